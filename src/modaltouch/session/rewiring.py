"""An interrupted session: what it needs to go on, all of it from its own record, and how it goes on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from modaltouch.planning import Observer
from modaltouch.preflight import examine_findings
from modaltouch.protocol import Findings, Schedule, Turn
from modaltouch.record import (
    RecordError,
    RecordInputError,
    Session,
    SessionFolder,
    SessionLog,
    audit_session,
    read_session,
)
from modaltouch.session.events import boot_id
from modaltouch.session.resumption import begin_anew, examine_interruption, go_on, refuse_failed, refuse_old
from modaltouch.session.sensation_level import recorded_levels
from modaltouch.session.setup import Setup, sit
from modaltouch.session.wiring import SessionParts, mode_of
from modaltouch.window import AnswersBy, WindowOptions


def wire_resume(
    path: Path,
    *,
    rig: str | None = None,
    answers: AnswersBy | None = None,
    restart: bool = False,
    window: Mapping[str, Any] | None = None,
) -> Setup:
    """Return what an interrupted session needs to go on, all of it from the session's own record.

    Parameters
    ----------
    path : Path
        A session's folder or its log.
    rig, answers : str, optional
        Others than the recorded ones, of the same kind.
    restart : bool
        Whether it is begun anew as another session, whatever its protocol says.
    window : mapping, optional
        What of the answer window is to be otherwise than it was, by the names of `WindowOptions`.

    Raises
    ------
    RecordError
        If there is no such session, `modaltouch verify` refuses it, it has been begun anew, or a real one would go on
        simulated.
    """
    session = Session.find(path)
    audit_session(session).require()
    start = session.start
    place = SessionFolder.of(session.path, session.mode, session.protocol)
    rig, answers = rig or start["rig_choice"], answers or start["answers_choice"]
    _refuse_another_kind(session, rig, answers, restart=restart)
    preflight = examine_findings(Findings.recorded(start)).require()
    preflight = recorded_levels(preflight, start)
    given = Turn.recorded(start)
    protocol = preflight.experiment.protocol
    schedule = Schedule.draw(protocol, place.participant, start["seed"], session.drawn_as, given=given)
    observer = Observer.from_dict(start["observer"]) if "observer" in start else Observer()
    at = protocol.schedule.resume.at
    begins_anew = (restart and not session.complete) or (at == "restart" and session.lacks_trials)
    begins_anew = begins_anew or session.begun_anew_as is not None
    anew = _place_anew(place, session) if begins_anew else None
    wires = SessionParts(
        preflight,
        anew or place,
        seed=start["seed"],
        rig=rig,
        answers=answers,
        window_options=replace(WindowOptions.recorded(_latest_window(session)), **(window or {})),
        observer=observer,
        after=float(session.events[-1]["clock"]),
    )
    kept = ("sensation_levels", "people") if anew else ()
    setup = wires.setup(schedule, {name: start[name] for name in kept if name in start})
    return replace(setup, replaces=place if anew else None)


def resume(setup: Setup) -> Session:
    """Continue an interrupted session as its protocol has it, the trials that are left in the order they had.

    A session that lacks no answer is left as it is, but for what the interruption kept from it: the BIDS view, and
    the last line, where that was cut.
    One that is begun anew (`Setup.replaces`) is closed, and all its trials come in the same order.

    Raises
    ------
    RecordError
        If the record is damaged or in use, the interruption is too old, or this program would draw another
        order than the recorded one.
    RigError, WindowError, SessionStopped, Interrupted
        Whatever ended it early again.
    """
    place = setup.replaces or setup.place
    session = read_session(place.log)
    if session.complete:
        return SessionLog.mend(place, timed_by=setup.clock)
    recorded = session.start["schedule"]
    if recorded["order_hash"] != setup.schedule.order_hash:
        raise RecordError(
            f"{place.log}: its order has the hash {recorded['order_hash'][:12]}, this program draws "
            f"{setup.schedule.order_hash[:12]}; resume it with the version that began it "
            f"({session.start['versions']['modaltouch']})"
        )

    cut = examine_interruption(session, now=datetime.now(UTC), clock=setup.clock.now(), boot=boot_id())
    policy = setup.preflight.experiment.protocol.schedule.resume
    if setup.replaces is not None:
        old = setup.replaces
        setup.place.refuse_existing()
        return sit(setup, lambda place, facts: begin_anew(old, place, cut, facts, setup.clock), "start")
    refuse_failed(session, cut)
    refuse_old(session, cut, policy.within_hours)
    return sit(setup, lambda place, facts: go_on(place, setup.schedule, policy.at, cut, facts, setup.clock), "resume")


def _refuse_another_kind(session: Session, rig: str, answers: AnswersBy, *, restart: bool) -> None:
    """Raise where a session would go on as something else than it was begun as."""
    start, log = session.start, session.path
    if start.get("schema", 1) < SessionLog.SCHEMA and not (session.complete or restart):
        raise RecordInputError(
            f"{log}: was begun by a version whose bursts were not counted "
            f"({start['versions'].get('modaltouch', 'unknown')}); half a session of each is no session: "
            f"`modaltouch resume --restart {log.parent}` begins it anew, and keeps what was answered"
        )
    as_begun = (rig, answers) == (start["rig_choice"], start["answers_choice"])
    if not as_begun and mode_of(rig, answers, pilot=session.mode == "pilot") != session.mode:
        raise RecordError(
            f"{log}: is a {session.mode} session, and with rig {rig!r} and answers {answers!r} it would go on as "
            "another kind; give --rig and --answers as it began"
        )


def _latest_window(session: Session) -> dict[str, Any]:
    """Return what the record says of the window of the latest sitting."""
    sittings = (event for event in reversed(session.events) if event["event"] in ("start", "resume"))
    return next(sittings).get("window") or {}


def _place_anew(place: SessionFolder, session: Session) -> SessionFolder:
    """Return the place of the session that begins another one anew: the next free number."""
    number = session.begun_anew_as
    if number is not None:
        anew = replace(place, session=number)
        if anew.log.exists():
            raise RecordInputError(
                f"{place.log}: was begun anew as session {number}; go on with `modaltouch resume {anew.folder}`"
            )
        return anew
    number = place.session + 1
    while replace(place, session=number).log.exists():
        number += 1
    return replace(place, session=number)
