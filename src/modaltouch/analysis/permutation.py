"""Permutation tests within and between participants, with the intervals that invert them.

Of one value per participant: one-sample tests of symmetry use sign flips, or signed ranks for ratings; two-sample tests
permute the group labels. Of several conditions: ranks or unordered answers are permuted within participants.

References
----------
Hollander and Wolfe, "Nonparametric Statistical Methods" (1973), sections 3.1 to 3.3 (signed ranks).
Pitman, J. R. Stat. Soc. Suppl. 4 (1937) 119-130 (shuffled groups).
Friedman, J. Am. Stat. Assoc. 32 (1937) 675-701; Landis, Heyman and Koch, Int. Stat. Rev. 46 (1978) 237-254 (general
association of unordered answers, stratified by participant).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.exact import ExactTest, sign_flip_test
from modaltouch.analysis.intervals import CONFIDENCE, Interval, centre_interval
from modaltouch.analysis.sums import FloatArray, IntArray

Located = tuple[ExactTest, Interval]


def flip_test(values: FloatArray) -> ExactTest:
    """Exact sign-flip test of symmetry about zero, with the values as whole numbers of `_unit`.

    Parameters
    ----------
    values : (..., n) array
        One value per participant.

    Examples
    --------
    >>> float(flip_test(np.array([1, 1, 2, -1]) / 18).p)  # 8 of 16 sums are as far from 0
    0.5
    """
    unit = _unit(values)
    test = sign_flip_test(np.rint(values / unit).astype(np.int64))
    return ExactTest(
        test.statistic * unit, lambda: test.p, lambda: test.p_min, test.n_informative, lambda: test.quick_p
    )


NOISE = 1e-9
"""Values up to this are numerical noise: none of the measures is known as finely."""

# Maximum common denominator of exact values, and the numbers of distinct values and of steps up to the largest.
_DENOMINATORS, _DISTINCT, _STEPS = np.arange(1, 2001), 500, 10_000


def _unit(values: FloatArray) -> float:
    """Return a unit of which the largest value is a thousand or more, and of which fractions are whole numbers.

    Rounding would break ties, as of 1/18 + 1/18 and 1/9. Values without a small common denominator are rounded to four
    digits of the largest.
    """
    sizes = np.unique(np.abs(values))
    largest = float(sizes.max(initial=0.0))
    if largest < NOISE:
        return 1.0
    if sizes.size <= _DISTINCT:
        scaled = sizes[:, np.newaxis] * _DENOMINATORS[_DENOMINATORS * largest <= _STEPS]
        is_whole = (np.abs(scaled - np.rint(scaled)) < 1e-6 * np.minimum(scaled[-1], 1)).all(axis=0)
        if is_whole.any():
            denominator = int(_DENOMINATORS[is_whole.argmax()])
            return 1 / (denominator * math.ceil(1000 / (largest * denominator)))
    return 10.0 ** (math.floor(math.log10(largest)) - 3)


def by_flips(values: FloatArray) -> Located:
    """Return the sign-flip test of `flip_test`, and the mean with the interval of centres that it does not reject."""
    thousand = 1000 * _unit(values)
    return flip_test(values), centre_interval(values / thousand).changed(lambda scaled: scaled * thousand)


def rank_test(values: FloatArray) -> ExactTest:
    """Wilcoxon's exact signed-rank test, excluding zeros and with midranks for ties.

    Parameters
    ----------
    values : (..., n) array
        One value per participant.

    Examples
    --------
    >>> float(rank_test(np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])).p)  # 2 / 2^6
    0.03125
    """
    rows = np.abs(values).reshape(-1, values.shape[-1])
    ranks = pd.DataFrame(np.where(rows > 0, rows, np.nan)).rank(axis=1).fillna(0.0).to_numpy().reshape(values.shape)
    return sign_flip_test(np.rint(2 * ranks * np.sign(values)).astype(np.int64))


def by_ranks(values: FloatArray) -> Located:
    """Return the signed-rank test, and the Hodges-Lehmann estimate (median of the Walsh averages) with its interval.

    Parameters
    ----------
    values : (..., n) array
        One value per participant.
    """
    # Round off numerical noise, which would break ties.
    values, n = values.round(9), values.shape[-1]
    first, second = np.triu_indices(n)
    averages = np.sort((values[..., first] + values[..., second]) / 2)
    chances = np.ones(1)
    for rank in range(1, n + 1):
        chances = (np.pad(chances, (0, rank)) + np.pad(chances, (rank, 0))) / 2
    dropped = int(np.searchsorted(np.cumsum(chances), (1 - CONFIDENCE) / 2))
    is_bounded = bool(dropped and n)
    low, high = (averages[..., dropped - 1], averages[..., -dropped]) if is_bounded else (-math.inf, math.inf)
    middle = np.median(averages, axis=-1) if n else math.nan
    return rank_test(values), Interval(middle, low, high, n)


# Maximum number of permutations for full enumeration; with more, this many are sampled.
_MOST_ORDERS = 20_000

# Maximum size of temporary arrays.
_AT_ONCE = 400_000


def group_test(first: FloatArray, second: FloatArray) -> Located:
    """Return the permutation test of equal distributions in two groups, and the interval of shifts not rejected by it.

    Parameters
    ----------
    first, second : (n,) arrays
        One value per participant; the statistic is the difference of the means, first minus second.
    """
    first, second = np.sort(first), np.sort(second)  # makes the sample independent of the participants' order
    test, values = shuffle_test(first, second), np.concatenate([first, second])
    observed, far = float(test.statistic), 2 * float(np.ptp(values)) + 1e-9
    weights = _weights(first.size, values.size)
    # The difference of means in a permutation is linear in the shift of the first group.
    differences, moved = weights @ values, weights[:, : first.size].sum(axis=-1)

    def p(shift: float) -> float:
        return float((np.abs(differences - shift * moved) >= abs(observed - shift) - 1e-9).mean())

    low, high = (_last_kept(p, observed, observed + far * side) for side in (-1, 1))
    return test, Interval(observed, low, high, first.size + second.size)


def shuffle_test(first: FloatArray, second: FloatArray) -> ExactTest:
    """Permutation test of equal distributions in two groups.

    Parameters
    ----------
    first, second : (..., n) arrays
        As for `group_test`.
    """
    values, observed = np.concatenate([first, second], axis=-1), first.mean(axis=-1) - second.mean(axis=-1)
    rows, tails = values.reshape(-1, values.shape[-1]), list[FloatArray]()
    weights = _weights(first.shape[-1], rows.shape[-1])
    step = max(1, _AT_ONCE // len(weights))
    for start in range(0, len(rows), step):
        far = np.abs(rows[start : start + step] @ weights.T)
        ends = np.stack([far[:, 0], far.max(axis=-1)])  # the first permutation is the identity
        tails.append((far >= ends[..., np.newaxis] - 1e-9).mean(axis=-1))
    p, p_min = np.concatenate(tails, axis=-1).reshape(2, *observed.shape)
    return ExactTest(observed, p, p_min, np.where(np.ptp(values, axis=-1) > 0, values.shape[-1], 0))


@lru_cache(maxsize=4)
def _weights(n: int, size: int) -> FloatArray:
    """Return the weights of the difference of means by permutation, identity first; all of them, or a sample."""
    is_first = np.arange(size) < n
    if math.comb(size, n) <= _MOST_ORDERS:
        chosen = np.array(list(combinations(range(size), n)))
        orders = np.zeros((len(chosen), size), dtype=bool)
        np.put_along_axis(orders, chosen, True, axis=1)
    else:
        rng = np.random.default_rng(1)
        orders = np.stack([is_first, *(rng.permutation(is_first) for _ in range(_MOST_ORDERS - 1))])
    return np.asarray(orders / n - ~orders / (size - n))


def _last_kept(p: Callable[[float], float], kept: float, rejected: float) -> float:
    """Find the farthest shift that is not rejected, by bisection; infinite if `rejected` is not rejected either."""
    if p(rejected) > 1 - CONFIDENCE:
        return math.copysign(math.inf, rejected - kept)
    for _ in range(40):
        middle = (kept + rejected) / 2
        kept, rejected = (middle, rejected) if p(middle) > 1 - CONFIDENCE else (kept, middle)
    return kept


_SHUFFLES = 9_999


def association_test(counts: IntArray) -> ExactTest:
    """Test the null hypothesis that no participant's answers depend on the condition.

    As in Pearson's statistic, the deviations of the counts from those expected from each participant's totals are
    squared and divided by the total of the answer; the deviations are first summed over participants.

    Parameters
    ----------
    counts : (..., n_participants, n_conditions, n_answers) array of int
        Counts of answers.
    """
    given, asked = counts.sum(axis=-2, keepdims=True), counts.sum(axis=-1, keepdims=True)
    expected = asked * given / np.maximum(asked.sum(axis=-2, keepdims=True), 1)
    return shuffle_conditions((counts - expected) / np.sqrt(np.maximum(given.sum(axis=-3, keepdims=True), 1)))


def shuffle_conditions(values: NDArray[Any]) -> ExactTest:
    """Test the exchangeability of conditions within participants, by 9,999 permutations with a fixed seed.

    Parameters
    ----------
    values : (..., n_participants, n_conditions, n_values) array of float
        Values to permute. The statistic is the sum of squares of their sums over participants.
    """
    shape, (n, k, n_values) = values.shape[:-3], values.shape[-3:]
    rows = values.reshape(-1, n, k, n_values)
    order = np.lexsort(np.moveaxis(rows.reshape(-1, n, k * n_values), -1, 0))  # independent of participant order
    rows = np.take_along_axis(rows, order[..., np.newaxis, np.newaxis], axis=1)
    observed = (rows.sum(axis=1, dtype=float) ** 2).sum(axis=(-2, -1))
    flat, total = np.moveaxis(rows, -1, 1).reshape(-1, n * k), rows.sum(axis=(1, 2), dtype=float)[..., np.newaxis]
    least, reached = (observed - 1e-9 * np.maximum(observed, 1.0))[:, np.newaxis], np.zeros(len(rows))
    for shuffles in _shuffles(n, k, 1_000_000 // (k * max(len(flat), n * k))):
        sums = (
            np.tensordot(flat, shuffles.astype(rows.dtype), 1)
            .reshape(len(rows), n_values, *shuffles.shape[1:])
            .astype(float)
        )
        last = total - sums.sum(axis=2)
        statistic = np.einsum("tvks,tvks->ts", sums, sums) + np.einsum("tvs,tvs->ts", last, last)
        reached += (statistic >= least).sum(axis=-1)
    # Relabelling the conditions for all participants leaves the statistic unchanged, so the most extreme arrangement is
    # reached in at least as many ways as the participant with the most distinct arrangements has.
    alike = (rows[:, :, :, np.newaxis] == rows[:, :, np.newaxis]).all(axis=-1)
    ways = math.lgamma(k + 1) - np.log(np.tril(alike).sum(axis=-1)).sum(axis=-1)  # log of the number
    p_min = np.maximum(1 / (_SHUFFLES + 1), np.exp((ways.max(axis=-1) - ways.sum(axis=-1)).round(12)))
    p = np.maximum((reached + 1) / (_SHUFFLES + 1), p_min)
    return ExactTest(*(each.reshape(shape)[()] for each in (observed, p, p_min, (ways > 1e-9).sum(axis=-1))))


def _shuffles(n: int, k: int, at_once: int) -> Iterator[NDArray[np.bool_]]:
    """Yield batches of permutations within n participants, as tables that map values to their sums by condition.

    They are (n * k, k - 1, n_permutations) arrays; the last condition is left out.
    """
    rng = np.random.default_rng(1)
    for start in range(0, _SHUFFLES, max(at_once, 1)):
        size = min(max(at_once, 1), _SHUFFLES - start)
        places = rng.permuted(np.broadcast_to(np.arange(k, dtype=np.uint8), (size, n, k)), axis=2)
        picked = places[..., :-1].transpose(1, 2, 0)[:, np.newaxis] == np.arange(k)[:, np.newaxis, np.newaxis]
        yield picked.reshape(n * k, k - 1, size)


def friedman(rows: FloatArray) -> tuple[ExactTest, Any]:
    """Return Friedman's test, with p from permutations within participants, and Kendall's W.

    Parameters
    ----------
    rows : (..., n_participants, n_levels) array
        Mean ratings.
    """
    shape, (n, k) = rows.shape[:-2], rows.shape[-2:]
    ranks = pd.DataFrame(rows.reshape(-1, k)).round(9).rank(axis=1).to_numpy().reshape(-1, n, k)
    ties = ((ranks[..., np.newaxis] == ranks[..., np.newaxis, :]).sum(axis=-1) ** 2 - 1).sum(axis=(1, 2))
    most = n**2 * (k**3 - k) / 12 - n * ties / 12
    # Ranks are multiples of 1/2, so their sums are exact in single precision.
    test = shuffle_conditions((ranks - (k + 1) / 2).astype(np.float32)[..., np.newaxis])
    concordance = np.divide(test.statistic, most, out=np.full(most.shape, math.nan), where=most > 0)
    statistic = np.where(most > 0, n * (k - 1) * concordance, 0.0)
    found: list[Any] = [
        each.reshape(shape)[()] for each in (statistic, test.p, test.p_min, test.n_informative, concordance)
    ]
    return ExactTest(*found[:4]), found[4]
