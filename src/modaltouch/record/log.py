"""Session log: one JSON line per event, synced to disk before the session continues."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar, Self

from modaltouch.record.chain import GENESIS, Chain, RecordError, describe_torn, encode_line, read_chain
from modaltouch.record.files import make_folder, move, open_file, sync_folder
from modaltouch.record.folders import SessionFolder, refuse_existing
from modaltouch.record.session import SCHEMA, Session, count, read_session
from modaltouch.record.view import write_view
from modaltouch.system import SYSTEM_CLOCK, Clock, lock, sync_file


class SessionLog(AbstractContextManager["SessionLog"]):
    """An open session log; `append` returns once the event is on disk.

    Use `create` for a new session and `reopen` for one that was interrupted.
    """

    SCHEMA: ClassVar[int] = SCHEMA
    """Version of the log format written."""

    def __init__(self, path: Path, descriptor: int, chain: Chain | None, clock: Clock = SYSTEM_CLOCK) -> None:
        self.path = path
        self.events: list[dict[str, Any]] = list(chain.events) if chain else []
        self._descriptor = descriptor
        self._clock = clock
        self._check = chain.last_check if chain else GENESIS
        self._torn = chain.torn if chain else b""
        self._needs_newline = bool(chain and not chain.ends_in_newline)
        self._failure = ""
        self._table: tuple[tuple[dict[str, Any], ...], str] = (), ""
        self._counting: dict[int, dict[str, Any]] = {}
        self._of_trials: dict[tuple[str, str], list[dict[str, Any]]] = {}
        for event in self.events:
            self._sort(event)
        self._unsettled: tuple[dict[str, Any], str, int, int] | None = None
        self.listener: Callable[[dict[str, Any]], None] = lambda line: None
        """Called with each event once it is on disk."""

    @classmethod
    def create(cls, path: Path, event: str, *, timed_by: Clock = SYSTEM_CLOCK, **facts: Any) -> Self:
        """Create a new log with its first event, accessible to its owner only.

        The file is renamed into place once it contains the first event, so that an interruption leaves either no
        session or one that can be resumed.

        Parameters
        ----------
        path : Path
            Path of the log.
        event : str
            Kind of the first event.
        timed_by : Clock
            Clock of the session.
        **facts
            Members of the event, plain values.

        Raises
        ------
        RecordError
            If the log exists or the folder cannot be written.
        """
        draft = path.with_name(f".{path.name}.{os.getpid()}.tmp")
        try:
            make_folder(path.parent)
            descriptor = open_file(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
            _take(path, descriptor)
            log = cls(path, descriptor, None, timed_by)
            try:
                log.append(event, **facts)
                log._publish(draft)
            except BaseException:
                log.close()
                draft.unlink(missing_ok=True)
                raise
        except OSError as error:
            raise RecordError(
                f"{path}: cannot be created ({error.strerror}); give a folder you may write to with --results"
            ) from error
        sync_folder(path.parent)
        return log

    @classmethod
    def reopen(cls, path: Path, *, timed_by: Clock = SYSTEM_CLOCK) -> Self:
        """Open an interrupted log for appending; an incomplete last line is kept and declared by the next line.

        Raises
        ------
        RecordError
            If the log is damaged, in use by another process, or cannot be written.
        """
        descriptor = _open_log(path)
        for leftover in path.parent.glob(".*.tmp"):  # left by a kill; the lock excludes other writers
            leftover.unlink()
        chain = read_chain(path)
        if chain.damage or not chain.events:
            os.close(descriptor)
            raise RecordError(
                "\n".join(chain.damage) or f"{path}: contains no complete line: there is nothing to continue"
            )
        return cls(path, descriptor, chain, timed_by)

    @classmethod
    def mend(cls, place: SessionFolder, *, timed_by: Clock = SYSTEM_CLOCK) -> Session:
        """Write the last line and BIDS view of a complete session if an interruption left them out.

        Raises
        ------
        RecordError
            If the log is damaged, in use by another process, or cannot be written.
        """
        session = read_session(place.log)
        is_written = place.table.exists() and (place.form_table.exists() or not session.form)
        is_current = is_written and place.lines_in_view(place.folder) == len(session.events)
        if is_current and not session.chain.problems:
            return session
        with cls.reopen(place.log, timed_by=timed_by) as log:
            if not log.ends_cleanly:
                log.append("stop", reason="finished", complete=True, n_answered=log.session.n_answered)
            log.write_view(place)
        return read_session(place.log)

    @property
    def session(self) -> Session:
        """The session as written so far."""
        session = Session(self.path, tuple(self.events))
        vars(session)["trials"] = tuple(self._counting.values())  # avoids collecting them again after each answer
        return session

    def events_of(self, trial: dict[str, Any]) -> list[dict[str, Any]]:
        """Return the events so far of a trial, identified by ``practice`` and ``index``."""
        return self._of_trials.get(_key(trial), [])

    def write_view(self, place: SessionFolder) -> None:
        """Update the session's BIDS table and its sidecar file.

        Raises
        ------
        RecordError
            If a file cannot be written; existing files remain valid.
        """
        session = self.session
        self._table = session.trials, write_view(place, session, self.head, self._table)

    def append(self, event: str, **facts: Any) -> dict[str, Any]:
        """Write an event and return it once it is on disk.

        Parameters
        ----------
        event : str
            Kind of event.
        **facts
            Members of the event, plain values.

        Raises
        ------
        RecordError
            If writing fails; the log then refuses further events.
        """
        if self._failure:
            raise RecordError(self._failure)
        self._settle()
        line = {
            "n": len(self.events) + 1,
            "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "clock": round(self._clock.now(), 6),
            "event": event,
            **({"torn": describe_torn(self._torn)} if self._torn else {}),
            **facts,
        }
        data, check = encode_line(line, self._check)
        data = b"\n" * self._needs_newline + data
        before = os.fstat(self._descriptor)
        if not before.st_nlink:
            self._failure = f"{self.path}: was deleted while the session ran; restore it from a backup, or start anew"
            raise RecordError(self._failure)
        self._unsettled = line, check, before.st_size, len(data)
        self._write(data)
        self._settle()
        self.listener(line)
        return line

    @property
    def ends_cleanly(self) -> bool:
        """Whether the log ends in a complete line."""
        return not (self._torn or self._needs_newline)

    @property
    def head(self) -> dict[str, Any]:
        """Number of lines so far and check of the last line."""
        return {"lines": len(self.events), "check": self._check}

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _publish(self, draft: Path) -> None:
        """Rename the draft to the log's path, unless that exists."""
        refuse_existing(self.path)
        if sys.platform == "win32":
            # Windows cannot rename an open file or replace an existing one. Other sessions wait for the dataset's lock.
            self.close()
            move(draft.rename, self.path)
            self._descriptor = _open_log(self.path)
            return
        try:
            os.link(draft, self.path)
        except FileExistsError:
            refuse_existing(self.path)
        except OSError:  # a file system without hard links
            draft.rename(self.path)
        else:
            draft.unlink()

    def _settle(self) -> None:
        """Account for the pending line if it was written, else discard it.

        A signal may raise an exception just after the write, so the file size decides.
        """
        if self._unsettled is None:
            return
        line, check, size, length = self._unsettled
        written = os.fstat(self._descriptor).st_size - size
        if written not in (0, length):
            self._failure = f"{self.path}: a line was cut while being written; all earlier events are on the disk"
            raise RecordError(self._failure)
        if written:
            self._check, self._torn, self._needs_newline = check, b"", False
            self.events[line["n"] - 1 :] = [line]
            self._sort(line)
        self._unsettled = None

    def _sort(self, event: dict[str, Any]) -> None:
        """Assign an event to its trial and update the answers that count."""
        count(self._counting, event)
        trial = event.get("trial")
        if isinstance(trial, dict):
            own = self._of_trials.setdefault(_key(trial), [])
            if event not in own[-1:]:  # an exception from a signal may cause a second call
                own.append(event)

    def _write(self, data: bytes) -> None:
        try:
            # With one write call, only a full disk, a power failure or SIGKILL between two pages truncates the line.
            written = os.write(self._descriptor, data)
            sync_file(self._descriptor)
        except OSError as error:
            self._failure = f"{self.path}: writing failed ({error.strerror}); earlier events are on the disk"
            raise RecordError(self._failure) from error
        if written != len(data):
            self._failure = f"{self.path}: the disk is full; all earlier events are on it, this one is not"
            raise RecordError(self._failure)


def _key(trial: dict[str, Any]) -> tuple[str, str]:
    return str(trial.get("practice")), str(trial.get("index"))


def _open_log(path: Path) -> int:
    """Open an existing log for appending, lock it, and return its descriptor."""
    try:
        descriptor = open_file(path, os.O_WRONLY | os.O_APPEND)
    except OSError as error:
        raise RecordError(f"{path}: cannot be opened for writing ({error.strerror})") from error
    _take(path, descriptor)
    return descriptor


def _take(path: Path, descriptor: int) -> None:
    try:
        lock(descriptor, 0.1)  # another process may hold it for a moment, only to test it
    except OSError as error:
        os.close(descriptor)
        raise RecordError(f"{path}: another process is writing this session; wait until it ends") from error
