"""Operations on an open file that differ between systems: locking it for one process, forcing it to the disk."""

from __future__ import annotations

import contextlib
import os
import sys
import time

LOCKED_BYTE = 1 << 40
"""The byte locked on Windows, where others cannot read a locked byte: far beyond any content."""


def lock(descriptor: int, patience: float = 0.0) -> None:
    """Take the lock of a file; raise OSError if it is not free within `patience` [s]."""
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
    """Force what was written to a file to the disk."""
    if sys.platform == "darwin":
        import fcntl

        # On macOS fsync stops at the drive's cache; a file system without F_FULLFSYNC refuses it.
        with contextlib.suppress(OSError):
            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
            return
    os.fsync(descriptor)
