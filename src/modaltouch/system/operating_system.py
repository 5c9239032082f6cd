"""Platform-dependent functions: locking and syncing an open file, and the signals that end a session."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from types import FrameType
from typing import Self

LOCKED_BYTE = 1 << 40
"""Offset of the byte locked on Windows: far beyond any content, because others cannot read a locked byte."""


def lock(descriptor: int, patience: float = 0.0) -> None:
    """Lock a file; raise OSError if the lock is not available within `patience` [s]."""
    deadline = time.monotonic() + patience
    while True:
        try:
            return _lock_at_once(descriptor)
        except OSError:
            if time.monotonic() >= deadline:
                raise
        time.sleep(0.005)


def _lock_at_once(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        os.lseek(descriptor, 0, os.SEEK_END)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def sync_file(descriptor: int) -> None:
    """Flush a file to the disk."""
    if sys.platform == "darwin":
        import fcntl

        # On macOS fsync stops at the drive's cache; file systems without F_FULLFSYNC raise OSError.
        with contextlib.suppress(OSError):
            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
            return
    os.fsync(descriptor)


SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))


class Interrupted(BaseException):
    """Raised when a signal ends the session.

    Not an `Exception`, so that no library's ``except Exception`` can swallow it.

    Attributes
    ----------
    signal_name : str
        ``SIGINT``, ``SIGTERM``, ...
    """

    def __init__(self, signal_name: str) -> None:
        super().__init__(signal_name)
        self.signal_name = signal_name


class Interruption:
    """Context manager that notes the signals in `SIGNALS`; `check` raises after one has arrived.

    A handler that raises at an arbitrary instruction could truncate a line of the record or skip an `output off`; a
    note cannot. A second SIGINT raises immediately, in case the program hangs.
    """

    def __init__(self) -> None:
        self.pending = ""
        self._previous: dict[int, object] = {}

    def check(self) -> None:
        """Raise `Interrupted` if a signal has arrived.

        Raises
        ------
        Interrupted
            With the name of the signal.
        """
        if self.pending:
            raise Interrupted(self.pending)

    def __enter__(self) -> Self:
        self._previous = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def __exit__(self, *exc: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.pending == "SIGINT" and number == signal.SIGINT:
            raise Interrupted("SIGINT")
        self.pending = signal.Signals(number).name
