"""A tree of recorded sessions -> answers, with every session that stays out named with its reason.

Modes and protocols are never mixed: real, pilot and simulated sessions answer different questions, and so do
two designs.
"""

from __future__ import annotations

import gc
import hashlib
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd

from modaltouch.analysis.provenance import SessionFacts, take_facts
from modaltouch.analysis.responses import (
    AnswerSource,
    ExcludedSource,
    Responses,
    answers_per_cell,
    describe_cell,
    unmirror,
)
from modaltouch.analysis.scale import OWN_THRESHOLD, VELOCITY, scale_of
from modaltouch.protocol import TIME_OUT, AnswerList, InputError, Problem
from modaltouch.record import RecordError, Session, SessionFolder, audit_session, read_session


@dataclass(frozen=True)
class SessionAnswers:
    """A session of the tree.

    Attributes
    ----------
    path : Path
        Its log.
    mode, participant, protocol : str
        What the log says of itself; empty where it cannot be read.
    reason : str
        Why it stays out; empty if it is analysed.
    unfit : str
        Why it would stay out though its mode and protocol are the right ones.
    digest : str
        SHA-256 of the log.
    rows : tuple of tuple
        Its answers in the order of `COLUMNS`; none where it stays out.
    facts : SessionFacts or None
        What it tells beside the answers; None where it stays out.
    focus : str
        Zone at which the vibration was focused, if known.
    foci : dict of str to str
        Zone in focus of each of several stimuli.
    in_multiples : bool
        Whether its levels are told as multiples of the participant's own threshold.
    is_adaptive : bool
        Whether its levels followed from the answers; its rows then hold the catch trials too, at 0 mm/s.
    answers : AnswerList
        What could be answered.
    catches : Counter
        Its answers to catch trials.
    """

    path: Path
    mode: str = ""
    participant: str = ""
    protocol: str = ""
    reason: str = ""
    unfit: str = ""
    digest: str = ""
    rows: tuple[tuple[Any, ...], ...] = ()
    facts: SessionFacts | None = None
    focus: str = ""
    answers: AnswerList = field(default_factory=lambda: AnswerList.of({}))
    catches: Counter[str] = field(default_factory=Counter)
    is_adaptive: bool = False
    in_multiples: bool = False
    foci: dict[str, str] = field(default_factory=dict)


def _rows(session: Session) -> tuple[tuple[Any, ...], ...]:
    """Return the answers of a session that count, in the order of `COLUMNS`; catch trials only of adaptive ones."""
    rows, with_catches = [], is_adaptive(session)
    for row in session.table():
        if row["practice"] or (row["catch"] and not with_catches):
            continue
        row |= {"velocity_mm_s": row["multiple_of_threshold"] or row["velocity_mm_s"], "n": 1}
        values = (row[name] for name in COLUMNS)
        # One copy of a word that comes in every row.
        rows.append(tuple(sys.intern(value) if isinstance(value, str) else value for value in values))
    return tuple(rows)


def is_adaptive(session: Session) -> bool:
    """Return whether the levels of a session followed from its answers."""
    return bool(session.start.get("design", {}).get("adaptive"))


COLUMNS = (
    "participant",
    "finger_condition",
    "zone_left",
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
    "speed_right_mm_s",
    "confirmed",
)
"""Columns of the tidy table of recorded answers; of levels calibrated by participant the multiple is told instead."""

_NUMBERS = ("trial", "block", "response_uncertainty", "speed_left_mm_s", "speed_right_mm_s")


def open_log(path: Path) -> SessionAnswers:
    """Read a session and keep only what an analysis needs of it: a thousand logs would not fit in memory."""
    try:
        session = read_session(path)
    except RecordError as error:
        return SessionAnswers(path, reason=f"unreadable: {error}")
    if not session.start:
        damage = f"damaged: {session.chain.problems[0]}" if session.chain.problems else "cut before it began"
        return SessionAnswers(path, reason=damage)
    found = SessionAnswers(path, session.mode, session.participant, session.protocol, unfit=_unfit(session))
    if found.unfit:
        return found
    design = session.start.get("design", {})
    return replace(
        found,
        digest=_digest(path),
        rows=_rows(session),
        facts=take_facts(session),
        focus=str(design.get("stimulus", {}).get("focus", "")),
        answers=AnswerList.of(design.get("answers", {})),
        is_adaptive=is_adaptive(session),
        in_multiples=bool(session.multiples),
        foci={
            name: str(own.get("focus") or design.get("stimulus", {}).get("focus", ""))
            for name, own in design.get("stimuli", {}).items()
        },
        catches=Counter(row["response"] for row in session.table() if row["catch"]),
    )


def _unfit(session: Session) -> str:
    if faults := session.chain.problems or audit_session(session).problems:
        return f"damaged: {faults[0]}"
    if not session.complete and session.begun_anew_as is not None:
        return f"closed: begun anew as session {session.begun_anew_as}"
    if not session.complete:
        total = session.start.get("schedule", {}).get("n_trials", 0)
        return f"incomplete: {session.n_answered} of {total} trials answered (go on with `modaltouch resume`)"
    n_timed_out = sum(event["response"]["answer"] == TIME_OUT for event in session.trials)
    if n_timed_out:
        return f"without an answer to {n_timed_out} trials, which timed out"
    return ""


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


MODES = ("real", "pilot", "simulated")

_FIXED, _ADAPTIVE, _IN_MULTIPLES = "fixed", "adaptive", "calibrated"
"""What sets the levels of a session: the protocol, the answers, or the participant's own threshold."""


def read_tree(place: Path, mode: str | None = None, stimulus: str | None = None) -> Responses:
    """Return the answers of the complete, sound sessions in a folder.

    Parameters
    ----------
    place : Path
        A results folder, a folder in it, or one session log.
    mode : {"real", "pilot", "simulated"}, optional
        Which sessions to take; by default the real ones, and where there are none the only kind there is.
    stimulus : str, optional
        Whose trials to take, of sessions with several stimuli and fixed levels.

    Raises
    ------
    InputError
        If there is no session to analyse, or the folder mixes modes or protocols without a choice.
    """
    if mode is not None and mode not in MODES:
        _refuse(place, f"mode {mode!r}", ", ".join(MODES), "choose one of them")
    with _no_search_for_cycles():
        found = [open_log(path) for path in find_logs(place)]
    if not found:
        remedy = f"give the folder that `modaltouch run` wrote to; it holds files named {SessionFolder.LOG_NAME}"
        _refuse(place, "a folder without a recorded session", "a results folder", remedy)
    chosen = mode or _choose_mode(place, found)
    found = [_mark(item, _other_mode(item, chosen)) for item in found]
    _refuse_protocols(place, [item.protocol for item in found if not item.reason])
    found = [_mark(item, item.unfit) for item in found]
    kind = _kind_of_levels(place, [item for item in found if not item.reason])
    is_adaptive = kind == _ADAPTIVE
    found = found if is_adaptive else _even_out(found)
    left_out = tuple(ExcludedSource(str(item.path.parent), item.reason) for item in found if item.reason)
    taken = [item for item in found if not item.reason]
    if not taken:
        counted = Counter(item.reason for item in left_out)
        listed = "; ".join(f"{n} {reason}" for reason, n in counted.most_common(5))
        remedy = "finish one with `modaltouch resume`, or choose another mode or folder"
        _refuse(place, f"no session that can be analysed ({listed})", "at least one complete session", remedy)
    answers = _one_list(place, taken)
    frame = pd.DataFrame([row for item in taken for row in item.rows], columns=list(COLUMNS))
    frame = unmirror(frame.astype(dict.fromkeys(_NUMBERS, float)), answers)
    if kind == _IN_MULTIPLES:
        frame = frame.rename(columns={VELOCITY.column: OWN_THRESHOLD.column})
    foci = taken[0].foci
    if is_adaptive and stimulus is not None:
        given, remedy = f"stimulus {stimulus!r} with adaptive sessions", "leave the option out: each run is of one"
        _refuse(place, given, "all stimuli together", remedy)
    if not is_adaptive:
        frame = _choose_stimulus(place, frame, stimulus)
        _refuse_designs(place, frame)
    frame["response"] = pd.Categorical(frame["response"], categories=list(answers.ranked.names))
    digest = hashlib.sha256("".join(item.digest for item in taken).encode()).hexdigest()
    facts = tuple(item.facts for item in taken if item.facts is not None)
    start = read_session(taken[0].path).start
    source = AnswerSource(str(place), "results", digest, chosen)
    focus = foci.get(stimulus or "", taken[0].focus)
    return Responses(frame, facts, left_out, source, focus, start, _sum_catches(taken), stimulus or "", foci, answers)


def _one_list(place: Path, taken: Sequence[SessionAnswers]) -> AnswerList:
    """Return what could be answered in all sessions: some may lack an answer that others offer."""
    longest = max((item.answers for item in taken), key=len)
    for item in taken:
        if not set(item.answers) <= set(longest):
            given = f"sessions with the answers {', '.join(longest.names)}, and with {', '.join(item.answers.names)}"
            remedy = "give the folder of one of them; name the other protocol anew"
            _refuse(place, given, "the same answers under the name of one protocol", remedy)
    return longest


def _sum_catches(found: Sequence[SessionAnswers]) -> dict[str, Counter[str]]:
    """Return the answers to catch trials by participant, over sessions."""
    catches: dict[str, Counter[str]] = {}
    for item in found:
        if item.catches:
            catches.setdefault(item.participant, Counter()).update(item.catches)
    return catches


@contextmanager
def _no_search_for_cycles() -> Iterator[None]:
    """Do without cyclic garbage collection: lines of JSON hold no cycles, and a fifth of the time went into looking."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def find_logs(place: Path) -> list[Path]:
    """Return the session logs under a folder, in order of their names."""
    return [place] if place.is_file() else sorted(place.rglob(SessionFolder.LOG_NAME))


def _mark(item: SessionAnswers, reason: str) -> SessionAnswers:
    return item if item.reason or not reason else replace(item, reason=reason)


def _choose_mode(place: Path, found: Sequence[SessionAnswers]) -> str:
    counted = Counter(item.mode for item in found if item.mode)
    if "real" in counted or not counted:
        return "real"
    if len(counted) > 1:
        listed = ", ".join(f"{n} {mode}" for mode, n in counted.most_common())
        remedy = "choose with --mode, or give the folder of one of them"
        _refuse(place, f"sessions of several modes ({listed})", "sessions of one mode", remedy)
    return next(iter(counted))


def _other_mode(item: SessionAnswers, chosen: str) -> str:
    if not item.mode or item.mode == chosen:
        return ""
    return f"{item.mode}, not {chosen} (choose with --mode {item.mode})"


def _refuse_protocols(place: Path, protocols: Sequence[str]) -> None:
    names = Counter(protocols)
    if len(names) > 1:
        listed = ", ".join(f"{n} of {name!r}" for name, n in names.most_common())
        _refuse(place, f"sessions of several protocols ({listed})", "one protocol", "give the folder of one of them")


def _choose_stimulus(place: Path, frame: pd.DataFrame, stimulus: str | None) -> pd.DataFrame:
    """Return the trials of one stimulus, as the statistics know no other factor than fingers, pair and level."""
    names = [name for name in frame["stimulus"].unique().tolist() if name]
    listed = ", ".join(names) or "sessions have one alone"
    if stimulus is None and len(names) > 1:
        remedy = "`modaltouch analyse` takes one with --stimulus, `modaltouch fit` all of them, with their protocol"
        _refuse(place, f"sessions with several stimuli ({listed})", "one stimulus", remedy)
    if stimulus is not None and stimulus not in names:
        remedy = "choose one of them, or leave the option out; a fit needs the protocol that was answered"
        _refuse(place, f"stimulus {stimulus!r}", listed, remedy)
    if stimulus is None:
        return frame
    return frame[frame["stimulus"] == stimulus].reset_index(drop=True)


def _kind_of_levels(place: Path, found: Sequence[SessionAnswers]) -> str:
    """Return what sets the levels of all sessions; refuse sessions that differ in it."""
    kinds = {_ADAPTIVE if item.is_adaptive else _IN_MULTIPLES if item.in_multiples else _FIXED for item in found}
    if len(kinds) > 1:
        given = f"sessions with {' and '.join(sorted(kinds))} levels under the name of one protocol"
        _refuse(place, given, "one of them", "give the folder of one of them; name the other protocol anew")
    return next(iter(kinds), _FIXED)


def _refuse_designs(place: Path, frame: pd.DataFrame) -> None:
    """Refuse participants who met different conditions, as under two versions of a protocol."""
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
    _refuse(place, given, "the same conditions, equally often, for every participant", remedy)


def _even_out(found: Sequence[SessionAnswers]) -> list[SessionAnswers]:
    """Keep as many sessions of every participant as the one with fewest has."""
    usable = Counter(item.participant for item in found if not item.reason)
    fewest = min(usable.values(), default=0)
    taken: Counter[str] = Counter()
    evened = []
    for item in found:
        if not item.reason:
            taken[item.participant] += 1
            if taken[item.participant] > fewest:
                item = _mark(item, f"session beyond the first {fewest}: not every participant has as many")
        evened.append(item)
    return evened


def _refuse(place: Path, given: str, allowed: str, remedy: str) -> None:
    raise InputError([Problem(str(place), 0, 0, "", given, allowed, remedy)])
