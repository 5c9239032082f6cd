"""Settings as commands and queries, and the replies that confirm them."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import modaltouch.rig
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig import instrument_of, instruments
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.instrument import Limits, Setting
from modaltouch.rig.interface import RigError
from modaltouch.rig.keysight33500b import KEYSIGHT_33500B
from modaltouch.rig.player import _refuse_steps as refuse_steps
from modaltouch.stimulus.burst import Burst

TABLE = AFG3022B.commands
ON = TABLE.output.filled(channel=1)
OFF = ON.off
QUIET = [entry.filled(channel=1) for entry in TABLE.quiet]
BURST = [entry.filled(channel=1, memory=1) for entry in (*TABLE.burst, *TABLE.triggered)]


@pytest.mark.parametrize(
    ("setting", "command"),
    [
        (Setting("SOUR1:FREQ", 20.0, "HZ"), "SOUR1:FREQ 20HZ"),
        (Setting("SOUR1:VOLT", 1.234, "VPP"), "SOUR1:VOLT 1.234VPP"),
        (Setting("TRIG:TIM", 1 / 7, "S"), "TRIG:TIM 0.142857142857S"),
        (Setting("OUTP1", "ON"), "OUTP1 ON"),
    ],
)
def test_a_command_has_value_and_unit(setting: Setting, command: str) -> None:
    """Twelve digits, the most that the instrument accepts; always with a unit, since the front panel has its own."""
    assert setting.command == command
    assert setting.query == command.split(" ")[0] + "?"


@pytest.mark.parametrize(
    ("setting", "reply", "confirmed"),
    [
        (Setting("SOUR1:VOLT", 1.234, "VPP"), "1.2340E+00", True),
        (Setting("SOUR1:VOLT", 1.234, "VPP"), "1.2350E+00", False),
        (Setting("SOUR1:VOLT", 1.0, "VPP"), "1.00009", True),
        (Setting("SOUR1:VOLT", 1.0, "VPP"), "1.00015", False),
        (Setting("SOUR1:VOLT", 1.234, "VPP"), "", False),
        (Setting("SOUR1:VOLT:OFFS", 0.0, "V"), "0.0000E+00", True),
        (Setting("SOUR1:VOLT:OFFS", 0.0, "V"), "1.5E-04", False),
        (Setting("SOUR1:VOLT:OFFS", 0.0, "V"), "0.9E-04", True),
        (Setting("OUTP1:IMP", "INF"), "9.9E+37", True),
        (Setting("OUTP1:IMP", "INF"), "5.0E+01", False),
        (ON, "1", True),
        (ON, "0", False),
        (ON, "on", True),
        (OFF, "0", True),
        (OFF, "1", False),
        (OFF, "Off", True),
        (Setting("SOUR1:FUNC:ARB", "mt2"), "MT2", True),
        (QUIET[1], "NORMAL", True),
        (QUIET[1], "INV", False),
        (BURST[2], "TRIGGERED", True),
        (BURST[2], "GATED", False),
        (TABLE.armed, "TIMER", True),
        (TABLE.armed, "EXTERNAL", False),
        (Setting("OUTP1:IMP", "INF"), "8.0E+37", False),
        (BURST[1], "USER", True),
        (replace(BURST[1], value="USER2"), "USER", False),
        (TABLE.stopped, "EXTERNAL", True),
        (Setting("TRIG:TIM", 1 / 7, "S", tolerance=5e-4), "1.429E-01", True),
        (Setting("TRIG:TIM", 1 / 7, "S", tolerance=5e-4), "1.43E-01", False),
        (Setting("SOUR1:FREQ", 20.0, "HZ", tolerance=1e-6), "20.0001", False),
    ],
)
def test_a_reply_confirms_a_setting_within_its_tolerance(setting: Setting, reply: str, confirmed: bool) -> None:
    """Tolerances: 1e-4 for levels on a grid of four digits, 5e-4 for a timer of four digits, 1e-6 for the rate."""
    assert setting.confirmed_by(reply) is confirmed


def limits_of(apparatus: Apparatus) -> Limits:
    """Return the limits that an apparatus sets to its generator."""
    return instrument_of(apparatus).limits(apparatus)


@pytest.mark.parametrize(
    ("limit", "gain", "level"),
    [(250.0, 25.0, 10.0), (100.0, 25.0, 4.0), (100.0, 30.0, 3.33), (1000.0, 25.0, 10.0), (145.0, 500.0, 0.29)],
)
def test_the_level_limit_follows_the_amplifier(apparatus: Apparatus, limit: float, gain: float, level: float) -> None:
    """Volts at the beam over the gain, rounded down to 10 mV, at most the instrument's own 10 V."""
    amplifier = apparatus.amplifier.model_copy(update={"limit_V": limit, "gain_V_per_V": gain})
    assert limits_of(apparatus.model_copy(update={"amplifier": amplifier})).level == pytest.approx(level)


def test_limits_of_the_shipped_apparatus(apparatus: Apparatus) -> None:
    """250 V at the beam with a gain of 25, and 500 mm/s; into 50 ohm the voltage is halved."""
    assert limits_of(apparatus) == Limits(AFG3022B, level=10.0, beam=250.0, gain=25.0, velocity=0.5)
    terminated = apparatus.model_copy(update={"generator": apparatus.generator.model_copy(update={"load": "50_ohm"})})
    assert limits_of(terminated) == Limits(AFG3022B, level=10.0, beam=250.0, gain=12.5, velocity=0.5)


WIDE = Limits(AFG3022B, level=10.0, beam=1000.0, gain=25.0, velocity=0.5)
"""Only the generator's own limits."""


def strong(burst: Burst, amplitude: float, limits: Limits = WIDE) -> tuple[float, ...]:
    """Return the amplitudes at 200 mm/s of a burst with a given amplitude on its first channel."""
    return limits.amplitudes(full(burst, (amplitude, 8.0)), 0.2)


def full(burst: Burst, amplitude: tuple[float, float]) -> Burst:
    """Return a burst whose records use all codes."""
    codes = burst.codes.copy()
    codes[:, 1] = 16382
    return replace(burst, codes=codes, amplitude=amplitude)


@pytest.mark.parametrize(
    ("amplitude", "limits", "refusal"),
    [
        (20.0, WIDE, ""),
        (20.01, WIDE, r"needs 20.01 V peak to peak of output 1: allowed 0.02 to 20 V"),
        (0.02, WIDE, ""),
        (0.0199, WIDE, r"needs 0.0199 V peak to peak of output 1: allowed 0.02 to 20 V"),
        (12.0, replace(WIDE, level=6.0), ""),
        (12.01, replace(WIDE, level=6.0), r"allowed 0.02 to 12 V"),
        (12.0, replace(WIDE, beam=150.0), ""),
        (12.0, replace(WIDE, beam=150.0 * (1 - 1.5e-9)), "150.0 V at the beam: allowed at most 150 V"),
        (12.01, replace(WIDE, beam=150.0), r"150.1 V at the beam: allowed at most 150 V; the outputs stay off"),
        (12.01, replace(WIDE, beam=75.0, gain=12.5), r"75.1 V at the beam: allowed at most 75 V"),
    ],
)
def test_amplitudes_are_limited_by_generator_and_amplifier(
    burst: Burst, amplitude: float, limits: Limits, refusal: str
) -> None:
    """20 mV to 20 V peak to peak open circuit; half of it times the gain at the beam; the limit itself is allowed."""
    if not refusal:
        assert strong(burst, amplitude, limits) == (amplitude, 8.0)
        return
    with pytest.raises(RigError, match=refusal):
        strong(burst, amplitude, limits)


def test_the_second_output_is_limited_like_the_first(burst: Burst) -> None:
    """8 Vpp of output 2 at a level limit of 3.9 V, while output 1 needs only 1 Vpp."""
    with pytest.raises(RigError, match="needs 8 V peak to peak of output 2: allowed 0.02 to 7.8 V"):
        strong(burst, 1.0, replace(WIDE, level=3.9))


@pytest.mark.parametrize("velocity", [0.0, -0.1, 0.5001, 1.0, math.nan, math.inf])
def test_no_velocity_beyond_the_safety_limit_is_played(burst: Burst, velocity: float) -> None:
    """Above 0 and up to 500 mm/s, whatever generator and amplifier permit."""
    low = full(burst, (1.0, 1.0))
    assert WIDE.amplitudes(low, 0.5) == (2.5, 2.5)
    with pytest.raises(RigError, match="allowed above 0, up to the safety limit of 500 mm/s; the outputs stay off"):
        WIDE.amplitudes(low, velocity)


@pytest.mark.parametrize(("level", "quiet"), [(10.0, 0.1), (0.05, 0.1), (0.03, 0.06)])
def test_a_channel_without_drive_has_a_low_level(burst: Burst, level: float, quiet: float) -> None:
    """0.1 V peak to peak, or twice the level where that is less."""
    silent = replace(burst, codes=np.full_like(burst.codes, 8191), amplitude=(0.0, 0.0))
    limits = replace(WIDE, level=level)
    assert limits.amplitudes(silent, 0.2) == pytest.approx((quiet, quiet))
    setting = next(each for each in limits.quiet_settings(1) if each.header == "SOUR1:VOLT")
    assert setting.value == pytest.approx(quiet)


@pytest.mark.parametrize(("place", "code"), [(0, 81), (0, -81), (-1, 81), (-1, -81)])
def test_a_record_begins_and_ends_within_1_percent_of_full_scale(burst: Burst, place: int, code: int) -> None:
    """81 of 8191 codes are 0.99 %, 82 are 1.001 %, either sign, at either end."""
    codes = burst.codes.copy()
    codes[1, place] = 8191 + code
    refuse_steps(replace(burst, codes=codes))
    codes[1, place] += np.sign(code)
    with pytest.raises(RigError, match=r"output 2 begins or ends at 1.0% of its full scale: at most 1% is allowed"):
        refuse_steps(replace(burst, codes=codes))


def test_peaks_are_relative_to_full_scale(burst: Burst) -> None:
    """(16382 - 8191) / 8191 = 1 of the first channel; the lowest code of the second gives (8191 - 4096) / 8191."""
    codes = np.full_like(burst.codes, 8191)
    codes[0, 7], codes[0, 9], codes[1, 7], codes[1, 9] = 16382, 8000, 9000, 4096
    assert replace(burst, codes=codes).peaks == (1.0, pytest.approx(4095 / 8191))


def commands(*settings: Setting) -> str:
    """Return the commands of settings."""
    return ";".join(setting.command for setting in settings)


def test_settings_before_a_load_are_quiet_and_limited() -> None:
    """Open circuit, normal polarity, Vpp, no offset, low level, both limits; all but the level hold at firing."""
    quiet = (
        "OUTP{0}:IMP INF;OUTP{0}:POL NORM;SOUR{0}:VOLT:UNIT VPP;SOUR{0}:VOLT:OFFS 0V;SOUR{0}:VOLT 0.1VPP;"
        "SOUR{0}:VOLT:LIM:HIGH 4V;SOUR{0}:VOLT:LIM:LOW -4V"
    )
    limits = replace(WIDE, level=4.0)
    assert commands(*limits.quiet_settings(2)) == quiet.format(2)
    both = f"{quiet.format(1)};{quiet.format(2)}"
    assert commands(*limits.guarded_settings()) == both.replace("SOUR1:VOLT 0.1VPP;", "").replace(
        "SOUR2:VOLT 0.1VPP;", ""
    )


def test_only_the_amplitude_may_change_in_a_stimulus() -> None:
    """Not every setting with its header: of an instrument that names the quantity after it, the offset stays."""
    level, offset = (
        Setting("APPL", value, of=f"{name}{{channel}}") for name, value in (("AMP", "amplitude"), ("OFF", 0.0))
    )
    table = replace(TABLE, level=level, quiet=(replace(level, value="quiet_amplitude"), offset))
    limits = replace(WIDE, instrument=replace(AFG3022B, commands=table))
    assert commands(*limits.guarded_settings()) == "APPL OFF1,0;APPL OFF2,0"


def test_burst_is_played_once_at_each_trigger(burst: Burst) -> None:
    """One cycle of 50 ms from the first point, at once; the rate to a millionth, as 11 digits are kept of it."""
    settings = AFG3022B.burst_settings(2, 3, burst, continuous=False)
    assert commands(*settings) == (
        "SOUR2:FREQ 20HZ;SOUR2:FUNC USER3;SOUR2:BURS:MODE TRIG;SOUR2:BURS:NCYC 1;SOUR2:BURS:TDEL 0S;SOUR2:PHAS 0RAD;"
        "SOUR2:BURS:STAT ON"
    )
    assert settings[0].confirmed_by("20.000018")
    assert not settings[0].confirmed_by("20.00003")


def test_a_continuous_record_needs_no_trigger(burst: Burst) -> None:
    """A whole period of 1/7 s from the first point on, burst mode off."""
    settings = AFG3022B.burst_settings(1, 4, burst, continuous=True)
    assert commands(*settings) == "SOUR1:FREQ 7HZ;SOUR1:FUNC USER4;SOUR1:PHAS 0RAD;SOUR1:BURS:STAT OFF"
    assert settings[0].confirmed_by("7.000006")
    assert not settings[0].confirmed_by("7.00001")


def test_timer_level_and_lock(burst: Burst) -> None:
    """1/7 s, of which the instrument may keep four digits; an amplitude; a memory locked against overwriting."""
    assert commands(*AFG3022B.timer(burst), AFG3022B.level(2, 1.5)) == "TRIG:TIM 0.142857142857S;SOUR2:VOLT 1.5VPP"
    (timer,) = AFG3022B.timer(burst)
    assert timer.confirmed_by("0.1429")
    assert not timer.confirmed_by("0.14298")
    (lock,) = (entry.filled(memory="3") for entry in TABLE.locks)
    assert (lock.command, lock.query) == ("DATA:LOCK:STAT USER3,ON", "DATA:LOCK:STAT? USER3")
    assert lock.off.command == "DATA:LOCK:STAT USER3,OFF"
    (mark,) = (entry.filled(mark=3182.0) for entry in TABLE.marks)
    assert (mark.command, mark.query) == ("DATA:POIN EMEM,3182", "DATA:POIN? EMEM")
    assert mark.confirmed_by("3182")
    assert not mark.confirmed_by("3183")


def test_an_instrument_with_a_trigger_per_channel() -> None:
    """One setting per channel if the table contains a channel, otherwise one in all; no common timer."""
    both = KEYSIGHT_33500B.on_all(KEYSIGHT_33500B.commands.stopped)
    assert commands(*both) == "TRIG1:SOUR BUS;TRIG2:SOUR BUS"
    assert commands(*AFG3022B.on_all(TABLE.stopped)) == "TRIG:SOUR EXT"
    assert KEYSIGHT_33500B.commands.timer is KEYSIGHT_33500B.commands.armed is None


def test_records_are_played_at_a_sampling_rate(burst: Burst) -> None:
    """2,500 samples in 50 ms are 50 kHz; a whole period at 7 Hz has 262,144 points, 1.835008 MHz."""
    assert KEYSIGHT_33500B.timer(burst) == ()
    once = commands(*KEYSIGHT_33500B.burst_settings(2, "MT0", burst, continuous=False))
    assert once == (
        'SOUR2:FUNC:ARB "MT0";SOUR2:FUNC ARB;SOUR2:FUNC:ARB:ADV SRAT;SOUR2:FUNC:ARB:FILT OFF;SOUR2:FUNC:ARB:SRAT 50000;'
        "SOUR2:BURS:MODE TRIG;SOUR2:BURS:NCYC 1;SOUR2:BURS:PHAS 0;TRIG2:DEL 0;SOUR2:BURS:STAT ON"
    )
    always = commands(*KEYSIGHT_33500B.burst_settings(1, "MT0", burst, continuous=True))
    assert always.endswith("SOUR1:FUNC:ARB:SRAT 1835008;SOUR1:BURS:STAT OFF")


def test_a_single_message_switches_all_outputs_off() -> None:
    """Each output off, then each queried: exactly the message that the watchdog process sends."""
    assert AFG3022B.off == ":OUTP1 OFF;:OUTP2 OFF;:OUTP1?;:OUTP2?"
    # What does not move the beam cannot spoil the reply that confirms the outputs off.
    assert KEYSIGHT_33500B.off == f"{AFG3022B.off}\n:OUTP:TRIG OFF"


def test_the_settable_amplitude_depends_on_the_range_of_the_codes(burst: Burst) -> None:
    """Codes from -1/4 to 1 of the range use 5/8 of it: 8 Vpp are 12.8 V of full scale, 160 V at the beam."""
    codes = np.full_like(burst.codes, 32767)
    codes[:, 5], codes[:, 7] = 65534, 24575
    part = replace(burst, codes=codes, converter=KEYSIGHT_33500B.converter, amplitude=(12.8, 12.8))
    limits = Limits(KEYSIGHT_33500B, level=10.0, beam=160.0, gain=25.0, velocity=0.5)
    assert limits.amplitudes(part, 0.2) == (8.0, 8.0)
    with pytest.raises(RigError, match="160.0 V at the beam: allowed at most 159 V"):
        replace(limits, beam=159.0).amplitudes(part, 0.2)
    with pytest.raises(RigError, match=r"needs 8 V peak to peak of output 1: allowed 0.002 to 7.5\d* V"):
        replace(limits, level=6.0).amplitudes(part, 0.2)


def test_figures_of_the_data_sheet() -> None:
    """AFG3022B: 131,072 points per record; the AFG3022C accepts the same commands."""
    assert AFG3022B.converter.max_points == 131_072
    assert instruments()[0].models == ("AFG3022B", "AFG3022C")


def test_the_simulator_is_recognised_by_its_serial_number() -> None:
    """`*IDN?`: maker, model, serial number, firmware (IEEE 488.2, 10.14); in other fields the text does not count."""
    assert AFG3022B.is_simulated("TEKTRONIX,AFG3022B,SIMULATED,SCPI:99.0 FV:3.2.2")
    assert not AFG3022B.is_simulated("TEKTRONIX,AFG3022B,C012345,SCPI:99.0 FV:3.2.2")
    assert not AFG3022B.is_simulated("SIMULATED INSTRUMENTS,AFG3022B,C012345,1")


def test_an_unknown_model_is_treated_as_the_first_one(apparatus: Apparatus) -> None:
    """A related model in the apparatus file gets the AFG3022B's figures and commands."""
    other = apparatus.model_copy(update={"generator": apparatus.generator.model_copy(update={"model": "AFG31022"})})
    assert instrument_of(other) is instrument_of(apparatus) is AFG3022B


def test_the_voltage_at_the_beam_depends_on_the_records_peak(apparatus: Apparatus, burst: Burst) -> None:
    """A record that uses half the codes reaches half the voltage: allowed where a full one is not."""
    limits = replace(limits_of(apparatus), beam=100.0, level=10.0)
    half = replace(burst, codes=((burst.codes.astype(int) - 8191) // 2 + 8191).astype("uint16"))
    with pytest.raises(RigError, match="150.0 V at the beam: allowed at most 100 V"):
        limits.amplitudes(burst, 0.2)
    assert limits.amplitudes(half, 0.2) == (12.0, 8.0)


@pytest.mark.parametrize(
    "module", ["generator", "connection", "controls", "player", "pacing", "visa", "watchdog_client"]
)
def test_the_driver_contains_no_command_of_one_instrument(module: str) -> None:
    """Headers and memories of the AFG3022B are only in its own table."""
    text = (Path(modaltouch.rig.__file__).parent / f"{module}.py").read_text(encoding="utf-8")
    assert not re.findall(r"SOUR|EMEM|USER|TRIG:|OUTP|BURS:|AFG3", text)
