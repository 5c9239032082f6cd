"""Exact tests for few participants: the multinomial test and sign flips, one test or a batch of them.

Cost grows with the range of the score and never with 2^N. Scores are integers, which leaves no doubt about ties. Every
test also tells the smallest p its data could give.

References
----------
Fisher, "The Design of Experiments" (1935), section 21 (sign flips); Pitman, J. R. Stat. Soc. Suppl. 4 (1937)
(randomisation); Engels, "XNomial" (exact multinomial test).
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.sums import LEAST_P, Sums

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

_EXACT_UP_TO = 40
"""Signs of so many participants give p in steps that rounding can tell apart."""


class ExactTest:
    """A two-sided exact test, or a batch of them: then each attribute is an array.

    Parameters
    ----------
    statistic : float or array
        Value of the test statistic.
    p, p_min : float or array, or callable
        As the attributes; what is called is called when it is asked for.
    n_informative : int or array
        Participants (or answers, in the multinomial test) that could move the statistic.
    quick_p : callable, optional
        As the attribute.
    """

    def __init__(
        self, statistic: Any, p: Any, p_min: Any, n_informative: Any, quick_p: Callable[[], Any] | None = None
    ) -> None:
        self.statistic, self.n_informative = statistic, n_informative
        self._p, self._p_min, self._quick_p = p, p_min, quick_p

    @cached_property
    def p(self) -> Any:
        """Probability, if the null hypothesis holds, of a statistic at least as extreme [1]."""
        return _bounded(self._p)

    @cached_property
    def p_min(self) -> Any:
        """Smallest p these data could have given, however the answers had fallen [1]."""
        return _bounded(self._p_min)

    @cached_property
    def quick_p(self) -> Any:
        """`p` to within 1e-13, for counting significant tests by the thousand [1]."""
        return self.p if self._quick_p is None else _bounded(self._quick_p)

    def __getitem__(self, place: int) -> ExactTest:
        """Return one test of a batch."""
        values = (self.statistic, self.p, self.p_min, self.n_informative)
        return ExactTest(*(np.asarray(value)[place] for value in values))


def _bounded(value: Any) -> Any:
    # No outcome is impossible: what is too small for a float is printed as the smallest normal one.
    return np.clip(value() if callable(value) else value, sys.float_info.min, 1.0)


def sum_test(sums: Sums, observed: ArrayLike) -> ExactTest:
    """Return tests whose statistic is a sum over participants, less its mean.

    Parameters
    ----------
    sums : Sums
        Null distributions, test by test.
    observed : (...) array of int
        The sums.
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
    """Return how many participants of each test have each of some values.

    Parameters
    ----------
    values : (..., n_participants) array of int
        One value a participant.
    kinds : (n_kinds,) array of int
        Which are counted.

    Returns
    -------
    (n_tests, n_kinds) array of int
    """
    rows = values.reshape(math.prod(values.shape[:-1]), values.shape[-1])
    counts = [(rows == kind).sum(axis=1) for kind in np.asarray(kinds).tolist()]
    return np.stack(counts, axis=1) if counts else np.zeros((len(rows), 0), dtype=np.int64)


def sign_flip_test(scores: ArrayLike) -> ExactTest:
    """Return the exact test that scores are symmetric about zero; the statistic is their sum.

    Under the null hypothesis every participant's score could as well have had the other sign.

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
    """Return the quick p of sign flips, which for few participants is a known whole number of known steps."""
    n = np.asarray(test.n_informative)
    steps = 2.0 ** np.minimum(n, _EXACT_UP_TO)
    p = np.where(n <= _EXACT_UP_TO, np.rint(test.quick_p * steps) / steps, test.quick_p)
    return np.asarray(np.maximum(p, np.maximum(2.0 ** (1.0 - np.maximum(n, 1)), LEAST_P)))


def sign_test(scores: ArrayLike) -> ExactTest:
    """Return the exact sign test: how many participants, the statistic, lean to the positive side, zeros left out.

    Parameters
    ----------
    scores : (..., n_participants) array of int
        One net score per participant.
    """
    values = whole_numbers(scores, "scores")
    test = sign_flip_test(np.sign(values))
    n_positive = (values > 0).sum(axis=-1)
    return ExactTest(n_positive, lambda: test.p, lambda: test.p_min, test.n_informative, lambda: test.quick_p)


def multinomial_test(counts: ArrayLike, probabilities: Sequence[float] | None = None) -> ExactTest:
    """Return the exact goodness-of-fit test of counts; the statistic is twice the logarithm of the likelihood ratio.

    Every possible outcome is enumerated, the more extreme the larger its likelihood ratio; of outcomes that are alike
    under the null hypothesis, one stands for all.

    Parameters
    ----------
    counts : (..., n_categories) array of int
        Observed counts.
    probabilities : sequence of float, optional
        Probability of each category under the null hypothesis [1]; equal by default.

    Raises
    ------
    ValueError
        If the counts are negative, or of fewer than two categories, or the probabilities do not add up to one.

    Examples
    --------
    >>> float(multinomial_test([10, 0, 0]).p.round(8))  # three such outcomes, each of probability (1/3)^10
    5.081e-05
    """
    observed = whole_numbers(counts, "counts")
    null = _check_multinomial(observed, probabilities)
    rows = observed.reshape(-1, null.size)
    totals = rows.sum(axis=1)
    statistic, p, p_min = np.zeros(len(rows)), np.ones(len(rows)), np.ones(len(rows))
    for n in np.unique(totals[totals > 0]).tolist():
        here, shares = totals == n, _tables(n, null)[1]
        statistic[here] = shares[np.arange(null.size), rows[here]].sum(axis=1)
        # The ratio is convex in the counts, so the most extreme outcome has all answers in one category.
        extremes = np.append(statistic[here], shares[:, n].max())
        least = extremes - 1e-9 * np.maximum(1.0, np.abs(extremes))  # rounding allowed for
        if math.comb(n + null.size - 1, n) <= _KEPT:
            values, tails = _ranked_outcomes(n, tuple(null.tolist()))
            chances = tails[np.searchsorted(values, least)]
        else:
            chances = sum((value >= least[:, np.newaxis]) @ mass for value, mass in _weighed_outcomes(n, null))
        p[here], p_min[here] = chances[:-1], chances[-1]
    shape = observed.shape[:-1]
    found: list[Any] = [each.reshape(shape)[()] for each in (statistic, p, p_min, totals)]
    return ExactTest(*found)


def _check_multinomial(observed: IntArray, probabilities: Sequence[float] | None) -> FloatArray:
    if observed.ndim < 1 or observed.shape[-1] < 2 or observed.size == 0:
        raise ValueError(f"counts have shape {observed.shape}: give (..., n_categories), two categories or more")
    if observed.min() < 0:
        raise ValueError(f"counts must not be negative, got {observed.tolist()}")
    k = observed.shape[-1]
    null = np.full(k, 1 / k) if probabilities is None else np.asarray(probabilities, dtype=float)
    if null.shape != (k,) or (null <= 0).any() or abs(null.sum() - 1) > 1e-9:
        raise ValueError(f"probabilities {null.tolist()} must be {k} positive numbers that add up to 1")
    return null


_KEPT = 10_000
"""Up to how many outcomes are kept for the next experiment of a study that is planned; 2,000 answers have 2e6."""


@lru_cache(maxsize=1024)
def _ranked_outcomes(n: int, probabilities: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the statistic of every outcome, increasing, and the probability of that outcome and all after it."""
    value, mass = (np.concatenate(each) for each in zip(*_weighed_outcomes(n, np.array(probabilities)), strict=True))
    order = np.argsort(value)
    return value[order], np.cumsum(mass[order][::-1])[::-1]


def _weighed_outcomes(n: int, null: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the statistic of every outcome and its probability, part by part."""
    log_p, share = _tables(n, null)
    for head, orders, tail in _outcomes(n, null.size, alike=bool((null == null[0]).all())):
        at_head = [(log_p[j, x], share[j, x]) for j, x in enumerate(head)]
        mass = orders * np.exp(log_p[-2, tail] + log_p[-1, tail[::-1]] + sum(p for p, _ in at_head))
        yield share[-2, tail] + share[-1, tail[::-1]] + sum(value for _, value in at_head), mass


def _tables(n: int, null: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return, per category and count, its share of the log probability and of the statistic."""
    x = np.arange(n + 1)
    log_factorial = np.concatenate([[0.0], np.cumsum(np.log(x[1:]))])
    log_p = x * np.log(null)[:, np.newaxis] - log_factorial
    log_p[0] += log_factorial[n]
    expected = n * null[:, np.newaxis]
    return log_p, np.asarray(2 * x * np.log(np.maximum(x, 1) / expected), dtype=float)


def _outcomes(n: int, k: int, alike: bool) -> Iterator[tuple[tuple[int, ...], int, IntArray]]:
    """Yield the counts of all but the last two categories, and the range that the last but one can take.

    Where the categories are alike, counts that differ in their order alone come once, with how many orders they have.
    """
    for head in _heads(n, k - 2, n if alike else None):
        orders = math.factorial(k - 2) // math.prod(map(math.factorial, Counter(head).values())) if alike else 1
        yield head, orders, np.arange(n - sum(head) + 1, dtype=np.int64)


def _heads(n: int, length: int, most: int | None) -> Iterator[tuple[int, ...]]:
    """Yield counts that add up to n at most; where the first may be no more than a number, none above its neighbour."""
    if length == 0:
        yield ()
        return
    for first in range((n if most is None else min(n, most)) + 1):
        for rest in _heads(n - first, length - 1, None if most is None else first):
            yield first, *rest


def whole_numbers(values: ArrayLike, name: str) -> IntArray:
    """Return an array of integers.

    Parameters
    ----------
    values : array
        Whole numbers of any type.
    name : str
        What they are, for the message.

    Raises
    ------
    ValueError
        If any is a fraction.
    """
    array = np.asarray(values)
    if array.dtype.kind not in "iub" and not np.array_equal(array, np.rint(array)):
        raise ValueError(f"{name} must be whole numbers, so that ties are exact; got {array.ravel()[:5].tolist()}")
    return array.astype(np.int64, copy=False)
