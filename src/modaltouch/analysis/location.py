"""Location tests for one value per participant, with the intervals that invert them.

One-sample tests of symmetry use sign flips, or signed ranks for ratings. Two-sample tests permute the group labels.

References
----------
Hollander and Wolfe, "Nonparametric Statistical Methods" (1973), sections 3.1 to 3.3 (signed ranks).
Pitman, J. R. Stat. Soc. Suppl. 4 (1937) 119-130 (shuffled groups).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.covariates import centre_interval
from modaltouch.analysis.exact import ExactTest, sign_flip_test
from modaltouch.analysis.intervals import CONFIDENCE, Interval

FloatArray = NDArray[np.float64]
Located = tuple[ExactTest, Interval]


def flip_test(values: FloatArray) -> ExactTest:
    """Exact sign-flip test of symmetry about zero, with values rounded to four significant digits of the largest.

    Parameters
    ----------
    values : (..., n) array
        One value per participant.
    """
    return sign_flip_test(np.rint(values / _unit(values) * 1000).astype(np.int64))


def _unit(values: FloatArray) -> float:
    largest = float(np.abs(values).max(initial=0.0))
    return 10.0 ** math.floor(math.log10(largest)) if largest > 0 else 1.0


def by_flips(values: FloatArray) -> Located:
    """Return the sign-flip test of `flip_test`, and the mean with the interval of centres that it does not reject."""
    unit = _unit(values)
    return flip_test(values), centre_interval(values / unit).changed(lambda scaled: scaled * unit)


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
    is_told = bool(dropped and n)
    low, high = (averages[..., dropped - 1], averages[..., -dropped]) if is_told else (-math.inf, math.inf)
    middle = np.median(averages, axis=-1) if n else math.nan
    return rank_test(values), Interval(middle, low, high, n)


_MOST_ORDERS = 20_000
"""Maximum number of permutations for full enumeration; with more, this many are sampled."""

_AT_ONCE = 4_000_000
"""Maximum size of temporary arrays."""


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
    weights, _ = _weights(first.size, values.size)
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
    values, n = np.concatenate([first, second], axis=-1), first.shape[-1]
    size = values.shape[-1]
    weights, is_exact = _weights(n, size)
    observed = first.mean(axis=-1) - second.mean(axis=-1)
    rows, least = values.reshape(-1, size), np.abs(observed).reshape(-1, 1) - 1e-9
    step = max(1, _AT_ONCE // len(weights))
    parts = (slice(start, start + step) for start in range(0, len(rows), step))
    p = np.concatenate([(np.abs(rows[part] @ weights.T) >= least[part]).mean(axis=-1) for part in parts])
    p_min = (2 if is_exact and 2 * n == size else 1) / len(weights)
    return ExactTest(observed, p.reshape(observed.shape)[()], p_min, size)


@lru_cache(maxsize=4)
def _weights(n: int, size: int) -> tuple[FloatArray, bool]:
    """Return the weights of the difference of means by permutation, identity first, and whether all are enumerated."""
    is_first = np.arange(size) < n
    is_exact = math.comb(size, n) <= _MOST_ORDERS
    if is_exact:
        chosen = np.array(list(combinations(range(size), n)))
        orders = np.zeros((len(chosen), size), dtype=bool)
        np.put_along_axis(orders, chosen, True, axis=1)
    else:
        rng = np.random.default_rng(1)
        orders = np.stack([is_first, *(rng.permutation(is_first) for _ in range(_MOST_ORDERS - 1))])
    return orders / n - ~orders / (size - n), is_exact


def _last_kept(p: Callable[[float], float], kept: float, rejected: float) -> float:
    """Find the farthest shift that is not rejected, by bisection; infinite if `rejected` is not rejected either."""
    if p(rejected) > 1 - CONFIDENCE:
        return math.copysign(math.inf, rejected - kept)
    for _ in range(40):
        middle = (kept + rejected) / 2
        kept, rejected = (middle, rejected) if p(middle) > 1 - CONFIDENCE else (kept, middle)
    return kept
