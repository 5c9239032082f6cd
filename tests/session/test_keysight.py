"""A session with a Keysight generator: run, recorded, verified."""

from pathlib import Path

import pytest

from modaltouch.preflight import examine
from modaltouch.record.audit import audit_session
from modaltouch.record.session import Session
from modaltouch.rig.keysight33500b import KEYSIGHT_33500B
from modaltouch.session.setup import begin
from modaltouch.session.wiring import wire_run

BEAM, OTHER = "apparatus/beam_100x6x2.yaml", "apparatus/keysight_33522b.yaml"


@pytest.fixture
def session(edit, tmp_path):
    """A simulated session of the demo with a 33522B instead of the AFG3022B."""
    preflight = examine(edit("demo.yaml", (BEAM, OTHER))).require()
    return begin(wire_run(preflight, "p01", answers="simulated", results=tmp_path / "results"))


def test_a_session_runs_records_and_verifies(session):
    """All answers are recorded, with the instrument, and verification recomputes amplitudes and codes."""
    assert session.complete
    assert session.start["rig"]["identity"].split(",")[1:3] == ["33522B", "SIMULATED"]
    verdict = audit_session(Session.find(Path(session.path).parent))
    assert verdict.problems == ()
    assert verdict.lines[-1] == "complete"


def test_the_commanded_amplitude_is_that_of_the_waveform(session):
    """Sent and read-back amplitudes agree and are below the full scale, of which the waveform uses a part."""
    full = session.start["stimulus"]["amplitude_Vpp"]
    for event in session.trials:
        commanded = event["commanded"]["amplitude_Vpp"]
        assert event["confirmed"]["confirmed_amplitude"] == pytest.approx(commanded, rel=1e-4)
        assert all(part < 0.999 * whole for part, whole in zip(commanded, full, strict=True))
        assert commanded == [KEYSIGHT_33500B.converter.round_amplitude(each) for each in commanded]
