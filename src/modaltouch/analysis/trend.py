"""Exact test of a trend over levels, answers shuffled within participants.

References
----------
Pitman, J. R. Stat. Soc. Suppl. 4 (1937) 119-130 and 225-232 (randomisation tests).
Armitage, Biometrics 11 (1955) 375-386 (linear trend in proportions).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.convolution import Kernel, tail_probability
from modaltouch.analysis.exact import ExactTest, whole_numbers

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

GRID_STEPS = 1000
"""Levels that share no coarser grid are placed on one of this many steps between the lowest and the highest."""


def trend_test(chosen: ArrayLike, levels: Sequence[float], n_repetitions: int = 1) -> ExactTest:
    """Return the exact test of a trend over levels, answers shuffled within each participant.

    Under the null hypothesis a participant's answers have nothing to do with the level, so any assignment of
    the answers to the presentations was as likely. Participants whose answers are all the same drop out.

    Parameters
    ----------
    chosen : (n_participants, n_levels) array of int
        How often the answer was chosen at each level.
    levels : sequence of float
        Levels, as scores of the trend; only their ratios of distances matter.
    n_repetitions : int
        Presentations of each level.

    Returns
    -------
    ExactTest
        The statistic is the sum over participants of score times count less its expectation, in units of the
        grid `level_scores` returns.

    Raises
    ------
    ValueError
        If the counts do not fit the levels and repetitions.
    """
    counts = whole_numbers(chosen, "chosen")
    scores = level_scores(levels)
    if counts.ndim != 2 or counts.shape[1] != len(scores):
        raise ValueError(
            f"chosen has shape {counts.shape}, but there are {len(scores)} levels: give participants by levels"
        )
    if counts.size and (counts.min() < 0 or counts.max() > n_repetitions):
        raise ValueError(f"chosen runs from {counts.min()} to {counts.max()}, allowed are 0 to {n_repetitions}")
    totals = counts.sum(axis=1)
    moving = (totals > 0) & (totals < n_repetitions * len(scores))
    n_levels = len(scores)
    # Everything is multiplied by the number of levels, so that the expectation is an integer too.
    observed = int((counts[moving] @ scores).sum()) * n_levels
    expected = int(totals[moving].sum()) * int(scores.sum())
    if not moving.any() or scores.max() == 0:
        return ExactTest(0.0, 1.0, 1.0, 0)
    by_total = draws_without_replacement(scores, n_repetitions)
    kernels = [Kernel(by_total[k], count) for k, count in sorted(Counter(totals[moving].tolist()).items())]
    distance = abs(observed - expected)
    lowest, highest = (sum(k.count * edge for k in kernels for edge in (k.ends[i],)) for i in (0, 1))
    farthest = max(expected - lowest * n_levels, highest * n_levels - expected)
    p, p_min = (
        1.0
        if d == 0
        else tail_probability(kernels, math.floor((expected - d) / n_levels), math.ceil((expected + d) / n_levels))
        for d in (distance, farthest)
    )
    return ExactTest((observed - expected) / n_levels, p, min(p_min, p), int(moving.sum()))


def level_scores(levels: Sequence[float]) -> IntArray:
    """Return levels as small integers from zero, on their common grid.

    Parameters
    ----------
    levels : sequence of float
        Levels in one unit, to three decimals.

    Returns
    -------
    (n_levels,) array of int
        Scores; levels without a common grid of at most `GRID_STEPS` steps are rounded to one.

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


def draws_without_replacement(scores: IntArray, n_repetitions: int) -> list[tuple[IntArray, FloatArray]]:
    """Return, for every k, the distribution of the sum of k presentations drawn without replacement.

    Parameters
    ----------
    scores : (n_levels,) array of int
        Score of each level, from zero.
    n_repetitions : int
        Presentations of each level.

    Returns
    -------
    list of (sums, probabilities)
        For k from 0 to all presentations: the sums that occur, increasing, and their probabilities [1].
    """
    n_answers = n_repetitions * len(scores)
    ways = np.zeros((n_answers + 1, n_repetitions * int(scores.sum()) + 1))
    ways[0, 0] = 1.0
    for score in scores.tolist():
        grown = ways.copy()
        for taken in range(1, n_repetitions + 1):
            shift = taken * score
            grown[taken:, shift:] += (
                math.comb(n_repetitions, taken) * ways[: n_answers + 1 - taken, : ways.shape[1] - shift]
            )
        ways = grown
    distributions = []
    for k in range(n_answers + 1):
        sums = np.flatnonzero(ways[k])
        distributions.append((sums.astype(np.int64), ways[k, sums] / math.comb(n_answers, k)))
    return distributions
