"""Words of an unbalanced table that are probably a slip: rare beside the others, or spelt like one of them."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.csv_table import MOST_LISTED, Table
from modaltouch.analysis.responses import keys_of
from modaltouch.document import Problem

_FEW = 4
"""A word is rare where the commonest of its kind has at least as many times its rows."""

_CLOSE = 0.6
"""Similarity (difflib's ratio) from which two words may be one misspelt [1]."""

_NUMBER_WORDS = {"1": "one", "2": "two"}

Value = tuple[Any, ...]
Totals = dict[Value, int]


@dataclass(frozen=True, eq=False)
class Odd:
    """Rows whose word is probably a slip.

    Attributes
    ----------
    problem : Problem
        The word, its lines, and what it was probably meant to be.
    rows : (n_rows,) array of int
        Rows of the table that hold it.
    columns : tuple of str
        Columns whose true word is therefore unknown.
    """

    problem: Problem
    rows: NDArray[np.int64]
    columns: tuple[str, ...]


def find_odd(table: Table, frame: pd.DataFrame, usual: int) -> list[Odd]:
    """Return the participants, finger conditions, zone pairs and levels that are probably a slip of the pen.

    A word is odd where it is rare beside the others of its kind, or where it is spelt much like a commoner one
    whose missing answers its rows would fill. A participant is odd only in the second way: one who gave up
    early is rare, too.

    Parameters
    ----------
    table : Table
        The file, for the places of the words.
    frame : DataFrame
        Rows whose participant and cell can be read, indexed by row of the file.
    usual : int
        Answers in a cell of the design.
    """
    keys = keys_of(frame.columns)
    sums = frame.groupby(list(keys), observed=True)["n"].sum()
    totals: Totals = dict(zip(sums.index.to_list(), sums.to_list(), strict=True))
    factors = (keys[1:2], keys[2:4], keys[4:])
    odd = [each for columns in factors for each in _odd_of(table, frame, totals, columns, usual)]
    # Where a cell exists by mistake nobody else has answers, which is no gap for a participant to fill.
    rows = frame.loc[np.concatenate([each.rows for each in odd])] if odd else frame.iloc[:0]
    mistaken = set(rows[list(keys[1:])].itertuples(index=False, name=None))
    real = {key: n for key, n in totals.items() if key[1:] not in mistaken}
    return odd + _odd_of(table, frame, real, ("participant",), usual)


def _odd_of(table: Table, frame: pd.DataFrame, totals: Totals, columns: tuple[str, ...], usual: int) -> list[Odd]:
    first = keys_of(frame.columns).index(columns[0])
    place = slice(first, first + len(columns))
    counts: Counter[Value] = Counter()
    for key, n in totals.items():
        counts[key[place]] += n
    most = max(counts.values(), default=0)
    suspects = [value for value, n in sorted(counts.items(), key=lambda item: item[1]) if n < most or len(counts) == 2]
    found: dict[Value, Value | None] = {}
    for value in suspects:
        if len(found) == MOST_LISTED:
            break
        few = columns != ("participant",) and counts[value] * _FEW <= most
        others = [other for other in counts if other != value and other not in found]
        alike = {other: _likeness(value, other) for other in others if counts[other] >= counts[value]}
        if not few:
            alike = {other: like for other, like in alike.items() if _is_slip(like, counts[value], counts[other])}
        ranked = sorted(alike, key=lambda other: -alike[other])[:MOST_LISTED]
        meant = next((other for other in ranked if _fills(totals, place, value, other, usual)), None)
        if few or meant is not None:
            found[value] = meant
    common = sorted(value for value in counts if value not in found)
    return [_tell(table, frame, columns, value, meant, common) for value, meant in found.items()]


def _is_slip(likeness: float, n: int, n_other: int) -> bool:
    """Return whether a word that is not rare may be a commoner one misspelt."""
    return likeness == 1 or (likeness >= _CLOSE and 2 * n <= n_other)


def _likeness(value: Value, other: Value) -> float:
    """Return how alike two values are spelt, 1 where only case, signs or leading zeros differ [1]."""
    pairs = [(a, b) for a, b in zip(value, other, strict=True) if a != b]
    if any(not isinstance(a, str) for a, _ in pairs):
        return 0.0
    return min(_ratio(_folded(a), _folded(b)) for a, b in pairs) / len(pairs)


def _ratio(one: str, other: str) -> float:
    return 1.0 if one == other else min(difflib.SequenceMatcher(None, one, other).ratio(), 0.99)


def _folded(word: str) -> str:
    parts = re.findall(r"[^\W\d_]+|\d+", word.casefold())
    return "".join(_NUMBER_WORDS.get(part, part) for part in (part.lstrip("0") or part for part in parts))


def _fills(totals: Totals, place: slice, value: Value, other: Value, usual: int) -> bool:
    """Return whether the answers under one value would fill gaps of the other and nothing else."""
    for key, n in totals.items():
        if key[place] == value and totals.get((*key[: place.start], *other, *key[place.stop :]), 0) + n > usual:
            return False
    return True


def _tell(
    table: Table,
    frame: pd.DataFrame,
    columns: tuple[str, ...],
    value: Value,
    meant: Value | None,
    common: list[Value],
) -> Odd:
    held = np.all([(frame[name] == word).to_numpy() for name, word in zip(columns, value, strict=True)], axis=0)
    rows = frame.index[held].to_numpy(dtype=np.int64)
    lines = [str(table.lines[row]) for row in rows]
    more = f" and {len(lines) - 8} more" if len(lines) > 8 else ""
    where = f"line{'s' if len(lines) > 1 else ''} {', '.join(lines[:8])}{more}"
    differing = [i for i in range(len(columns)) if meant is None or value[i] != meant[i]]
    if len(differing) == 1:
        at = differing[0]
        word, known = value[at], sorted({each[at] for each in common})
        wanted = None if meant is None else meant[at]
    else:
        at, word, known = differing[0], "-".join(map(str, value)), ["-".join(map(str, each)) for each in common]
        wanted = None if meant is None else "-".join(map(str, meant))
    shown = ", ".join(_said(each) for each in known[:8]) + (", ..." if len(known) > 8 else "")
    remedy = "correct these rows, or give every participant the same cells"
    problem = table.problem(
        int(rows[0]),
        _column(table, int(rows[0]), columns, at, value[at]),
        f"{_said(word)!r} in {len(rows)} of {len(frame)} rows ({where})",
        f"what the other rows have: {shown}",
        remedy if wanted is None else f"did you mean {_said(wanted)!r}?",
    )
    return Odd(problem, rows, columns)


def _said(word: object) -> str:
    return f"{word:g}" if isinstance(word, float) else str(word)


def _column(table: Table, row: int, columns: tuple[str, ...], at: int, word: object) -> str:
    """Return the column where a word stands in the file; turned beams have their zones exchanged."""
    for name in (columns[at], *columns):
        column = table.columns[name]
        if column.words[column.codes[row]] == word:
            return name
    return columns[at]
