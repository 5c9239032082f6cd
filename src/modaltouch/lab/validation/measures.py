"""Sizes of a focus: how wide its spot is, how long its peak lasts, how far one curve lies from another."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def spot_width(position: FloatArray, field: FloatArray, centre: float, fraction: float) -> float:
    """Return how wide a field is, around its focus, at a fraction of its value there [m].

    Parameters
    ----------
    position : (n_positions,) array
        Where the field is given, increasing [m].
    field : (n_positions,) array
        Velocity field, straight lines between the points; its sign at the centre counts as positive [m/s].
    centre : float
        The focus [m].
    fraction : float
        Of the velocity at the centre [1].

    Returns
    -------
    float
        NaN where the field is zero at the centre; up to the end of the field where it does not fall below.
    """
    at_centre = float(np.interp(centre, position, field))
    if at_centre == 0:
        return math.nan
    height = field / at_centre
    left, right = position <= centre, position >= centre
    down = _first_below(np.append(position[left], centre)[::-1], np.append(height[left], 1.0)[::-1], fraction)
    up = _first_below(np.insert(position[right], 0, centre), np.insert(height[right], 0, 1.0), fraction)
    return abs(up - down)


def _first_below(place: FloatArray, height: FloatArray, fraction: float) -> float:
    """Return where straight lines, followed from the first point, first fall to a fraction."""
    below = np.flatnonzero(height < fraction)
    if below.size == 0:
        return float(place[-1])
    after = int(below[0])
    high, low = height[after - 1], height[after]
    share = (high - fraction) / (high - low)
    return float(place[after - 1] + share * (place[after] - place[after - 1]))


def time_above(time: FloatArray, velocity: FloatArray, instant: float, fraction: float) -> float:
    """Return how long a velocity stays above a fraction of its value at an instant, without a break around it [s].

    Parameters
    ----------
    time : (n_times,) array
        Instants, increasing [s].
    velocity : (n_times,) array
        Velocity of a point [m/s].
    instant : float
        Of the peak [s].
    fraction : float
        Of the velocity at that instant [1].
    """
    return spot_width(time, velocity, instant, fraction)


def root_mean_square(values: FloatArray) -> float:
    """Return the root of the mean of the squares, in the unit of the values."""
    return math.sqrt(float(np.mean(np.square(values))))


def contrast(one: float, other: float) -> float:
    """Return how many times the faster of two speeds is the slower [1]; infinite beside a zone at rest."""
    slower, faster = sorted((abs(one), abs(other)))
    return faster / slower if slower > 0 else math.inf
