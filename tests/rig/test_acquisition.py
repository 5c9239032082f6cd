"""Settings that a measurement may request, and the input ranges chosen for it."""

from __future__ import annotations

from typing import Any

import pytest

from modaltouch.rig.interface import RigError
from modaltouch.rig.scope import Acquisition, Inputs

INPUTS = Inputs(sensitivity=0.05, highest_velocity=0.5, attenuation=100.0)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"sampling_rate": 0.0}, "sampling_rate is 0.0 Hz: give a number above 0"),
        ({"sampling_rate": float("nan")}, "sampling_rate is nan"),
        ({"velocity_range": -1.0}, "velocity_range is -1.0 m/s"),
        ({"drive_range": float("inf")}, "drive_range is inf V"),
        ({"n_samples": 1}, "n_samples is 1: give at least 2"),
        ({"n_records": 0}, "n_records is 0: give at least 1"),
        ({"start": float("inf")}, "start is inf s"),
        ({"drives": (1, 1)}, r"drives are \(1, 1\): name each generator output of \(1, 2\) at most once"),
        ({"drives": (3,)}, r"drives are \(3,\)"),
    ],
)
def test_impossible_acquisitions_are_refused(asked: dict[str, Any], words: str) -> None:
    """The error states the given value and the allowed ones."""
    with pytest.raises(ValueError, match=words):
        Acquisition(**asked)


@pytest.mark.parametrize(
    ("velocity", "drive", "ranges"),
    [
        (None, None, (10.0, 20.0)),  # 500 mm/s at 50 mm/s per V are 10 V
        (0.2, 180.0, (5.0, 2.0)),  # 4 V and 1.8 V
        (0.05, 100.0, (1.0, 1.0)),  # each exactly a range
        (1e-4, 0.1, (0.05, 0.05)),  # the smallest ranges
    ],
)
def test_the_smallest_sufficient_range_is_chosen(
    velocity: float | None, drive: float | None, ranges: tuple[float, float]
) -> None:
    """By hand, with ranges of 50 mV to 20 V in steps of 1, 2, 5 (data sheet of the PicoScope 3404)."""
    assert INPUTS.ranges(Acquisition(velocity_range=velocity, drive_range=drive)) == ranges


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (Acquisition(velocity_range=0.6), "600 mm/s is to be measured, but the vibrometer's range ends at 500 mm/s"),
        (Acquisition(drive_range=2500.0), "2500 V is 25 V at the scope's input: at most 20 V"),
    ],
)
def test_signals_beyond_every_range_are_refused(asked: Acquisition, words: str) -> None:
    """The message states the requested value and the limit."""
    with pytest.raises(RigError, match=words):
        INPUTS.ranges(asked)
