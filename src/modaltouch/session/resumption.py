"""Resumption of interrupted sessions from their records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from modaltouch.planning import Observer
from modaltouch.preflight import examine_findings
from modaltouch.protocol import Findings, Schedule
from modaltouch.record import (
    RecordError,
    RecordInputError,
    Session,
    SessionFolder,
    SessionLog,
    audit_session,
    read_session,
)
from modaltouch.session.events import PRACTICE_FAILED, boot_id, how_to_continue
from modaltouch.session.setup import Setup, sit
from modaltouch.session.wiring import AnswersBy, SessionParts, mode_of
from modaltouch.system import SYSTEM_CLOCK, Clock
from modaltouch.window import WindowOptions

CLOCK_TOLERANCE = 60.0
"""Clock error up to which network adjustment is assumed, rather than a clock set back [s]."""


def examine_interruption(session: Session, *, now: datetime, clock: float, boot: str) -> dict[str, Any]:
    """Return the facts of an interruption for the record.

    The reason is that of the stop record, or ``killed`` without one. Age and set-back of this machine's clock are lower
    bounds (0 if no set-back is known). The cut trial is a trial whose stimulus had begun without an answer.

    Parameters
    ----------
    clock : float
        Monotonic clock of the record, `time.perf_counter` [s].
    boot : str
        Identifier of the boot from which that clock counts (`events.boot_id`); empty if unknown.
    """
    events = session.events
    last = events[-1]
    marks = ("fired", "answered", "trial", "trial_cut")
    mark: dict[str, Any] = next((event for event in reversed(events) if event["event"] in marks), {})
    latest = max(datetime.fromisoformat(event["time"]) for event in events)
    passed = (now.astimezone(UTC) - latest).total_seconds()
    boots = [event["boot"] for event in events if event.get("boot")]
    counted = clock - last["clock"] if boot and boots and boots[-1] == boot else 0.0
    behind = max(counted, 0.0) - passed
    return {
        "reason": str(last["reason"]) if last["event"] == "stop" else "killed",
        "last_line": int(last["n"]),
        "last_time": latest.isoformat(timespec="milliseconds"),
        "age_s": round(max(passed, counted, 0.0), 1),
        "clock_set_back_s": round(behind, 1) if behind > CLOCK_TOLERANCE else 0.0,
        "cut_trial": mark["trial"] if mark.get("event") == "fired" else None,
    }


def refuse_old(session: Session, interruption: dict[str, Any], within_hours: float | None) -> None:
    """Refuse an interruption longer than the protocol allows.

    Raises
    ------
    RecordInputError
        If it is too long, or its age is unknown because the clock was set back.
    """
    if within_hours is None:
        return
    anew = f"`modaltouch resume --restart {session.path.parent}` starts it over and keeps the answers so far"
    limit = f"the protocol allows it to continue within {within_hours:g} h"
    if interruption["clock_set_back_s"]:
        raise RecordInputError(
            f"{session.path}: the clock of this machine is at least {interruption['clock_set_back_s'] / 3600:.2g} h "
            f"behind the record, so the age of the interruption is unknown, and {limit}; set the clock right, or: "
            f"{anew}"
        )
    hours = interruption["age_s"] / 3600
    if hours > within_hours:
        ago = f"{hours:.1f} h" if hours >= 1 else f"{60 * hours:.1f} min"
        raise RecordInputError(
            f"{session.path}: was interrupted {ago} ago, and {limit} (schedule.resume.within_hours); {anew}"
        )


def answers_to_ask_again(session: Session, schedule: Schedule, at: str) -> tuple[int, ...]:
    """Return the lines of the answers to withdraw: those of the interrupted block if `at` is ``block``."""
    if at != "block":
        return ()
    cut = next((trial.block for trial in schedule.trials if (False, trial.index) not in session.answered), None)
    return tuple(
        event["n"] for event in session.trials if not event["trial"]["practice"] and event["trial"]["block"] == cut
    )


def continue_log(
    place: SessionFolder,
    schedule: Schedule,
    at: str,
    cut: dict[str, Any],
    facts: dict[str, Any],
    clock: Clock = SYSTEM_CLOCK,
) -> SessionLog:
    """Reopen the log of an interrupted session, and record the cut trial and withdrawn answers.

    Raises
    ------
    RecordError
        If the log is damaged, in use, or cannot be written.
    """
    log = SessionLog.reopen(place.log, timed_by=clock)
    log.append("resume", at=at, interruption=cut, **facts)
    if cut["cut_trial"] is not None:
        log.append("trial_cut", trial=cut["cut_trial"], reason=f"interrupted ({cut['reason']})")
    if lines := answers_to_ask_again(log.session, schedule, at):
        log.append("withdrawn", lines=list(lines), reason="the block that was interrupted begins anew")
    return log


def start_over(
    old: SessionFolder,
    place: SessionFolder,
    cut: dict[str, Any],
    facts: dict[str, Any],
    clock: Clock = SYSTEM_CLOCK,
) -> SessionLog:
    """Close an interrupted session and return the open log of its replacement.

    Raises
    ------
    RecordError
        If either log cannot be written.
    """
    with SessionLog.reopen(old.log) as log:
        if log.session.started_over_as is None:
            log.append("closed", begun_anew_as=place.session, interruption=cut)
        log.write_view(old)
    return SessionLog.create(
        place.log,
        "start",
        timed_by=clock,
        **facts,
        begins_anew={"session": old.session, "interruption": cut},
    )


def wire_resume(
    path: Path,
    *,
    rig: str | None = None,
    answers: AnswersBy | None = None,
    restart: bool = False,
    window: Mapping[str, Any] | None = None,
) -> Setup:
    """Return the setup to continue an interrupted session, from its record.

    Parameters
    ----------
    path : Path
        Folder or log of the session.
    rig, answers : str, optional
        Replacements of the recorded choices; of the same kind.
    restart : bool
        Whether to start over as another session, regardless of the protocol.
    window : mapping, optional
        Replacements of the recorded options of the answer window, by name in `WindowOptions`.

    Raises
    ------
    RecordError
        If there is no such session, `modaltouch verify` reports faults, it has been started over, it would continue in
        another mode or order, or the interruption is too old.
    """
    session = Session.find(path)
    audit_session(session).require()
    start = session.start
    place = SessionFolder.of(session.path, session.mode, session.protocol)
    rig, answers = rig or start["rig_choice"], answers or start["answers_choice"]
    _refuse_another_kind(session, rig, answers, restart=restart)
    preflight = examine_findings(Findings.recorded(start)).require()
    if own := start.get("sensation_levels"):
        preflight = preflight.with_levels(tuple(own["levels_mm_s"]))
    protocol = preflight.experiment.protocol
    schedule = Schedule.draw_again(protocol, start, session.drawn_as)
    observer = Observer.from_dict(start["observer"]) if "observer" in start else Observer()
    at = protocol.schedule.resume.at
    chosen = (restart and not session.complete) or (at == "restart" and session.lacks_trials)
    anew = _next_free_place(place, session) if chosen or session.started_over_as is not None else None
    latest = next(event for event in reversed(session.events) if event["event"] in ("start", "resume"))
    parts = SessionParts(
        preflight,
        anew or place,
        seed=start["seed"],
        rig=rig,
        answers=answers,
        window_options=replace(WindowOptions.recorded(latest.get("window") or {}), **(window or {})),
        observer=observer,
        after=float(session.events[-1]["clock"]),
    )
    kept = ("sensation_levels", "people") if anew else ()
    setup = parts.setup(schedule, {name: start[name] for name in kept if name in start})
    n_withdrawn = 0 if anew else len(answers_to_ask_again(session, schedule, at))
    setup = replace(setup, replaces=place if anew else None, n_answered=session.n_answered - n_withdrawn)
    if not session.complete:
        _examine(session, setup)
    return setup


def resume(setup: Setup) -> Session:
    """Continue an interrupted session according to its protocol, with the remaining trials in their original order.

    For a session with all answers, only its BIDS view and a truncated last line are written. A session that is started
    over (`Setup.replaces`) is closed, and all its trials are run in the same order.

    Raises
    ------
    RecordError
        If the record is damaged or in use, the interruption is too old, or this program draws a different order from
        the recorded one.
    RigError, WindowError, SessionStopped, Interrupted
        If the session ended early again.
    """
    place = setup.replaces or setup.place
    session = read_session(place.log)
    if session.complete:
        return SessionLog.mend(place, timed_by=setup.clock)
    cut = _examine(session, setup)
    if setup.replaces is not None:
        return sit(setup, lambda new, facts: start_over(place, new, cut, facts, setup.clock), "start")
    at = setup.preflight.experiment.protocol.schedule.resume.at
    return sit(setup, lambda place, facts: continue_log(place, setup.schedule, at, cut, facts, setup.clock), "resume")


def _examine(session: Session, setup: Setup) -> dict[str, Any]:
    """Return facts about the interruption; refuse a session that may not, or cannot, be continued."""
    recorded = session.start["schedule"]
    if recorded["order_hash"] != setup.schedule.order_hash:
        raise RecordError(
            f"{session.path}: its order has the hash {recorded['order_hash'][:12]}, but this program draws "
            f"{setup.schedule.order_hash[:12]}; resume it with the version that began it "
            f"({session.start['versions']['modaltouch']})"
        )
    cut = examine_interruption(session, now=datetime.now(UTC), clock=setup.clock.now(), boot=boot_id())
    if setup.replaces is not None:
        setup.place.refuse_existing()
        return cut
    if cut["reason"] == PRACTICE_FAILED:
        raise RecordInputError(
            f"{session.path}: practice was not passed, and the protocol then ends the session "
            f"(schedule.after_failed_practice); {how_to_continue(PRACTICE_FAILED, session.path.parent)}"
        )
    refuse_old(session, cut, setup.preflight.experiment.protocol.schedule.resume.within_hours)
    return cut


def _refuse_another_kind(session: Session, rig: str, answers: AnswersBy, *, restart: bool) -> None:
    """Refuse to continue a session in another mode, or from a record too old for this version."""
    start, log = session.start, session.path
    if start.get("schema", 1) < SessionLog.SCHEMA and not (session.complete or restart):
        raise RecordInputError(
            f"{log}: was begun by a version that did not count bursts "
            f"({start['versions'].get('modaltouch', 'unknown')}), so this version cannot continue it: `modaltouch "
            f"resume --restart {log.parent}` starts it over and keeps the answers so far"
        )
    as_begun = (rig, answers) == (start["rig_choice"], start["answers_choice"])
    if not as_begun and mode_of(rig, answers, pilot=session.mode == "pilot") != session.mode:
        raise RecordError(
            f"{log}: is a {session.mode} session, and with rig {rig!r} and answers {answers!r} it would continue as "
            "another kind; give the --rig and --answers that it began with"
        )


def _next_free_place(place: SessionFolder, session: Session) -> SessionFolder:
    """Return the folder with the next free number, for the session that replaces this one."""
    anew = replace(place, session=session.started_over_as or place.session + 1)
    if session.started_over_as is not None and anew.log.exists():
        raise RecordInputError(
            f"{place.log}: was started over as session {anew.session}; continue with `modaltouch resume {anew.folder}`"
        )
    while anew.log.exists():
        anew = replace(anew, session=anew.session + 1)
    return anew
