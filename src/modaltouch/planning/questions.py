"""The questions of the analysis, asked of thousands of simulated experiments at once.

Family by family the same tests, in the same order, with the same correction as `modaltouch.analysis.questions`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from modaltouch.analysis.counts import LEFT
from modaltouch.planning.design import Design
from modaltouch.planning.precision import difference_width, share_width, slope_width
from modaltouch.planning.significance import multinomial_p, sign_flip_p, trend_p

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

FAMILIES = {
    "a1": "does a cell differ from guessing",
    "a2": "is one zone chosen more than the other",
    "b": "does the choice of the dominant zone change with the level",
    "c": "does the choice of the dominant zone differ between finger conditions",
    "c both": 'does "both" differ between finger conditions',
    "d": 'is "both" answered more often for one pair than for another',
}
"""Tests corrected together by Holm's method, as in the analysis, and what they ask."""

CONFIRMED = ("a2", "b", "c", "d")
"""The families with the 21 tests of the paper's design."""


@dataclass(frozen=True, eq=False)
class Answers:
    """Answers of simulated experiments.

    Attributes
    ----------
    left, right : (n_experiments, n_participants, n_finger_conditions, n_pairs, n_levels) arrays of int
        How often each participant named one side of the beam in each cell; the rest is both.
    n_repetitions : int
        Answers of each participant in each cell.
    design : Design
        The cells.
    """

    left: IntArray
    right: IntArray
    n_repetitions: int
    design: Design

    @property
    def n_answers(self) -> int:
        """Answers of each participant to one pair under one finger condition."""
        return self.n_repetitions * len(self.design.levels)

    @cached_property
    def both(self) -> IntArray:
        """Counts of both, with participants moved behind the pairs."""
        return self.n_repetitions - np.moveaxis(self.left + self.right, 1, 3)

    @cached_property
    def dominant(self) -> IntArray:
        """Counts of the dominant zone of each pair, with participants moved behind the pairs."""
        return self._of_pairs(dominant=True)

    @cached_property
    def other(self) -> IntArray:
        """Counts of the other zone of each pair, with participants moved behind the pairs."""
        return self._of_pairs(dominant=False)

    def _of_pairs(self, *, dominant: bool) -> IntArray:
        left, right = np.moveaxis(self.left, 1, 3), np.moveaxis(self.right, 1, 3)
        is_left = [(pair.dominant_index == LEFT) == dominant for pair in self.design.pairs]
        return np.where(np.array(is_left)[:, None, None], left, right)

    @cached_property
    def modal(self) -> IntArray:
        """Participants whose most frequent answer was the other zone, both, the dominant one; ties left out.

        Shape (n_experiments, n_finger_conditions, n_pairs, n_levels, 3).
        """
        other, both, dominant = self.other, self.both, self.dominant
        most = (
            other > np.maximum(both, dominant),
            both > np.maximum(other, dominant),
            dominant > np.maximum(other, both),
        )
        return np.stack([each.sum(axis=3) for each in most], axis=-1)


def p_values(answers: Answers, family: str) -> FloatArray:
    """Return the two-sided p of a family's exact tests, (n_experiments, n_tests) array as in `Design.scopes` [1].

    Parameters
    ----------
    answers : Answers
        Simulated experiments.
    family : str
        One of `FAMILIES`.
    """
    n_experiments = len(answers.left)
    if family == "a1":
        p = multinomial_p(answers.modal)
    elif family == "a2":
        p = sign_flip_p((answers.dominant - answers.other).sum(axis=-1))
    elif family == "b":
        p = trend_p(answers.dominant, answers.design.levels, answers.n_repetitions)
    else:
        first, second = _compared(answers, family)
        p = sign_flip_p((first - second).sum(axis=-1))
    return p.reshape(n_experiments, -1)


def half_widths(answers: Answers, family: str) -> FloatArray:
    """Return half the widths of the 95 % intervals that the analysis prints beside the tests of a family.

    Parameters
    ----------
    answers, family
        As for `p_values`.

    Returns
    -------
    (n_experiments, n_tests) array
        Of a share (a1), of a difference of shares (a2, c, d) [1], or of a slope per 100 mm/s (b); not a number
        where there is no interval.
    """
    n_experiments, n_repetitions = len(answers.left), answers.n_repetitions
    if family == "a1":
        modal = answers.modal
        widths = share_width(modal[..., 2], modal.sum(axis=-1))
    elif family == "a2":
        widths = difference_width(answers.dominant.sum(axis=-1), answers.other.sum(axis=-1), answers.n_answers)
    elif family == "b":
        levels = answers.design.levels
        chosen = answers.dominant
        widths = slope_width(chosen / n_repetitions, levels) if len(levels) > 1 else np.full(chosen.shape[:3], np.nan)
    else:
        first, second = _compared(answers, family)
        # Repetitions have no natural partner, so every pairing is averaged.
        only_first = (first * (n_repetitions - second)).sum(axis=-1) / n_repetitions
        only_second = (second * (n_repetitions - first)).sum(axis=-1) / n_repetitions
        widths = difference_width(only_first, only_second, answers.n_answers)
    return widths.reshape(n_experiments, -1)


def _compared(answers: Answers, family: str) -> tuple[IntArray, IntArray]:
    """Return the counts that the tests of a family compare, (n_experiments, n_tests, n_participants, n_levels)."""
    n_fingers, n_pairs, _ = answers.design.shape
    if family == "d":
        chosen = answers.both
        places = [((f, q), (f, r)) for f in range(n_fingers) for q, r in combinations(range(n_pairs), 2)]
    else:
        chosen = answers.dominant if family == "c" else answers.both
        places = [((f, q), (g, q)) for f, g in combinations(range(n_fingers), 2) for q in range(n_pairs)]
    first, second = ([side[i] for side in places] for i in (0, 1))
    return tuple(np.stack([chosen[:, f, q] for f, q in side], axis=1) for side in (first, second))  # type: ignore[return-value]
