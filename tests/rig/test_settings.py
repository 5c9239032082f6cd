"""Settings as commands and queries, and what confirms them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from modaltouch.apparatus import Apparatus
from modaltouch.rig.interface import RigError
from modaltouch.rig.settings import Limits, Setting, amplitudes, record_peaks
from modaltouch.stimulus.burst import Burst


@pytest.mark.parametrize(
    ("setting", "command"),
    [
        (Setting("SOUR1:FREQ", 20.0, "HZ"), "SOUR1:FREQ 20HZ"),
        (Setting("SOUR1:VOLT", 1.234, "VPP"), "SOUR1:VOLT 1.234VPP"),
        (Setting("TRIG:TIM", 1 / 7, "S"), "TRIG:TIM 0.142857142857S"),
        (Setting("OUTP1", "ON"), "OUTP1 ON"),
    ],
)
def test_command_carries_value_and_unit(setting: Setting, command: str) -> None:
    """Twelve digits, the most that the instrument takes; the unit always, since the front panel has its own."""
    assert setting.command == command
    assert setting.query == command.split(" ")[0] + "?"


@pytest.mark.parametrize(
    ("setting", "reply", "confirmed"),
    [
        (Setting("SOUR1:VOLT", 1.234, "VPP"), "1.2340E+00", True),
        (Setting("SOUR1:VOLT", 1.234, "VPP"), "1.2350E+00", False),
        (Setting("SOUR1:VOLT", 1.234, "VPP"), "", False),
        (Setting("SOUR1:VOLT:OFFS", 0.0, "V"), "0.0000E+00", True),
        (Setting("SOUR1:VOLT:OFFS", 0.0, "V"), "1.0E-03", False),
        (Setting("OUTP1:IMP", "INF"), "9.9E+37", True),
        (Setting("OUTP1:IMP", "INF"), "5.0E+01", False),
        (Setting("OUTP1", "ON"), "1", True),
        (Setting("OUTP1", "ON"), "0", False),
        (Setting("SOUR1:FUNC", "USER1"), "USER", True),
        (Setting("SOUR1:FUNC", "USER2"), "USER", False),
        (Setting("TRIG:SOUR", "EXT"), "EXTERNAL", True),
        (Setting("TRIG:TIM", 1 / 7, "S", tolerance=5e-4), "1.429E-01", True),
        (Setting("TRIG:TIM", 1 / 7, "S", tolerance=5e-4), "1.43E-01", False),
        (Setting("SOUR1:FREQ", 20.0, "HZ", tolerance=1e-6), "20.0001", False),
    ],
)
def test_reply_confirms_or_does_not(setting: Setting, reply: str, confirmed: bool) -> None:
    """Tolerances: 1e-4 for levels on a grid of four digits, 5e-4 for a timer of four digits, 1e-6 for the rate."""
    assert setting.confirmed_by(reply) is confirmed


@pytest.mark.parametrize(
    ("limit", "gain", "level"), [(250.0, 25.0, 10.0), (100.0, 25.0, 4.0), (100.0, 30.0, 3.33), (1000.0, 25.0, 10.0)]
)
def test_level_limit_is_what_the_amplifier_allows(
    apparatus: Apparatus, limit: float, gain: float, level: float
) -> None:
    """Volts at the beam over the gain, rounded down to 10 mV, at most the instrument's own 10 V."""
    amplifier = apparatus.amplifier.model_copy(update={"limit_V": limit, "gain_V_per_V": gain})
    assert Limits.of(apparatus.model_copy(update={"amplifier": amplifier})).level == pytest.approx(level)


def test_peak_of_the_record_counts_at_the_beam(apparatus: Apparatus, burst: Burst) -> None:
    """A record that uses half the codes reaches half the volts: allowed where a full one is not."""
    limits = replace(Limits.of(apparatus), beam=100.0, level=10.0)
    half = replace(burst, codes=((burst.codes.astype(int) - 8191) // 2 + 8191).astype("uint16"))
    with pytest.raises(RigError, match="150.0 V at the beam: allowed at most 100 V"):
        amplitudes(burst, record_peaks(burst), 0.2, limits)
    assert amplitudes(half, record_peaks(half), 0.2, limits) == (12.0, 8.0)
