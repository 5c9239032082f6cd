"""Exact tests for small samples: multinomial, sign-flip and sign tests, singly or in batches.

The cost grows with the range of the scores, not with 2^N. Scores are integers, so ties are exact. Every test also
reports the smallest attainable p.

References
----------
Fisher, "The Design of Experiments" (1935), section 21 (sign flips); Pitman, J. R. Stat. Soc. Suppl. 4 (1937)
(randomisation); Engels, "XNomial" (exact multinomial test).
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.sums import LEAST_P, Sums

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

_EXACT_UP_TO = 40
"""Maximum number of participants for which p is rounded to its exact steps."""


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


def sum_test(sums: Sums, observed: ArrayLike) -> ExactTest:
    """Return tests whose statistic is a sum over participants minus its expectation under the null hypothesis.

    Parameters
    ----------
    sums : Sums
        Null distributions, test by test.
    observed : (...) array of int
        Observed sums.
    """
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


def count_each(values: IntArray, kinds: ArrayLike) -> IntArray:
    """Count the participants with each of some values, test by test.

    Parameters
    ----------
    values : (..., n_participants) array of int
        One value per participant.
    kinds : (n_kinds,) array of int
        The values to count.

    Returns
    -------
    (n_tests, n_kinds) array of int
    """
    rows = values.reshape(math.prod(values.shape[:-1]), values.shape[-1])
    counts = [(rows == kind).sum(axis=1) for kind in np.asarray(kinds).tolist()]
    return np.stack(counts, axis=1) if counts else np.zeros((len(rows), 0), dtype=np.int64)


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
    values = whole_numbers(scores, "scores")
    sizes = np.abs(values)
    kinds = np.unique(sizes)
    kinds = kinds[kinds > 0]
    coin = np.array([0.5, 0.5])
    laws = [(np.array([-size, size]), coin) for size in kinds]
    sums = Sums(laws, np.zeros(len(laws), dtype=np.int64), 1, count_each(sizes, kinds))
    test = sum_test(sums, values.sum(axis=-1))
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
    values = whole_numbers(scores, "scores")
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
    observed = whole_numbers(counts, "counts")
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
    shape = observed.shape[:-1]
    found: list[Any] = [each.reshape(shape)[()] for each in (statistic, p, p_min, totals)]
    return ExactTest(*found)


_KEPT = 10_000
"""Maximum number of outcomes to cache for further simulated experiments; 2,000 answers in three categories have 2e6."""


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


def whole_numbers(values: ArrayLike, name: str) -> IntArray:
    """Convert whole numbers to an integer array.

    Parameters
    ----------
    values : array
        Whole numbers of any dtype.
    name : str
        Name of the values for the error message.

    Raises
    ------
    ValueError
        If any value is not a whole number.
    """
    array = np.asarray(values)
    if array.dtype.kind not in "iub" and not np.array_equal(array, np.rint(array)):
        raise ValueError(f"{name} must be whole numbers, so that ties are exact; got {array.ravel()[:5].tolist()}")
    return array.astype(np.int64, copy=False)
