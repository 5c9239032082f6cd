"""The shipped stimulus, recorded once on the twin."""

from __future__ import annotations

from pathlib import Path

import pytest

from modaltouch.lab.laboratory import open_laboratory
from modaltouch.lab.validation import record_laws
from modaltouch.lab.validation.evidence import Evidence
from modaltouch.lab.validation.plausibility import evaluate
from modaltouch.preflight import Preflight, examine
from modaltouch.rig.simulator.motion import TrueState

PROTOCOL = Path(__file__).parents[3] / "protocols" / "differentiated_stimulation.yaml"
N_POINTS, N_RECORDS = 41, 4


@pytest.fixture(scope="session")
def preflight() -> Preflight:
    """Return the shipped protocol, examined."""
    return examine(PROTOCOL).require()


@pytest.fixture(scope="session")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder for the scans."""
    return tmp_path_factory.mktemp("validation") / "scans"


@pytest.fixture(scope="session")
def recorded(preflight: Preflight, kept: Path) -> tuple[list[Evidence], TrueState]:
    """Return the recordings, and the true state under the last law 1.6 us after the focusing instant.

    By then the voltage sent before the focusing instant has passed the twin's amplifier (1 us, 300 kHz).
    """
    with open_laboratory(preflight.experiment.apparatus) as laboratory:
        observed = record_laws(
            preflight.inputs, laboratory, 0.2, n_points=N_POINTS, n_records=N_RECORDS, folder=kept,
            source=preflight.experiment.sources.apparatus,
        )  # fmt: skip
        laboratory.load(observed[1].stimulus.burst)
        assert laboratory.rig.fire(0.2).started
        state = laboratory.simulator.true_state(0.025 + 1.53e-6)
    return observed, state


@pytest.fixture(scope="session")
def evidences(recorded: tuple[list[Evidence], TrueState]) -> list[Evidence]:
    """Return the evaluated recordings."""
    return evaluate(recorded[0])
