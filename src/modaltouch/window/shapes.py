"""Elements of pictures: filled polygons and texts, in units of the window's height.

The origin is the middle of the window, x to the right and y upwards. A picture is plain data, so that screens can be
compared and tested without a window; `cover` rasterises a polygon.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

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
