"""The driver behind a real watchdog process: what it costs, and what becomes of one that is gone or stuck."""

from __future__ import annotations

import ctypes
import os
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
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.watchdog_client import WatchdogClient
from modaltouch.rig.watchdog_process import LIMIT
from modaltouch.stimulus.burst import Burst


def small_burst() -> Burst:
    """Return a burst of a hundred points."""
    codes = np.full((2, 100), 8191, dtype=np.uint16)
    codes[:, 50] = 9000
    return Burst(codes, 0.05, 7.0, 0.2, (10.0, 10.0), AFG3022B.converter)


@pytest.fixture
def dogs() -> list[WatchdogClient]:
    """Return the list that watchdogs are entered in."""
    return []


@pytest.fixture
def rig(apparatus: Apparatus, single_link: Simulator, dogs: list[WatchdogClient]) -> Iterator[Generator]:
    """Return a driver behind a real watchdog, loaded."""

    def begin(address: str, off: str) -> WatchdogClient:
        dogs.append(WatchdogClient(address, off))
        return dogs[-1]

    patience = Patience(reply=0.5)
    with Generator(single_link.address, apparatus, start_guard=begin, patience=patience) as generator:
        generator.load(small_burst())
        yield generator
    assert single_link.outputs == (False, False)


def test_slow_instrument_is_no_stalled_session(apparatus: Apparatus, single_link: Simulator) -> None:
    """Every exchange is a sign of life: 0.3 s a reply makes starting take more than the limit, and nothing trips."""
    with Generator(single_link.address, apparatus) as rig:
        rig.load(small_burst())
        rig.fire(0.1)
        rig.stop()
        single_link.faults.inject("delayed_reply", value=0.3, times=99)
        started = time.monotonic()
        assert rig.fire(0.1).started
        assert time.monotonic() - started > LIMIT
        assert single_link.outputs == (True, True)
        single_link.faults.clear()
        rig.stop()
        assert rig.firing is not None
        assert rig.firing.confirmed


def test_exchange_longer_than_the_limit_is_no_stall(rig: Generator, single_link: Simulator) -> None:
    """While the instrument is slow over one message, it is the instrument that is waited for."""
    rig.fire(0.1)
    single_link.faults.inject("slow_command", when="IDN", value=LIMIT + 0.4)
    rig._connection.controls.ask("*IDN?", timeout=3)
    assert single_link.outputs == (True, True)


def test_watchdog_that_is_gone_stops_the_stimulus_and_is_replaced(
    rig: Generator, single_link: Simulator, dogs: list[WatchdogClient]
) -> None:
    """Nothing plays without one: the heartbeat raises, a new one has switched off, and the next trial can come."""
    rig.fire(0.1)
    dogs[0]._process.kill()
    dogs[0]._process.wait()
    time.sleep(0.15)
    with pytest.raises(RigError, match="watchdog process .* is gone.*the outputs were switched off"):
        rig.heartbeat()
    assert single_link.outputs == (False, False)
    assert rig.fire(0.1).started
    assert single_link.outputs == (True, True)


def test_watchdog_that_is_stuck_is_ended_and_replaced(
    rig: Generator, single_link: Simulator, dogs: list[WatchdogClient], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is stopped does not answer: ended after the times that it was given, and the outputs go off."""
    monkeypatch.setattr("modaltouch.rig.watchdog_client.OVERHEAD", 0.5)
    rig.fire(0.1)
    stuck = dogs[0]._process
    os.kill(stuck.pid, signal.SIGSTOP)
    rig.stop()
    assert stuck.poll() == -signal.SIGKILL
    assert single_link.outputs == (False, False)
    assert rig.fire(0.1).started


@pytest.mark.parametrize("stopped", ["session", "watchdog"])
def test_whoever_is_held_up_it_is_known(rig: Generator, dogs: list[WatchdogClient], stopped: str) -> None:
    """None of its threads runs for 0.6 s, as on a machine that swaps: at least 0.5 s is told; then it counts anew."""
    rig.fire(0.1)
    if stopped == "session":
        # A foreign function that keeps Python's lock: pytest itself cannot be stopped without its terminal.
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


def test_signal_in_the_midst_of_an_exchange_mixes_up_no_answers(rig: Generator, single_link: Simulator) -> None:
    """A handler that raises while an answer is awaited: the late answer is not the next question's."""

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


def test_heartbeat_writes_four_times_a_lease_however_often_it_is_called(
    rig: Generator, dogs: list[WatchdogClient], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A letter every 45 ms at most, which a thread writes; the call itself, made every millisecond, writes nothing."""
    rig.fire(0.1)
    sent: list[str] = []
    send = dogs[0]._send
    monkeypatch.setattr(dogs[0], "_send", lambda data: (sent.append(threading.current_thread().name), send(data)))
    started = time.perf_counter()
    while len(sent) < 5 and time.perf_counter() < started + 30:
        rig.heartbeat()
    assert 5 <= len(sent) <= (time.perf_counter() - started) / 0.045 + 1
    assert threading.main_thread().name not in sent


@pytest.mark.parametrize("clean", [True, False])
def test_watchdog_that_is_let_go_ends_and_takes_nothing_more(single_link: Simulator, clean: bool) -> None:
    """No process and no thread stays behind; what is asked of it afterwards is told, not swallowed."""
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


def test_lost_bursts_are_told_while_outputs_may_be_on(single_link: Simulator) -> None:
    """Once they are off, nothing is left to be told."""
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


@pytest.mark.parametrize(("is_armed", "silence", "n_sent"), [(True, 0.0, 3), (True, LIMIT, 0), (False, 0.0, 0)])
def test_heartbeats_are_those_of_the_session(is_armed: bool, silence: float, n_sent: int) -> None:
    """A session that stands still sends none, so that the watchdog switches off; nor is one needed with outputs off."""
    dog: Any = object.__new__(WatchdogClient)
    rounds, sent = [True, False, False, False], []
    dog._released = SimpleNamespace(wait=lambda period: rounds.pop())
    dog._armed = SimpleNamespace(wait=lambda period: is_armed, is_set=lambda: is_armed)
    dog._lost, dog._broken, dog._came_round = "", None, time.monotonic() - silence
    dog._request = lambda letter, content, limit: sent.append(letter) or b""
    dog._keep_beating()
    assert len(sent) == n_sent
    assert (rounds, dog.beat(), dog._broken) == ([], "", None)


def test_watchdog_imports_from_where_this_process_does(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_how_a_watchdog_ended_is_said(single_link: Simulator) -> None:
    """Killed in the midst of an exchange, as by a machine that runs out of memory: signal 9."""
    dog = WatchdogClient(single_link.address, AFG3022B.off)
    try:
        dog.open()
        single_link.faults.inject("slow_command", when="IDN", value=1.0)
        threading.Timer(0.2, dog._process.kill).start()
        with pytest.raises(LinkError, match=r"is gone \(exit status -9\), and the connection with it"):
            dog.exchange(b"*IDN?\n", timeout=3, reply=True)
    finally:
        dog.release(clean=False)


def test_machine_that_starts_no_process_touches_no_generator(
    single_link: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a watchdog nothing is opened: a rig fault with what to look at."""

    def refuse(*parts: object, **options: object) -> None:
        raise OSError("Resource temporarily unavailable")

    monkeypatch.setattr("modaltouch.rig.watchdog_client.subprocess.Popen", refuse)
    with pytest.raises(RigError, match="cannot be started .Resource temporarily.*was not touched; check that"):
        WatchdogClient(single_link.address, AFG3022B.off)


def test_watchdog_has_a_session_of_its_own(single_link: Simulator) -> None:
    """A terminal that hangs up, or Ctrl-C in it, reaches the processes of its own session."""
    dog = WatchdogClient(single_link.address, AFG3022B.off)
    try:
        assert os.getsid(dog._process.pid) == os.getpgid(dog._process.pid) == dog._process.pid
    finally:
        dog.release(clean=False)


def test_watchdog_has_a_console_of_its_own_on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is attached to a console ends with it (CTRL_CLOSE_EVENT); one without any would open a window.

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
