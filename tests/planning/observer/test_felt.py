"""Speeds at the fingers on the shipped beam, against the preflight and the velocity history."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from forward import velocity_history

from modaltouch.planning.felt import felt_per_level, sense
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol.trial import Condition, Trial

ZONES = {"A": -0.04, "B": -0.02, "C": 0.0, "D": 0.02, "E": 0.04}


@pytest.fixture(scope="module")
def preflight() -> Preflight:
    """The paper's protocol, examined."""
    shipped = Path(__file__).parents[3] / "protocols"
    return examine(shipped / "differentiated_stimulation.yaml").require()


def test_the_peak_agrees_with_the_preflight(preflight: Preflight) -> None:
    """It agrees within 1e-3; the difference is the generator's amplitude resolution of four digits."""
    felt = felt_per_level(preflight.stimulus, ZONES, "peak")
    for level in (80.0, 200.0):
        left, right = preflight.speeds(Trial(1, 1, Condition("one_hand", "A", "C", level)))
        assert felt["A"] * level * 1e-3 == pytest.approx(left, rel=1e-3)
        assert felt["C"] * level * 1e-3 == pytest.approx(right, rel=1e-3)


def test_only_the_focus_moves_at_the_focusing_instant(preflight: Preflight) -> None:
    """C moves at the level, A less than 1 % of it, since A and E lie outside the triangle of 56 mm."""
    felt = felt_per_level(preflight.stimulus, ZONES, "peak_at_focus")
    assert felt["C"] == pytest.approx(1.0, rel=1e-3)
    assert felt["A"] < 0.01 * felt["C"]


def test_other_front_ends_use_a_whole_repetition(preflight: Preflight) -> None:
    """The value is that of the front end applied to the history computed here over a seventh of a second."""
    stimulus = preflight.stimulus
    timing, level = stimulus.timing, 0.1
    voltage = np.zeros((2, int(timing.sampling_rate / 7)))
    voltage[:, : timing.n_samples] = stimulus.voltage_played(level)
    history = velocity_history(stimulus.model, voltage, timing, [0.0], stimulus.amplifier)
    expected = sense("rms", history, timing.sampling_rate)[0]
    assert felt_per_level(stimulus, {"C": 0.0}, "rms")["C"] * level == pytest.approx(expected, rel=1e-3)
