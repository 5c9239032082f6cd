"""Checks of a table's balance: duplicate rows, missing cells, and surplus answers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from modaltouch.analysis.columns import VELOCITY, scale_of
from modaltouch.analysis.csv_table import Table, list_faults
from modaltouch.analysis.responses import answers_per_cell, cell_of, describe_cell, keys_of
from modaltouch.protocol import Problem

# Share of missing answers at or above which a participant presumably had another design, or gave up [1].
_MOST_MISSING = 0.25

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
    """Refuse a table whose every row is duplicated; up to the planned repetitions, note it instead.

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
    times = math.gcd(*pd.util.hash_pandas_object(table.fields, index=False).value_counts().tolist())
    if times < 2 or frame.empty:
        return [], []
    cell = [*cell_of(frame.columns), *({"stimulus"} & {*frame.columns})]
    found = int(frame.groupby(["participant", *cell], observed=True)["n"].sum().max())
    if most is not None and found <= most:
        return [], [f"every row occurs {times} times, taken as repetitions, as planned: remove any copies"]
    given, allowed = f"every row {times} times", "each once, or repetitions with numbers under `repetition`"
    if most is not None:
        given += f", which gives {found} answers of a participant in a cell"
        allowed = f"{most}, as in the protocol"
    return [Problem(table.file, 1, 1, "", given, allowed, "remove the copies, or number the repetitions")], []


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
