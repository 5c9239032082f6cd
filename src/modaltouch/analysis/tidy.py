"""The tidy CSV: every word, number and cell checked, all faults at once."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.balance import check_balance
from modaltouch.analysis.csv_table import MOST_LISTED, Column, Table, read_table
from modaltouch.analysis.responses import REQUIRED, AnswerSource, ExcludedSource, Responses, unmirror
from modaltouch.analysis.scale import OWN_THRESHOLD, VELOCITY, scale_of
from modaltouch.protocol import AnswerList, InputError, Problem, suggest

FINGER_CONDITIONS = ("one_hand", "two_hands")

NUMBERS = ("trial", "block", "response_time", "speed_left_mm_s", "speed_right_mm_s")
"""Further columns the analysis uses where they are there, named as in the record's own table."""

_TRUTH = {"0": False, "false": False, "no": False, "": False, "1": True, "true": True, "yes": True}


def read_csv(path: Path, answers: AnswerList | None = None) -> Responses:
    """Return the answers in a tidy CSV file.

    Parameters
    ----------
    path : Path
        A table with the six columns, and optionally ``n`` (count of equal answers), ``repetition``, ``practice``,
        ``catch`` (1 where nothing was driven, whatever the velocity) and any others, which are kept. Where any
        response is ``none``, that is taken to have been an answer, unless `answers` tells. Where
        ``multiple_of_threshold`` is filled in, as in the record's own table, that is the level in place of the
        velocity.
    answers : AnswerList, optional
        What could be answered.

    Raises
    ------
    InputError
        With every fault found.
    """
    table = read_table(path, REQUIRED)
    problems: list[Problem] = []
    frame = pd.DataFrame(index=pd.RangeIndex(table.n_rows))
    for name in REQUIRED[:4]:
        frame[name] = _words(table, name, problems)
    caught, caught_problems = _flags(table, "catch", "a catch trial")
    problems += caught_problems
    velocities = _velocities(table, problems, caught)
    multiples = _multiples(table, problems, caught)
    level = VELOCITY.column if multiples is None else OWN_THRESHOLD.column
    frame[level] = velocities if multiples is None else multiples
    remedy = "write one of these words"
    if answers is None:
        answers = AnswerList.of_words(("none",) if "none" in table.columns["response"].words else ())
        remedy += ", or name the protocol that offers other answers with --protocol"
    frame["response"] = _answers(table, problems, answers.ranked.names, remedy)
    frame["n"] = _whole_numbers(table, "n", problems, 0) if "n" in table.columns else 1
    if "repetition" in table.columns:
        frame["repetition"] = _whole_numbers(table, "repetition", problems, 1)
    for name, column in table.columns.items():
        if name in NUMBERS:
            frame[name] = _numbers(table, name, problems, "a number, or nothing", _anything, empty=True)
        elif name not in frame.columns and name not in ("catch", VELOCITY.column, OWN_THRESHOLD.column):
            frame[name] = _categorical(column.codes, column.words).astype("str")
    problems += _same_zone(table, frame) + _near_conditions(table)
    unread = _unread(table, frame) if problems else None
    n_problems = len(problems)
    practised, practice_problems = _flags(table, "practice", "a practice trial")
    problems += practice_problems
    catches = _count_catches(frame[caught & ~practised])
    practice, caught = practised, caught & ~practised
    frame = unmirror(frame[~practice & ~caught], answers)
    if len(problems) == n_problems:
        problems += check_balance(table, frame, None if unread is None else unread.loc[frame.index])
    if problems:
        raise InputError(problems)
    apart = ((practice, "practice trials"), (caught, "catch trials, counted apart"))
    left_out = tuple(ExcludedSource(f"{table.file}: {rows.sum()} rows", why) for rows, why in apart if rows.any())
    return Responses(
        frame, (), left_out, AnswerSource(table.file, "csv", table.sha256), catches=catches, answers=answers
    )


def _count_catches(frame: pd.DataFrame) -> dict[str, Counter[str]]:
    """Return the answers to catch trials by participant."""
    catches: dict[str, Counter[str]] = {}
    for participant, word, n in zip(frame["participant"], frame["response"], frame["n"], strict=True):
        catches.setdefault(str(participant), Counter())[str(word)] += int(n)
    return catches


def _velocities(table: Table, problems: list[Problem], caught: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the velocities, 0 allowed in catch trials alone."""
    allowed = "a peak velocity in mm/s, above 0"
    if not caught.any():
        return _numbers(table, "velocity_mm_s", problems, allowed, _positive)
    values = _numbers(table, "velocity_mm_s", problems, allowed, _not_negative)
    still = np.flatnonzero((values == 0) & ~caught)
    for row in still[:MOST_LISTED]:
        problems.append(
            table.problem(int(row), "velocity_mm_s", "'0'", allowed, "write 1 under catch, or the velocity")
        )
    return np.where((values == 0) & ~caught, math.nan, values)


def _multiples(table: Table, problems: list[Problem], caught: NDArray[np.bool_]) -> NDArray[np.float64] | None:
    """Return the multiples of each participant's own threshold, whatever stands in catch trials; None without any."""
    name = OWN_THRESHOLD.column
    column = table.columns.get(name)
    if column is None or all(word in ("", "n/a") for word in column.words):
        return None
    allowed = "a multiple of the participant's own threshold, above 0"
    values = _numbers(table, name, problems, allowed, _positive, empty=True)
    absent = np.array([word in ("", "n/a") for word in column.words], dtype=bool)[column.codes]
    bare = np.flatnonzero(absent & ~caught)
    for row in bare[:MOST_LISTED]:
        given, remedy = "nothing where other rows have a multiple", "fill it in, or analyse these rows by themselves"
        problems.append(table.problem(int(row), name, given, allowed, remedy))
    return values


def _unread(table: Table, frame: pd.DataFrame) -> pd.DataFrame:
    """Return which words of each row are faulty: participant, cell, and ``other`` for the rest of the row."""
    words = {name: frame[name].astype(str) for name in REQUIRED[:4]}
    level = scale_of(frame.columns).column
    # A turned beam exchanges the zones, so a fault in one leaves both unsure.
    zones = (words["zone_left"] == "") | (words["zone_right"] == "") | (words["zone_left"] == words["zone_right"])
    slips = [word for word in table.columns["finger_condition"].words if _is_near(word)]
    other = frame["response"].isna() | (frame["n"] < 0)
    if "repetition" in table.columns:
        other |= frame["repetition"] < 0
    return pd.DataFrame(
        {
            "participant": words["participant"] == "",
            "finger_condition": words["finger_condition"].isin(["", *slips]),
            "zone_left": zones,
            "zone_right": zones,
            level: frame[level].isna(),
            "other": other,
        }
    )


def _report(
    table: Table, column: Column, faulty: list[int], allowed: str, say: Callable[[str], tuple[str, str]]
) -> list[Problem]:
    """Return one problem for each faulty word, at its first row."""
    first, counts = column.first_rows(), column.counts()
    problems = []
    for code in faulty[:MOST_LISTED]:
        given, remedy = say(column.words[code])
        if counts[code] > 1:
            given += f" (in {counts[code]} rows)"
        problems.append(table.problem(int(first[code]), column.name, given, allowed, remedy))
    if len(faulty) > MOST_LISTED:
        rest = f"{len(faulty) - MOST_LISTED} more words of this kind"
        problems.append(table.problem(int(first[faulty[MOST_LISTED]]), column.name, rest, allowed))
    return problems


def _words(table: Table, name: str, problems: list[Problem]) -> pd.Categorical:
    column = table.columns[name]
    empty = [code for code, word in enumerate(column.words) if not word]
    problems += _report(table, column, empty, "a word", lambda word: ("nothing", "fill it in"))
    return _categorical(column.codes, column.words)


def _categorical(codes: NDArray[np.int64], words: Sequence[str]) -> pd.Categorical:
    values: pd.Categorical = pd.Categorical.from_codes(codes.astype(np.intp), pd.Index(list(words), dtype="str"))
    return values


def _answers(table: Table, problems: list[Problem], words: tuple[str, ...], remedy: str) -> pd.Categorical:
    column = table.columns["response"]
    unknown = [code for code, word in enumerate(column.words) if word not in words]

    def say(word: str) -> tuple[str, str]:
        meant = suggest(word, words)
        return repr(word) if word else "nothing", f"write {meant}" if meant else remedy

    problems += _report(table, column, unknown, ", ".join(words), say)
    codes = np.array([words.index(word) if word in words else -1 for word in column.words], dtype=np.int64)
    return _categorical(codes[column.codes], words)


def _positive(value: float) -> bool:
    return math.isfinite(value) and value > 0


def _not_negative(value: float) -> bool:
    return math.isfinite(value) and value >= 0


def _anything(value: float) -> bool:
    return math.isfinite(value)


def _numbers(
    table: Table,
    name: str,
    problems: list[Problem],
    allowed: str,
    sound: Callable[[float], bool],
    *,
    empty: bool = False,
) -> NDArray[np.float64]:
    column = table.columns[name]
    values = np.array([_number(word, table.separator, empty=empty) for word in column.words])
    absent = np.array([empty and word in ("", "n/a") for word in column.words], dtype=bool)
    faulty = [code for code in range(len(values)) if not absent[code] and not sound(float(values[code]))]

    def say(word: str) -> tuple[str, str]:
        if "," in word and math.isnan(_number(word, table.separator)):
            return repr(word), "write a decimal point"
        return repr(word) if word else "nothing", "write a plain number such as 80 or 92.5"

    problems += _report(table, column, faulty, allowed, say)
    values[faulty] = math.nan
    return np.asarray(values[column.codes], dtype=float)


def _number(word: str, separator: str, *, empty: bool = False) -> float:
    # A decimal comma is beyond doubt only where commas do not separate fields and no point stands beside it.
    if separator != "," and word.count(",") == 1 and "." not in word:
        word = word.replace(",", ".")
    if "_" in word:
        return math.nan
    try:
        return float(word)
    except ValueError:
        return math.nan


def _whole_numbers(table: Table, name: str, problems: list[Problem], least: int) -> NDArray[np.int64]:
    values = _numbers(
        table,
        name,
        problems,
        f"a whole number, {least} or above",
        lambda value: math.isfinite(value) and value == int(value) and least <= value < 1e9,
    )
    return np.nan_to_num(values, nan=-1.0).astype(np.int64)


def _same_zone(table: Table, frame: pd.DataFrame) -> list[Problem]:
    same = np.flatnonzero((frame["zone_left"].astype(str) == frame["zone_right"].astype(str)).to_numpy())
    return [
        table.problem(
            int(row),
            "zone_right",
            f"zone {frame['zone_right'].iloc[row]!r} under both fingers",
            "two different zones",
            "correct zone_left or zone_right",
        )
        for row in same[:MOST_LISTED]
    ]


def _near_conditions(table: Table) -> list[Problem]:
    """Return the finger conditions that are probably a slip of the pen."""
    column = table.columns["finger_condition"]
    slips = [code for code, word in enumerate(column.words) if _is_near(word)]
    allowed = f"{', '.join(FINGER_CONDITIONS)}, or any other name"
    return _report(table, column, slips, allowed, lambda w: (repr(w), f"write {suggest(w, FINGER_CONDITIONS)}"))


def _is_near(word: str) -> bool:
    known = {_folded(each) for each in FINGER_CONDITIONS}
    return bool(word) and word not in FINGER_CONDITIONS and _folded(word) in known


def _folded(word: str) -> str:
    return "".join(character for character in word.casefold() if character.isalnum()).rstrip("s")


def _flags(table: Table, name: str, what: str) -> tuple[NDArray[np.bool_], list[Problem]]:
    """Return which rows a column of 0 and 1 marks, none where there is no such column, and its faults."""
    if name not in table.columns:
        return np.zeros(table.n_rows, dtype=bool), []
    column = table.columns[name]
    unknown = [code for code, word in enumerate(column.words) if word.casefold() not in _TRUTH]
    problems = _report(table, column, unknown, "0 or 1", lambda w: (repr(w), f"write 1 for {what}"))
    known: list[Any] = [_TRUTH.get(word.casefold(), False) for word in column.words]
    return np.array(known, dtype=bool)[column.codes], problems
