"""The driver against the simulator: what it sends, what it confirms, and that its outputs are off."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import pyvisa
from pyvisa.ctwrapper import IVIVisaLibrary

from modaltouch.apparatus import Apparatus
from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import RigError
from modaltouch.rig.settings import continuous_codes
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.visa import find_by, find_instruments
from modaltouch.stimulus.burst import Burst

LEVELS = (0.08, 0.1, 0.15, 0.2)


def test_outputs_are_off_after_opening(simulator: Simulator, open_generator: Callable[..., Generator]) -> None:
    """An output left on by somebody else is off once the driver has the instrument (promise list)."""
    simulator.front_panel("OUTP1 ON;:OUTP2 ON")
    open_generator()
    assert simulator.outputs == (False, False)


def test_firing_is_confirmed_and_felt(loaded: Generator, simulator: Simulator) -> None:
    """Between fire and stop both outputs are on and fingers feel something; before and after they do not."""
    assert simulator.felt_velocity(["A", "C"]).tolist() == [0, 0]
    firing = loaded.fire(0.2)
    assert firing.confirmed
    assert firing.confirmed_amplitude == firing.commanded_amplitude == (12.0, 8.0)
    assert simulator.outputs == (True, True)
    assert (simulator.felt_velocity(["A", "C"]) > 0).all()
    loaded.stop()
    assert simulator.outputs == (False, False)
    assert simulator.felt_velocity(["A", "C"]).tolist() == [0, 0]


def test_a_catch_trial_does_everything_but_play(loaded: Generator, simulator: Simulator) -> None:
    """Amplitudes set, relays on, all confirmed, and fingers feel nothing, though a burst had just been playing."""
    loaded.fire(0.1)
    loaded.stop()
    firing = loaded.fire(0.08, silent=True)
    assert firing.confirmed
    assert firing.confirmed_amplitude == firing.commanded_amplitude != (0, 0)
    assert simulator.outputs == (True, True)
    assert simulator.felt_velocity(["A", "C"]).tolist() == [0, 0]
    loaded.stop()
    assert simulator.outputs == (False, False)
    assert loaded.firing is not None
    assert loaded.firing.confirmed
    assert loaded.fire(0.08).confirmed
    assert (simulator.felt_velocity(["A", "C"]) > 0).all()


def test_a_catch_trial_takes_the_commands_of_any_other(loaded: Generator, heard: Any) -> None:
    """The same number of messages, so that neither time nor relays tell; one differs: the trigger's source."""
    sent = []
    for silent in (False, True):
        heard.clear()
        loaded.fire(0.08, silent=silent)
        loaded.stop()
        sent.append(heard.sent)
    assert len(sent[0]) == len(sent[1])
    ((let_go, kept),) = [pair for pair in zip(*sent, strict=True) if pair[0] != pair[1]]
    assert let_go.startswith(":TRIG:SOUR TIM;")
    assert kept == let_go.replace("TIM", "EXT")


def test_a_continuous_record_cannot_be_silent(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst
) -> None:
    """It plays as soon as the outputs are on, so a catch trial is refused and they stay off."""
    generator = open_generator(repetition="continuous")
    generator.load(burst)
    with pytest.raises(RigError, match="needs the repetition `burst`"):
        generator.fire(0.1, silent=True)
    assert simulator.outputs == (False, False)


def test_level_scales_what_is_felt(loaded: Generator, simulator: Simulator) -> None:
    """The beam is linear: speeds are in the ratio of the levels, 0.4 to 0.5 to 0.75 to 1."""
    felt = []
    for level in LEVELS:
        loaded.fire(level)
        felt.append(simulator.felt_velocity(["B", "D"]))
        loaded.stop()
    assert np.allclose(np.array(felt) / felt[-1], np.array(LEVELS)[:, None] / 0.2, rtol=1e-9)


def test_instrument_is_set_as_the_burst_asks(loaded: Generator, simulator: Simulator) -> None:
    """State of the instrument while it fires: 20 Hz, one cycle a trigger, 1/7 s, 12 and 8 Vpp, no offset."""
    loaded.fire(0.2)
    for channel, memory, amplitude in zip(simulator.afg.channels.values(), ("USER1", "USER2"), (12, 8), strict=True):
        assert channel.function == memory
        assert (channel.frequency, channel.n_cycles, channel.burst, channel.burst_mode) == (20, 1, True, "TRIG")
        assert (channel.offset, channel.delay, channel.polarity) == (0, 0, "NORM")
        assert math.isinf(channel.load)
        assert channel.amplitude == pytest.approx(amplitude)
    assert simulator.afg.trigger_source == "TIM"
    assert simulator.afg.timer == pytest.approx(1 / 7, rel=1e-8)


def test_memories_hold_the_codes(loaded: Generator, simulator: Simulator, burst: Burst) -> None:
    """USER1 and USER2 hold the burst's codes, two bytes each, big-endian (instruments.md, arbitrary waveforms)."""
    for number, codes in enumerate(burst.codes, start=1):
        assert simulator.afg.user[number] == codes.astype(">u2").tobytes()


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


def test_every_set_reads_the_error_queue(loaded: Generator, heard: Any) -> None:
    """Each message that sets something ends by asking for errors (promise list)."""
    loaded.fire(0.1)
    loaded.stop()
    sets = [m for m in heard.sent if any(" " in unit.strip() and "?" not in unit for unit in m.split(";"))]
    assert sets
    assert all(message.endswith("SYST:ERR?") for message in sets)


def test_level_change_sends_no_record(loaded: Generator, heard: Any) -> None:
    """A trial sets two amplitudes, the outputs and the trigger source; nothing else (promise list)."""
    for level in LEVELS:
        loaded.fire(level)
        loaded.stop()
    assert not any("DATA" in message.replace("DATA:LOCK:STAT?", "") for message in heard.sent)


def test_levels_are_set_while_the_trigger_is_stopped(loaded: Generator, simulator: Simulator) -> None:
    """No burst plays between the two channels' settings: the trigger waits and both outputs are off."""
    seen = []
    set_levels = simulator.afg.set_levels

    def watch(number: int, **levels: float) -> None:
        seen.append((simulator.afg.trigger_source, simulator.outputs))
        set_levels(number, **levels)

    simulator.afg.set_levels = watch
    loaded.fire(0.1)
    loaded.fire(0.2)
    assert seen == [("EXT", (False, False))] * 4


def test_level_change_takes_at_most_two_milliseconds(loaded: Generator) -> None:
    """Two amplitudes set, read back and free of errors, over VXI-11: the bar is 2 ms (fastest of 50 tries)."""
    took = []
    for step in range(50):
        started = time.perf_counter()
        loaded.set_levels((1 + step / 1000, 2.0))
        took.append(time.perf_counter() - started)
    assert min(took) < 2e-3


def test_record_already_there_is_not_sent_again(
    open_generator: Callable[..., Generator], burst: Burst, heard: Any
) -> None:
    """A second session reads the memories back, finds the record right and sends none (promise list)."""
    with open_generator() as first:
        first.load(burst)
    assert len(heard.of("record_sent")) == 2
    heard.clear()
    open_generator().load(burst)
    assert heard.of("record_sent") == []
    assert len(heard.of("record_found")) == 2


def test_record_with_one_wrong_code_is_sent_again(
    open_generator: Callable[..., Generator], simulator: Simulator, burst: Burst, heard: Any
) -> None:
    """A memory that differs in a single code is not taken for the record."""
    with open_generator() as first:
        first.load(burst)
    simulator.front_panel("DATA:COPY EMEM,USER2;:DATA:DATA:VAL EMEM,1000,8192;:DATA:COPY USER2,EMEM")
    heard.clear()
    open_generator().load(burst)
    assert [facts["memory"] for facts in heard.of("record_sent")] == ["USER2"]
    assert simulator.afg.user[2] == burst.codes[1].astype(">u2").tobytes()


def test_two_bursts_share_the_memories(
    loaded: Generator, simulator: Simulator, burst: Burst, make: Callable[..., Burst], heard: Any
) -> None:
    """Loading another burst and the first again plays the first one's records."""
    other = make(seed=1)
    loaded.load(other)
    loaded.load(burst)
    loaded.fire(0.1)
    for channel, codes in zip(simulator.afg.channels.values(), burst.codes, strict=True):
        assert simulator.afg.user[int(channel.function[4:])] == codes.astype(">u2").tobytes()


def test_bursts_change_places_without_an_upload(
    generator: Generator, simulator: Simulator, burst: Burst, make: Callable[..., Burst], heard: Any
) -> None:
    """Two bursts of four records fill the memories; firing one or the other sends settings alone, in any order."""
    other = replace(make(seed=1), repetition_rate=5.0, amplitude=(6.0, 3.0))
    generator.load(burst, other)
    assert len(heard.of("record_sent")) == 4
    heard.clear()
    for which in (0, 1, 1, 0):
        chosen = (burst, other)[which]
        firing = generator.fire(0.1, which=which)
        assert firing.confirmed
        assert firing.commanded_amplitude == tuple(a / 2 for a in chosen.amplitude)
        for channel, codes in zip(simulator.afg.channels.values(), chosen.codes, strict=True):
            assert simulator.afg.user[int(channel.function[4:])] == codes.astype(">u2").tobytes()
        assert simulator.afg.timer == pytest.approx(1 / chosen.repetition_rate, rel=5e-4)
        generator.stop()
        assert generator.firing is not None
        assert generator.firing.confirmed
    assert heard.of("record_sent") == []
    with pytest.raises(RigError, match="burst 2 was asked for: 0 to 1 are loaded"):
        generator.fire(0.1, which=2)


def test_more_records_than_memories_are_refused(generator: Generator, make: Callable[..., Burst]) -> None:
    """Six different records do not fit into four memories; three bursts that share one channel's do."""
    bursts = [make(seed=seed) for seed in (1, 2, 3)]
    with pytest.raises(RigError, match="the bursts have 6 records: the generator has 4 memories"):
        generator.load(*bursts)
    shared = [replace(each, codes=np.stack([each.codes[0], bursts[0].codes[1]])) for each in bursts]
    generator.load(*shared)
    assert generator.fire(0.1, which=2).confirmed


def test_log_holds_every_exchange_but_no_record(generator: Generator, burst: Burst, heard: Any) -> None:
    """Commands come with reply and time; a record is named by its length and hash."""
    generator.load(burst)
    exchanges = heard.of("scpi")
    assert all(facts["seconds"] >= 0 for facts in exchanges)
    assert max(len(str(facts)) for facts in exchanges) < 1000
    uploads = [facts["sent"] for facts in exchanges if facts["sent"].startswith("DATA:DATA EMEM,")]
    assert len(uploads) == 2
    assert all(f"<{2 * burst.codes.shape[1]} bytes, blake2b " in sent for sent in uploads)


@pytest.mark.parametrize(("end", "code"), [(0, 8191 + 100), (-1, 8191 - 100)])
def test_burst_that_begins_or_ends_with_a_step_is_refused(
    loaded: Generator, simulator: Simulator, burst: Burst, end: int, code: int
) -> None:
    """Ramp on, ramp off: the outputs rest at a record's ends, at most 1 % of full scale from 0 V; none is loaded."""
    codes = burst.codes.copy()
    codes[1, end] = code
    with pytest.raises(RigError, match="output 2 begins or ends at 1.2% of its full scale: at most 1% is allowed"):
        loaded.load(replace(burst, codes=codes))
    with pytest.raises(RigError, match="before a burst was loaded"):
        loaded.fire(0.1)
    assert simulator.outputs == (False, False)


def test_silent_channel_plays_nothing(generator: Generator, simulator: Simulator, burst: Burst) -> None:
    """A channel without drive keeps a low amplitude and a record of zero volts."""
    codes = burst.codes.copy()
    codes[1] = 8191
    generator.load(replace(burst, codes=codes, amplitude=(12.0, 0.0)))
    firing = generator.fire(0.2)
    assert firing.confirmed
    assert firing.commanded_amplitude == (12.0, 0.1)


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
def test_level_beyond_a_limit_is_refused(loaded: Generator, simulator: Simulator, level: float, message: str) -> None:
    """Limits: safety 500 mm/s, 250 V at the beam = 20 Vpp * 25 / 2, lowest amplitude 20 mVpp (apparatus, NI)."""
    with pytest.raises(RigError, match=message):
        loaded.fire(level)
    assert simulator.outputs == (False, False)


def test_lower_amplifier_limit_binds_the_instrument(
    simulator: Simulator, apparatus: Apparatus, guard: Any, burst: Burst
) -> None:
    """With 100 V allowed at the beam the instrument itself refuses more than 4 V at its output."""
    gentle = apparatus.model_copy(update={"amplifier": apparatus.amplifier.model_copy(update={"limit_V": 100.0})})
    with Generator(simulator.address, gentle, start_guard=guard) as generator:
        generator.load(burst)
        with pytest.raises(RigError, match=r"200 mm/s needs 12 V .* 150.0 V at the beam: allowed at most 100 V"):
            generator.fire(0.2)
        assert simulator.front_panel("SOUR1:VOLT 12VPP;:SYST:ERR?").startswith("-222")


def test_fifty_ohm_load_halves_the_volts_at_the_beam(
    simulator: Simulator, apparatus: Apparatus, guard: Any, burst: Burst
) -> None:
    """Into 50 ohm half the open-circuit volts remain: 20 Vpp at the generator are 125 V at the beam."""
    terminated = apparatus.model_copy(update={"generator": apparatus.generator.model_copy(update={"load": "50_ohm"})})
    strong = replace(burst, amplitude=(20.0, 8.0))
    with Generator(simulator.address, terminated, start_guard=guard) as generator:
        generator.load(strong)
        assert generator.fire(0.2).confirmed


def test_fire_before_load_is_refused(generator: Generator, heard: Any) -> None:
    """There is nothing to fire, and no output goes on."""
    with pytest.raises(RigError, match="fire was called before a burst was loaded and verified"):
        generator.fire(0.1)
    assert not any("ON" in message for message in heard.sent)


def test_fire_after_a_load_that_failed_is_refused(
    generator: Generator, simulator: Simulator, burst: Burst, heard: Any
) -> None:
    """A record that could not be verified is not there, whatever the caller makes of the error."""
    simulator.faults.inject("garbled_upload", when="DATA EMEM,", times=99)
    with pytest.raises(RigError, match="does not hold the record that was sent"):
        generator.load(burst)
    with pytest.raises(RigError, match="before a burst was loaded and verified"):
        generator.fire(0.1)
    assert not any("OUTP1 ON" in message for message in heard.sent)
    simulator.faults.clear()
    generator.load(burst)
    assert generator.fire(0.1).confirmed


@pytest.mark.parametrize("erased", ["nothing", "the memories too"])
def test_fire_after_a_power_cycle_sends_no_output_on_before_all_is_verified_again(
    loaded: Generator, simulator: Simulator, heard: Any, erased: str
) -> None:
    """The first try is not confirmed, and no output goes on; the records are read back or sent before the next."""
    simulator.power_cycle()
    if erased == "the memories too":
        simulator.front_panel("SYST:SEC:IMM")
    assert not loaded.fire(0.1).confirmed
    assert not any("OUTP1 ON" in message for message in heard.sent)
    assert len(heard.of("record_sent" if erased == "the memories too" else "record_found")) == 2
    assert loaded.fire(0.1).confirmed


def test_memories_are_locked_while_they_are_needed(
    loaded: Generator, simulator: Simulator, burst: Burst, open_generator: Callable[..., Generator]
) -> None:
    """Nobody stores another record over them at the front panel (-221); whoever comes next can."""
    loaded.fire(0.1)
    assert simulator.front_panel("*CLS;:DATA:COPY USER1,EMEM;:SYST:ERR?").startswith("-221")
    assert simulator.afg.user[1] == burst.codes[0].astype(">u2").tobytes()
    loaded.stop()
    assert loaded.firing is not None
    assert loaded.firing.confirmed
    loaded.close()
    assert simulator.front_panel("*CLS;:DATA:COPY USER1,EMEM;:SYST:ERR?").startswith("0,")


def test_burst_of_one_channel_is_refused(generator: Generator, make: Callable[..., Burst]) -> None:
    """The generator has two outputs and one trigger: a record is due for each."""
    with pytest.raises(RigError, match="the burst has 1 channels: the generator has 2"):
        generator.load(make(amplitude=(10.0,)))


def test_another_model_is_refused(simulator: Simulator, apparatus: Apparatus, guard: Any) -> None:
    """An instrument other than the apparatus file's is left alone, and the remedy named."""
    other = apparatus.model_copy(update={"generator": apparatus.generator.model_copy(update={"model": "AFG31022"})})
    simulator.front_panel("OUTP1 ON")
    with pytest.raises(RigError, match=r"says it is 'TEKTRONIX,AFG3022B.*names AFG31022; no output was switched on"):
        Generator(simulator.address, other, start_guard=guard)
    assert guard.told == ["clean"]
    assert simulator.outputs == (True, False)


def test_fire_while_firing_stops_first(loaded: Generator, simulator: Simulator) -> None:
    """A second fire changes the level with the outputs off in between, and is confirmed."""
    loaded.fire(0.1)
    assert loaded.fire(0.2).confirmed
    assert simulator.outputs == (True, True)


def test_exception_inside_the_session_leaves_outputs_off(
    open_generator: Callable[..., Generator], simulator: Simulator, burst: Burst
) -> None:
    """Any way out of the with statement switches off."""

    class SomethingElse(BaseException):
        pass

    def sit() -> None:
        with open_generator() as rig:
            rig.load(burst)
            rig.fire(0.1)
            raise SomethingElse

    with pytest.raises(SomethingElse):
        sit()
    assert simulator.outputs == (False, False)


def test_close_is_final_and_can_be_repeated(loaded: Generator, simulator: Simulator, guard: Any) -> None:
    """The second close does nothing; the watchdog is let go once, cleanly."""
    loaded.fire(0.1)
    loaded.close()
    loaded.close()
    assert simulator.outputs == (False, False)
    assert guard.told[-1] == "clean"
    assert guard.told.count("clean") == 1


def test_watchdog_is_armed_before_the_outputs_go_on(loaded: Generator, guard: Any, heard: Any) -> None:
    """The watchdog knows first; it is relieved once the outputs are confirmed off."""
    loaded.fire(0.1)
    assert guard.told[-1] == "arm"
    loaded.stop()
    assert guard.told[-1] == "disarm"


def test_onset_bounds_the_first_burst(loaded: Generator) -> None:
    """The timer runs free: the first burst comes within one period of 1/7 s after the trigger was armed."""
    before = time.perf_counter()
    firing = loaded.fire(0.1)
    after = time.perf_counter()
    assert before < firing.onset < after
    assert 1 / 7 < firing.onset_uncertainty < 1 / 7 + (after - before)


def test_continuous_record_repeats_without_trigger(
    open_generator: Callable[..., Generator], simulator: Simulator, make: Callable[..., Burst]
) -> None:
    """Without burst mode one record of 1/7 s holds burst and silence; what is felt differs by under 2 %."""
    burst = make(n_samples=125_000)
    felt = []
    for repetition in ("burst", "continuous"):
        with open_generator(repetition=repetition) as rig:
            rig.load(burst)
            assert rig.fire(0.2).confirmed
            felt.append(simulator.felt_velocity(["A", "C", "E"]))
            rig.stop()
            assert rig.firing is not None
            assert rig.firing.confirmed
    assert simulator.afg.channels[1].frequency == pytest.approx(7)
    assert felt[1] == pytest.approx(felt[0], rel=0.02)


def test_continuous_codes_hold_the_burst_and_then_rest(burst: Burst) -> None:
    """Point n of 131072 lies at (n + 1/2) / (7 Hz * 131072): the burst's sample of that instant, else 0 V."""
    codes = continuous_codes(burst)
    n_points = 131_072
    assert codes.shape == (2, n_points)
    for n in (0, 1, 1000, 30_000, 45_874):
        sample = int((n + 0.5) / (7 * n_points) / (0.05 / burst.codes.shape[1]))
        assert codes[0, n] == burst.codes[0, sample]
    assert (codes[:, 45_876:] == 8191).all()


def test_interrupt_in_the_midst_of_starting_leaves_outputs_off(loaded: Generator, simulator: Simulator) -> None:
    """Ctrl-C right after the outputs went on: not swallowed, and they are off before it passes on."""
    controls = loaded._connection.controls
    outputs_on = controls.outputs_on

    def on_and_interrupt() -> None:
        outputs_on()
        assert simulator.outputs == (True, True)
        raise KeyboardInterrupt

    controls.outputs_on = on_and_interrupt
    with pytest.raises(KeyboardInterrupt):
        loaded.fire(0.1)
    assert simulator.outputs == (False, False)


def test_watchdog_that_cannot_be_armed_leaves_outputs_off(loaded: Generator, simulator: Simulator, guard: Any) -> None:
    """No output without a watchdog."""

    def refuse() -> None:
        raise RigError("the watchdog process does not run")

    guard.arm = refuse
    with pytest.raises(RigError, match="watchdog process does not run"):
        loaded.fire(0.1)
    assert simulator.outputs == (False, False)


def test_found_instruments_are_no_serial_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    """The AFG3022B has USB, LAN and GPIB; what a backend warns of while it searches is kept from the user."""

    class Manager:
        def __init__(self, library: str) -> None:
            pass

        def list_resources(self, query: str) -> tuple[str, ...]:
            warnings.warn("discovery needs another package", stacklevel=1)
            return ("ASRL/dev/ttyS0::INSTR", "USB0::0x0699::0x0347::C012345::INSTR", "TCPIP::10.0.0.7::INSTR")

    monkeypatch.setattr(pyvisa, "ResourceManager", Manager)
    assert find_instruments() == ("USB0::0x0699::0x0347::C012345::INSTR", "TCPIP::10.0.0.7::INSTR")
    monkeypatch.setattr(IVIVisaLibrary, "get_library_paths", lambda: ("/usr/lib/libvisa.so",))
    assert find_instruments()[2] == "USB0::0x0699::0x0347::C012345::INSTR@ivi"


def test_backend_that_is_not_there_is_reported() -> None:
    """A VISA library that does not exist: said, and that an address needs no listing."""
    with pytest.raises(RigError, match="VISA backend '/nowhere/libvisa.so' cannot list instruments .*works without"):
        find_by("/nowhere/libvisa.so")


def test_backend_is_chosen_by_the_address(
    simulator: Simulator, open_generator: Callable[..., Generator], apparatus: Apparatus, guard: Any
) -> None:
    """`@py` after an address is what none means; `@ivi` wants a vendor's library, and says so where there is none."""
    with Generator(f"{simulator.address}@py", apparatus, start_guard=guard) as generator:
        assert generator.address.endswith("INSTR@py")
    with pytest.raises(RigError, match="no generator answers .*Could not open VISA library"):
        Generator(f"{simulator.address}@ivi", apparatus, start_guard=guard)


def test_close_with_a_log_that_fails_switches_off_and_leaves_the_watchdog(
    open_generator: Callable[..., Generator], simulator: Simulator, burst: Burst, guard: Any
) -> None:
    """A full disk under the log: close raises nothing, the outputs are off, and the watchdog makes sure."""
    full = False

    def log(event: str, **facts: Any) -> None:
        if full:
            raise OSError(28, "No space left on device")

    rig = open_generator(log=log)
    rig.load(burst)
    rig.fire(0.1)
    full = True
    rig.close()
    assert simulator.outputs == (False, False)
    assert guard.told[-1] == "left watching"
