"""Files that are whole or not there: written beside their place, synced, and renamed into it."""

from __future__ import annotations

import os
from pathlib import Path

from modaltouch.record.chain import RecordError

OWNER_ALONE = 0o600
"""Permissions of a file that holds what a participant did."""


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
            os.fsync(file.fileno())
        temporary.replace(path)
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
    if os.name == "nt":  # Windows keeps no descriptor of a folder; its file system logs the entries itself
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
