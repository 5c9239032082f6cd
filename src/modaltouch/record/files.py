"""Files that are whole or not there: written beside their place, synced, and renamed into it."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

from modaltouch.record.chain import RecordError

OWNER_ALONE = 0o600
"""Permissions of a file that holds what a participant did."""

PATIENCE = 1.0
"""How long Windows is asked to rename a file that another program has open, such as a virus scanner [s]."""


def open_file(path: Path, flags: int) -> int:
    """Return a descriptor that takes bytes as they are; Windows would otherwise write CR LF for LF."""
    return os.open(path, flags | getattr(os, "O_BINARY", 0), OWNER_ALONE)


def sync_file(descriptor: int) -> None:
    """Force what was written to a file to the disk."""
    if sys.platform == "darwin":
        import fcntl

        # There fsync stops at the cache of the drive; a file system that cannot do more refuses this.
        with contextlib.suppress(OSError):
            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
            return
    os.fsync(descriptor)


def move(rename: Callable[[Path], object], target: Path) -> None:
    """Call `Path.rename` or `Path.replace` of a file until it is done; Windows refuses while either file is open."""
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            rename(target)
            return
        except PermissionError:
            if sys.platform != "win32" or time.monotonic() >= deadline:
                raise
        time.sleep(0.02)


def replace_file(path: Path, content: bytes, remedy: str, mode: int = 0o666) -> None:
    """Put a file in place in one step: a reader sees the old one or the new one, never a part.

    Parameters
    ----------
    path : Path
        Where it goes; its folder exists.
    content : bytes
        What it holds.
    remedy : str
        What to do, or what is safe, where it cannot be written.
    mode : int
        Its permissions, of which the user's mask takes some.

    Raises
    ------
    RecordError
        If the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb", opener=lambda name, flags: os.open(name, flags, mode)) as file:
            file.write(content)
            file.flush()
            sync_file(file.fileno())
        move(temporary.replace, path)
        sync_folder(path.parent)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise RecordError(f"{path}: cannot be written ({error.strerror}); {remedy}") from error


def prepare_file(path: Path) -> None:
    """Make the folder of a file that is to be written, and refuse one that is there: somebody may have used it.

    Raises
    ------
    RecordError
        If there is a file already, or its folder cannot be made.
    """
    if path.exists():
        raise RecordError(f"{path}: is there already and is not overwritten; give another file with --out")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"{path.parent}: cannot be made ({error.strerror}); give another file with --out") from error


def sync_folder(folder: Path) -> None:
    """Force a folder's entries to the disk, where the system can."""
    if sys.platform == "win32":  # it keeps no descriptor of a folder; its file system logs the entries itself
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        sync_file(descriptor)
    finally:
        os.close(descriptor)
