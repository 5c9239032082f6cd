"""The driver with a Keysight 33522B: the same guarantees as with an AFG3022B, by different commands."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_faults import KINDS, WRONG, counted

from modaltouch.preflight.single_design import design, find_design_inputs
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.protocol.findings import Findings
from modaltouch.rig import instrument_of
from modaltouch.rig.checklist import QUESTIONS, check_rig
from modaltouch.rig.connection import Patience
from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import RigError
from modaltouch.rig.keysight33500b import KEYSIGHT_33500B, ZERO, _agrees, figures
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.keysight33500b import TrueformChannel
from modaltouch.rig.watchdog_client import WatchdogClient
from modaltouch.stimulus.burst import Burst
from modaltouch.system.clock import VirtualClock

PROTOCOLS = Path(__file__).parents[2] / "protocols"
PATIENCE = Patience(reply=0.3, copy=1.0, tries=2, pause=0.02)


@pytest.fixture(scope="session")
def apparatus() -> Apparatus:
    """Return the shipped apparatus with this generator."""
    return Apparatus.read(PROTOCOLS / "apparatus" / "keysight_33522b.yaml")


@pytest.fixture(name="make")
def _make(make: Callable[..., Burst]) -> Callable[..., Burst]:
    """Return a function that makes bursts in this generator's codes, none of which uses the whole range."""

    def in_its_codes(**options: Any) -> Burst:
        burst = make(**options)
        wave = (burst.codes.astype(float) - 8191) / 8191
        codes = np.round(ZERO + ZERO * wave).astype(np.uint16)
        return replace(burst, codes=codes, converter=KEYSIGHT_33500B.converter)

    return in_its_codes


@pytest.fixture
def burst(make: Callable[..., Burst]) -> Burst:
    """Return a short burst."""
    return make()


UPLOAD, READ_BACK, ARM, SWITCH_ON, TRIGGER, STOP = (
    "DATA:ARB:DAC",
    r"MMEM:UPL\?",
    "VOLT 4.754VPP",
    "OUTP1 ON",
    r"^\*TRG$",
    r"OUTP1\?;:OUTP2\?;:OUTP1 OFF",
)

LARGE_FILE = '#245Data Type:"short"\nData:\n99999999999999999999\n'
"""A file with a code that exceeds every machine integer."""

MATRIX: list[tuple[str, str, Any, str, str, str]] = [
    # fault, message affected, value, phase, outcome, pattern of the error; as in test_faults
    ("lost_reply", "IDN", 0, "connect", "refused", "no generator answers at .* no output was switched on"),
    ("wrong_reply", "IDN", "ACME,GEN1,0,1", "connect", "refused", "says it is 'ACME,GEN1,0,1'.*33522B"),
    ("scpi_error", "RST", -310, "connect", "refused", "does not accept its settings.*-310"),
    ("wrong_reply", "LIM:STAT", '0;0,"No error"', "connect", "refused", "SOUR1:VOLT:LIM:STAT reads 0, ON was set"),
    ("wrong_reply", "OUTP1:LOAD", '50;0,"No error"', "connect", "refused", "OUTP1:LOAD reads 50, INF was set"),
    ("dropped_connection", UPLOAD, 0, "upload", "recovers", ""),
    ("ignored_message", UPLOAD, 0, "upload", "recovers", ""),
    ("truncated_upload", UPLOAD, 0, "upload", "recovers", ""),
    ("garbled_upload", UPLOAD, 0, "upload", "recovers", ""),
    ("scpi_error", UPLOAD, -222, "upload", "recovers", ""),
    ("garbled_reply", READ_BACK, 0, "upload", "recovers", ""),
    ("dropped_reply", READ_BACK, 0, "upload", "recovers", ""),
    ("wrong_reply", READ_BACK, LARGE_FILE, "upload", "recovers", ""),
    ("wrong_reply", r"ATTR:POIN\?", "1E99999", "upload", "recovers", ""),
    ("scpi_error", "MMEM:STOR", -250, "upload", "recovers", ""),
    ("power_cycle", "BURS:STAT ON", 0, "upload", "recovers", ""),
    ("front_panel", r"SOUR2:BURS:STAT ON", "SOUR1:FUNC SIN", "upload", "unconfirmed", "SOUR1:FUNC reads SIN"),
    ("lost_reply", ARM, 0, "arm", "unconfirmed", "failed"),
    ("garbled_reply", ARM, 0, "arm", "unconfirmed", "failed"),
    ("scpi_error", ARM, -222, "arm", "unconfirmed", "-222"),
    ("power_cycle", ARM, 0, "arm", "unconfirmed", "failed"),
    ("front_panel", ARM, "SOUR2:FUNC:ARB:SRAT 40000", "arm", "unconfirmed", r"SOUR2:FUNC:ARB:SRAT reads \+4"),
    ("front_panel", ARM, "SOUR1:FUNC:ARB:FILT STEP", "arm", "unconfirmed", "SOUR1:FUNC:ARB:FILT reads STEP, OFF"),
    ("front_panel", ARM, "TRIG1:SOUR IMM", "arm", "unconfirmed", "TRIG1:SOUR reads IMM, BUS was set"),
    ("wrong_reply", SWITCH_ON, '1;0;0,"No error"', "arm", "unconfirmed", "OUTP2 reads 0, ON was set"),
    ("dropped_connection", TRIGGER, 0, "arm", "unconfirmed", "trigger 1 failed"),
    ("scpi_error", TRIGGER, -211, "arm", "unconfirmed", "the generator reports -211"),
    ("front_panel", TRIGGER, "OUTP2 OFF", "arm", "unconfirmed", "output 2 was off"),
    ("dropped_connection", STOP, 0, "stop", "recovers", ""),
    ("ignored_message", STOP, 0, "stop", "recovers", ""),
    ("power_cycle", STOP, 0, "stop", "unconfirmed", "output 1 was off; output 2 was off; .*SOUR1:VOLT reads"),
]


@pytest.mark.parametrize("row", MATRIX, ids=lambda row: f"{row[3]}-{row[0]}-{row[1]}-{row[2]}")
def test_a_fault_never_leaves_outputs_on_or_confirms_a_wrong_stimulus(
    row: tuple[str, str, Any, str, str, str],
    simulator: Simulator,
    open_generator: Callable[..., Generator],
    burst: Burst,
) -> None:
    """Outputs are off after each fault; a confirmed stimulus played as requested; the next stimulus plays."""
    fault, when, value, phase, seen, words = row
    if phase == "connect":
        simulator.faults.inject(fault, when=when, value=value)
        simulator.front_panel("OUTP1 ON")
        with pytest.raises(RigError, match=words):
            open_generator()
        return
    rig = open_generator()
    if phase != "upload":
        rig.load(burst)
    simulator.faults.inject(fault, when=when, value=value)
    if phase == "upload":
        rig.load(burst)
        if seen == "recovers":
            assert_holds(simulator, burst)
    firing = rig.fire(0.1)
    if not firing.started:
        assert simulator.outputs == (False, False)
    rig.stop()
    assert simulator.outputs == (False, False)
    assert not simulator.faults.any
    assert rig.firing is not None
    assert rig.firing.confirmed is (seen == "recovers")
    assert re.search(words, rig.firing.reason)
    again = rig.fire(0.1)
    assert again.started
    assert_plays(simulator, burst, 0.1)
    rig.stop()
    assert rig.firing.confirmed


def assert_holds(simulator: Simulator, burst: Burst) -> None:
    """Check that each channel has its record selected."""
    for channel, codes in zip(simulator.afg.channels.values(), burst.codes, strict=True):
        np.testing.assert_array_equal(channel.record, codes.astype(int) - ZERO)


def assert_plays(simulator: Simulator, burst: Burst, velocity: float) -> None:
    """Check that the instrument plays what was commanded: records, full scales, length."""
    assert simulator.outputs == (True, True)
    for playback, codes, full_scale in zip(
        simulator.playbacks, burst.codes, burst.full_scale_for(velocity), strict=True
    ):
        assert playback is not None
        assert playback.record == codes.astype(">u2").tobytes()
        assert playback.amplitude == pytest.approx(full_scale)
        assert (playback.offset, playback.duration) == (0, pytest.approx(burst.duration))


@pytest.mark.parametrize(
    ("disturb", "words"),
    [
        ("SOUR1:VOLT 3VPP", r"SOUR1:VOLT reads \+3.0.*, 4.754VPP was set when the stimulus ended"),
        ("OUTP2 OFF", "output 2 was off when the stimulus ended"),
        ("TRIG2:SOUR TIM", "TRIG2:SOUR reads TIM, BUS was set"),
        ("SOUR1:DATA:VOL:CLE", "SOUR1:FUNC:ARB reads .*EXP_RISE.*"),
        ("SOUR1:BURS:PHAS 90", r"SOUR1:BURS:PHAS reads \+9.0"),
        ("OUTP1:POL INV", "OUTP1:POL reads INV"),
    ],
)
def test_a_disturbance_during_a_trial_prevents_its_confirmation(
    generator: Generator, simulator: Simulator, burst: Burst, disturb: str, words: str
) -> None:
    """A setting changed at the front panel during a stimulus is detected at the end of the stimulus."""
    generator.load(burst)
    assert generator.fire(0.1).started
    simulator.front_panel(disturb)
    generator.stop()
    assert simulator.outputs == (False, False)
    assert generator.firing is not None
    assert not generator.firing.confirmed
    assert re.search(words, generator.firing.reason)


def test_the_amplitude_set_is_that_of_the_record(generator: Generator, simulator: Simulator, burst: Burst) -> None:
    """Codes over 79 % and 87 % of the range: full scales of 6 V and 4 V need 4.754 Vpp and 3.469 Vpp."""
    generator.load(burst)
    firing = generator.fire(0.1)
    spans = np.ptp(burst.codes.astype(int), axis=1) / (2 * ZERO)
    assert firing.commanded_amplitude == tuple(np.round(spans * (6.0, 4.0), 3)) == (4.754, 3.469)
    assert firing.confirmed_amplitude == firing.commanded_amplitude
    assert [playback.amplitude for playback in simulator.playbacks if playback] == pytest.approx((6, 4), rel=5e-4 / 4)


def test_the_amplitude_limit_is_scaled_by_the_range_of_the_codes(apparatus: Apparatus, burst: Burst) -> None:
    """With 79 % of the range, 20 V of full scale are 15.85 Vpp: the limit, although the data sheet allows 20 Vpp."""
    limits = replace(instrument_of(apparatus).limits(apparatus), beam=1000.0)
    with pytest.raises(RigError, match=r"needs 16.64 V peak to peak of output 1: allowed 0.002 to 15.8\d* V"):
        limits.amplitudes(replace(burst, amplitude=(21.0, 4.0)), 0.2)


def test_records_are_sent_once(open_generator: Callable[..., Generator], burst: Burst, heard: Any) -> None:
    """A second session finds both records by name, reads them back and sends none."""
    with open_generator() as first:
        first.load(burst)
    assert [facts["memory"][:4] for facts in heard.of("record_sent")] == ["1:MT", "2:MT"]
    heard.clear()
    open_generator().load(burst)
    assert (len(heard.of("record_sent")), len(heard.of("record_found"))) == (0, 2)


def test_bursts_alternate_without_an_upload(
    generator: Generator, simulator: Simulator, make: Callable[..., Burst], heard: Any
) -> None:
    """Two bursts, two records per channel: firing either one sends only settings."""
    bursts = make(), make(seed=1)
    generator.load(*bursts)
    assert len(heard.of("record_sent")) == 4
    heard.clear()
    for which in (1, 0):
        assert generator.fire(0.1, which=which).started
        assert_plays(simulator, bursts[which], 0.1)
        generator.stop()
    assert heard.of("record_sent") == []


def test_a_record_that_cannot_be_read_back_is_checked_by_its_statistics(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst, heard: Any
) -> None:
    """If no files can be stored: points, average, peak to peak and crest factor are compared; the log records it."""
    simulator.faults.inject("wrong_reply", when="MMEM:STOR", value='1;-113,"Undefined header"', times=99)
    rig = open_generator()
    rig.load(burst)
    assert len(heard.of("record_figures")) == 2
    assert rig.fire(0.1).started
    assert_plays(simulator, burst, 0.1)


def test_faults_that_the_statistics_detect_and_miss(burst: Burst) -> None:
    """To four decimals: a lost point, byte order, sign or scale is detected; one code that is wrong by one is not."""
    codes = burst.codes[0]

    def noticed(other: Any) -> bool:
        told = [f"{figures(codes)[0]:+.0f}", *(f"{figure:+.4f}" for figure in figures(codes)[1:])]
        return not all(_agrees(*each) for each in zip(told, figures(np.asarray(other)), strict=True))

    signed = codes.astype(int) - ZERO
    assert not noticed(codes)
    assert noticed(codes[:-1])
    assert noticed((signed.astype(np.int16).byteswap().astype(int) + ZERO).clip(0, 2 * ZERO))
    assert noticed(ZERO - signed)
    assert noticed(signed // 2 + ZERO)
    slightly = codes.copy()
    slightly[1000] ^= 1
    assert not noticed(slightly)


def test_a_record_that_reads_back_wrong_twice_is_refused(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst
) -> None:
    """After two uploads that read back wrong there is no third, and the outputs are off."""
    simulator.faults.inject("garbled_upload", when=UPLOAD, times=99)
    with pytest.raises(RigError, match="MT[0-9A-F]{10} of output 1 does not hold the record that was sent"):
        open_generator().load(burst)
    assert simulator.outputs == (False, False)


@pytest.mark.parametrize("repetition", ["continuous", "wired"])
def test_other_repetitions_play(
    repetition: str, apparatus: Apparatus, guard: Any, clock: VirtualClock, burst: Burst
) -> None:
    """Continuous repetition of a whole period, or one burst per external trigger pulse."""
    hardware = apparatus.twin.generator.model_copy(update={"external_pulses_Hz": 7.0})
    wired = apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update={"generator": hardware})})
    with Simulator(wired, clock=clock) as simulator:
        options: dict[str, Any] = {"repetition": repetition, "start_guard": guard, "clock": clock}
        with Generator(simulator.address, wired, **options) as rig:
            rig.load(burst)
            assert rig.fire(0.1).started
            clock.sleep(0.5)
            assert simulator.felt_velocity(["C"])[0] > 1e-4
            rig.stop()
            assert rig.firing is not None
            assert rig.firing.confirmed, rig.firing.reason
        assert simulator.outputs == (False, False)


def test_separate_timers_of_the_channels_are_refused(open_generator: Callable[..., Generator], burst: Burst) -> None:
    """Two timers with equal period and unknown phase would separate the channels in time."""
    rig = open_generator(repetition="timer")
    with pytest.raises(RigError, match="33522B has no timer that its channels share; .* generator.repetition: single"):
        rig.load(burst)


def test_outputs_go_off_when_the_session_is_killed(apparatus: Apparatus) -> None:
    """The watchdog process receives this instrument's off commands and sends them: outputs, then trigger output."""
    with Simulator(apparatus) as simulator:
        dog = WatchdogClient(simulator.address, instrument_of(apparatus).off)
        dog.open()
        dog.arm(free_running=False)
        simulator.front_panel("OUTP1 ON;:OUTP2 ON;:OUTP:TRIG ON")
        dog.release(clean=False)
        end = time.monotonic() + 10
        while (on := simulator.front_panel("OUTP1?;:OUTP2?;:OUTP:TRIG?")) != "0;0;0" and time.monotonic() < end:
            time.sleep(0.01)
        assert on == "0;0;0"


def test_outputs_go_off_after_an_exception(apparatus: Apparatus, burst: Burst) -> None:
    """An exception that leaves the driver's with block switches the outputs off."""

    def fail(simulator: Simulator) -> None:
        with Generator(simulator.address, apparatus) as rig:
            rig.load(burst)
            assert rig.fire(0.1).started
            raise ZeroDivisionError

    with Simulator(apparatus) as simulator:
        with pytest.raises(ZeroDivisionError):
            fail(simulator)
        assert simulator.outputs == (False, False)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(kind=st.sampled_from(KINDS), nth=st.integers(0, 75), times=st.integers(1, 2))
def test_no_fault_at_any_message_leaves_outputs_on_or_confirms_a_wrong_stimulus(
    kind: str,
    nth: int,
    times: int,
    simulator: Simulator,
    open_generator: Callable[..., Generator],
    make: Callable[..., Burst],
) -> None:
    """For any fault at any message: outputs off at the end, and a confirmed firing played what was requested."""
    burst = make(n_samples=200)
    simulator.power_cycle()
    simulator.faults.clear()
    refused = "outputs"
    values = {"delayed_reply": 0.3, "scpi_error": -310, "wrong_reply": WRONG[nth % len(WRONG)]}
    with counted(simulator, nth, lambda: simulator.faults.inject(kind, value=values.get(kind, 0), times=times)):
        try:
            with open_generator() as rig:
                rig.load(burst)
                for level in (0.1, 0.2):
                    plays = False
                    if rig.fire(level).started and simulator.outputs == (True, True):
                        sent = [playback for playback in simulator.playbacks if playback is not None]
                        records = [codes.astype(">u2").tobytes() for codes in burst.codes]
                        plays = [each.record for each in sent] == records
                        plays &= [each.amplitude for each in sent] == pytest.approx(burst.full_scale_for(level), 1e-3)
                    rig.stop()
                    assert simulator.outputs == (False, False)
                    assert plays or rig.firing is None or not rig.firing.confirmed
        except RigError as error:
            refused = str(error)
    assert "output" in refused
    assert simulator.outputs == (False, False)


def test_checklist_asks_what_applies(apparatus: Apparatus) -> None:
    """What is about the AFG3022B's timer and edit memory is left out; what is left finds its answers."""
    with Simulator(apparatus) as simulator:
        rows = check_rig(simulator.address, apparatus, patience=PATIENCE)
        assert simulator.outputs == (False, False)
    answers = {row["number"]: row["answer"] for row in rows}
    assert sorted(answers) == [0, 6, 7, 10, 13, 14]
    assert not [row["number"] for row in rows if row["state"] == "unanswered"]
    assert "33522B" in answers[0]
    assert "refused with -221" in answers[7]
    assert "*TRG is accepted" in answers[13]
    assert answers[14] == "a record that uses half the codes reaches 10 Vpp, one that uses all codes 20 Vpp"
    assert "the record, from its lowest code to its highest, as the driver assumes" in rows[-1]["advice"]


def test_trigger_output_shows_each_burst(
    apparatus: Apparatus, open_generator: Callable[..., Generator], simulator: Simulator, burst: Burst
) -> None:
    """It is off after a reset, and the connector is the trigger input of an external source (guide, page 264)."""
    scope = simulator.scope()
    with pytest.raises(RigError, match="no trigger came from the generator: .* its trigger output is off"):
        scope.time_trigger(lambda: simulator.front_panel("SOUR1:BURS:STAT ON;:TRIG1:SOUR BUS;:*TRG"))
    (row,) = (
        row for row in check_rig(simulator.address, apparatus, patience=PATIENCE, scope=scope) if row["number"] == 13
    )
    assert re.search(r"trigger_latency_ms: \{low: 0.\d, high: 0.\d\}", row["answer"])
    rig = open_generator()
    rig.load(burst)
    assert simulator.front_panel("OUTP:TRIG?") == "1"
    rig.load(burst, repetition="wired")
    rig.fire(0.1)
    assert simulator.front_panel("OUTP:TRIG?") == "0"
    rig.stop()
    assert rig.firing is not None
    rig.load(burst, repetition="single")
    assert simulator.front_panel("OUTP:TRIG?") == "1"
    rig.close()
    assert simulator.front_panel("OUTP:TRIG?") == "0"
    assert rig.firing.confirmed, rig.firing.reason


def test_checklist_notices_an_amplitude_of_another_meaning(
    apparatus: Apparatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the amplitude is that of the full code range, every level would be too low: found before anything plays."""
    monkeypatch.setattr(TrueformChannel, "span", 1.0)
    monkeypatch.setattr("modaltouch.rig.checklist.QUESTIONS", QUESTIONS[-1:])
    with Simulator(apparatus) as simulator:
        (row,) = check_rig(simulator.address, apparatus, patience=PATIENCE)
    assert row["answer"] == "a record that uses half the codes reaches 20 Vpp, one that uses all codes 20 Vpp"
    assert "EVERY LEVEL WOULD BE WRONG" in row["advice"]


def test_the_twin_plays_the_predicted_stimulus(apparatus: Apparatus, guard: Any, clock: VirtualClock) -> None:
    """On the identified beam each mode at the focus is as predicted from 16-bit codes, within 1e-6.

    The prediction includes the rounding of amplitudes to four digits, which scales all modes by one factor: the full
    scale cannot be chosen to avoid it, since the amplitude is that of the record. The codes alone err by less than one.
    """
    exact = dict.fromkeys(
        ("natural_frequency_mismatch", "damping_ratio_mismatch", "gain_mismatch", "generator_gain_mismatch"), 0.0
    )
    true = apparatus.model_copy(update={"twin": apparatus.twin.model_copy(update=exact | {"cross_gain": 0.0})})
    ground = find_design_inputs(Findings.read(PROTOCOLS / "differentiated_stimulation.yaml"))
    assert ground is not None
    stimulus = design(replace(ground, apparatus=true))
    timing, n_codes = stimulus.timing, np.ptp(stimulus.burst.codes.astype(int), axis=1).min()
    assert timing.converter is KEYSIGHT_33500B.converter
    with (
        Simulator(true, clock=clock) as simulator,
        Generator(simulator.address, true, start_guard=guard, clock=clock) as rig,
    ):
        rig.load(stimulus.burst)
        for level in (0.2, 0.08):
            firing = rig.fire(level)
            assert firing.started
            state = simulator.true_state(timing.focusing_instant, first=True)
            rig.stop()
            predicted, displaced = stimulus.achieved(level)
            np.testing.assert_allclose(state.velocity, predicted, atol=1e-6 * level)
            np.testing.assert_allclose(state.displacement, displaced, atol=1e-6 * level)
            off = (
                np.array(firing.commanded_amplitude) / (stimulus.burst.shares * stimulus.burst.amplitude) * 0.2 / level
            )
            assert np.abs(off - 1).max() < 5e-4
            assert stimulus.worst_modal_error(level) < (np.abs(off - 1).max() + 1 / n_codes) * level
