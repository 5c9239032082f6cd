"""Intervals for proportions and their paired differences that hold when every answer is the same.

Every function takes one experiment or a batch of them, over whose axes it runs.

References
----------
Clopper and Pearson, Biometrika 26 (1934) 404-413.
Korn and Graubard, Survey Methodology 24 (1998) 193-201.
Tango, Statistics in Medicine 17 (1998) 891-908.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

CONFIDENCE = 0.95
"""Confidence of every interval in the analysis."""

_MOST_STEPS = 80
"""Steps to a bound; about ten are taken."""


@dataclass(frozen=True, eq=False)
class Interval:
    """An estimate with its confidence interval, or arrays of them.

    Attributes
    ----------
    estimate, low, high : float or array
        Estimate and bounds.
    n_effective : float or array
        Independent answers the interval is worth.
    """

    estimate: Any
    low: Any
    high: Any
    n_effective: Any

    @property
    def half_width(self) -> Any:
        """Half the distance of the bounds."""
        return (self.high - self.low) / 2

    def __getitem__(self, place: int | slice) -> Interval:
        return Interval(*(np.asarray(value)[place] for value in vars(self).values()))

    def __mul__(self, scale: float) -> Interval:
        return Interval(self.estimate * scale, self.low * scale, self.high * scale, self.n_effective)


def clopper_pearson(successes: ArrayLike, n: ArrayLike, confidence: float = CONFIDENCE) -> Interval:
    """Return the exact interval of a proportion; 0 to 1 about NaN where n is zero.

    Parameters
    ----------
    successes, n : float or arrays
        Successes out of n; need not be whole, as a design effect may have scaled both.
    confidence : float
        Confidence of the interval [1].

    Raises
    ------
    ValueError
        If there are more successes than n, or fewer than none.

    Examples
    --------
    >>> interval = clopper_pearson(10, 10)
    >>> float(interval.low.round(4)), float(interval.high)
    (0.6915, 1.0)
    """
    from scipy.special import betaincinv

    k, m = np.broadcast_arrays(np.asarray(successes, dtype=float), np.asarray(n, dtype=float))
    if not ((k >= 0) & (k <= m)).all():
        raise ValueError(f"{successes!r} successes out of {n!r}: allowed are 0 to n")
    tail = (1 - confidence) / 2
    low = np.where(k > 0, betaincinv(np.where(k > 0, k, 1), m - k + 1, tail), 0.0)
    high = np.where(k < m, betaincinv(k + 1, np.where(k < m, m - k, 1), 1 - tail), 1.0)
    share = np.divide(k, m, out=np.full(m.shape, math.nan), where=m > 0)
    return Interval(share[()], low[()], high[()], m[()])


def wilson(successes: float, n: float) -> Interval:
    """Return the score interval of a proportion, as used for Monte Carlo shares.

    Parameters
    ----------
    successes, n : float
        Successes out of n, n above zero.
    """
    z2 = _normal_quantile(CONFIDENCE) ** 2
    p = successes / n
    centre = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = math.sqrt(z2 * (p * (1 - p) / n + z2 / (4 * n * n))) / (1 + z2 / n)
    return Interval(p, max(centre - half, 0.0), min(centre + half, 1.0), n)


def korn_graubard(successes: ArrayLike, n_answers: int) -> Interval:
    """Return the interval of a proportion of all answers when each participant gave several.

    The Clopper-Pearson interval at the effective number of answers. The design effect is held between 1 and
    the answers per participant, and is the latter where all participants agree: ten participants who always
    give the same answer are worth ten answers, not forty.

    Parameters
    ----------
    successes : (..., n_participants) array
        How many of each participant's answers count.
    n_answers : int
        Answers per participant.
    """
    shares = np.asarray(successes, dtype=float) / n_answers
    p = shares.mean(axis=-1)
    effective = _effective_number(p * (1 - p), shares, n_answers)
    inner = clopper_pearson(p * effective, effective)
    return Interval(p, inner.low, inner.high, effective)


def tango(only_first: ArrayLike, only_second: ArrayLike, n: ArrayLike, confidence: float = CONFIDENCE) -> Interval:
    """Return the score interval of a difference of paired proportions.

    Parameters
    ----------
    only_first, only_second : float or arrays
        Pairs that succeeded only the first way, and only the second way; need not be whole.
    n : float or array
        Number of pairs, above zero.
    confidence : float
        Confidence of the interval [1].

    Returns
    -------
    Interval
        Difference, first less second. Without any discordant pair the half width is z^2 / (n + z^2).

    Raises
    ------
    ValueError
        If more pairs are discordant than there are.

    Examples
    --------
    >>> float(tango(0, 0, 10).high.round(3))
    0.278
    """
    b, c, pairs = np.broadcast_arrays(*(np.asarray(each, dtype=float) for each in (only_first, only_second, n)))
    if not ((b >= 0) & (c >= 0) & (pairs > 0) & (pairs >= b + c - 1e-9)).all():
        raise ValueError(f"{only_first!r} + {only_second!r} discordant pairs of {n!r}: they cannot be more than all")
    # The lower bound of a difference is the upper one of its negative.
    high, low = _upper_bounds(np.stack([b, c]), np.stack([c, b]), pairs, _normal_quantile(confidence))
    return Interval((b - c) / pairs, -low, high, pairs[()])


def _upper_bounds(b: FloatArray, c: FloatArray, n: FloatArray, z: float) -> FloatArray:
    """Return where the score statistic reaches z above the estimate: Newton's method, by halves where it leaves."""
    inside = np.minimum((b - c) / n, 1.0)
    outside = bound = np.ones(b.shape)
    slope, variance, curvature = 2 * n - b + c, z * z * n, 4 * n * c
    for _ in range(_MOST_STEPS):
        # The likeliest probability of a pair of the second kind, given the difference (Tango, eq. 10), twice.
        linear, turn = slope * bound - b - c, 1 - 2 * bound
        root = np.sqrt(np.maximum(linear * linear + 2 * curvature * bound * (1 - bound), 1e-300))
        twice, grown = (root - linear) / (2 * n), ((linear * slope + curvature * turn) / root - slope) / (2 * n)
        gap = b - c - n * bound
        value = gap * gap - variance * (twice + bound * (1 - bound))
        rise = -2 * n * gap - variance * (grown + turn)
        outside, inside = np.where(value > 0, bound, outside), np.where(value > 0, inside, bound)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            next_bound = bound - value / rise
        within = (inside <= next_bound) & (next_bound <= outside)
        next_bound = np.where(within, next_bound, (inside + outside) / 2)
        moved = float(np.abs(next_bound - bound).max(initial=0.0))
        bound = next_bound
        if moved < 1e-12:
            break
    return np.asarray(bound)


def clustered_difference(first: ArrayLike, second: ArrayLike, n_answers: int) -> Interval:
    """Return the interval of a share less another, paired, when each participant gave several answers.

    Tango's interval at the effective number of answers, found as in `korn_graubard`: the design effect is held
    between 1 and the answers per participant, and is the latter where nothing varies.

    Parameters
    ----------
    first, second : (..., n_participants) arrays
        How many of each participant's answers (or pairs of answers) count only for the first, and only for the
        second.
    n_answers : int
        Answers, or pairs of answers, per participant.
    """
    b, c = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    total = float(b.shape[-1] * n_answers)
    only_first, only_second = b.sum(axis=-1) / total, c.sum(axis=-1) / total
    single = only_first + only_second - (only_first - only_second) ** 2
    effective = _effective_number(single, (b - c) / n_answers, n_answers)
    return tango(only_first * effective, only_second * effective, effective)


def _effective_number(single: FloatArray, shares: FloatArray, n_answers: int) -> FloatArray:
    """Return how many independent answers those of all participants are worth.

    Parameters
    ----------
    single : (...) array
        Variance of a single answer [1].
    shares : (..., n_participants) array
        Mean of each participant's answers.
    n_answers : int
        Answers per participant.
    """
    n = shares.shape[-1]
    if n < 2:
        return np.full(single.shape, float(n))[()]
    between = shares.var(axis=-1, ddof=1) / n
    worth = np.divide(single, between, out=np.full(single.shape, math.inf), where=between > 0)
    return np.asarray(np.where(single <= 1e-12, n, np.clip(worth, n, n * n_answers)))[()]


def paired_mean(scores: ArrayLike, scale: float) -> Interval:
    """Return a never degenerate interval for the mean of score / scale, one bounded score per participant.

    A score of `scale` counts as a whole pair discordant one way, half of it as half a pair; this overstates the
    spread of fractional scores, so the interval is conservative. Where all scores are zero it is Tango's.

    Parameters
    ----------
    scores : (..., n_participants) array
        Scores between -scale and scale.
    scale : float
        Largest size a score can have.
    """
    shares = np.asarray(scores, dtype=float) / scale
    return tango(np.maximum(shares, 0).sum(axis=-1), np.maximum(-shares, 0).sum(axis=-1), shares.shape[-1])


def mean_slope(shares: ArrayLike, levels: Sequence[float], step: float) -> Interval:
    """Return the mean slope of participants' shares over the level; not a number where there is one level only.

    Parameters
    ----------
    shares : (..., n_participants, n_levels) array
        Share of one answer at each level [1].
    levels : sequence of float
        Levels.
    step : float
        Difference of levels that the slope is of.
    """
    values, centred = np.asarray(shares, dtype=float), np.asarray(levels, dtype=float) - np.mean(levels)
    if not centred.any():
        return Interval(*(np.full(values.shape[:-2], each)[()] for each in (math.nan, math.nan, math.nan, 0.0)))
    weights = step * centred / (centred**2).sum()
    steepest = float(weights[weights > 0].sum())
    return paired_mean(values @ weights, steepest) * steepest


def student_interval(values: FloatArray) -> Interval:
    """Return the t interval of a mean; without bounds where the values do not vary.

    Parameters
    ----------
    values : (n,) array
        One value a participant.
    """
    n = values.size
    if n < 2 or np.ptp(values) == 0:
        return Interval(float(values.mean()) if n else math.nan, math.nan, math.nan, n)
    mean, half = float(values.mean()), student_quantile(n - 1) * float(values.std(ddof=1)) / math.sqrt(n)
    return Interval(mean, mean - half, mean + half, n)


def student_quantile(degrees: int) -> float:
    """Return how many standard errors the bounds of a t interval are from the estimate.

    Parameters
    ----------
    degrees : int
        Degrees of freedom.
    """
    from scipy.special import stdtrit

    return float(stdtrit(degrees, 1 - (1 - CONFIDENCE) / 2))


def matched_odds_ratio(only_first: int, only_second: int) -> Interval:
    """Return the conditional odds ratio of pairs, by transforming the exact interval of b / (b + c).

    Parameters
    ----------
    only_first, only_second : int
        Pairs that succeeded only the first way, and only the second way.

    Returns
    -------
    Interval
        0 to infinity, with an estimate that is not a number, where no pair is discordant.
    """
    share = clopper_pearson(only_first, only_first + only_second)

    def odds(p: float) -> float:
        return math.inf if p == 1 else p / (1 - p)

    return Interval(odds(share.estimate), odds(share.low), odds(share.high), share.n_effective)


def _normal_quantile(confidence: float) -> float:
    return NormalDist().inv_cdf(1 - (1 - confidence) / 2)
