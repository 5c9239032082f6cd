"""A session that dies or stalls leaves its outputs off: real processes, real signals, read from the instrument."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import pyvisa

from modaltouch.apparatus import Apparatus
from modaltouch.rig.generator import Generator
from modaltouch.rig.guard import Watchdog
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.behaviour import Behaviour
from modaltouch.rig.watchdog import ARM, BEAT, CLEAN, DISARM, LIMIT, insist, watch
from modaltouch.stimulus.burst import Burst

APPARATUS = Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"

SESSION = textwrap.dedent(
    """
    import sys, time
    import numpy as np
    from modaltouch.apparatus import read_apparatus
    from modaltouch.rig import open_rig
    from modaltouch.stimulus.burst import Burst

    address, apparatus, ending = sys.argv[1:]
    codes = np.full((2, 1000), 8191, dtype=np.uint16)
    codes[:, 500] = 12000
    with open_rig(address, read_apparatus(apparatus), log=lambda event, **facts: None) as rig:
        rig.load(Burst(codes, 0.05, 7.0, 0.2, (10.0, 10.0)))
        rig.fire(0.1)
        print("firing", flush=True)
        started = time.monotonic()
        while time.monotonic() < started + 60:
            rig.heartbeat()
            time.sleep(1e-3)
            if ending == "exception" and time.monotonic() > started + 0.2:
                raise RuntimeError("planned")
            if ending == "hang" and time.monotonic() > started + 0.2:
                time.sleep(60)
    """
)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Return the address of a simulator in a process of its own."""
    command = [sys.executable, "-m", "modaltouch.rig.simulator", "--port", "0", str(APPARATUS)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
        process.terminate()


@pytest.fixture
def ask(address: str) -> Iterator[Callable[[str], str]]:
    """Return what asks the instrument over a session of the test's own."""
    resource = pyvisa.ResourceManager("@py").open_resource(address)
    resource.timeout = 2000
    yield lambda message: resource.query(message).strip()
    resource.close()


@pytest.fixture
def firing_session(address: str, ask: Callable[[str], str]) -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    """Return what starts a session in a process of its own and waits until it fires."""
    started: list[subprocess.Popen[str]] = []

    def start(ending: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", SESSION, address, str(APPARATUS), ending]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "firing\n"
        assert ask("OUTP1?;:OUTP2?") == "1;1"
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def seconds_until_off(ask: Callable[[str], str], patience: float = 5.0) -> float:
    """Return how long the outputs stayed on."""
    started = time.monotonic()
    while ask("OUTP1?;:OUTP2?") != "0;0":
        if time.monotonic() > started + patience:
            pytest.fail(f"an output is still on after {patience} s")
        time.sleep(2e-3)
    return time.monotonic() - started


def test_killed_session_leaves_outputs_off(firing_session: Callable[..., object], ask: Callable[[str], str]) -> None:
    """SIGKILL passes every finally; the pipe's end tells the watchdog (instruments.md: 5 ms)."""
    session = firing_session("signal")
    session.kill()
    assert seconds_until_off(ask) < 0.5


def test_stopped_session_leaves_outputs_off(firing_session: Callable[..., object], ask: Callable[[str], str]) -> None:
    """A stopped process sends no sign of life: off after the limit of 1 s and a moment."""
    session = firing_session("signal")
    os.kill(session.pid, signal.SIGSTOP)
    took = seconds_until_off(ask)
    assert 0.7 * LIMIT < took < LIMIT + 0.6
    os.kill(session.pid, signal.SIGCONT)


def test_hanging_session_leaves_outputs_off(firing_session: Callable[..., object], ask: Callable[[str], str]) -> None:
    """A session that runs but no longer comes round counts as stalled: no heartbeat, off."""
    firing_session("hang")
    assert seconds_until_off(ask) < LIMIT + 1.0


def test_exception_leaves_outputs_off_before_the_process_ends(
    firing_session: Callable[..., object], ask: Callable[[str], str]
) -> None:
    """The with statement switches off; status 1 is Python's for an exception."""
    session = firing_session("exception")
    assert session.wait(10) == 1
    assert ask("OUTP1?;:OUTP2?") == "0;0"


def test_terminated_session_leaves_outputs_off(
    firing_session: Callable[..., object], ask: Callable[[str], str]
) -> None:
    """Without any handler SIGTERM ends the process at once, past every finally."""
    session = firing_session("signal")
    session.terminate()
    assert seconds_until_off(ask) < 0.5


def children(pid: int) -> list[int]:
    """Return the child processes of a process."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_session_that_holds_the_only_link_is_ended(apparatus: Apparatus) -> None:
    """An instrument of one session: the watchdog ends the stalled process, which frees the link, and goes in."""
    with Simulator(apparatus, behaviour=Behaviour(max_sessions=1)) as simulator:
        command = [sys.executable, "-c", SESSION, simulator.address, str(APPARATUS), "hang"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as session:
            assert session.stdout is not None
            assert session.stdout.readline() == "firing\n"
            assert simulator.outputs == (True, True)
            assert session.wait(20) == -signal.SIGKILL
        deadline = time.monotonic() + 5
        while simulator.outputs != (False, False) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert simulator.outputs == (False, False)


def test_slow_instrument_is_no_stalled_session(apparatus: Apparatus, simulator: Simulator) -> None:
    """Every exchange is a sign of life: 0.2 s a reply makes starting take more than the limit, and nothing trips."""
    with Generator(simulator.address, apparatus) as rig:
        rig.load(small_burst())
        rig.fire(0.1)
        rig.stop()
        simulator.faults.inject("delayed_reply", value=0.2, times=99)
        started = time.monotonic()
        assert rig.fire(0.1).confirmed
        assert time.monotonic() - started > LIMIT
        assert simulator.outputs == (True, True)
        simulator.faults.clear()
        rig.stop()
        assert rig.firing is not None
        assert rig.firing.confirmed


def small_burst() -> Burst:
    """Return a burst of a hundred points."""
    codes = np.full((2, 100), 8191, dtype=np.uint16)
    codes[:, 50] = 9000
    return Burst(codes, 0.05, 7.0, 0.2, (10.0, 10.0))


def test_watchdog_that_is_gone_stops_the_session(apparatus: Apparatus, simulator: Simulator) -> None:
    """Without a watchdog no stimulus goes on: the heartbeat raises, and the outputs are off."""
    guards: list[Watchdog] = []

    def start(address: str, library: str) -> Watchdog:
        guards.append(Watchdog(address, library))
        return guards[-1]

    with Generator(simulator.address, apparatus, start_guard=start) as rig:
        rig.load(small_burst())
        rig.fire(0.1)
        guards[0]._process.kill()
        guards[0]._process.wait()
        time.sleep(0.15)
        with pytest.raises(RigError, match="watchdog process .* is gone"):
            rig.heartbeat()
        assert simulator.outputs == (False, False)
        with pytest.raises(RigError, match="no output is switched on"):
            rig.fire(0.1)


def test_heartbeat_costs_microseconds_and_writes_ten_times_a_second(address: str) -> None:
    """Called every millisecond it must cost next to nothing: under 5 us a call, at most 11 letters a second."""
    dog = Watchdog(address, "@py")
    dog.attach()
    dog.arm()
    sent: list[bytes] = []
    send = dog._send
    dog._send = lambda letter: (sent.append(letter), send(letter))[1]  # type: ignore[method-assign]
    calls, started = 0, time.perf_counter()
    while time.perf_counter() < started + 0.55:
        dog.beat()
        calls += 1
    assert 0.55 / calls < 5e-6
    assert 3 <= len(sent) <= 6
    dog.disarm()
    dog.release(clean=True)
    assert dog.said == ("ready",)


def run_watch(letters: list[bytes], *, limit: float = 0.05) -> list[bool]:
    """Return what the watchdog does on hearing letters: each entry is whether it took the session for stalled."""
    heard: queue.Queue[bytes] = queue.Queue()
    for letter in letters:
        heard.put(letter)
    pressed: list[bool] = []

    def off(stalled: bool) -> bool:
        pressed.append(stalled)
        threading.Timer(0.01, heard.put, [b""] if stalled else []).start() if stalled else None
        return True

    watch(heard, off, limit=limit)
    return pressed


@pytest.mark.parametrize(
    ("letters", "pressed"),
    [
        ([CLEAN], []),
        ([ARM, DISARM, CLEAN], []),
        ([ARM, BEAT, BEAT, CLEAN], []),
        ([b""], [False]),
        ([ARM, b""], [False]),
        ([ARM, DISARM, b""], [False]),
        ([ARM], [True, False]),
        ([ARM, BEAT], [True, False]),
    ],
)
def test_watch_presses_at_the_pipes_end_and_at_a_stall(letters: list[bytes], pressed: list[bool]) -> None:
    """Only a clean end spares the outputs; silence counts only while armed (module docstring)."""
    assert run_watch(letters) == pressed


def test_beat_does_not_arm() -> None:
    """A sign of life of a session whose outputs are off starts no clock."""
    heard: queue.Queue[bytes] = queue.Queue()
    heard.put(BEAT)
    threading.Timer(0.2, heard.put, [CLEAN]).start()
    pressed: list[bool] = []
    watch(heard, lambda stalled: not pressed.append(stalled), limit=0.02)
    assert pressed == []


def test_insist_tries_until_it_works() -> None:
    """Two failures, then off: three tries, the time told after each failure."""
    replies = iter([False, False, True])
    told: list[float] = []
    assert insist(lambda: next(replies), give_up=5, held=told.append)
    assert len(told) == 2


def test_insist_gives_up() -> None:
    """An instrument that never answers is given up after the time stated."""
    started = time.monotonic()
    assert not insist(lambda: False, give_up=0.1, held=lambda elapsed: None)
    assert time.monotonic() - started < 1
