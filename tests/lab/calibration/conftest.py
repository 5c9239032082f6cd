"""A bench at the level of physics: twin and scope without the generator's commands, and a large mismatch."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modaltouch.lab.calibration import CalibrationLoop
from modaltouch.lab.calibration.file import CalibrationResult, corrected_inputs
from modaltouch.lab.laboratory import SILENT_PROGRESS
from modaltouch.preflight import Preflight, examine
from modaltouch.preflight.single_design import design_to_fit
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.apparatus_sections import TrueAmplifier
from modaltouch.rig.scope import Acquisition, Recording
from modaltouch.rig.simulator.motion import TrueState
from modaltouch.rig.simulator.scope import SimulatedScope
from modaltouch.rig.simulator.timeline import Delays, Playback, Timeline
from modaltouch.rig.simulator.twin import Twin
from modaltouch.stimulus.burst import Burst

PROTOCOL = Path(__file__).parents[3] / "protocols" / "differentiated_stimulation.yaml"

BAR = 0.3e-3
"""Of every modelled mode's velocity and w eta, read from the twin's true state [m/s]."""

LEVEL_BAR = 0.01
"""Of every level at the focus [1]."""


class TwinBench:
    """Plays on a twin and records with its scope; `amplitude_error` distorts the generator's amplitude."""

    progress = SILENT_PROGRESS

    def __init__(self, apparatus: Apparatus, seed: int, amplitude_error: Callable[[float], float] | None = None):
        self.twin = Twin(apparatus, seed)
        self.playing: tuple[Playback | None, ...] = ()
        self.n_records = 0
        self.highest_voltage = 0.0
        self.asked: list[Acquisition] = []
        self._error = amplitude_error or (lambda amplitude: 1.0)
        self._scope = SimulatedScope(self.twin, lambda: self.playing, lambda: (), Timeline(Delays()))

    def load(self, burst: Burst) -> None:
        self._burst = burst

    def play(self, burst: Burst, velocity: float) -> None:
        """Play a burst at a level."""
        first = burst.amplitude_for(velocity)[0]
        self.playing = tuple(
            Playback(
                codes.astype(">u2").tobytes(),
                amplitude * self._error(first),
                0.0,
                burst.duration,
                1 / burst.repetition_rate,
                8191,
            )
            for codes, amplitude in zip(burst.codes, burst.amplitude_for(velocity), strict=True)
        )
        for held in self.twin.held_of(self.playing):
            self.highest_voltage = max(self.highest_voltage, float(np.abs(held.voltage).max()))

    def record(self, position: float, velocity: float, acquisition: Acquisition) -> Recording:
        self.play(self._burst, velocity)
        self.n_records += 1
        self.asked.append(acquisition)
        self._scope.configure(acquisition)
        return self._scope.measure(position)

    def true_state(self, burst: Burst, velocity: float, instant: float) -> TrueState:
        """Return the true state at an instant of a burst that has been repeated for long."""
        self.play(burst, velocity)
        return self.twin.true_state(self.playing, instant)


@pytest.fixture(scope="session")
def make_bench() -> type[TwinBench]:
    """Return a function that makes a bench of an apparatus and a seed."""
    return TwinBench


@pytest.fixture(scope="session")
def preflight() -> Preflight:
    """The paper's protocol, checked."""
    return examine(PROTOCOL).require()


@pytest.fixture(scope="session")
def shipped_apparatus(preflight: Preflight) -> Apparatus:
    """The apparatus with its shipped mismatch."""
    return preflight.experiment.apparatus


def mismatched_of(shipped_apparatus: Apparatus) -> Apparatus:
    """Return the apparatus with a mismatch five times as large as shipped."""
    changed = {
        "natural_frequency_mismatch": 0.005,
        "damping_ratio_mismatch": 0.1,
        "gain_mismatch": 0.1,
        "amplifier": TrueAmplifier(bandwidth_kHz=100.0, delay_us=5.0),
    }
    return shipped_apparatus.model_copy(update={"twin": shipped_apparatus.twin.model_copy(update=changed)})


@pytest.fixture(scope="session")
def mismatched(shipped_apparatus: Apparatus) -> Apparatus:
    """The apparatus with a mismatch five times as large as shipped."""
    return mismatched_of(shipped_apparatus)


@pytest.fixture(scope="session")
def judge(preflight: Preflight) -> Callable[[TwinBench, CalibrationResult], tuple[float, float, float]]:
    """Return what judges a calibration by the twin's true state, playing the burst that a session plays.

    Largest true errors of velocity and w eta over the modes at the reference level [m/s], and the largest relative
    error of the true velocity at the focus over the levels [1].
    """

    def judged(bench: TwinBench, outcome: CalibrationResult) -> tuple[float, float, float]:
        assert preflight.inputs is not None
        stimulus = design_to_fit(corrected_inputs(preflight.inputs, outcome.refined, outcome.correction))
        assert stimulus.release == "braked"
        instant = stimulus.timing.focusing_instant
        state = bench.true_state(stimulus.burst, stimulus.target_field.velocity, instant)
        shapes = bench.twin.beam.shapes(stimulus.target_field.centre)[:, 0]
        off = []
        for level in stimulus.levels:
            true = bench.true_state(stimulus.burst, level, instant)
            velocity = float(shapes @ np.concatenate([true.velocity, true.unlisted_velocity]))
            off.append(abs(velocity / level - 1))
        return (
            float(np.abs(state.velocity - stimulus.target).max()),
            float(np.abs(state.displacement).max()),
            max(off),
        )

    return judged


@pytest.fixture
def run_seed(preflight: Preflight, mismatched: Apparatus, judge: Callable) -> Callable[[int], None]:
    """Return what calibrates one beam of that mismatch and holds it against the bars."""

    def run(seed: int) -> None:
        bench = TwinBench(mismatched, seed)
        assert preflight.inputs is not None
        outcome = CalibrationLoop(bench, mismatched, preflight.inputs).run()
        velocity, displacement, level = judge(bench, outcome)
        assert velocity <= BAR
        assert displacement <= BAR
        assert level <= LEVEL_BAR
        assert outcome.turns[-1].number <= 4
        assert outcome.turns[0].worst > 1e-3
        assert all(each.highest > 0.95 * each.velocity for each in outcome.levels)
        assert bench.highest_voltage <= mismatched.amplifier.limit_V

    return run
