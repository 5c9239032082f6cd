"""Where a session lives: ``<results>/[simulated|pilot/]<protocol>/sub-<id>/ses-<n>/beh/``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from modaltouch.record.chain import RecordError, RecordInputError

Mode = Literal["real", "pilot", "simulated"]
LOG_NAME = "session.jsonl"

_PARTICIPANT = re.compile(r"[A-Za-z0-9]{1,32}\Z")


@dataclass(frozen=True)
class SessionFolder:
    """The place of one session.

    Attributes
    ----------
    results : Path
        Root of all results.
    mode : str
        ``real``, ``pilot`` or ``simulated``; the last two have trees of their own.
    protocol : str
        Name of the protocol.
    participant : str
        Participant id, letters and digits only.
    session : int
        Number of the session, from 1.
    """

    results: Path
    mode: Mode
    protocol: str
    participant: str
    session: int = 1

    def __post_init__(self) -> None:
        check_participant(self.participant)
        if self.session < 1:
            raise RecordInputError(f"session number {self.session} is not allowed: sessions count from 1")

    @property
    def dataset(self) -> Path:
        """Root of the BIDS dataset: one protocol in one mode."""
        return dataset_of(self.results, self.mode, self.protocol)

    @property
    def folder(self) -> Path:
        """Folder of the session's files."""
        return self.dataset / f"sub-{self.participant}" / f"ses-{self.session}" / "beh"

    @property
    def log(self) -> Path:
        """The session log, the only truth."""
        return self.folder / LOG_NAME

    @property
    def table(self) -> Path:
        """The BIDS table derived from the log; its side file has the suffix ``.json``."""
        task = re.sub(r"[^A-Za-z0-9]", "", self.protocol)
        return self.folder / f"sub-{self.participant}_ses-{self.session}_task-{task}_beh.tsv"


def dataset_of(results: Path, mode: Mode, protocol: str) -> Path:
    """Return the root of the BIDS dataset of one protocol in one mode.

    Parameters
    ----------
    results : Path
        Root of all results.
    mode : str
        ``real``, ``pilot`` or ``simulated``.
    protocol : str
        Name of the protocol.
    """
    return (results if mode == "real" else results / mode) / protocol


def check_participant(participant: str) -> str:
    """Return the participant id if it may stand in a file name.

    Raises
    ------
    RecordError
        If it is empty, longer than 32 or holds anything but ASCII letters and digits.
    """
    if not _PARTICIPANT.match(participant):
        raise RecordInputError(
            f"participant id {participant!r} is not allowed: use 1 to 32 letters and digits (A-Z, a-z, 0-9), "
            "for example p01, and never a person's name"
        )
    return participant


def find_log(session: Path) -> Path:
    """Return the session log that a path names: the log itself, its folder, or a folder above with one log.

    Raises
    ------
    RecordInputError
        If there is none, or more than one.
    """
    if session.is_file():
        if session.suffix != ".jsonl":
            raise RecordInputError(f"{session}: is not a session log; give a session's folder or its {LOG_NAME}")
        return session
    if not session.exists():
        raise RecordInputError(f"{session}: no such file or folder; give a session's folder or its {LOG_NAME}")
    logs = sorted(session.rglob(LOG_NAME))
    if len(logs) != 1:
        listed = "".join(f"\n  {log.parent}" for log in logs[:10])
        raise RecordInputError(f"{session}: holds {len(logs)} sessions, exactly one is needed; name it{listed}")
    return logs[0]


def locate(log: Path, mode: str, protocol: str) -> SessionFolder:
    """Return the place of a session from the path of its log.

    Raises
    ------
    RecordError
        If the log does not lie where sessions lie.
    """
    folder = log.resolve().parent
    session, participant = folder.parent.name, folder.parent.parent.name
    dataset = folder.parent.parent.parent
    results = dataset.parent if mode == "real" else dataset.parent.parent
    named = re.fullmatch(r"ses-([1-9]\d*)", session), re.fullmatch(r"sub-(\w+)", participant)
    if mode not in ("real", "pilot", "simulated") or not all(named):
        raise RecordError(f"{log}: does not lie in a folder sub-<id>/ses-<n>/beh; put it back there")
    place = SessionFolder(results, mode, protocol, participant[4:], int(session[4:]))  # type: ignore[arg-type]
    if place.log != log.resolve():
        raise RecordError(
            f"{log}: is a {mode} session of the protocol {protocol} and belongs in {place.folder}; put it back there"
        )
    return place


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
