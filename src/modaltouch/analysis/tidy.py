"""The tidy CSV: every word, number and cell checked, all faults of its fields at once."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from modaltouch.analysis.balance import check_balance
from modaltouch.analysis.csv_table import Table, list_faults, read_table
from modaltouch.analysis.responses import REQUIRED, AnswerSource, ExcludedSource, Responses, unmirror
from modaltouch.analysis.scale import OWN_THRESHOLD, VELOCITY
from modaltouch.protocol import AnswerList, InputError, Problem, suggest

NUMBERS = ("trial", "block", "response_time", "speed_left_mm_s", "speed_right_mm_s")
"""Further columns the analysis uses where they are there, named as in the record's own table."""

_TRUTH = {"0": False, "false": False, "no": False, "": False, "1": True, "true": True, "yes": True}
_EMPTY = ("", "n/a")


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
        With every fault of a field; where there is none, with every one of the balance.
    """
    table = read_table(path, REQUIRED)
    fields, columns = table.fields, _Columns(table)
    caught, practice = columns.flags("catch", "a catch trial"), columns.flags("practice", "a practice trial")
    frame = pd.DataFrame({name: columns.words(name) for name in REQUIRED[:4]})
    level = VELOCITY if set(fields.get(OWN_THRESHOLD.column, ())) <= set(_EMPTY) else OWN_THRESHOLD
    allowed = {
        VELOCITY: "a peak velocity in mm/s, above 0",
        OWN_THRESHOLD: "a multiple of the participant's own threshold, above 0",
    }
    frame[level.column] = columns.numbers(level.column, allowed[level], lambda value: value > 0, where=~caught)
    remedy = "write one of these words"
    if answers is None:
        answers = AnswerList.of_words(("none",) if "none" in fields["response"].cat.categories else ())
        remedy += ", or name the protocol that offers other answers with --protocol"
    frame["response"] = columns.answers(answers.ranked.names, remedy)
    frame["n"] = columns.whole_numbers("n", 0) if "n" in fields else 1
    if "repetition" in fields:
        frame["repetition"] = columns.whole_numbers("repetition", 1)
    for name in fields.columns.difference([*frame.columns, "catch", VELOCITY.column, OWN_THRESHOLD.column], sort=False):
        is_number = name in NUMBERS
        frame[name] = (
            columns.numbers(name, "a number, or nothing", empty=True) if is_number else fields[name].astype("str")
        )
    columns.check_zones()
    caught &= ~practice
    if not columns.problems:
        answered = frame[~practice & ~caught]
        columns.problems += check_balance(table, unmirror(answered, answers))
    if columns.problems:
        raise InputError(columns.problems)
    apart = ((practice, "practice trials"), (caught, "catch trials, counted apart"))
    return Responses(
        unmirror(answered, answers),
        (),
        tuple(ExcludedSource(f"{table.file}: {rows.sum()} rows", why) for rows, why in apart if rows.any()),
        AnswerSource(table.file, "csv", table.sha256),
        catches=_count_catches(frame[caught]),
        answers=answers,
    )


def _count_catches(frame: pd.DataFrame) -> dict[str, Counter[str]]:
    """Return the answers to catch trials by participant."""
    catches: dict[str, Counter[str]] = {}
    for participant, word, n in zip(frame["participant"], frame["response"], frame["n"], strict=True):
        catches.setdefault(str(participant), Counter())[str(word)] += int(n)
    return catches


class _Columns:
    """The columns of a table as values, and the faults of their fields."""

    def __init__(self, table: Table) -> None:
        self._table = table
        self.problems: list[Problem] = []

    def words(self, name: str) -> pd.Series:
        """Return a column of words, none of them empty."""
        column = self._table.fields[name]
        self.problems += self._table.check_words(column, bool, "a word", lambda word: ("nothing", "fill it in"))
        return column

    def answers(self, words: tuple[str, ...], remedy: str) -> pd.Series:
        """Return the responses, each one of the answers."""

        def say(word: str) -> tuple[str, str]:
            meant = suggest(word, words)
            return repr(word) if word else "nothing", f"write {meant}" if meant else remedy

        column = self._table.fields["response"]
        self.problems += self._table.check_words(column, words.__contains__, ", ".join(words), say)
        return column.cat.set_categories(list(words))

    def flags(self, name: str, what: str) -> pd.Series:
        """Return which rows a column of 0 and 1 marks, none where there is no such column."""
        fields = self._table.fields
        if name not in fields:
            return pd.Series(False, index=fields.index)
        self.problems += self._table.check_words(
            fields[name], lambda word: word.casefold() in _TRUTH, "0 or 1", lambda w: (repr(w), f"write 1 for {what}")
        )
        return self._values(name, lambda word: _TRUTH.get(word.casefold(), False)).astype(bool)

    def numbers(
        self,
        name: str,
        allowed: str,
        is_sound: Callable[[float], bool] = lambda value: True,
        *,
        empty: bool = False,
        where: pd.Series | None = None,
    ) -> pd.Series:
        """Return a column of finite numbers; `empty` allows nothing, `where` are the rows that are checked."""
        table = self._table

        def say(word: str) -> tuple[str, str]:
            if "," in word and math.isnan(_number(word, table.separator)):
                return repr(word), "write a decimal point"
            return "nothing" if word in _EMPTY else repr(word), "write a plain number such as 80 or 92.5"

        def is_fit(word: str) -> bool:
            value = _number(word, table.separator)
            return (empty and word in _EMPTY) or (math.isfinite(value) and is_sound(value))

        column = table.fields[name] if where is None else table.fields.loc[where, name]
        self.problems += table.check_words(column, is_fit, allowed, say)
        return self._values(name, lambda word: _number(word, table.separator))

    def whole_numbers(self, name: str, least: int) -> pd.Series:
        """Return a column of whole numbers."""
        allowed = f"a whole number, {least} or above"
        values = self.numbers(name, allowed, lambda value: value == int(value) and least <= value < 1e9)
        return values.fillna(-1.0).astype(np.int64, errors="ignore")

    def check_zones(self) -> None:
        """Refuse the same zone under both fingers."""
        zones = self._table.fields[["zone_left", "zone_right"]].astype("str")
        allowed, remedy = "two different zones", "correct zone_left or zone_right"

        def problem(fault: tuple[Any, str]) -> Problem:
            line, zone = fault
            given = f"zone {zone!r} under both fingers"
            return self._table.problem(line, "zone_right", given, allowed, remedy)

        same = zones.loc[zones["zone_left"] == zones["zone_right"], "zone_right"]
        self.problems += list_faults(
            self._table.file, list(same.items()), "rows with a zone under both fingers", problem
        )

    def _values(self, name: str, read: Callable[[str], float]) -> pd.Series:
        """Return what each word of a column means."""
        column = self._table.fields[name]
        meanings = np.array([read(str(word)) for word in column.cat.categories], dtype=float)
        return pd.Series(meanings[column.cat.codes], index=column.index)


def _number(word: str, separator: str) -> float:
    # A decimal comma is beyond doubt only where commas do not separate fields and no point stands beside it.
    if separator != "," and word.count(",") == 1 and "." not in word:
        word = word.replace(",", ".")
    try:
        return math.nan if "_" in word else float(word)
    except ValueError:
        return math.nan
