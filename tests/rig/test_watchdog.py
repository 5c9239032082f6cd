"""A session that dies or stalls leaves its outputs off: real processes and signals, with the state read from the twin.

The instrument admits one session, as over USB: switching it off requires that session.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from modaltouch.rig.pacing import PATIENCE
from modaltouch.rig.simulator import Simulator
from modaltouch.rig.watchdog_process import REPLY_TIMEOUT

APPARATUS = Path(__file__).parents[2] / "protocols" / "apparatus" / "beam_100x6x2.yaml"

SESSIONS = textwrap.dedent(
    """
    import os, signal, sys, time
    import numpy as np
    from modaltouch.protocol.apparatus import Apparatus
    from modaltouch.rig import Generator
    from modaltouch.rig.afg3022b import AFG3022B
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
        with Generator(address, apparatus, log=lambda event, **facts: None) as rig:
            rig.load(Burst(codes, 0.05, 7.0, 0.2, (10.0, 10.0), AFG3022B.converter))
            rig.fire(0.1)
            print("firing", flush=True)
            ends = time.monotonic() + float(seconds)
            while time.monotonic() < ends:
                rig.heartbeat()
                time.sleep(60 if hangs == "hangs" else 1e-3)
            rig.stop()
            print("confirmed" if rig.firing.confirmed else rig.firing.reason, flush=True)

    apparatus = Apparatus.read(sys.argv[1])
    for line in sys.stdin:
        verb, *words = line.split()
        if verb == "wait":
            print(os.waitstatus_to_exitcode(os.waitpid(int(words[0]), 0)[1]), flush=True)
            continue
        pid = os.fork()
        if pid == 0:
            output, terminal = os.open(words.pop(0), os.O_WRONLY | os.O_CREAT), words.pop(0)
            os.dup2(output, 1)
            os.dup2(output, 2)
            if terminal != "none":
                os.setsid()  # the terminal opened next becomes its controlling terminal
                signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests themselves may run under nohup
                os.dup2(os.open(terminal, os.O_RDWR), 2)
            sit(*words)
            os._exit(0)
        print(pid, flush=True)
    """
)
"""Runs sessions in processes forked after all imports, which saves a second per start."""


class Session:
    """A session in its own process."""

    def __init__(self, host: subprocess.Popen[str], output: Path, *words: str) -> None:
        self._host = host
        self._output = output
        self.pid = int(self._tell("start", str(output), *words))
        self.ended = False

    def signal(self, number: int) -> None:
        """Send the process a signal."""
        os.kill(self.pid, number)

    def wait(self) -> int:
        """Return the exit status after the process has ended."""
        self.ended = True
        return int(self._tell("wait", str(self.pid)))

    @property
    def said(self) -> list[str]:
        """Lines that the process has printed."""
        return self._output.read_text().splitlines() if self._output.exists() else []

    def _tell(self, *words: str) -> str:
        assert self._host.stdin is not None
        assert self._host.stdout is not None
        self._host.stdin.write(" ".join(words) + "\n")
        self._host.stdin.flush()
        return self._host.stdout.readline()


SLOW = 0.4
"""How long the instrument takes for the message by which a phase is recognised [s]."""

PHASES = {"connect": r"\*RST", "upload": "COPY USER", "arm": "SEQ:IMM$", "trial": None, "stop": r"OUTP1\?;:OUTP2\?"}


@pytest.fixture(scope="module")
def host() -> Iterator[subprocess.Popen[str]]:
    """Return the process from which sessions are forked."""
    command = [sys.executable, "-c", SESSIONS, str(APPARATUS)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.terminate()


Start = Callable[..., Session]


@pytest.fixture
def start(single_link: Simulator, host: subprocess.Popen[str], tmp_path: Path) -> Iterator[Start]:
    """Return a function that starts a session and waits until it has reached a phase."""
    started: list[Session] = []

    def start_one(phase: str, *, hangs: bool = False, terminal: str = "none") -> Session:
        slow = PHASES[phase]
        if slow is not None and phase != "stop":
            single_link.faults.inject("slow_command", when=slow, value=SLOW)
        seconds = "0.3" if phase == "stop" else "60"
        words = [terminal, single_link.address, seconds, "hangs" if hangs else "beats"]
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


def wait_until(happened: Callable[[], bool], what: str, patience: float = 60.0) -> float:
    """Wait until a condition holds, and return how long it took [s]."""
    started = time.monotonic()
    while not happened():
        if time.monotonic() > started + patience:
            pytest.fail(f"{what} did not come within {patience} s")
        time.sleep(2e-3)
    return time.monotonic() - started


def seconds_until_off(simulator: Simulator) -> float:
    """Return how long the outputs stayed on; the promised time itself is checked by `make stops`."""
    took = wait_until(lambda: simulator.outputs == (False, False), "both outputs off", 60)
    # A pending message must not switch them on again.
    time.sleep(SLOW + 0.1)
    assert simulator.outputs == (False, False)
    return took


@pytest.mark.parametrize("phase", list(PHASES))
def test_a_killed_session_leaves_outputs_off(start: Start, single_link: Simulator, phase: str) -> None:
    """SIGKILL bypasses every finally; end of file on the pipe makes the watchdog switch off after a pending message."""
    start(phase).signal(signal.SIGKILL)
    seconds_until_off(single_link)


@pytest.mark.parametrize("phase", list(PHASES))
def test_a_stopped_session_leaves_outputs_off(start: Start, single_link: Simulator, phase: str) -> None:
    """After SIGSTOP there is no heartbeat: outputs are off soon after the limit of 1 s."""
    session = start(phase)
    session.signal(signal.SIGSTOP)
    took = seconds_until_off(single_link)
    if phase == "trial":
        assert took > 0.7 * PATIENCE


@pytest.mark.parametrize("phase", list(PHASES))
def test_an_exception_leaves_outputs_off_before_the_process_ends(
    start: Start, single_link: Simulator, phase: str
) -> None:
    """Raised during an exchange, in every phase: it propagates, and the with statement switches the outputs off."""
    session = start(phase)
    session.signal(signal.SIGUSR1)
    assert session.wait() == 1
    assert single_link.outputs == (False, False)
    assert session.said[-1].endswith("Planned")


@pytest.mark.parametrize("phase", list(PHASES))
def test_a_pulled_cable_and_a_kill_together_leave_outputs_off(start: Start, single_link: Simulator, phase: str) -> None:
    """The watchdog reopens the instrument as soon as it can be reached, here 0.3 s later."""
    session = start(phase)
    single_link.server.refuse()
    single_link.server.drop_connections()
    session.signal(signal.SIGKILL)
    time.sleep(0.3)
    single_link.server.listen()
    seconds_until_off(single_link)


def test_the_watchdog_reconnects_after_a_pulled_cable(start: Start, single_link: Simulator) -> None:
    """Connections dropped at the stop: the single session is reopened, and the outputs go off."""
    session = start("stop")
    single_link.server.drop_connections()
    assert session.wait() == 0
    assert single_link.outputs == (False, False)
    assert re.match(
        "confirmed|this computer was held up|output 1 was off|trigger .* failed|.*bursts ended before", session.said[1]
    )


def test_a_hanging_session_leaves_outputs_off(start: Start, single_link: Simulator) -> None:
    """A session that runs but sends no heartbeat counts as stalled."""
    start("trial", hangs=True)
    seconds_until_off(single_link)


def test_a_terminated_session_leaves_outputs_off(start: Start, single_link: Simulator) -> None:
    """Without a handler SIGTERM ends the process immediately and bypasses every finally."""
    start("trial").signal(signal.SIGTERM)
    seconds_until_off(single_link)


@pytest.mark.parametrize("cable", ["in", "out for a while"])
def test_closing_the_terminal_leaves_outputs_off(start: Start, single_link: Simulator, cable: str) -> None:
    """SIGHUP ends the session but not its watchdog, nor does writing to the closed terminal."""
    ours, theirs = os.openpty()
    session = start("trial", terminal=os.ttyname(theirs))
    os.close(theirs)
    if cable != "in":
        single_link.server.refuse()
        single_link.server.drop_connections()
    os.close(ours)
    assert session.wait() == -signal.SIGHUP
    if cable != "in":
        time.sleep(REPLY_TIMEOUT + 0.3)
        single_link.server.listen()
    seconds_until_off(single_link)


def test_a_session_continued_after_a_stall_does_not_confirm_its_trial(start: Start, single_link: Simulator) -> None:
    """It was stopped for longer than the limit; after SIGCONT it ends with an error, with the outputs off."""
    session = start("trial")
    session.signal(signal.SIGSTOP)
    seconds_until_off(single_link)
    session.signal(signal.SIGCONT)
    session.signal(signal.SIGUSR1)
    assert session.wait() == 1
    assert single_link.outputs == (False, False)
