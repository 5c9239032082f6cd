"""Cells of a design in the order of the analysis, with the felt speeds in each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.analysis import STATISTICS, AnswerCounts, Pair

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Design:
    """Cells of a protocol in the order of the analysis, with the speeds felt by an observer in each.

    Attributes
    ----------
    protocol : str
        Name of the protocol.
    finger_conditions : tuple of str
        Finger conditions.
    pairs : tuple of Pair
        Zone pairs, each with its dominant zone.
    levels : tuple of float
        Peak velocities, increasing [mm/s].
    speeds : (n_finger_conditions, n_pairs, n_levels, 2) array
        Speeds felt by the left and the right finger, as defined by the observer's front end [m/s].
    placements : tuple of bool
        Whether the beam is turned for the first, second, ... participant; repeated for more participants.
    stimulus : str
        Stimulus presented in the cells; empty if the protocol has only one.
    margin : float or None
        Equivalence margin of the finger conditions [1].
    """

    protocol: str
    finger_conditions: tuple[str, ...]
    pairs: tuple[Pair, ...]
    levels: tuple[float, ...]
    speeds: FloatArray
    placements: tuple[bool, ...] = (False,)
    stimulus: str = ""
    margin: float | None = None

    @property
    def title(self) -> str:
        """Name of the protocol, with the stimulus if there are several."""
        return f"{self.protocol}, stimulus {self.stimulus}" if self.stimulus else self.protocol

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of finger conditions, pairs and levels."""
        return len(self.finger_conditions), len(self.pairs), len(self.levels)

    @property
    def cells(self) -> tuple[str, ...]:
        """Finger condition of every cell, in the order of `speeds`."""
        _, n_pairs, n_levels = self.shape
        return tuple(name for name in self.finger_conditions for _ in range(n_pairs * n_levels))

    def facing(self, n_participants: int) -> FloatArray:
        """Return 1 for each participant, or -1 if the beam is turned for them, (n_participants,) array."""
        turned = np.resize(np.array(self.placements), n_participants)
        return np.where(turned, -1.0, 1.0)

    def count(self, counts: NDArray[np.int64], n_repetitions: int) -> AnswerCounts:
        """Return counts of answers in the form used by the analysis.

        Parameters
        ----------
        counts : (..., n_participants, n_finger_conditions, n_pairs, n_levels, 3) array of int
            Counts of the answers left, both and right by participant and cell, for one experiment or a batch.
        n_repetitions : int
            Answers per participant and cell.
        """
        names = tuple(f"p{number}" for number in range(1, counts.shape[-5] + 1))
        return AnswerCounts(
            names, self.finger_conditions, self.pairs, self.levels, counts, n_repetitions, margin=self.margin
        )

    @cached_property
    def tests(self) -> dict[str, list[tuple[str, str]]]:
        """Scope and quantity of each test, as worded by the analysis, by family (a key of `STATISTICS`)."""
        nothing_yet = self.count(np.zeros((1, *self.shape, 3), dtype=np.int64), 1)
        found = {family: statistic.compute(nothing_yet) for family, statistic in STATISTICS.items()}
        return {
            family: [] if result is None else list(zip(result.scopes, result.quantities, strict=True))
            for family, result in found.items()
        }

    def scopes(self, family: str) -> tuple[str, ...]:
        """Return the scope of each test of a family (a key of `STATISTICS`), as worded by the analysis."""
        return tuple(scope for scope, _ in self.tests[family])
