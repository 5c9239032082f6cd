"""Session folders, ``<results>/[simulated|pilot/]<protocol>/sub-<id>/ses-<n>/beh/``, and the files of a dataset.

References
----------
Brain Imaging Data Structure 1.10, "Behavioral experiments (with no neural recordings)".
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal, Self

from modaltouch.protocol import InputError
from modaltouch.record.chain import RecordError, RecordExistsError, RecordInputError
from modaltouch.record.files import LOCK_NAME, OWNER_ALONE, hold, is_locked, make_folder, replace_file
from modaltouch.system import version

BIDS_VERSION = "1.10.0"
Mode = Literal["real", "pilot", "simulated"]
LOG_NAME = "session.jsonl"
_README = """\
{}: sessions recorded by modaltouch {}.

Each session has a table of answers (*_beh.tsv) with a file that describes its columns (*_beh.json), and the log from
which both were derived (session.jsonl): the protocol, every stimulus and every answer. `modaltouch verify` recomputes
the table from the log.
"""


@dataclass(frozen=True)
class SessionFolder:
    """The folder of a session.

    Attributes
    ----------
    results : Path
        Root folder of all results.
    mode : str
        ``real``, ``pilot`` or ``simulated``; the last two have separate trees.
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
        self.check_participant(self.participant)
        if self.session < 1:
            raise RecordInputError(f"session number {self.session} is not allowed: sessions count from 1")

    @classmethod
    def of(cls, log: Path, mode: str, protocol: str) -> Self:
        """Return the folder of a session from the path of its log.

        Raises
        ------
        RecordError
            If the log is not in the folder of its session.
        """
        parts = log.resolve().parts
        named = re.fullmatch(r"sub-(\w+)/ses-([1-9]\d*)/beh", "/".join(parts[-4:-1]))
        if mode not in ("real", "pilot", "simulated") or named is None:
            raise RecordError(f"{log}: is not in a folder sub-<id>/ses-<n>/beh; move it back there")
        results = Path(*parts[: -5 if mode == "real" else -6])
        place = cls(results, mode, protocol, named[1], int(named[2]))  # type: ignore[arg-type]
        if place.log != log.resolve():
            raise RecordError(
                f"{log}: is a {mode} session of the protocol {protocol} and belongs in {place.folder}; move it back "
                "there"
            )
        return place

    @staticmethod
    def dataset_of(results: Path, mode: Mode, protocol: str) -> Path:
        """Return the root of the BIDS dataset of a protocol in a mode."""
        return (results if mode == "real" else results / mode) / protocol

    @staticmethod
    def check_participant(participant: str) -> str:
        """Return the participant id if it is valid in a file name.

        Raises
        ------
        RecordInputError
            If it is empty, longer than 32 characters, or contains anything but ASCII letters and digits.
        """
        if not re.fullmatch(r"[A-Za-z0-9]{1,32}", participant):
            raise RecordInputError(
                f"participant id {participant!r} is not allowed: use 1 to 32 letters and digits (A-Z, a-z, 0-9), "
                "for example p01, and never a person's name"
            )
        return participant

    @property
    def dataset(self) -> Path:
        """Root of the BIDS dataset, for one protocol in one mode."""
        return self.dataset_of(self.results, self.mode, self.protocol)

    @property
    def folder(self) -> Path:
        """Folder of the session's files."""
        return self.dataset / f"sub-{self.participant}" / f"ses-{self.session}" / "beh"

    @property
    def log(self) -> Path:
        """The session log, the only original."""
        return self.folder / LOG_NAME

    @property
    def table(self) -> Path:
        """BIDS table derived from the log; its sidecar file has the suffix ``.json``."""
        return self._table_of("")

    @property
    def form_table(self) -> Path:
        """BIDS table of the closing form, which is a separate task from the trials."""
        return self._table_of("form")

    def _table_of(self, part: str) -> Path:
        task = re.sub(r"[^A-Za-z0-9]", "", self.protocol)
        return self.folder / f"sub-{self.participant}_ses-{self.session}_task-{task}{part}_beh.tsv"

    def refuse_existing(self) -> None:
        """Refuse a recorded session, or a participant id that differs from another only in case.

        Raises
        ------
        RecordExistsError
            If the log exists; the message says how to continue.
        RecordInputError
            If there is such a participant, whose folder is the same on Windows and macOS.
        """
        own = f"sub-{self.participant}"
        names = [folder.name for folder in self.dataset.glob("sub-*") if folder.name.casefold() == own.casefold()]
        if names and own not in names:
            other = names[0].removeprefix("sub-")
            raise RecordInputError(
                f"given participant {self.participant}, but there is {other}, who differs in capitals alone; give "
                f"{other} for the same person, or another id for another"
            )
        refuse_existing(self.log)

    @staticmethod
    def number_of(log: Path) -> int:
        """Return the session number from the folder of a log; 0 if it has none."""
        name = log.parent.parent.name.removeprefix("ses-")
        return int(name) if name.isdecimal() else 0

    @classmethod
    def logs_of(cls, participant: Path) -> list[Path]:
        """Return the logs in a participant's folder, sorted by session number."""
        return sorted(participant.glob(f"ses-*/beh/{LOG_NAME}"), key=cls.number_of)

    @staticmethod
    def logs_under(place: Path) -> list[Path]:
        """Return the logs at a path, the file itself or all in a folder, sorted by path; also lost ones.

        A folder with a BIDS table has had a log.

        Raises
        ------
        InputError
            If there is none; the message says what to give.
        PermissionError
            If a folder belongs to another user; its sessions must not be silently missing.
        """

        def refuse(error: OSError) -> None:
            if isinstance(error, PermissionError):
                raise error

        walk = ((Path(folder, LOG_NAME), names) for folder, _, names in os.walk(place, onerror=refuse))
        found = (log for log, names in walk if LOG_NAME in names or any(name.endswith("_beh.tsv") for name in names))
        if logs := [place] if place.is_file() else sorted(found):
            return logs
        given = "a folder without a recorded session" if place.exists() else "no such file or folder"
        remedy = f"give the folder that `modaltouch run` wrote to; it holds files named {LOG_NAME}"
        raise InputError.of(place, given, "a results folder", remedy)

    @staticmethod
    def lines_in_view(folder: Path) -> int:
        """Return the number of log lines from which the BIDS view in a folder was made; 0 if not stated."""
        for side in folder.glob("*_beh.json"):
            with suppress(OSError, ValueError, LookupError, TypeError, RecursionError):  # such as the form's
                return int(json.loads(side.read_text(encoding="utf-8"))["SessionLog"]["lines"])
        return 0

    def describe_dataset(self, title: str) -> None:
        """Write the dataset's description, README and ignore file, unless there is a description.

        Raises
        ------
        RecordError
            If a file cannot be written.
        """
        dataset = self.dataset
        try:
            make_folder(dataset)
        except OSError as error:
            raise RecordError(
                f"{dataset}: cannot be created ({error.strerror}); give a folder you may write to with --results"
            ) from error
        if (dataset / "dataset_description.json").exists():
            return
        description = {
            "Name": title or self.protocol,
            "BIDSVersion": BIDS_VERSION,
            "DatasetType": "raw",
            "GeneratedBy": [{"Name": "modaltouch", "Version": version()}],
        }
        replace_text(dataset / "README", _README.format(description["Name"], version()))
        replace_text(dataset / ".bidsignore", f"*.jsonl\n*.log\n{LOCK_NAME}\n")
        # Last, since its presence says that all three are there, whatever is interrupted.
        replace_json(dataset / "dataset_description.json", description)

    def hold_dataset(self) -> AbstractContextManager[None]:
        """Lock the dataset, so that no other session starts in it; raises `RecordError` like `hold`."""
        return hold(self.dataset)

    def list_participants(self, start: Mapping[str, Any] | None = None) -> None:
        """Add missing participants to ``participants.tsv``, and this one's answers to the protocol's questions.

        Entries made by the lab, in the list or in the file that describes its columns, are kept.

        Parameters
        ----------
        start : mapping, optional
            Start record of the participant's session.

        Raises
        ------
        RecordError
            If the list cannot be read or written.
        """
        fields = (start or {}).get("design", {}).get("people", {})
        answers = (start or {}).get("people", {})
        if group := (start or {}).get("schedule", {}).get("group"):
            names = list((start or {})["design"]["groups"])
            fields = {"group": {"question": "Group of the participant", "kind": "choice", "choices": names}} | fields
            answers = {"group": group} | answers
        with self.hold_dataset():  # sessions may start concurrently, and the list must contain both
            table, side = self.dataset / "participants.tsv", self.dataset / "participants.json"
            read, own = table, f"sub-{self.participant}"
            try:
                text = table.read_text(encoding="utf-8") if table.exists() else ""
                rows = [line.split("\t") for line in text.splitlines() if line] or [["participant_id"]]
                read = side
                known = json.loads(side.read_text(encoding="utf-8")) if fields and side.exists() else {}
                described = {name: _describe(field) for name, field in fields.items()} | known
            except (OSError, ValueError, TypeError) as error:
                raise RecordError(f"{read}: cannot be read ({error}); repair it or move it away") from error
            header = [*rows[0], *(name for name in fields if name not in rows[0])]
            listed = {row[0] for row in rows}
            folders = sorted(folder.name for folder in self.dataset.glob("sub-*") if folder.is_dir())
            made = "\t".join(header) + "\n"
            for row in (*rows[1:], *([name] for name in folders if name not in listed)):
                cells = zip_longest(header, row, fillvalue="n/a")
                mine = answers if row[0] == own else {}
                made += "\t".join(_cell(mine.get(name)) if cell == "n/a" else cell for name, cell in cells) + "\n"
            if made != text:
                replace_text(table, made)
            if described != known:
                replace_json(side, described)


def _cell(answer: object) -> str:
    return "n/a" if answer is None else f"{answer:g}" if isinstance(answer, float) else " ".join(str(answer).split())


def _describe(field: Mapping[str, Any]) -> dict[str, Any]:
    levels = {each: each for each in field.get("choices", ())} or {"yes": "yes", "no": "no"}
    return {
        "Description": field.get("question", ""),
        **({"Units": field["unit"]} if field.get("unit") else {}),
        **({"Levels": levels} if field.get("kind") in ("choice", "consent") else {}),
    }


def replace_text(path: Path, text: str) -> None:
    """Write a file of the view atomically, accessible to its owner only."""
    replace_file(path, text.encode(), "the session log is intact", OWNER_ALONE)


def replace_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write plain values as a JSON file of the view."""
    replace_text(path, json.dumps(values, indent=2, ensure_ascii=False) + "\n")


def find_log(session: Path) -> Path:
    """Return the session log at a path: the log itself, its folder, or any folder with a single log.

    Raises InputError if there is none, RecordInputError if there are several or the file is not a log.
    """
    if session.is_file() and session.suffix != ".jsonl":
        raise RecordInputError(f"{session}: is not a session log; give a session's folder or its {LOG_NAME}")
    logs = [session] if session.name == LOG_NAME else SessionFolder.logs_under(session)
    if len(logs) > 1:
        listed = "".join(f"\n  {log.parent}" for log in logs[:10])
        raise RecordInputError(f"{session}: holds {len(logs)} sessions, but exactly one is needed; give it{listed}")
    return logs[0]


def refuse_existing(path: Path) -> None:
    """Raise RecordExistsError, with how to continue, if the log of a session exists."""
    if path.exists() and is_locked(path):
        raise RecordExistsError(
            f"{path}: another program is running this session now; give another participant id, or wait until it ends"
        )
    if path.exists():
        raise RecordExistsError(
            f"{path}: this session exists already and is never overwritten; "
            f"continue it with `modaltouch resume {path.parent}`, or give another --session number or --results folder"
        )
