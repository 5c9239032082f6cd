"""Confidence intervals of proportions and means, and the tests that they invert.

For the mean of a bounded score, one participant at an end of the scale is added to the sample: at the low end for a
lower bound, at the high end for an upper bound. The distribution of the weighted mean, with weights uniform on the
simplex, gives p and the bound (Gaffke 2005). The method assumes only that scores are bounded, not a symmetric or other
shape of their distribution, so the bounds hold even if few participants show an effect. If all scores are at the two
ends of the scale, the bounds are those of Clopper and Pearson.

References
----------
Clopper and Pearson, Biometrika 26 (1934) 404-413.
Gaffke, "Three test statistics for a nonparametric one-sided hypothesis on the mean of a nonnegative variable",
Math. Methods Stat. 14 (2005) 451-467.
Learned-Miller and Thomas, "A new confidence interval for the mean of a bounded random variable", arXiv:1905.06208
(2019). Coverage is conjectured for all distributions, and proven for scores at the two ends of the scale.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.exact import ExactTest, sign_flip_test
from modaltouch.analysis.sums import FloatArray, IntArray

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


MOST_TIME_STEPS = 1_000_000
"""Maximum sum of times in steps for sign-flip tests, whose memory and run time grow with it."""


def time_steps(seconds: FloatArray) -> tuple[IntArray, float]:
    """Return times in milliseconds, or in longer steps if they sum to over `MOST_TIME_STEPS`; and steps per second.

    Rounding treats both signs alike, so sign-flip tests of the steps keep their level.
    """
    per_second = 1000 / max(1.0, 1000 * float(np.abs(seconds).sum()) / MOST_TIME_STEPS)
    return np.rint(seconds * per_second).astype(np.int64), per_second


def centre_interval(seconds: FloatArray) -> Interval:
    """Return the mean with the interval of centres not rejected by the sign-flip test, to a step of `time_steps`.

    Parameters
    ----------
    seconds : (n,) array
        One value per participant [s].

    References
    ----------
    Hartigan, J. Am. Stat. Assoc. 64 (1969) 1303-1317 (typical values).
    """
    values, per_second = time_steps(seconds)
    if 2.0 ** (1 - values.size) > 1 - CONFIDENCE:
        return Interval(float(seconds.mean()) if values.size else math.nan, -math.inf, math.inf, values.size)

    def lowest(values: IntArray) -> int:
        @cache
        def p(centre: int) -> float:
            return float(sign_flip_test(values - centre).p)

        centres = range(int(values.min()), int(np.rint(values.mean())))
        # The bound is usually within a step of that of the t interval, which is NaN if the values do not vary.
        near = range(centres.stop, centres.stop)
        if math.isfinite(bound := student_interval(values.astype(float)).low):
            near = range(max(math.floor(bound) - 1, centres.start), min(math.floor(bound) + 3, centres.stop))
        if len(near) > 1 and p(near[0]) <= 1 - CONFIDENCE < p(near[-1]):
            centres = near
        return centres.start + bisect_right(centres, 1 - CONFIDENCE, key=p)

    mean = float(seconds.mean())
    low, high = lowest(values) / per_second, -lowest(-values) / per_second
    return Interval(mean, min(low, mean), max(high, mean), values.size)


def student_quantile(degrees: int) -> float:
    """Return the half-width of a t interval in standard errors.

    Parameters
    ----------
    degrees : int
        Degrees of freedom.
    """
    from scipy.special import stdtrit

    return float(stdtrit(degrees, 1 - (1 - CONFIDENCE) / 2))


MOST_DROPPED = 250
"""Maximum number of participants for the B-spline recursion, with a cost quadratic in their number."""

# Maximum number of iterations for a bound; about eight are needed.
_MOST_STEPS = 60


class BoundedMean:
    """Mean of a bounded score over participants, for one experiment or a batch.

    Parameters
    ----------
    scores : (..., n_participants) array
        Scores between `low` and `high`; NaN are ignored.
    low, high : float
        Ends of the scale.

    Examples
    --------
    >>> interval = BoundedMean([0] * 10).interval()
    >>> float(interval.low.round(4)), float(interval.high.round(4))  # 1 - 0.025^(1/10)
    (-0.3085, 0.3085)
    """

    def __init__(self, scores: ArrayLike, low: float = -1.0, high: float = 1.0) -> None:
        values = np.clip(np.asarray(scores, dtype=float), low, high)
        self.low, self.high, self.shape = low, high, values.shape[:-1]
        # NaN sort to the end.
        self._rows = np.sort(values.reshape(math.prod(self.shape), values.shape[-1]), axis=-1)
        self._n = np.isfinite(self._rows).sum(axis=-1)

    @property
    def n(self) -> IntArray:
        """Number of participants with a score, for each test."""
        return np.asarray(self._n.reshape(self.shape)[()])

    @property
    def estimate(self) -> FloatArray:
        """Mean score; NaN without scores."""
        total = np.nansum(self._rows, axis=-1)
        mean = np.divide(total, self._n, out=np.full(total.shape, math.nan), where=self._n > 0)
        return np.asarray(np.clip(mean, self.low, self.high).reshape(self.shape)[()])

    def p_above(self, mean: ArrayLike) -> FloatArray:
        """Return the one-sided p of the null hypothesis that the mean is at most a value [1]."""
        values = np.broadcast_to(np.asarray(mean, dtype=float), self.shape).reshape(-1)
        p = np.ones(len(self._rows))
        for n in np.unique(self._n).tolist():
            here = self._n == n
            p[here] = _weighted_tail(self._rows[here, :n], self.low, values[here])
        return np.asarray(p.reshape(self.shape)[()])

    def p_below(self, mean: ArrayLike) -> FloatArray:
        """Return the one-sided p of the null hypothesis that the mean is at least a value [1]."""
        return self.mirrored.p_above(-np.asarray(mean, dtype=float))

    @property
    def mirrored(self) -> BoundedMean:
        """Mean of the scores with the opposite sign."""
        return BoundedMean(-self._rows.reshape(*self.shape, -1), -self.high, -self.low)

    def test(self, mean: ArrayLike = 0.0) -> ExactTest:
        """Return the two-sided test of a mean, with twice the smaller one-sided p."""
        reach = (np.asarray(mean, dtype=float) - self.low) / (self.high - self.low)
        least = 2 * np.minimum(reach, 1 - reach) ** self.n
        both = np.minimum(1.0, 2 * np.minimum(self.p_above(mean), self.p_below(mean)))
        return ExactTest(self.estimate - np.asarray(mean), both, np.minimum(1.0, least), self.n)

    def equivalence(self, margin: float) -> ExactTest:
        """Return the equivalence test of a mean within a margin of zero, by two one-sided tests with the larger p.

        References
        ----------
        Schuirmann, J. Pharmacokin. Biopharm. 15 (1987) 657-680.
        """
        p = np.maximum(self.p_above(-margin), self.p_below(margin))
        alike = BoundedMean(np.zeros(self._rows.shape[-1:]), self.low, self.high)
        least = alike.p_above(-margin) if self._rows.shape[-1] else 1.0
        return ExactTest(self.estimate, p, np.minimum(least, p), self.n)

    def interval(self, confidence: float = CONFIDENCE) -> Interval:
        """Return the interval of means not rejected by the two-sided test at level 1 - confidence."""
        tail, other = (1 - confidence) / 2, self.mirrored
        return Interval(self.estimate, self._bound(tail), -other._bound(tail), self.n)

    def _bound(self, tail: float) -> FloatArray:
        """Return the lowest mean not rejected by the one-sided test, for each test."""
        # The n-th root of p is nearly linear in the mean, so the Illinois method (regula falsi) converges fast.
        power = 1 / np.maximum(self.n, 1)
        low, high = np.full(self.shape, self.low), np.where(self.n > 0, self.estimate, self.low)
        below, above = -(tail**power), self.p_above(high) ** power - tail**power
        bound, was_low = low, None
        for _ in range(_MOST_STEPS):
            before, bound = bound, np.where(high > low, high - above * (high - low) / (above - below), low)
            found = self.p_above(bound) ** power - tail**power
            is_low = found < 0
            low, high = np.where(is_low, bound, low), np.where(is_low, high, bound)
            # Illinois step: halve the value at an end retained twice in a row.
            half = 1.0 if was_low is None else np.where(is_low == was_low, 0.5, 1.0)
            below, above = np.where(is_low, found, half * below), np.where(is_low, half * above, found)
            was_low = is_low
            if not (np.abs(bound - before) > 1e-13).any():
                break
        return np.asarray(bound[()])


def _weighted_tail(rows: FloatArray, low: float, values: FloatArray) -> FloatArray:
    """Return the probability that a randomly weighted mean of the scores and `low` is at most a value.

    Computed by the recursion of integrated B-splines (de Boor 1972), whose terms are all positive; for many
    participants, by inversion of the characteristic function.

    Parameters
    ----------
    rows : (n_tests, n_participants) array
        Scores in increasing order.
    low : float
        Score of the added participant.
    values : (n_tests,) array
        Values of the mean.
    """
    if rows.shape[-1] > MOST_DROPPED:
        chance, is_small = _inverted(rows, low, values)
        if is_small.any():
            chance[is_small] = _dropped(rows[is_small], low, values[is_small])
        return chance
    return _dropped(rows, low, values)


def _inverted(rows: FloatArray, low: float, values: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Compute `_weighted_tail` by inverting the characteristic function, and flag values not accurate to 1e-13.

    The weighted mean is at most a value if the sum of the scores minus that value, each times an independent
    exponential variate, is at most zero. Equal scores are pooled, so the cost hardly grows with the number of
    participants.

    References
    ----------
    Davies, Biometrika 60 (1973) 415-417.
    """
    distinct, places = np.unique(rows, return_inverse=True)
    counts = np.zeros((len(rows), distinct.size))
    np.add.at(counts, (np.arange(len(rows))[:, None], places.reshape(rows.shape)), 1.0)
    above = np.concatenate([np.full(1, low), distinct]) - values[:, None]
    counts = np.concatenate([np.ones((len(rows), 1)), counts], axis=1)
    spread = np.sqrt((counts * above**2).sum(axis=1))[:, None, None]
    angle = np.arange(0.5, 60.0) * 0.2
    scaled = angle[:, None] * np.divide(above[:, None], spread, out=np.zeros_like(above[:, None]), where=spread > 0)
    size = np.exp(-0.5 * np.einsum("tkj,tj->tk", np.log1p(scaled**2), counts))
    turn = np.einsum("tkj,tj->tk", np.arctan(scaled), counts)
    chance = 0.5 - (size * np.sin(turn) / angle).sum(axis=1) * 0.2 / math.pi
    # A step of 0.2 resolves sums only within 2 pi / 0.2 = 31 times their spread.
    drift = np.abs((counts * above).sum(axis=1))
    is_small = (size[:, -1] > 1e-14) | (chance < 1e-9) | (drift > 20 * spread[:, 0, 0])
    return np.asarray(np.clip(chance, 0.0, 1.0)), np.asarray(is_small)


def _dropped(rows: FloatArray, low: float, values: FloatArray) -> FloatArray:
    """Compute `_weighted_tail` by the recursion of integrated B-splines, which drops one score at a time."""
    knots = np.concatenate([np.full((len(rows), 1), low), rows], axis=-1)
    at = values[:, np.newaxis]
    chance = (knots <= at).astype(float)
    for dropped in range(1, knots.shape[-1]):
        least, most = knots[:, :-dropped], knots[:, dropped:]
        share = np.divide(most - at, most - least, out=np.zeros(least.shape), where=most > least)
        share = np.clip(share, 0.0, 1.0)  # outside [0, 1] both terms are equal; avoid amplifying rounding errors
        chance = share * chance[:, 1:] + (1 - share) * chance[:, :-1]
    return np.asarray(chance[:, 0])
