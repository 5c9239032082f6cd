"""Reading and validation of tidy CSV files; all problems in the fields are reported together."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from modaltouch.analysis.balance import check_balance, check_doubling, check_planned
from modaltouch.analysis.columns import OWN_THRESHOLD, VELOCITY, zones_of
from modaltouch.analysis.csv_table import Table, TableFormat, read_table
from modaltouch.analysis.responses import (
    CHOOSE_STIMULUS,
    MODES,
    REQUIRED,
    AnswerSource,
    ExcludedSource,
    Responses,
    answers_per_cell,
    are_crossed,
    kinds_of,
    missing_answer_notes,
    names_in,
    sum_catches,
    unmirror,
)
from modaltouch.protocol import TIME_OUT, AnswerList, InputError, Problem, ScaleSection, suggest

_SPEEDS = ("speed_left_mm_s", "speed_between_mm_s", "speed_right_mm_s")
NUMBERS = ("trial", "block", "response_time", *_SPEEDS)
"""Optional columns used by the analysis, named as in the table of recorded answers."""

_LEAST_LEVEL, _MOST = 0.001, 100_000
"""Lowest level (the resolution of trend tests), and highest level and count of identical answers."""

_LONGEST, _LONG = 86_400.0, 60.0
"""Maximum reaction time, and maximum median [s]; longer times are presumably in milliseconds."""

_MILLISECONDS = 100.0
"""Ratio to the others' median above which one participant's times are presumably in milliseconds [1]."""

_CAUGHT = "catch trials, counted apart"
_CATCH_COLUMNS = ["participant", "finger_condition", "session_kind", "response", "n"]
_LEFT_OUT = ("excluded", "exclude", "withdrawn", "invalid")
"""Columns of 0 and 1 that mark excluded rows."""

_TRUTH = {"0": False, "false": False, "no": False, "": False, "1": True, "true": True, "yes": True}
_EMPTY = ("", "n/a")


def read_csv(
    path: Path, table_format: TableFormat | None = None, mode: str | None = None, stimulus: str | None = None
) -> Responses:
    """Read the answers in a tidy CSV file.

    Parameters
    ----------
    path : Path
        A table with the six columns, and optionally ``n`` (identical answers), ``repetition``, ``practice``, ``catch``
        (1 for trials without a stimulus, whatever the velocity), ``excluded`` (or ``exclude``, ``withdrawn``,
        ``invalid``), ``mode``, ``stimulus``, ``session``, ``session_kind`` and others, which are kept. If ``none``
        occurs as a response, it is an answer, unless `table_format` specifies the answers. A filled column
        ``multiple_of_threshold`` holds the levels. Sessions of a kind count as repetitions, up to the number that all
        participants have. If the answers are ratings, ``response`` is optional.
    table_format : TableFormat, optional
        Format of the file.
    mode, stimulus : str, optional
        Which rows to use. The mode is required if there are several; by default, all stimuli are used.

    Raises
    ------
    InputError
        With all problems in the fields or, if there are none, all problems of balance.
    """
    table_format = table_format or TableFormat()
    table = choose_rows(_with_responses(path, table_format), "mode", mode)
    table, left_out, notes = choose_sessions(table if stimulus is None else choose_rows(table, "stimulus", stimulus))
    fields, columns = table.fields, _Columns(table)
    apart = columns.apart(kinds_of(table_format.design))
    caught, counts = apart[_CAUGHT], ~pd.DataFrame(apart).any(axis=1)
    frame, answers = _frame_of(columns, fields, counts, table_format)
    columns.check_words(counts, table_format.design)
    if not columns.problems:
        asked = unmirror(frame[counts], answers)
        columns.problems += check_planned(table, asked, table_format)
    if not columns.problems:
        is_whole, parts = are_crossed(table_format.design), _parts(asked, table_format.design)
        checked = [check_balance(table, part, is_crossed=is_whole) for part in parts]
        doubled, noted = check_doubling(table, asked, table_format.most)
        columns.problems += [problem for problems, _ in checked for problem in problems] or doubled
    if columns.problems:
        raise InputError(columns.problems)
    left_out += [ExcludedSource(f"{table.file}: {rows.sum()} rows", why) for why, rows in apart.items() if rows.any()]
    is_crossed = is_whole and len(parts) < 2
    kept = asked if is_crossed else _joined_parts(parts, [usual for _, usual in checked], table_format.design)
    kept, foci = _in_order(kept, table_format.design), _foci(kept, table_format.design)
    given, silent = kept[kept["response"].notna()], frame[caught & frame["response"].notna()]
    return Responses(
        given,
        (),
        tuple(left_out),
        AnswerSource(table.file, "csv", table.sha256, next(iter({*fields.get("mode", ())} - {*_EMPTY}), "")),
        foci[0],
        catches=sum_catches(silent.reindex(columns=_CATCH_COLUMNS, fill_value="").itertuples(index=False, name=None)),
        answers=answers,
        asked=checked[-1][1] or None,
        notes=(*notes, *noted, *(missing_answer_notes(kept, given) if is_crossed else ())),
        scheduled=None if is_crossed else kept,
        design=table_format.design,
    )


def _with_responses(path: Path, table_format: TableFormat) -> Table:
    """Read a table, adding a column of responses if it has only ratings."""
    is_rated = "value" in table_format.asked
    table = read_table(path, (*REQUIRED[: -1 if is_rated else None], *table_format.asked))
    if not is_rated or set(table.fields.get("response", ())) - set(_EMPTY):
        return table
    (rated,) = AnswerList.of(table_format.design["answers"]).names
    return replace(table, fields=table.fields.assign(response=pd.Categorical([rated] * len(table.fields))))


def _with_missing(part: pd.DataFrame, usual: int) -> pd.DataFrame:
    """Expand a crossed part to one row per answer, adding rows without a response for missing answers."""
    lacks = (usual - answers_per_cell(part)).melt(ignore_index=False, value_name="n").reset_index()
    missing = lacks.loc[lacks.index.repeat(lacks["n"].clip(lower=0))]
    rows = pd.concat([part.loc[part.index.repeat(part["n"])], missing])
    rows["response"] = pd.Categorical(rows["response"], part["response"].cat.categories)
    return rows.assign(n=1, **{name: part[name].iloc[0] for name in ("stimulus", "session_kind") if name in part})


def _in_order(frame: pd.DataFrame, design: Mapping[str, Any]) -> pd.DataFrame:
    """Order stimuli, groups and kinds of session as in the protocol, followed by any others."""
    for column, names in names_in(design).items():
        if column in frame:
            named = [name for name in names if (frame[column] == name).any()]
            order = [*named, *sorted({*frame[column]} - {*named})]
            frame = frame.assign(**{column: pd.Categorical(frame[column], order)})
    return frame


def _joined_parts(parts: Sequence[pd.DataFrame], usual: Sequence[int], design: Mapping[str, Any]) -> pd.DataFrame:
    """Join all parts into one table, with the columns of recorded answers for group, kind of session and focus."""
    frame = pd.concat(map(_with_missing, parts, usual))
    lacking = {name: "" for name in ("group", "session_kind") if name not in frame}
    frame = frame.assign(focus=_foci(frame, design), **lacking)
    return frame.assign(group=frame.groupby("participant")["group"].transform("first")).reset_index(drop=True)


def _parts(asked: pd.DataFrame, design: Mapping[str, Any]) -> list[pd.DataFrame]:
    """Split the answers by stimulus, kind of session and group of the protocol."""
    by = ["stimulus", *["group"] * ("group" in asked and bool(design.get("groups")))]
    by += ["session_kind"] * ("session_kind" in asked)
    named = asked if "stimulus" in asked else asked.assign(stimulus="")
    return [part for _, part in named.groupby(by, sort=False)] or [named]


def _foci(frame: pd.DataFrame, design: Mapping[str, Any]) -> list[str]:
    """Return the focus of each answer's stimulus; empty if not given by a protocol."""
    focal, own = (design.get("stimulus") or {}).get("focus", ""), design.get("stimuli") or {}
    return [str(own.get(name, {}).get("focus") or focal) for name in frame.get("stimulus", [""] * len(frame))]


def _frame_of(
    columns: _Columns, fields: pd.DataFrame, counts: pd.Series, table_format: TableFormat
) -> tuple[pd.DataFrame, AnswerList]:
    answers = table_format.answers
    # An empty column of zones belongs to an unused finger.
    absent = [name for name in zones_of(fields.columns)[1:] if set(fields[name]) <= set(_EMPTY)]
    names = [name for name in (*REQUIRED[:2], *zones_of(fields.columns)) if name not in absent]
    frame = pd.DataFrame({name: columns.words(name) for name in names})
    fields = fields.drop(columns=absent)
    frame["zone_right"] = frame.get("zone_right", "")
    level = VELOCITY if set(fields.get(OWN_THRESHOLD.column, ())) <= set(_EMPTY) else OWN_THRESHOLD
    levels = {
        VELOCITY: f"a peak velocity in mm/s, {_LEAST_LEVEL:g} to {_MOST}",
        OWN_THRESHOLD: f"a multiple of the participant's own threshold, {_LEAST_LEVEL:g} to {_MOST}",
    }
    frame[level.column] = columns.numbers(
        level.column, levels[level], lambda value: _LEAST_LEVEL <= value <= _MOST, where=counts
    )
    meant = {table_format.words.get(word, word) for word in fields["response"].cat.categories}
    remedy = "map it as in --answers L=left,R=right, or, if it stands for no answer, name it with --missing"
    if meant - {"both", "none"} <= {*frame.filter(like="zone_").to_numpy().ravel()}:
        remedy = "where it is a zone, write `left` or `right` for the finger on it"
    if answers is None:
        answers = AnswerList.of_words(("none",) if "none" in meant else ())
        remedy += "; or name the protocol that offers other answers with --protocol"
    frame["response"] = columns.answers("response", answers.ranked.names, remedy, table_format)
    frame["n"] = columns.whole_numbers("n", 0, _MOST) if "n" in fields else 1
    if "repetition" in fields:
        frame["repetition"] = columns.whole_numbers("repetition", 1)
    section = table_format.design.get("answers") or {}
    asked = {"value": {"scale": section.get("scale")}, **(section.get("then") or {})}
    for name in fields.columns.difference([*frame.columns, "catch", VELOCITY.column, OWN_THRESHOLD.column], sort=False):
        if given := asked.get(name, {}).get("scale"):
            scale, words = ScaleSection.model_validate(given), table_format.missing
            frame[name] = columns.numbers(name, f"{scale.allowed}, or nothing", scale.takes, empty=True, missing=words)
        elif listed := asked.get(name, {}).get("keys"):
            frame[name] = columns.answers(name, tuple(listed), "leave it empty, or see --missing", table_format)
        elif name == "response_time":
            frame[name] = columns.times(name, counts)
        elif name in NUMBERS:
            frame[name] = columns.numbers(name, "a number, or nothing", empty=True)
        else:
            frame[name] = fields[name].astype("str")
    if "value" in table_format.asked:
        frame["response"] = frame["response"].where(frame["value"].notna())  # without a rating, the answer is missing
    if "interval" in table_format.asked:
        frame["interval"] = columns.whole_numbers("interval", 1, table_format.design["intervals"]["number"])
    return frame, answers


def choose_rows(table: Table, name: str, chosen: str | None) -> Table:
    """Select the rows with a value in a column, if given.

    Raises
    ------
    InputError
        If the column has several values and none is given, lacks the given value, or contains unknown modes.
    """
    words = set(table.fields[name]) - set(_EMPTY) if name in table.fields else set()
    listed = ", ".join(sorted(map(str, words))) or f"a table with a column {name}"
    if chosen is None and len(words) > 1:
        given, remedy = f"rows of several words under {name} ({listed})", f"choose one with --{name}"
        raise InputError.of(Path(table.file), given, f"rows of one {name}", remedy)
    if chosen is not None and chosen not in words:
        remedy = CHOOSE_STIMULUS if name == "stimulus" else f"choose one of them, or leave out --{name}"
        raise InputError.of(Path(table.file), f"{name} {chosen!r} with a CSV file", listed, remedy)
    if name == "mode" and words and not words <= set(MODES):
        given, remedy = f"a column mode with {listed}", "correct it, or rename the column if it means something else"
        raise InputError.of(Path(table.file), given, ", ".join(MODES), remedy)
    return table if chosen is None else replace(table, fields=table.fields[table.fields[name] == chosen])


def choose_sessions(table: Table) -> tuple[Table, list[ExcludedSource], list[str]]:
    """Select equally many sessions of each participant; return them with excluded sources and notes."""
    if "session" not in table.fields:
        return table, [], []
    who, session = (table.fields[name].astype("str") for name in ("participant", "session"))
    kind = table.fields.get("session_kind", who.map(lambda _: "")).astype("str")
    place = session.groupby([who, kind], sort=False).transform(lambda own: pd.factorize(own)[0])
    fewest = place.groupby([who, kind]).max().groupby(level=1).min() + 1
    beyond, most = place >= kind.map(fewest), int(fewest.max())
    why = f"sessions after number {most}: not every participant has more"
    left_out = [ExcludedSource(f"{table.file}: {beyond.sum()} rows", why)] * bool(beyond.any())
    notes = [f"{most} sessions of each participant taken together, as repetitions"] if most > 1 else []
    return replace(table, fields=table.fields[~beyond]), left_out, notes


class _Columns:
    """Parser of the columns of a table, which collects problems in their fields."""

    def __init__(self, table: Table) -> None:
        self._table = table
        self.problems: list[Problem] = []

    def words(self, name: str) -> pd.Series:
        """Return a column of non-empty words."""
        column = self._table.fields[name]
        self.problems += self._table.check_words(column, bool, "a word", lambda word: ("nothing", "fill it in"))
        return column

    def answers(self, name: str, words: tuple[str, ...], remedy: str, table_format: TableFormat) -> pd.Series:
        """Return a column of words as a categorical of the answers to its question, with missing values."""
        missing = {*_EMPTY, TIME_OUT, *table_format.missing}

        def say(word: str) -> tuple[str, str]:
            meant = suggest(word, words)
            return repr(word), f"write {meant}, or {remedy}" if meant else remedy

        def is_sound(word: str) -> bool:
            return table_format.words.get(word, word) in words or word in missing

        column = self._table.fields[name]
        self.problems += self._table.check_words(column, is_sound, ", ".join(words), say)
        found = column.astype("str").map(lambda word: table_format.words.get(word, word))
        return pd.Series(pd.Categorical(found.where(found.isin(words)), list(words)), column.index)

    def apart(self, kinds: Mapping[str, bool]) -> dict[str, pd.Series]:
        """Return masks of the rows to exclude, each under one reason; `kinds` flags the analysed kinds of session."""
        reasons = {name: (f"rows marked {name}", "a row that does not count") for name in _LEFT_OUT}
        reasons |= {"practice": ("practice trials", "a practice trial"), "catch": (_CAUGHT, "a catch trial")}
        apart, free = {}, pd.Series(True, index=self._table.fields.index)
        for name, (reason, what) in reasons.items():
            apart[reason] = self.flags(name, what) & free
            free &= ~apart[reason]
        if "session_kind" in self._table.fields:
            training = self._table.fields["session_kind"].isin([name for name, counts in kinds.items() if not counts])
            apart["of a kind of session that is not analysed (schedule.sessions)"] = training & free
        return apart

    def flags(self, name: str, what: str) -> pd.Series:
        """Return the mask of rows marked in a column of 0 and 1; none without the column."""
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
        missing: Sequence[str] = (),
        where: pd.Series | None = None,
    ) -> pd.Series:
        """Return finite numbers; check the rows `where`, and allow empty fields if `empty`, and words in `missing`."""
        table = self._table

        def say(word: str) -> tuple[str, str]:
            if "," in word and math.isnan(_number(word, table.separator)):
                return repr(word), "write a decimal point"
            if name == VELOCITY.column and _number(word, table.separator) == 0:
                return repr(word), "mark catch trials by a 1 in a column `catch`"
            return "nothing" if word in _EMPTY else repr(word), "write a plain number such as 80 or 92.5"

        def is_fit(word: str) -> bool:
            value = _number(word, table.separator)
            return (empty and word in (*_EMPTY, TIME_OUT, *missing)) or (math.isfinite(value) and is_sound(value))

        column = table.fields[name] if where is None else table.fields.loc[where, name]
        self.problems += table.check_words(column, is_fit, allowed, say)
        return self._values(name, lambda word: math.nan if word in missing else _number(word, table.separator))

    def times(self, name: str, where: pd.Series) -> pd.Series:
        """Return a column of times in seconds; check the median of all rows `where`, and of each participant."""
        values = self.numbers(
            name, f"0 to {_LONGEST:g} s, or nothing", lambda value: 0 <= value <= _LONGEST, empty=True
        )
        people, own = self._table.fields["participant"], values[where]
        middle = own.groupby(people, observed=True).transform("median")
        others = own[middle <= _LONG].median()
        least = _LONG if own.median() > _LONG else max(_LONG, _MILLISECONDS * others)
        if slow := list(own.index[(middle > least) & (own > _LONG)][:1]):
            given = f"a median time of {middle[slow[0]]:g} s from participant {people[slow[0]]}"
            allowed, remedy = f"seconds, with a median of at most {_LONG:g}", "divide times in milliseconds by 1000"
            self.problems.append(self._table.problem(slow[0], name, given, allowed, remedy))
        return values

    def check_words(self, where: pd.Series, design: Mapping[str, Any]) -> None:
        """Check for words that differ only in case, equal zones, and names unknown to the protocol."""
        for name in (*REQUIRED[:2], *zones_of(self._table.fields.columns)):
            self.check_spelling(name)
        self.check_zones()
        self.check_stimuli(where)
        self.check_names(where, design)

    def check_spelling(self, name: str) -> None:
        """Refuse words of a column that differ only in case, presumably by mistake."""
        column = self._table.fields[name]
        words = map(str, reversed([*column.unique()]))
        usual = {word.casefold(): word for word in words}  # the first spelling in the file

        def say(word: str) -> tuple[str, str]:
            return (
                f"{word!r} beside {usual[word.casefold()]!r}",
                "write it one way, or give different things clearly different names",
            )

        is_usual = {*usual.values()}.__contains__
        self.problems += self._table.check_words(column, is_usual, "one spelling for each name", say)

    def whole_numbers(self, name: str, least: int, most: int | None = None) -> pd.Series:
        """Return a column of integers."""
        allowed = f"a whole number, {least} or above" if most is None else f"a whole number, {least} to {most}"
        highest = 999_999_999 if most is None else most
        values = self.numbers(name, allowed, lambda value: value == int(value) and least <= value <= highest)
        return values.fillna(-1.0).astype(np.int64, errors="ignore")

    def check_zones(self) -> None:
        """Refuse the same zone under both fingers."""
        left, right = (self._table.fields[name].astype("str") for name in ("zone_left", "zone_right"))
        self.problems += self._table.check_words(
            right[(left == right) & (left != "")], lambda word: False, "two different zones",
            lambda word: (f"zone {word!r} under both fingers", "correct zone_left or zone_right"),
        )  # fmt: skip

    def check_stimuli(self, where: pd.Series) -> None:
        """Refuse rows without a stimulus, or a kind of session, if other rows have one."""
        fields = self._table.fields
        for name, what in (("stimulus", "stimulus"), ("session_kind", "kind of session")):
            if name in fields and not set(fields[name]) <= set(_EMPTY):
                self.problems += self._table.check_words(
                    fields.loc[where, name], lambda word: word not in _EMPTY, f"the name of a {what} in every row",
                    lambda word: ("nothing", "fill it in"),
                )  # fmt: skip

    def check_names(self, where: pd.Series, design: Mapping[str, Any]) -> None:
        """Refuse stimuli, groups and kinds of session unknown to the protocol, and participants in several groups."""
        table, fields = self._table, self._table.fields
        for column, names in names_in(design).items():
            if column in fields and names:
                self.problems += table.check_words(
                    fields.loc[where, column], names.__contains__, ", ".join(names),
                    lambda word: (repr(word), "write one of them, as the protocol does"),
                )  # fmt: skip
        if "group" in fields:
            own = fields.loc[where, ["participant", "group"]].astype("str")
            odd = own[own["group"] != own.groupby("participant")["group"].transform("first")]
            self.problems += table.check_words(
                (odd["group"].map(repr) + " of participant " + odd["participant"]).rename("group"), lambda word: False,
                "one group of each participant", lambda word: (
                    f"{word}, who was in another group before", "correct one of them, or give two people two names"),
            )  # fmt: skip

    def _values(self, name: str, read: Callable[[str], float]) -> pd.Series:
        column = self._table.fields[name]
        meanings = np.array([read(str(word)) for word in column.cat.categories], dtype=float)
        return pd.Series(meanings[column.cat.codes], index=column.index)


def _number(word: str, separator: str) -> float:
    # A decimal comma is unambiguous only if fields are not separated by commas, and there is no decimal point.
    if separator != "," and word.count(",") == 1 and "." not in word:
        word = word.replace(",", ".")
    try:
        return math.nan if "_" in word else float(word)
    except ValueError:
        return math.nan
