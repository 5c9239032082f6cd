"""Exact tests for small samples: multinomial, sign-flip, sign and trend tests, singly or in batches.

The cost grows with the range of the scores, not with 2^N. Scores are integers, so ties are exact. Every test also
reports the smallest attainable p.

References
----------
Fisher, "The Design of Experiments" (1935), section 21 (sign flips); Pitman, J. R. Stat. Soc. Suppl. 4 (1937) 119-130
and 225-232 (randomisation); Engels, "XNomial" (exact multinomial test); Armitage, Biometrics 11 (1955) 375-386 (linear
trend in proportions).
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.analysis.sums import LEAST_P, FloatArray, IntArray, Law, Sums, distinct_rows

# Maximum number of participants for which p is rounded to its exact steps.
_EXACT_UP_TO = 40


class ExactTest:
    """A two-sided exact test, or a batch of tests with arrays as attributes.

    Parameters
    ----------
    statistic : float or array
        Value of the test statistic.
    p, p_min : float or array, or callable
        The attributes, or functions to compute them on first access.
    n_informative : int or array
        Number of participants (in the multinomial test, answers) that can affect the statistic.
    quick_p : callable, optional
        Function to compute the attribute on first access.
    """

    def __init__(
        self, statistic: Any, p: Any, p_min: Any, n_informative: Any, quick_p: Callable[[], Any] | None = None
    ) -> None:
        self.statistic, self.n_informative = statistic, n_informative
        self._p, self._p_min, self._quick_p = p, p_min, quick_p

    @cached_property
    def p(self) -> Any:
        """Probability of a statistic at least as extreme, under the null hypothesis [1]."""
        return _bounded(self._p)

    @cached_property
    def p_min(self) -> Any:
        """Smallest attainable p, over all possible outcomes [1]."""
        return _bounded(self._p_min)

    @cached_property
    def quick_p(self) -> Any:
        """Fast approximation of `p` to within 1e-13, for thousands of tests [1]."""
        return self.p if self._quick_p is None else _bounded(self._quick_p)

    def __getitem__(self, place: int) -> ExactTest:
        """Return one test of a batch."""
        values = (self.statistic, self.p, self.p_min, self.n_informative)
        return ExactTest(*(np.asarray(value)[place] for value in values))


def _bounded(value: Any) -> Any:
    # p is never zero: values that underflow become the smallest normal float.
    return np.clip(value() if callable(value) else value, sys.float_info.min, 1.0)


def _sum_test(sums: Sums, observed: ArrayLike) -> ExactTest:
    """Return tests whose statistic is an observed sum minus its expectation under the null hypothesis."""
    values = np.asarray(observed)
    centred = values.reshape(-1) * sums.scale - sums.mean
    distance, shape = np.abs(centred), values.shape
    return ExactTest(
        (centred / sums.scale).reshape(shape)[()],
        lambda: sums.tails(distance).reshape(shape),
        lambda: sums.tails(sums.farthest).reshape(shape),
        sums.counts.sum(axis=1).reshape(shape)[()],
        lambda: sums.quick_tails(distance).reshape(shape),
    )


def _count_each(places: IntArray, n_kinds: int) -> IntArray:
    """Count the participants of each kind, test by test, (n_tests, n_kinds) array; those of kind -1 are left out."""
    rows = places.reshape(math.prod(places.shape[:-1]), places.shape[-1])
    counts = np.zeros((len(rows), n_kinds + 1), dtype=np.int64)
    np.add.at(counts, (np.arange(len(rows))[:, np.newaxis], rows), 1)
    return counts[:, :-1]


def sign_flip_test(scores: ArrayLike) -> ExactTest:
    """Exact sign-flip test of symmetry about zero; the statistic is the sum of the scores.

    Under the null hypothesis, both signs of each participant's score are equally likely.

    Parameters
    ----------
    scores : (..., n_participants) array of int
        One net score per participant.

    Examples
    --------
    >>> bool(sign_flip_test([4] * 10).p == 2 / 2**10)
    True
    """
    values = _whole_numbers(scores, "scores")
    kinds, places = np.unique(np.append(np.abs(values), 0), return_inverse=True)
    coin = np.array([0.5, 0.5])
    laws = [(np.array([-size, size]), coin) for size in kinds[1:]]
    counts = _count_each(places[:-1].reshape(values.shape) - 1, len(laws))
    sums = Sums(laws, np.zeros(len(laws), dtype=np.int64), 1, counts)
    test = _sum_test(sums, values.sum(axis=-1))
    return ExactTest(test.statistic, lambda: test.p, lambda: test.p_min, test.n_informative, lambda: _stepped(test))


def _stepped(test: ExactTest) -> FloatArray:
    """Return `quick_p` of sign flips, for few participants rounded to a multiple of 2^-n."""
    n = np.asarray(test.n_informative)
    steps = 2.0 ** np.minimum(n, _EXACT_UP_TO)
    p = np.where(n <= _EXACT_UP_TO, np.rint(test.quick_p * steps) / steps, test.quick_p)
    return np.asarray(np.maximum(p, np.maximum(2.0 ** (1.0 - np.maximum(n, 1)), LEAST_P)))


def sign_test(scores: ArrayLike) -> ExactTest:
    """Exact sign test; the statistic is the number of positive scores, excluding zeros.

    Parameters
    ----------
    scores : (..., n_participants) array of int
        One net score per participant.
    """
    values = _whole_numbers(scores, "scores")
    test = sign_flip_test(np.sign(values))
    n_positive = (values > 0).sum(axis=-1)
    return ExactTest(n_positive, lambda: test.p, lambda: test.p_min, test.n_informative, lambda: test.quick_p)


def multinomial_test(counts: ArrayLike) -> ExactTest:
    """Exact multinomial test of equal probabilities of all categories.

    The statistic is twice the log likelihood ratio. All possible outcomes are enumerated, those equivalent under the
    null hypothesis only once.

    Parameters
    ----------
    counts : (..., n_categories) array of int
        Observed counts.

    Raises
    ------
    ValueError
        If counts are negative, or there are fewer than two categories.

    Examples
    --------
    >>> float(multinomial_test([10, 0, 0]).p.round(8))  # three such outcomes, each with probability (1/3)^10
    5.081e-05
    """
    observed = _whole_numbers(counts, "counts")
    if observed.ndim < 1 or observed.shape[-1] < 2 or observed.size == 0:
        raise ValueError(f"counts have shape {observed.shape}: give (..., n_categories), two categories or more")
    if observed.min() < 0:
        raise ValueError(f"counts must not be negative, got {observed.tolist()}")
    k = observed.shape[-1]
    rows = observed.reshape(-1, k)
    totals = rows.sum(axis=1)
    statistic, p, p_min = np.zeros(len(rows)), np.ones(len(rows)), np.ones(len(rows))
    for n in np.unique(totals[totals > 0]).tolist():
        here, shares = totals == n, _shares(n, k)
        statistic[here] = shares[rows[here]].sum(axis=1)
        # The statistic is convex in the counts, so the most extreme outcome has all answers in one category.
        extremes = np.append(statistic[here], shares[n])
        least = extremes - 1e-9 * np.maximum(1.0, np.abs(extremes))  # tolerance for rounding
        if math.comb(n + k - 1, n) <= _KEPT:
            values, tails = _ranked_outcomes(n, k)
            chances = tails[np.searchsorted(values, least)]
        else:
            chances = sum((value >= least[:, np.newaxis]) @ mass for value, mass in _weighed_outcomes(n, k))
        p[here], p_min[here] = chances[:-1], chances[-1]
    found: list[Any] = [each.reshape(observed.shape[:-1])[()] for each in (statistic, p, p_min, totals)]
    return ExactTest(*found)


# Maximum number of outcomes to cache for further simulated experiments; 2,000 answers in three categories have 2e6.
_KEPT = 10_000


@lru_cache(maxsize=1024)
def _ranked_outcomes(n: int, k: int) -> tuple[FloatArray, FloatArray]:
    """Return the statistics of all outcomes in increasing order, and the probability of at least as large a value."""
    value, mass = (np.concatenate(each) for each in zip(*_weighed_outcomes(n, k), strict=True))
    order = np.argsort(value)
    return value[order], np.cumsum(mass[order][::-1])[::-1]


def _weighed_outcomes(n: int, k: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the statistics and probabilities of outcomes, grouped by the counts of all but the last two categories.

    Groups that differ only in the order of these counts are merged.
    """
    log_factorial = np.concatenate([[0.0], np.cumsum(np.log(np.arange(1, n + 1)))])
    shares, whole = _shares(n, k), log_factorial[n] - n * math.log(k)
    for head in _heads(n, k - 2, n):
        orders = math.factorial(k - 2) // math.prod(map(math.factorial, Counter(head).values()))
        tail, at_head = np.arange(n - sum(head) + 1), list(head)
        ways = log_factorial[tail] + log_factorial[tail[::-1]] + log_factorial[at_head].sum()
        yield shares[tail] + shares[tail[::-1]] + shares[at_head].sum(), orders * np.exp(whole - ways)


def _shares(n: int, k: int) -> FloatArray:
    """Return the contribution to the statistic of a category's count, for counts from 0 to n."""
    x = np.arange(n + 1)
    return np.asarray(2 * x * np.log(np.maximum(x, 1) * k / n), dtype=float)


def _heads(n: int, length: int, most: int) -> Iterator[tuple[int, ...]]:
    """Yield non-increasing counts with a sum of at most n and a first count of at most `most`."""
    if length == 0:
        yield ()
        return
    for first in range(min(n, most) + 1):
        for rest in _heads(n - first, length - 1, first):
            yield first, *rest


def _whole_numbers(values: ArrayLike, name: str) -> IntArray:
    """Convert whole numbers of any dtype to integers; `name` is theirs in the error message."""
    array = np.asarray(values)
    if array.dtype.kind not in "iub" and not np.array_equal(array, np.rint(array)):
        raise ValueError(f"{name} must be whole numbers, so that ties are exact; got {array.ravel()[:5].tolist()}")
    return array.astype(np.int64, copy=False)


GRID_STEPS = 1000
"""Maximum number of steps of the common grid of levels; levels without such a grid are rounded to this many steps."""

MOST_EXACT = 400
"""Maximum number of answers per participant for the exact test; for more, p is from a normal approximation, accurate to
4 % above 1e-6."""

_RAREST = 4


def trend_test(chosen: ArrayLike, levels: Sequence[float], n_repetitions: ArrayLike = 1) -> ExactTest:
    """Exact test of a trend over levels by permutation of the answers within each participant.

    Under the null hypothesis, a participant's answers do not depend on the level, so all assignments of the answers to
    the presentations are equally likely. Participants with identical answers do not contribute.

    Parameters
    ----------
    chosen : (..., n_participants, n_levels) array of int
        Counts of the answer at each level.
    levels : sequence of float
        Levels, the scores of the trend; only their relative distances matter.
    n_repetitions : int, or array of int like `chosen`
        Number of all answers at each level.

    Returns
    -------
    ExactTest
        The statistic is the sum over participants of score times count, minus its expectation, in units of the grid of
        `level_scores`.

    Raises
    ------
    ValueError
        If the counts do not match the levels and repetitions.
    """
    counts = _whole_numbers(chosen, "chosen")
    scores = level_scores(levels)
    if counts.ndim < 2 or counts.shape[-1] != len(scores):
        raise ValueError(
            f"chosen has shape {counts.shape}, but there are {len(scores)} levels: give participants by levels"
        )
    answered = np.broadcast_to(np.asarray(n_repetitions, dtype=np.int64), counts.shape)
    if counts.size and (counts.min() < 0 or (counts > answered).any()):
        raise ValueError(f"chosen runs from {counts.min()} to {counts.max()}, allowed: 0 to {answered.max()}")
    if counts.size and answered.sum(axis=-1).max() > MOST_EXACT:
        return _normal_trend(counts, answered, scores)
    rows, totals = answered.reshape(-1, len(scores)), counts.sum(axis=-1)
    first, inverse = distinct_rows(rows)
    patterns, which = rows[first], inverse.reshape(counts.shape[:-1])
    scale = int(np.lcm.reduce(np.maximum(patterns.sum(axis=1), 1)))
    laws: list[Law] = []
    means: list[int] = []
    law = np.full(totals.shape, -1)
    for place, pattern in enumerate(patterns):
        own = _draws_without_replacement(scores, pattern)[1:-1] if (scores * (pattern > 0)).any() else []
        moving = (which == place) & (totals > 0) & (totals <= len(own))
        law[moving] = len(laws) + totals[moving] - 1
        laws += own
        means += [scale // (len(own) + 1) * k * int(pattern @ scores) for k in range(1, len(own) + 1)]
    observed = np.where(law >= 0, counts @ scores, 0).sum(axis=-1)
    return _sum_test(Sums(laws, np.array(means, dtype=np.int64), scale, _count_each(law, len(laws))), observed)


def _normal_trend(counts: IntArray, answered: IntArray, scores: IntArray) -> ExactTest:
    """Return the test by normal approximation, with a continuity correction of half a step."""
    from scipy.special import ndtr

    n, chosen = answered.sum(axis=-1), counts.sum(axis=-1)
    mean, square = ((answered @ each) / np.maximum(n, 1) for each in (scores, scores**2))
    scatter = square - mean**2
    variance = chosen * (n - chosen) / np.maximum(n - 1, 1) * scatter
    deviation = (counts @ scores - chosen * mean).sum(axis=-1)
    spread = np.sqrt(variance.sum(axis=-1))
    half = 0.5 * int(np.gcd.reduce(scores))

    def p(distance: FloatArray) -> FloatArray:
        return np.asarray(2 * ndtr(-np.maximum(distance - half, 0.0) / np.where(spread > 0, spread, np.inf)))

    ends = []
    for order in (np.argsort(scores), np.argsort(-scores)):
        left, end = chosen.copy(), -chosen * mean
        for level in order:
            taken = np.minimum(left, answered[..., level])
            left, end = left - taken, end + taken * scores[level]
        ends.append(np.abs(end.sum(axis=-1)))
    return ExactTest(
        deviation, lambda: p(np.abs(deviation)), lambda: p(np.maximum(*ends)), np.count_nonzero(variance > 0, axis=-1)
    )


def smallest_trend_p(levels: Sequence[float], n_participants: int, n_repetitions: int) -> float:
    """Return the smallest attainable p of a trend test [1].

    Parameters
    ----------
    levels : sequence of float
        Levels.
    n_participants, n_repetitions : int
        Number of participants, and of presentations at each level.
    """
    if len(levels) * n_repetitions > MOST_EXACT:
        return sys.float_info.min if len(set(levels)) > 1 else 1.0
    extremes = _extreme_choices(levels, n_repetitions)
    # If all participants choose alike, both tails are equally probable; if one differs, the other tail may be smaller.
    chosen = [[most] * (n_participants - 1) + [one] for side in extremes for most in side for one in side]
    return float(trend_test(np.array(chosen), levels, n_repetitions).quick_p.min()) if chosen else 1.0


def _extreme_choices(levels: Sequence[float], n_repetitions: int) -> list[list[IntArray]]:
    """Return the least likely choices of only the highest or only the lowest levels, (n_levels,) arrays of counts."""
    laws = _draws_without_replacement(level_scores(levels), n_repetitions)[1:-1]
    places = np.arange(len(levels) * n_repetitions).reshape(len(levels), n_repetitions)
    sides = []
    for order, end in ((places[::-1], -1), (places, 0)):
        rarest = np.argsort([weights[end] for _, weights in laws], kind="stable")[:_RAREST]
        sides.append([(order <= k).sum(axis=1) for k in rarest.tolist()])
    return sides if laws else []


def level_scores(levels: Sequence[float]) -> IntArray:
    """Convert levels to small integers from zero, in steps of their common grid.

    Parameters
    ----------
    levels : sequence of float
        Levels with at most three decimals.

    Returns
    -------
    (n_levels,) array of int
        Scores; without a common grid of at most `GRID_STEPS` steps, levels are rounded to a grid of this many.

    Examples
    --------
    >>> level_scores([80, 100, 150, 200]).tolist()
    [0, 2, 7, 12]
    """
    fine = np.rint(np.asarray(levels, dtype=float) * 1000).astype(np.int64)
    fine = fine - fine.min()
    unit = int(np.gcd.reduce(fine)) or 1
    scores = fine // unit
    if scores.max() > GRID_STEPS:
        scores = np.rint(scores * (GRID_STEPS / scores.max())).astype(np.int64)
    return np.asarray(scores, dtype=np.int64)


def _draws_without_replacement(scores: IntArray, n_repetitions: ArrayLike) -> list[Law]:
    """Return the distribution of the sum of scores of k of the answers drawn without replacement, for each k from 0."""
    answered = np.broadcast_to(np.asarray(n_repetitions, dtype=np.int64), scores.shape)
    n_answers = int(answered.sum())
    ways = np.zeros((n_answers + 1, int(answered @ scores) + 1))
    ways[0, 0] = 1.0
    for score, own in zip(scores.tolist(), answered.tolist(), strict=True):
        grown = ways.copy()
        for taken in range(1, own + 1):
            shift = taken * score
            grown[taken:, shift:] += math.comb(own, taken) * ways[: n_answers + 1 - taken, : ways.shape[1] - shift]
        ways = grown
    sums = (np.flatnonzero(row) for row in ways)
    return [(own.astype(np.int64), ways[k, own] / math.comb(n_answers, k)) for k, own in enumerate(sums)]
