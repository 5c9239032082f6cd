"""Consoles of a session: live display in the terminal, plain lines, and JSON lines for other programs."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import select
import stat
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, TextIO, cast

from modaltouch.session.console import Console, Request, SessionState, describe_last, describe_time

if sys.platform != "win32":
    import termios

_OPENING = b'{"time": "'
"""Beginning of each line."""
LONGEST_LINE = 4096
"""Maximum length of a line that a pipe accepts atomically (POSIX PIPE_BUF on Linux) [bytes]."""
_KEYS_GONE = b"The console has ended, so its keys do nothing now; Ctrl-C stops the session.\r\n"
"""Text for the experimenter if the process ends before the session does."""
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
                time = datetime.now(UTC).isoformat(timespec="milliseconds")
                dropped = {"n_dropped": self._n_dropped} if self._n_dropped else {}
                os.write(self._descriptor, as_line({"time": time, **facts, **dropped}))
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


def as_line(facts: SessionState) -> bytes:
    """Return a state as one JSON line, with long texts shortened to what a pipe accepts atomically."""
    line = json.dumps(facts, ensure_ascii=False).encode() + b"\n"
    if len(line) > LONGEST_LINE:
        shortened = {**facts, "warnings": [warning[:80] for warning in facts["warnings"][:4]]}
        shortened["generator"] = {**facts["generator"], "last_error": facts["generator"]["last_error"][:200]}
        line = json.dumps(shortened, ensure_ascii=False).encode() + b"\n"
    return line


def restore_terminal(descriptor: int, before: list[Any]) -> None:
    """Restore the settings of a terminal, unless it is gone."""
    # TCSANOW: waiting for output to drain would block forever on a stopped terminal.
    with contextlib.suppress(termios.error):
        termios.tcsetattr(descriptor, termios.TCSANOW, before)


class TerminalConsole(Console):
    """Live display in the terminal, with its keys; neither reading nor writing waits for it."""

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
        self._before = termios.tcgetattr(keys)
        # Pass separate descriptors, since the process's standard input and output are pipes.
        passed = os.dup(keys), os.dup(screen)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "modaltouch.session.console", *map(str, passed), ",".join(emergency) or "x"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            bufsize=0,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            pass_fds=passed,
        )
        for number in passed:
            os.close(number)
        self._told, self._heard = (cast("IO[bytes]", pipe) for pipe in (self._process.stdin, self._process.stdout))
        for pipe in (self._told, self._heard):
            os.set_blocking(pipe.fileno(), False)
        self._unsent = self._unread = b""

    def show(self, facts: SessionState) -> None:
        """Show the state of the session; only the newest is kept for a stopped terminal."""
        if self._process.poll() is not None:
            self._give_back(_KEYS_GONE)
            self._instead.show(facts)
            return
        self._unsent = as_line(facts)
        self._send()

    def requests(self) -> list[Request]:
        """Return the requests typed since the last call."""
        self._send()
        *lines, self._unread = (self._unread + (self._heard.read(4096) or b"")).split(b"\n")
        return [Request(**json.loads(line)) for line in lines]

    def close(self) -> None:
        """End the process, and restore the terminal if the process did not."""
        if self._unsent:
            select.select([], [self._told], [], _PATIENCE)
            self._send()
        self._told.close()
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._give_back()
        self._heard.close()

    def _give_back(self, message: bytes = b"") -> None:
        """Restore the terminal, whether or not the process did, and show a message there."""
        if self._is_given_back:
            return
        self._is_given_back = True
        # Leave the alternate screen and show the cursor, unless the process did.
        left = b"" if self._process.returncode == 0 else b"\x1b[?1049l\x1b[?25h"
        with contextlib.suppress(OSError):
            os.write(self._screen, left + message)
        restore_terminal(self._terminal, self._before)

    def _send(self) -> None:
        """Write the newest state if the process takes it at once."""
        if self._unsent:
            with contextlib.suppress(OSError):
                os.write(self._told.fileno(), self._unsent)
                self._unsent = b""
