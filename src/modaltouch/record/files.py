"""Files that are whole or not there: written beside their place, synced, and renamed into it; and who holds them."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from modaltouch.record.chain import RecordError
from modaltouch.system import lock, sync_file

OWNER_ALONE = 0o600
"""Permissions of a file that holds what a participant did."""

PATIENCE = 1.0
"""How long Windows is asked to rename a file that another program has open, such as a virus scanner [s]."""


LOCK_NAME = ".lock"
"""File of a folder that stands for the folder where it is locked; it stays, empty."""

LOCK_PATIENCE = 10.0
"""How long to wait for a folder that another process holds [s]; each holds it for milliseconds."""


def open_file(path: Path, flags: int) -> int:
    """Return a descriptor that takes bytes as they are; Windows would otherwise write CR LF for LF."""
    return os.open(path, flags | getattr(os, "O_BINARY", 0), OWNER_ALONE)


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
        If there is a file already, or none can be written there.
    """
    if path.exists():
        raise RecordError(f"{path}: exists already and is not overwritten; give another file with --out")
    trial = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # No permission tells: root may write to /proc, where no file can be made.
        trial.touch()
        trial.unlink()
    except OSError as error:
        raise RecordError(f"{path}: cannot be written ({error.strerror}); give another file with --out") from error


def sync_folder(folder: Path) -> None:
    """Force a folder's entries to the disk, where the system can."""
    if sys.platform == "win32":  # it keeps no descriptor of a folder; its file system logs the entries itself
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        sync_file(descriptor)
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Create a folder and those above it that are missing, every one for its owner alone.

    `Path.mkdir` gives its mode to the last folder only.

    Raises
    ------
    OSError
        If one cannot be created.
    """
    if not folder.is_dir():
        make_folder(folder.parent)
        folder.mkdir(mode=0o700, exist_ok=True)


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

    Raises
    ------
    RecordError
        If the lock cannot be made, or another process keeps it for longer than `LOCK_PATIENCE`.
    """
    with ExitStack() as stack:
        try:
            descriptor = open_file(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT)
            stack.callback(os.close, descriptor)
            lock(descriptor, LOCK_PATIENCE)
        except OSError as error:
            raise RecordError(f"{folder}: cannot be locked ({error.strerror}); see what else writes there") from error
        yield
