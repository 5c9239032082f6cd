"""The driver with a real watchdog process: its cost, and what happens if it is gone or does not respond."""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.afg3022b import AFG3022B
from modaltouch.rig.connection import Patience
from modaltouch.rig.generator import Generator
from modaltouch.rig.interface import LinkError, RigError
from modaltouch.rig.pacing import PATIENCE, Order, Report
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.watchdog_client import WatchdogClient
from modaltouch.stimulus.burst import Burst


def small_burst() -> Burst:
    """Return a burst of a hundred points."""
    codes = np.full((2, 100), 8191, dtype=np.uint16)
    codes[:, 50] = 9000
    return Burst(codes, 0.05, 7.0, 0.2, (10.0, 10.0), AFG3022B.converter)


@pytest.fixture
def dogs() -> list[WatchdogClient]:
    """Return the list in which watchdogs are registered."""
    return []


@pytest.fixture
def rig(apparatus: Apparatus, single_link: Simulator, dogs: list[WatchdogClient]) -> Iterator[Generator]:
    """Return a driver with a real watchdog, loaded."""

    def begin(address: str, off: str) -> WatchdogClient:
        dogs.append(WatchdogClient(address, off))
        return dogs[-1]

    patience = Patience(reply=0.5)
    with Generator(single_link.address, apparatus, start_guard=begin, patience=patience) as generator:
        generator.load(small_burst())
        yield generator
    assert single_link.outputs == (False, False)


def test_a_slow_instrument_is_not_a_stalled_session(apparatus: Apparatus, single_link: Simulator) -> None:
    """Every exchange counts as a heartbeat: with 0.3 s per reply, starting takes over the limit and is not stopped."""
    with Generator(single_link.address, apparatus) as rig:
        rig.load(small_burst())
        rig.fire(0.1)
        rig.stop()
        single_link.faults.inject("delayed_reply", value=0.3, times=99)
        started = time.monotonic()
        assert rig.fire(0.1).started
        assert time.monotonic() - started > PATIENCE
        assert single_link.outputs == (True, True)
        single_link.faults.clear()
        rig.stop()
        assert rig.firing is not None
        assert rig.firing.confirmed


def test_an_exchange_longer_than_the_limit_is_not_a_stall(rig: Generator, single_link: Simulator) -> None:
    """While one message takes long, the session is waiting for the instrument."""
    rig.fire(0.1)
    single_link.faults.inject("slow_command", when="IDN", value=PATIENCE + 0.4)
    rig._connection.controls.ask("*IDN?", timeout=3)
    assert single_link.outputs == (True, True)


def test_a_lost_watchdog_stops_the_stimulus_and_is_replaced(
    rig: Generator, single_link: Simulator, dogs: list[WatchdogClient]
) -> None:
    """The heartbeat raises, a new watchdog has switched the outputs off, and the next trial can start."""
    rig.fire(0.1)
    dogs[0]._process.kill()
    dogs[0]._process.wait()
    time.sleep(0.15)
    with pytest.raises(RigError, match="watchdog process .* is gone.*the outputs were switched off"):
        rig.heartbeat()
    assert single_link.outputs == (False, False)
    assert rig.fire(0.1).started
    assert single_link.outputs == (True, True)


def test_an_unresponsive_watchdog_is_killed_and_replaced(
    rig: Generator, single_link: Simulator, dogs: list[WatchdogClient], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stopped process is killed after its timeouts, and the outputs go off."""
    monkeypatch.setattr("modaltouch.rig.watchdog_client.OVERHEAD", 0.5)
    rig.fire(0.1)
    stuck = dogs[0]._process
    os.kill(stuck.pid, signal.SIGSTOP)
    rig.stop()
    assert stuck.poll() == -signal.SIGKILL
    assert single_link.outputs == (False, False)
    assert rig.fire(0.1).started


@pytest.mark.parametrize("stopped", ["session", "watchdog"])
def test_a_delay_of_session_or_watchdog_is_detected(rig: Generator, dogs: list[WatchdogClient], stopped: str) -> None:
    """No thread runs for 0.6 s, as on a machine that swaps: over 0.5 s is reported; then the count restarts."""
    rig.fire(0.1)
    if stopped == "session":
        # A C function that holds Python's lock: pytest itself cannot be stopped without its terminal.
        ctypes.PyDLL(None).usleep(600_000)
    else:
        os.kill(dogs[0]._process.pid, signal.SIGSTOP)
        time.sleep(0.6)
        os.kill(dogs[0]._process.pid, signal.SIGCONT)
    time.sleep(0.1)
    held_up = dogs[0].held_up()
    assert held_up > 0.5
    rig.stop()
    rig.fire(0.1)
    assert dogs[0].held_up() < held_up
    rig.stop()


def test_a_signal_during_an_exchange_does_not_shift_replies(rig: Generator, single_link: Simulator) -> None:
    """If a handler raises while a reply is pending, the late reply is not taken for that to the next query."""

    def raise_it(*_: object) -> None:
        raise KeyboardInterrupt

    link = rig._connection.controls
    before = signal.signal(signal.SIGUSR2, raise_it)
    try:
        single_link.faults.inject("delayed_reply", when="IDN", value=0.3)
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGUSR2)).start()
        with pytest.raises(KeyboardInterrupt):
            link.ask("*IDN?")
    finally:
        signal.signal(signal.SIGUSR2, before)
    link.open()
    assert link.ask("*OPC?") == "1"
    assert link.ask("*IDN?").startswith("TEKTRONIX")


def test_the_rate_of_heartbeats_does_not_depend_on_the_calls(
    rig: Generator, dogs: list[WatchdogClient], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thread asks once every 45 ms at most; the call itself writes nothing."""
    rig.fire(0.1)
    sent: list[str] = []
    send = dogs[0]._send
    monkeypatch.setattr(dogs[0], "_send", lambda name: (sent.append(threading.current_thread().name), send(name)))
    started = time.perf_counter()
    while len(sent) < 5 and time.perf_counter() < started + 30:
        rig.heartbeat()
    assert 5 <= len(sent) <= (time.perf_counter() - started) / 0.045 + 1
    assert threading.main_thread().name not in sent


@pytest.mark.parametrize("clean", [True, False])
def test_a_released_watchdog_ends_and_refuses_requests(single_link: Simulator, clean: bool) -> None:
    """No process or thread remains; a later request raises an error."""
    before = set(threading.enumerate())
    dog = WatchdogClient(single_link.address, AFG3022B.off)
    own = {each for each in set(threading.enumerate()) - before if each.name.startswith("watchdog_")}
    dog.open()
    dog.release(clean=clean)
    assert dog._process.wait(10) == 0
    for thread in own:
        thread.join(10)
    assert len(own) == 2
    assert not any(thread.is_alive() for thread in own)
    with pytest.raises(LinkError, match=r"is gone \(exit status 0\)"):
        dog.arm(free_running=False)


def test_lost_bursts_are_reported_only_while_outputs_may_be_on(single_link: Simulator) -> None:
    """After the outputs have been switched off, nothing is reported."""
    dog = WatchdogClient(single_link.address, AFG3022B.off)
    try:
        dog.open()
        dog.arm(free_running=False)
        assert dog.beat() == ""
        dog._lost = "stalled: no heartbeat"
        assert dog.beat() == "stalled: no heartbeat"
        dog.disarm()
        assert dog.beat() == ""
    finally:
        dog.release(clean=True)


@pytest.mark.parametrize(("is_armed", "silence", "n_sent"), [(True, 0.0, 3), (True, PATIENCE, 0), (False, 0.0, 0)])
def test_heartbeats_are_sent_only_for_a_running_session(is_armed: bool, silence: float, n_sent: int) -> None:
    """A stalled session sends none, so that the watchdog switches off; with the outputs off none is needed."""
    dog: Any = object.__new__(WatchdogClient)
    rounds, sent = [True, False, False, False], []
    dog._released = SimpleNamespace(wait=lambda period: rounds.pop())
    dog._armed = SimpleNamespace(wait=lambda period: is_armed, is_set=lambda: is_armed)
    dog._lost, dog._broken, dog._came_round = "", None, time.monotonic() - silence
    dog._request = lambda limit, name: sent.append(name) or Report()
    dog._keep_beating()
    assert len(sent) == n_sent
    assert (rounds, dog.beat(), dog._broken) == ([], "", None)


class Gone:
    """A process that is killed, and from then on is gone."""

    pid = 7

    def __init__(self, answer: bytes = b"", error: BaseException | None = None) -> None:
        self.killed = False
        # The unpickler itself peeks for more than a byte.
        self.stdout = SimpleNamespace(peek=lambda size: b"x"[: size == 1], read=self.read, readline=self.read)
        self._answer, self._error = answer, error

    def read(self, size: int = -1) -> bytes:
        if self._error is not None:
            raise self._error
        data, self._answer = self._answer[:size], self._answer[size:]
        return data

    def kill(self) -> None:
        self.killed = True

    def wait(self, timeout: float) -> None:
        return None

    def poll(self) -> int:
        return -9


def test_a_pacer_that_reports_nothing_is_killed() -> None:
    """A trigger that never returns: the first burst is long overdue, and the outputs are unknown."""
    dog: Any = object.__new__(WatchdogClient)
    dog._process = process = Gone()

    def request(limit: float, name: str, **_: object) -> Report:
        if process.killed:
            raise LinkError("it is gone")
        return Report()

    dog._request = request
    with pytest.raises(LinkError, match="it is gone"):
        dog.play(Order("*TRG", 5, time.perf_counter() - 60.0, 0.142, 0.05, 0.1))


@pytest.mark.parametrize(
    ("process", "raised"),
    [
        (Gone(error=KeyboardInterrupt()), KeyboardInterrupt),
        (Gone(pickle.dumps((1, b"half of it"))[:-4]), LinkError),
        (Gone(b"no pickle"), LinkError),
    ],
    ids=["interrupted", "truncated", "garbled"],
)
def test_an_answer_that_is_not_read_whole_is_no_answer(process: Gone, raised: type[BaseException]) -> None:
    """The rest would be taken for the next one: the process is replaced."""
    dog: Any = object.__new__(WatchdogClient)
    dog._process = process
    with pytest.raises(raised):
        dog._answer()
    assert process.killed


def test_the_watchdog_uses_the_import_path_of_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """It runs the same version of the program, installed or not."""
    asked: list[dict[str, Any]] = []

    def refuse(*parts: object, **options: Any) -> None:
        asked.append(options["env"])
        raise OSError("enough is known")

    monkeypatch.setattr("modaltouch.rig.watchdog_client.subprocess.Popen", refuse)
    monkeypatch.setattr(sys, "path", ["", "/lab/modaltouch/src", *sys.path])
    with pytest.raises(RigError, match="enough is known"):
        WatchdogClient("TCPIP::192.0.2.1::INSTR", AFG3022B.off)
    assert asked[0]["PYTHONPATH"].split(os.pathsep)[0] == "/lab/modaltouch/src"


def test_the_exit_status_of_a_lost_watchdog_is_reported(single_link: Simulator) -> None:
    """Killed during an exchange, as when memory runs out: signal 9."""
    dog = WatchdogClient(single_link.address, AFG3022B.off)
    try:
        dog.open()
        single_link.faults.inject("slow_command", when="IDN", value=1.0)
        threading.Timer(0.2, dog._process.kill).start()
        with pytest.raises(LinkError, match=r"is gone \(exit status -9\), and the connection with it"):
            dog.exchange(b"*IDN?\n", timeout=3, reply=True)
    finally:
        dog.release(clean=False)


def test_no_generator_is_opened_if_the_watchdog_cannot_start(
    single_link: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rig error that advises what to check."""

    def refuse(*parts: object, **options: object) -> None:
        raise OSError("Resource temporarily unavailable")

    monkeypatch.setattr("modaltouch.rig.watchdog_client.subprocess.Popen", refuse)
    with pytest.raises(RigError, match="cannot be started .Resource temporarily.*was not touched; check that"):
        WatchdogClient(single_link.address, AFG3022B.off)


def test_the_watchdog_has_its_own_process_session(single_link: Simulator) -> None:
    """A hangup or Ctrl-C in a terminal reaches only the processes of that terminal's session."""
    dog = WatchdogClient(single_link.address, AFG3022B.off)
    try:
        assert os.getsid(dog._process.pid) == os.getpgid(dog._process.pid) == dog._process.pid
    finally:
        dog.release(clean=False)


def test_the_watchdog_has_its_own_console_on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes attached to a console end with it (CTRL_CLOSE_EVENT); without a console a window would open.

    Flags: Microsoft, "Process Creation Flags"; Popen takes no session there.
    """
    flags = {"CREATE_NEW_PROCESS_GROUP": 0x200, "CREATE_NO_WINDOW": 0x08000000, "DETACHED_PROCESS": 0x8}
    for name, value in flags.items():
        monkeypatch.setattr(subprocess, name, value, raising=False)
    monkeypatch.setattr(sys, "platform", "win32")
    asked: list[dict[str, Any]] = []

    def refuse(*parts: object, **options: Any) -> None:
        asked.append(options)
        raise OSError("enough is known")

    monkeypatch.setattr("modaltouch.rig.watchdog_client.subprocess.Popen", refuse)
    with pytest.raises(RigError, match="enough is known"):
        WatchdogClient("TCPIP::192.0.2.1::INSTR", AFG3022B.off)
    assert asked[0]["creationflags"] == 0x08000200
    assert "start_new_session" not in asked[0]
