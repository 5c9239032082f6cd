"""Atomic file replacement, by writing a temporary file, syncing and renaming it; folders and locks."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from modaltouch.record.chain import RecordError
from modaltouch.system import lock, sync_file

OWNER_ALONE = 0o600
"""Permissions of files with participant data."""

PATIENCE = 1.0
"""Time to retry renaming, on Windows, a file that another program such as a virus scanner has open [s]."""

LOCK_NAME = ".lock"
"""Empty lock file of a folder; never deleted."""

LOCK_PATIENCE = 10.0
"""Time to wait for a folder locked by another process, usually for milliseconds [s]."""


def open_file(path: Path, flags: int) -> int:
    """Return a descriptor opened in binary mode, since Windows would otherwise write CR LF for LF."""
    return os.open(path, flags | getattr(os, "O_BINARY", 0), OWNER_ALONE)


def move(rename: Callable[[Path], object], target: Path) -> None:
    """Call `Path.rename` or `Path.replace` until it succeeds; Windows refuses while either file is open."""
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
    """Write a file atomically: readers see either the old or the new file.

    Parameters
    ----------
    path : Path
        The file, in an existing folder.
    content : bytes
        Contents of the file.
    remedy : str
        End of the error message: what to do, or what is safe.
    mode : int
        Permissions, subject to the user's umask.

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
        with suppress(OSError):  # a disk that has become read-only lets nothing be removed either
            temporary.unlink()
        raise RecordError(f"{path}: cannot be written ({error.strerror}); {remedy}") from error


def prepare_file(path: Path, option: str = "--out") -> None:
    """Create the folder of the file that an option names, and refuse to overwrite an existing file.

    Raises
    ------
    RecordError
        If the file exists, or cannot be written.
    """
    if path.exists():
        raise RecordError(f"{path}: exists already and is not overwritten; give another file with {option}")
    trial = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Permissions are not conclusive: root may write to /proc but cannot create a file there.
        trial.touch()
        trial.unlink()
    except OSError as error:
        raise RecordError(f"{path}: cannot be written ({error.strerror}); give another file with {option}") from error


def sync_folder(folder: Path) -> None:
    """Sync a folder's entries to disk, where supported."""
    if sys.platform == "win32":  # Windows has no folder descriptors, and its file system journals the entries
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        sync_file(descriptor)
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Create a folder and its missing parents, each accessible to its owner only.

    `Path.mkdir` applies its mode to the last folder only. Raises OSError if a folder cannot be created.
    """
    if not folder.is_dir():
        make_folder(folder.parent)
        folder.mkdir(mode=0o700, exist_ok=True)


def is_locked(path: Path) -> bool:
    """Return whether a process holds the lock of a file, such as the log of a running session."""
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
    """Lock a folder's shared files, such as the list of participants, against changes by other processes.

    Raises RecordError if the lock cannot be created, or is held by another process for longer than `LOCK_PATIENCE`.
    """
    with ExitStack() as stack:
        try:
            descriptor = open_file(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT)
            stack.callback(os.close, descriptor)
            lock(descriptor, LOCK_PATIENCE)
        except OSError as error:
            raise RecordError(f"{folder}: cannot be locked ({error.strerror}); see what else writes there") from error
        yield
