"""Exact test of a trend over levels, answers shuffled within participants; one test or a batch of them.

References
----------
Pitman, J. R. Stat. Soc. Suppl. 4 (1937) 119-130 and 225-232 (randomisation tests).
Armitage, Biometrics 11 (1955) 375-386 (linear trend in proportions).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.exact import ExactTest, count_each, sum_test, whole_numbers
from modaltouch.analysis.sums import Law, Sums

IntArray = NDArray[np.int64]

GRID_STEPS = 1000
"""Levels that share no coarser grid are placed on one of this many steps between the lowest and the highest."""

_RAREST = 4


def trend_test(chosen: ArrayLike, levels: Sequence[float], n_repetitions: int = 1) -> ExactTest:
    """Return the exact test of a trend over levels, answers shuffled within each participant.

    Under the null hypothesis a participant's answers have nothing to do with the level, so any assignment of
    the answers to the presentations was as likely. Participants whose answers are all the same drop out.

    Parameters
    ----------
    chosen : (..., n_participants, n_levels) array of int
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
    if counts.ndim < 2 or counts.shape[-1] != len(scores):
        raise ValueError(
            f"chosen has shape {counts.shape}, but there are {len(scores)} levels: give participants by levels"
        )
    if counts.size and (counts.min() < 0 or counts.max() > n_repetitions):
        raise ValueError(f"chosen runs from {counts.min()} to {counts.max()}, allowed are 0 to {n_repetitions}")
    totals = counts.sum(axis=-1)
    laws = draws_without_replacement(scores, n_repetitions)[1:-1] if scores.any() else []
    drawn = np.arange(1, len(laws) + 1)
    moving = (totals > 0) & (totals <= len(laws))
    observed = np.where(moving, counts @ scores, 0).sum(axis=-1)
    return sum_test(Sums(laws, drawn * scores.sum(), len(scores), count_each(totals, drawn)), observed)


def smallest_trend_p(levels: Sequence[float], n_participants: int, n_repetitions: int) -> float:
    """Return the smallest p that a trend test can give, however the answers fall [1].

    Parameters
    ----------
    levels : sequence of float
        Levels.
    n_participants, n_repetitions : int
        Participants, and presentations of each level.
    """
    extremes = _extreme_choices(levels, n_repetitions)
    # All participants alike reach both tails at once; one who differs may leave the other tail out.
    chosen = [[most] * (n_participants - 1) + [one] for side in extremes for most in side for one in side]
    return float(trend_test(np.array(chosen), levels, n_repetitions).quick_p.min()) if chosen else 1.0


def _extreme_choices(levels: Sequence[float], n_repetitions: int) -> list[list[IntArray]]:
    """Return the rarest ways to choose only the highest levels, and only the lowest, (n_levels,) arrays of counts."""
    laws = draws_without_replacement(level_scores(levels), n_repetitions)[1:-1]
    places = np.arange(len(levels) * n_repetitions).reshape(len(levels), n_repetitions)
    sides = []
    for order, end in ((places[::-1], -1), (places, 0)):
        rarest = np.argsort([weights[end] for _, weights in laws], kind="stable")[:_RAREST]
        sides.append([(order <= k).sum(axis=1) for k in rarest.tolist()])
    return sides if laws else []


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


def draws_without_replacement(scores: IntArray, n_repetitions: int) -> list[Law]:
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
