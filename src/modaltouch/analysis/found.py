"""One recorded session as the analysis takes it: its answers and facts, or why it stays out."""

from __future__ import annotations

import hashlib
import sys
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from modaltouch.analysis.record_facts import SessionFacts, take_facts
from modaltouch.audit import audit
from modaltouch.record.chain import Chain, RecordError, read_chain
from modaltouch.record.session import Session
from modaltouch.trial import TIME_OUT


@dataclass(frozen=True)
class Found:
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
    offers_none : bool
        Whether none was an answer.
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
    offers_none: bool = False
    catches: Counter[str] = field(default_factory=Counter)
    is_adaptive: bool = False
    in_multiples: bool = False
    foci: dict[str, str] = field(default_factory=dict)


def _rows(session: Session) -> tuple[tuple[Any, ...], ...]:
    """Return the answers of a session that count, in the order of `COLUMNS`; catch trials only of adaptive ones."""
    counted = (event for event in session.trials if not event["trial"]["practice"])
    with_catches, who, number = is_adaptive(session), session.participant, session.start.get("session", 1)
    multiples = session.multiples
    return tuple(_row(who, number, event, multiples) for event in counted if with_catches or not event.get("catch"))


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


def _row(participant: str, session: int, event: dict[str, Any], multiples: dict[float, float]) -> tuple[Any, ...]:
    trial, response, planned = event["trial"], event["response"], event.get("planned", {})
    condition = trial["condition"]
    velocity = float(condition["velocity_mm_s"])
    return (
        participant,
        _one(condition["finger_condition"]),
        _one(condition["zone_left"]),
        _one(condition["zone_right"]),
        multiples.get(velocity, velocity),
        _one(condition.get("placement", "normal")),
        _one(condition.get("stimulus", "")),
        _one(response["answer"]),
        1,
        trial["repetition"],
        session,
        float(trial["index"]),
        float(trial["block"]),
        float(response["reaction_time"]),
        _one(response.get("onset", "")),
        _uncertainty(event),
        _one(response.get("answered_by", "")),
        bool(response.get("double", False)),
        float(planned.get("speed_left_mm_s", float("nan"))),
        float(planned.get("speed_right_mm_s", float("nan"))),
        bool(event.get("confirmed", {}).get("confirmed", False)),
    )


def _uncertainty(event: dict[str, Any]) -> float:
    """Return how far off a reaction time can be: by the first burst, where it counts from that, and by the answer."""
    response, onset = event["response"], event.get("confirmed", {}).get("onset_uncertainty")
    from_burst = response.get("onset") == "first_burst"
    if from_burst and onset is None:
        return float("nan")
    start = onset if from_burst else response.get("question_uncertainty", 0.0)
    return float(start) + float(response.get("time_uncertainty", 0.0))


def _one(word: object) -> str:
    """Return the one copy of a word that comes in every row."""
    return sys.intern(str(word))


def open_log(path: Path) -> Found:
    """Read a session and keep only what an analysis needs of it: a thousand logs would not fit in memory."""
    try:
        chain = read_chain(path)
    except RecordError as error:
        return Found(path, reason=f"unreadable: {error}")
    session = Session(path, chain.events, chain.problems)
    if not session.start:
        damage = f"damaged: {session.problems[0]}" if session.problems else "cut before it began"
        return Found(path, reason=damage)
    found = Found(path, session.mode, session.participant, session.protocol, unfit=_unfit(session, chain))
    if found.unfit:
        return found
    design = session.start.get("design", {})
    return replace(
        found,
        digest=_digest(path),
        rows=_rows(session),
        facts=take_facts(session),
        focus=str(design.get("stimulus", {}).get("focus", "")),
        offers_none="none" in design.get("answers", {}).get("keys", {}),
        is_adaptive=is_adaptive(session),
        in_multiples=bool(session.multiples),
        foci={
            name: str(own.get("focus") or design.get("stimulus", {}).get("focus", ""))
            for name, own in design.get("stimuli", {}).items()
        },
        catches=Counter(_one(event["response"]["answer"]) for event in session.trials if event.get("catch")),
    )


def _unfit(session: Session, chain: Chain) -> str:
    if faults := session.problems or audit(session, chain).problems:
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
