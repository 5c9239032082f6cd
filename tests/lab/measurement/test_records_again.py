"""A record spoilt by a stall of the computer is repeated; no other fault is."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modaltouch.lab.laboratory import ATTEMPTS, Laboratory, MeasurementProgress
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.interface import Firing, RigError, StimulusLost
from modaltouch.rig.scope import Acquisition, Recording

APPARATUS = Apparatus.read(Path(__file__).parents[3] / "protocols" / "apparatus" / "beam_100x6x2.yaml")
SOUND = Firing((1.0, 1.0), (1.0, 1.0), 0.0, 0.001, started=True, confirmed=True)
STALLED = Firing(
    (1.0, 1.0), (1.0, 1.0), 0.0, 0.001, started=True, stalled=True, reason="this computer was held up for 1.4 s"
)
TOUCHED = Firing((1.0, 1.0), (1.0, 1.0), 0.0, 0.001, started=True, reason="SOUR1:VOLT reads 3, 6VPP was set")
REFUSED = Firing((1.0, 1.0), (), 0.0, 0.001, reason="SOUR1:FUNC reads SIN")


@dataclass
class Bench:
    """Generator and scope in one: plays the given outcomes in turn, and notes its calls."""

    ends: list[Firing]
    lost: int = 0
    done: list[str] = field(default_factory=list)
    firing: Firing | None = None
    slowest: float = 120.0

    def configure(self, acquisition: Acquisition) -> None:
        self.done.append("configure")

    def aim(self, position: float, across: float) -> None:
        self.done.append(f"aim {position:g} {across:g}")

    def fire(self, velocity: float, **options: Any) -> Firing:
        self.done.append(f"fire {velocity:g}")
        self.firing = self.ends.pop(0)
        return self.firing

    def heartbeat(self) -> None:
        """Report bursts that ended by themselves, a given number of times."""
        if self.lost:
            self.lost -= 1
            raise StimulusLost("the bursts ended before the stimulus did")

    def measure(self, position: float, across: float) -> Recording:
        self.done.append("measure")
        return Recording(position, np.zeros(2), np.zeros((1, 2)), np.zeros((1, 1, 2)), 500e3, ())

    def stop(self) -> None:
        self.done.append("stop")


def record(bench: Bench) -> Recording:
    """Take a record at 20 mm at 200 mm/s."""
    laboratory = Laboratory(APPARATUS, bench, bench, "simulated", MeasurementProgress(aim=bench.aim), 0.0, bench)
    return laboratory.record(0.02, 0.2, Acquisition(n_samples=2))


TAKEN = ["fire 0.2", "measure", "stop"]


@pytest.mark.parametrize("n_stalls", [0, 1, 2])
def test_a_record_spoilt_by_a_stall_is_repeated(n_stalls: int) -> None:
    """At the same position, at most three times; the valid record is returned."""
    bench = Bench([*[STALLED] * n_stalls, SOUND, SOUND])
    assert record(bench).position == 0.02
    assert bench.done == ["configure", "aim 0.02 0", *TAKEN * (n_stalls + 1)]


def test_a_third_stall_is_an_error() -> None:
    """The message blames the computer, not the instrument."""
    assert ATTEMPTS == 3
    bench = Bench([STALLED] * 4)
    with pytest.raises(
        RigError, match="at 20 mm the record is not valid: this computer was held up for 1.4 s; the outputs"
    ):
        record(bench)
    assert bench.done == ["configure", "aim 0.02 0", *TAKEN * 3]


@pytest.mark.parametrize(("before", "n_taken"), [([], 1), ([STALLED], 2)])
def test_a_changed_setting_is_not_repeated(before: list[Firing], n_taken: int) -> None:
    """Someone must find the cause, whether or not a stall came before."""
    bench = Bench([*before, TOUCHED, SOUND])
    with pytest.raises(RigError, match="at 20 mm the record is not valid: SOUR1:VOLT reads 3, 6VPP was set"):
        record(bench)
    assert bench.done[2:] == TAKEN * n_taken


def test_a_stimulus_that_does_not_start_is_not_repeated() -> None:
    """Nothing was played, so nothing is stopped or recorded."""
    bench = Bench([REFUSED, SOUND])
    with pytest.raises(RigError, match=r"did not confirm what it should play \(SOUR1:FUNC reads SIN\)"):
        record(bench)
    assert bench.done[2:] == ["fire 0.2"]


@pytest.mark.parametrize(("end", "n_taken"), [(STALLED, 2), (SOUND, 1)])
def test_bursts_that_ended_by_themselves_give_no_record(end: Firing, n_taken: int) -> None:
    """After a stall the record is repeated; otherwise it is refused, whatever the settings."""
    bench = Bench([end, SOUND], lost=1)
    if end is STALLED:
        assert record(bench).position == 0.02
    else:
        with pytest.raises(RigError, match="at 20 mm the record is not valid"):
            record(bench)
    assert bench.done.count("stop") == n_taken
