"""Layout of the screen and its elements: boxes, filled polygons, texts and colours, in units of the window's height.

The origin is the middle of the window, x to the right and y upwards. A picture is plain data, so that screens can be
compared and tested without a window; `cover` rasterises a polygon.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import AnswerList, ScaleSection

Point = tuple[float, float]


@dataclass(frozen=True)
class Box:
    """A rectangle by its centre and size [window heights]."""

    x: float
    y: float
    width: float
    height: float

    @property
    def left(self) -> float:
        """Left edge [window heights]."""
        return self.x - self.width / 2

    @property
    def right(self) -> float:
        """Right edge [window heights]."""
        return self.x + self.width / 2

    @property
    def bottom(self) -> float:
        """Lower edge [window heights]."""
        return self.y - self.height / 2

    @property
    def top(self) -> float:
        """Upper edge [window heights]."""
        return self.y + self.height / 2

    def contains(self, x: float, y: float) -> bool:
        """Return whether a point lies in the box, edges included."""
        return self.left <= x <= self.right and self.bottom <= y <= self.top

    def inset(self, margin: float) -> Box:
        """Return the box reduced by a margin on every side."""
        return Box(self.x, self.y, self.width - 2 * margin, self.height - 2 * margin)


@dataclass(frozen=True)
class Shape:
    """A filled convex polygon."""

    corners: tuple[Point, ...]  # corners in order [window heights]
    fill: str  # colour as ``#RRGGBB``


@dataclass(frozen=True)
class Words:
    """A text centred in its box, made smaller if it does not fit."""

    text: str  # the text; a line break starts a new line
    box: Box  # box that the text must fit
    size: float  # intended type size, em [window heights]
    fill: str  # colour as ``#RRGGBB``
    bold: bool = False  # whether the type is bold


Mark = Shape | Words


@dataclass(frozen=True)
class Picture:
    """A screen, with its marks in drawing order."""

    name: str  # name, used for screenshots, such as ``question_one_hand_AC``
    marks: tuple[Mark, ...]  # marks in drawing order

    @property
    def texts(self) -> tuple[str, ...]:
        """Texts of the picture in drawing order."""
        return tuple(mark.text for mark in self.marks if isinstance(mark, Words))


def moved(marks: tuple[Mark, ...], rise: float) -> tuple[Mark, ...]:
    """Return the marks moved upwards [window heights]."""
    return tuple(
        replace(mark, corners=tuple((x, y + rise) for x, y in mark.corners))
        if isinstance(mark, Shape)
        else replace(mark, box=replace(mark.box, y=mark.box.y + rise))
        for mark in marks
    )


def rectangle(box: Box, fill: str) -> Shape:
    """Return a filled rectangle."""
    return Shape(((box.left, box.bottom), (box.right, box.bottom), (box.right, box.top), (box.left, box.top)), fill)


def rounded(box: Box, radius: float, fill: str, *, n_steps: int = 8) -> Shape:
    """Return a filled rectangle with rounded corners of a radius [window heights]."""
    radius = min(radius, box.width / 2, box.height / 2)
    centres = (
        (box.right - radius, box.top - radius, 0.0),
        (box.left + radius, box.top - radius, 0.5),
        (box.left + radius, box.bottom + radius, 1.0),
        (box.right - radius, box.bottom + radius, 1.5),
    )
    corners = tuple(
        (x + radius * math.cos(angle), y + radius * math.sin(angle))
        for x, y, start in centres
        for angle in (math.pi * (start + step / (2 * n_steps)) for step in range(n_steps + 1))
    )
    return Shape(corners, fill)


def framed(box: Box, radius: float, edge: str, fill: str, line: float) -> tuple[Shape, Shape]:
    """Return a rounded rectangle with an edge of width `line` inside the box [window heights]."""
    return rounded(box, radius, edge), rounded(box.inset(line), radius - line, fill)


def capsule(start: Point, end: Point, radius: float, fill: str, *, n_steps: int = 12) -> Shape:
    """Return a bar with rounded ends between two points [window heights]."""
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    halves = ((end, heading - math.pi / 2), (start, heading + math.pi / 2))
    corners = tuple(
        (x + radius * math.cos(angle), y + radius * math.sin(angle))
        for (x, y), first in halves
        for angle in (first + math.pi * step / n_steps for step in range(n_steps + 1))
    )
    return Shape(corners, fill)


def triangle(direction: str, x: float, y: float, radius: float, fill: str) -> Shape:
    """Return a triangle pointing ``left``, ``right``, ``up`` or ``down``, by its circumscribed circle."""
    first = {"right": 0.0, "up": 0.5, "left": 1.0, "down": 1.5}[direction] * math.pi
    angles = (first + 2 * math.pi * corner / 3 for corner in range(3))
    return Shape(tuple((x + radius * math.cos(a), y + radius * math.sin(a)) for a in angles), fill)


@dataclass(frozen=True, eq=False)
class Coverage:
    """Covered share of each pixel."""

    # left, bottom: position of the first pixel [pixels]
    left: int
    bottom: int
    alpha: NDArray[np.float32]  # (n_rows, n_columns): covered share of each pixel, the lowest row first [1]


def cover(corners: NDArray[np.float64]) -> Coverage:
    """Return the share of each pixel covered by a convex polygon.

    The share is computed from the distance of the pixel's centre to the nearest edge: exact for edges along the pixel
    grid, and within 0.1 of the true area otherwise.

    Parameters
    ----------
    corners : (n_corners, 2) array
        Corners in order, in either direction, y upwards [pixels].
    """
    left, bottom = (math.floor(low) - 1 for low in corners.min(axis=0))
    right, top = (math.ceil(high) + 1 for high in corners.max(axis=0))
    x = np.arange(left, right, dtype=np.float32) + np.float32(0.5)
    y = np.arange(bottom, top, dtype=np.float32)[:, np.newaxis] + np.float32(0.5)
    following = np.roll(corners, -1, axis=0)
    turn = np.sign(np.sum(corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1]))
    inside = np.full((top - bottom, right - left), np.inf, dtype=np.float32)
    for (x0, y0), (x1, y1) in zip(corners, following, strict=True):
        length = math.hypot(x1 - x0, y1 - y0)
        if length < 1e-9:
            continue
        normal_x, normal_y = -turn * (y1 - y0) / length, turn * (x1 - x0) / length
        distance = np.float32(normal_x) * (x - np.float32(x0)) + np.float32(normal_y) * (y - np.float32(y0))
        np.minimum(inside, distance, out=inside)
    return Coverage(left, bottom, np.clip(inside + np.float32(0.5), 0, 1))


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
    *,
    from_right: bool = False,
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
    from_right : bool
        Whether the first answer is on the right.
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
        buttons=_scale_parts(scale, across, unit) if scale else _answer_buttons(answers, width, unit, from_right),
        headline=Box(0, 0.405, 1.24 * unit, 0.14),
        body=Box(0, 0.24 - 0.06 * (1 - unit), 1.18 * unit, 0.21),
        page=Box(0, 0.06, 1.14 * unit, 0.6),
        go_on=Box(0, -0.432, min(1.2 * unit, type_scale), 0.08),
        label=Box(0, -0.437, 1.2 * unit, 0.034),
        bar=Box(0, -0.47, across, 0.01),
        note=Box(0, -0.391, 1.2 * unit, 0.046),
    )


def _answer_buttons(answers: AnswerList, width: float, unit: float, from_right: bool) -> dict[str, Box]:
    """Return the answer buttons: a row, high enough for two lines of text, and those below it.

    From six answers on, the row is wider than the beam, as far as the window allows.
    """
    step = -1 if from_right else 1
    row, below = ([answer.name for answer in answers if answer.is_below is lower][::step] for lower in (False, True))
    gap, high = min(0.045, 0.16 / max(len(row), 1)) * unit, max(unit, 0.8)
    across = max(1.2 * unit, min(0.24 * unit * len(row), width - 0.05))
    each, low = ((across - gap * (len(names) - 1)) / max(len(names), 1) for names in (row, below))
    middle = Box(0, -0.21, min(0.56 * unit, each), 0.14 * high)
    if not below:
        middle = replace(middle, y=-0.2575, height=0.21 * high)
    return {**_row(row, middle, gap), **_row(below, Box(0, -0.3285, low, 0.075), gap)}


def _scale_parts(scale: ScaleSection, across: float, unit: float) -> dict[str, Box]:
    """Return the parts of a scale by the action of a click."""
    confirm, line = Box(0, -0.333, 0.48 * unit, 0.058), Box(0, -0.215, 0.96 * across, 0.07)
    if scale.kind == "vas":
        return {"confirm": confirm, "line": line}
    signs = [*"0123456789", ".", *(["-"] if "-" in scale.actions else []), "back"]
    names = [f"{point:.10g}" for point in scale.points][:: -1 if scale.is_from_right else 1] or signs
    step = across / max(len(names), 5)
    middle = Box(0, -0.185, 0.86 * step, 0.07) if scale.points else Box(0, -0.268, 0.86 * step, 0.05)
    return {"confirm": confirm, **_row(names, middle, 0.14 * step)}


def _row(names: list[str], middle: Box, gap: float = 0.0) -> dict[str, Box]:
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
