"""Signal detection theory: sensitivity d' and criterion of one participant, with 95 % intervals.

Estimates use rates with the log-linear correction, (k + 0.5) / (n + 1), to be finite. Intervals use uncorrected counts
and exact limits of the rates, so their coverage is at least 95 %; a bound not determined by the answers is infinite.

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
from numpy.typing import ArrayLike
from scipy.special import ncfdtr, ndtr, ndtri

from modaltouch.analysis.intervals import DROP, Interval, clopper_pearson
from modaltouch.analysis.sums import FloatArray

Statistic = Callable[[FloatArray, FloatArray], FloatArray]
Count = tuple[int, int]
"""Count of an answer, and number of trials."""

_HALVINGS = 50
_FARTHEST = 40.0
"""Largest finite d'."""


@dataclass(frozen=True, eq=False)
class SignalDetection:
    """Sensitivity and criterion of one participant.

    Attributes
    ----------
    d_prime : Interval
        Sensitivity d', in standard deviations of the percept of one presentation.
    contrast : float
        Difference of the two rates, or of one rate and chance [1]. Unlike d', whose rates are biased by the correction
        if the numbers of trials differ, its expectation is zero without discrimination. NaN without trials of both
        kinds.
    criterion : Interval or None
        Criterion; 0 without response bias, and higher with fewer answers of the first kind. None if all answers are
        pooled.
    model : str
        Decision model.
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
        Answers "yes" in trials with and without the signal.

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
        Answers "first" in trials with the signal in the first and in the second interval.
    """
    found = yes_no(first, second)
    return replace(found, d_prime=found.d_prime.changed(lambda d_prime: d_prime / math.sqrt(2)), model="2AFC")


def m_intervals(correct: Count, m: int) -> SignalDetection:
    """Return d' of an unbiased observer of m alternatives, with the interval from that of the proportion correct.

    Parameters
    ----------
    correct : (int, int)
        Correct answers.
    m : int
        Number of alternatives, at least two.
    """
    found = _of_share(correct, lambda d: share_correct(d, m), -_FARTHEST)
    return SignalDetection(found, _rate(correct) - 1 / m, model=f"{m}AFC")


def odd_of_three(correct: Count) -> SignalDetection:
    """Return d' of the triangular method, in which the percept farthest from the other two is judged as odd.

    With percepts x, y of the equal stimuli and z of the odd one, u = (x - y) / sqrt(2) and v = (z - (x + y) / 2)
    sqrt(2 / 3) have unit variance. The answer is correct if v^2 / u^2 > 3; this ratio has a noncentral F distribution
    with 1 and 1 degrees of freedom and noncentrality 2 d'^2 / 3. d' is at least 0.

    Parameters
    ----------
    correct : (int, int)
        Correct answers.
    """
    found = _of_share(correct, lambda d: 1 - ncfdtr(1, 1, 2 * d**2 / 3, 3), 0.0)
    return SignalDetection(found, _rate(correct) - 1 / 3, model="triangular (odd one of three)")


def _of_share(correct: Count, rising: Callable[[FloatArray], FloatArray], lowest: float) -> Interval:
    """Return the d', at least `lowest`, for a proportion of correct answers, with exact bounds."""
    share = clopper_pearson(*correct)
    rates = np.array([_corrected(*correct), share.low, share.high])
    ends = np.full(rates.shape, lowest), np.full(rates.shape, _FARTHEST)
    estimate, low, high = _inverted(rising, rates, *ends).tolist()
    return Interval(estimate, low, high, correct[1])


def share_correct(d_prime: ArrayLike, m: int) -> FloatArray:
    """Return the proportion of correct answers of an unbiased observer of m alternatives [1].

    Parameters
    ----------
    d_prime : float or array
        Sensitivity d'.
    m : int
        Number of alternatives.
    """
    if m == 2:
        return np.asarray(ndtr(np.asarray(d_prime) / np.sqrt(2)))
    nodes, weights = _nodes()
    felt = np.asarray(d_prime, dtype=float)[..., np.newaxis] + nodes
    return np.asarray((weights * ndtr(felt) ** (m - 1)).sum(axis=-1) / np.sqrt(2 * np.pi))


@lru_cache(maxsize=1)
def _nodes() -> tuple[FloatArray, FloatArray]:
    """Return the 80 nodes and weights of Gauss-Hermite quadrature, accurate to 1e-9."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    return nodes, weights


def same_different(differing: Count, alike: Count) -> SignalDetection:
    """Return d' and criterion k of the differencing model: "different" if two percepts differ by more than k.

    If equal stimuli are called different more often than different stimuli, d' is negative, so that it is unbiased
    without discrimination.

    Parameters
    ----------
    differing, alike : (int, int)
        Answers "different" in trials with different and with equal stimuli.
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
    """Return the d' for a rate `hit` of answers "different" to different stimuli; 0 if not above `alarm`."""
    hit, k = np.broadcast_arrays(hit, _criterion(alarm))
    known = np.where(np.isfinite(k), k, 0.0)
    root, far = np.sqrt(2), np.full(hit.shape, _FARTHEST)
    d = _inverted(lambda d: ndtr((d - known) / root) + ndtr((-d - known) / root), hit, np.zeros(hit.shape), far)
    return np.where(np.isfinite(k), d, np.where(hit > 0, np.inf, 0.0))


def _inverted(
    rising: Callable[[FloatArray], FloatArray], wanted: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Invert an increasing function by bisection; infinite at a bound of `_FARTHEST`."""
    bottom, top = low, high
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        is_low = rising(middle) < wanted
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    # Round the bisection error at zero.
    found = np.where((wanted >= 1) | (high == top), np.inf, np.where(np.abs(low) < 1e-6, 0.0, low))
    return np.where((low == bottom) & (bottom < 0), -np.inf, found)


def _rate(count: Count) -> float:
    return count[0] / count[1] if count[1] else math.nan


def _corrected(given: int, n: int) -> float:
    return (given + 0.5) / (n + 1)


def _joint(statistic: Statistic, first: Count, second: Count) -> Interval:
    """Return a statistic that is monotonic in each of two rates, with its bounds.

    At a bound, both rates are at exact limits whose squared normal quantiles add up to that of 97.5 %.
    """
    estimate = statistic(*(np.asarray(_corrected(*count)) for count in (first, second)))
    one, other = _limits(*first), _limits(*second)[:, ::-1]
    with np.errstate(invalid="ignore"):
        values = statistic(one[:, np.newaxis], other[np.newaxis])
    # Round numerical noise to positive zero.
    best, low, high = (round(float(each), 12) + 0.0 for each in (estimate, np.nanmin(values), np.nanmax(values)))
    return Interval(best, low, high, first[1] + second[1])


_PARTS = 2 * ndtr(math.sqrt(2 * DROP) * np.sin(np.linspace(0, np.pi / 2, 61))) - 1
"""Confidence levels of the limits of a rate, from 0 to 95 %, closely spaced at both ends [1]."""


@lru_cache(maxsize=4096)
def _limits(given: int, n: int) -> FloatArray:
    """Return the lower and upper exact limits of a rate at each confidence level of `_PARTS`, (2, 61) array."""
    share = clopper_pearson(given, n, _PARTS)
    return np.stack([share.low, share.high])
