"""Whether every participant answered every cell of the design equally often."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.csv_table import MOST_LISTED, Table
from modaltouch.analysis.responses import answers_per_cell, cell_of, describe_cell, keys_of
from modaltouch.analysis.scale import scale_of
from modaltouch.protocol import Problem

_ANY = "\0any"
"""Stands for a word that cannot be read and may be any; no text file holds it."""

_MOST_EXCUSES = 10_000
"""With more faulty rows that differ, nothing can be said about the balance of the rest."""


def check_balance(table: Table, frame: pd.DataFrame, unread: pd.DataFrame | None = None) -> list[Problem]:
    """Return doubled rows, missing cells and unequal numbers of answers.

    The design is every finger condition with every zone pair at every level that occurs. Rows of the same
    participant and cell are repetitions where a column ``repetition`` tells them apart, or where all cells have
    the same number of them.

    Parameters
    ----------
    table : Table
        The file, for the places of the faults.
    frame : DataFrame
        Its rows, indexed by row of the file.
    unread : DataFrame, optional
        Which words of them are faulty by themselves: truth values by row, a column for each of `keys_of` and
        one ``other`` for the rest of the row. Such rows are neither counted nor missed.
    """
    keys = list(keys_of(frame.columns))
    if unread is None:
        unread = pd.DataFrame(False, index=frame.index, columns=[*keys, "other"])
    if not len(frame) or (frame["n"].sum() == 0 and not unread.to_numpy().any()):
        return [Problem(table.file, 1, 1, "", "no answers", "at least one answer that is not practice", "")]
    faulty = _any_of(unread)
    sound = frame.loc[~faulty]
    if sound["n"].sum() == 0:
        return []
    problems = _doubled(table, sound)
    answers = answers_per_cell(sound)
    usual = _most_common(answers.to_numpy().ravel())
    counted = np.where(_excused(answers, frame.loc[faulty], unread.loc[faulty]), np.maximum(answers, usual), answers)
    return problems + _unequal(table, sound, answers, counted, usual)


def _unequal(
    table: Table, frame: pd.DataFrame, answers: pd.DataFrame, counted: NDArray[np.int64], usual: int
) -> list[Problem]:
    """Return the participants with missing or surplus answers, those of faulty rows not missed."""
    problems: list[Problem] = []
    listed = 0
    for participant, row in zip(answers.index, counted, strict=True):
        odd = np.flatnonzero(row != usual)
        if not odd.size:
            continue
        listed += 1
        if listed <= MOST_LISTED:
            problems += _unbalanced(table, frame, participant, row, answers.columns.to_list(), usual)
    if listed > MOST_LISTED:
        rest = f"{listed - MOST_LISTED} more participants with missing or surplus answers"
        problems.append(Problem(table.file, 1, 1, "", rest, f"{usual} in every cell", ""))
    return problems


def _any_of(truths: pd.DataFrame) -> NDArray[np.bool_]:
    """Return which rows hold anything true."""
    return np.asarray(truths.to_numpy(dtype=bool).any(axis=1), dtype=np.bool_)


def _excused(answers: pd.DataFrame, frame: pd.DataFrame, unread: pd.DataFrame) -> NDArray[np.bool_]:
    """Return which missing answers may stand in faulty rows, (n_participants, n_cells) array."""
    excused = np.zeros(answers.shape, dtype=bool)
    keys = list(keys_of(frame.columns))
    known = frame[keys].astype(object).where(~unread[keys].to_numpy(), _ANY)
    different = set(known.itertuples(index=False, name=None))
    if len(different) > _MOST_EXCUSES:
        return np.ones(answers.shape, dtype=bool)
    participants = answers.index.to_numpy()
    cells = [answers.columns.get_level_values(name).to_numpy() for name in keys[1:]]
    for participant, *cell in different:
        rows = np.full(len(participants), True) if participant == _ANY else participants == participant
        columns = np.full(answers.shape[1], True)
        for words, word in zip(cells, cell, strict=True):
            columns &= True if word == _ANY else words == word
        excused[np.ix_(rows, columns)] = True
    return excused


def _doubled(table: Table, frame: pd.DataFrame) -> list[Problem]:
    """Return rows that say the same thing twice: one repetition, or one count, given again."""
    keys = list(keys_of(frame.columns))
    if "repetition" in table.columns:
        keys.append("repetition")
    elif "n" not in table.columns:
        return []
    if "n" in table.columns:
        keys.append("response")
    again = np.flatnonzero(frame.duplicated(keys).to_numpy())
    problems = []
    for at in again[:MOST_LISTED]:
        row = frame.iloc[at]
        same = np.flatnonzero((frame[keys] == row[keys]).all(axis=1).to_numpy())
        given = f"{_who(row)} again (first on line {table.lines[frame.index[same[0]]]})"
        allowed = f"one row for each {', '.join(keys)}"
        problems.append(
            table.problem(int(frame.index[at]), keys[-1], given, allowed, "remove one of the rows, or number them")
        )
    if len(again) > MOST_LISTED:
        rest = f"{len(again) - MOST_LISTED} more doubled rows"
        problems.append(Problem(table.file, 1, 1, "", rest, "one row for each answer", ""))
    return problems


def _unbalanced(
    table: Table,
    frame: pd.DataFrame,
    participant: object,
    row: NDArray[np.int64],
    cells: Sequence[Any],
    usual: int,
) -> list[Problem]:
    own = frame.index[(frame["participant"] == participant).to_numpy()]
    first, names, scale = int(own[0]), cell_of(frame.columns), scale_of(frame.columns)
    problems = []
    fewer = [describe_cell(cell, scale) for cell, n in zip(cells, row, strict=True) if n < usual]
    if fewer:
        shown = ", ".join(fewer[:3]) + (f" and {len(fewer) - 3} more cells" if len(fewer) > 3 else "")
        what = "no answer" if usual == 1 else "too few answers"
        problems.append(
            table.problem(
                first,
                "participant",
                f"{what} of participant {participant} in {shown}",
                f"{usual} in every cell of the design (each finger condition, zone pair and level)",
                "add the missing rows, or remove this participant from the file",
            )
        )
    for cell, n in zip(cells, row, strict=True):
        if n > usual and len(problems) < MOST_LISTED:
            inside = frame.loc[own]
            mask = np.all([(inside[name] == value).to_numpy() for name, value in zip(names, cell, strict=True)], axis=0)
            rows = inside.index[mask]
            lines = ", ".join(str(table.lines[r]) for r in rows[:5])
            problems.append(
                table.problem(
                    int(rows[-1]),
                    "participant",
                    f"{n} answers of participant {participant} in {describe_cell(cell, scale)} (lines {lines})",
                    f"{usual}, as in the other cells",
                    "remove the doubled row; repetitions must be as many in every cell",
                )
            )
    return problems


def _who(row: pd.Series) -> str:
    cell, scale = cell_of(row.index), scale_of(row.index)
    return f"participant {row['participant']}, {describe_cell((row[name] for name in cell), scale)}"


def _most_common(counts: NDArray[np.int64]) -> int:
    values, times = np.unique(counts[counts > 0], return_counts=True)
    return int(values[np.argmax(times)])
