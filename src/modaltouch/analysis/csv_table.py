"""Delimited text files, read as columns of strings indexed by line, and checks of the balance of their answers.

Fields are separated by commas, semicolons or tabs, or as a first line such as ``sep=;`` says. A byte-order mark, any
line endings and blank lines are accepted. Columns are pandas categoricals, to save memory.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
import pandas as pd

from modaltouch.analysis.columns import VELOCITY, scale_of
from modaltouch.analysis.responses import answers_per_cell, cell_of, describe_cell, keys_of, kinds_of
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
    margin : float or None
        Equivalence margin of the finger conditions [1].
    design : dict
        Sections of the protocol; empty if no protocol is given.
    most : int or None
        Most answers of a participant in a cell, in all analysed sessions of the protocol.
    """

    answers: AnswerList | None = None
    words: Mapping[str, str] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    margin: float | None = None
    design: Mapping[str, Any] = field(default_factory=dict)
    most: int | None = None

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
        margin, design = first.analysis.equivalence_margin, first.model_dump(mode="json")
        return cls(first.answers.offered, words or {}, missing, margin, design, max(planned.values(), default=None))

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


# Share of missing answers at or above which a participant presumably had another design, or gave up [1].
_MOST_MISSING = 0.25

# Share of rows that occur equally often at or above which a table was presumably pasted together [1].
_MOST_ROWS = 0.95

# Minimum number of distinct reaction times for which a full match cannot be coincidence.
_FEWEST_TIMES = 4


def check_balance(table: Table, frame: pd.DataFrame, *, is_crossed: bool = True) -> tuple[list[Problem], int]:
    """Find duplicate rows, missing cells and surplus answers, and return the usual number of answers per cell.

    Single answers may be missing, but not a cell of all participants, nor a quarter of one participant's answers.

    The design crosses all finger conditions, zone pairs and levels in the table. Multiple rows of one participant and
    cell are repetitions if numbered by a column ``repetition``, or if all cells have the same number of rows.

    Parameters
    ----------
    table : Table
        The file, for the locations of the problems.
    frame : DataFrame
        Rows of the file, indexed by line.
    is_crossed : bool
        Whether the design is crossed. If not, every trial has a row, and only duplicate rows are reported.
    """
    if frame["n"].sum() == 0:
        remedy = "look at the columns excluded, practice, catch and n, as far as there are any"
        return [Problem(table.file, 1, 1, "", "no answers", "at least one answer that is not practice", remedy)], 0
    again = [*_doubled(table, frame), *_copied(table, frame)]
    if not is_crossed:
        return again, 0
    answers = answers_per_cell(frame)
    counts = answers.to_numpy()
    usual = int(np.bincount(counts[counts > 0]).argmax())
    keys, scale, cells = list(keys_of(frame.columns)), scale_of(frame.columns), answers.columns.to_list()

    def missing(participant: str) -> Problem:
        row = counts[answers.index.get_loc(participant)]
        fewer = [describe_cell(cell, scale) for cell, n in zip(cells, row, strict=True) if n < usual]
        return table.problem(
            int(frame.index[frame["participant"] == participant][0]),
            "participant",
            f"{'no answer' if usual == 1 else 'too few answers'} from participant {participant} in "
            f"{', '.join(fewer[:3])}" + (f" and {len(fewer) - 3} more cells" if len(fewer) > 3 else ""),
            f"{usual} in every cell of the design (each finger condition, zone pair and level)",
            "add the missing rows, or remove this participant from the file",
        )

    def surplus(key: tuple[Any, ...]) -> Problem:
        participant, *cell = key
        lines = frame.index[(frame[keys] == list(key)).all(axis=1)]
        given = f"{answers.loc[participant, tuple(cell)]} answers from participant {participant}"
        given += f" in {describe_cell(cell, scale)} (line{'s' * (len(lines) > 1)} {', '.join(map(str, lines[:5]))})"
        remedy = "remove duplicate rows, or correct n: every cell needs the same number of answers"
        return table.problem(int(lines[-1]), "participant", given, f"{usual}, as in the other cells", remedy)

    lacks = np.maximum(usual - counts, 0)
    far = lacks.sum(axis=1) >= _MOST_MISSING * usual * len(cells)
    fewer = list(answers.index[far | ((counts == 0) & (counts == 0).all(axis=0)).any(axis=1)])
    if fewer and 2 * frame[scale.column].nunique() > len(frame):
        return [_measured_levels(table, frame, scale.column)], usual
    more = [(answers.index[who], *cells[cell]) for who, cell in np.argwhere(counts > usual).tolist()]
    problems = [
        *again,
        *list_faults(table.file, fewer, "participants with missing answers", missing, f"{usual} in every cell"),
        *list_faults(table.file, more, "cells with surplus answers", surplus, f"{usual} in every cell"),
    ]
    return problems, usual


def _measured_levels(table: Table, frame: pd.DataFrame, column: str) -> Problem:
    given = f"{frame[column].nunique()} different levels in {len(frame)} rows"
    remedy = f"give the requested levels, and measured ones in a column not named {column}"
    return table.problem(int(frame.index[0]), column, given, "the same levels for all participants", remedy)


def check_doubling(table: Table, frame: pd.DataFrame, most: int | None) -> tuple[list[Problem], list[str]]:
    """Refuse a table whose every row is duplicated, but for a few; up to the planned repetitions, note it instead.

    Repetitions of a participant who always answers alike look like copies, so unplanned ones need numbers.

    Parameters
    ----------
    table : Table
        The file.
    frame : DataFrame
        Rows of the file that count.
    most : int or None
        Most answers of a participant in a cell, according to the protocol; None if unknown.
    """
    counts = pd.util.hash_pandas_object(table.fields, index=False).value_counts().to_numpy()
    multiples = (times for times in range(int(counts.max()), 1, -1) if (counts % times == 0).mean() >= _MOST_ROWS)
    times = next(multiples, 1)
    every = "every row" if (counts % times == 0).all() else "nearly every row"
    if times < 2 or frame.empty:
        return [], []
    cell = [*cell_of(frame.columns), *({"stimulus"} & {*frame.columns})]
    found = int(frame.groupby(["participant", *cell], observed=True)["n"].sum().max())
    if most is not None and found <= most:
        return [], [f"{every} occurs {times} times, taken as repetitions, as planned: remove any copies"]
    given, allowed = f"{every} {times} times", "each once, or repetitions with numbers under `repetition`"
    remedy = "remove the copies, or number the repetitions; or name their protocol with --protocol, if it plans them"
    if most is not None:
        given += f", which gives {found} answers of a participant in a cell"
        allowed, remedy = f"{most}, as in the protocol", "remove the copies"
    return [Problem(table.file, 1, 1, "", given, allowed, remedy)], []


def check_unit(table: Table, frame: pd.DataFrame, design: Mapping[str, Any]) -> list[Problem]:
    """Report levels below 1 mm/s throughout, presumably given in m/s, unless the protocol has such levels."""
    planned = (design.get("conditions") or {}).get("peak_velocities_mm_s") or (1.0,)
    highest = frame[VELOCITY.column].max() if VELOCITY.column in frame else math.inf
    if not highest < 1 <= max(planned):
        return []
    remedy = "multiply them by 1000 if they are in m/s" + "; if not, name their protocol with --protocol" * (not design)
    given, allowed = f"levels of at most {highest:g}", "peak velocities in mm/s"
    return [table.problem(int(frame.index[0]), VELOCITY.column, given, allowed, remedy)]


def _doubled(table: Table, frame: pd.DataFrame) -> list[Problem]:
    """Report duplicate rows of a repetition or a count."""
    counted = [name for name, column in (("repetition", "repetition"), ("response", "n")) if column in table.fields]
    keys = [*keys_of(frame.columns), *counted, *({"session"} & set(frame.columns) if counted else ())]
    again = frame[frame.duplicated(keys, keep=False)] if counted else frame[:0]

    def problem(lines: pd.Index) -> Problem:
        row, cell = frame.loc[lines[1]], cell_of(frame.columns)
        where = describe_cell((row[name] for name in cell), scale_of(frame.columns))
        given = f"participant {row['participant']}, {where} again (first on line {lines[0]})"
        return table.problem(
            int(lines[1]),
            keys[-1],
            given,
            f"one row for each {', '.join(keys)}",
            "remove one of the rows, or number them",
        )

    return list_faults(table.file, list(again.groupby(keys, observed=True).groups.values()), "duplicate rows", problem)


def _copied(table: Table, frame: pd.DataFrame) -> list[Problem]:
    """Report participants whose trials all occur twice, or match another participant's answers and reaction times."""
    timed = frame.dropna(subset=["response_time"]) if "response_time" in frame else frame[:0]
    seen: dict[tuple[Any, ...], Any] = {}
    problems = []
    for participant, own in timed.groupby("participant", sort=False, observed=True):
        rows = own[[*cell_of(own.columns), "response", "response_time"]]
        if rows["response_time"].nunique() < _FEWEST_TIMES:
            continue
        other = seen.setdefault(tuple(sorted(map(str, rows.itertuples(index=False)))), participant)
        # Coarse times may coincide by chance, but only in a table pasted repeatedly does every row recur equally often.
        twice = math.gcd(*rows.value_counts().tolist()) > 1
        if twice or other != participant:
            given = (
                f"every answer of {participant}, with the same times, "
                f"{'twice' if twice else f'identical to those of {other}'}"
            )
            problems.append(table.problem(int(own.index[-1]), "participant", given, "each once", "remove the copies"))
    numbered = frame.dropna(subset=["trial"]) if "trial" in frame and not problems else frame[:0]
    marked = [name for name in ("trial", "block", "repetition", "session") if name in frame]
    for participant, own in numbered.groupby("participant", sort=False, observed=True):
        if math.gcd(*own.value_counts([*cell_of(own.columns), "response", *marked], dropna=False).tolist()) > 1:
            given, remedy = f"every trial of {participant} twice", "remove the copies, or number sessions under session"
            problems.append(table.problem(int(own.index[-1]), "participant", given, "each once", remedy))
    return problems
