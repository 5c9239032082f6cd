"""The watchdog's reactions to requests, silence and the end of its pipe, without a process or an instrument."""

from __future__ import annotations

import io
import itertools
import math
import os
import pickle
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from modaltouch.rig import watchdog_process as watchdog
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.interface import InUse, LinkError
from modaltouch.rig.pacing import Order, Pacer, Report
from modaltouch.rig.watchdog_process import LONG_PERSISTENCE, PERSISTENCE, WatchdogProcess
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


Asked = tuple[str, dict[str, Any]]


def ask(name: str, **arguments: Any) -> Asked:
    """Return a request; one to arm is for bursts that need triggers."""
    return name, arguments or ({"free_running": False} if name == "arm" else {})


def exchange(message: bytes) -> Asked:
    """Return the request for an exchange."""
    return ask("exchange", message=message, timeout=1.0, reply=True)


def serve(instrument: Instrument, *requests: Asked, rubbish: bytes = b"") -> list[Any]:
    """Carry out requests until their end, and return number and content of each answer."""
    answers = io.BytesIO()
    watch = WatchdogProcess(instrument, ASKED_OFF, limit=0.05, persistence=0.1)
    written = b"".join(pickle.dumps((number, *request)) for number, request in enumerate(requests))
    watch.serve(io.BytesIO(written + rubbish), answers)
    answers.seek(0)
    told = []
    while answers.tell() < len(answers.getvalue()):
        told.append(pickle.load(answers))
    return told


@pytest.mark.parametrize(
    ("requests", "pressed"),
    [
        ("", False),
        ("release", False),
        ("open", True),
        ("open release", False),
        ("open arm", True),
        ("open arm look", True),
        ("open arm disarm", True),
        ("open arm disarm release", False),
        ("open arm release", False),
    ],
)
def test_the_end_of_the_pipe_without_a_clean_end_switches_off(requests: str, pressed: bool) -> None:
    """A session that opened the instrument and did not announce a clean end counts as dead (module docstring)."""
    instrument = Instrument()
    serve(instrument, *map(ask, requests.split()))
    assert (OFF in instrument.sent) is pressed


def test_answers_have_the_numbers_of_their_requests() -> None:
    """A failure is an exception with the message of the error."""
    instrument = Instrument(b"reply\n", TimeoutError("too late"), b"0;0\n")
    requests = ask("open"), exchange(b"*IDN?\n"), exchange(b"*OPC?\n"), ask("close", broken=True)
    opened, replied, failed, closed = serve(instrument, *requests)
    assert (opened, replied, closed) == ((0, "locked out"), (1, b"reply\n"), (3, None))
    assert failed[0] == 2
    assert (type(failed[1]), str(failed[1])) == (LinkError, "TimeoutError: too late")
    assert instrument.sent[:3] == [b"*IDN?\n", b"*OPC?\n", b"broken"]


def test_an_instrument_of_another_program_is_not_touched() -> None:
    """It was never opened: nothing is switched off at the end."""

    class Taken(Instrument):
        def open(self) -> str:
            raise InUse("another program has locked it")

    instrument = Taken()
    ((_, answer),) = serve(instrument, ask("open"))
    assert (type(answer), str(answer)) == (InUse, "another program has locked it")
    assert instrument.sent == []


@pytest.mark.parametrize(
    "rubbish", [b"x", bytes(13), pickle.dumps((1, "release", {}))[:-1], pickle.dumps(7), pickle.dumps((1, "lock", {}))]
)
def test_invalid_data_in_the_pipe_counts_as_its_end(rubbish: bytes) -> None:
    """An invalid or incomplete request switches the outputs off."""
    instrument = Instrument()
    serve(instrument, ask("open"), rubbish=rubbish)
    assert instrument.sent == [OFF]


class Master:
    """The client of a watchdog that runs in a thread."""

    def __init__(self, instrument: Instrument, clock: Clock = SYSTEM_CLOCK, **options: Any) -> None:
        theirs, self._requests = (os.fdopen(end, mode) for end, mode in zip(os.pipe(), ("rb", "wb"), strict=True))
        self._answers, ours = (os.fdopen(end, mode) for end, mode in zip(os.pipe(), ("rb", "wb"), strict=True))
        self.watch = WatchdogProcess(instrument, ASKED_OFF, clock=clock, **options)

        def serve() -> None:
            with theirs, ours:
                self.watch.serve(theirs, ours)

        self.serving = threading.Thread(target=serve)
        self.serving.start()

    def tell(self, name: str, **arguments: Any) -> None:
        """Send a request without awaiting the answer."""
        self._requests.write(pickle.dumps((1, *ask(name, **arguments))))
        self._requests.flush()

    def ask(self, name: str, **arguments: Any) -> Any:
        """Return the answer to a request."""
        self.tell(name, **arguments)
        return self.read()

    def read(self) -> Any:
        """Return the next answer."""
        return pickle.load(self._answers)[1]

    def hang_up(self) -> None:
        """Close the pipe, and wait for the end."""
        self._requests.close()
        self.serving.join(10)
        self._answers.close()
        assert not self.serving.is_alive()

    def leave(self) -> None:
        """End the bursts and the watchdog."""
        self.ask("end")
        self.tell("release")
        self.hang_up()


def silent(instrument: Instrument, names: list[str], seconds: float = 0.3) -> int:
    """Return how often an instrument is switched off during a silence after some requests."""
    master = Master(instrument, limit=0.05, persistence=0.1)
    for name in names:
        master.ask(name)
    time.sleep(seconds)
    if "arm" in names and "disarm" not in names:  # on a busy machine the silence may begin late
        assert instrument.is_off.wait(20)
    pressed = instrument.sent.count(OFF)
    master.leave()
    return pressed


@pytest.mark.parametrize(
    ("names", "pressed"),
    [("open arm", 1), ("open arm look", 1), ("open", 0), ("open look", 0), ("open arm disarm", 0)],
)
def test_silence_switches_off_only_while_armed(names: str, pressed: int) -> None:
    """0.3 s without a heartbeat at a limit of 0.05 s: off, once; a heartbeat alone does not arm."""
    assert silent(Instrument(), names.split()) == pressed


def test_the_limit_on_silence_matches_the_readme() -> None:
    """The README of the rig; `test_watchdog.py` checks it with processes."""
    text = " ".join((Path(watchdog.__file__).parent / "README.md").read_text(encoding="utf-8").split())
    assert f"or falls silent for {watchdog.PATIENCE:g} s while outputs may be on" in text


def test_heartbeats_keep_the_outputs_on() -> None:
    """A heartbeat every 0.02 s at a limit of half a second: never switched off, and the bursts continue."""
    instrument = Instrument()
    master = Master(instrument, limit=0.5)
    for name in ("open", "arm"):
        master.ask(name)
    master.ask("play", order=order(5))
    for _ in range(15):
        time.sleep(0.02)
        told = master.ask("look")
    pressed = instrument.sent.count(OFF)
    master.leave()
    assert pressed == 0
    assert told.ended == ""


class Waiting(Instrument):
    """Does not answer until permitted."""

    def __init__(self) -> None:
        super().__init__()
        self.may_answer = threading.Event()

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> Any:
        assert self.may_answer.wait(10)
        return super().exchange(message, timeout=timeout, reply=reply)


def test_a_long_exchange_is_no_silence() -> None:
    """Silence counts from the end of the exchange that the client awaits, however long it took."""
    instrument, clock = Waiting(), VirtualClock(50.0)
    master = Master(instrument, clock)
    master.tell("exchange", message=b"*IDN?\n", timeout=1.0, reply=True)
    clock.sleep(0.4)
    instrument.may_answer.set()
    assert master.read() == b"0;0\n"
    assert master.watch._silence() == 0
    master.leave()


class Sluggish(VirtualClock):
    """Oversleep by 0.3 s each time."""

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds + 0.3)


def test_the_watchdog_reports_its_own_delay() -> None:
    """It checks every 50 ms; any excess counts as its delay since it was armed."""
    watch = WatchdogProcess(Instrument(), ASKED_OFF, clock=Sluggish(50.0))

    watch.arm(free_running=False)
    assert watch.held_up() == 0
    off = threading.Event()
    watch.switch_off = lambda: bool(off.set()) or True  # type: ignore[method-assign]
    threading.Thread(target=watch._watch_client, daemon=True).start()
    assert off.wait(10)
    assert watch.held_up() == pytest.approx(0.3, abs=1e-6)
    watch._armed = threading.Event()
    watch.arm(free_running=False)
    assert watch.held_up() == 0


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
        watch.arm(free_running=True)
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


@pytest.fixture
def master() -> Iterator[Master]:
    """Return the client of a watchdog that ends with the test."""
    master = Master(Instrument())
    yield master
    master.leave()


def order(n_bursts: int, command: str = "*TRG") -> Order:
    """Return an order for bursts 1,000 s apart, the first one due now."""
    return Order(command, n_bursts, SYSTEM_CLOCK.now(), 1000.0, 0.05, 1.0)


def played(master: Master, order: Order) -> Report:
    """Return the report after the first burst."""
    master.ask("play", order=order)
    until = time.monotonic() + 60
    while not ((report := master.ask("look")).first or report.ended):
        assert time.monotonic() < until
        time.sleep(1e-3)
    return report


@pytest.mark.parametrize("how", ["end", "report", "play"])
def test_a_request_ends_the_bursts_between_two_of_them(master: Master, how: str) -> None:
    """The first is triggered and reported immediately; to end, report or play another order waits for no burst."""
    first = played(master, order(5))
    assert (first.due, first.played, first.ended) == (1, 1, "")
    pacing = master.watch._pacing
    if how == "end":
        master.ask("end")
    elif how == "report":
        assert master.ask("report", wait=False).ended == "asked"
    else:
        assert played(master, order(1, "TRIG:SEQ:IMM")).ended == "count"
    pacing.join(10)
    assert not pacing.is_alive()
    instrument = master.watch._transport
    assert instrument.sent == [b"*TRG\n", *([b"TRIG:SEQ:IMM\n"] if how == "play" else [])]
    assert not any(instrument.replies)
    assert master.ask("report", wait=True).ended == ("count" if how == "play" else "asked")


def test_a_report_waits_for_the_last_burst_if_requested() -> None:
    """A burst of 50 ms that has just begun: 50 ms, and no further wait the second time."""
    clock = VirtualClock(50.0)
    watch = WatchdogProcess(Instrument(), ASKED_OFF, clock=clock)
    watch._pacer = pacer = Pacer(Order("*TRG", 1, 50.0, 0.2, 0.05, 0.1), lambda: None, lambda: 0.0, clock)
    pacer.step()
    for wait, now in ((False, 50.0), (True, 50.05), (True, 50.05)):
        assert watch.report(wait=wait).played == 1
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
    assert watch.report(wait=True).ended == "failed"
    assert clock.now() == pytest.approx(end)


def test_a_report_without_an_order_is_empty(master: Master) -> None:
    """Neither a report nor a look has any content."""
    assert master.ask("report", wait=True) == master.ask("look") == Report()


def test_the_end_of_the_pipe_ends_the_bursts() -> None:
    """The session is gone: no further burst."""
    master = Master(Instrument())
    master.ask("open")
    played(master, order(5))
    pacing, pacer = master.watch._pacing, master.watch._pacer
    master.hang_up()
    pacing.join(10)
    assert pacer is not None
    assert pacer.report.ended == "asked"


def test_bursts_requested_just_before_the_end_of_the_pipe_are_not_played() -> None:
    """Killed right after its request: the end of the pipe follows."""
    instrument = Instrument()
    master = Master(instrument)
    master.tell("play", order=Order("*TRG", 5, SYSTEM_CLOCK.now() + 1000.0, 1.0, 0.05, 1.0))
    master.hang_up()
    master.watch._pacing.join(10)
    assert master.watch._pacer is not None
    assert master.watch._pacer.report.ended == "asked"
    assert b"*TRG\n" not in instrument.sent


def test_messages_and_answers_use_separate_streams(capfd: pytest.CaptureFixture[str]) -> None:
    """Answers go through the pipe, messages to the terminal on separate lines."""
    watchdog._say("it is on")
    assert capfd.readouterr() == ("", "\nmodaltouch: it is on\n")


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
    serve(instrument, ask("open"), ask("release"))
    assert instrument.sent == [b"closed"]


def test_a_failed_trigger_is_reported_with_the_next_heartbeat() -> None:
    """A heartbeat is answered with the report of the bursts, which is empty before a stimulus begins."""
    master = Master(Instrument(OSError("gone"), b"0;0\n"))
    failed = played(master, order(5))
    assert (failed.played, failed.ended, failed.reason) == (0, "failed", "trigger 1 failed (OSError: gone)")
    assert master.ask("look") == failed
    master.ask("arm")
    assert master.ask("look") == Report(), "a stimulus that has not begun cannot be lost"
    assert played(master, order(5)).ended == ""
    master.leave()
