"""Whether every participant answered every cell of the design equally often."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.csv_table import MOST_LISTED, Table
from modaltouch.analysis.responses import CELL
from modaltouch.document import Problem


def check_balance(table: Table, frame: pd.DataFrame) -> list[Problem]:
    """Return doubled rows, missing cells and unequal numbers of answers.

    The design is every finger condition with every zone pair at every level that occurs. Rows of the same
    participant and cell are repetitions where a column ``repetition`` tells them apart, or where all cells have
    the same number of them.

    Parameters
    ----------
    table : Table
        The file, for the places of the faults.
    frame : DataFrame
        Its sound rows, indexed by row of the file.

    Returns
    -------
    list of Problem
    """
    if not len(frame) or frame["n"].sum() == 0:
        return [Problem(table.file, 1, 1, "", "no answers", "at least one answer that is not practice", "")]
    problems = _doubled(table, frame)
    answers = answers_per_cell(frame)
    usual = _most_common(answers.to_numpy().ravel())
    listed = 0
    for participant, row in zip(answers.index, answers.to_numpy(), strict=True):
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


def answers_per_cell(frame: pd.DataFrame) -> pd.DataFrame:
    """Return how many answers each participant gave in each cell of the crossed design.

    Parameters
    ----------
    frame : DataFrame
        Tidy answers with a count ``n``.

    Returns
    -------
    DataFrame
        Participants by (finger_condition, zone_left, zone_right, velocity_mm_s).
    """
    sums = frame.groupby(["participant", *CELL], observed=True)["n"].sum()
    wide = sums.unstack(list(CELL), fill_value=0)
    pairs = frame[["zone_left", "zone_right"]].drop_duplicates().itertuples(index=False, name=None)
    conditions, levels = frame["finger_condition"].unique(), sorted(frame["velocity_mm_s"].unique())
    crossed = [(c, *pair, level) for pair in pairs for c in conditions for level in levels]
    return wide.reindex(columns=pd.MultiIndex.from_tuples(crossed, names=list(CELL)), fill_value=0)


def describe_cell(cell: Iterable[object]) -> str:
    """Return a cell in words, as in ``one_hand A-C 80 mm/s``."""
    condition, left, right, level = cell
    return f"{condition} {left}-{right} {float(str(level)):g} mm/s"


def _doubled(table: Table, frame: pd.DataFrame) -> list[Problem]:
    """Return rows that say the same thing twice: one repetition, or one count, given again."""
    keys = ["participant", *CELL]
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
    first = int(own[0])
    problems = []
    fewer = [describe_cell(cell) for cell, n in zip(cells, row, strict=True) if n < usual]
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
            mask = np.all([(inside[name] == value).to_numpy() for name, value in zip(CELL, cell, strict=True)], axis=0)
            rows = inside.index[mask]
            lines = ", ".join(str(table.lines[r]) for r in rows[:5])
            problems.append(
                table.problem(
                    int(rows[-1]),
                    "participant",
                    f"{n} answers of participant {participant} in {describe_cell(cell)} (lines {lines})",
                    f"{usual}, as in the other cells",
                    "remove the doubled row; repetitions must be as many in every cell",
                )
            )
    return problems


def _who(row: pd.Series) -> str:
    return f"participant {row['participant']}, {describe_cell(row[name] for name in CELL)}"


def _most_common(counts: NDArray[np.int64]) -> int:
    values, times = np.unique(counts[counts > 0], return_counts=True)
    return int(values[np.argmax(times)])
