"""Delimited text files, read as columns of strings indexed by line.

Fields are separated by commas, semicolons or tabs, or as a first line such as ``sep=;`` says. A byte-order mark, any
line endings and blank lines are accepted. Columns are pandas categoricals, to save memory.
"""

from __future__ import annotations

import csv
import hashlib
import io
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import pandas as pd

from modaltouch.analysis.responses import kinds_of
from modaltouch.protocol import AnswerList, InputError, Problem, suggest

if TYPE_CHECKING:
    from modaltouch.protocol import Findings

SEPARATORS = (",", ";", "\t")
_NAMED_SEPARATOR = re.compile(r'"?sep=([^\n"])"?[,;\t ]*(?=\n)', re.IGNORECASE)
"""First line by which a spreadsheet program names the separator."""
MOST_LISTED = 20
"""Maximum number of problems of one kind to list; the rest are only counted."""

Fault = TypeVar("Fault")


@dataclass(frozen=True)
class TableFormat:
    """Format of a CSV file.

    Attributes
    ----------
    answers : AnswerList or None
        The answers offered; by default the paper's.
    words : dict of str to str
        Mapping from words in the file to answers.
    missing : tuple of str
        Words for a missing answer, besides an empty field, ``n/a`` and ``time_out``.
    design : dict
        Sections of the protocol; empty if no protocol is given.
    planned : dict of tuple to int
        Answers of a participant in all analysed sessions of the protocol, by group, finger condition, zones, level and
        stimulus; empty if no protocol is given.
    is_pilot : bool
        Whether the answers may be to other levels than those of the protocol.
    """

    answers: AnswerList | None = None
    words: Mapping[str, str] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    design: Mapping[str, Any] = field(default_factory=dict)
    planned: Mapping[tuple[Any, ...], int] = field(default_factory=dict)
    is_pilot: bool = False

    @classmethod
    def of(cls, findings: Findings, words: Mapping[str, str] | None = None, missing: tuple[str, ...] = ()) -> Self:
        """Return the format of answers to a protocol, whose `findings` include those of its groups and kinds."""
        planned = Counter[tuple[Any, ...]]()
        for each in (findings, *findings.others):
            own, (group, kind) = each.experiment().protocol, each.occasion
            kinds = [met.name for met in own.schedule.session_kinds if met.analysed]
            n_times = own.scheduled_repetitions * (kinds.count(kind) if kind else own.schedule.n_sessions)
            cells = [(group, name, *cell) for name in own.conditions.finger_conditions for cell in own.cells(name)]
            planned.update(cells * n_times)
        first = findings.experiment().protocol
        return cls(first.answers.offered, words or {}, missing, first.model_dump(mode="json"), planned)

    @property
    def most(self) -> int | None:
        """Most answers of a participant in a cell; None if unknown."""
        return max(self.planned.values(), default=None)

    @property
    def asked(self) -> tuple[str, ...]:
        """Columns required by the protocol; without them, the analysis could silently assume a different design."""
        answers = self.design.get("answers") or {}
        sections = {"interval": self.design.get("intervals"), "value": answers.get("scale"),
                "stimulus": self.design.get("stimuli"), "group": self.design.get("groups"),
                "session_kind": len(kinds_of(self.design)) > 1}  # fmt: skip
        return (*(name for name, section in sections.items() if section), *(answers.get("then") or {}))


@dataclass(frozen=True, eq=False)
class Table:
    """A table read from a text file.

    Attributes
    ----------
    file : str
        Path of the file, as given by the user.
    fields : DataFrame
        Stripped fields as categorical columns in the order of the file, indexed by line.
    separator : str
        Field separator.
    sha256 : str
        Hash of the file.
    """

    file: str
    fields: pd.DataFrame
    separator: str
    sha256: str

    def problem(self, line: int, column: str, given: str, allowed: str, remedy: str = "") -> Problem:
        """Return a problem of a field."""
        return Problem(self.file, line, 1, column, given, allowed, remedy)

    def check_words(
        self, column: pd.Series, is_sound: Callable[[str], bool], allowed: str, say: Callable[[str], tuple[str, str]]
    ) -> list[Problem]:
        """Return a problem for each invalid word of a column, at its first occurrence.

        Parameters
        ----------
        column : Series
            A column of `fields`, or a subset of its rows.
        is_sound : callable
            Whether a word is valid.
        allowed : str
            Description of the valid words.
        say : callable
            Maps an invalid word to a description of the word and a remedy.
        """
        counts = column.value_counts(sort=False)
        faulty = [(str(word), n) for word, n in counts[counts > 0].items() if not is_sound(str(word))]

        def problem(fault: tuple[str, int]) -> Problem:
            word, n = fault
            given, remedy = say(word)
            given += f" (in {n} rows)" if n > 1 else ""
            return self.problem(int(column.index[column == word][0]), str(column.name), given, allowed, remedy)

        return list_faults(self.file, faulty, f"words of this kind under {column.name}", problem)


def list_faults(
    file: str, faults: Sequence[Fault], what: str, problem: Callable[[Fault], Problem], allowed: str = "none of them"
) -> list[Problem]:
    """Return a problem for each of the first faults, and one with the number of the others."""
    beyond = len(faults) - MOST_LISTED
    rest = [Problem(file, 1, 1, "", f"{beyond} more {what}", allowed)] if beyond > 0 else []
    return [*map(problem, faults[:MOST_LISTED]), *rest]


def read_table(path: Path, required: Sequence[str]) -> Table:
    """Read a table from a file.

    Parameters
    ----------
    path : Path
        A text file in UTF-8 with a header line.
    required : sequence of str
        Required columns.

    Raises
    ------
    InputError
        If the file cannot be read as text, is empty, lacks columns, or has rows of a different length than the header.
    """
    data, text = _read_text(path)
    file, named = str(path), _NAMED_SEPARATOR.match(text)
    text = text[named.end() :] if named else text  # an empty line is left, so that line numbers hold
    separator = _find_separator(text, required, (*([named[1]] if named else []), *SEPARATORS))
    reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True, strict=True)
    rows = ((reader.line_num, row) for row in reader if any(map(str.strip, row)))
    try:
        header_line, header = next(rows, (0, []))
        header = [name.strip() for name in header]
        while header and not header[-1]:
            header.pop()
        if not header:
            raise InputError.of(path, "an empty file", _form(required), "write the answers into it")
        _check_header(file, header_line, header, required, text)
        fields, problems = _read_fields(file, header, rows, separator)
    except csv.Error as error:
        where = Problem(
            file,
            reader.line_num,
            1,
            "",
            f"a line that is not CSV ({error})",
            "fields in matching quotes",
            "repair that line",
        )
        raise InputError([where]) from error
    if fields.empty and not problems:
        raise InputError.of(path, "a header without any row", "one row for each answer", "write the answers into it")
    if problems:
        raise InputError(problems)
    return Table(file, fields, separator, hashlib.sha256(data).hexdigest())


def _form(required: Sequence[str]) -> str:
    return f"a table with one answer per row and the columns {', '.join(required)}"


def _read_text(path: Path) -> tuple[bytes, str]:
    try:
        data = path.read_bytes()
    except OSError as error:
        given = f"a file that cannot be read ({error.strerror})"
        raise InputError.of(path, given, "a readable file", "check its name and permissions") from error
    remedy = "save the table again as CSV in UTF-8 (in a spreadsheet: CSV UTF-8)"
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in data:
        kind = "text in UTF-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "a file that is not text"
        raise InputError.of(path, kind, "text in UTF-8", remedy)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start]
        line, column = before.count(b"\n") + 1, len(before) - (before.rfind(b"\n") + 1) + 1
        given = f"the byte 0x{data[error.start]:02x}, which is not UTF-8"
        raise InputError([Problem(str(path), line, column, "", given, "text in UTF-8", remedy)]) from error
    return data, text.replace("\r\n", "\n").replace("\r", "\n")


def _find_separator(text: str, required: Sequence[str], separators: Sequence[str]) -> str:
    header = next((line for line in text.split("\n") if line.strip()), "")

    def known(separator: str) -> tuple[int, int]:
        fields = [field.strip().strip('"') for field in header.split(separator)]
        return len(set(fields) & set(required)), len(fields)

    return max(separators, key=known)


def _check_header(file: str, line: int, header: list[str], required: Sequence[str], text: str) -> None:
    found = ", ".join(name or "(no name)" for name in header)
    missing = [name for name in required if name not in header]
    problems = []
    if len(missing) == len(required) and not any(suggest(name, header) for name in required):
        given = f"a first line {text.split(chr(10))[line - 1][:80]!r}"
        raise InputError([Problem(file, line, 1, "", given, _form(required), "name the columns in the first line")])
    for name in missing:
        meant = suggest(name, [other for other in header if other and other not in {*required, "session"}])
        remedy = f"rename {meant!r}" if meant else f"add the column {name}, or rename the one that holds it"
        problems.append(Problem(file, line, 1, name, f"columns {found}", _form(required), remedy))
    for name in sorted({name for name in header if header.count(name) > 1}):
        given = f"{header.count(name)} columns named {name!r}"
        problems.append(Problem(file, line, 1, name, given, "one column of each name", "rename or remove one"))
    if problems:
        raise InputError(problems)


def _read_fields(
    file: str, header: list[str], rows: Iterable[tuple[int, list[str]]], separator: str
) -> tuple[pd.DataFrame, list[Problem]]:
    """Return the fields of rows that match the header in length, and a problem for each other row."""
    columns: list[list[str]] = [[] for _ in header]
    lines: list[int] = []
    wrong: list[tuple[int, int]] = []
    for line, row in rows:
        if len(row) < len(header) or any(map(str.strip, row[len(header) :])):
            wrong.append((line, len(row)))
            continue
        lines.append(line)
        for column, word in zip(columns, row, strict=False):
            column.append(sys.intern(word.strip()))

    def problem(fault: tuple[int, int]) -> Problem:
        line, found = fault
        remedy = "give every row one field for each column"
        if separator == "," and found > len(header):
            remedy += "; a decimal comma splits a number into two fields: write 80.5, or separate fields by semicolons"
        return Problem(file, line, 1, "", f"{found} fields", f"{len(header)} fields, as in the header", remedy)

    problems = list_faults(file, wrong, "rows of a wrong length", problem, f"{len(header)} fields in every row")
    coded = {name: pd.Categorical(columns.pop(0)) for name in header}  # pop frees each list in turn
    return pd.DataFrame(coded, index=lines), problems
