"""Layout and colours of the screen, and hit testing of clicks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from modaltouch.protocol import AnswerList, ScaleSection
from modaltouch.window.shapes import Box

Spans = Mapping[str, tuple[float, float]]
"""Start and end of each zone, by name from the left, as shares of the beam's length from its middle [1]."""

_FULL_ASPECT = 1.32
"""Aspect ratio from which everything is shown at full size; narrower windows shrink it to fit."""


@dataclass(frozen=True)
class Layout:
    """Positions and sizes in a window [window heights]."""

    width: float  # width of the window; its height is 1
    unit: float  # scale of parts that must fit the width of the window, relative to a wide window [1]
    type_scale: float  # scale of type, relative to a wide window [1]
    beam: Box  # the whole beam
    zones: dict[str, Box]  # zones from the left, by name, to scale
    buttons: dict[str, Box]  # answer buttons, by answer; or the parts of a scale
    answer_width: float  # width of the buttons in the row
    # headline, body, page, go_on, label, bar, note: question or title; text under a title; text of a screen without a
    # beam; button to continue; progress as text; progress bar; line under the answer buttons
    headline: Box
    body: Box
    page: Box
    go_on: Box
    label: Box
    bar: Box
    note: Box

    def answer_at(self, x: float, y: float) -> str | None:
        """Return the answer whose button is at a point, or None.

        Parameters
        ----------
        x, y : float
            Position of the click [window heights], origin in the middle of the window, y upwards.
        """
        return next((answer for answer, box in self.buttons.items() if box.contains(x, y)), None)

    def turned(self) -> Layout:
        """Return the layout for the beam turned end to end, with its last zone on the left."""
        return replace(self, zones={name: replace(box, x=-box.x) for name, box in reversed(self.zones.items())})


def lay_out(
    width_px: int,
    height_px: int,
    zones: Spans,
    answers: AnswerList,
    scale: ScaleSection | None = None,
) -> Layout:
    """Return the layout of a window.

    Parameters
    ----------
    width_px, height_px : int
        Size of the window [pixels].
    zones : mapping of str to (float, float)
        As `Spans`.
    answers : AnswerList
        Offered answers.
    scale : ScaleSection, optional
        Scale in place of the answers; its parts are then the buttons, by the action of a click.
    """
    width = width_px / height_px
    unit = min(1.0, width / _FULL_ASPECT)
    type_scale = max(unit, min(1.0, 0.2 + 0.8 * width))
    across = 1.2 * unit
    beam = Box(0, 0.16, 1.1 * unit, 0.105 * unit)
    return Layout(
        width=width,
        unit=unit,
        type_scale=type_scale,
        beam=beam,
        zones={
            name: replace(beam, x=(left + right) / 2 * beam.width, width=(right - left) * beam.width)
            for name, (left, right) in zones.items()
        },
        **(_answer_buttons(answers, across, unit) if scale is None else _scale_parts(scale, across, unit)),
        headline=Box(0, 0.405, 1.24 * unit, 0.14),
        body=Box(0, 0.24 - 0.06 * (1 - unit), 1.18 * unit, 0.21),
        page=Box(0, 0.06, 1.14 * unit, 0.6),
        go_on=Box(0, -0.432, min(1.2 * unit, type_scale), 0.08),
        label=Box(0, -0.437, 1.2 * unit, 0.034),
        bar=Box(0, -0.47, across, 0.01),
        note=Box(0, -0.391, 1.2 * unit, 0.046),
    )


def _answer_buttons(answers: AnswerList, across: float, unit: float) -> dict[str, Any]:
    """Return the answer buttons, and the width of those in the row, which is higher if others are below."""
    row = tuple(answer.name for answer in answers if not answer.is_below)
    gap = min(0.045, 0.16 / max(len(row), 1)) * unit
    below = tuple(answer.name for answer in answers if answer.is_below)
    width, low = ((across - gap * (len(names) - 1)) / max(len(names), 1) for names in (row, below))
    width = min(0.4 * unit, width)
    if not below:
        return {"buttons": _row(row, Box(0, -0.275, width, 0.175 * max(unit, 0.8)), gap), "answer_width": width}
    above = _row(row, Box(0, -0.21, width, 0.14 * max(unit, 0.8)), gap)
    return {"buttons": {**above, **_row(below, Box(0, -0.3285, low, 0.075), gap)}, "answer_width": width}


def _scale_parts(scale: ScaleSection, across: float, unit: float) -> dict[str, Any]:
    """Return the parts of a scale by the action of a click, and the width of a point or key."""
    confirm, line = Box(0, -0.333, 0.48 * unit, 0.058), Box(0, -0.215, 0.96 * across, 0.07)
    if scale.kind == "vas":
        return {"buttons": {"confirm": confirm, "line": line}, "answer_width": line.width}
    signs = [*"0123456789", ".", *(["-"] if "-" in scale.actions else []), "back"]
    names = tuple(f"{point:.10g}" for point in scale.points)[:: -1 if scale.is_from_right else 1] or tuple(signs)
    step = across / max(len(names), 5)
    middle = Box(0, -0.185, 0.86 * step, 0.07) if scale.points else Box(0, -0.268, 0.86 * step, 0.05)
    return {"buttons": {"confirm": confirm, **_row(names, middle, 0.14 * step)}, "answer_width": middle.width}


def _row(names: tuple[str, ...], middle: Box, gap: float = 0.0) -> dict[str, Box]:
    """Return a row of boxes from the left, centred on the box `middle`."""
    step, centre = middle.width + gap, (len(names) - 1) / 2
    return {name: replace(middle, x=middle.x + (place - centre) * step) for place, name in enumerate(names)}


@dataclass(frozen=True)
class Theme:
    """Colours as ``#RRGGBB``.

    The colours of fingers are the blue, purple and orange of Okabe and Ito (Color Universal Design, 2008), which remain
    distinguishable under all common colour vision deficiencies; colour is never the only cue.
    """

    # ground, text, dim: background, text, and secondary text
    ground: str
    text: str
    dim: str
    # beam, beam_edge, zone: the beam, its outline and divisions, and the fill of all touched zones
    beam: str
    beam_edge: str
    zone: str
    # left, between, right: fingers on the left and right zone and between them, with their labels
    left: str
    between: str
    right: str
    # hand, hand_edge: hands except the touching fingers
    hand: str
    hand_edge: str
    # button, button_edge: answer buttons; the chosen one has the colour of the text, and its text that of the ground
    button: str
    button_edge: str


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
    button="#1E262E",
    button_edge="#8B97A3",
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
    button="#FFFFFF",
    button_edge="#6C7884",
)


def mixed(colour: str, other: str, share: float) -> str:
    """Mix a colour with a share (0 to 1) of another."""
    pairs = ((int(colour[i : i + 2], 16), int(other[i : i + 2], 16)) for i in (1, 3, 5))
    return "#" + "".join(f"{round(a + (b - a) * share):02X}" for a, b in pairs)


THEMES: dict[str, Theme] = {"dark": DARK, "light": LIGHT}
"""Themes by name."""
