"""Recovery of the verifiable lines of a damaged log into a new log; the damaged log is never changed.

Since the check of a line includes that of its predecessor, changed, moved and duplicated lines can be detected: a line
is verified if its check is correct after that of any line in the file, or after `GENESIS`. A line whose predecessor is
missing cannot be verified; it is left out of the new log and kept in a separate file.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, TypeVar

from modaltouch.record.chain import (
    BYTE_ORDER_MARK,
    GENESIS,
    TAIL,
    RecordError,
    UnreadableLineError,
    conversion,
    decode_line,
    describe_torn,
    parse_chain,
    read_log,
    read_object,
)
from modaltouch.record.files import OWNER_ALONE, replace_file
from modaltouch.record.folders import SessionFolder, find_log
from modaltouch.record.log import SessionLog

Item = TypeVar("Item")


@dataclass(frozen=True)
class Recovery:
    """Result of the survey of a damaged log.

    Attributes
    ----------
    path : Path
        The log.
    sha256 : str
        SHA-256 of the whole file.
    events : tuple of dict
        Verified lines, in the order of writing.
    numbers : tuple of int
        Line number of each in the file, from 1.
    left_out : tuple of (int, str, bytes)
        The other lines: number in the file from 1, why it is left out, and the line as found.
    missing : tuple of int
        Numbers of lines that were written and are missing.
    converted : str
        Conversion of the whole file by another program, such as of line ends, which is undone before verification.
    is_cut : bool
        Whether the only fault is an incomplete last line, which `modaltouch resume` can handle.
    """

    path: Path
    sha256: str
    events: tuple[dict[str, Any], ...]
    numbers: tuple[int, ...]
    left_out: tuple[tuple[int, str, bytes], ...]
    missing: tuple[int, ...]
    converted: str
    is_cut: bool

    @property
    def is_sound(self) -> bool:
        """Whether no line is lost, except incomplete lines declared by the next one."""
        is_whole = not (self.left_out or self.missing or self.converted)
        return is_whole and self.numbers == tuple(sorted(self.numbers))

    @property
    def has_start(self) -> bool:
        """Whether the start record is verified; without it, the answers cannot be attributed."""
        return bool(self.events) and self.events[0].get("event") == "start"

    @property
    def lines(self) -> list[str]:
        """Sentences on what can and cannot be recovered."""
        answers = sum(event.get("event") == "trial" for event in self.events)
        sentences = [f"{len(self.events)} lines are intact, including {answers} answers"]
        if self.numbers != tuple(sorted(self.numbers)):
            sentences.append("lines were moved; their original order is known")
        sentences += [self.converted] if self.converted else []
        sentences += [f"line {number} is left out: {reason}" for number, reason, _ in self.left_out]
        if self.missing:
            sentences.append(f"missing: line{'s' * (len(self.missing) > 1)} {_ranges(self.missing)}")
        return sentences

    @property
    def _reasons(self) -> list[dict[str, Any]]:
        return [{"line": number, "reason": reason} for number, reason, _ in self.left_out]

    def as_dict(self) -> dict[str, Any]:
        """Return the recovery as plain values."""
        return {
            "session": str(self.path),
            "sound": self.is_sound,
            "n_lines": len(self.events),
            "n_answers": sum(event.get("event") == "trial" for event in self.events),
            "left_out": self._reasons,
            "missing": list(self.missing),
            "lines": self.lines,
        }

    def write(self, results: Path) -> Path:
        """Write a new log with the verified lines and a last line that describes the recovery, and return its path.

        Parameters
        ----------
        results : Path
            Root folder of results for the new log.

        Raises
        ------
        RecordError
            If the start record is not verified, or the session exists already.
        """
        if not self.has_start:
            raise RecordError(
                f"{self.path}: its start record is not intact, so it is unknown what the answers belong to; the lines "
                "are left as they are"
            )
        first, *others = self.events
        place = SessionFolder(results, first["mode"], first["protocol"], first["participant"], first["session"])
        place.refuse_existing()
        place.describe_dataset(first.get("design", {}).get("title", ""))
        new_numbers = {event["n"]: number for number, event in enumerate(self.events, 1)}
        with SessionLog.create(place.log, "start", **_facts(first)) as log:
            for event in others:
                facts = _facts(event)
                for reference in ("supersedes", "answered"):
                    if event.get(reference):
                        facts[reference] = new_numbers.get(event[reference])
                if event["event"] == "withdrawn":
                    facts["lines"] = [new_numbers[line] for line in event["lines"] if line in new_numbers]
                log.append(event["event"], **facts)
            log.append(
                "recovered",
                sha256=self.sha256,
                lines=[event["n"] for event in self.events],
                missing=list(self.missing),
                left_out=self._reasons,
            )
            place.list_participants(first)
            log.write_view(place)
        if self.left_out:
            content = b"".join(line + b"\n" for _, _, line in self.left_out)
            replace_file(place.log.with_name("left_out.txt"), content, "the new log is intact", OWNER_ALONE)
        return place.log


def survey(path: Path) -> Recovery:
    """Survey the verifiable lines of a log.

    Parameters
    ----------
    path : Path
        A session's folder or its ``session.jsonl``.

    Raises
    ------
    RecordError
        If there is no log, or it cannot be read.
    """
    path = find_log(path)
    data = read_log(path)
    converted = conversion(data)
    lines = (data.removeprefix(BYTE_ORDER_MARK).replace(b"\r\n", b"\n") if converted else data).split(b"\n")
    if lines and not lines[-1]:
        lines.pop()
    claimed = {number: tail.group(1).decode() for number, line in enumerate(lines, 1) if (tail := TAIL.search(line))}
    proved: dict[int, dict[str, Any]] = {}
    left_out: list[tuple[int, str, bytes]] = []
    first_copy: dict[bytes, int] = {}
    for number, line in enumerate(lines, 1):
        event = _prove(lines, claimed, number)
        if event is None:
            left_out.append((number, _why(line, claimed, number), line))
        elif line in first_copy:
            left_out.append((number, f"a copy of line {first_copy[line]}", line))
        else:
            first_copy[line] = number
            proved[number] = event
    order = sorted(proved, key=lambda number: proved[number]["n"])
    declared = [event["torn"] for event in proved.values() if "torn" in event]
    # The remains of several lines in a row are declared together.
    runs = [
        (run, describe_torn(b"\n".join(line for _, _, line in run))) for run in _runs(left_out, lambda each: each[0])
    ]
    left_out = [each for run, remains in runs if remains not in declared for each in run]
    events = tuple(proved[number] for number in order)
    written = {event["n"] for event in events}
    # Lines removed from the end leave no gap in the log, but the view states the number of lines it was made from.
    in_view = SessionFolder.lines_in_view(path.parent)
    missing = tuple(n for n in range(1, max(in_view, *written, 0) + 1) if n not in written)
    chain = parse_chain(data, str(path))
    is_cut = bool(chain.problems and not chain.damage) and in_view <= len(chain.checks) + 1
    return Recovery(
        path,
        hashlib.sha256(data).hexdigest(),
        events,
        numbers=tuple(order),
        left_out=tuple(left_out),
        missing=missing,
        converted=converted,
        is_cut=is_cut,
    )


def _facts(event: dict[str, Any]) -> dict[str, Any]:
    """Return the members of an event except number, kind and ``torn``, which are set by the new log."""
    return {name: value for name, value in event.items() if name not in ("n", "event", "torn")}


def _prove(lines: list[bytes], claimed: dict[int, str], number: int) -> dict[str, Any] | None:
    """Return the event of a line if its check is correct after that of any line in the file, else None."""
    for previous in (claimed.get(number - 1, GENESIS), GENESIS, *claimed.values()) if number in claimed else ():
        event, _, _ = decode_line(lines[number - 1], previous)
        if event is not None:
            return event if isinstance(event.get("n"), int) else None
    return None


def _why(line: bytes, claimed: dict[int, str], number: int) -> str:
    if number not in claimed:
        return "it was cut or its end was changed"
    try:
        read_object(line)
    except UnreadableLineError as error:
        return f"it {error}"
    return "it was changed, or the line before it is missing, so it cannot be verified"


def _ranges(numbers: tuple[int, ...]) -> str:
    """Format numbers as ``3, 7 to 9``."""
    runs = _runs(numbers, lambda number: number)
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)


def _runs(items: Sequence[Item], number_of: Callable[[Item], int]) -> list[list[Item]]:
    """Return the runs of items with consecutive numbers."""
    # The difference of number and place is constant in a run.
    runs = groupby(enumerate(items), lambda each: number_of(each[1]) - each[0])
    return [[item for _, item in run] for _, run in runs]
