"""The session's end of the watchdog: starts its process, reaches the instrument through it, keeps it informed."""

from __future__ import annotations

import contextlib
import json
import math
import os
import subprocess
import sys
import threading
import time
import typing
from dataclasses import asdict
from typing import Any

from modaltouch.rig.interface import LinkError, RigError
from modaltouch.rig.link import InUse, TransportError
from modaltouch.rig.pacing import LEASE, Order, Report
from modaltouch.rig.watchdog_process import (
    ARM,
    BEAT,
    CLEAN,
    CLOSE,
    DISARM,
    DONE,
    END,
    EXCHANGE,
    FLAG,
    HEAD,
    LATE,
    LIMIT,
    LOOK,
    MARK,
    OPEN,
    PLAY,
    REPORT,
    TAKEN,
    TERMS,
    frame,
)

BEAT_PERIOD = LEASE / 4
"""Time between two signs of life [s]."""

ROUND = 0.05
"""Time between two looks at whether the process is stuck, or this one was held up [s]."""

OPEN_LIMIT = 20.0
"""Longest time that starting the process and opening the instrument may take [s]."""

OVERHEAD = 3.0
"""What a backend may need beyond the times it is given, before its process counts as stuck [s]."""

PIPE_SIZE = 1 << 20
"""What Linux grants to everybody [bytes]."""


class WatchdogClient:
    """A process that holds the VISA session, and switches the outputs off when this one dies or stalls.

    One that dies or gets stuck itself is replaced by the next `open`. A request raises TransportError if it fails, and
    LinkError if the process is gone.

    Parameters
    ----------
    address : str
        VISA address.
    off : str
        The message that switches the outputs off and asks whether they are.
    """

    def __init__(self, address: str, off: str) -> None:
        self._command = [sys.executable, "-P", "-m", "modaltouch.rig.watchdog_process", address, off]
        self._came_round = 0.0
        self._armed = threading.Event()
        self._lost = ""
        self._broken: LinkError | None = None
        self._number = 0
        self._asking = threading.Lock()
        self._due = math.inf
        self._held_up = 0.0
        try:
            self._process = self._start()
        except OSError as error:
            raise RigError(
                f"the watchdog process cannot be started ({error}), so the generator at {address} was not touched; "
                f"check that this machine can start {sys.executable}"
            ) from error
        self._released = threading.Event()
        for work in (self._end_if_stuck, self._keep_beating):
            threading.Thread(target=work, daemon=True, name=f"watchdog{work.__name__}").start()

    def open(self) -> str:
        """Reopen the instrument and return a sentence on how others are kept out.

        Raises
        ------
        InUse
            If another program has the instrument.
        TransportError, OSError
            If it cannot be reached, or the process cannot be started.
        """
        if self._process.poll() is not None:
            _close_pipes(self._process)
            self._armed.clear()
            self._process = self._start()
        return self._request(OPEN, b"", OPEN_LIMIT).decode()

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        """Send a message, and return the reply if one is expected, within a time for each [s]."""
        return self._request(EXCHANGE, TERMS.pack(timeout, reply, False) + message, 2 * timeout + OVERHEAD)

    def close(self, *, broken: bool) -> None:
        """End the VISA session; the process stays."""
        self._request(CLOSE, TERMS.pack(0.0, False, broken), 2 * OVERHEAD)

    def arm(self, *, plays_by_itself: bool) -> None:
        """Tell it that outputs may go on, and whether what they play does not end without a command."""
        self._send(frame(ARM, 0, FLAG.pack(plays_by_itself)))
        self._lost, self._broken, self._held_up = "", None, 0.0
        self._came_round = time.monotonic()
        self._armed.set()

    def beat(self) -> str:
        """Say that the session comes round, and return why the bursts ended that nobody ended; empty while all is well.

        As long as it comes round, a thread tells the watchdog so.
        """
        self._came_round = time.monotonic()
        if self._armed.is_set() and self._broken is not None:
            raise self._broken
        return self._lost if self._armed.is_set() else ""

    def _keep_beating(self) -> None:
        """Give signs of life while outputs may be on, as long as the session comes round."""
        while not self._released.wait(BEAT_PERIOD):
            self._armed.wait(BEAT_PERIOD)
            if not self._armed.is_set() or time.monotonic() - self._came_round > LIMIT / 2:
                continue
            try:
                lost = self._request(BEAT, b"", OVERHEAD).decode()
            except (LinkError, TransportError) as error:
                # A request that was cut short in the meantime told the session itself.
                self._broken = self._broken or LinkError(str(error))
            else:
                self._lost = self._lost or lost

    def play(self, order: Order) -> Report:
        """Have bursts played; return the report as it stands after the first."""
        limit = max(order.first - time.perf_counter(), 0.0) + order.timeout + OVERHEAD
        return _report(self._request(PLAY, json.dumps(asdict(order)).encode(), limit))

    def look(self) -> Report:
        """Return what was played so far."""
        return _report(self._request(LOOK, b"", OVERHEAD))

    def end(self) -> None:
        """Let no further burst go; never raises, for what follows finds out."""
        with contextlib.suppress(LinkError):
            self._send(frame(END, 0))

    def report(self, *, wait: bool) -> Report:
        """Let no further burst go, and return what was played; with `wait`, once the last burst is over."""
        return _report(self._request(REPORT, FLAG.pack(wait), 2 * OVERHEAD))

    def held_up(self) -> float:
        """Return for how long this process or the watchdog was held up at most since `arm` [s]."""
        other = 0.0
        with contextlib.suppress(LinkError, TransportError):
            other = float(self._request(LATE, b"", OVERHEAD))
        return max(self._held_up, other)

    def disarm(self) -> None:
        """Tell it that the outputs are off."""
        if self._armed.is_set():
            self._armed.clear()
            with contextlib.suppress(LinkError):
                self._send(frame(DISARM, 0))

    def release(self, *, clean: bool) -> None:
        """Let it go, without waiting for what it still has to do unless that is nothing."""
        self._released.set()
        with contextlib.suppress(LinkError):
            if clean:
                self._send(frame(CLEAN, 0))
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        reaper = threading.Thread(target=_reap, args=(self._process,), daemon=True, name="watchdog-reaper")
        reaper.start()
        if clean:
            reaper.join(2.0)

    def _start(self) -> subprocess.Popen[bytes]:
        self._came = bytearray()
        process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # A person at a terminal is told what cannot be switched off; a pipe would wait for this process to end.
            stderr=None if sys.__stderr__ is not None and sys.__stderr__.isatty() else subprocess.DEVNULL,
            bufsize=0,
            # This process's module path too, in case the package is not installed.
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            **_out_of_reach(),
        )
        for pipe in (process.stdin, process.stdout):
            _widen(pipe)
        return process

    def _request(self, letter: bytes, content: bytes, limit: float) -> bytes:
        """Return what comes of a request."""
        with self._asking:
            self._number = (self._number + 1) % (1 << 32)
            self._due = time.monotonic() + limit
            try:
                self._send(frame(letter, self._number, content))
                went, number, answer = self._answer()
                # An answer that a signal kept from being read is not the next one's.
                while number != self._number:
                    went, number, answer = self._answer()
            finally:
                self._due = math.inf
        if went == TAKEN:
            raise InUse(answer.decode())
        if went != DONE:
            raise TransportError(answer.decode())
        return answer

    def _send(self, data: bytes) -> None:
        pipe = self._process.stdin
        rest = memoryview(data)
        try:
            if pipe is None or pipe.closed:
                raise BrokenPipeError("closed")
            while rest:
                rest = rest[os.write(pipe.fileno(), rest) :]
        except OSError as error:
            raise self._gone() from error
        except BaseException:
            # Cut by a signal: half a request would be taken for the beginning of the next.
            if len(rest) < len(data):
                self._process.kill()
            raise

    def _answer(self) -> tuple[bytes, int, bytes]:
        mark, letter, number, length = HEAD.unpack(self._read(HEAD.size))
        if mark != MARK:
            self._process.kill()
            raise self._gone()
        return letter, number, self._read(length)

    def _read(self, size: int) -> bytes:
        pipe = self._process.stdout
        while len(self._came) < size:
            chunk = os.read(pipe.fileno(), max(size, 1 << 16)) if pipe is not None else b""
            if not chunk:
                raise self._gone()
            self._came += chunk
        data = bytes(self._came[:size])
        del self._came[:size]
        return data

    def _gone(self) -> LinkError:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        return LinkError(
            f"the watchdog process {self._process.pid} is gone (exit status {self._process.poll()}), and the "
            "connection with it"
        )

    def _end_if_stuck(self) -> None:
        """End a process whose answer is overdue; `open` starts another."""
        was_overdue, asleep = False, time.monotonic()
        while not self._released.wait(ROUND):
            now = time.monotonic()
            self._held_up = max(self._held_up, now - asleep - ROUND)
            # As this process comes to itself again, an answer that has come is not read yet.
            if was_overdue and now > self._due:
                self._process.kill()
            was_overdue, asleep = now > self._due, time.monotonic()


def _report(answer: bytes) -> Report:
    values = json.loads(answer)
    for name in ("first", "last"):
        if values.get(name) is not None:
            values[name] = tuple(values[name])
    return Report(**values)


def _reap(process: subprocess.Popen[bytes]) -> None:
    """Wait for a process, so that no zombie and no open pipe is left."""
    process.wait()
    _close_pipes(process)


def _close_pipes(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()


def _widen(pipe: typing.IO[bytes] | None) -> None:
    """Let a pipe hold a whole record, where the system can: two wake-ups instead of ten."""
    if sys.platform == "linux" and pipe is not None:
        import fcntl

        with contextlib.suppress(OSError):
            fcntl.fcntl(pipe.fileno(), fcntl.F_SETPIPE_SZ, PIPE_SIZE)


def _out_of_reach() -> dict[str, Any]:
    """Return what keeps a process out of reach of a closed terminal and of Ctrl-C, as options of `Popen`."""
    if sys.platform == "win32":
        # Closing a console ends whatever is attached to it, so this one has a console of its own, without a window.
        # With none (DETACHED_PROCESS) the interpreter behind a venv's launcher would open one, to be closed by hand.
        return {"creationflags": subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}
