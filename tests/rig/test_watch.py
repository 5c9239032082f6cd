"""The watchdog's reactions to requests, silence and the end of its pipe, without a process or an instrument."""

from __future__ import annotations

import io
import itertools
import json
import math
import queue
import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from modaltouch.rig import watchdog_process as watchdog
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.interface import InUse
from modaltouch.rig.pacing import Order, Pacer
from modaltouch.rig.watchdog_process import (
    ARM,
    BEAT,
    CLEAN,
    CLOSE,
    DISARM,
    DONE,
    END,
    EXCHANGE,
    FAILED,
    FLAG,
    LATE,
    LONG_PERSISTENCE,
    OPEN,
    PERSISTENCE,
    PLAY,
    REPORT,
    TAKEN,
    TERMS,
    WatchdogProcess,
    frame,
    read_frames,
)
from modaltouch.system.clock import SYSTEM_CLOCK, Clock, VirtualClock

ASKED_OFF = AFG3022B.off
OFF = ASKED_OFF.encode() + b"\n"


class Instrument:
    """Record the messages, and give prepared answers, the last one repeatedly."""

    def __init__(self, *answers: object) -> None:
        self.answers = list(answers) or [b"0;0\n"]
        self.sent: list[bytes] = []
        self.replies: list[bool] = []
        self.opened = 0
        self.is_off = threading.Event()

    def open(self) -> str:
        self.opened += 1
        return "locked out"

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> Any:
        self.sent.append(message)
        if message == OFF:
            self.is_off.set()
        self.replies.append(reply)
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self, *, broken: bool) -> None:
        self.sent.append(b"broken" if broken else b"closed")


class Pipe:
    """Return what is written to it, as a pipe does, until it is closed."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._more = threading.Condition()
        self._closed = False

    def write(self, *requests: bytes) -> None:
        with self._more:
            self._data += b"".join(requests)
            self._more.notify()

    def close(self) -> None:
        with self._more:
            self._closed = True
            self._more.notify()

    def read(self, size: int) -> bytes:
        with self._more:
            self._more.wait_for(lambda: self._closed or len(self._data) >= size, timeout=5)
            data = bytes(self._data[:size])
            del self._data[:size]
            return data


def serve(instrument: Instrument, *requests: bytes) -> list[tuple[bytes, int, bytes]]:
    """Carry out requests until their end, and return the answers."""
    answers = bytearray()
    watch = WatchdogProcess(instrument, ASKED_OFF, limit=0.05, persistence=0.1)
    watch.serve(io.BytesIO(b"".join(requests)), answers.extend)
    return list(read_frames(io.BytesIO(bytes(answers))))


def request(letter: bytes) -> bytes:
    """Return a request with default content."""
    return frame(letter, 0, FLAG.pack(False) if letter in (ARM, REPORT) else b"")


def ask(number: int, message: bytes) -> bytes:
    """Return the request for an exchange."""
    return frame(EXCHANGE, number, TERMS.pack(1.0, True, False) + message)


@pytest.mark.parametrize(
    ("requests", "pressed"),
    [
        ([], False),
        ([CLEAN], False),
        ([OPEN], True),
        ([OPEN, CLEAN], False),
        ([OPEN, ARM], True),
        ([OPEN, ARM, BEAT], True),
        ([OPEN, ARM, DISARM], True),
        ([OPEN, ARM, DISARM, CLEAN], False),
        ([OPEN, ARM, CLEAN], False),
    ],
)
def test_the_end_of_the_pipe_without_a_clean_end_switches_off(requests: list[bytes], pressed: bool) -> None:
    """A session that opened the instrument and did not announce a clean end counts as dead (module docstring)."""
    instrument = Instrument()
    serve(instrument, *map(request, requests))
    assert (OFF in instrument.sent) is pressed


def test_answers_have_the_numbers_of_their_requests() -> None:
    """Done and failed are distinguished; the message of an error is included."""
    instrument = Instrument(b"reply\n", TimeoutError("too late"), b"0;0\n")
    answers = serve(
        instrument, frame(OPEN, 7), ask(8, b"*IDN?\n"), ask(9, b"*OPC?\n"), frame(CLOSE, 10, TERMS.pack(0, False, True))
    )
    assert answers == [
        (DONE, 7, b"locked out"),
        (DONE, 8, b"reply\n"),
        (FAILED, 9, b"TimeoutError: too late"),
        (DONE, 10, b""),
    ]
    assert instrument.sent[:3] == [b"*IDN?\n", b"*OPC?\n", b"broken"]


def test_an_instrument_of_another_program_is_not_touched() -> None:
    """It was never opened: nothing is switched off at the end."""

    class Taken(Instrument):
        def open(self) -> str:
            raise InUse("another program has locked it")

    instrument = Taken()
    assert serve(instrument, frame(OPEN, 1)) == [(TAKEN, 1, b"another program has locked it")]
    assert instrument.sent == []


@pytest.mark.parametrize(
    "rubbish",
    [
        b"x",
        bytes(13),
        b"mtwd",
        struct.pack(">4scII", b"mtwd", b"X", 1, 99),
        struct.pack(">4scII", b"mtwx", CLEAN, 1, 0),
    ],
)
def test_invalid_data_in_the_pipe_counts_as_its_end(rubbish: bytes) -> None:
    """An invalid or incomplete request switches the outputs off."""
    instrument = Instrument()
    serve(instrument, frame(OPEN, 1), rubbish)
    assert instrument.sent == [OFF]


def silent(instrument: Instrument, *letters: bytes, seconds: float = 0.3) -> int:
    """Return how often an instrument is switched off during a silence after some requests."""
    pipe = Pipe()
    watch = WatchdogProcess(instrument, ASKED_OFF, limit=0.05, persistence=0.1)
    serving = threading.Thread(target=watch.serve, args=(pipe, lambda data: None))
    serving.start()
    pipe.write(*map(request, letters))
    time.sleep(seconds)
    if {ARM} <= {*letters} and DISARM not in letters:  # on a busy machine the silence may begin late
        assert instrument.is_off.wait(20)
    pressed = instrument.sent.count(OFF)
    pipe.write(frame(CLEAN, 0))
    serving.join(5)
    return pressed


@pytest.mark.parametrize(
    ("letters", "pressed"),
    [((OPEN, ARM), 1), ((OPEN, ARM, BEAT), 1), ((OPEN,), 0), ((OPEN, BEAT), 0), ((OPEN, ARM, DISARM), 0)],
)
def test_silence_switches_off_only_while_armed(letters: tuple[bytes, ...], pressed: int) -> None:
    """0.3 s without a heartbeat at a limit of 0.05 s: off, once; a heartbeat alone does not arm."""
    assert silent(Instrument(), *letters) == pressed


def test_the_limit_on_silence_matches_the_readme() -> None:
    """The README of the rig; `test_watchdog.py` checks it with processes."""
    text = " ".join((Path(watchdog.__file__).parent / "README.md").read_text(encoding="utf-8").split())
    assert f"or falls silent for {watchdog.PATIENCE:g} s while outputs may be on" in text


def test_heartbeats_keep_the_outputs_on() -> None:
    """A heartbeat every 0.02 s at a limit of half a second: never switched off, and the bursts continue."""
    pipe, instrument = Pipe(), Instrument()
    watch = WatchdogProcess(instrument, ASKED_OFF, limit=0.5)
    serving = threading.Thread(target=watch.serve, args=(pipe, lambda data: None))
    serving.start()
    pipe.write(request(OPEN), request(ARM), frame(PLAY, 0, order(5)))
    for _ in range(15):
        time.sleep(0.02)
        pipe.write(frame(BEAT, 0))
    pressed, told = instrument.sent.count(OFF), json.loads(watch._encoded_report())
    pipe.write(frame(END, 0), frame(CLEAN, 0))
    serving.join(5)
    assert pressed == 0
    assert told["ended"] == ""


class Waiting(Instrument):
    """Does not answer until permitted."""

    def __init__(self) -> None:
        super().__init__()
        self.may_answer = threading.Event()

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> Any:
        assert self.may_answer.wait(10)
        return super().exchange(message, timeout=timeout, reply=reply)


def test_heartbeats_are_received_during_a_long_exchange() -> None:
    """Answered during the exchange, with the time of arrival; silence then counts from the end of the exchange."""
    instrument, clock = Waiting(), VirtualClock(50.0)
    master = Master(instrument, clock)
    master.pipe.write(ask(1, b"*IDN?\n"), frame(BEAT, 2))
    ((done, number, _),) = read_frames(io.BytesIO(master.answers.get(timeout=60)))
    assert (done, number) == (DONE, 2)
    clock.sleep(0.4)
    instrument.may_answer.set()
    ((_, number, answer),) = read_frames(io.BytesIO(master.answers.get(timeout=60)))
    assert (number, answer) == (1, b"0;0\n")
    assert clock.now() - master.watch._heard == pytest.approx(0.4)
    assert master.watch._silence() == 0
    master.pipe.write(frame(CLEAN, 0))
    master.serving.join(10)


class Sluggish(VirtualClock):
    """Oversleep by 0.3 s each time."""

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds + 0.3)


def test_the_watchdog_reports_its_own_delay() -> None:
    """It checks every 50 ms; any excess counts as its delay since it was armed."""
    watch = WatchdogProcess(Instrument(), ASKED_OFF, clock=Sluggish(50.0))

    def late() -> float:
        answered = watch._carry_out(LATE, b"", lambda content: None)
        assert answered is not None
        return float(answered[1])

    def arm() -> None:
        watch._carry_out(ARM, FLAG.pack(False), lambda content: None)

    arm()
    assert late() == 0
    off = threading.Event()
    watch.switch_off = lambda: bool(off.set()) or True  # type: ignore[method-assign]
    threading.Thread(target=watch._watch_client, daemon=True).start()
    assert off.wait(10)
    assert late() == pytest.approx(0.3, abs=1e-6)
    watch._armed = threading.Event()
    arm()
    assert late() == 0


def test_switching_off_is_repeated_over_new_sessions() -> None:
    """A lost reply, then an output that stays on: off at the third attempt, each over a new session."""
    instrument = Instrument(TimeoutError("lost"), b"0;1\n", b"0;0\n")
    assert WatchdogProcess(instrument, ASKED_OFF, persistence=5).switch_off()
    assert instrument.sent == [OFF, b"broken", OFF, b"broken", OFF]
    assert instrument.replies == [True] * 3
    assert instrument.opened == 2


def test_replies_of_0_or_off_confirm_that_an_output_is_off() -> None:
    """Generators use both for `OUTP?`; a missing reply does not confirm the other output."""
    instrument = Instrument(b"OFF\n", b"OFF;ON\n", b"off;OFF\n")
    assert WatchdogProcess(instrument, ASKED_OFF, persistence=5).switch_off()
    assert instrument.sent.count(OFF) == 3


class Terminal:
    """Record the messages to the terminal and their times [s]."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.said: list[tuple[float, str]] = []

    def __call__(self, sentence: str) -> None:
        self.said.append((self.clock.now(), sentence))


class Dead(Instrument):
    """Answer only from a given instant on."""

    def __init__(self, clock: VirtualClock, until: float) -> None:
        super().__init__()
        self.clock = clock
        self.until = until

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> Any:
        if self.clock.now() < self.until:
            raise OSError("gone")
        return super().exchange(message, timeout=timeout, reply=reply)


STILL, NOBODY = (
    f"the generator does not confirm that its outputs are off ({trying}): SWITCH THE AMPLIFIER OFF"
    for trying in ("still trying", "no further attempt")
)


@pytest.mark.parametrize(("free_running", "patience"), [(False, 30.0), (True, 3600.0)])
def test_a_failure_to_switch_off_is_repeated_on_the_terminal(free_running: bool, patience: float) -> None:
    """After one second, then every ten; the last message after 30 s, or after an hour if bursts are free-running."""
    assert (PERSISTENCE, LONG_PERSISTENCE) == (30.0, 3600.0)
    clock = VirtualClock(50.0)
    terminal, instrument = Terminal(clock), Dead(clock, math.inf)
    watch = WatchdogProcess(instrument, ASKED_OFF, say=terminal, clock=clock)
    if free_running:
        watch._carry_out(ARM, FLAG.pack(True), lambda content: None)
    assert watch.switch_off() is False
    times, words = zip(*terminal.said, strict=True)
    assert times[0] == pytest.approx(51.0, abs=0.6)
    gaps = [later - earlier for earlier, later in itertools.pairwise(times[:-1])]
    assert all(10 <= gap <= 10.6 for gap in gaps)
    assert times[-1] - 50 == pytest.approx(patience, abs=0.6)
    assert words[-2] == STILL
    assert set(words[:-1]) == {STILL}
    assert words[-1] == NOBODY
    assert instrument.opened == instrument.sent.count(b"broken") >= 2 * (patience - 5)


@pytest.mark.parametrize(("dead_for", "said"), [(0.1, []), (0.5, []), (5.0, [STILL]), (15.0, [STILL, STILL])])
def test_the_end_of_a_warning_is_shown_only_after_a_warning(dead_for: float, said: list[str]) -> None:
    """After a warning to switch the amplifier off, success is shown as well; otherwise nothing is."""
    clock = VirtualClock(50.0)
    terminal = Terminal(clock)
    assert WatchdogProcess(Dead(clock, 50 + dead_for), ASKED_OFF, say=terminal, clock=clock).switch_off()
    over = ["the generator's outputs are off now"] if said else []
    assert [words for _, words in terminal.said] == said + over
    assert clock.now() - 50 <= min(2 * dead_for + 0.05, dead_for + 0.5)


class Master:
    """The client of a watchdog that runs in a thread."""

    def __init__(self, instrument: Instrument, clock: Clock = SYSTEM_CLOCK) -> None:
        self.answers: queue.Queue[bytes] = queue.Queue()
        self.pipe = Pipe()
        self.watch = WatchdogProcess(instrument, ASKED_OFF, clock=clock)
        self.serving = threading.Thread(target=self.watch.serve, args=(self.pipe, self.answers.put))
        self.serving.start()

    def ask(self, letter: bytes, content: bytes = b"") -> dict[str, Any]:
        """Return the report that answers a request."""
        self.pipe.write(frame(letter, 1, content))
        ((done, _, answer),) = read_frames(io.BytesIO(self.answers.get(timeout=60)))
        assert done == DONE
        return dict(json.loads(answer))


@pytest.fixture
def master() -> Iterator[Master]:
    """Return the client of a watchdog that ends with the test."""
    master = Master(Instrument())
    yield master
    master.pipe.write(frame(END, 0), frame(CLEAN, 0))
    master.serving.join(10)
    assert not master.serving.is_alive()


def order(n_bursts: int, command: str = "*TRG") -> bytes:
    """Return an order for bursts 1,000 s apart, the first one due now."""
    return json.dumps(asdict(Order(command, n_bursts, SYSTEM_CLOCK.now(), 1000.0, 0.05, 1.0))).encode()


@pytest.mark.parametrize("how", [END, REPORT, PLAY])
def test_a_request_ends_the_bursts_between_two_of_them(master: Master, how: bytes) -> None:
    """The first is triggered and reported immediately; to end, report or play another order waits for no burst."""
    first = master.ask(PLAY, order(5))
    assert (first["due"], first["played"], first["ended"]) == (1, 1, "")
    assert master.ask(BEAT) == first
    pacing = master.watch._pacing
    if how == END:
        master.pipe.write(frame(END, 2))
    elif how == REPORT:
        assert master.ask(REPORT, FLAG.pack(False))["ended"] == "asked"
    else:
        assert master.ask(PLAY, order(1, "TRIG:SEQ:IMM"))["ended"] == "count"
    pacing.join(10)
    assert not pacing.is_alive()
    instrument = master.watch._transport
    assert instrument.sent == [b"*TRG\n", *([b"TRIG:SEQ:IMM\n"] if how == PLAY else [])]
    assert not any(instrument.replies)
    ended = master.ask(REPORT, FLAG.pack(True))
    assert ended["ended"] == ("count" if how == PLAY else "asked")


def test_a_report_waits_for_the_last_burst_if_requested() -> None:
    """A burst of 50 ms that has just begun: 50 ms, and no further wait the second time."""
    clock = VirtualClock(50.0)
    watch = WatchdogProcess(Instrument(), ASKED_OFF, clock=clock)
    watch._pacer = pacer = Pacer(Order("*TRG", 1, 50.0, 0.2, 0.05, 0.1), lambda: None, lambda: 0.0, clock)
    pacer.step()
    for wait, now in ((False, 50.0), (True, 50.05), (True, 50.05)):
        assert json.loads(watch._report(wait))["played"] == 1
        assert clock.now() == pytest.approx(now)


@pytest.mark.parametrize(("command", "end"), [("*TRG", 50.2), ("refused", 50.15)])
def test_a_report_after_a_failure_waits_for_an_accepted_burst(command: str, end: float) -> None:
    """Accepted 150 ms late in 200 ms, it may play for its 50 ms; a trigger that was refused plays nothing."""
    clock = VirtualClock(50.0)
    watch = WatchdogProcess(Instrument(), ASKED_OFF, clock=clock)

    def trigger() -> None:
        clock.sleep(0.15)
        if command == "refused":
            raise TimeoutError

    watch._pacer = Pacer(Order(command, 1, 50.0, 0.2, 0.05, 0.1), trigger, lambda: 0.0, clock)
    watch._pacer.step()
    assert json.loads(watch._report(True))["ended"] == "failed"
    assert clock.now() == pytest.approx(end)


def test_a_report_without_an_order_is_empty(master: Master) -> None:
    """Neither a report nor a look has any content."""
    assert master.ask(REPORT, FLAG.pack(True)) == master.ask(BEAT) == {}


def test_the_end_of_the_pipe_ends_the_bursts() -> None:
    """The session is gone: no further burst."""
    master = Master(Instrument())
    master.pipe.write(frame(OPEN, 0))
    master.answers.get(timeout=60)
    master.ask(PLAY, order(5))
    pacing, pacer = master.watch._pacing, master.watch._pacer
    master.pipe.close()
    master.serving.join(10)
    pacing.join(10)
    assert pacer is not None
    assert pacer.report.ended == "asked"


def test_bursts_requested_just_before_the_end_of_the_pipe_are_not_played() -> None:
    """Killed right after its request, which waits for an exchange: the pipe has ended before it is carried out."""
    instrument = Waiting()
    master = Master(instrument)
    later = Order("*TRG", 5, SYSTEM_CLOCK.now() + 1000.0, 1.0, 0.05, 1.0)
    master.pipe.write(ask(1, b"*IDN?\n"), frame(PLAY, 2, json.dumps(asdict(later)).encode()))
    master.pipe.close()
    instrument.may_answer.set()
    master.serving.join(10)
    master.watch._pacing.join(10)
    assert master.watch._pacer is not None
    assert master.watch._pacer.report.ended == "asked"
    assert b"*TRG\n" not in instrument.sent


def test_messages_and_answers_use_separate_streams(capfd: pytest.CaptureFixture[str]) -> None:
    """Answers go through the pipe unchanged, messages to the terminal on separate lines."""
    watchdog._answer(b"mtwd+")
    watchdog._say("it is on")
    assert capfd.readouterr() == ("mtwd+", "\nmodaltouch: it is on\n")


def test_the_watchdog_raises_its_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """A burst that waits for the processor or for garbage collection is late."""
    done: list[Any] = []
    monkeypatch.setattr(watchdog.os, "setpriority", lambda *asked: done.append(asked))
    monkeypatch.setattr(watchdog.gc, "disable", lambda: done.append("gc"))
    watchdog._take_precedence()
    assert done == ["gc", (watchdog.os.PRIO_PROCESS, 0, -10)]


def test_a_clean_end_closes_an_intact_session_in_order() -> None:
    """The instrument is notified, since it would keep the link otherwise."""
    instrument = Instrument()
    serve(instrument, request(OPEN), request(CLEAN))
    assert instrument.sent == [b"closed"]


def test_a_failed_trigger_is_reported_with_the_next_heartbeat() -> None:
    """A heartbeat is answered with the report of the bursts, which is empty before a stimulus begins."""
    master = Master(Instrument(OSError("gone"), b"0;0\n"))
    failed = master.ask(PLAY, order(5))
    assert (failed["played"], failed["ended"], failed["reason"]) == (0, "failed", "trigger 1 failed (OSError: gone)")
    assert master.ask(BEAT) == failed
    master.pipe.write(request(ARM), frame(LATE, 4))
    ((_, number, _),) = read_frames(io.BytesIO(master.answers.get(timeout=60)))
    assert number == 4, "the next stimulus is being prepared"
    assert master.ask(BEAT) == {}, "a stimulus that has not begun cannot be lost"
    assert master.ask(PLAY, order(5))["ended"] == ""
    assert master.ask(BEAT)["ended"] == ""
    master.pipe.write(frame(END, 0), frame(CLEAN, 0))
    master.serving.join(10)
