"""The smallest p that an experiment of a size can give, whatever its answers: below it nothing is significant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.analysis.exact import multinomial_test
from modaltouch.analysis.findings import ALPHA
from modaltouch.analysis.trend import draws_without_replacement, level_scores
from modaltouch.planning.design import Design
from modaltouch.planning.significance import trend_p

IntArray = NDArray[np.int64]

_MOST = 200
_RAREST = 4


@dataclass(frozen=True)
class Floor:
    """What a family of tests can reach.

    Attributes
    ----------
    family : str
        The family.
    n_tests : int
        Tests that Holm's method corrects together.
    n_repetitions : int
        Answers of each participant in each cell.
    least_participants : int or None
        Fewest participants with whom a test of the family can be significant after the correction; None where
        no number suffices.
    """

    family: str
    n_tests: int
    n_repetitions: int
    least_participants: int | None


def smallest_p(design: Design, family: str, n_participants: int, n_repetitions: int) -> float:
    """Return the smallest p that a test of a family can give, however the answers fall [1].

    Parameters
    ----------
    design : Design
        The cells.
    family : str
        One of `modaltouch.planning.questions.FAMILIES`.
    n_participants, n_repetitions : int
        Size of the experiment.
    """
    if family == "a1":
        return multinomial_test([n_participants, 0, 0]).p
    if family != "b":
        return 2.0 ** (1 - n_participants)
    extremes = _extreme_choices(design.levels, n_repetitions)
    if not extremes:
        return 1.0
    # All participants alike reach both tails at once; one who differs may leave the other tail out.
    chosen = [[most] * (n_participants - 1) + [one] for side in extremes for most in side for one in side]
    return float(trend_p(np.array(chosen), design.levels, n_repetitions).min())


def _extreme_choices(levels: Sequence[float], n_repetitions: int) -> list[list[IntArray]]:
    """Return the rarest ways to choose only the highest levels, and only the lowest, (n_levels,) arrays of counts."""
    laws = draws_without_replacement(level_scores(levels), n_repetitions)[1:-1]
    places = np.arange(len(levels) * n_repetitions).reshape(len(levels), n_repetitions)
    sides = []
    for order, end in ((places[::-1], -1), (places, 0)):
        rarest = np.argsort([weights[end] for _, weights in laws], kind="stable")[:_RAREST]
        sides.append([(order <= k).sum(axis=1) for k in rarest.tolist()])
    return sides if laws else []


def find_floor(design: Design, family: str, n_repetitions: int, alpha: float = ALPHA) -> Floor:
    """Return how few participants can make a family's tests significant.

    Parameters
    ----------
    design, family
        As for `smallest_p`.
    n_repetitions : int
        Answers of each participant in each cell.
    alpha : float
        Level of significance [1].
    """
    n_tests = len(design.scopes(family))
    reach = (n for n in range(1, _MOST) if smallest_p(design, family, n, n_repetitions) * n_tests <= alpha)
    least = next(reach, None) if len(design.levels) > 1 or family != "b" else None
    return Floor(family, n_tests, n_repetitions, least)
