"""The twin of the Keysight 33522B against its user's guide and a driver that is independent of this project."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvisa
from hypothesis import given, settings
from hypothesis import strategies as st
from pymeasure.adapters import VISAAdapter
from pymeasure.instruments.agilent import Agilent33500

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.keysight33500b import HIGHEST_CODE, keysight_twin
from modaltouch.system.clock import VirtualClock

PROTOCOLS = Path(__file__).parents[3] / "protocols"
NO_ERROR = '+0,"No error"'


@pytest.fixture(scope="session")
def apparatus() -> Apparatus:
    """Return the shipped apparatus with this generator."""
    return Apparatus.read(PROTOCOLS / "apparatus" / "keysight_33522b.yaml")


@pytest.fixture
def stranger(simulator: Simulator) -> Iterator[Any]:
    """Return PyMeasure's driver of the series, connected to the simulator."""
    adapter = VISAAdapter(simulator.address, visa_library="@py", timeout=1000)
    yield Agilent33500(adapter)
    adapter.close()


def said(simulator: Simulator, *messages: str) -> str:
    """Return the last reply to messages from the front panel."""
    return [simulator.front_panel(message) for message in messages][-1]


def error_of(simulator: Simulator, message: str) -> str:
    """Return the error that a message causes."""
    return said(simulator, "*CLS", message, "SYST:ERR?")


def test_pymeasure_sets_and_reads_both_channels(stranger: Any, simulator: Simulator) -> None:
    """Shape, unit, amplitude, offset, frequency, load, burst and trigger of its driver, without an error."""
    assert stranger.id.split(",")[1:3] == ["33522B", "SIMULATED"]
    for channel, amplitude in ((stranger.ch_1, 1.5), (stranger.ch_2, 2.5)):
        channel.output_load = "INF"
        for name, value in {
            "shape": "SIN",
            "amplitude_unit": "VPP",
            "amplitude": amplitude,
            "offset": 0.25,
            "frequency": 1234.5,
            "burst_mode": "TRIG",
            "burst_ncycles": 3,
            "burst_period": 0.1,
            "burst_state": True,
            "output": True,
        }.items():
            setattr(channel, name, value)
            read = getattr(channel, name)
            assert read == (value if isinstance(value, str | bool) else pytest.approx(value)), name
        assert float(channel.output_load) > 9.8e37
    stranger.trigger_source = "BUS"
    assert stranger.trigger_source == "BUS"
    stranger.ext_trig_out = True
    stranger.trigger()
    stranger.phase_sync()
    stranger.beep()
    stranger.display = "ready"
    stranger.clear_display()
    assert simulator.outputs == (True, True)
    assert stranger.check_errors() == []


def test_pymeasure_uploads_a_record(stranger: Any, simulator: Simulator) -> None:
    """Codes and values under names, selected, at a rate, unfiltered; a name can be reused only after clearing."""
    channel = stranger.ch_2
    ramp = range(-10_000, 10_000, 20)
    channel.data_arb("test", ramp, data_format="DAC")
    channel.data_arb("half", [-0.5] * 4 + [0.5] * 4, data_format="float")
    channel.arb_file = "test"
    channel.shape = "ARB"
    channel.arb_filter = "OFF"
    channel.arb_srate = 1e6
    channel.arb_advance = "SRAT"
    assert channel.arb_file == '"TEST"'
    assert channel.arb_srate == pytest.approx(1e6)
    assert (channel.arb_filter, channel.arb_advance, channel.shape) == ("OFF", "SRAT", "ARB")
    np.testing.assert_array_equal(simulator.afg.channels[2].record, ramp)
    np.testing.assert_array_equal(np.unique(simulator.afg.volatile[2]["HALF"]), [-16384, 16384])
    assert stranger.check_errors() == []
    channel.data_arb("test", ramp)
    assert [int(error[0]) for error in stranger.check_errors()] == [786]
    channel.data_volatile_clear()
    channel.data_arb("test", ramp)
    assert stranger.check_errors() == []


def write(simulator: Simulator, codes: list[int], name: str = "REC") -> None:
    """Select a record for channel 1, played without a filter."""
    points = ",".join(map(str, codes))
    said(simulator, f"SOUR1:DATA:ARB:DAC {name},{points}", f'SOUR1:FUNC:ARB "{name}"', "SOUR1:FUNC ARB")
    said(simulator, "SOUR1:FUNC:ARB:FILT OFF", "OUTP1:LOAD INF", "OUTP1 ON")


def test_the_amplitude_is_that_of_the_record(simulator: Simulator) -> None:
    """Values from 0 to 1 at 0.9 Vpp are 0 to 0.9 V, as a user's 33522B played them: full scale is 1.8 Vpp."""
    write(simulator, [0] * 8 + [HIGHEST_CODE] * 8)
    said(simulator, "SOUR1:VOLT 0.9", "SOUR1:VOLT:OFFS 0")
    playback = simulator.afg.playback(1)
    assert playback is not None
    assert playback.amplitude == pytest.approx(1.8)
    codes = np.frombuffer(playback.record, ">u2").astype(float)
    volts = (codes - HIGHEST_CODE) / (2 * HIGHEST_CODE) * playback.amplitude + playback.offset
    assert (volts.min(), volts.max()) == (0, pytest.approx(0.9))


def test_unused_codes_limit_the_amplitude(simulator: Simulator) -> None:
    """The guide's "Sinc" from -0.2174 to 1 reaches 6.087 V of 10 into 50 ohm; more is clipped, with -222."""
    write(simulator, [round(-0.2174 * HIGHEST_CODE)] * 8 + [HIGHEST_CODE] * 8)
    said(simulator, "OUTP1:LOAD 50")
    assert float(said(simulator, "SOUR1:VOLT? MAX")) == pytest.approx(6.087, abs=5e-4)
    assert error_of(simulator, "SOUR1:VOLT 7").startswith("-222")
    assert float(said(simulator, "SOUR1:VOLT?")) == pytest.approx(6.087, abs=3e-3)


@pytest.mark.parametrize(
    ("message", "error"),
    [
        ("SOUR1:DATA:ARB:DAC REC,1,2,3,4,5,6,7", -220),
        ("SOUR1:DATA:ARB:DAC NAMEOF13CHARS,1,2,3,4,5,6,7,8", -220),
        ("SOUR1:DATA:ARB:DAC REC,-32768,2,3,4,5,6,7,8", -222),
        ("SOUR1:DATA:ARB:DAC REC", -109),
        ("SOUR1:DATA:ARB:DAC REC,#12ab", -220),
        ("SOUR1:DATA:ARB:DAC REC,#217" + 17 * "~", -161),
        ("SOUR1:DATA:ARB:DAC #13abc,1,2,3,4,5,6,7,8", -220),
        ('SOUR1:DATA:ARB:DAC "A B",1,2,3,4,5,6,7,8', -220),
        ("SOUR1:DATA:ARB REC,#232" + 8 * "\x7f\x7f\x7f\x7f", -222),
        ("SOUR1:FUNC:ARB NOBODY", 785),
        ("SOUR1:DATA:ATTR:POIN? NOBODY", 785),
        ('MMEM:UPL? "INT:\\NONE.ARB"', -256),
        ("SOUR1:FUNC:ARB:SRAT 63E6", -222),
        ("SOUR1:VOLT 1 VRMS", -131),
        ("SOUR1:VOLT:UNIT VRMS", -241),
        ("SOUR1:VOLT:HIGH -1", -222),
        ("SOUR3:VOLT 1", -114),
        ("*TRG", -211),
        ("TRIG2", -211),
        ("SOUR1:BURS:STAT ON;:SOUR2:BURS:STAT ON;:TRIG2", -241),
        ("OUTP1:LOAD 20000", -222),
        ("SOUR1:BURS:NCYC 1e9", -222),
        ("SOUR1:VOLT MAX", 0),
        ("SOUR1:VOLT MIN", 0),
        ("SOUR1:VOLT 1e400", -222),
        ("OUTP1:LOAD INF;:SOUR1:VOLT MAX;VOLT:OFFS 1", -221),
        ("SOUR1:VOLT:LIM:HIGH 0.05", 0),
        ("SOUR1:VOLT:LIM:STAT ON;:SOUR1:VOLT:LIM:HIGH 0.01", -221),
        ("SOUR1:VOLT:LIM:STAT ON;:SOUR1:VOLT:LIM:HIGH 1;:SOUR1:VOLT 4", -221),
    ],
)
def test_invalid_records_and_settings_are_refused(simulator: Simulator, message: str, error: int) -> None:
    """Too few points, a long name, a code beyond the converter, an unknown record, a value beyond a limit."""
    assert int(error_of(simulator, message).split(",")[0]) == error


def test_an_amplitude_beyond_the_limits_may_be_clipped(simulator: Simulator) -> None:
    """As on some instruments, without an error: only reading back shows it."""
    said(simulator, "OUTP1:LOAD INF", "SOUR1:VOLT 1", "SOUR1:VOLT:LIM:HIGH 1.5;LOW -1.5;STAT ON")
    simulator.afg.behaviour = replace(simulator.afg.behaviour, limit_violation="clip")
    said(simulator, "SOUR1:VOLT 4")
    assert simulator.afg.channels[1].amplitude == 3.0


def test_both_byte_orders_are_read(simulator: Simulator) -> None:
    """With `FORM:BORD SWAP` the low byte is first."""
    codes = np.array([1, -2, 300, -32767, 32767, 0, 5, 6])
    for name, order, kind in (("A", "NORM", ">i2"), ("B", "SWAP", "<i2")):
        simulator.front_panel(f"FORM:BORD {order}")
        block = codes.astype(kind).tobytes()
        simulator.afg.run(f"SOUR2:DATA:ARB:DAC {name},#216".encode() + block, 0)
        np.testing.assert_array_equal(simulator.afg.volatile[2][name], codes)
    assert said(simulator, "SOUR2:DATA:VOL:CAT?").endswith('"A","B"')
    assert int(said(simulator, "SOUR2:DATA:VOL:FREE?")) == (1 << 20) - 16


def test_one_bus_trigger_starts_both_channels(simulator: Simulator, clock: VirtualClock) -> None:
    """Each channel has its own trigger source; a channel with another source does not start."""
    for n in (1, 2):
        points = ",".join(["0", "20000"] * 50)
        said(simulator, f"SOUR{n}:DATA:ARB:DAC R,{points}", f"SOUR{n}:FUNC:ARB R", f"SOUR{n}:FUNC ARB")
        said(simulator, f"SOUR{n}:FUNC:ARB:FILT OFF", f"TRIG{n}:SOUR BUS", f"SOUR{n}:BURS:STAT ON", f"OUTP{n} ON")
    clock.sleep(0.1)
    assert simulator.playbacks == (None, None)
    assert error_of(simulator, "*TRG") == NO_ERROR
    clock.sleep(0.1)
    assert all(simulator.playbacks)
    said(simulator, "TRIG2:SOUR EXT", "*TRG")
    clock.sleep(0.1)
    assert [playback is not None for playback in simulator.playbacks] == [True, False]


def test_values_are_read_as_floats_in_both_byte_orders(simulator: Simulator) -> None:
    """`DATA:ARB` takes values from -1 to 1, here in blocks of four bytes each."""
    values = np.array([0, 0.5, -0.5, 1, -1, 0.25, 0, 0])
    for name, order, kind in (("A", "NORM", ">f4"), ("B", "SWAP", "<f4")):
        simulator.front_panel(f"FORM:BORD {order}")
        simulator.afg.run(f"SOUR1:DATA:ARB {name},#232".encode() + values.astype(kind).tobytes(), 0)
        np.testing.assert_array_equal(simulator.afg.volatile[1][name], np.round(values * HIGHEST_CODE))


@pytest.mark.parametrize("setting", ["SOUR1:BURS:NCYC INF", "SOUR1:BURS:PHAS 90", "TRIG1:DEL 1"])
def test_a_burst_that_is_not_simulated_plays_nothing(simulator: Simulator, setting: str) -> None:
    """Only single cycles that follow their trigger at once: `TRIG1` starts one, with any trigger source."""
    write(simulator, [0, 20000] * 50)
    said(simulator, "TRIG1:SOUR EXT", "SOUR1:BURS:STAT ON")
    seen = []
    for message in ("*OPC?", "TRIG1", setting, "TRIG1"):
        assert error_of(simulator, message) == NO_ERROR
        seen.append(simulator.playbacks[0] is not None)
    assert seen == [False, True, False, False]


STATE, TABLE = keysight_twin("33522B", None, clock=VirtualClock(0.0))
HEADS = [re.sub(r"[\[\]]", "", head).replace("#", "1") for head in TABLE.commands]
WORDS = (
    *("", "1", "-1", "1e400", "INF", "MIN", "MAX", "DEF", "ON", '"x"', "A", "ARB", "OFF", "BUS", "nan", ",", "5 VPP"),
    *("A,1,2,3,4,5,6,7,8", "#15hello", "A,#216" + 16 * "~", "A,#10", "#0", '"INT:\\K.ARB"', "R,1e9,1,1,1,1,1,1,1"),
)


@settings(max_examples=400, deadline=None, derandomize=True)
@given(head=st.sampled_from(HEADS), query=st.sampled_from(["", "?"]), word=st.sampled_from(WORDS))
def test_no_message_breaks_the_instrument(head: str, query: str, word: str) -> None:
    """Every header with any argument causes a reply, a setting or an entry of the error queue."""
    TABLE.run(f"{head}{query} {word}".encode(), fail=STATE.fail)
    STATE.clock.sleep(1e-3)
    for number in STATE.channels:
        playback = STATE.playback(number)
        assert playback is None or playback.duration > 0


def test_files_survive_a_power_failure_and_records_do_not(simulator: Simulator) -> None:
    """The channels' memories are empty after it; a file stored from a record keeps its codes."""
    write(simulator, [0, 1, -2, 32767, -32767, 5, 6, 0])
    said(simulator, 'MMEM:STOR:DATA1 "INT:\\KEPT.ARB"')
    simulator.power_cycle()
    assert said(simulator, "SOUR1:DATA:VOL:CAT?") == r'"INT:\BUILTIN\EXP_RISE.ARB"'
    content = said(simulator, 'MMEM:UPL? "INT:\\KEPT.ARB"')
    assert content.partition("Data:\n")[2].split() == ["0", "1", "-2", "32767", "-32767", "5", "6", "0"]


def test_high_and_low_levels_set_amplitude_and_offset(simulator: Simulator) -> None:
    """1 V and -0.5 V are 1.5 Vpp about 0.25 V."""
    said(simulator, "OUTP1:LOAD INF", "SOUR1:VOLT:HIGH 1", "SOUR1:VOLT:LOW -0.5")
    told = said(simulator, "SOUR1:VOLT?;VOLT:OFFS?;HIGH?;LOW?").split(";")
    assert [float(each) for each in told] == pytest.approx([1.5, 0.25, 1, -0.5])
    assert error_of(simulator, "SOUR1:FREQ:MODE FIX") == NO_ERROR


@pytest.mark.parametrize("resource", ["address", "socket_address"])
def test_a_record_as_long_as_the_memory_arrives(simulator: Simulator, resource: str) -> None:
    """1,048,576 points without options: a message of 2 MiB, over either link."""
    client: Any = pyvisa.ResourceManager("@py").open_resource(getattr(simulator, resource), read_termination="\n")
    client.timeout = 20_000
    client.query("SOUR1:DATA:VOL:CLE;*OPC?")
    client.write_binary_values("SOUR1:DATA:ARB:DAC LONG,", np.ones(1 << 20, "i2"), datatype="h", is_big_endian=True)
    assert client.query("SOUR1:DATA:ATTR:POIN? LONG;:SYST:ERR?") == f"+1048576;{NO_ERROR}"
    client.close()
