"""Reading of answers from a tree of recorded sessions, with the reasons for excluded sessions.

Real, pilot and simulated sessions are never mixed, nor are sessions of different protocols.
"""

from __future__ import annotations

import gc
import hashlib
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.columns import OWN_THRESHOLD, VELOCITY
from modaltouch.analysis.provenance import SessionFacts, share, take_facts, version_notes
from modaltouch.analysis.responses import (
    CHOOSE_STIMULUS,
    MODES,
    AnswerSource,
    ExcludedSource,
    Responses,
    answers_per_cell,
    are_crossed,
    missing_answer_notes,
    names_in,
    refuse_unequal,
    sum_catches,
    unmirror,
)
from modaltouch.protocol import TIME_OUT, AnswerList, InputError
from modaltouch.record import RecordError, Session, SessionFolder, audit_session, read_session

Column = NDArray[np.float64] | tuple[Any, ...]


@dataclass(frozen=True)
class SessionAnswers:
    """Answers of one session of the tree.

    Attributes
    ----------
    path : Path
        Log of the session.
    mode, participant, protocol : str
        From the log; empty if it cannot be read.
    reason : str
        Reason to exclude the session, apart from its mode; empty if it can be analysed.
    digest : str
        SHA-256 of the log.
    columns : dict of str to sequence
        Answers by column: `COLUMNS`, then those of further questions; empty if excluded.
    facts : SessionFacts or None
        Facts from the log besides the answers; None if excluded.
    focus : str
        Zone of the focus, if known.
    foci : dict of str to str
        Focus of each stimulus, if there are several.
    levels : {"fixed", "adaptive", "calibrated"}
        Origin of the levels: fixed by the protocol; set adaptively (the rows then include catch trials, at 0 mm/s); or
        multiples of the participant's threshold.
    answers : AnswerList
        The answers offered.
    catches : Counter
        Answers to catch trials, with their finger condition.
    kind : (str, str)
        Group of the participant and kind of session; empty if there are none.
    is_crossed : bool
        Whether the protocol has every pair at every level, equally often.
    names : tuple of str
        Stimuli, groups and kinds of session in the order of the protocol.
    lab : str
        Name of the tree, if there are several.
    """

    path: Path
    mode: str = ""
    participant: str = ""
    protocol: str = ""
    reason: str = ""
    digest: str = ""
    columns: dict[str, Column] = field(default_factory=dict)
    facts: SessionFacts | None = None
    focus: str = ""
    answers: AnswerList = field(default_factory=lambda: AnswerList.of({}))
    catches: Counter[tuple[str, str]] = field(default_factory=Counter)
    levels: str = "fixed"
    foci: dict[str, str] = field(default_factory=dict)
    kind: tuple[str, str] = ("", "")
    is_crossed: bool = True
    names: tuple[str, ...] = ()
    lab: str = ""

    def of_lab(self, name: str) -> SessionAnswers:
        """Return the session with the lab in the participant id, to keep participants of different labs distinct."""
        who = f"{name}/{self.participant}"
        columns = self.columns | {"participant": (who,) * self.n_answers}
        facts = None if self.facts is None else replace(self.facts, participant=who, occasion=(name, self.kind[1]))
        return replace(self, participant=who, columns=columns, facts=facts, lab=name)

    @property
    def n_answers(self) -> int:
        """Number of answers."""
        return len(self.columns.get("n", ()))


def _columns(session: Session) -> dict[str, Column]:
    """Return the valid answers of a session by column, packed; catch trials are included only in adaptive sessions."""
    with_catches = _levels(session) == "adaptive"
    rows = [row for row in session.table() if not row["practice"] and (with_catches or not row["catch"])]
    for row in rows:
        row |= {"velocity_mm_s": row["multiple_of_threshold"] or row["velocity_mm_s"], "n": 1}
    return {name: _pack(name, tuple(row[name] for row in rows)) for name in (*COLUMNS, *session.question_columns)}


def _pack(name: str, values: tuple[Any, ...]) -> Column:
    """Return a column as an array of numbers, or as a tuple shared between the sessions with the same values."""
    if name in _NUMBERS:
        return np.array(values, dtype=float)
    packed: Column = share(name, tuple(sys.intern(each) if isinstance(each, str) else each for each in values))
    return packed


def _levels(session: Session) -> str:
    if session.start.get("design", {}).get("adaptive"):
        return "adaptive"
    return "calibrated" if session.multiples else "fixed"


COLUMNS = (
    "participant",
    "finger_condition",
    "zone_left",
    "zone_between",
    "zone_right",
    "velocity_mm_s",
    "placement",
    "stimulus",
    "response",
    "n",
    "repetition",
    "session",
    "trial",
    "block",
    "response_time",
    "response_onset",
    "response_uncertainty",
    "answered_by",
    "double",
    "speed_left_mm_s",
    "speed_between_mm_s",
    "speed_right_mm_s",
    "delivered_mm_s",
    "confirmed",
    "interval",
    "standard_mm_s",
    "correct",
)
"""Columns of the tidy table of recorded answers; calibrated levels are multiples of the participant's threshold."""

_ONE = "give the folder of one of them"
_ONE_NAMED = f"{_ONE}; give the other protocol another name"
_OF_INTERVALS = ("interval", "standard_mm_s", "correct")
"""Columns specific to trials with several intervals."""

_SPEEDS = ("speed_left_mm_s", "speed_between_mm_s", "speed_right_mm_s", "delivered_mm_s")
_NUMBERS = frozenset({VELOCITY.column, "trial", "block", "response_time", "response_uncertainty", *_SPEEDS})


def open_log(path: Path) -> SessionAnswers:
    """Read a session, keeping only the data for an analysis, since a thousand logs would not fit in memory."""
    try:
        session = read_session(path)
    except RecordError as error:
        return SessionAnswers(path, reason=f"unreadable: {error}")
    if not session.start:
        damage = f"damaged: {session.chain.problems[0]}" if session.chain.problems else "cut before it began"
        return SessionAnswers(path, reason=damage)
    faults = session.chain.problems or audit_session(session).problems
    if reason := f"damaged: {faults[0]}" if faults else session.unfit:
        return SessionAnswers(path, session.mode, session.participant, session.protocol, reason)
    design = session.start.get("design", {})
    caught = [row for row in session.table() if row["catch"] and row["response"] != TIME_OUT]
    return SessionAnswers(
        path,
        session.mode,
        session.participant,
        session.protocol,
        digest=hashlib.sha256(path.read_bytes()).hexdigest(),
        columns=_columns(session),
        facts=take_facts(session),
        focus=str(design.get("stimulus", {}).get("focus", "")),
        answers=share("answers", AnswerList.of(design.get("answers", {}))),
        levels=_levels(session),
        foci={
            name: str(own.get("focus") or design.get("stimulus", {}).get("focus", ""))
            for name, own in design.get("stimuli", {}).items()
        },
        catches=Counter((row["finger_condition"], row["response"]) for row in caught),
        kind=session.occasion,
        is_crossed=are_crossed({**design, "groups": {}, "schedule": {}}),
        names=tuple(chain(*names_in(design).values())),
    )


def _in_time(whole: pd.DataFrame, answers: AnswerList, *, keep: bool) -> pd.DataFrame:
    """Drop the trials that timed out or, with `keep`, set their answers to missing."""
    responses = pd.Categorical(
        whole["response"].where(in_time := whole["response"] != TIME_OUT), list(answers.ranked.names)
    )
    return whole.assign(response=responses)[in_time | keep].reset_index(drop=True)


def read_tree(place: Path, *further: Path, mode: str | None = None, stimulus: str | None = None) -> Responses:
    """Read the answers of the complete, valid sessions in a folder, or in the folders of several labs.

    Parameters
    ----------
    place : Path
        A results folder, a folder in it, or one session log.
    *further : Path
        Results folders of other labs; the folder names then define groups of participants.
    mode : {"real", "pilot", "simulated"}, optional
        Which sessions to use; by default the real ones or, if there are none, those of the only mode.
    stimulus : str, optional
        Stimulus to analyse, of several at fixed levels; by default all.

    Raises
    ------
    InputError
        If there is no session to analyse, or if the folder mixes modes or protocols and none is selected.
    """
    if mode is not None and mode not in MODES:
        raise InputError.of(place, f"mode {mode!r}", ", ".join(MODES), "choose one of them")
    found = _open_labs(place, *further) if further else _open_logs(place)
    modes = [item.mode for item in found if item.mode]
    choice = f"choose with --mode, or {_ONE}"
    chosen = mode or ("real" if "real" in modes else _only(place, "modes", modes, choice) or "real")
    left_out: list[ExcludedSource] = []
    of_mode = _sort(found, left_out, lambda item: _other_mode(item, chosen))
    _only(place, "protocols", [f"of {item.protocol!r}" for item in of_mode if item.mode], _ONE)
    taken = _sort(of_mode, left_out, lambda item: item.reason)
    _check(place, taken, left_out)
    levels = _only(place, "kinds of levels", [item.levels for item in taken], _ONE_NAMED)
    taken = taken if levels == "adaptive" else _as_many(taken, left_out)
    is_crossed = levels == "adaptive" or _is_crossed(taken, stimulus)
    answers = _one_list(place, taken)
    whole = _join(place, taken, levels, answers, stimulus, is_crossed=is_crossed)
    asked = int(answers_per_cell(whole).to_numpy().max()) if levels != "adaptive" else None
    frame = _in_time(whole, answers, keep=levels == "adaptive")
    notes = [f"Groups are labs: {', '.join(frame['group'].cat.categories)}"] if further else []
    if levels != "adaptive" and is_crossed:
        notes += missing_answer_notes(whole, frame)
    foci, start = taken[0].foci, read_session(taken[0].path).start
    facts = tuple(item.facts for item in taken if item.facts is not None)
    caught = ((one.participant, name, one.kind[1], word, n) for one in taken for (name, word), n in one.catches.items())
    return Responses(
        frame,
        facts,
        tuple(sorted(left_out, key=lambda item: Path(item.source))),
        _source([place, *further], taken, chosen),
        foci.get(stimulus or "", taken[0].focus),
        start,
        sum_catches(caught),
        stimulus or "",
        foci,
        answers,
        asked,
        notes=(*notes, *version_notes(facts)),
        scheduled=None if is_crossed else whole,
        design=start.get("design", {}),
    )


def _open_logs(place: Path) -> list[SessionAnswers]:
    was_on = gc.isenabled()
    gc.disable()  # searching for cycles, which JSON does not have, takes a fifth of the run time
    try:
        return [open_log(path) for path in SessionFolder.logs_under(place)]
    finally:
        if was_on:
            gc.enable()


def _open_labs(*places: Path) -> list[SessionAnswers]:
    names = [place.resolve().name for place in places]
    if twice := next((name for name in names if names.count(name) > 1), None):
        given = f"several folders named {twice!r}"
        raise InputError.of(places[0], given, "one folder of each lab", "name each folder after its lab")
    found = [item.of_lab(name) for name, place in zip(names, places, strict=True) for item in _open_logs(place)]
    if grouped := next((item for item in found if item.kind[0]), None):
        given = f"sessions of several labs with groups of participants, such as {grouped.kind[0]!r}"
        raise InputError.of(places[0], given, "labs of a protocol without groups", "analyse each lab separately")
    return found


def _source(places: Sequence[Path], taken: Sequence[SessionAnswers], mode: str) -> AnswerSource:
    names = tuple(map(str, places))
    digest = hashlib.sha256("".join(item.digest for item in taken).encode()).hexdigest()
    return AnswerSource(", ".join(names), "results", digest, mode, names if len(names) > 1 else ())


def _check(place: Path, taken: Sequence[SessionAnswers], left_out: Sequence[ExcludedSource]) -> None:
    """Refuse an empty selection, several foci, and duplicate sessions, e.g. from a copy or nested folders of labs."""
    first: dict[str, Path] = {}
    for item in taken:
        if (earlier := first.setdefault(item.digest, item.path)) is not item.path:
            given = f"the same session twice, {earlier.parent} and {item.path.parent}"
            raise InputError.of(place, given, "each session once", "give folders that share no session")
    if not taken:
        counted = Counter(item.reason for item in left_out)
        listed = "; ".join(f"{n} session{'s' * (n != 1)}: {reason}" for reason, n in counted.most_common(5))
        finish = "finish one with `modaltouch resume`, or " * any("incomplete" in reason for reason in counted)
        remedy = f"{finish}choose another mode or folder"
        given = f"no session that can be analysed ({listed})"
        raise InputError.of(place, given, "at least one complete session", remedy)
    for kind in dict.fromkeys(item.kind for item in taken):
        touched = [", ".join(item.foci.values()) or item.focus for item in taken if item.kind == kind]
        _only(place, "foci", touched, _ONE_NAMED)


def _join(
    place: Path,
    taken: Sequence[SessionAnswers],
    levels: str,
    answers: AnswerList,
    stimulus: str | None,
    *,
    is_crossed: bool,
) -> pd.DataFrame:
    """Join the answers of the sessions into a tidy table, for one stimulus if selected."""
    columns = {name: _joined([item.columns[name] for item in taken]) for name in taken[0].columns}
    frame = pd.DataFrame(columns, copy=False)
    numbers = [item.n_answers for item in taken]
    for place_of, column in enumerate(("group", "session_kind")):
        frame[column] = np.repeat([(item.lab or item.kind[0], item.kind[1])[place_of] for item in taken], numbers)
    for column in ("group", "session_kind", "stimulus"):
        names = sorted(frame[column].unique(), key=lambda name: (*taken[0].names, name).index(name))
        frame[column] = pd.Categorical(frame[column], names)
    frame["focus"] = [item.foci.get(name, item.focus) for item in taken for name in item.columns["stimulus"]]
    frame = unmirror(frame, answers)
    if not frame["zone_between"].any():
        frame = frame.drop(columns=["zone_between", "speed_between_mm_s"])
    if frame["delivered_mm_s"].isna().all():
        frame = frame.drop(columns="delivered_mm_s")
    if frame["interval"].isna().all():
        frame = frame.drop(columns=list(_OF_INTERVALS))
    if levels == "calibrated":
        frame = frame.rename(columns={VELOCITY.column: OWN_THRESHOLD.column})
    if levels != "adaptive" and stimulus is not None:
        frame = _choose_stimulus(place, frame, stimulus)
    if levels != "adaptive" and is_crossed:
        refuse_unequal(place, frame)
    if levels == "adaptive" and stimulus is not None:
        given, remedy = f"stimulus {stimulus!r} with adaptive sessions", "leave it out: each run has one stimulus"
        raise InputError.of(place, given, "all stimuli together", remedy)
    return frame


def _joined(parts: Sequence[Column]) -> pd.Series:
    return pd.Series(np.concatenate(parts) if isinstance(parts[0], np.ndarray) else list(chain.from_iterable(parts)))


def _sort(
    items: Sequence[SessionAnswers], left_out: list[ExcludedSource], reason_of: Callable[[SessionAnswers], str]
) -> list[SessionAnswers]:
    """Return the sessions without a reason for exclusion, and append the others to `left_out`."""
    reasons = [(item, reason_of(item)) for item in items]
    left_out += [ExcludedSource(str(item.path.parent), reason) for item, reason in reasons if reason]
    return [item for item, reason in reasons if not reason]


def _only(place: Path, what: str, values: Sequence[str], remedy: str) -> str:
    """Return the common value of all sessions, or an empty string without any; refuse several values."""
    counted = Counter(values)
    if len(counted) > 1:
        listed = ", ".join(f"{n} {value}" for value, n in counted.most_common())
        raise InputError.of(place, f"sessions of several {what} ({listed})", "sessions of only one", remedy)
    return next(iter(counted), "")


def _one_list(place: Path, taken: Sequence[SessionAnswers]) -> AnswerList:
    """Return the longest list of answers offered; refuse sessions with other answers or different questions."""
    longest = max((item.answers for item in taken), key=len)
    for item in taken:
        if (asked := _further(item)) != (first := _further(taken[0])):
            given = f"sessions that ask {', '.join(first) or 'nothing more'}, and {', '.join(asked)}"
            raise InputError.of(place, given, "the same questions under the name of one protocol", _ONE_NAMED)
        if not set(item.answers) <= set(longest):
            given = f"sessions with the answers {', '.join(longest.names)}, and with {', '.join(item.answers.names)}"
            raise InputError.of(place, given, "the same answers under the name of one protocol", _ONE_NAMED)
    return longest


def _further(item: SessionAnswers) -> list[str]:
    """Return the columns of numbers on a scale, and of further questions."""
    return [*item.columns][len(COLUMNS) :]


def _other_mode(item: SessionAnswers, chosen: str) -> str:
    return f"{item.mode}, not {chosen} (choose with --mode {item.mode})" * (item.mode not in ("", chosen))


def _is_crossed(taken: Sequence[SessionAnswers], stimulus: str | None) -> bool:
    """Return whether all sessions have one stimulus and kind, with every pair at every level equally often."""
    is_one = stimulus is not None or len({name for item in taken for name in item.columns["stimulus"]}) < 2
    return is_one and all(item.is_crossed for item in taken) and len({item.kind for item in taken}) == 1


def _as_many(taken: Sequence[SessionAnswers], left_out: list[ExcludedSource]) -> list[SessionAnswers]:
    """Select equally many sessions of each kind from every participant; the others are excluded."""
    held, seen = Counter((item.participant, item.kind) for item in taken), Counter[object]()
    fewest = {kind: min(n for (_, own), n in held.items() if own == kind) for _, kind in held}
    return _sort(taken, left_out, lambda item: _surplus(item, fewest[item.kind], seen))


def _surplus(item: SessionAnswers, fewest: int, seen: Counter[object]) -> str:
    seen[item.participant, item.kind] += 1
    beyond = seen[item.participant, item.kind] > fewest
    return f"session after number {fewest}: not every participant has more" if beyond else ""


def _choose_stimulus(place: Path, frame: pd.DataFrame, stimulus: str) -> pd.DataFrame:
    names = [name for name in frame["stimulus"].unique().tolist() if name]
    if stimulus not in names:
        allowed = ", ".join(names) or "the sessions have only one"
        raise InputError.of(place, f"stimulus {stimulus!r}", allowed, CHOOSE_STIMULUS)
    return frame[frame["stimulus"] == stimulus].reset_index(drop=True)
