"""What an interruption left behind, how old it is, and which answers the protocol wants again.

The age of an interruption is counted by two clocks. The wall clock can be set; the monotonic clock cannot, but
it tells nothing across a restart of the machine and stands still while it sleeps. So an interruption is at least
as old as either says, and a wall clock that lags behind the monotonic one, or behind the record itself, was set
back: then no limit of age can be checked, and that is said rather than guessed. What stays unseen is a clock set
back across a restart of the machine by less than has passed.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from modaltouch.protocol import Schedule
from modaltouch.record import RecordInputError, Session, SessionFolder, SessionLog
from modaltouch.session.events import PRACTICE_FAILED, way_on
from modaltouch.system import SYSTEM_CLOCK, Clock

CLOCK_TOLERANCE = 60.0
"""A clock this far off is being kept right by the network, not set back [s]."""


@dataclass(frozen=True)
class SessionInterruption:
    """How a session ended before its end.

    Attributes
    ----------
    reason : str
        As its stop record says, or ``killed`` where there is none.
    last_line : int
        Number of the last sound line.
    last_time : str
        Latest time of day in the record (UTC).
    age_s : float
        Time since then, at least [s].
    clock_set_back_s : float
        How far the clock of this machine is known to be behind, at least; 0 if it is not known to be [s].
    cut_trial : dict or None
        The trial whose stimulus had begun and that got no answer.
    """

    reason: str
    last_line: int
    last_time: str
    age_s: float
    clock_set_back_s: float
    cut_trial: dict[str, Any] | None


def examine_interruption(session: Session, *, now: datetime, clock: float, boot: str) -> SessionInterruption:
    """Return how a session was interrupted.

    Parameters
    ----------
    session : Session
        As its log tells it, with at least one line.
    now : datetime
        Time of day, with its zone.
    clock : float
        The monotonic clock of the record, `time.perf_counter` [s].
    boot : str
        Since which start of the machine that clock counts (`events.boot_id`); empty if unknown.
    """
    events = session.events
    last = events[-1]
    latest = max(datetime.fromisoformat(event["time"]) for event in events)
    passed = (now.astimezone(UTC) - latest).total_seconds()
    boots = [event["boot"] for event in events if event.get("boot")]
    counted = clock - last["clock"] if boot and boots and boots[-1] == boot else 0.0
    behind = max(counted, 0.0) - passed
    return SessionInterruption(
        reason=str(last["reason"]) if last["event"] == "stop" else "killed",
        last_line=int(last["n"]),
        last_time=latest.isoformat(timespec="milliseconds"),
        age_s=round(max(passed, counted, 0.0), 1),
        clock_set_back_s=round(behind, 1) if behind > CLOCK_TOLERANCE else 0.0,
        cut_trial=_cut_trial(session),
    )


def refuse_failed(session: Session, interruption: SessionInterruption) -> None:
    """Raise if a session ended because its practice was not passed: it would only end again.

    Raises
    ------
    RecordInputError
        With the way to begin it anew.
    """
    if interruption.reason == PRACTICE_FAILED:
        raise RecordInputError(
            f"{session.path}: practice was not passed, and the protocol then ends the session "
            f"(schedule.after_failed_practice); {way_on(PRACTICE_FAILED, session.path.parent)}"
        )


def refuse_old(session: Session, interruption: SessionInterruption, within_hours: float | None) -> None:
    """Raise if the protocol does not let a session go on after so long a time.

    Raises
    ------
    RecordInputError
        If the interruption is too old, or the clock was set back, so that its age is unknown.
    """
    if within_hours is None:
        return
    anew = f"`modaltouch resume --restart {session.path.parent}` begins it anew, and keeps what was answered"
    limit = f"the protocol allows it to go on within {within_hours:g} h"
    if interruption.clock_set_back_s:
        raise RecordInputError(
            f"{session.path}: the clock of this machine is at least {interruption.clock_set_back_s / 3600:.2g} h "
            f"behind the record, so the age of the interruption is unknown, and {limit}; set the clock right, or: "
            f"{anew}"
        )
    hours = interruption.age_s / 3600
    if hours > within_hours:
        raise RecordInputError(
            f"{session.path}: was interrupted {_duration(interruption.age_s)} ago, and {limit} "
            f"(schedule.resume.within_hours); {anew}"
        )


def answers_to_ask_again(session: Session, schedule: Schedule, at: str) -> tuple[int, ...]:
    """Return the lines of the answers that a resumed session asks for again: those of the block that was cut."""
    if at != "block":
        return ()
    done = session.answered
    cut = next((trial.block for trial in schedule.trials if (False, trial.index) not in done), None)
    return tuple(
        event["n"] for event in session.trials if not event["trial"]["practice"] and event["trial"]["block"] == cut
    )


def go_on(
    place: SessionFolder,
    schedule: Schedule,
    at: str,
    cut: SessionInterruption,
    facts: dict[str, Any],
    clock: Clock = SYSTEM_CLOCK,
) -> SessionLog:
    """Return the open log of an interrupted session, with what the interruption cut and what is asked again.

    Parameters
    ----------
    place : SessionFolder
        Where it is recorded.
    schedule : Schedule
        Its trials.
    at : str
        ``schedule.resume.at``: where it goes on.
    cut : SessionInterruption
        How it was interrupted.
    facts : dict
        What else the resume record says.
    clock : Clock
        Of the session.

    Raises
    ------
    RecordError
        If the log is damaged, in use, or cannot be written.
    """
    log = SessionLog.reopen(place.log, timed_by=clock)
    log.append("resume", at=at, interruption=asdict(cut), **facts)
    if cut.cut_trial is not None:
        log.append("trial_cut", trial=cut.cut_trial, reason=f"interrupted ({cut.reason})")
    lines = answers_to_ask_again(log.session, schedule, at)
    if lines:
        log.append("withdrawn", lines=list(lines), reason="the block that was interrupted begins anew")
    return log


def begin_anew(
    old: SessionFolder,
    place: SessionFolder,
    cut: SessionInterruption,
    facts: dict[str, Any],
    clock: Clock = SYSTEM_CLOCK,
) -> SessionLog:
    """Close an interrupted session and return the open log of the one that takes its place.

    Parameters
    ----------
    old, place : SessionFolder
        Where the interrupted session is recorded, and where the new one will be.
    cut : SessionInterruption
        How the old one was interrupted.
    facts : dict
        What else the start record of the new one says.
    clock : Clock
        Of the session.

    Raises
    ------
    RecordError
        If either log cannot be written.
    """
    with SessionLog.reopen(old.log) as log:
        if log.session.begun_anew_as is None:
            log.append("closed", begun_anew_as=place.session, interruption=asdict(cut))
        log.write_view(old)
    begun = {"session": old.session, "interruption": asdict(cut)}
    return SessionLog.create(place.log, "start", timed_by=clock, **facts, begins_anew=begun)


def _duration(seconds: float) -> str:
    return f"{seconds / 3600:.1f} h" if seconds >= 3600 else f"{seconds / 60:.1f} min"


def _cut_trial(session: Session) -> dict[str, Any] | None:
    """Return the trial of the last stimulus that neither an answer nor a cut follows."""
    for event in reversed(session.events):
        if event["event"] in ("answered", "trial", "trial_cut"):
            return None
        if event["event"] == "fired":
            trial: dict[str, Any] = event["trial"]
            return trial
    return None
