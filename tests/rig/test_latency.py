"""How soon a generator does as it is told: measured on the twin, with nothing played."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig import Simulator, open_rig
from modaltouch.rig.latency import CommandLatency

APPARATUS = Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"
GOOD = CommandLatency("TCPIP::x::INSTR", "TEKTRONIX,AFG3022B,1,2", 50, 0.3, 1e-3, 2e-3, 3e-3, 1e-3, 2e-3, 3e-3)


def test_the_twin_is_prompt_and_stays_silent() -> None:
    """Expected: figures in order, both outputs off before and after."""
    parts = Apparatus.read(APPARATUS)
    with Simulator(parts) as simulator:
        with open_rig(simulator.address, parts) as rig:
            measured = rig.command_latency(10)
        assert [float(speed) for speed in simulator.felt_velocity(("A", "C"))] == [0.0, 0.0]
    assert 0 < measured.level_median <= measured.level_p95 <= measured.level_max
    assert 0 < measured.off_median <= measured.off_p95 <= measured.off_max
    assert measured.as_dict()["n"] == 10
    assert "SIMULATED" in measured.identity


def test_what_a_person_should_do_is_said() -> None:
    """A prompt one is good, a slow one delays every trial, a very slow one is not for a session."""
    assert GOOD.verdict.endswith("are off within 2.0 ms (95 %): good.")
    assert "begins that much later" in replace(GOOD, level_p95=0.03).verdict
    assert "too slow. Connect the generator directly" in replace(GOOD, level_p95=0.2).verdict
