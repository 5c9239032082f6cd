"""The cells of a design, in the order of the analysis, and what fingers feel in them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from modaltouch.analysis import Pair

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Design:
    """The cells of a protocol, in the order of the analysis, and what an observer's fingers feel in them.

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
        What the left and the right finger feel, by the observer's front end [m/s].
    placements : tuple of bool
        Whether the beam is turned for the first, second, ... participant; repeated for more participants.
    stimulus : str
        Which of several stimuli the cells are presented with; empty where the protocol has one.
    """

    protocol: str
    finger_conditions: tuple[str, ...]
    pairs: tuple[Pair, ...]
    levels: tuple[float, ...]
    speeds: FloatArray
    placements: tuple[bool, ...] = (False,)
    stimulus: str = ""

    @property
    def title(self) -> str:
        """The protocol, and the stimulus where it has several."""
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
        """Return 1 for each participant who sees the beam as it is, -1 where it is turned, (n_participants,) array."""
        turned = np.resize(np.array(self.placements), n_participants)
        return np.where(turned, -1.0, 1.0)

    def scopes(self, family: str) -> tuple[str, ...]:
        """Return what each test of a family, one of `FAMILIES`, is about, worded as in the analysis."""
        fingers, labels = self.finger_conditions, [pair.label for pair in self.pairs]
        if family == "a1":
            return tuple(f"{f} {q} {v:g} mm/s" for f, q, v in product(fingers, labels, self.levels))
        if family in ("a2", "b"):
            return tuple(f"{f} {q}" for f, q in product(fingers, labels))
        if family == "d":
            return tuple(f"{f} {q} - {r}" for f in fingers for q, r in combinations(labels, 2))
        return tuple(f"{f} - {g} {q}" for (f, g), q in product(combinations(fingers, 2), labels))

    def without_differences(self) -> Design:
        """Return the design with both fingers feeling alike everywhere: nothing is there to be found."""
        alike = np.full_like(self.speeds, float(self.speeds.mean()))
        return replace(self, speeds=alike)
