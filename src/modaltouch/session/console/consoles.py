"""Consoles of a session: live display in the terminal, plain lines, and JSON lines for other programs."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import queue
import re
import stat
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, TextIO, cast

from modaltouch.session.console import COMMANDS, Console, Request, SessionState, describe_last, describe_time

if sys.platform != "win32":
    import termios

_OPENING = b'{"time": "'
"""Beginning of each line."""
LONGEST_LINE = 4096
"""Maximum length of a line that a pipe accepts atomically (POSIX PIPE_BUF on Linux) [bytes]."""
_KEPT = 64
"""Number of states kept for a blocked terminal; each is complete, so old ones are dropped."""
_PATIENCE = 2.0
"""Maximum time for the process to restore the terminal [s]."""


def open_console(events: Path | None, emergency_keys: Sequence[str], *, plain: bool) -> Console:
    """Open the experimenter's console for a sitting, to be closed by the caller.

    Parameters
    ----------
    events : Path or None
        File or named pipe for the events as JSON lines.
    emergency_keys : sequence of str
        Names of the emergency keys.
    plain : bool
        Whether to show plain lines even in a terminal.

    Raises
    ------
    OSError
        If the events cannot be written.
    """
    lines = None if events is None else EventLines(events)
    shown: Console = PlainLines(sys.stderr)
    if _has_terminal() and not plain:
        # Fall back to plain lines if no process can be started.
        with contextlib.suppress(OSError):
            shown = TerminalConsole(sys.stdin.fileno(), sys.stderr.fileno(), emergency_keys, instead=shown)
    if lines is None:
        return shown
    lines.beside = shown
    return lines


def _has_terminal() -> bool:
    """Return whether the process has a terminal (of Unix) for both keys and display."""
    is_unix = sys.platform != "win32" and os.environ.get("TERM") != "dumb"
    if is_unix and sys.stdin.isatty() and sys.stderr.isatty():
        # A background job would be stopped on reading from the terminal; a terminal of another session cannot be asked.
        with contextlib.suppress(OSError):
            return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    return False


class PlainLines(Console):
    """Console that prints one line for each answer, pause, break, warning and error."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._warned: set[str] = set()
        self._error = ""

    def show(self, facts: SessionState) -> None:
        """Print what is new; nothing of earlier sittings."""
        done = f"{facts['n_answered']} of {facts['n_trials']} answered"
        lines = {
            "trial": f"{done}: {describe_last(facts['last'])}; {describe_time(facts['time_left_s'])} left",
            "pause": "paused",
            "focus_lost": "paused: focus lost",
            "continued": "continued",
            "rest": "break",
            "resume": "resumed",
            "stop": f"ended: {facts['stopped_by']}",
        }
        if facts["event"] in lines and not facts["replayed"]:
            self._write(lines[facts["event"]])
        for warning in facts["warnings"]:
            # Print a warning once, although its count rises from trial to trial.
            if (kind := re.sub(r"^once|^\d+ (times|of \d+)|\d+$", "", warning)) not in self._warned:
                self._warned.add(kind)
                self._write(f"warning: {warning}")
        if facts["generator"]["last_error"] not in ("", self._error):
            self._error = facts["generator"]["last_error"]
            self._write(f"generator: {self._error}")

    def _write(self, line: str) -> None:
        # The session continues even if the terminal is gone.
        with contextlib.suppress(OSError, ValueError):
            self._file.write(line + "\n")
            self._file.flush()


class EventLines(Console):
    """Console that writes the state as JSON lines to a file or named pipe, without blocking, `beside` another console.

    A line that a full pipe does not accept is dropped, and the next one written gives the number of dropped lines as
    ``n_dropped``.
    """

    def __init__(self, path: Path) -> None:
        self.beside = Console()
        self._path = path
        self._descriptor = -1
        self._n_dropped = 0
        if path.is_file() and path.read_bytes()[: len(_OPENING)] not in (b"", _OPENING):
            raise FileExistsError(errno.EEXIST, "it already contains something other than events", str(path))
        self._open()

    def show(self, facts: SessionState) -> None:
        """Write a line if it is accepted at once."""
        self.beside.show(facts)
        try:
            if self._descriptor < 0:
                self._open()
            if self._descriptor >= 0:
                os.write(self._descriptor, self._line(facts))
                self._n_dropped = 0
                return
        except BlockingIOError:
            pass
        except OSError:
            self._close_file()  # the reader has gone and may return, or the disk is full
        self._n_dropped += 1

    def requests(self) -> list[Request]:
        """Return the requests at the console beside it."""
        return self.beside.requests()

    def close(self) -> None:
        """Close the file or pipe, and the console beside it."""
        self._close_file()
        self.beside.close()

    def _close_file(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _open(self) -> None:
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        try:
            self._descriptor = os.open(self._path, flags, 0o600)
        except OSError as error:
            if error.errno != errno.ENXIO or not stat.S_ISFIFO(self._path.stat().st_mode):
                raise
            # A pipe without a reader yet.

    def _line(self, facts: SessionState) -> bytes:
        time = datetime.now(UTC).isoformat(timespec="milliseconds")
        values = {"time": time, **facts, **({"n_dropped": self._n_dropped} if self._n_dropped else {})}
        line = json.dumps(values, ensure_ascii=False).encode() + b"\n"
        if len(line) > LONGEST_LINE:
            shortened = {**values, "warnings": [warning[:80] for warning in facts["warnings"][:4]]}
            shortened["generator"] = {**facts["generator"], "last_error": facts["generator"]["last_error"][:200]}
            line = json.dumps(shortened, ensure_ascii=False).encode() + b"\n"
        return line


def save_terminal(descriptor: int) -> list[Any] | None:
    """Return the settings of a terminal; None if not available."""
    try:
        return termios.tcgetattr(descriptor)
    except termios.error:
        return None


def restore_terminal(descriptor: int, before: list[Any] | None) -> None:
    """Restore the settings of a terminal, unless it is gone."""
    # TCSANOW: waiting for output to drain would block forever on a stopped terminal.
    with contextlib.suppress(termios.error):
        if before is not None:
            termios.tcsetattr(descriptor, termios.TCSANOW, before)


class TerminalConsole(Console):
    """Live display in the terminal, with its keys."""

    def __init__(
        self,
        keys: int = 0,
        screen: int = 2,
        emergency: Sequence[str] = ("f12",),
        instead: Console | None = None,
    ) -> None:
        self._instead = instead or Console()
        self._is_given_back = False
        self._terminal = keys
        self._screen = screen
        self._before = save_terminal(keys)
        # Pass separate descriptors, since the process's standard input and output are pipes.
        passed = os.dup(keys), os.dup(screen)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "modaltouch.session.console", *map(str, passed), ",".join(emergency) or "x"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            pass_fds=passed,
        )
        for number in passed:
            os.close(number)
        self._asked: deque[Request] = deque()
        self._facts: deque[SessionState] = deque(maxlen=_KEPT)
        self._wake: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._send, self._hear)]
        for thread in self._threads:
            thread.start()

    def show(self, facts: SessionState) -> None:
        """Show the state of the session, without waiting for a stopped terminal."""
        if self._process.poll() is not None:
            self._give_back()
            self._instead.show(facts)
            return
        self._facts.append(facts)
        self._wake.put(True)

    def requests(self) -> list[Request]:
        """Return the requests typed since the last call."""
        return [self._asked.popleft() for _ in range(len(self._asked))]

    def close(self) -> None:
        """End the process, and restore the terminal if the process did not."""
        self._wake.put(False)
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._give_back()
        for thread in self._threads:
            thread.join(_PATIENCE)
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _give_back(self) -> None:
        """Restore the terminal, whether or not the process did."""
        if self._is_given_back:
            return
        self._is_given_back = True
        if self._process.returncode != 0:
            with contextlib.suppress(OSError):
                # Leave the alternate screen and show the cursor.
                os.write(self._screen, b"\x1b[?1049l\x1b[?25h")
        restore_terminal(self._terminal, self._before)

    def _send(self) -> None:
        """Write states to the process until the end."""
        pipe = cast("IO[bytes]", self._process.stdin)
        with contextlib.suppress(OSError, ValueError):
            while self._wake.get():
                if self._facts:
                    pipe.write(json.dumps(self._facts.popleft()).encode() + b"\n")
                    pipe.flush()
        with contextlib.suppress(OSError):
            pipe.close()

    def _hear(self) -> None:
        """Store the requests sent by the process."""
        pipe = cast("IO[bytes]", self._process.stdout)
        with contextlib.suppress(OSError, ValueError):
            for line in pipe:
                asked = json.loads(line)
                if asked.get("command") in COMMANDS:
                    self._asked.append(Request(asked["command"], str(asked.get("text", "")), float(asked.get("at", 0))))
