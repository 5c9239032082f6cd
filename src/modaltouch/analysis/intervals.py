"""Confidence intervals of proportions and of unbounded means; for means of bounded scores, see `means`.

References
----------
Clopper and Pearson, Biometrika 26 (1934) 404-413.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

CONFIDENCE = 0.95
"""Default confidence level [1]."""

DROP, REGION = 1.920729, 2.995732
"""Half the 95 % quantiles of the chi-squared distribution with one and two degrees of freedom."""


@dataclass(frozen=True, eq=False)
class Interval:
    """An estimate with its confidence interval, or arrays of them.

    Attributes
    ----------
    estimate, low, high : float or array
        Estimate and bounds.
    n_effective : float or array
        Effective number of independent answers.
    """

    estimate: Any
    low: Any
    high: Any
    n_effective: Any

    @property
    def half_width(self) -> Any:
        """Half the distance between the bounds."""
        return (self.high - self.low) / 2

    def __getitem__(self, place: int | slice) -> Interval:
        return Interval(*(np.asarray(value)[place] for value in vars(self).values()))

    def changed(self, change: Callable[[Any], Any]) -> Interval:
        """Apply an increasing function to the estimate and the bounds."""
        return Interval(change(self.estimate), change(self.low), change(self.high), self.n_effective)

    @classmethod
    def point(cls, estimate: Any, n: Any) -> Interval:
        """Return an estimate without bounds."""
        nothing = np.full(np.shape(estimate), math.nan)[()]
        return cls(estimate, nothing, nothing, np.broadcast_to(n, np.shape(estimate))[()])


def clopper_pearson(successes: ArrayLike, n: ArrayLike, confidence: ArrayLike = CONFIDENCE) -> Interval:
    """Return the exact interval of a proportion; where n is zero, [0, 1] with NaN as the estimate.

    Parameters
    ----------
    successes, n : float or arrays
        Number of successes and trials; not necessarily whole, since both may be scaled by a design effect.
    confidence : float or array
        Confidence level [1].

    Raises
    ------
    ValueError
        If successes are negative or exceed n.

    Examples
    --------
    >>> interval = clopper_pearson(10, 10)
    >>> float(interval.low.round(4)), float(interval.high)
    (0.6915, 1.0)
    """
    from scipy.special import betaincinv

    k, m = np.broadcast_arrays(np.asarray(successes, dtype=float), np.asarray(n, dtype=float))
    if not ((k >= 0) & (k <= m)).all():
        raise ValueError(f"{successes!r} successes out of {n!r}: allowed: 0 to n")
    tail = (1 - np.asarray(confidence)) / 2
    low = np.where(k > 0, betaincinv(np.where(k > 0, k, 1), m - k + 1, tail), 0.0)
    high = np.where(k < m, betaincinv(k + 1, np.where(k < m, m - k, 1), 1 - tail), 1.0)
    share = np.divide(k, m, out=np.full(m.shape, math.nan), where=m > 0)
    return Interval(share[()], low[()], high[()], m[()])


def wilson(successes: float, n: float) -> Interval:
    """Return Wilson's score interval of a proportion, used for Monte Carlo shares.

    Parameters
    ----------
    successes, n : float
        Number of successes and trials, n > 0.
    """
    z2 = NormalDist().inv_cdf(1 - (1 - CONFIDENCE) / 2) ** 2
    p = successes / n
    centre = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = math.sqrt(z2 * (p * (1 - p) / n + z2 / (4 * n * n))) / (1 + z2 / n)
    return Interval(p, max(centre - half, 0.0), min(centre + half, 1.0), n)


def student_interval(values: FloatArray) -> Interval:
    """Return Student's t interval of a mean; unbounded if the values do not vary.

    Parameters
    ----------
    values : (n,) array
        One value per participant.
    """
    n = values.size
    if n < 2 or np.ptp(values) == 0:
        return Interval(float(values.mean()) if n else math.nan, math.nan, math.nan, n)
    mean, half = float(values.mean()), student_quantile(n - 1) * float(values.std(ddof=1)) / math.sqrt(n)
    return Interval(mean, mean - half, mean + half, n)


def student_quantile(degrees: int) -> float:
    """Return the half-width of a t interval in standard errors.

    Parameters
    ----------
    degrees : int
        Degrees of freedom.
    """
    from scipy.special import stdtrit

    return float(stdtrit(degrees, 1 - (1 - CONFIDENCE) / 2))


def matched_odds_ratio(only_first: int, only_second: int) -> Interval:
    """Return the conditional odds ratio of matched pairs, with the interval derived from the exact one of b / (b + c).

    Parameters
    ----------
    only_first, only_second : int
        Numbers b and c of discordant pairs, with a success only in the first or only in the second condition.

    Returns
    -------
    Interval
        [0, inf] with NaN as the estimate, if no pair is discordant.
    """
    share = clopper_pearson(only_first, only_first + only_second)
    return share.changed(lambda p: math.inf if p == 1 else p / (1 - p))
