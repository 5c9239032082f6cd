"""Limits that no protocol can raise, and conditions for switching an output on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator import Simulator
from modaltouch.stimulus.burst import Burst


def test_voltage_limits_are_set_before_any_output_goes_on(
    generator: Generator, simulator: Simulator, burst: Burst, heard: Any, apparatus: Apparatus
) -> None:
    """VOLTage:LIMit is what the amplifier allows, 250 V / 25, and precedes the first output on."""
    generator.load(burst)
    generator.fire(0.1)
    sent = heard.sent
    first_on = next(i for i, message in enumerate(sent) if "OUTP1 ON" in message)
    for side in ("HIGH 10V", "LOW -10V"):
        assert any(f"SOUR1:VOLT:LIM:{side}" in message for message in sent[:first_on])
        assert any(f"SOUR2:VOLT:LIM:{side}" in message for message in sent[:first_on])
    assert simulator.afg.channels[1].limit_high == 10


@pytest.mark.parametrize(
    ("level", "message"),
    [
        (0.0, "0 mm/s was asked for: allowed above 0"),
        (-0.1, "-100 mm/s"),
        (math.nan, "nan mm/s"),
        (math.inf, "inf mm/s"),
        (0.6, "600 mm/s was asked for.*safety limit of 500 mm/s"),
        (0.4, "400 mm/s needs 24 V peak to peak of output 1, 300.0 V at the beam: allowed at most 250 V"),
        (0.0002, "needs 0.012 V peak to peak of output 1: allowed 0.02 to 20 V"),
    ],
)
def test_a_level_beyond_a_limit_is_refused(loaded: Generator, simulator: Simulator, level: float, message: str) -> None:
    """Limits: safety 500 mm/s, 250 V at the beam = 20 Vpp * 25 / 2, lowest amplitude 20 mVpp (apparatus, NI)."""
    with pytest.raises(RigError, match=message):
        loaded.fire(level)
    assert simulator.outputs == (False, False)


def test_a_lower_amplifier_limit_is_set_in_the_instrument(
    simulator: Simulator, apparatus: Apparatus, guard: Any, burst: Burst
) -> None:
    """With 100 V allowed at the beam the instrument itself refuses more than 4 V at its output."""
    gentle = apparatus.model_copy(update={"amplifier": apparatus.amplifier.model_copy(update={"limit_V": 100.0})})
    with Generator(simulator.address, gentle, start_guard=guard) as generator:
        generator.load(burst)
        with pytest.raises(RigError, match=r"200 mm/s needs 12 V .* 150.0 V at the beam: allowed at most 100 V"):
            generator.fire(0.2)
        assert simulator.front_panel("SOUR1:VOLT 12VPP;:SYST:ERR?").startswith("-222")


def test_a_50_ohm_load_halves_the_voltage_at_the_beam(
    simulator: Simulator, apparatus: Apparatus, guard: Any, burst: Burst
) -> None:
    """20 Vpp at the generator are 125 V at the beam, which is allowed."""
    terminated = apparatus.model_copy(update={"generator": apparatus.generator.model_copy(update={"load": "50_ohm"})})
    strong = replace(burst, amplitude=(20.0, 8.0))
    with Generator(simulator.address, terminated, start_guard=guard) as generator:
        generator.load(strong)
        assert generator.fire(0.2).started


@pytest.mark.parametrize(("end", "code"), [(0, 8191 + 100), (-1, 8191 - 100)])
def test_a_burst_that_begins_or_ends_with_a_step_is_refused(
    loaded: Generator, simulator: Simulator, burst: Burst, end: int, code: int
) -> None:
    """A record must begin and end within 1 % of full scale of 0 V; otherwise it is not loaded."""
    codes = burst.codes.copy()
    codes[1, end] = code
    with pytest.raises(RigError, match="output 2 begins or ends at 1.2% of its full scale: at most 1% is allowed"):
        loaded.load(replace(burst, codes=codes))
    with pytest.raises(RigError, match="before a burst was loaded"):
        loaded.fire(0.1)
    assert simulator.outputs == (False, False)


def test_a_burst_of_one_channel_is_refused(generator: Generator, make: Callable[..., Burst]) -> None:
    """The generator has two outputs and one trigger, and needs a record for each."""
    with pytest.raises(RigError, match="the burst has 1 channels: the generator has 2"):
        generator.load(make(amplitude=(10.0,)))


def test_fire_before_load_is_refused(generator: Generator, heard: Any) -> None:
    """No output is switched on."""
    with pytest.raises(RigError, match="fire was called before a burst was loaded and verified"):
        generator.fire(0.1)
    assert not any("ON" in message for message in heard.sent)


def test_fire_after_a_failed_load_is_refused(
    generator: Generator, simulator: Simulator, burst: Burst, heard: Any
) -> None:
    """A record that could not be verified does not count as loaded, even if the caller ignores the error."""
    simulator.faults.inject("garbled_upload", when="DATA EMEM,", times=99)
    with pytest.raises(RigError, match="does not hold the record that was sent"):
        generator.load(burst)
    with pytest.raises(RigError, match="before a burst was loaded and verified"):
        generator.fire(0.1)
    assert not any("OUTP1 ON" in message for message in heard.sent)
    simulator.faults.clear()
    generator.load(burst)
    assert generator.fire(0.1).started


@pytest.mark.parametrize("erased", ["nothing", "the memories too"])
def test_after_a_power_cycle_no_output_is_on_until_all_is_verified(
    loaded: Generator, simulator: Simulator, heard: Any, erased: str
) -> None:
    """The first firing is not confirmed; the records are read back or sent before the next one."""
    simulator.power_cycle()
    if erased == "the memories too":
        simulator.front_panel("DATA:LOCK USER1,OFF;LOCK USER2,OFF;DEL USER1;DEL USER2")
    assert not loaded.fire(0.1).started
    assert not any("OUTP1 ON" in message for message in heard.sent)
    assert len(heard.of("record_sent" if erased == "the memories too" else "record_found")) == 2
    assert loaded.fire(0.1).started
