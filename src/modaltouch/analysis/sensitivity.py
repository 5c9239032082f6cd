"""Sensitivity d' and criterion of one participant, by signal detection theory, with 95 % intervals.

Estimates use rates with the log-linear correction, (k + 0.5) / (n + 1), so that they are finite. Intervals use the
counts themselves and exact limits of the rates, so they cover at least 95 %; a bound is infinite if the answers do not
determine it.

References
----------
Macmillan and Creelman, "Detection Theory: A User's Guide", 2nd ed. (2005), chapters 1, 7 and 9.
Hautus, Behavior Research Methods 27 (1995) 46-51 (log-linear correction).
Hacker and Ratcliff, Perception & Psychophysics 26 (1979) 168-170 (m alternatives).
Frijters, British Journal of Mathematical and Statistical Psychology 32 (1979) 229-241 (the odd one of three).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ncfdtr, ndtr, ndtri

from modaltouch.analysis.intervals import DROP, Interval, clopper_pearson

FloatArray = NDArray[np.float64]
Statistic = Callable[[FloatArray, FloatArray], FloatArray]
Count = tuple[int, int]
"""How often an answer was given, and out of how many."""

_HALVINGS = 50
_FARTHEST = 40.0
"""Largest d' that is distinguished from an infinite one."""


@dataclass(frozen=True, eq=False)
class SignalDetection:
    """Signal detection of one participant from two kinds of trial.

    Attributes
    ----------
    d_prime : Interval
        Sensitivity d', in standard deviations of what is felt at one presentation.
    contrast : float
        Difference of the two rates, or of one rate from chance [1]. Its expectation is zero if nothing is
        discriminated, unlike that of d', whose correction shifts the rate of fewer trials more. NaN without trials of
        both kinds.
    criterion : Interval or None
        Criterion; 0 if no answer is preferred, higher with fewer answers of the first kind. None if all answers are
        pooled.
    model : str
        Decision model that it rests on.
    """

    d_prime: Interval
    contrast: float
    criterion: Interval | None = None
    model: str = "yes-no"


def yes_no(signal: Count, noise: Count) -> SignalDetection:
    """Return d' = z(H) - z(F) and c = -(z(H) + z(F)) / 2 from the rates of hits H and false alarms F.

    Parameters
    ----------
    signal, noise : (int, int)
        Answers "yes" in trials with the signal, and in those without it.

    Examples
    --------
    >>> found = yes_no((40, 40), (0, 38))
    >>> round(found.d_prime.estimate, 3), found.d_prime.high
    (4.483, inf)
    """
    return SignalDetection(
        _joint(lambda hit, alarm: ndtri(hit) - ndtri(alarm), signal, noise),
        _rate(signal) - _rate(noise),
        _joint(lambda hit, alarm: -(ndtri(hit) + ndtri(alarm)) / 2, signal, noise),
    )


def two_intervals(first: Count, second: Count) -> SignalDetection:
    """Return d' = (z(H) - z(F)) / sqrt(2) and c for two alternatives in time or space.

    Parameters
    ----------
    first, second : (int, int)
        Answers "first" in trials with the signal in the first interval, and in those with it in the second.
    """
    found = yes_no(first, second)
    return replace(found, d_prime=found.d_prime.changed(lambda d_prime: d_prime / math.sqrt(2)), model="2AFC")


def m_intervals(correct: Count, m: int) -> SignalDetection:
    """Return d' of an unbiased observer of m alternatives, with the interval from the exact one of the share.

    Parameters
    ----------
    correct : (int, int)
        Correct answers.
    m : int
        Alternatives, two or more.
    """
    found = _of_share(correct, lambda d: share_correct(d, m), -_FARTHEST)
    return SignalDetection(found, _rate(correct) - 1 / m, model=f"{m}AFC")


def odd_of_three(correct: Count) -> SignalDetection:
    """Return d' of the triangular model: whichever percept is farthest from the other two is called the odd one.

    With percepts x, y of the equal stimuli and z of the odd one, u = (x - y) / sqrt(2) and v = (z - (x + y) / 2)
    sqrt(2 / 3) have unit variance. The answer is correct if v^2 / u^2 > 3, which has a noncentral F distribution with
    1 and 1 degrees of freedom and noncentrality 2 d'^2 / 3. No d' is below 0.

    Parameters
    ----------
    correct : (int, int)
        Correct answers.
    """
    found = _of_share(correct, lambda d: 1 - ncfdtr(1, 1, 2 * d**2 / 3, 3), 0.0)
    return SignalDetection(found, _rate(correct) - 1 / 3, model="triangular (odd one of three)")


def _of_share(correct: Count, rising: Callable[[FloatArray], FloatArray], lowest: float) -> Interval:
    """Return the d', at least `lowest`, that gives a share of correct answers, with exact bounds."""
    share = clopper_pearson(*correct)
    rates = np.array([_corrected(*correct), share.low, share.high])
    ends = np.full(rates.shape, lowest), np.full(rates.shape, _FARTHEST)
    estimate, low, high = _inverted(rising, rates, *ends).tolist()
    return Interval(estimate, low, high, correct[1])


def share_correct(d_prime: ArrayLike, m: int) -> FloatArray:
    """Return the share of correct answers of an unbiased observer of m alternatives [1].

    Parameters
    ----------
    d_prime : float or array
        Sensitivity d'.
    m : int
        Alternatives.
    """
    if m == 2:
        return np.asarray(ndtr(np.asarray(d_prime) / np.sqrt(2)))
    nodes, weights = _nodes()
    felt = np.asarray(d_prime, dtype=float)[..., np.newaxis] + nodes
    return np.asarray((weights * ndtr(felt) ** (m - 1)).sum(axis=-1) / np.sqrt(2 * np.pi))


@lru_cache(maxsize=1)
def _nodes() -> tuple[FloatArray, FloatArray]:
    """Return the 80 nodes and weights of an integral over the normal distribution, accurate to 1e-9."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    return nodes, weights


def same_different(differing: Count, alike: Count) -> SignalDetection:
    """Return d' and criterion of the differencing model: "different" if two percepts are farther apart than k.

    If equal stimuli are called different more often than differing ones, d' is negative, so that it is unbiased if
    nothing is discriminated.

    Parameters
    ----------
    differing, alike : (int, int)
        Answers "different" in trials whose stimuli differ, and in those whose stimuli are the same.
    """
    return SignalDetection(
        _joint(_signed, differing, alike),
        _rate(differing) - _rate(alike),
        _joint(lambda hit, alarm: _criterion(alarm), differing, alike),
        "differencing (same or different)",
    )


def _criterion(alarm: FloatArray) -> FloatArray:
    return np.asarray(-np.sqrt(2) * ndtri(alarm / 2))


def _signed(hit: FloatArray, alarm: FloatArray) -> FloatArray:
    low, high = np.minimum(hit, alarm), np.maximum(hit, alarm)
    return np.where(hit < alarm, -1.0, 1.0) * _differencing(high, low)


def _differencing(hit: FloatArray, alarm: FloatArray) -> FloatArray:
    """Return the d' that gives the rate `hit` of "different" to differing stimuli; 0 if it is not above `alarm`."""
    hit, k = np.broadcast_arrays(hit, _criterion(alarm))
    known = np.where(np.isfinite(k), k, 0.0)
    root, far = np.sqrt(2), np.full(hit.shape, _FARTHEST)
    d = _inverted(lambda d: ndtr((d - known) / root) + ndtr((-d - known) / root), hit, np.zeros(hit.shape), far)
    return np.where(np.isfinite(k), d, np.where(hit > 0, np.inf, 0.0))


def _inverted(
    rising: Callable[[FloatArray], FloatArray], wanted: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return where an increasing function reaches some values, by bisection; infinite at a bound of `_FARTHEST`."""
    bottom, top = low, high
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        is_low = rising(middle) < wanted
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    # What bisection leaves of zero becomes zero.
    found = np.where((wanted >= 1) | (high == top), np.inf, np.where(np.abs(low) < 1e-6, 0.0, low))
    return np.where((low == bottom) & (bottom < 0), -np.inf, found)


def _rate(count: Count) -> float:
    return count[0] / count[1] if count[1] else math.nan


def _corrected(given: int, n: int) -> float:
    return (given + 0.5) / (n + 1)


def _joint(statistic: Statistic, first: Count, second: Count) -> Interval:
    """Return a statistic that is monotonic in each of two rates, and its bounds.

    At a bound each rate is at an exact limit of its own; squares of their normal quantiles add up to that of 97.5 %.
    """
    estimate = statistic(*(np.asarray(_corrected(*count)) for count in (first, second)))
    one, other = _limits(*first), _limits(*second)[:, ::-1]
    with np.errstate(invalid="ignore"):
        values = statistic(one[:, np.newaxis], other[np.newaxis])
    # Rounding errors about zero become zero, without a sign.
    best, low, high = (round(float(each), 12) + 0.0 for each in (estimate, np.nanmin(values), np.nanmax(values)))
    return Interval(best, low, high, first[1] + second[1])


_PARTS = 2 * ndtr(math.sqrt(2 * DROP) * np.sin(np.linspace(0, np.pi / 2, 61))) - 1
"""Confidence of a rate's limits at bounds of a statistic, from none to 95 %; closely spaced at both ends."""


@lru_cache(maxsize=4096)
def _limits(given: int, n: int) -> FloatArray:
    """Return the lowest and the highest rate that a count allows at each confidence of `_PARTS`, (2, 61) array."""
    share = clopper_pearson(given, n, _PARTS)
    return np.stack([share.low, share.high])
