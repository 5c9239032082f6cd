"""Exact test of a trend over levels by permutation within participants, singly or in batches.

References
----------
Pitman, J. R. Stat. Soc. Suppl. 4 (1937) 119-130 and 225-232 (randomisation tests).
Armitage, Biometrics 11 (1955) 375-386 (linear trend in proportions).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.exact import ExactTest, count_each, sum_test, whole_numbers
from modaltouch.analysis.sums import Law, Sums

IntArray = NDArray[np.int64]

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
    counts = whole_numbers(chosen, "chosen")
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
    patterns, which = np.unique(answered.reshape(-1, len(scores)), axis=0, return_inverse=True)
    which, totals = which.reshape(counts.shape[:-1]), counts.sum(axis=-1)
    scale = int(np.lcm.reduce(np.maximum(patterns.sum(axis=1), 1)))
    laws: list[Law] = []
    means: list[int] = []
    columns, observed = [], np.zeros(counts.shape[:-2], dtype=np.int64)
    for place, pattern in enumerate(patterns):
        own = draws_without_replacement(scores, pattern)[1:-1] if (scores * (pattern > 0)).any() else []
        drawn = np.arange(1, len(own) + 1)
        here = np.where(which == place, totals, 0)
        moving = (here > 0) & (here <= len(own))
        observed = observed + np.where(moving, counts @ scores, 0).sum(axis=-1)
        laws += own
        means += [scale // (len(own) + 1) * k * int(pattern @ scores) for k in drawn.tolist()]
        columns.append(count_each(here, drawn))
    return sum_test(Sums(laws, np.array(means, dtype=np.int64), scale, np.concatenate(columns, axis=1)), observed)


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

    def p(distance: NDArray[np.float64]) -> NDArray[np.float64]:
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
    laws = draws_without_replacement(level_scores(levels), n_repetitions)[1:-1]
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


def draws_without_replacement(scores: IntArray, n_repetitions: ArrayLike) -> list[Law]:
    """Return the distribution of the sum of scores of k presentations drawn without replacement, for each k.

    Parameters
    ----------
    scores : (n_levels,) array of int
        Score of each level, from zero.
    n_repetitions : int, or (n_levels,) array of int
        Number of answers at each level.

    Returns
    -------
    list of (sums, probabilities)
        For k from 0 to the number of presentations: possible sums in increasing order, and their probabilities [1].
    """
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
    distributions = []
    for k in range(n_answers + 1):
        sums = np.flatnonzero(ways[k])
        distributions.append((sums.astype(np.int64), ways[k, sums] / math.comb(n_answers, k)))
    return distributions
