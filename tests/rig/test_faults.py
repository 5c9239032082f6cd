"""Fault x phase: how the session is affected; outputs are off, and no wrong stimulus is confirmed.

``recovers``: only the log shows the fault. ``unconfirmed``: the firing is not confirmed, so that the trial is offered
again. ``refused``: `RigError`. The pattern after it must match the message.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from cable import Cable
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import modaltouch.rig
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.connection import Patience
from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator import Simulator
from modaltouch.stimulus.burst import Burst
from modaltouch.system.clock import VirtualClock

README = Path(modaltouch.rig.__file__).parent / "README.md"

UPLOAD, BLOCK_BACK, COPY, ARM, SWITCH_ON, TRIGGER, STOP = (
    "DATA EMEM,",
    r"DATA:DATA\?",
    "COPY USER",
    "VOLT 6VPP",
    "OUTP1 ON",
    "SEQ:IMM$",
    r"OUTP1\?;:OUTP2\?;:OUTP1 OFF",
)

MATRIX: list[tuple[str, str, Any, str, str, str]] = [
    # fault, message affected, value, phase, outcome, pattern of the error
    ("lost_reply", "IDN", 0, "connect", "refused", "no generator answers at .* no output was switched on"),
    ("delayed_reply", "IDN", 9, "connect", "refused", "no generator answers"),
    ("garbled_reply", "IDN", 0, "connect", "refused", "no generator answers"),
    ("dropped_connection", "IDN", 0, "connect", "refused", "no generator answers"),
    ("wrong_reply", "IDN", "ACME,GEN1,0,1", "connect", "refused", "says it is 'ACME,GEN1,0,1'.*AFG3022B"),
    ("wrong_reply", "IDN", "nonsense", "connect", "refused", "says it is 'nonsense'"),
    ("lost_reply", "RST", 0, "connect", "refused", "no generator answers"),
    ("scpi_error", "RST", -310, "connect", "refused", "does not accept its settings.*-310"),
    ("scpi_error", "LIM:HIGH", -222, "connect", "refused", "does not accept its settings"),
    ("wrong_reply", "LIM:HIGH", '5.0;0,"No error"', "connect", "refused", "SOUR1:VOLT:LIM:HIGH reads 5.0, 10.0V"),
    ("wrong_reply", "OUTP1:IMP", '50;0,"No error"', "connect", "refused", "OUTP1:IMP reads 50, INF was set"),
    ("dropped_connection", UPLOAD, 0, "upload", "recovers", ""),
    ("dropped_reply", UPLOAD, 0, "upload", "recovers", ""),
    ("ignored_message", UPLOAD, 0, "upload", "recovers", ""),
    ("truncated_upload", UPLOAD, 0, "upload", "recovers", ""),
    ("garbled_upload", UPLOAD, 0, "upload", "recovers", ""),
    ("scpi_error", UPLOAD, -222, "upload", "recovers", ""),
    ("slow_command", COPY, 0.2, "upload", "recovers", ""),
    ("slow_command", COPY, 2.5, "upload", "recovers", ""),
    ("lost_reply", COPY, 0, "upload", "recovers", ""),
    ("lost_reply", r"\*OPC\?", 0, "upload", "recovers", ""),
    ("garbled_reply", BLOCK_BACK, 0, "upload", "recovers", ""),
    ("truncated_reply", BLOCK_BACK, 0, "upload", "recovers", ""),
    ("dropped_reply", BLOCK_BACK, 0, "upload", "recovers", ""),
    ("power_cycle", COPY, 0, "upload", "recovers", ""),
    ("front_panel", "FUNC USER1", "SOUR1:FUNC SIN", "upload", "unconfirmed", "SOUR1:FUNC reads SIN"),
    ("lost_reply", ARM, 0, "arm", "unconfirmed", "failed"),
    ("delayed_reply", ARM, 9, "arm", "unconfirmed", "failed"),
    ("delayed_reply", ARM, 0.05, "arm", "recovers", ""),
    ("garbled_reply", ARM, 0, "arm", "unconfirmed", "failed"),
    ("truncated_reply", ARM, 0, "arm", "unconfirmed", ""),
    ("wrong_reply", ARM, '5.9;4.0;0,"No error"', "arm", "unconfirmed", "SOUR1:VOLT reads 5.9, 6.0VPP was set"),
    ("dropped_connection", ARM, 0, "arm", "unconfirmed", "failed"),
    ("dropped_reply", ARM, 0, "arm", "unconfirmed", "failed"),
    ("wrong_reply", ARM, "6;4;", "arm", "unconfirmed", "reports an empty error"),
    ("wrong_reply", ARM, 'NAN;1E999;0,"No error"', "arm", "unconfirmed", "SOUR1:VOLT reads NAN, 6.0VPP was set"),
    ("scpi_error", ARM, -222, "arm", "unconfirmed", "-222"),
    ("power_cycle", ARM, 0, "arm", "unconfirmed", "failed"),
    ("front_panel", ARM, "SOUR2:FREQ 21", "arm", "unconfirmed", "SOUR2:FREQ reads 2.1.*20.0HZ was set"),
    ("front_panel", ARM, "SOUR1:VOLT:OFFS 1", "arm", "unconfirmed", "SOUR1:VOLT:OFFS reads 1"),
    ("front_panel", ARM, "OUTP1:IMP 50", "arm", "unconfirmed", "OUTP1:IMP reads 5"),
    ("front_panel", ARM, "TRIG:SOUR TIM", "arm", "unconfirmed", "TRIG:SOUR reads TIM, EXT was set"),
    ("ignored_message", SWITCH_ON, 0, "arm", "unconfirmed", "failed"),
    ("lost_reply", SWITCH_ON, 0, "arm", "unconfirmed", "failed"),
    ("scpi_error", SWITCH_ON, -310, "arm", "unconfirmed", "-310"),
    ("wrong_reply", SWITCH_ON, '1;0;0,"No error"', "arm", "unconfirmed", "OUTP2 reads 0, ON was set"),
    ("dropped_connection", TRIGGER, 0, "arm", "unconfirmed", "trigger 1 failed"),
    ("dropped_reply", TRIGGER, 0, "arm", "unconfirmed", "trigger 1 failed"),
    ("power_cycle", TRIGGER, 0, "arm", "unconfirmed", "trigger 1 failed"),
    ("scpi_error", TRIGGER, -211, "arm", "unconfirmed", "the generator reports -211"),
    ("front_panel", TRIGGER, "OUTP2 OFF", "arm", "unconfirmed", "output 2 was off"),
    ("lost_reply", STOP, 0, "stop", "unconfirmed", "output 1 was off"),
    ("dropped_connection", STOP, 0, "stop", "recovers", ""),
    ("dropped_reply", STOP, 0, "stop", "unconfirmed", "output 1 was off"),
    ("ignored_message", STOP, 0, "stop", "recovers", ""),
    ("garbled_reply", STOP, 0, "stop", "unconfirmed", "output 1 was off"),
    ("wrong_reply", STOP, '1;1;1;1;0,"No error"', "stop", "unconfirmed", "output 1 was off"),
    ("power_cycle", STOP, 0, "stop", "unconfirmed", "output 1 was off; output 2 was off; .*SOUR1:VOLT reads"),
]


DISTURBANCES: list[tuple[str, str, bool, str]] = [
    # fault, disturbance during a stimulus, whether the firing stays confirmed, pattern of the reason
    ("front panel", "SOUR1:VOLT 3VPP", False, r"SOUR1:VOLT reads 3.0000E\+00, 6.0VPP was set when the stimulus ended"),
    ("front panel", "OUTP2 OFF", False, "output 2 was off when the stimulus ended"),
    ("front panel", "TRIG:SOUR TIM", False, "TRIG:SOUR reads TIM, EXT was set"),
    ("front panel", "SOUR1:FUNC USER2", False, "SOUR1:FUNC reads USER2, USER1 was set"),
    ("front panel", "DATA:LOCK USER1,OFF;:DATA:COPY USER1,EMEM", False, "DATA:LOCK:STAT USER1 reads 0, ON was set"),
    ("front panel", "SOUR1:PHAS 90DEG", False, "SOUR1:PHAS reads 1.5"),
    ("front panel", "SOUR2:FREQ 19", False, "SOUR2:FREQ reads 1.9"),
    ("front panel", "OUTP1:POL INV", False, "OUTP1:POL reads INV"),
    ("power cycle", "power cycle", False, "output 1 was off; output 2 was off"),
    ("dropped connection", "cable out and in", True, ""),
]

LINKS: list[tuple[str, str, str]] = [
    # fault, phase, outcome
    ("half-open link", "upload", "recovers"),
    ("half-open link", "arm", "unconfirmed"),
    ("half-open link", "trial", "unconfirmed"),
    ("half-open link", "stop", "recovers"),
    ("mute link", "upload", "recovers"),
    ("mute link", "arm", "unconfirmed"),
    ("mute link", "trial", "unconfirmed"),
    ("mute link", "stop", "unconfirmed"),
]
"""The existing link dies silently, in both directions or in that of replies; new links work."""

ELSEWHERE: list[tuple[str, str, str, str]] = [
    # fault, phase, outcome, the test in this file that checks it
    ("refused connection", "connect", "refused", "test_a_refused_connection_is_reported"),
    ("refused connection", "upload", "refused", "test_a_lost_instrument_is_an_error_with_a_remedy"),
    ("refused connection", "arm", "refused", "test_a_lost_instrument_is_an_error_with_a_remedy"),
    ("refused connection", "stop", "refused", "test_a_lost_instrument_is_an_error_with_a_remedy"),
    ("stuck *OPC?", "upload", "refused", "test_waiting_for_completion_is_bounded"),
    ("clipped amplitude", "arm", "unconfirmed", "test_a_clipped_amplitude_is_never_confirmed"),
    ("amplifier trip", "trial", "unseen", "test_a_tripped_amplifier_is_undetected"),
]


def test_the_readmes_table_of_faults_matches_these_tests() -> None:
    """The table has a cell for each fault and phase that is tested here, and no other."""
    words = {"refused": "error", "recovers": "continues", "unconfirmed": "trial repeated", "unseen": "undetected"}
    proved: dict[tuple[str, str], set[str]] = {}
    for fault, _, _, phase, seen, _ in MATRIX:
        proved.setdefault((fault.replace("_", " "), phase), set()).add(words[seen])
    for fault, _, confirmed, _ in DISTURBANCES:
        proved.setdefault((fault, "trial"), set()).add("continues" if confirmed else "trial repeated")
    for fault, phase, seen in LINKS:
        proved.setdefault((fault, phase), set()).add(words[seen])
    for fault, phase, seen, test in ELSEWHERE:
        assert test in globals(), f"{test} does not exist: give the test of {fault} at {phase}"
        proved.setdefault((fault, phase), set()).add(words[seen])
    lines = README.read_text(encoding="utf-8").partition("| fault |")[2].splitlines()
    phases = [name.strip() for name in lines[0].split("|")[:-1]]
    told: dict[tuple[str, str], set[str]] = {}
    for line in lines[2:]:
        if not line.startswith("|"):
            break
        fault, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        told |= {(fault, phase): set(text.split(" or ")) for phase, text in zip(phases, cells, strict=True) if text}
    assert told == proved


def cell(row: tuple[str, str, Any, str, str, str]) -> str:
    """Return a readable id of a cell."""
    return f"{row[3]}-{row[0]}-{row[1]}-{row[2]}"


@pytest.mark.parametrize("row", MATRIX, ids=cell)
def test_a_fault_never_leaves_outputs_on_or_confirms_a_wrong_stimulus(
    row: tuple[str, str, Any, str, str, str],
    simulator: Simulator,
    open_generator: Callable[..., Generator],
    burst: Burst,
) -> None:
    """Each cell of the matrix, with the outcomes that the module's docstring defines."""
    fault, when, value, phase, seen, words = row
    if phase == "connect":
        simulator.faults.inject(fault, when=when, value=value)
        simulator.front_panel("OUTP1 ON")
        with pytest.raises(RigError, match=words):
            open_generator()
        return
    rig = open_generator()
    if phase == "upload":
        simulator.faults.inject(fault, when=when, value=value)
        rig.load(burst)
        assert_holds(simulator, burst)
    else:
        rig.load(burst)
        simulator.faults.inject(fault, when=when, value=value)
    firing = rig.fire(0.1)
    assert not firing.confirmed
    assert all(map(math.isfinite, firing.confirmed_amplitude)), "a log has no NaN"
    if not firing.started:
        assert simulator.outputs == (False, False)
    elif when != TRIGGER:
        assert_plays(simulator, burst, firing.commanded_amplitude)
    rig.stop()
    assert simulator.outputs == (False, False)
    assert not simulator.faults.any
    last = rig.firing
    assert last is not None
    assert last.confirmed is (seen == "recovers")
    if not last.confirmed:
        assert re.search(words, last.reason)
    again = rig.fire(0.1)
    assert again.started
    assert_plays(simulator, burst, again.commanded_amplitude)
    rig.stop()
    assert rig.firing is not None
    assert rig.firing.confirmed


def assert_holds(simulator: Simulator, burst: Burst) -> None:
    """Check that the selected memories hold the burst."""
    for channel, codes in zip(simulator.afg.channels.values(), burst.codes, strict=True):
        if channel.function.startswith("USER"):
            assert simulator.afg.user[int(channel.function[4:])] == codes.astype(">u2").tobytes()


def assert_plays(simulator: Simulator, burst: Burst, amplitudes: tuple[float, ...]) -> None:
    """Check that the instrument plays what was commanded: records, levels, length."""
    assert simulator.outputs == (True, True)
    for number, codes, amplitude in zip((1, 2), burst.codes, amplitudes, strict=True):
        playback = simulator.afg.playback(number)
        assert playback is not None
        assert playback.record == codes.astype(">u2").tobytes()
        assert playback.amplitude == pytest.approx(amplitude, rel=1e-3)
        assert playback.offset == 0
        assert playback.duration == pytest.approx(burst.duration)


@pytest.mark.parametrize(("fault", "disturb", "confirmed", "words"), DISTURBANCES)
def test_a_disturbance_during_a_trial_prevents_its_confirmation(
    loaded: Generator, simulator: Simulator, fault: str, disturb: str, confirmed: bool, words: str
) -> None:
    """The state at the end of the stimulus decides; a broken link alone says nothing about the stimulus."""
    assert loaded.fire(0.1).started
    others = {"power cycle": simulator.power_cycle, "cable out and in": simulator.server.drop_connections}
    others.get(disturb, lambda: simulator.front_panel(disturb))()
    loaded.stop()
    assert simulator.outputs == (False, False)
    assert loaded.firing is not None
    assert loaded.firing.confirmed is confirmed
    assert re.search(words, loaded.firing.reason)
    assert loaded.fire(0.1).started


@pytest.mark.parametrize(("fault", "phase", "seen"), LINKS)
def test_a_dead_link_is_replaced_by_a_new_one(
    fault: str,
    phase: str,
    seen: str,
    simulator: Simulator,
    apparatus: Apparatus,
    guard: Any,
    patience: Patience,
    clock: VirtualClock,
    burst: Burst,
) -> None:
    """No wait exceeds its timeout, no lock blocks the new link, and an uncertain trial is offered again."""
    port = int(simulator.address.split(",")[1].split(":")[0])
    with (
        Cable(port) as cable,
        Generator(cable.address, apparatus, start_guard=guard, patience=patience, clock=clock) as rig,
    ):
        steps: dict[str, Callable[[], object]] = {
            "upload": lambda: rig.load(burst),
            "arm": lambda: rig.fire(0.1),
            "trial": lambda: clock.sleep(0.3),
            "stop": lambda: rig.stop(),
        }
        for name, step in steps.items():
            if name == phase:
                cable.cut("both" if fault == "half-open link" else "from", new=False)
            step()
        assert rig.firing is not None
        assert rig.firing.confirmed is (seen == "recovers")
        assert simulator.outputs == (False, False)
        rig.fire(0.1)
        rig.stop()
        assert rig.firing.confirmed


def test_waiting_for_completion_is_bounded(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst
) -> None:
    """``*OPC?`` without a reply: an error after the configured timeouts and attempts, outputs off."""
    rig = open_generator(patience=Patience(reply=0.1, copy=0.1, tries=2, pause=0.01, trigger=0.05))
    simulator.faults.inject("lost_reply", when=r"\*OPC\?", times=10_000)
    with pytest.raises(RigError, match="loading the stimulus"):
        rig.load(burst)
    assert simulator.outputs == (False, False)


def test_a_clipped_amplitude_is_never_confirmed(loaded: Generator, simulator: Simulator) -> None:
    """An output stage limited to 5 Vpp reads back 5 Vpp: not the commanded amplitude, outputs off."""
    simulator.afg.clip_amplitude = 5.0
    firing = loaded.fire(0.2)
    assert not firing.started
    assert firing.commanded_amplitude == (12.0, 8.0)
    assert firing.confirmed_amplitude == (5.0, 5.0)
    assert simulator.outputs == (False, False)


def test_a_tripped_amplifier_is_undetected(loaded: Generator, simulator: Simulator) -> None:
    """The generator has no feedback from its amplifier: confirmed, and no motion until it is reset."""
    simulator.twin.tripped = True
    assert loaded.fire(0.1).started
    assert simulator.felt_velocity(["C"]) == 0
    simulator.twin.tripped = False
    assert simulator.felt_velocity(["C"]) > 0


def test_a_refused_connection_is_reported(simulator: Simulator, open_generator: Callable[..., Generator]) -> None:
    """Nothing listens at the address: reported immediately, with the remedy."""
    simulator.server.refuse()
    with pytest.raises(RigError, match=r"no generator answers at .*ConnectionRefusedError.*`modaltouch rig list`"):
        open_generator()


@pytest.mark.parametrize("phase", ["upload", "arm", "trial"])
def test_a_lost_instrument_is_an_error_with_a_remedy(
    phase: str,
    simulator: Simulator,
    open_generator: Callable[..., Generator],
    burst: Burst,
    guard: Any,
) -> None:
    """RigError after the configured attempts, with the amplifier as remedy; the watchdog keeps watching."""
    rig = open_generator(patience=Patience(reply=0.1, copy=0.1, tries=2, pause=0.01, trigger=0.05))
    steps: list[Callable[[], object]] = [lambda: rig.load(burst), lambda: rig.fire(0.1), rig.stop]
    n_before = ("upload", "arm", "trial").index(phase)
    for step in steps[:n_before]:
        step()
    simulator.server.refuse()
    simulator.server.drop_connections()
    with pytest.raises(RigError, match=r"2 new connections .* could not be confirmed off: SWITCH THE AMPLIFIER OFF"):
        steps[n_before]()
    rig.close()
    assert guard.told[-1] == "left watching"


def test_outputs_confirmed_off_are_not_a_reason_to_switch_the_amplifier_off(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst
) -> None:
    """The instrument accepts no record over any connection, but confirms over each that its outputs are off."""
    rig = open_generator(patience=Patience(reply=0.1, copy=0.1, tries=2, pause=0.01))
    simulator.faults.inject("lost_reply", when=r"DATA:POIN\? EMEM", times=99)
    with pytest.raises(RigError, match=r"2 new connections .*; the outputs are off; check that .* connected$"):
        rig.load(burst)


def test_an_instrument_that_returns_is_reconnected(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst, clock: VirtualClock
) -> None:
    """A cable pulled and plugged in again costs at most one trial, and no upload."""
    rig = open_generator(patience=Patience(reply=0.2, copy=0.4, tries=5, pause=0.02))
    rig.load(burst)
    rig.fire(0.1)
    simulator.server.refuse()
    simulator.server.drop_connections()
    clock.call_at(clock.now() + 0.1, simulator.server.listen)
    rig.stop()
    assert rig.fire(0.2).started
    assert_plays(simulator, burst, (12.0, 8.0))


def test_another_instrument_at_the_address_is_refused(loaded: Generator, simulator: Simulator) -> None:
    """Another serial number answers after a lost link: its records and state are unknown."""
    loaded.fire(0.1)
    simulator.faults.inject("wrong_reply", when="IDN", value="TEKTRONIX,AFG3022B,C999999,SCPI:99.0 FV:3.2.2", times=9)
    simulator.server.drop_connections()
    with pytest.raises(RigError, match="now answers as 'TEKTRONIX,AFG3022B,C999999"):
        loaded.stop()


def test_a_garbled_identity_is_queried_again(loaded: Generator, simulator: Simulator, burst: Burst) -> None:
    """Half a reply to ``*IDN?`` after a lost link: the session continues with the same instrument."""
    loaded.fire(0.1)
    simulator.faults.inject("truncated_reply", when="IDN")
    simulator.server.drop_connections()
    loaded.stop()
    assert not simulator.faults.any
    assert loaded.fire(0.2).started
    assert_plays(simulator, burst, (12.0, 8.0))


def test_unreadable_blocks_are_replaced_by_spot_checks(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst, heard: Any
) -> None:
    """If block replies never arrive, a record is verified by its length and 64 single points."""
    simulator.faults.inject("garbled_reply", when=BLOCK_BACK, times=99)
    rig = open_generator()
    rig.load(burst)
    assert len(heard.of("record_spot_check")) == 2
    assert rig.fire(0.1).started
    assert_plays(simulator, burst, (6.0, 4.0))


def test_spot_checks_read_the_memory_that_is_played(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst
) -> None:
    """If both copies back are lost, the edit memory still contains what was sent, whatever USER1 contains."""
    at = int(burst.codes[0].argmax())
    spoil = f"DATA:DATA:VAL EMEM,{at + 1},8191;:DATA:COPY USER1;:DATA:DATA:VAL EMEM,{at + 1},{burst.codes[0, at]}"
    simulator.faults.inject("front_panel", when="COPY USER1,EMEM", value=spoil, times=2)
    simulator.faults.inject("ignored_message", when="COPY EMEM,USER1", times=2)
    rig = open_generator(patience=Patience(reply=0.2, copy=0.4, tries=2, pause=0.02))
    with pytest.raises(RigError, match="USER1 does not hold the record that was sent, after two uploads"):
        rig.load(burst)


def test_a_record_that_reads_back_wrong_twice_is_refused(
    simulator: Simulator, open_generator: Callable[..., Generator], burst: Burst
) -> None:
    """After two uploads that read back wrong there is no third, and the outputs are off."""
    simulator.faults.inject("garbled_upload", when=UPLOAD, times=99)
    rig = open_generator()
    with pytest.raises(RigError, match="USER1 does not hold the record that was sent, after two uploads"):
        rig.load(burst)
    assert simulator.outputs == (False, False)


KINDS = (
    "delayed_reply",
    "lost_reply",
    "garbled_reply",
    "truncated_reply",
    "dropped_connection",
    "dropped_reply",
    "ignored_message",
    "truncated_upload",
    "garbled_upload",
    "scpi_error",
    "power_cycle",
    "wrong_reply",
)

WRONG = ("", "nonsense", "1", "0", "-1", "9.9E37", "1;1", "0;0;0;0;0", '0,"No error"', "1;1;1;1;0", "nan", "USER1;TRIG")
"""Replies to other queries, or to none."""


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(kind=st.sampled_from(KINDS), nth=st.integers(0, 60), times=st.integers(1, 2))
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
                    firing = rig.fire(level)
                    plays = firing.started and simulator.outputs == (True, True)
                    amplitudes = tuple(channel.amplitude for channel in simulator.afg.channels.values())
                    rig.stop()
                    assert simulator.outputs == (False, False)
                    if rig.firing is not None and rig.firing.confirmed:
                        assert plays
                        assert amplitudes == pytest.approx(burst.amplitude_for(level), rel=1e-3)
        except RigError as error:
            refused = str(error)
    assert "output" in refused
    assert simulator.outputs == (False, False)


class counted:  # noqa: N801
    """Perform an action just before the n-th message over a link."""

    def __init__(self, simulator: Simulator, nth: int, action: Callable[[], None]) -> None:
        self._instrument = simulator.afg
        self._execute = self._instrument.execute
        self._left = nth
        self._action = action

    def __enter__(self) -> None:
        def execute(message: bytes, *link: int) -> Any:
            if self._left == 0:
                self._action()
            self._left -= 1
            return self._execute(message, *link)

        self._instrument.execute = execute

    def __exit__(self, *exc: object) -> None:
        self._instrument.execute = self._execute


@pytest.fixture(autouse=True)
def _faults_end(simulator: Simulator) -> Iterator[None]:
    """Clear the faults before the driver closes."""
    yield
    simulator.faults.clear()
