"""Tests by random shuffling within participants, where the exact distribution is out of reach.

Every p is (1 + shuffles at least as extreme) / (1 + shuffles), with its own interval and a stated seed.

References
----------
Phipson and Smyth, "Permutation p-values should never be zero", Stat. Appl. Genet. Mol. Biol. 9 (2010) 39.
Landis, Heyman and Koch, "Average partial association in three-way contingency tables", Int. Stat. Rev. 46
(1978) 237-254.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.analysis.exact import ExactTest
from modaltouch.analysis.intervals import clopper_pearson

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

SEED = 20190709
SHUFFLES = 9999
LEAST_SHUFFLES = 199
WORK = 4_000_000
"""About how many answers are shuffled altogether; decides how many shuffles large data get."""

BATCH = 200_000
"""Answers shuffled at a time, which bounds the memory."""


@dataclass(frozen=True, eq=False)
class ShuffleTest:
    """A Monte Carlo test.

    Attributes
    ----------
    test : ExactTest
        Statistic, p, and the share of shuffles at the most extreme value met, as smallest p.
    low, high : float
        95 % interval of the p that all shuffles would give [1].
    n_shuffles : int
        How many were drawn.
    seed : int
        Seed of the generator.
    """

    test: ExactTest
    low: float
    high: float
    n_shuffles: int
    seed: int

    @property
    def note(self) -> str:
        """The interval, number of shuffles and seed in words."""
        between = f"p between {self.low:.2g} and {self.high:.2g}"
        return f"Monte Carlo: {between}, {self.n_shuffles} shuffles, seed {self.seed}"


def level_association(table: IntArray) -> ShuffleTest:
    """Return the generalised Cochran-Mantel-Haenszel test of level against answer, participants as strata.

    Parameters
    ----------
    table : (n_participants, n_levels, n_answers) array of int
        Counts; answers are shuffled over the levels within each participant.
    """
    margins = table.sum(axis=1)
    moving = (margins > 0).sum(axis=1) > 1
    sub = table[moving]
    per_level = int(table[0, 0].sum()) if table.size else 0
    n_levels, n_kinds = table.shape[1:]
    expected = sub.sum(axis=(0, 1)) / n_levels
    spread = sum((_covariance(row, per_level * n_levels) for row in margins[moving]), np.zeros((n_kinds, n_kinds)))
    inverse = np.linalg.pinv(spread)

    def statistic(sums: IntArray) -> FloatArray:
        gap = sums - expected
        return np.asarray(np.einsum("...la,ab,...lb->...", gap, inverse, gap))

    cards = np.repeat(np.tile(np.arange(n_kinds, dtype=np.int8), len(sub)), margins[moving].ravel()).reshape(
        len(sub), per_level * n_levels
    )

    def shuffle(rng: np.random.Generator, size: int) -> FloatArray:
        dealt = rng.permuted(np.broadcast_to(cards, (size, *cards.shape)), axis=2)
        places = np.arange(size)[:, np.newaxis, np.newaxis] * n_levels + np.repeat(np.arange(n_levels), per_level)
        sums = np.bincount((places * n_kinds + dealt).ravel(), minlength=size * n_levels * n_kinds)
        return statistic(sums.reshape(size, n_levels, n_kinds))

    return _monte_carlo(statistic(sub.sum(axis=0)), shuffle, cards.size, int(moving.sum()))


def pair_association(table: IntArray) -> ShuffleTest:
    """Return the omnibus test of pair against answer, whole pairs swapped within each participant.

    Parameters
    ----------
    table : (n_participants, n_pairs, n_answers) array of int
        Counts over all levels.

    Notes
    -----
    With a single 0/1 answer in each place the statistic is Cochran's Q.
    """
    centred = table - table.mean(axis=1, keepdims=True)
    moving = np.abs(centred).sum(axis=(1, 2)) > 0
    sub = centred[moving]
    n_pairs = table.shape[1]
    spread = np.einsum("npa,npb->ab", sub, sub) / n_pairs
    inverse = np.linalg.pinv(spread)

    def statistic(sums: FloatArray) -> FloatArray:
        return np.asarray((n_pairs - 1) / n_pairs * np.einsum("...pa,ab,...pb->...", sums, inverse, sums))

    def shuffle(rng: np.random.Generator, size: int) -> FloatArray:
        order = rng.permuted(np.broadcast_to(np.arange(n_pairs), (size, len(sub), n_pairs)), axis=2)
        swapped = np.take_along_axis(sub[np.newaxis], order[..., np.newaxis], axis=2)
        return statistic(swapped.sum(axis=1))

    return _monte_carlo(statistic(sub.sum(axis=0)), shuffle, sub.size, int(moving.sum()))


def participant_heterogeneity(scores: IntArray) -> ShuffleTest:
    """Return the test that participants do not differ, answers shuffled over participants within each cell.

    Parameters
    ----------
    scores : (n_participants, n_cells) array of int
        Net score of each participant in each cell.
    """
    varying = np.ptp(scores, axis=0) > 0
    columns = scores[:, varying]
    centre = columns.sum() / max(len(scores), 1)

    def statistic(values: IntArray) -> FloatArray:
        return np.asarray(((values.sum(axis=-1) - centre) ** 2).sum(axis=-1))

    def shuffle(rng: np.random.Generator, size: int) -> FloatArray:
        return statistic(rng.permuted(np.broadcast_to(columns, (size, *columns.shape)), axis=1))

    informative = len(scores) if varying.sum() > 1 else 0
    return _monte_carlo(statistic(columns), shuffle, columns.size if informative else 0, informative)


def _monte_carlo(
    observed: FloatArray,
    shuffle: Callable[[np.random.Generator, int], FloatArray],
    size: int,
    n_informative: int,
) -> ShuffleTest:
    value = float(observed)
    if size == 0 or n_informative == 0:
        return ShuffleTest(ExactTest(value, 1.0, 1.0, 0), 1.0, 1.0, 0, SEED)
    n = int(min(max(WORK // size, LEAST_SHUFFLES), SHUFFLES))
    rng = np.random.default_rng(SEED)
    batch = max(1, BATCH // size)
    drawn = np.concatenate([shuffle(rng, min(batch, n - done)) for done in range(0, n, batch)])
    slack = 1e-9 * max(1.0, abs(value))
    reached = int((drawn >= value - slack).sum())
    extreme = max(float(drawn.max()), value)
    at_extreme = int((drawn >= extreme - 1e-9 * max(1.0, abs(extreme))).sum())
    interval = clopper_pearson(reached, n)
    p, p_min = (1 + reached) / (n + 1), (1 + at_extreme) / (n + 1)
    test = ExactTest(value, p, min(p_min, p), n_informative)
    return ShuffleTest(test, float(interval.low), float(interval.high), n, SEED)


def _covariance(margin: IntArray, total: int) -> FloatArray:
    shares = margin / total
    return np.asarray((np.diag(shares) - np.outer(shares, shares)) * total / max(total - 1, 1))
