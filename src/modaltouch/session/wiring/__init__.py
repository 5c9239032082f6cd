"""Puts real or simulated parts behind the session's interfaces: the only place that knows which is which."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from modaltouch.planning import Observer, read_observer, usual_observer
from modaltouch.preflight import Preflight, examine_findings
from modaltouch.protocol import Findings, Protocol, Schedule, Sources, Turn
from modaltouch.record import (
    SCHEMA,
    Mode,
    RecordError,
    RecordInputError,
    Session,
    SessionFolder,
    find_log,
    locate,
    require_sound,
)
from modaltouch.session.assignment import next_session
from modaltouch.session.sensation_level import at_own_levels, recorded_levels
from modaltouch.session.setup import Setup
from modaltouch.session.wiring.parts import SIMULATED, SessionParts
from modaltouch.window import AnswersBy, WindowOptions


def wire_run(
    preflight: Preflight,
    participant: str,
    *,
    session: int | None = 1,
    rig: str = SIMULATED,
    answers: AnswersBy = "window",
    pilot: bool = False,
    seed: int = 1,
    results: Path = Path("results"),
    window_options: WindowOptions | None = None,
    observer: Observer | None = None,
    threshold_mm_s: float | None = None,
) -> Setup:
    """Return what a new session needs.

    Parameters
    ----------
    preflight : Preflight
        The checked experiment.
    participant : str
        Participant id.
    session : int or None
        Number of the session; None for the participant's next.
    rig, answers, pilot, seed, results, window_options, observer
        As `SessionParts` and the command line have them.
    threshold_mm_s : float, optional
        The participant's own threshold, where levels are calibrated by participant and it was measured otherwise than
        by a session of this program.

    Raises
    ------
    RecordError
        If the participant id is not allowed, or the participant has no next session.
    InputError
        If levels are calibrated by participant and this one's cannot be told.
    """
    protocol = preflight.experiment.protocol
    place = SessionFolder(results, mode_of(rig, answers, pilot=pilot), protocol.protocol, participant, session or 1)
    drawn_as = place.session
    if session is None:
        place, drawn_as = next_session(place, protocol.schedule.sessions)
    preflight, calibrated = at_own_levels(preflight, place, threshold_mm_s)
    schedule = Schedule.draw(preflight.experiment.protocol, participant, seed, drawn_as)
    wires = SessionParts(
        preflight,
        place,
        seed=seed,
        rig=rig,
        answers=answers,
        window_options=window_options,
        observer=observer or _usual(protocol, answers),
    )
    setup = wires.setup(schedule)
    setup = replace(setup, facts=setup.facts | calibrated)
    return replace(setup, drawn_as=drawn_as) if protocol.schedule.balance == "least_filled" else setup


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
    log = find_log(path)
    session = require_sound(log)
    start = session.start
    place = locate(log, session.mode, session.protocol)
    rig, answers = rig or start["rig_choice"], answers or start["answers_choice"]
    _refuse_another_kind(session, rig, answers, restart=restart)
    preflight = examine_findings(Findings.restored(Sources.from_dict(start["sources"]))).require()
    preflight = recorded_levels(preflight, start)
    given = Turn.recorded(start)
    protocol = preflight.experiment.protocol
    schedule = Schedule.draw(protocol, place.participant, start["seed"], session.drawn_as, given=given)
    observer = Observer.from_dict(start["observer"]) if "observer" in start else Observer()
    at = preflight.experiment.protocol.schedule.resume.at
    anew = _place_anew(place, session) if (restart or at == "restart") and not session.complete else None
    if anew is None and session.begun_anew_as is not None:
        anew = _place_anew(place, session)
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
    setup = wires.setup(schedule)
    if anew is None:
        return setup
    calibrated = {name: start[name] for name in ("sensation_levels",) if name in start}
    return replace(setup, replaces=place, facts=setup.facts | calibrated)


def _refuse_another_kind(session: Session, rig: str, answers: AnswersBy, *, restart: bool) -> None:
    """Raise where a session would go on as something else than it was begun as."""
    start, log = session.start, session.path
    if start.get("schema", 1) < SCHEMA and not (session.complete or restart):
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


def _usual(protocol: Protocol, answers: AnswersBy) -> Observer:
    """Return who is simulated if nobody says otherwise; the default observer is the shipped `paper`."""
    name = usual_observer(protocol)
    return Observer() if name == "paper" or answers == "window" else read_observer(name)


def _place_anew(place: SessionFolder, session: Session) -> SessionFolder:
    """Return the place of the session that begins another one anew: the next free number.

    Raises
    ------
    RecordInputError
        If it has been begun anew already.
    """
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


def mode_of(rig: str, answers: AnswersBy, *, pilot: bool) -> Mode:
    """Return which kind of data a session makes: ``simulated`` as soon as anything in it is."""
    if rig == SIMULATED or answers != "window":
        return "simulated"
    return "pilot" if pilot else "real"
