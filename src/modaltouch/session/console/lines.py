"""How a session stands, line by line: in plain words where there is no terminal, and as JSON for other programs."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import stat
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

from modaltouch.session.console.drawing import describe_last
from modaltouch.session.console.interface import Facts, NoConsole

_OPENING = b'{"time": "'
"""How every line begins."""
LONGEST_LINE = 4096
"""A pipe takes a line of this length whole or not at all (POSIX's PIPE_BUF on Linux) [bytes]."""


class PlainLines(NoConsole):
    """One line for each answer, pause, break, warning and trouble.

    Parameters
    ----------
    file : text stream
        Where they go.
    """

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._warned: set[str] = set()
        self._error = ""
        self._told: int | None = None

    def show(self, facts: Facts) -> None:
        """Write what is new."""
        last, minutes = facts["last"], facts["time_left_s"] / 60
        if facts["event"] in ("answered", "trial") and last["line"] != self._told:
            self._told = last["line"]
            done = f"{facts['n_answered']} of {facts['n_trials']} answered"
            self._write(f"{done}: {describe_last(last)}; {minutes:.0f} min left")
        elif facts["event"] in ("pause", "focus_lost", "continued", "rest", "stop"):
            words = {"pause": "paused", "focus_lost": "paused: focus lost", "rest": "break", "continued": "going on"}
            self._write(words.get(facts["event"], f"ended: {facts['stopped_by']}"))
        for warning in facts["warnings"]:
            # A warning counts on with every trial; it is said when it begins.
            if warning.split(" ", 1)[-1][:12] not in self._warned:
                self._warned.add(warning.split(" ", 1)[-1][:12])
                self._write(f"warning: {warning}")
        if facts["generator"]["last_error"] not in ("", self._error):
            self._error = facts["generator"]["last_error"]
            self._write(f"generator: {self._error}")

    def _write(self, line: str) -> None:
        # Nobody may read it any more; the session goes on.
        with contextlib.suppress(OSError, ValueError):
            self._file.write(line + "\n")
            self._file.flush()


class EventLines(NoConsole):
    """The facts as JSON lines in a file or a named pipe, never waiting for whoever reads it.

    A line says everything, so one that a full pipe does not take is dropped; the next one that is taken says how
    many were, under ``n_dropped``.

    Parameters
    ----------
    path : Path
        A file, which is appended to, or a named pipe, which may get its reader at any time.

    Raises
    ------
    OSError
        If it can be neither, or the file holds something else already.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor = -1
        self._n_dropped = 0
        if path.is_file() and path.read_bytes()[: len(_OPENING)] not in (b"", _OPENING):
            raise FileExistsError(errno.EEXIST, "it holds something else than events already", str(path))
        self._open()

    def show(self, facts: Facts) -> None:
        """Write a line, if it is taken at once."""
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
            self.close()  # the reader has gone, and another may come; or the disk is full
        self._n_dropped += 1

    def close(self) -> None:
        """Close it."""
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
            # A pipe that nobody reads yet.

    def _line(self, facts: Facts) -> bytes:
        time = datetime.now(UTC).isoformat(timespec="milliseconds")
        said = {"time": time, **facts, **({"n_dropped": self._n_dropped} if self._n_dropped else {})}
        line = json.dumps(said, ensure_ascii=False).encode() + b"\n"
        if len(line) > LONGEST_LINE:
            shortened = {**said, "warnings": [warning[:80] for warning in facts["warnings"][:4]]}
            shortened["generator"] = {**facts["generator"], "last_error": facts["generator"]["last_error"][:200]}
            line = json.dumps(shortened, ensure_ascii=False).encode() + b"\n"
        return line
