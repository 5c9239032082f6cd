"""The input ranges chosen for a measurement."""

from __future__ import annotations

import pytest

from modaltouch.rig.interface import RigError
from modaltouch.rig.scope import Acquisition, Inputs

INPUTS = Inputs(sensitivity=0.05, highest_velocity=0.5, attenuation=100.0)


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
