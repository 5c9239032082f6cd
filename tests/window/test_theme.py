"""Contrast of the colours, by WCAG 2.1."""

from __future__ import annotations

import pytest

from modaltouch.window.layout import THEMES, Theme, mixed


def luminance(colour: str) -> float:
    """Return the relative luminance (WCAG 2.1, section 1.4.3)."""
    linear = []
    for place in (1, 3, 5):
        value = int(colour[place : place + 2], 16) / 255
        linear.append(value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4)
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(first: str, second: str) -> float:
    """Return the contrast ratio of two colours, 1 to 21 (WCAG 2.1, section 1.4.3)."""
    high, low = sorted((luminance(first), luminance(second)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("theme", THEMES.values(), ids=list(THEMES))
def test_words_are_readable(theme: Theme) -> None:
    """Ratios of 7 (AAA) for text, and 4.5 (AA) for secondary text and finger names."""
    assert contrast(theme.text, theme.ground) > 7
    assert contrast(theme.text, theme.button) > 7
    for colour in (theme.dim, theme.left, theme.right):
        assert contrast(colour, theme.ground) > 4.5


@pytest.mark.parametrize("theme", THEMES.values(), ids=list(THEMES))
def test_shapes_stand_out(theme: Theme) -> None:
    """A ratio of 3 for parts of a picture (WCAG 2.1, section 1.4.11)."""
    for colour in (theme.beam_edge, theme.button_edge, theme.hand_edge, theme.left, theme.right):
        assert contrast(colour, theme.ground) > 3
    assert contrast(theme.text, theme.zone) > 3


MACHADO_DEUTAN = ((0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.011820, 0.042940, 0.968881))
MACHADO_PROTAN = ((0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998))


@pytest.mark.parametrize("matrix", [MACHADO_DEUTAN, MACHADO_PROTAN], ids=["deutan", "protan"])
@pytest.mark.parametrize("theme", THEMES.values(), ids=list(THEMES))
def test_left_and_right_differ_without_red_or_green(
    theme: Theme, matrix: tuple[tuple[float, float, float], ...]
) -> None:
    """In blue by a third of its range (matrices of Machado et al., IEEE TVCG 15, 2009)."""

    def blue(colour: str) -> float:
        rgb = [(int(colour[place : place + 2], 16) / 255) ** 2.2 for place in (1, 3, 5)]
        return sum(weight * value for weight, value in zip(matrix[2], rgb, strict=True))

    assert abs(blue(theme.left) - blue(theme.right)) > 1 / 3


def test_a_mix_lies_between_its_colours() -> None:
    """The ends at fractions 0 and 1, the mean at one half."""
    assert [mixed("#000000", "#FF8000", share) for share in (0, 0.5, 1)] == ["#000000", "#804000", "#FF8000"]
