"""Colours of the answer window, dark and light."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Theme:
    """Colours as ``#RRGGBB``.

    The colours of fingers are the blue, purple and orange of Okabe and Ito (Color Universal Design, 2008), which remain
    distinguishable under all common colour vision deficiencies; colour is never the only cue.

    Attributes
    ----------
    ground, text, dim : str
        Background, text, and secondary text.
    beam, beam_edge, zone : str
        The beam, its outline and divisions, and the fill of all touched zones.
    left, between, right : str
        Fingers on the left and right zone and between them, with their labels.
    hand, hand_edge, nail : str
        Hands except the touching fingers, and the tint of a nail.
    button, button_edge, pressed, pressed_text : str
        Answer buttons, and the chosen one.
    """

    ground: str
    text: str
    dim: str
    beam: str
    beam_edge: str
    zone: str
    left: str
    between: str
    right: str
    hand: str
    hand_edge: str
    nail: str
    button: str
    button_edge: str
    pressed: str
    pressed_text: str


DARK = Theme(
    ground="#12171C",
    text="#F3F5F7",
    dim="#A7B1BB",
    beam="#39434D",
    beam_edge="#8B97A3",
    zone="#616E7A",
    left="#56B4E9",
    between="#CC79A7",
    right="#E69F00",
    hand="#28313A",
    hand_edge="#6C7986",
    nail="#FFFFFF",
    button="#1E262E",
    button_edge="#8B97A3",
    pressed="#F3F5F7",
    pressed_text="#12171C",
)

LIGHT = Theme(
    ground="#FAFAF8",
    text="#14191E",
    dim="#4C5762",
    beam="#D5DADF",
    beam_edge="#6C7884",
    zone="#FFFFFF",
    left="#0072B2",
    between="#9A3A73",
    right="#C05000",
    hand="#E6E3DE",
    hand_edge="#857E76",
    nail="#FFFFFF",
    button="#FFFFFF",
    button_edge="#6C7884",
    pressed="#14191E",
    pressed_text="#FAFAF8",
)


def mixed(colour: str, other: str, share: float) -> str:
    """Mix a colour with a share (0 to 1) of another."""
    pairs = ((int(colour[i : i + 2], 16), int(other[i : i + 2], 16)) for i in (1, 3, 5))
    return "#" + "".join(f"{round(a + (b - a) * share):02X}" for a, b in pairs)


THEMES: dict[str, Theme] = {"dark": DARK, "light": LIGHT}
"""Themes by name."""
