"""Sensitivity d' and criterion of one participant, by the theory of signal detection, with 95 % intervals.

Estimates are of rates with the log-linear correction, (k + 0.5) / (n + 1), so that they are finite. Intervals are of
the counts themselves: by profile likelihood where two rates tell, exact where one does; a bound is infinite where the
answers set none.

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
from scipy.special import ncfdtr, ndtr, ndtri, xlog1py, xlogy

from modaltouch.analysis.intervals import Interval, clopper_pearson

FloatArray = NDArray[np.float64]
Statistic = Callable[[FloatArray, FloatArray], FloatArray]
Count = tuple[int, int]
"""How often an answer was given, of how many."""

DROP = 1.920729
"""Half the 95 % point of chi-squared with one degree of freedom."""

_HALVINGS = 50
_FARTHEST = 40.0
"""Largest d' that is told from an infinite one."""


@dataclass(frozen=True, eq=False)
class SignalDetection:
    """Signal detection of one participant from two kinds of trial.

    Attributes
    ----------
    d_prime : Interval
        SignalDetection, in standard deviations of what is felt at one presentation.
    contrast : float
        Difference of the two rates, or of one and its chance [1]: unlike d', whose correction pulls the rate of fewer
        trials farther, its expectation is zero where nothing is told apart. Not a number without trials of both.
    criterion : Interval or None
        Criterion; 0 where no answer is preferred, above 0 the fewer answers of the first kind. None where all answers
        count together.
    model : str
        Model of the decision that it rests on.
    """

    d_prime: Interval
    contrast: float
    criterion: Interval | None = None
    model: str = "yes-no"


def yes_no(signal: Count, noise: Count) -> SignalDetection:
    """Return d' = z(H) - z(F) and c = -(z(H) + z(F)) / 2 of hits and false alarms.

    Parameters
    ----------
    signal, noise : (int, int)
        "Yes" among the trials with the signal, and among those without it.

    Examples
    --------
    >>> found = yes_no((40, 40), (0, 38))
    >>> round(found.d_prime.estimate, 3), found.d_prime.high
    (4.483, inf)
    """
    return SignalDetection(
        _profile(lambda hit, alarm: ndtri(hit) - ndtri(alarm), signal, noise),
        _rate(signal) - _rate(noise),
        _profile(lambda hit, alarm: -(ndtri(hit) + ndtri(alarm)) / 2, signal, noise),
    )


def two_intervals(first: Count, second: Count) -> SignalDetection:
    """Return d' = (z(H) - z(F)) / sqrt 2 and c of two alternatives in time or space.

    Parameters
    ----------
    first, second : (int, int)
        "First" among the trials with the signal in the first interval, and among those with it in the second.
    """
    found = yes_no(first, second)
    return replace(found, d_prime=found.d_prime.changed(lambda d_prime: d_prime / math.sqrt(2)), model="2AFC")


def m_intervals(correct: Count, m: int) -> SignalDetection:
    """Return d' of an observer who prefers none of m alternatives; its interval is that of the share, exact.

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

    Their distances are those of F with one and one degrees of freedom: it is the odd one that lies more than
    sqrt 3 times as far from the mean of the others, in its standard deviations, as they lie apart. No d' is below 0.

    Parameters
    ----------
    correct : (int, int)
        Correct answers.
    """
    found = _of_share(correct, lambda d: 1 - ncfdtr(1, 1, 2 * d**2 / 3, 3), 0.0)
    return SignalDetection(found, _rate(correct) - 1 / 3, model="triangular (odd one of three)")


def _of_share(correct: Count, rising: Callable[[FloatArray], FloatArray], lowest: float) -> Interval:
    """Return the d', from the lowest on, at which a share of correct answers is the given one, exact bounds with it."""
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
        SignalDetection.
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
    """Return where and how much an integral over the normal law is read: of 80 nodes, good to 1e-9."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    return nodes, weights


def same_different(differing: Count, alike: Count) -> SignalDetection:
    """Return d' and criterion of the differencing model: "different" where two percepts are farther apart than k.

    Where the same are called different more often than the differing, d' is told as negative, so that it has no bias
    where nothing is told apart.

    Parameters
    ----------
    differing, alike : (int, int)
        "Different" among the trials whose stimuli differ, and among those whose stimuli are the same.
    """
    return SignalDetection(
        _profile(_signed, differing, alike),
        _rate(differing) - _rate(alike),
        _profile(lambda hit, alarm: _criterion(alarm), differing, alike),
        "differencing (same or different)",
    )


def _criterion(alarm: FloatArray) -> FloatArray:
    return np.asarray(-np.sqrt(2) * ndtri(alarm / 2))


def _signed(hit: FloatArray, alarm: FloatArray) -> FloatArray:
    low, high = np.minimum(hit, alarm), np.maximum(hit, alarm)
    return np.where(hit < alarm, -1.0, 1.0) * _differencing(high, low)


def _differencing(hit: FloatArray, alarm: FloatArray) -> FloatArray:
    """Return the d' at which differing stimuli are called different as often as they were; 0 where no more often."""
    hit, k = np.broadcast_arrays(hit, _criterion(alarm))
    known = np.where(np.isfinite(k), k, 0.0)
    root, far = np.sqrt(2), np.full(hit.shape, _FARTHEST)
    d = _inverted(lambda d: ndtr((d - known) / root) + ndtr((-d - known) / root), hit, np.zeros(hit.shape), far)
    return np.where(np.isfinite(k), d, np.where(hit > 0, np.inf, 0.0))


def _inverted(
    rising: Callable[[FloatArray], FloatArray], wanted: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return where a rising function reaches some values, its ends included; infinite beyond a bound of `_FARTHEST`."""
    bottom, top = low, high
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        is_low = rising(middle) < wanted
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    # What halving leaves of zero is none.
    found = np.where((wanted >= 1) | (high == top), np.inf, np.where(np.abs(low) < 1e-6, 0.0, low))
    return np.where((low == bottom) & (bottom < 0), -np.inf, found)


def _rate(count: Count) -> float:
    return count[0] / count[1] if count[1] else math.nan


def _corrected(given: int, n: int) -> float:
    return (given + 0.5) / (n + 1)


def _profile(statistic: Statistic, first: Count, second: Count) -> Interval:
    """Return a statistic of two rates, and its ends where their likelihood together has fallen by `DROP`."""
    estimate = statistic(*(np.asarray(_corrected(*count)) for count in (first, second)))
    # At an end, one rate takes a part of the drop and the other the rest.
    one, other = _rates(*first), _rates(*second)[:, ::-1]
    with np.errstate(invalid="ignore"):
        values = statistic(one[:, np.newaxis], other[np.newaxis])
    # What rounding leaves of zero is none, and has no sign.
    best, low, high = (round(float(each), 12) + 0.0 for each in (estimate, np.nanmin(values), np.nanmax(values)))
    return Interval(best, low, high, first[1] + second[1])


@lru_cache(maxsize=4096)
def _rates(given: int, n: int) -> FloatArray:
    """Return the lowest and highest rates whose log likelihood is, at most, each part of `DROP` below the best.

    Returns
    -------
    (2, 61) array
        The parts rise from none to all of it.
    """
    drop = DROP * np.sin(np.linspace(0, np.pi / 2, 61)) ** 2  # fine at both ends
    if n == 0:
        return np.stack([np.zeros(drop.shape), np.ones(drop.shape)])
    share = given / n
    most = xlogy(given, share) + xlog1py(n - given, -share)

    def fallen(rate: FloatArray) -> FloatArray:
        return np.asarray(most - xlogy(given, rate) - xlog1py(n - given, -rate))

    ends = []
    for end in (0.0, 1.0):
        inside, outside = np.full(drop.shape, share), np.full(drop.shape, end)
        for _ in range(_HALVINGS):
            middle = (inside + outside) / 2
            is_in = fallen(middle) <= drop
            inside, outside = np.where(is_in, middle, inside), np.where(is_in, outside, middle)
        ends.append(inside if share != end else outside)
    return np.stack(ends)
