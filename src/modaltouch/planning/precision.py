"""Widths of the intervals that the analysis would print, for thousands of experiments at once.

The same score intervals as `modaltouch.analysis.intervals`, over arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.intervals import CONFIDENCE

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

_BISECTIONS = 28
"""Halve the range until a bound is known to 1e-8."""


def difference_width(first: ArrayLike, second: ArrayLike, n_answers: int) -> FloatArray:
    """Return half the widths of `modaltouch.analysis.intervals.clustered_difference`, (...,) array [1].

    Parameters
    ----------
    first, second : (..., n_participants) arrays
        How many of each participant's answers count only for the first, and only for the second.
    n_answers : int
        Answers per participant.
    """
    b, c = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    n, total = b.shape[-1], float(b.shape[-1] * n_answers)
    only_first, only_second = b.sum(axis=-1), c.sum(axis=-1)
    difference = (only_first - only_second) / total
    single = (only_first + only_second) / total - difference**2
    net = (b - c) / n_answers
    between = net.var(axis=-1, ddof=1) / n if n > 1 else np.full(difference.shape, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        worth = np.where(between > 0, single / between, total)
    effective = np.where(single <= 1e-12, n, np.clip(worth, n, total))
    share = effective / total
    return tango_width(only_first * share, only_second * share, effective)


def slope_width(shares: ArrayLike, levels: Sequence[float]) -> FloatArray:
    """Return half the widths of the 95 % intervals of mean slopes per 100 mm/s of the level, (...,) array [1].

    Parameters
    ----------
    shares : (..., n_participants, n_levels) array
        Share of one answer at each level [1].
    levels : sequence of float
        Levels [mm/s], two or more.
    """
    centred = np.asarray(levels, dtype=float) - np.mean(levels)
    weights = 100 * centred / (centred**2).sum()
    steepest = float(weights[weights > 0].sum())
    slopes = np.asarray(shares, dtype=float) @ weights / steepest
    rising, falling = np.maximum(slopes, 0).sum(axis=-1), np.maximum(-slopes, 0).sum(axis=-1)
    return tango_width(rising, falling, np.full(rising.shape, slopes.shape[-1])) * steepest


def share_width(successes: IntArray, n: IntArray) -> FloatArray:
    """Return half the widths of the exact intervals of proportions.

    Parameters
    ----------
    successes, n : arrays of int
        Successes out of n; n may be zero.
    """
    from scipy.special import betaincinv

    tail = (1 - CONFIDENCE) / 2
    k, m = np.asarray(successes, dtype=float), np.asarray(n, dtype=float)
    low = np.where(k > 0, betaincinv(np.maximum(k, 1), m - k + 1, tail), 0.0)
    high = np.where(k < m, betaincinv(k + 1, np.maximum(m - k, 1), 1 - tail), 1.0)
    return np.asarray((high - low) / 2)


def tango_width(only_first: FloatArray, only_second: FloatArray, n: ArrayLike) -> FloatArray:
    """Return half the widths of Tango's intervals of paired differences.

    Parameters
    ----------
    only_first, only_second : arrays
        Pairs that succeeded only the first way, and only the second way; need not be whole.
    n : array
        Numbers of pairs.
    """
    z = NormalDist().inv_cdf(1 - (1 - CONFIDENCE) / 2)
    pairs = np.asarray(n, dtype=float)
    upper, lower = (_bound(only_first, only_second, pairs, z, end) for end in (1.0, -1.0))
    return np.asarray((upper - lower) / 2)


def _bound(b: FloatArray, c: FloatArray, n: FloatArray, z: float, end: float) -> FloatArray:
    """Return where the score statistic reaches z, between the estimate and an end, by bisection."""
    inside = (b - c) / n
    outside = np.full(inside.shape, end)
    for _ in range(_BISECTIONS):
        middle = (inside + outside) / 2
        linear = (2 * n - b + c) * middle - b - c
        # The likeliest probability of a pair of the second kind, given the difference (Tango, eq. 10).
        constant = -c * middle * (1 - middle)
        q = (np.sqrt(np.maximum(linear * linear - 8 * n * constant, 0.0)) - linear) / (4 * n)
        spread = n * np.maximum(2 * q + middle * (1 - middle), 0.0)
        too_far = np.abs(b - c - n * middle) > z * np.sqrt(spread)
        outside = np.where(too_far, middle, outside)
        inside = np.where(too_far, inside, middle)
    return np.asarray((inside + outside) / 2)
