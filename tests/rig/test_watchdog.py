"""A session that dies or stalls leaves its outputs off: real processes, real signals, read from the instrument.

The instrument admits one session, as over USB: whoever switches it off must have that one.
"""

from __future__ import annotations

import os
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

from modaltouch.apparatus import Apparatus
from modaltouch.rig.connection import Patience
from modaltouch.rig.generator import Generator
from modaltouch.rig.guard import Watchdog
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.simulator.behaviour import Behaviour
from modaltouch.rig.watchdog import LIMIT
from modaltouch.stimulus.burst import Burst

APPARATUS = Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"

SESSION = textwrap.dedent(
    """
    import signal, sys, time
    import numpy as np
    from modaltouch.apparatus import read_apparatus
    from modaltouch.rig import open_rig
    from modaltouch.stimulus.burst import Burst

    class Planned(BaseException):
        pass

    def raise_it(*_):
        raise Planned

    address, apparatus, seconds, hangs = sys.argv[1:]
    signal.signal(signal.SIGUSR1, raise_it)
    codes = np.full((2, 1000), 8191, dtype=np.uint16)
    codes[:, 500] = 12000
    with open_rig(address, read_apparatus(apparatus), log=lambda event, **facts: None) as rig:
        rig.load(Burst(codes, 0.05, 7.0, 0.2, (10.0, 10.0)))
        rig.fire(0.1)
        print("firing", flush=True)
        ends = time.monotonic() + float(seconds)
        while time.monotonic() < ends:
            rig.heartbeat()
            time.sleep(60 if hangs == "hangs" else 1e-3)
        rig.stop()
        print("confirmed" if rig.firing.confirmed else rig.firing.reason, flush=True)
    """
)

SLOW = 0.6
"""How long the instrument takes over the message at which a phase is met [s]."""

PHASES = {"connect": r"\*RST", "upload": "COPY USER", "arm": "SOUR TIM", "trial": None, "stop": r"OUTP1\?;:OUTP2\?"}


@pytest.fixture
def single_link(apparatus: Apparatus) -> Iterator[Simulator]:
    """Return an instrument that admits one session."""
    with Simulator(apparatus, behaviour=Behaviour(max_sessions=1)) as simulator:
        yield simulator


Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start(single_link: Simulator) -> Iterator[Start]:
    """Return what starts a session in a process of its own and waits until it has come to a phase."""
    started: list[subprocess.Popen[str]] = []

    def start_one(phase: str, *, hangs: bool = False) -> subprocess.Popen[str]:
        slow = PHASES[phase]
        if slow is not None and phase != "stop":
            single_link.faults.inject("slow_command", when=slow, value=SLOW)
        seconds = "0.3" if phase == "stop" else "60"
        words = [single_link.address, str(APPARATUS), seconds, "hangs" if hangs else ""]
        process = subprocess.Popen(
            [sys.executable, "-c", SESSION, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        started.append(process)
        if phase in ("trial", "stop"):
            assert process.stdout is not None
            assert process.stdout.readline() == "firing\n"
            assert single_link.outputs == (True, True)
        if phase == "stop" and slow is not None:
            single_link.faults.inject("slow_command", when=slow, value=SLOW)
        wait_until(lambda: not single_link.faults.any, f"the phase '{phase}'")
        return process

    yield start_one
    for process in started:
        process.kill()
        process.communicate()


def wait_until(happened: Callable[[], bool], what: str, patience: float = 20.0) -> float:
    """Wait for something, and return how long it took [s]."""
    started = time.monotonic()
    while not happened():
        if time.monotonic() > started + patience:
            pytest.fail(f"{what} did not come within {patience} s")
        time.sleep(2e-3)
    return time.monotonic() - started


def seconds_until_off(simulator: Simulator) -> float:
    """Return how long the outputs stayed on, the message that is under way included."""
    took = wait_until(lambda: simulator.outputs == (False, False), "both outputs off", 8)
    # What is under way at the instrument must not switch them on again.
    time.sleep(SLOW + 0.1)
    assert simulator.outputs == (False, False)
    return took


@pytest.mark.parametrize("phase", list(PHASES))
def test_killed_session_leaves_outputs_off(start: Start, single_link: Simulator, phase: str) -> None:
    """SIGKILL passes every finally; the pipe's end tells the watchdog, which waits for what is under way alone."""
    start(phase).kill()
    assert seconds_until_off(single_link) < (0.5 if phase == "trial" else SLOW + 0.5)


@pytest.mark.parametrize("phase", list(PHASES))
def test_stopped_session_leaves_outputs_off(start: Start, single_link: Simulator, phase: str) -> None:
    """SIGSTOP: no sign of life, off after the limit of 1 s and a moment; with outputs that are off, nothing to do."""
    session = start(phase)
    os.kill(session.pid, signal.SIGSTOP)
    took = seconds_until_off(single_link)
    assert took < LIMIT + SLOW + 0.6
    if phase == "trial":
        assert took > 0.7 * LIMIT


@pytest.mark.parametrize("phase", list(PHASES))
def test_exception_leaves_outputs_off_before_the_process_ends(start: Start, single_link: Simulator, phase: str) -> None:
    """Raised in the midst of an exchange, in every phase: not swallowed, and the with statement switches off."""
    session = start(phase)
    os.kill(session.pid, signal.SIGUSR1)
    _, errors = session.communicate(timeout=20)
    assert session.returncode == 1
    assert single_link.outputs == (False, False)
    assert "Planned" in errors.splitlines()[-1]


@pytest.mark.parametrize("phase", list(PHASES))
def test_pulled_cable_and_a_killed_session_leave_outputs_off(start: Start, single_link: Simulator, phase: str) -> None:
    """Both at once: the watchdog opens the instrument anew as soon as it can be reached, here 0.3 s later."""
    session = start(phase)
    single_link.refuse_connections()
    single_link.drop_connections()
    session.kill()
    time.sleep(0.3)
    single_link.accept_connections()
    assert seconds_until_off(single_link) < SLOW + 1.0


def test_pulled_cable_is_found_again_through_the_watchdog(start: Start, single_link: Simulator) -> None:
    """Cable out and in at the stop: the one session is opened anew, and the outputs go off."""
    session = start("stop")
    single_link.drop_connections()
    said, _ = session.communicate(timeout=20)
    assert session.returncode == 0
    assert single_link.outputs == (False, False)
    assert said in ("confirmed\n", "output 1 was off; output 2 was off when the stimulus ended\n")


def test_hanging_session_leaves_outputs_off(start: Start, single_link: Simulator) -> None:
    """A session that runs but no longer comes round counts as stalled: no heartbeat, off."""
    start("trial", hangs=True)
    assert seconds_until_off(single_link) < LIMIT + 1.0


def test_terminated_session_leaves_outputs_off(start: Start, single_link: Simulator) -> None:
    """Without any handler SIGTERM ends the process at once, past every finally."""
    start("trial").terminate()
    assert seconds_until_off(single_link) < 0.5


def test_session_that_wakes_up_again_is_told_what_happened(start: Start, single_link: Simulator) -> None:
    """Stopped for longer than the limit, then continued: its trial is not confirmed."""
    session = start("trial")
    os.kill(session.pid, signal.SIGSTOP)
    seconds_until_off(single_link)
    os.kill(session.pid, signal.SIGCONT)
    os.kill(session.pid, signal.SIGUSR1)
    session.communicate(timeout=20)
    assert session.returncode == 1
    assert single_link.outputs == (False, False)


def small_burst() -> Burst:
    """Return a burst of a hundred points."""
    codes = np.full((2, 100), 8191, dtype=np.uint16)
    codes[:, 50] = 9000
    return Burst(codes, 0.05, 7.0, 0.2, (10.0, 10.0))


@pytest.fixture
def dogs() -> list[Watchdog]:
    """Return the list that watchdogs are entered in."""
    return []


@pytest.fixture
def rig(apparatus: Apparatus, single_link: Simulator, dogs: list[Watchdog]) -> Iterator[Generator]:
    """Return a driver behind a real watchdog, loaded."""

    def begin(address: str, library: str) -> Watchdog:
        dogs.append(Watchdog(address, library))
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
        assert rig.fire(0.1).confirmed
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
    rig._connection.link.ask("*IDN?", timeout=3)
    assert single_link.outputs == (True, True)


def test_watchdog_that_is_gone_stops_the_stimulus_and_is_replaced(
    rig: Generator, single_link: Simulator, dogs: list[Watchdog]
) -> None:
    """Nothing plays without one: the heartbeat raises, a new one has switched off, and the next trial can come."""
    rig.fire(0.1)
    dogs[0]._process.kill()
    dogs[0]._process.wait()
    time.sleep(0.15)
    with pytest.raises(RigError, match="watchdog process .* is gone.*the outputs are off"):
        rig.heartbeat()
    assert single_link.outputs == (False, False)
    assert rig.fire(0.1).confirmed
    assert single_link.outputs == (True, True)


def test_watchdog_that_is_stuck_is_ended_and_replaced(
    rig: Generator, single_link: Simulator, dogs: list[Watchdog], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is stopped does not answer: ended after the times that it was given, and the outputs go off."""
    monkeypatch.setattr("modaltouch.rig.guard.OVERHEAD", 0.5)
    rig.fire(0.1)
    stuck = dogs[0]._process
    os.kill(stuck.pid, signal.SIGSTOP)
    rig.stop()
    assert stuck.poll() == -signal.SIGKILL
    assert single_link.outputs == (False, False)
    assert rig.fire(0.1).confirmed


def test_signal_in_the_midst_of_an_exchange_mixes_up_no_answers(rig: Generator, single_link: Simulator) -> None:
    """A handler that raises while an answer is awaited: the late answer is not the next question's."""

    def raise_it(*_: object) -> None:
        raise KeyboardInterrupt

    link = rig._connection.link
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


def test_level_change_through_the_watchdog_takes_at_most_two_milliseconds(rig: Generator) -> None:
    """The pipe costs tenths of a millisecond: two amplitudes set, read back, free of errors (fastest of 50)."""
    took = []
    for step in range(50):
        started = time.perf_counter()
        rig.set_levels((1 + step / 1000, 2.0))
        took.append(time.perf_counter() - started)
    assert min(took) < 2e-3


def test_heartbeat_costs_microseconds_and_writes_ten_times_a_second(
    rig: Generator, dogs: list[Watchdog], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Called every millisecond it must cost next to nothing: under 5 us a call, at most 11 letters a second."""
    rig.fire(0.1)
    sent: list[bytes] = []
    send = dogs[0]._send
    monkeypatch.setattr(dogs[0], "_send", lambda data: (sent.append(data), send(data)))
    calls, started = 0, time.perf_counter()
    while time.perf_counter() < started + 0.55:
        rig.heartbeat()
        calls += 1
    assert 0.55 / calls < 5e-6
    assert 3 <= len(sent) <= 6
