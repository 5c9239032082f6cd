"""An exclusive lock on an open file or on a folder, released by the system when its process ends."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LOCK_NAME = ".lock"
"""File of a folder that stands for the folder where it is locked; it stays, empty."""

PATIENCE = 10.0
"""How long to wait for a folder that another process holds [s]; each holds it for milliseconds."""

LOCKED_BYTE = 1 << 40
"""The byte that is locked on Windows, which forbids others to read what is locked: far beyond any content."""


def lock(descriptor: int, patience: float = 0.0) -> None:
    """Take the lock of a file, or raise OSError once it has been waited for so long [s]."""
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


def is_locked(path: Path) -> bool:
    """Return whether a process keeps the lock of a file, as a session does for its log while it is run."""
    try:
        descriptor = os.open(path, os.O_RDWR)
    except OSError:
        return False
    try:
        lock(descriptor)
    except OSError:
        return True
    finally:
        os.close(descriptor)
    return False


@contextmanager
def hold(folder: Path) -> Iterator[None]:
    """Keep other processes from changing what a folder holds in common, such as a list of participants.

    Parameters
    ----------
    folder : Path
        An existing folder; a file `LOCK_NAME` appears in it.

    Raises
    ------
    OSError
        If the lock cannot be made, or another process keeps it for longer than `PATIENCE`.
    """
    descriptor = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        lock(descriptor, PATIENCE)
        yield
    finally:
        os.close(descriptor)
