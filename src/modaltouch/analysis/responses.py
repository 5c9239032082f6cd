"""Answers as input to the analysis: a tidy table, and the source of the answers.

The tidy table has one row per answer (or, with a column ``n``, per count of identical answers)::

    participant, finger_condition, zone_left, zone_right, velocity_mm_s, response

If levels are multiples of each participant's threshold, ``multiple_of_threshold`` replaces ``velocity_mm_s``.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Collection, Container, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from modaltouch.analysis.columns import (
    DELIVERED,
    OWN_THRESHOLD,
    PREDICTED,
    VELOCITY,
    LevelScale,
    Speed,
    scale_of,
    zones_of,
)
from modaltouch.analysis.counts import AnswerCounts, count_answers
from modaltouch.analysis.provenance import SessionFacts, summarise_form
from modaltouch.protocol import AnswerList, InputError

if TYPE_CHECKING:
    from modaltouch.analysis.task import TrialTask

REQUIRED = ("participant", "finger_condition", "zone_left", "zone_right", "velocity_mm_s", "response")
CELL = ("finger_condition", "zone_left", "zone_right", "velocity_mm_s")

MODES = ("real", "pilot", "simulated")

CHOOSE_STIMULUS = (
    "with `analyse`, choose one of them or leave out --stimulus; with `fit`, give the protocol that was answered"
)

_SIDES = (("zone_left", "zone_right"), ("speed_left_mm_s", "speed_right_mm_s"))


def cell_of(columns: Container[str]) -> tuple[str, ...]:
    """Return the columns that define the cells of the design."""
    return (CELL[0], *zones_of(columns), scale_of(columns).column)


def keys_of(columns: Container[str]) -> tuple[str, ...]:
    """Return the columns that define participant and cell of an answer in a balanced table."""
    return ("participant", *cell_of(columns))


def answers_per_cell(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the number of answers of each participant (row) in each cell of the crossed design (column).

    Parameters
    ----------
    frame : DataFrame
        Tidy answers with a count ``n``.
    """
    cell = cell_of(frame.columns)
    sums = frame.groupby(["participant", *cell], observed=True)["n"].sum()
    wide = sums.unstack(list(cell), fill_value=0)
    pairs = frame[list(zones_of(frame.columns))].drop_duplicates().itertuples(index=False, name=None)
    conditions, levels = frame["finger_condition"].unique(), sorted(frame[cell[-1]].unique())
    crossed = [(c, *pair, level) for pair in pairs for c in conditions for level in levels]
    return wide.reindex(columns=pd.MultiIndex.from_tuples(crossed, names=list(cell)), fill_value=0)


def describe_cell(cell: Iterable[object], scale: LevelScale = VELOCITY) -> str:
    """Return a cell in words, as in ``one_hand A-C 80 mm/s``."""
    condition, *zones, level = map(str, cell)
    return f"{condition} {'-'.join(filter(None, zones))} {scale.say(float(level))}"


def missing_answer_notes(asked: pd.DataFrame, given: pd.DataFrame) -> tuple[str, ...]:
    """Return notes on participants, pairs and levels without any answer, which do not appear in tables or tests.

    Parameters
    ----------
    asked, given : DataFrame
        Rows of all trials, and of trials with an answer.
    """
    scale = scale_of(asked.columns)
    words: dict[tuple[str, ...], Callable[..., str]] = {
        ("participant",): lambda who: f"participant {who}",
        (CELL[0], *zones_of(asked.columns)): lambda condition, *zones: f"{condition} {'-'.join(filter(None, zones))}",
        (scale.column,): scale.say,
    }
    notes = []
    for names, say in words.items():
        every, answered = (dict.fromkeys(zip(*map(frame.get, names), strict=True)) for frame in (asked, given))
        notes += [say(*each) for each in every if each not in answered]
    return (f"Left out, since there is no answer at all: {', '.join(notes)}",) if notes else ()


@dataclass(frozen=True)
class ExcludedSource:
    """A source of answers excluded from the analysis.

    Attributes
    ----------
    source : str
        File, folder or rows.
    reason : str
        Reason for the exclusion.
    """

    source: str
    reason: str


@dataclass(frozen=True)
class AnswerSource:
    """Source of the answers.

    Attributes
    ----------
    path : str
        File or folder, as given by the user.
    kind : str
        ``csv`` or ``results``.
    sha256 : str
        Hash of the file, or of the hashes of the logs.
    mode : str
        ``real``, ``pilot`` or ``simulated``; empty (unknown) for a CSV.
    labs : tuple of str
        Folders of the labs, if there are several.
    """

    path: str
    kind: str
    sha256: str
    mode: str = ""
    labs: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Responses:
    """Answers as input to the analysis.

    Attributes
    ----------
    frame : DataFrame
        Tidy table; ``response`` is categorical over all answers offered, ``n`` counts identical answers. For adaptive
        sessions, it includes trials that timed out, without a response.
    sessions : tuple of SessionFacts
        Facts about each recorded session besides its answers; empty for a CSV.
    left_out : tuple of ExcludedSource
        Sources excluded from the analysis, with reasons.
    source : AnswerSource
        Source of the answers.
    focus : str
        Zone of the focus, if known.
    start : dict
        Start record of the first session; empty for a CSV.
    catches : dict of (str, str, str) to Counter
        Answers to catch trials by participant, finger condition and kind of session; these are not in the table.
    stimulus : str
        Stimulus selected among several; empty if none was selected.
    foci : dict of str to str
        Focus of each stimulus, if there are several.
    answers : AnswerList
        The answers offered.
    asked : int or None
        Scheduled answers per participant and cell; None to infer them from the table.
    notes : tuple of str
        Notes on the reading of the table, for the report.
    scheduled : DataFrame or None
        All trials, with or without an answer, to count the trials of each cell in designs that are not crossed; None
        for a crossed design.
    design : dict
        Sections of the protocol; empty if unknown.
    """

    frame: pd.DataFrame
    sessions: tuple[SessionFacts, ...]
    left_out: tuple[ExcludedSource, ...]
    source: AnswerSource
    focus: str = ""
    start: dict[str, Any] = field(default_factory=dict)
    catches: dict[tuple[str, str, str], Counter[str]] = field(default_factory=dict)
    stimulus: str = ""
    foci: dict[str, str] = field(default_factory=dict)
    answers: AnswerList = field(default_factory=lambda: AnswerList.of({}))
    asked: int | None = None
    notes: tuple[str, ...] = ()
    scheduled: pd.DataFrame | None = None
    design: Mapping[str, Any] = field(default_factory=dict)

    @property
    def task(self) -> TrialTask:
        """Task of the participant in a trial."""
        from modaltouch.analysis.task import TrialTask

        return TrialTask.of(self.design)

    def heading(self, what: str) -> str:
        """Return a heading with the title or name of the protocol, as in ``Analysis of answers`` without one."""
        name = self.design.get("title") or self.start.get("protocol")
        return f"{what}: {name}" if name else f"{what} of answers"

    @property
    def command(self) -> str:
        """Command line to analyse these answers."""
        source = self.source
        words = ["modaltouch", "analyse", *(source.labs or [source.path]), *["--out", "FOLDER"] * bool(source.labs)]
        words += ["--stimulus", self.stimulus] * bool(self.stimulus)
        if self.sessions:
            words += ["--mode", source.mode]
        elif self.design:
            words += ["--protocol", "PROTOCOL"]
        return shlex.join(words)

    def as_dict(self, *notes: str) -> dict[str, Any]:
        """Return the source of the answers and the form at the end, as plain values for ``--json``."""
        return {
            "notes": [*self.notes, *notes],
            "mode": self.source.mode or None,
            "source": self.source.path,
            "left_out": [{"source": item.source, "reason": item.reason} for item in self.left_out],
            "form": list(summarise_form(self.sessions)),
        }

    @property
    def has_individual_results(self) -> bool:
        """Whether there are individual results besides counts: catch trials, d', thresholds, ratings or groups."""
        detects = bool(self.catches) or self.answers.naming() is not None or len(self.answers) == 2
        rated = "value" in self.frame.columns or bool((self.design.get("answers") or {}).get("then"))
        return detects or rated or bool(self.design.get("intervals")) or bool(self.groups)

    def caught(self, participant: str, finger_condition: str = "all", kind: str = "") -> Counter[str]:
        """Return a participant's answers to catch trials, for one or all finger conditions and kinds of session."""
        own = (
            words
            for (who, condition, occasion), words in self.catches.items()
            if who == participant and finger_condition in ("all", condition) and kind in ("", occasion)
        )
        return sum(own, Counter())

    @property
    def groups(self) -> dict[str, str]:
        """Group of each participant, in the order of the protocol; empty unless there are several groups."""
        if "group" not in self.frame.columns or self.frame["group"].nunique() < 2:
            return {}
        members = self.frame[["participant", "group"]].drop_duplicates().sort_values("group", kind="stable")
        return dict(zip(members["participant"].astype(str), members["group"].astype(str), strict=True))

    def of_groups(self, groups: Collection[str]) -> Responses:
        """Return the answers of some groups in the cells common to all of them."""
        own = self.frame[self.frame["group"].isin(groups)]
        kept = [name for name in (*cell_of(own), "stimulus", "session_kind", "focus") if name in own.columns]
        n_met = own.groupby(kept, observed=True)["group"].transform("nunique")
        return replace(self, frame=own[n_met == len(groups)])

    @property
    def stimuli(self) -> tuple[str, ...]:
        """Stimuli of the answers, if there are several."""
        return self._several("stimulus")

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of session of the answers, if there are several."""
        return self._several("session_kind")

    def _several(self, column: str) -> tuple[str, ...]:
        names = tuple(map(str, self.frame[column].sort_values().unique())) if self.scheduled is not None else ()
        return names if len(names) > 1 else ()

    def by_choice(self) -> Responses:
        """Recode answers that name an interval by the stimulus chosen; keep other answers."""
        if not self.design.get("intervals") or not set(self.task.named) & set(self.answers.names):
            return self
        frame, answers = self.task.by_choice(self.frame, self.answers)
        scheduled = None if self.scheduled is None else self.task.by_choice(self.scheduled, self.answers)[0]
        return replace(self, frame=frame, answers=answers, scheduled=scheduled)

    def count(self, focus: str = "") -> AnswerCounts:
        """Count the answers.

        Parameters
        ----------
        focus : str
            Zone of the focus, if unknown from the answers; guessed if empty.

        Raises
        ------
        ValueError
            If a response is not one of the answers.
        """
        margin = (self.design.get("analysis") or {}).get("equivalence_margin")
        counts = count_answers(self.frame, self.focus or focus, self.answers, margin, self.asked)
        return replace(counts, guesses_evenly=self.task.n_intervals < 3)

    def by_speed(self, speed: Speed) -> Responses:
        """Replace the levels by the peak speeds predicted or delivered under the faster finger.

        In adaptive sessions, each trial has its own speed; fixed levels take the mean over trials, to preserve the
        cells of the design. Trials without a vibrometer measurement take the predicted speed.

        Raises
        ------
        InputError
            If the answers do not contain these speeds, or compare levels with a standard.
        """
        if self.task.standard > 0:
            given = f"a standard of {self.task.standard:g} mm/s, to which speeds under the fingers are not comparable"
            raise InputError.of(self.source.path, given, "trials without a standard level", "take --speed nominal")
        column = scale_of(self.frame.columns).column
        zones = {name: f"speed_{name.split('_')[1]}_mm_s" for name in zones_of(self.frame.columns)}
        sides = [side for zone, side in zones.items() if (self.frame[zone] != "").any()]
        if column != VELOCITY.column or not set(sides) <= set(self.frame) or self.frame[sides].isna().to_numpy().any():
            given = "answers without the speeds predicted under the fingers in mm/s"
            raise InputError.of(self.source.path, given, "recorded sessions of levels in mm/s", "take --speed nominal")
        speeds, scale = self.frame[sides].max(axis=1), PREDICTED
        if speed == "delivered":
            if "delivered_mm_s" not in self.frame:
                given = "answers without a delivered speed"
                raise InputError.of(
                    self.source.path, given, "sessions with `stimulus.fingers: measured`", "take --speed predicted"
                )
            speeds, scale = self.frame["delivered_mm_s"].fillna(speeds), DELIVERED
        if not self.is_adaptive:
            speeds = speeds.groupby(self.frame[column]).transform("mean")
        return replace(self, frame=self.frame.drop(columns=column).assign(**{scale.column: speeds.round(3)}))

    @property
    def in_multiples(self) -> bool:
        """Whether levels are multiples of each participant's threshold."""
        return scale_of(self.frame.columns) == OWN_THRESHOLD

    @property
    def is_adaptive(self) -> bool:
        """Whether levels were set adaptively, so that there are runs instead of counts."""
        return bool(self.start.get("design", {}).get("adaptive"))


def refuse_unequal(place: Path, frame: pd.DataFrame) -> None:
    """Refuse participants with different conditions, e.g. from two versions of a protocol.

    Parameters
    ----------
    place : Path
        Source of the answers.
    frame : DataFrame
        Tidy answers of recorded sessions.
    """
    answers = answers_per_cell(frame)
    usual = int(answers.to_numpy().max())
    odd = answers.index[(answers != usual).any(axis=1)]
    if not len(odd):
        return
    cells = answers.columns[(answers.loc[odd[0]] != usual).to_numpy()]
    cell = describe_cell(cells[0], scale_of(frame.columns))
    shown = f"{odd[0]} has {answers.loc[odd[0], cells[0]]} in {cell}, others up to {usual}"
    given = f"participants who answered different conditions ({len(odd)} of {len(answers)}; {shown})"
    remedy = "give a folder with the sessions of one version of the protocol"
    raise InputError.of(place, given, "the same conditions, equally often, for every participant", remedy)


def sum_catches(counted: Iterable[tuple[str, str, str, str, int]]) -> dict[tuple[str, str, str], Counter[str]]:
    """Sum the counts of answers to catch trials by participant, finger condition and kind of session."""
    catches: dict[tuple[str, str, str], Counter[str]] = {}
    for participant, finger_condition, kind, word, n in counted:
        catches.setdefault((str(participant), str(finger_condition), str(kind)), Counter())[str(word)] += int(n)
    return catches


def kinds_of(design: Mapping[str, Any]) -> dict[str, bool]:
    """Return the kinds of session in the sections of a protocol, and whether each is analysed."""
    listed = (design.get("schedule") or {}).get("sessions")
    return {kind["name"]: kind.get("analysed", True) for kind in listed} if isinstance(listed, (list, tuple)) else {}


def names_in(design: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """Return the stimuli, groups and kinds of session that a protocol defines, in its order, by column."""
    own = {"stimulus": design.get("stimuli"), "group": design.get("groups"), "session_kind": kinds_of(design)}
    return {column: tuple(names or ()) for column, names in own.items()}


def are_crossed(design: Mapping[str, Any]) -> bool:
    """Return whether the cells of a protocol, given as its sections, are crossed in every group and analysed kind."""
    whole, kinds = design.get("conditions") or {}, (design.get("schedule") or {}).get("sessions")
    analysed = [kind for kind in kinds if kind.get("analysed", True)] if isinstance(kinds, (list, tuple)) else []
    occasions = product((design.get("groups") or {"": {}}).values(), analysed or [{}])
    sections = [whole | (group.get("conditions") or {}) | (kind.get("conditions") or {}) for group, kind in occasions]
    listed = [own for own in sections if own.get("cells") or own.get("exclude")]
    if not listed:
        return True
    from modaltouch.protocol import Protocol

    return all(Protocol.are_crossed(own, design.get("stimuli") or ()) for own in listed)


def unmirror(frame: pd.DataFrame, answers: AnswerList) -> pd.DataFrame:
    """Return a tidy table with zones and answers of mirrored rows in the order of the beam.

    On a turned beam, a participant who feels zone C on the left answers "left"; the answer still means zone C, as for
    participants who feel it on the right. The column ``placement`` is kept and indicates the side.

    Parameters
    ----------
    frame : DataFrame
        Tidy answers; rows with a ``placement`` beginning with "mirrored" are swapped.
    answers : AnswerList
        The answers offered; an answer without an opposite among them is kept.
    """
    if "placement" not in frame.columns:
        return frame
    # A single finger has no opposite side.
    turned = (frame["placement"].astype(str).str.startswith("mirrored") & (frame["zone_right"] != "")).to_numpy()
    if not turned.any():
        return frame
    words = frame["response"].astype(str)
    opposite = {
        answer.name: next((a.name for a in answers if a.fingers == answer.mirrored), answer.name)
        for answer in answers
        if answer.fingers
    }
    changed: dict[str, Any] = {"response": words.where(~turned, words.map(lambda word: opposite.get(word, word)))}
    for left, right in _SIDES:
        if left in frame.columns and right in frame.columns:
            # The columns may have different categories.
            changed[left], changed[right] = (
                np.where(turned, frame[one], frame[other]) for one, other in ((right, left), (left, right))
            )
    return frame.assign(**changed)
