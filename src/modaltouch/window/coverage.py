"""The part of the screen that something drawn covers, pixel by pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Coverage:
    """The share of each pixel that is covered.

    Attributes
    ----------
    left, bottom : int
        Place of the first pixel [pixels].
    alpha : (n_rows, n_columns) array
        Share of each pixel, the lowest row first [1].
    """

    left: int
    bottom: int
    alpha: NDArray[np.float32]


def cover(corners: NDArray[np.float64]) -> Coverage:
    """Return how much of each pixel a convex polygon covers.

    A pixel's share is taken from the distance of its centre to the nearest edge: exact for a straight edge
    along the pixel grid, and within 0.1 of the true area elsewhere.

    Parameters
    ----------
    corners : (n_corners, 2) array
        Corners in order, either way round [pixels], y upwards.
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
