"""How soon a generator does as it is told: measured on the twin, with nothing played."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig import Generator, Simulator
from modaltouch.rig.latency import CommandLatency

APPARATUS = Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"
GOOD = CommandLatency("TCPIP::x::INSTR", "TEKTRONIX,AFG3022B,1,2", 50, {"level_p95": 2e-3, "off_p95": 2e-3})


def test_the_twin_is_prompt_and_stays_silent() -> None:
    """Expected: figures in order, both outputs off before and after."""
    parts = Apparatus.read(APPARATUS)
    with Simulator(parts) as simulator:
        with Generator(simulator.address, parts) as rig:
            measured = rig.command_latency(10)
        assert [float(speed) for speed in simulator.felt_velocity(("A", "C"))] == [0.0, 0.0]
    for command in ("level", "off"):
        median, p95, longest = (measured.times[f"{command}_{name}"] for name in ("median", "p95", "max"))
        assert 0 < median <= p95 <= longest
    assert measured.as_dict()["n"] == 10
    assert "SIMULATED" in measured.identity


def test_what_a_person_should_do_is_said() -> None:
    """A prompt one is good, a slow one delays every trial, a very slow one is not for a session."""
    assert GOOD.verdict.endswith("are off within 2.0 ms (95 %): good.")
    assert "begins that much later" in replace(GOOD, times={**GOOD.times, "level_p95": 0.03}).verdict
    assert "too slow. Connect the generator directly" in replace(GOOD, times={**GOOD.times, "level_p95": 0.2}).verdict
