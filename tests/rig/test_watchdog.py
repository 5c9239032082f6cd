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

SESSIONS = textwrap.dedent(
    """
    import os, signal, sys, time
    import numpy as np
    from modaltouch.apparatus import read_apparatus
    from modaltouch.rig import open_rig
    from modaltouch.rig.generator import Generator
    from modaltouch.stimulus.burst import Burst

    class Planned(BaseException):
        pass

    def raise_it(*_):
        raise Planned

    def sit(address, seconds, hangs):
        signal.signal(signal.SIGUSR1, raise_it)
        codes = np.full((2, 1000), 8191, dtype=np.uint16)
        codes[:, 500] = 12000
        with open_rig(address, apparatus, log=lambda event, **facts: None) as rig:
            rig.load(Burst(codes, 0.05, 7.0, 0.2, (10.0, 10.0)))
            rig.fire(0.1)
            print("firing", flush=True)
            ends = time.monotonic() + float(seconds)
            while time.monotonic() < ends:
                rig.heartbeat()
                time.sleep(60 if hangs == "hangs" else 1e-3)
            rig.stop()
            print("confirmed" if rig.firing.confirmed else rig.firing.reason, flush=True)

    apparatus = read_apparatus(sys.argv[1])
    for line in sys.stdin:
        verb, *words = line.split()
        if verb == "wait":
            print(os.waitstatus_to_exitcode(os.waitpid(int(words[0]), 0)[1]), flush=True)
            continue
        pid = os.fork()
        if pid == 0:
            output = os.open(words.pop(0), os.O_WRONLY | os.O_CREAT)
            os.dup2(output, 1)
            os.dup2(output, 2)
            sit(*words)
            os._exit(0)
        print(pid, flush=True)
    """
)
"""Sits through sessions in processes of their own, forked where all is imported: a start costs no second each."""


class Session:
    """One session's process."""

    def __init__(self, host: subprocess.Popen[str], output: Path, *words: str) -> None:
        self._host = host
        self._output = output
        self.pid = int(self._tell("start", str(output), *words))
        self.ended = False

    def signal(self, number: int) -> None:
        """Send it a signal."""
        os.kill(self.pid, number)

    def wait(self) -> int:
        """Return its status, once it has ended."""
        self.ended = True
        return int(self._tell("wait", str(self.pid)))

    @property
    def said(self) -> list[str]:
        """What it has printed."""
        return self._output.read_text().splitlines() if self._output.exists() else []

    def _tell(self, *words: str) -> str:
        assert self._host.stdin is not None
        assert self._host.stdout is not None
        self._host.stdin.write(" ".join(words) + "\n")
        self._host.stdin.flush()
        return self._host.stdout.readline()


SLOW = 0.4
"""How long the instrument takes over the message at which a phase is met [s]."""

PHASES = {"connect": r"\*RST", "upload": "COPY USER", "arm": "SOUR TIM", "trial": None, "stop": r"OUTP1\?;:OUTP2\?"}


@pytest.fixture
def single_link(apparatus: Apparatus) -> Iterator[Simulator]:
    """Return an instrument that admits one session."""
    with Simulator(apparatus, behaviour=Behaviour(max_sessions=1)) as simulator:
        yield simulator


@pytest.fixture(scope="module")
def host() -> Iterator[subprocess.Popen[str]]:
    """Return the process that sessions come from."""
    command = [sys.executable, "-c", SESSIONS, str(APPARATUS)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.terminate()


Start = Callable[..., Session]


@pytest.fixture
def start(single_link: Simulator, host: subprocess.Popen[str], tmp_path: Path) -> Iterator[Start]:
    """Return what starts a session and waits until it has come to a phase."""
    started: list[Session] = []

    def start_one(phase: str, *, hangs: bool = False) -> Session:
        slow = PHASES[phase]
        if slow is not None and phase != "stop":
            single_link.faults.inject("slow_command", when=slow, value=SLOW)
        seconds = "0.3" if phase == "stop" else "60"
        words = [single_link.address, seconds, "hangs" if hangs else "beats"]
        session = Session(host, tmp_path / "said.txt", *words)
        started.append(session)
        if phase in ("trial", "stop"):
            wait_until(lambda: session.said == ["firing"], "the stimulus")
            assert single_link.outputs == (True, True)
        if phase == "stop" and slow is not None:
            single_link.faults.inject("slow_command", when=slow, value=SLOW)
        wait_until(lambda: not single_link.faults.any, f"the phase '{phase}'")
        return session

    yield start_one
    for session in started:
        if not session.ended:
            session.signal(signal.SIGKILL)
            session.wait()


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
    start(phase).signal(signal.SIGKILL)
    assert seconds_until_off(single_link) < (0.5 if phase == "trial" else SLOW + 0.5)


@pytest.mark.parametrize("phase", list(PHASES))
def test_stopped_session_leaves_outputs_off(start: Start, single_link: Simulator, phase: str) -> None:
    """SIGSTOP: no sign of life, off after the limit of 1 s and a moment; with outputs that are off, nothing to do."""
    session = start(phase)
    session.signal(signal.SIGSTOP)
    took = seconds_until_off(single_link)
    assert took < LIMIT + SLOW + 0.6
    if phase == "trial":
        assert took > 0.7 * LIMIT


@pytest.mark.parametrize("phase", list(PHASES))
def test_exception_leaves_outputs_off_before_the_process_ends(start: Start, single_link: Simulator, phase: str) -> None:
    """Raised in the midst of an exchange, in every phase: not swallowed, and the with statement switches off."""
    session = start(phase)
    session.signal(signal.SIGUSR1)
    assert session.wait() == 1
    assert single_link.outputs == (False, False)
    assert session.said[-1].endswith("Planned")


@pytest.mark.parametrize("phase", list(PHASES))
def test_pulled_cable_and_a_killed_session_leave_outputs_off(start: Start, single_link: Simulator, phase: str) -> None:
    """Both at once: the watchdog opens the instrument anew as soon as it can be reached, here 0.3 s later."""
    session = start(phase)
    single_link.refuse_connections()
    single_link.drop_connections()
    session.signal(signal.SIGKILL)
    time.sleep(0.3)
    single_link.accept_connections()
    assert seconds_until_off(single_link) < SLOW + 1.0


def test_pulled_cable_is_found_again_through_the_watchdog(start: Start, single_link: Simulator) -> None:
    """Cable out and in at the stop: the one session is opened anew, and the outputs go off."""
    session = start("stop")
    single_link.drop_connections()
    assert session.wait() == 0
    assert single_link.outputs == (False, False)
    assert session.said[1] in ("confirmed", "output 1 was off; output 2 was off when the stimulus ended")


def test_hanging_session_leaves_outputs_off(start: Start, single_link: Simulator) -> None:
    """A session that runs but no longer comes round counts as stalled: no heartbeat, off."""
    start("trial", hangs=True)
    assert seconds_until_off(single_link) < LIMIT + 1.0


def test_terminated_session_leaves_outputs_off(start: Start, single_link: Simulator) -> None:
    """Without any handler SIGTERM ends the process at once, past every finally."""
    start("trial").signal(signal.SIGTERM)
    assert seconds_until_off(single_link) < 0.5


def test_session_that_wakes_up_again_is_told_what_happened(start: Start, single_link: Simulator) -> None:
    """Stopped for longer than the limit, then continued: its trial is not confirmed."""
    session = start("trial")
    session.signal(signal.SIGSTOP)
    seconds_until_off(single_link)
    session.signal(signal.SIGCONT)
    session.signal(signal.SIGUSR1)
    assert session.wait() == 1
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

    def begin(address: str) -> Watchdog:
        dogs.append(Watchdog(address))
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
