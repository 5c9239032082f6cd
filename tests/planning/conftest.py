"""A design like the paper's, with given speeds instead of those that the preflight computes."""

from __future__ import annotations

import numpy as np
import pytest

from modaltouch.analysis.counts import Pair
from modaltouch.planning.design import Design

PAIRS = (("A", "C"), ("B", "D"), ("C", "E"))
LEVELS = (80.0, 100.0, 150.0, 200.0)
CONDITIONS = ("one_hand", "two_hands")
PEAKS = {"A": 0.6145, "B": 0.5745, "C": 1.0, "D": 0.5745, "E": 0.6145}
"""Peak speeds of the shipped stimulus, relative to the level."""


def make_design(
    pairs: tuple[tuple[str, str], ...] = PAIRS,
    levels: tuple[float, ...] = LEVELS,
    conditions: tuple[str, ...] = CONDITIONS,
    placements: tuple[bool, ...] = (False,),
) -> Design:
    """Return a design with the speeds of the shipped stimulus."""
    one = [[[PEAKS[left] * v * 1e-3, PEAKS[right] * v * 1e-3] for v in levels] for left, right in pairs]
    oriented = tuple(Pair.of(left, right, "C") for left, right in pairs)
    return Design("paper", conditions, oriented, levels, np.array([one] * len(conditions)), placements, margin=0.25)


@pytest.fixture
def design() -> Design:
    """The paper's design."""
    return make_design()


@pytest.fixture
def small_design() -> Design:
    """One finger condition, one pair, one level."""
    return make_design(PAIRS[:1], LEVELS[:1], CONDITIONS[:1])
