"""Exact tests for few participants: the multinomial test and sign flips.

Distributions are built by convolution, so cost grows with the range of the score and never with 2^N. Scores
are integers, which leaves no doubt about ties. Every test also returns the smallest p its data could give.

References
----------
Fisher, "The Design of Experiments" (1935), section 21 (sign flips); Pitman, J. R. Stat. Soc. Suppl. 4 (1937)
(randomisation); Engels, "XNomial" (exact multinomial test).
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.convolution import Kernel, tail_probability

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class ExactTest:
    """A two-sided exact test.

    Attributes
    ----------
    statistic : float
        Value of the test statistic.
    p : float
        Probability, if the null hypothesis holds, of a statistic at least as extreme.
    p_min : float
        Smallest p these data could have given, however the answers had fallen.
    n_informative : int
        Participants (or answers, in the multinomial test) that could move the statistic.
    """

    statistic: float
    p: float
    p_min: float
    n_informative: int

    def __post_init__(self) -> None:
        # No outcome is impossible: what is too small for a float is printed as the smallest normal one.
        for name in ("p", "p_min"):
            object.__setattr__(self, name, min(max(getattr(self, name), sys.float_info.min), 1.0))


def multinomial_tests(counts: ArrayLike, probabilities: Sequence[float] | None = None) -> tuple[ExactTest, ...]:
    """Return exact goodness-of-fit tests of several count vectors with the same total.

    Every possible outcome is enumerated once for all of them, the more extreme the larger its likelihood ratio; of
    outcomes that are alike under the null hypothesis, one stands for all.

    Parameters
    ----------
    counts : (n_tests, n_categories) array of int
        Observed counts; all rows have the same total.
    probabilities : sequence of float, optional
        Probability of each category under the null hypothesis [1]; equal by default.

    Returns
    -------
    tuple of ExactTest
        One test per row; the statistic is the likelihood ratio, twice its logarithm.

    Raises
    ------
    ValueError
        If the counts are negative, fewer than two categories, of different totals, or the probabilities do not
        add up to one.
    """
    observed = np.asarray(counts, dtype=np.int64)
    null = _check_multinomial(observed, probabilities)
    n = int(observed[0].sum())
    if n == 0:
        return tuple(ExactTest(0.0, 1.0, 1.0, 0) for _ in observed)
    log_p, extremeness = _tables(n, null)
    categories = np.arange(null.size)
    reached = extremeness[categories, observed].sum(axis=1)
    tolerance = 1e-9 * np.maximum(1.0, np.abs(reached))
    p = np.zeros(len(observed))
    largest, p_min = -math.inf, 0.0
    alike = bool((null == null[0]).all())
    for head, orders, tail in _outcomes(n, null.size, alike):
        mass = orders * np.exp(log_p[-2, tail] + log_p[-1, tail[::-1]] + sum(log_p[j, x] for j, x in enumerate(head)))
        value = extremeness[-2, tail] + extremeness[-1, tail[::-1]]
        value = value + sum(extremeness[j, x] for j, x in enumerate(head))
        p += (value >= (reached - tolerance)[:, np.newaxis]) @ mass
        top, slack = float(value.max()), 1e-9 * max(1.0, abs(float(value.max())))
        if top > largest + slack:
            largest, p_min = top, 0.0
        p_min += float(mass[value >= largest - slack].sum())
    return tuple(ExactTest(float(s), float(q), min(p_min, float(q)), n) for s, q in zip(reached, p, strict=True))


def multinomial_test(counts: ArrayLike, probabilities: Sequence[float] | None = None) -> ExactTest:
    """Return the exact goodness-of-fit test of one count vector; see `multinomial_tests`.

    Examples
    --------
    >>> round(multinomial_test([10, 0, 0]).p, 8)  # three such outcomes, each of probability (1/3)^10
    5.081e-05
    """
    return multinomial_tests(np.asarray(counts)[np.newaxis], probabilities)[0]


def sign_flip_test(scores: ArrayLike) -> ExactTest:
    """Return the exact test that scores are symmetric about zero; the statistic is their sum.

    Under the null hypothesis every participant's score could as well have had the other sign.

    Parameters
    ----------
    scores : (n_participants,) array of int
        One net score per participant.

    Examples
    --------
    >>> sign_flip_test([4] * 10).p == 2 / 2**10
    True
    """
    values = whole_numbers(scores, "scores")
    sizes = np.abs(values[values != 0])
    total = int(values.sum())
    if sizes.size == 0:
        return ExactTest(float(total), 1.0, 1.0, 0)
    unit = int(np.gcd.reduce(sizes))
    kernels = [_coin_kernel(int(size) // unit, count) for size, count in sorted(Counter(sizes.tolist()).items())]
    reach = abs(total) // unit
    p = 1.0 if reach == 0 else tail_probability(kernels, -reach, reach)
    return ExactTest(float(total), p, 2.0 ** (1 - int(sizes.size)), int(sizes.size))


def sign_test(scores: ArrayLike) -> ExactTest:
    """Return the exact sign test: how many participants, the statistic, lean to the positive side, zeros left out.

    Parameters
    ----------
    scores : (n_participants,) array of int
        One net score per participant.
    """
    values = whole_numbers(scores, "scores")
    test = sign_flip_test(np.sign(values))
    return ExactTest(float((values > 0).sum()), test.p, test.p_min, test.n_informative)


def _check_multinomial(observed: IntArray, probabilities: Sequence[float] | None) -> FloatArray:
    if observed.ndim != 2 or observed.shape[1] < 2 or observed.size == 0:
        raise ValueError(f"counts have shape {observed.shape}: give (n_tests, n_categories), two categories or more")
    if observed.min() < 0 or len(set(observed.sum(axis=1).tolist())) != 1:
        raise ValueError(f"counts must not be negative and every row must have the same total, got {observed.tolist()}")
    k = observed.shape[1]
    null = np.full(k, 1 / k) if probabilities is None else np.asarray(probabilities, dtype=float)
    if null.shape != (k,) or (null <= 0).any() or abs(null.sum() - 1) > 1e-9:
        raise ValueError(f"probabilities {null.tolist()} must be {k} positive numbers that add up to 1")
    return null


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


def _coin_kernel(size: int, count: int) -> Kernel:
    """Return the distribution of `count` scores of one size under random signs."""
    weights = np.array([math.comb(count, heads) / (1 << count) for heads in range(count + 1)])
    steps = np.arange(-count, count + 1, 2, dtype=np.int64) * size
    return Kernel((steps, weights), 1)


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
    return array.astype(np.int64)
