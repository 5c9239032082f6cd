"""Client side of the watchdog: starts its process, exchanges messages with the instrument via it, sends heartbeats."""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import subprocess
import sys
import threading
import time
import typing
from typing import Any

from modaltouch.rig.interface import LinkError, RigError
from modaltouch.rig.pacing import LEASE, MOST_AWAITED, PATIENCE, Order, Report
from modaltouch.rig.watchdog_process import LARGEST

BEAT_PERIOD = LEASE / 4
"""Time between two heartbeats [s]."""

ROUND = 0.05
"""Time between two checks for a stuck watchdog process or a stall of this process [s]."""

POLL = 1e-3
"""Time between two questions whether the first burst was played [s]."""

OPEN_LIMIT = 20.0
"""Timeout for starting the process and opening the instrument [s]."""

OVERHEAD = 3.0
"""Time beyond the backend's timeouts after which its process counts as stuck [s]."""


class WatchdogClient:
    """Client of a process that holds the VISA session and switches the outputs off if this process dies or stalls.

    If the watchdog process itself dies or gets stuck, the next `open` replaces it. A request raises LinkError if it
    fails or the process has died.

    Parameters
    ----------
    address : str
        VISA address.
    off : str
        That of `WatchdogProcess`.
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
        """Reopen the VISA session; return a sentence on how other programs are locked out.

        Raises
        ------
        InUse
            If another program has the instrument.
        LinkError, OSError
            If the instrument cannot be reached, or the process cannot be started.
        """
        if self._process.poll() is not None:
            _reap(self._process)
            self._armed.clear()
            self._process = self._start()
        return str(self._request(OPEN_LIMIT, "open"))

    def exchange(self, message: bytes, *, timeout: float, reply: bool) -> bytes:
        """Send a message and return the reply, if one is expected; each may take up to `timeout` [s]."""
        return bytes(self._request(2 * timeout + OVERHEAD, "exchange", message=message, timeout=timeout, reply=reply))

    def close(self, *, broken: bool) -> None:
        """Close the VISA session; the process stays."""
        self._request(2 * OVERHEAD, "close", broken=broken)

    def arm(self, *, free_running: bool) -> None:
        """Notify the process that outputs may be on and, if `free_running`, that they play until switched off."""
        self._request(OVERHEAD, "arm", free_running=free_running)
        self._lost, self._broken, self._held_up = "", None, 0.0
        self._came_round = time.monotonic()
        self._armed.set()

    def beat(self) -> str:
        """Note that the session is alive; return the reason if the bursts ended without a request, else empty.

        As long as this is called often enough, a thread sends heartbeats to the process.
        """
        self._came_round = time.monotonic()
        if self._armed.is_set() and self._broken is not None:
            raise self._broken
        return self._lost if self._armed.is_set() else ""

    def _keep_beating(self) -> None:
        """Send heartbeats while outputs may be on, as long as the session calls `beat`."""
        while not self._released.wait(BEAT_PERIOD):
            self._armed.wait(BEAT_PERIOD)
            if not self._armed.is_set() or time.monotonic() - self._came_round > PATIENCE / 2:
                continue
            try:
                lost = self.look().lost
            except LinkError as error:
                # A request that failed meanwhile has already raised in the session.
                self._broken = self._broken or error
            else:
                self._lost = self._lost or lost

    def play(self, order: Order) -> Report:
        """Start to play bursts; return the report after the first that is not dropped, or of the last awaited."""
        self._request(OVERHEAD, "play", order=order)
        report, limit = Report(), order.first + MOST_AWAITED * order.period + order.timeout + OVERHEAD
        while not (report.first or report.ended) and report.due < MOST_AWAITED:
            if time.perf_counter() > limit:
                self._process.kill()
            time.sleep(max(order.first - time.perf_counter(), POLL))
            report = self.look()
        return report

    def look(self) -> Report:
        """Return the report so far; the request is a heartbeat, too."""
        return typing.cast("Report", self._request(OVERHEAD, "look"))

    def end(self) -> None:
        """Trigger no further burst; never raises, since the next request detects a lost process."""
        with contextlib.suppress(LinkError):
            self._request(OVERHEAD, "end")

    def report(self, *, wait: bool) -> Report:
        """Trigger no further burst and return the report; with `wait`, after the end of the last burst."""
        return typing.cast("Report", self._request(2 * OVERHEAD, "report", wait=wait))

    def held_up(self) -> float:
        """Return the longest stall of this process or of the watchdog since `arm` [s]."""
        other = 0.0
        with contextlib.suppress(LinkError):
            other = self._request(OVERHEAD, "held_up")
        return max(self._held_up, other)

    def disarm(self) -> None:
        """Notify the process that the outputs are off."""
        if self._armed.is_set():
            self._armed.clear()
            with contextlib.suppress(LinkError):
                self._request(OVERHEAD, "disarm")

    def release(self, *, clean: bool) -> None:
        """Let the process exit; unless `clean`, it first switches the outputs off, without blocking this call."""
        self._released.set()
        with contextlib.suppress(LinkError):
            if clean:
                self._send("release")
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        reaper = threading.Thread(target=_reap, args=(self._process,), daemon=True, name="watchdog-reaper")
        reaper.start()
        if clean:
            reaper.join(2.0)

    def _start(self) -> Any:
        return subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # At a terminal, the user is warned of outputs that cannot be switched off; the reader of a pipe would wait
            # until this process exits.
            stderr=None if sys.__stderr__ is not None and sys.__stderr__.isatty() else subprocess.DEVNULL,
            # A request interrupted by a signal stays in the buffer, and is sent before the next one.
            bufsize=LARGEST,
            # Pass on the module path of this process, in case the package is not installed.
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            **_out_of_reach(),
        )

    def _request(self, limit: float, name: str, **arguments: Any) -> Any:
        """Call a method of the process, which may take up to `limit` [s], and return its result."""
        with self._asking:
            self._number += 1
            self._due = time.monotonic() + limit
            try:
                self._send(name, **arguments)
                number, answer = self._answer()
                # Skip the answer to an earlier request, left unread because of a signal.
                while number != self._number:
                    number, answer = self._answer()
            finally:
                self._due = math.inf
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _send(self, name: str, **arguments: Any) -> None:
        try:
            self._process.stdin.write(pickle.dumps((self._number, name, arguments)))
            self._process.stdin.flush()
        # A closed pipe raises ValueError.
        except (OSError, ValueError) as error:
            raise self._gone() from error

    def _answer(self) -> Any:
        # An interruption by a signal during this wait loses nothing.
        if not self._process.stdout.peek(1):
            raise self._gone()
        try:
            return pickle.load(self._process.stdout)
        except BaseException as error:
            # The rest of this answer would be taken for the next one.
            self._process.kill()
            if isinstance(error, Exception):
                raise self._gone() from error
            raise

    def _gone(self) -> LinkError:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        return LinkError(
            f"the watchdog process {self._process.pid} is gone (exit status {self._process.poll()}), and the "
            "connection with it"
        )

    def _end_if_stuck(self) -> None:
        """Kill a process whose answer is overdue; `open` starts another."""
        was_overdue, asleep = False, time.monotonic()
        while not self._released.wait(ROUND):
            now = time.monotonic()
            self._held_up = max(self._held_up, now - asleep - ROUND)
            # Just after a stall of this process, an answer may have arrived but not yet been read.
            if was_overdue and now > self._due:
                self._process.kill()
            was_overdue, asleep = now > self._due, time.monotonic()


def _reap(process: Any) -> None:
    """Wait for a process to exit, so that neither a zombie nor an open pipe is left."""
    process.wait()
    for pipe in (process.stdin, process.stdout):
        with contextlib.suppress(OSError):
            pipe.close()


def _out_of_reach() -> dict[str, Any]:
    """Return options of `Popen` that protect a process from a closed terminal and from Ctrl-C."""
    if sys.platform == "win32":
        # Closing a console ends the processes attached to it, so this one gets a separate console without a window.
        # Without any console (DETACHED_PROCESS), the interpreter behind a venv launcher would open a persistent one.
        return {"creationflags": subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}
