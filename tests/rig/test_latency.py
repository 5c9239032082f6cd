"""Latency of a generator's commands, measured on the twin with nothing played."""

from __future__ import annotations

from pathlib import Path

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig import Generator, Simulator
from modaltouch.rig.checklist import assess_latency

APPARATUS = Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"
GOOD = {"level_p95_ms": 2.0, "off_p95_ms": 2.0}


def test_latency_is_measured_without_motion_of_the_beam() -> None:
    """The percentiles are in ascending order, and the beam is at rest afterwards."""
    parts = Apparatus.read(APPARATUS)
    with Simulator(parts) as simulator:
        with Generator(simulator.address, parts) as rig:
            measured, verdict = rig.command_latency(10)
        assert [float(speed) for speed in simulator.felt_velocity(("A", "C"))] == [0.0, 0.0]
    for command in ("level", "off"):
        median, p95, longest = (measured[f"{command}_{name}_ms"] for name in ("median", "p95", "max"))
        assert 0 < median <= p95 <= longest
    assert measured["n"] == 10
    assert "SIMULATED" in measured["identity"]
    assert verdict == assess_latency(measured)


def test_the_verdict_on_a_latency_gives_advice() -> None:
    """A short latency is good, a long one delays every trial, and a very long one is unfit for a session."""
    assert assess_latency(GOOD).endswith("are off within 2.0 ms (95 %): good.")
    assert "begins that much later" in assess_latency(GOOD | {"level_p95_ms": 30.0})
    assert "too slow. Connect the generator directly" in assess_latency(GOOD | {"level_p95_ms": 200.0})
