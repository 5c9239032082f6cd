"""The questions of the analysis, asked of thousands of simulated experiments at once.

Family by family the same tests, in the same order, with the same correction as `modaltouch.analysis.statistics`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis import CONFIDENCE
from modaltouch.planning.design import Design
from modaltouch.planning.significance import multinomial_p, sign_flip_p, trend_p

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

_BISECTIONS = 28
"""Halve the range until a bound is known to 1e-8."""


def difference_width(first: ArrayLike, second: ArrayLike, n_answers: int) -> FloatArray:
    """Return half the widths of `modaltouch.analysis.intervals.clustered_difference`, (...,) array [1].

    Parameters
    ----------
    first, second : (..., n_participants) arrays
        How many of each participant's answers count only for the first, and only for the second.
    n_answers : int
        Answers per participant.
    """
    b, c = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    n, total = b.shape[-1], float(b.shape[-1] * n_answers)
    only_first, only_second = b.sum(axis=-1), c.sum(axis=-1)
    difference = (only_first - only_second) / total
    single = (only_first + only_second) / total - difference**2
    net = (b - c) / n_answers
    between = net.var(axis=-1, ddof=1) / n if n > 1 else np.full(difference.shape, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        worth = np.where(between > 0, single / between, total)
    effective = np.where(single <= 1e-12, n, np.clip(worth, n, total))
    share = effective / total
    return tango_width(only_first * share, only_second * share, effective)


def slope_width(shares: ArrayLike, levels: Sequence[float]) -> FloatArray:
    """Return half the widths of the 95 % intervals of mean slopes per 100 mm/s of the level, (...,) array [1].

    Parameters
    ----------
    shares : (..., n_participants, n_levels) array
        Share of one answer at each level [1].
    levels : sequence of float
        Levels [mm/s], two or more.
    """
    centred = np.asarray(levels, dtype=float) - np.mean(levels)
    weights = 100 * centred / (centred**2).sum()
    steepest = float(weights[weights > 0].sum())
    slopes = np.asarray(shares, dtype=float) @ weights / steepest
    rising, falling = np.maximum(slopes, 0).sum(axis=-1), np.maximum(-slopes, 0).sum(axis=-1)
    return tango_width(rising, falling, np.full(rising.shape, slopes.shape[-1])) * steepest


def share_width(successes: IntArray, n: IntArray) -> FloatArray:
    """Return half the widths of the exact intervals of proportions.

    Parameters
    ----------
    successes, n : arrays of int
        Successes out of n; n may be zero.
    """
    from scipy.special import betaincinv

    tail = (1 - CONFIDENCE) / 2
    k, m = np.asarray(successes, dtype=float), np.asarray(n, dtype=float)
    low = np.where(k > 0, betaincinv(np.maximum(k, 1), m - k + 1, tail), 0.0)
    high = np.where(k < m, betaincinv(k + 1, np.maximum(m - k, 1), 1 - tail), 1.0)
    return np.asarray((high - low) / 2)


def tango_width(only_first: FloatArray, only_second: FloatArray, n: ArrayLike) -> FloatArray:
    """Return half the widths of Tango's intervals of paired differences.

    Parameters
    ----------
    only_first, only_second : arrays
        Pairs that succeeded only the first way, and only the second way; need not be whole.
    n : array
        Numbers of pairs.
    """
    z = NormalDist().inv_cdf(1 - (1 - CONFIDENCE) / 2)
    pairs = np.asarray(n, dtype=float)
    upper, lower = (_bound(only_first, only_second, pairs, z, end) for end in (1.0, -1.0))
    return np.asarray((upper - lower) / 2)


def _bound(b: FloatArray, c: FloatArray, n: FloatArray, z: float, end: float) -> FloatArray:
    """Return where the score statistic reaches z, between the estimate and an end, by bisection."""
    inside = (b - c) / n
    outside = np.full(inside.shape, end)
    for _ in range(_BISECTIONS):
        middle = (inside + outside) / 2
        linear = (2 * n - b + c) * middle - b - c
        # The likeliest probability of a pair of the second kind, given the difference (Tango, eq. 10).
        constant = -c * middle * (1 - middle)
        q = (np.sqrt(np.maximum(linear * linear - 8 * n * constant, 0.0)) - linear) / (4 * n)
        spread = n * np.maximum(2 * q + middle * (1 - middle), 0.0)
        too_far = np.abs(b - c - n * middle) > z * np.sqrt(spread)
        outside = np.where(too_far, middle, outside)
        inside = np.where(too_far, inside, middle)
    return np.asarray((inside + outside) / 2)


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
class SimulatedAnswers:
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
        is_left = [(pair.dominant == pair.left) == dominant for pair in self.design.pairs]
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


def p_values(answers: SimulatedAnswers, family: str) -> FloatArray:
    """Return the two-sided p of a family's exact tests, (n_experiments, n_tests) array as in `Design.scopes` [1].

    Parameters
    ----------
    answers : SimulatedAnswers
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


def half_widths(answers: SimulatedAnswers, family: str) -> FloatArray:
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


def _compared(answers: SimulatedAnswers, family: str) -> tuple[IntArray, IntArray]:
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
