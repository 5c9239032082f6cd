"""Permutation tests of differences between conditions, within participants, for ranks or unordered answers.

References
----------
Friedman, J. Am. Stat. Assoc. 32 (1937) 675-701; Landis, Heyman and Koch, Int. Stat. Rev. 46 (1978) 237-254 (general
association of unordered answers, stratified by participant).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.exact import ExactTest
from modaltouch.analysis.findings import Finding, finding_of
from modaltouch.analysis.intervals import Interval

_SHUFFLES = 9_999


def joint_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield joint tests of all unordered answers over levels, finger conditions and pairs of zones."""
    counts, pairs = answers.counts, [pair.label for pair in answers.pairs]
    over_levels = counts.sum(axis=3)
    for question, scopes, own in (
        ("b", [scope for *_, scope in answers.pair_cells], np.concatenate(np.moveaxis(counts, 0, 2))),
        ("c", pairs, over_levels.transpose(2, 0, 1, 3)),
        ("d", answers.finger_conditions, over_levels.swapaxes(0, 1)),
    ):
        if own.shape[-2] > 1:
            where = " over levels" * (question == "b")
            test, n, name = (
                association_test(own),
                len(counts),
                f"all answers together{where}, shuffles within participants",
            )
            for place, scope in enumerate(scopes):
                yield finding_of(
                    question, name, scope, test[place], "shares of all answers", Interval.point(math.nan, n), n,
                    family=f"{question} together",
                )  # fmt: skip


def association_test(counts: NDArray[np.int64]) -> ExactTest:
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
    values : (..., n_participants, n_conditions, n_values) array
        Values to permute. The statistic is the sum of squares of their sums over participants.
    """
    shape, (n, k, n_values) = values.shape[:-3], values.shape[-3:]
    rows = values.reshape(-1, n, k, n_values)
    order = np.lexsort(np.moveaxis(rows.reshape(-1, n, k * n_values), -1, 0))  # independent of participant order
    rows = np.take_along_axis(rows, order[..., np.newaxis, np.newaxis], axis=1)
    observed = (rows.sum(axis=1, dtype=float) ** 2).sum(axis=(-2, -1))
    flat, reached = np.moveaxis(rows, -1, 1).reshape(-1, n * k), np.zeros(len(rows))
    for shuffles in _shuffles(n, k, 1_000_000 // (k * max(len(flat), n * k))):
        sums = (flat @ shuffles).astype(float).reshape(len(rows), n_values, -1, k)
        least = observed - 1e-9 * np.maximum(observed, 1.0)  # tolerance for rounding
        reached += ((sums**2).sum(axis=(1, 3)) >= least[:, np.newaxis]).sum(axis=-1)
    # Relabelling the conditions for all participants leaves the statistic unchanged, so the most extreme arrangement is
    # reached in at least as many ways as the participant with the most distinct arrangements has.
    alike = (rows[:, :, :, np.newaxis] == rows[:, :, np.newaxis]).all(axis=-1)
    ways = math.lgamma(k + 1) - np.log(np.tril(alike).sum(axis=-1)).sum(axis=-1)  # log of the number
    p_min = np.maximum(1 / (_SHUFFLES + 1), np.exp(ways.max(axis=-1) - ways.sum(axis=-1)))
    p = np.maximum((reached + 1) / (_SHUFFLES + 1), p_min)
    return ExactTest(*(each.reshape(shape)[()] for each in (observed, p, p_min, (ways > 1e-9).sum(axis=-1))))


def _shuffles(n: int, k: int, at_once: int) -> Iterator[NDArray[np.float32]]:
    """Yield batches of permutations within n participants, as matrices that map values to their sums by condition."""
    rng = np.random.default_rng(1)
    for start in range(0, _SHUFFLES, max(at_once, 1)):
        size = min(max(at_once, 1), _SHUFFLES - start)
        places = rng.permuted(np.broadcast_to(np.arange(k), (size, n, k)), axis=2)
        picked = np.zeros((n, k, size, k), dtype=np.float32)
        picked[np.arange(n)[:, np.newaxis], places, np.arange(size)[:, np.newaxis, np.newaxis], np.arange(k)] = 1
        yield picked.reshape(n * k, size * k)
