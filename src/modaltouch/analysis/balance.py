"""Checks of a table of answers against its design: missing and surplus answers, copies, and cells not planned."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from modaltouch.analysis.columns import VELOCITY, label_zones, scale_of
from modaltouch.analysis.csv_table import Table, TableFormat, list_faults
from modaltouch.analysis.responses import answers_per_cell, cell_of, describe_cell, keys_of
from modaltouch.protocol import Problem

# Share of missing answers at or above which a participant presumably had another design, or gave up [1].
_MOST_MISSING = 0.25

# Share of distinct rows that occur equally often at or above which a table was presumably pasted together [1], and
# their number from which all but one will do: in that many, the counts of chance are rarely all even but for one.
_MOST_ROWS, _ALL_BUT_ONE = 0.95, 10

# Columns by which trials are usually numbered anew, and those that never tell when.
_RESTARTS = ("stimulus", "session_kind", "session", "block")
_NO_RESTART = {"lab", "trial", "response", "response_time", "n"}

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
    again = _copied(table, frame) or _doubled(table, frame)
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
    if rare := _rare(table, frame) if fewer else []:
        return [*again, *rare], usual
    more = [(answers.index[who], *cells[cell]) for who, cell in np.argwhere(counts > usual).tolist()]
    problems = [
        *again,
        *list_faults(table.file, fewer, "participants with missing answers", missing, f"{usual} in every cell"),
        *list_faults(table.file, more, "cells with surplus answers", surplus, f"{usual} in every cell"),
    ]
    return problems, usual


def _rare(table: Table, frame: pd.DataFrame) -> list[Problem]:
    """Report finger conditions, zones and levels that few participants have, such as a mistyped or a measured level."""
    level, problems, n = scale_of(frame.columns).column, list[Problem](), frame["participant"].nunique()
    levels = frame[level].map("{:.12g}".format)
    columns = {
        "finger_condition": frame["finger_condition"].astype("str"),
        "zone_left": label_zones(frame),
        level: levels,
    }
    for name, column in columns.items():
        n_met = column.map(frame["participant"].groupby(column).nunique())
        is_measured = name == level and 2 * column.nunique() > len(frame) and n > 1
        rare = column[(2 * n_met < n) | is_measured].drop_duplicates()
        if rare.empty or (len(rare) == column.nunique() and not is_measured):
            continue
        given = ", ".join(f"{value} (line {line})" for line, value in rare[:3].items())
        given += f" and {len(rare) - 3} more" * (len(rare) > 3)
        given += ", which fewer than half of the participants have" * (not is_measured)
        remedy = "correct them" + f"; put measured levels into a column not named {level}" * (name == level)
        problems.append(table.problem(int(rare.index[0]), name, given, "the same for all participants", remedy))
    return problems


def check_doubling(table: Table, frame: pd.DataFrame, most: int | None) -> tuple[list[Problem], list[str]]:
    """Refuse trials that occur again, and a table whose every row is duplicated, but for a few; note planned ones.

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
    again = _renumbered(table, frame)
    if again or frame.empty:
        return again, []
    counts = pd.util.hash_pandas_object(table.fields.loc[frame.index], index=False).value_counts().to_numpy()
    least = min(_MOST_ROWS, 1 - 1 / len(counts)) if len(counts) >= _ALL_BUT_ONE else _MOST_ROWS
    multiples = (times for times in range(int(counts.max()), 1, -1) if (counts % times == 0).mean() >= least)
    times = next(multiples, 1)
    every = "every row" if (counts % times == 0).all() else "nearly every row"
    if times < 2:
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


def _in_metres(table: Table, frame: pd.DataFrame, table_format: TableFormat) -> list[Problem]:
    """Report levels below 1 mm/s throughout, presumably given in m/s, unless the protocol has such levels."""
    highest = frame[VELOCITY.column].max() if VELOCITY.column in frame else math.inf
    planned = [level for *_, level, _ in table_format.planned]
    if not highest < 1 <= max(planned, default=1):
        return []
    remedy = "multiply them by 1000 if they are in m/s"
    remedy += "; if not, name their protocol with --protocol" * (not planned)
    given, allowed = f"levels of at most {highest:g}", "peak velocities in mm/s"
    return [table.problem(int(frame.index[0]), VELOCITY.column, given, allowed, remedy)]


def _doubled(table: Table, frame: pd.DataFrame) -> list[Problem]:
    """Report rows that repeat a repetition or a count."""
    counted = [name for name, column in (("repetition", "repetition"), ("response", "n")) if column in table.fields]
    keys = [*keys_of(frame.columns), *counted, *({"session"} & {*frame.columns})]
    return _repeated(table, frame, keys) if counted else []


def _renumbered(table: Table, frame: pd.DataFrame) -> list[Problem]:
    """Report trials that occur again, unless columns such as the zones or the day tell when their numbers restart."""
    if "trial" not in frame or (frame["n"] != 1).any():
        return []
    frame = frame.dropna(subset=["trial"])
    n_times = frame.groupby(["participant", "trial"], observed=True)["n"].transform("size")
    again = frame[n_times.groupby(frame["participant"], observed=True).transform("median") > 1]
    # A trial number occurs once for each value of the column by which trials are numbered anew. The lab of two people
    # of one name tells them apart, too, but makes them one participant.
    n_values = again.drop(columns=_NO_RESTART & {*again.columns}).groupby("participant", observed=True).nunique().max()
    marks = n_values.index[(n_values > 1) & ((n_values <= n_times.max()) | n_values.index.isin(_RESTARTS))]
    return _repeated(table, again, ["participant", *marks, "trial"])


def _repeated(table: Table, frame: pd.DataFrame, keys: list[str]) -> list[Problem]:
    """Report rows equal to an earlier one in some columns."""
    words = frame.dropna(subset=keys)[keys].astype("str")
    remedy = "remove copies, number repetitions or sessions, and give two people two names"

    def problem(line: int) -> Problem:
        row = words.loc[line]
        first = words.index[(words == row).all(axis=1)][0]
        named = ", ".join(f"{key} {word.removesuffix('.0')}" for key, word in row.items())
        given = f"{named} again (first on line {first})"
        return table.problem(line, keys[-1], given, f"one row for each {', '.join(keys)}", remedy)

    return list_faults(table.file, [*words.index[words.duplicated()]], "duplicate rows", problem)


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
    return problems


def check_planned(table: Table, frame: pd.DataFrame, table_format: TableFormat) -> list[Problem]:
    """Report levels in m/s, or finger conditions, zones (of swapped columns) and levels that the protocol lacks."""
    if problems := _in_metres(table, frame, table_format):
        return problems
    planned, scale = table_format.planned, scale_of(frame.columns)
    own = (table_format.design.get("conditions") or {}).get("sensation_levels") or {}
    levels = own.get("multiples") or [level for *_, level, _ in planned]
    known = {
        "finger_condition": [condition for _, condition, *_ in planned],
        "zone_left": ["-".join(zones) for _, _, zones, *_ in planned],
        scale.column: [f"{level:g}" for level in levels],
    }
    given = {
        "finger_condition": frame["finger_condition"].astype("str"),
        "zone_left": label_zones(frame).rename("zone_left"),
        scale.column: frame[scale.column].map("{:g}".format),
    }
    if table_format.is_pilot or (own and scale == VELOCITY):
        del given[scale.column]  # levels are each participant's own, or the pilot's
    remedy = "write them as the protocol does, or name the protocol of these answers"
    for name, column in given.items() if planned else ():
        allowed = ", ".join(dict.fromkeys(known[name]))
        problems += table.check_words(column, known[name].__contains__, allowed, lambda word: (repr(word), remedy))
    return problems
