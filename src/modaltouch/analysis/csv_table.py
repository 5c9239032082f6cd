"""A table in a text file -> columns of coded words that know their place.

Commas, semicolons and tabs separate; a byte-order mark, any line ends and blank lines are taken as they come.
Every column is held as its different words and one small integer a row, so memory stays a few bytes a field.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import InputError, Problem, suggest

SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab"}
CHUNK_ROWS = 1_000
"""Rows held as text at a time; few, as the collector of garbage goes through them again and again."""
MOST_LISTED = 20
"""How many faults of one kind are listed one by one before the rest is only counted."""


@dataclass(frozen=True, eq=False)
class Column:
    """One column: `words[codes[row]]` is the field of a row, without surrounding space."""

    name: str
    place: int
    words: tuple[str, ...]
    codes: NDArray[np.int64]

    def first_rows(self) -> NDArray[np.int64]:
        """Return the first row of every word."""
        _, first = np.unique(self.codes, return_index=True)
        return np.asarray(first, dtype=np.int64)

    def counts(self) -> NDArray[np.int64]:
        """Return how many rows hold each word."""
        return np.bincount(self.codes, minlength=len(self.words))


@dataclass(frozen=True, eq=False)
class Table:
    """A text table.

    Attributes
    ----------
    file : str
        File as it was named.
    columns : dict of str to Column
        Columns by name, in the file's order.
    lines : (n_rows,) array of int
        Line of each row in the file.
    separator : str
        What separates the fields.
    sha256 : str
        Hash of the file's bytes.
    text: str
        The file itself.
    """

    file: str
    columns: dict[str, Column]
    lines: NDArray[np.int64]
    separator: str
    sha256: str
    text: str

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return int(self.lines.size)

    def problem(self, row: int, column: str, given: str, allowed: str, remedy: str = "") -> Problem:
        """Return a problem at the place of one field; row -1 is the header."""
        line = 1 if row < 0 else int(self.lines[row])
        place = self.columns[column].place if column in self.columns else 0
        return Problem(self.file, line, self._character(line, place), column, given, allowed, remedy)

    def _character(self, line: int, place: int) -> int:
        text = self.text.split("\n", line)[line - 1]
        quoted, seen = False, 0
        for at, character in enumerate(text):
            if seen == place:
                return at + 1
            if character == '"':
                quoted = not quoted
            elif character == self.separator and not quoted:
                seen += 1
        return len(text) + 1 if seen == place else 1


def read_table(path: Path, required: Sequence[str]) -> Table:
    """Return the table in a file.

    Parameters
    ----------
    path : Path
        A text file in UTF-8 with a header line.
    required : sequence of str
        Columns that must be there.

    Raises
    ------
    InputError
        If the file cannot be read as text, is empty, lacks columns, or has rows of another length than the
        header.
    """
    data, text = _read_text(path)
    file = str(path)
    separator = _find_separator(text, required)
    reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True, strict=True)
    # A row is blank only if its first field is, so most rows are told by that one.
    rows = ((reader.line_num, row) for row in reader if row and (row[0].strip() or any(field.strip() for field in row)))
    try:
        header_line, header = next(rows, (0, []))
        header = [name.strip() for name in header]
        while header and not header[-1]:
            header.pop()
        if not header:
            raise InputError([_whole(file, "an empty file", _form(required), "write the answers into it")])
        _check_header(file, header_line, header, required, text)
        words, codes, lines, problems = _encode(file, header, rows, separator)
    except csv.Error as error:
        given = f"a line that is not CSV ({error})"
        where = Problem(file, reader.line_num, 1, "", given, "fields in matching quotes", "repair that line")
        raise InputError([where]) from error
    if not lines.size and not problems:
        problems = [_whole(file, "a header without any row", "one row for each answer", "write the answers into it")]
    if problems:
        raise InputError(problems)
    columns = {name: Column(name, i, words[i], codes[i]) for i, name in enumerate(header)}
    return Table(file, columns, lines, separator, hashlib.sha256(data).hexdigest(), text)


def _whole(file: str, given: str, allowed: str, remedy: str) -> Problem:
    return Problem(file, 1, 1, "", given, allowed, remedy)


def _form(required: Sequence[str]) -> str:
    return f"a table with the columns {', '.join(required)}"


def _read_text(path: Path) -> tuple[bytes, str]:
    try:
        data = path.read_bytes()
    except OSError as error:
        given = f"a file that cannot be read ({error.strerror})"
        raise InputError([_whole(str(path), given, "a readable file", "check its name and permissions")]) from error
    remedy = "save the table again as CSV in UTF-8 (in a spreadsheet: CSV UTF-8)"
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in data:
        kind = "text in UTF-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "a file that is not text"
        raise InputError([_whole(str(path), kind, "text in UTF-8", remedy)])
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start]
        line, column = before.count(b"\n") + 1, len(before) - (before.rfind(b"\n") + 1) + 1
        given = f"the byte 0x{data[error.start]:02x}, which is not UTF-8"
        raise InputError([Problem(str(path), line, column, "", given, "text in UTF-8", remedy)]) from error
    return data, text.replace("\r\n", "\n").replace("\r", "\n")


def _find_separator(text: str, required: Sequence[str]) -> str:
    header = next((line for line in text.split("\n") if line.strip()), "")

    def known(separator: str) -> tuple[int, int]:
        fields = [field.strip().strip('"') for field in header.split(separator)]
        return len(set(fields) & set(required)), len(fields)

    return max(SEPARATORS, key=known)


def _check_header(file: str, line: int, header: list[str], required: Sequence[str], text: str) -> None:
    found = ", ".join(name or "(no name)" for name in header)
    missing = [name for name in required if name not in header]
    problems = []
    if len(missing) == len(required):
        given = f"a first line {text.split(chr(10))[line - 1][:80]!r}"
        raise InputError([Problem(file, line, 1, "", given, _form(required), "name the columns in the first line")])
    for name in missing:
        meant = suggest(name, [other for other in header if other and other not in required])
        remedy = f"rename {meant!r}" if meant else f"add the column {name}"
        problems.append(Problem(file, line, 1, name, f"columns {found}", _form(required), remedy))
    for name in sorted({name for name in header if header.count(name) > 1}):
        given = f"{header.count(name)} columns named {name!r}"
        problems.append(Problem(file, line, 1, name, given, "one column of each name", "rename or remove one"))
    if problems:
        raise InputError(problems)


class _Vocabulary(dict[str, int]):
    """Gives every word of a column its code, without the space around it; a known word costs one look-up."""

    def __init__(self) -> None:
        self.words: list[str] = []

    def __missing__(self, field: str) -> int:
        word = field.strip()
        code = self.get(word, len(self.words))
        if code == len(self.words):
            self.words.append(word)
            self[word] = code
        self[field] = code
        return code


def _encode(
    file: str, header: list[str], rows: Iterable[tuple[int, list[str]]], separator: str
) -> tuple[list[tuple[str, ...]], list[NDArray[np.int64]], NDArray[np.int64], list[Problem]]:
    vocabularies = [_Vocabulary() for _ in header]
    coded: list[list[NDArray[np.int64]]] = [[] for _ in header]
    lines: list[NDArray[np.int64]] = []
    problems: list[Problem] = []
    n_wrong, width, iterator = 0, len(header), iter(rows)
    while chunk := list(islice(iterator, CHUNK_ROWS)):
        for place, (line, row) in enumerate(chunk):
            if len(row) > width and not any(field.strip() for field in row[width:]):
                chunk[place] = (line, row[:width])
        wrong = [(line, len(row)) for line, row in chunk if len(row) != width]
        problems += [_length(file, line, n, header, separator) for line, n in wrong[: MOST_LISTED - len(problems)]]
        n_wrong += len(wrong)
        sound = [item for item in chunk if len(item[1]) == width]
        lines.append(np.array([line for line, _ in sound], dtype=np.int64))
        fields = zip(*(row for _, row in sound), strict=True) if sound else ([] for _ in header)
        for vocabulary, parts, column in zip(vocabularies, coded, fields, strict=True):
            parts.append(np.fromiter(map(vocabulary.__getitem__, column), dtype=np.int64, count=len(sound)))
    if n_wrong > len(problems):
        rest = f"{n_wrong - len(problems)} more rows of a wrong length"
        problems = [*problems, _whole(file, rest, f"{width} fields in every row", "")]
    empty = np.zeros(0, dtype=np.int64)
    return (
        [tuple(vocabulary.words) for vocabulary in vocabularies],
        [np.concatenate(parts) if parts else empty for parts in coded],
        np.concatenate(lines) if lines else empty,
        problems,
    )


def _length(file: str, line: int, found: int, header: list[str], separator: str) -> Problem:
    remedy = "give every row one field for each column"
    if separator == "," and found > len(header):
        remedy += "; a decimal comma makes two fields of one: write 80.5, or separate fields by semicolons"
    allowed = f"{len(header)} fields, as in the header"
    return Problem(file, line, 1, "", f"{found} fields", allowed, remedy)
