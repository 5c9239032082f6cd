"""Intervals for proportions and their paired differences that hold when every answer is the same.

References
----------
Clopper and Pearson, Biometrika 26 (1934) 404-413.
Korn and Graubard, Survey Methodology 24 (1998) 193-201.
Tango, Statistics in Medicine 17 (1998) 891-908.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

CONFIDENCE = 0.95
"""Confidence of every interval in the analysis."""


@dataclass(frozen=True)
class Interval:
    """An estimate with its confidence interval.

    Attributes
    ----------
    estimate, low, high : float
        Estimate and bounds.
    n_effective : float
        Independent answers the interval is worth.
    """

    estimate: float
    low: float
    high: float
    n_effective: float


def clopper_pearson(successes: float, n: float, confidence: float = CONFIDENCE) -> Interval:
    """Return the exact interval of a proportion; 0 to 1 about NaN where n is zero.

    Parameters
    ----------
    successes, n : float
        Successes out of n; need not be whole, as a design effect may have scaled both.
    confidence : float
        Confidence of the interval [1].

    Raises
    ------
    ValueError
        If there are more successes than n, or fewer than none.

    Examples
    --------
    >>> round(clopper_pearson(10, 10).low, 4), clopper_pearson(10, 10).high
    (0.6915, 1.0)
    """
    from scipy.special import betaincinv

    if not 0 <= successes <= n:
        raise ValueError(f"{successes} successes out of {n}: allowed are 0 to n")
    if n == 0:
        return Interval(math.nan, 0.0, 1.0, 0.0)
    tail = (1 - confidence) / 2
    low = float(betaincinv(successes, n - successes + 1, tail)) if successes > 0 else 0.0
    high = float(betaincinv(successes + 1, n - successes, 1 - tail)) if successes < n else 1.0
    return Interval(successes / n, low, high, n)


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
    successes : (n_participants,) array
        How many of each participant's answers count.
    n_answers : int
        Answers per participant.
    """
    counts = np.asarray(successes, dtype=float)
    n, total = counts.size, float(counts.size * n_answers)
    p = float(counts.sum() / total)
    between = float(np.var(counts / n_answers, ddof=1)) / n if n > 1 else math.inf
    effective = float(n) if p in (0.0, 1.0) else min(max(p * (1 - p) / between if between > 0 else total, n), total)
    inner = clopper_pearson(p * effective, effective)
    return Interval(p, inner.low, inner.high, effective)


def tango(only_first: float, only_second: float, n: float, confidence: float = CONFIDENCE) -> Interval:
    """Return the score interval of a difference of paired proportions.

    Parameters
    ----------
    only_first, only_second : float
        Pairs that succeeded only the first way, and only the second way; need not be whole.
    n : float
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
    >>> round(tango(0, 0, 10).high, 3)
    0.278
    """
    if not (only_first >= 0 and only_second >= 0 and 0 < n >= only_first + only_second - 1e-9):
        raise ValueError(f"{only_first} + {only_second} discordant pairs of {n}: they cannot be more than all")
    z = _normal_quantile(confidence)
    difference = (only_first - only_second) / n
    low = -1.0 if difference <= -1 else _tango_bound(only_first, only_second, n, z, -1.0)
    high = 1.0 if difference >= 1 else _tango_bound(only_first, only_second, n, z, 1.0)
    return Interval(difference, low, high, n)


def _tango_bound(b: float, c: float, n: float, z: float, end: float) -> float:
    """Return where the score statistic reaches z, between the estimate and an end, by bisection."""
    inside, outside = (b - c) / n, end
    for _ in range(80):
        middle = (inside + outside) / 2
        q = _restricted_discordance(b, c, n, middle)
        spread = n * max(2 * q + middle * (1 - middle), 0.0)
        if abs(b - c - n * middle) > z * math.sqrt(spread):
            outside = middle
        else:
            inside = middle
    return (inside + outside) / 2


def _restricted_discordance(b: float, c: float, n: float, difference: float) -> float:
    """Return the likeliest probability of a pair of the second kind, given the difference (Tango, eq. 10)."""
    linear = -b - c + (2 * n - b + c) * difference
    constant = -c * difference * (1 - difference)
    return (math.sqrt(max(linear * linear - 8 * n * constant, 0.0)) - linear) / (4 * n)


def clustered_difference(first: ArrayLike, second: ArrayLike, n_answers: int) -> Interval:
    """Return the interval of a share less another, paired, when each participant gave several answers.

    Tango's interval at the effective number of answers, found as in `korn_graubard`: the design effect is held
    between 1 and the answers per participant, and is the latter where nothing varies.

    Parameters
    ----------
    first, second : (n_participants,) array
        How many of each participant's answers (or pairs of answers) count only for the first, and only for the
        second.
    n_answers : int
        Answers, or pairs of answers, per participant.
    """
    b, c = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    n, total = b.size, float(b.size * n_answers)
    difference = float((b.sum() - c.sum()) / total)
    single = float((b.sum() + c.sum()) / total) - difference**2
    between = float(np.var((b - c) / n_answers, ddof=1)) / n if n > 1 else math.inf
    worth = single / between if between > 0 else total
    effective = float(n) if single <= 1e-12 else min(max(worth, n), total)
    share = effective / total
    return tango(float(b.sum()) * share, float(c.sum()) * share, effective)


def paired_mean(scores: ArrayLike, scale: float) -> Interval:
    """Return a never degenerate interval for the mean of score / scale, one bounded score per participant.

    A score of `scale` counts as a whole pair discordant one way, half of it as half a pair; this overstates the
    spread of fractional scores, so the interval is conservative. Where all scores are zero it is Tango's.

    Parameters
    ----------
    scores : (n_participants,) array
        Scores between -scale and scale.
    scale : float
        Largest size a score can have.
    """
    shares = np.asarray(scores, dtype=float) / scale
    positive, negative = float(shares[shares > 0].sum()), float(-shares[shares < 0].sum())
    return tango(positive, negative, float(shares.size))


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
    from statistics import NormalDist

    return NormalDist().inv_cdf(1 - (1 - confidence) / 2)
