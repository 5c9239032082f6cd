"""Amplitudes in three units at the load that is set for a channel, against standard conversions."""

from __future__ import annotations

import pytest

from modaltouch.rig.simulator import Simulator


@pytest.mark.parametrize(
    ("setting", "vpp"),
    [
        ("FUNC SIN;:SOUR1:VOLT 0.5VRMS", 1.41421),  # 2 sqrt 2
        ("FUNC SQU;:SOUR1:VOLT 0.5VRMS", 1.0),  # 2
        ("FUNC RAMP;:SOUR1:VOLT 500mVRMS", 1.73205),  # 2 sqrt 3
        ("FUNC SIN;:SOUR1:VOLT 0DBM", 0.632456),  # 1 mW into 50 ohm: 223.6 mV rms
        ("FUNC SIN;:SOUR1:VOLT 13.0103DBM", 2.82843),  # 20 mW: 1 V rms
        ("FUNC SIN;:SOUR1:VOLT:UNIT VRMS;:SOUR1:VOLT 1.0E0", 2.82843),
        ("FUNC SIN;:SOUR1:VOLT:UNIT VRMS;:SOUR1:VOLT 1V", 1.0),
        ("FUNC SIN;:SOUR1:VOLT:UNIT DBM;:SOUR1:VOLT 1500 mVpp", 1.5),
    ],
)
def test_an_amplitude_is_converted_from_its_unit(simulator: Simulator, setting: str, vpp: float) -> None:
    """Read back in volts peak to peak: sine, square and ramp by their crest factors."""
    simulator.front_panel(f"SOUR1:{setting};:SOUR1:VOLT:UNIT VPP")
    assert simulator.front_panel("SYST:ERR?") == '0,"No error"'
    assert float(simulator.front_panel("SOUR1:VOLT?")) == pytest.approx(vpp, rel=5e-4)


@pytest.mark.parametrize(("unit", "answer"), [("VPP", 1.0), ("VRMS", 0.353553), ("DBM", 3.9794)])
def test_an_amplitude_is_returned_in_the_channels_unit(simulator: Simulator, unit: str, answer: float) -> None:
    """A sine of 1 Vpp into 50 ohm: 353.6 mV rms, 2.5 mW."""
    simulator.front_panel(f"SOUR1:FUNC SIN;:SOUR1:VOLT 1VPP;:SOUR1:VOLT:UNIT {unit}")
    assert float(simulator.front_panel("SOUR1:VOLT?")) == pytest.approx(answer, rel=1e-3)


@pytest.mark.parametrize(
    ("setting", "error"),
    [
        ("OUTP1:IMP INF;:SOUR1:VOLT 0DBM", '-221,"Settings conflict; no power goes into an open circuit'),
        ("SOUR1:FUNC PULS;:SOUR1:VOLT 1VRMS", '-221,"Settings conflict; PULS has no amplitude in VRMS'),
        ("SOUR1:VOLT 5VRMS", "-222"),
        ("SOUR1:VOLT 1HZ", "-131"),
    ],
)
def test_an_impossible_amplitude_is_an_error(simulator: Simulator, setting: str, error: str) -> None:
    """Conflict, range and foreign unit have their standard numbers; the level does not change."""
    simulator.front_panel(setting)
    assert simulator.front_panel("SYST:ERR?").startswith(error)
    assert simulator.afg.channels[1].amplitude == 2.0
