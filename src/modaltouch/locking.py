"""An exclusive lock on an open file or on a folder, released by the system when its process ends."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

if sys.platform == "win32":
    import msvcrt

    def lock(descriptor: int) -> None:
        """Take the lock of a file or raise OSError at once."""
        # One byte far beyond the content: Windows would otherwise forbid reading what is locked.
        os.lseek(descriptor, 1 << 40, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        os.lseek(descriptor, 0, os.SEEK_END)

else:
    import fcntl

    def lock(descriptor: int) -> None:
        """Take the lock of a file or raise OSError at once."""
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


LOCK_NAME = ".lock"
"""File of a folder that stands for the folder where it is locked; it stays, empty."""

PATIENCE = 10.0
"""How long to wait for a folder that another process holds [s]; each holds it for milliseconds."""


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
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                lock(descriptor)
                break
            except OSError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.005)
        yield
    finally:
        os.close(descriptor)
