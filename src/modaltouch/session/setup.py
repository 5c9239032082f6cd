"""Sets up one sitting of one participant, new or resumed: instrument, window, record; then the one loop."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

from modaltouch.preflight import Preflight, estimated_duration
from modaltouch.protocol import InputError, Levels, Schedule
from modaltouch.record import (
    RecordError,
    Session,
    SessionFolder,
    SessionLog,
    check_view,
    describe_dataset,
    hold_dataset,
    list_participants,
    read_chain,
    read_session,
    refuse_existing,
    write_view,
)
from modaltouch.rig import Rig, is_simulated
from modaltouch.session.assignment import allot
from modaltouch.session.console.experimenter import Experimenter
from modaltouch.session.console.interface import Console, NoConsole
from modaltouch.session.console.status import Status
from modaltouch.session.event_buffer import EventBuffer
from modaltouch.session.events import describe_ending, describe_start
from modaltouch.session.loop import SessionRun, conduct
from modaltouch.session.resumption import begin_anew, examine_interruption, go_on, refuse_failed, refuse_old, way_on
from modaltouch.system import SYSTEM_CLOCK, Clock, Interruption, boot, commit, versions
from modaltouch.window import AnswerWindow, Masking, NoMasking, Tick, Wish

OpenRig = Callable[[Callable[..., None]], AbstractContextManager[Rig]]
"""Opens the instrument for a while, given a function that takes each exchange with it."""

OpenWindow = Callable[[Tick, Callable[..., None]], AnswerWindow]
"""Opens the answer window, given the tick it must call while it waits and a function that takes its events."""

OpenMasking = Callable[[Callable[..., None]], Masking]
"""Opens the masking noise, given a function that takes its events."""


_UNFORESEEN = ("rig fault", "record fault", "experimenter", "emergency stop")
"""Endings that the participant has to be told of."""


@dataclass(frozen=True)
class Setup:
    """What a sitting is made of.

    Attributes
    ----------
    preflight : Preflight
        The checked experiment.
    schedule : Schedule
        The participant's trials.
    place : SessionFolder
        Where it is recorded.
    open_rig, open_window, open_masking : callable
        How the instrument, the window and the masking noise are opened.
    facts : dict
        What else the start record should say: rig, answers, seed.
    replaces : SessionFolder or None
        The interrupted session that this one begins anew.
    drawn_as : int or None
        Where the records on disk decide the participant's turn (`schedule.balance`): the number of the session in
        the participant's own count. `schedule` is then drawn as the session's log is created.
    on_progress : callable
        Called with (answered, total) after each trial.
    console : Console
        Shows the experimenter how the session stands, and takes requests; closed by whoever opened it.
    clock : Clock
        Of window, instrument and record: the machine's, or a virtual one.
    """

    preflight: Preflight
    schedule: Schedule
    place: SessionFolder
    open_rig: OpenRig
    open_window: OpenWindow
    open_masking: OpenMasking = lambda log: NoMasking()
    facts: dict[str, Any] = field(default_factory=dict)
    replaces: SessionFolder | None = None
    drawn_as: int | None = None
    on_progress: Callable[[int, int], None] = lambda answered, total: None
    console: Console = field(default_factory=NoConsole)
    clock: Clock = SYSTEM_CLOCK


def begin(setup: Setup) -> Session:
    """Run a new session and return it as recorded.

    Raises
    ------
    RecordError
        If the session exists already or cannot be written.
    RigError, WindowError, SessionStopped, Interrupted
        Whatever ended it early; outputs are off and what was answered is kept.
    """
    refuse_existing(setup.place.log)
    return _sit(
        setup, lambda place, facts: SessionLog.create(place.log, "start", timed_by=setup.clock, **facts), "start"
    )


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
    chain = read_chain(place.log)
    session = Session(place.log, chain.events, chain.problems)
    if session.complete:
        return session if check_view(session, chain.checks).is_current and not session.problems else _mend(setup, place)
    recorded = session.start["schedule"]
    if recorded["order_hash"] != setup.schedule.order_hash:
        raise RecordError(
            f"{place.log}: its order has the hash {recorded['order_hash'][:12]}, this program draws "
            f"{setup.schedule.order_hash[:12]}; resume it with the version that began it "
            f"({session.start['versions']['modaltouch']})"
        )

    cut = examine_interruption(session, now=datetime.now(UTC), clock=setup.clock.now(), boot=boot())
    policy = setup.preflight.experiment.protocol.schedule.resume
    if setup.replaces is not None:
        old = setup.replaces
        refuse_existing(setup.place.log)
        return _sit(setup, lambda place, facts: begin_anew(old, place, cut, facts, setup.clock), "start")
    refuse_failed(session, cut)
    refuse_old(session, cut, policy.within_hours)
    return _sit(setup, lambda place, facts: go_on(place, setup.schedule, policy.at, cut, facts, setup.clock), "resume")


def _mend(setup: Setup, place: SessionFolder) -> Session:
    """Write what an interruption kept from a complete session: its last line, its BIDS view."""
    with SessionLog.reopen(place.log, timed_by=setup.clock) as log:
        session = Session(log.path, tuple(log.events), ())
        if not log.ends_well:
            log.append("stop", reason="finished", complete=True, n_answered=session.n_answered)
        write_view(place, Session(log.path, tuple(log.events), ()), log.head)
    return read_session(place.log)


def _sit(setup: Setup, open_log: Callable[[SessionFolder, dict[str, Any]], SessionLog], first: str) -> Session:
    journal = EventBuffer()
    levels = Levels(setup.preflight.experiment.protocol)
    seconds = estimated_duration(setup.preflight.experiment.protocol) * 60 / max(len(setup.schedule.trials), 1)
    experimenter = Experimenter(setup.console, journal.event, Status(seconds))
    journal.listener = experimenter.tell
    with Interruption() as interruption, ExitStack() as stack:
        rig = stack.enter_context(setup.open_rig(journal.exchange))
        _refuse_other_generator(setup.preflight, rig)
        if is_simulated(rig.identity) and setup.place.mode != "simulated":
            # An address may lead to a simulator; its data never land among real ones.
            setup = replace(setup, place=replace(setup.place, mode="simulated"))
            refuse_existing(setup.place.log)
        rig.load(*setup.preflight.bursts)

        def tick() -> Wish | None:
            interruption.check()
            rig.heartbeat()
            return experimenter.attend()

        masking = stack.enter_context(setup.open_masking(journal.event))
        window = stack.enter_context(setup.open_window(tick, journal.event))
        describe_dataset(setup.place, setup.preflight.experiment.protocol.title)
        with hold_dataset(setup.place):
            setup = _allotted(setup)
            log = stack.enter_context(open_log(setup.place, _describe(setup, rig, window, masking, first)))
        journal.open(log)
        begun = max(event["n"] for event in log.events if event["event"] == first)
        for event in log.events:
            experimenter.tell(event, replayed=event["n"] < begun)
        log.listener = experimenter.tell
        ending = {"reason": "finished"}
        try:
            list_participants(setup.place)
            masking.start()
            sitting = _sitting(setup, rig, window, log, journal, tick, levels)
            conduct(replace(sitting, experimenter=experimenter, masking=masking))
        except BaseException as error:
            ending = describe_ending(error)
            error.add_note(f"everything answered is kept; {way_on(ending['reason'], setup.place.folder)}")
            raise
        finally:
            # Off first, then written down: nothing on disk is worth a beam that still moves.
            rig.close()
            with suppress(RecordError):  # told where it came up first
                masking.stop(hurry=ending["reason"] != "finished")
            _conclude(setup, log, journal, ending)
            if ending["reason"] in _UNFORESEEN:
                window.dismiss()
    return read_session(setup.place.log)


def _allotted(setup: Setup) -> Setup:
    """Return the setup with the schedule that the records on disk give the participant, if they do."""
    if setup.drawn_as is None:
        return setup
    drawn, protocol = setup.schedule, setup.preflight.experiment.protocol
    allotment = allot(setup.place, protocol, setup.drawn_as)
    schedule = Schedule.draw(protocol, drawn.participant, drawn.seed, drawn.session, given=allotment.turn)
    return replace(setup, schedule=schedule, facts={**setup.facts, "balance": allotment.as_dict()})


def _refuse_other_generator(preflight: Preflight, rig: Rig) -> None:
    """Refuse a generator that the calibration was not made with: its amplitudes are its own.

    Raises
    ------
    InputError
        With the place in the calibration file.
    """
    problem = preflight.findings.generator_problem(rig.identity)
    if problem is not None:
        raise InputError([problem])


def _sitting(
    setup: Setup,
    rig: Rig,
    window: AnswerWindow,
    log: SessionLog,
    journal: EventBuffer,
    tick: Tick,
    levels: Levels,
) -> SessionRun:
    done = Session(log.path, tuple(log.events), ()).answered
    schedule = setup.schedule
    remaining = [trial for trial in (*schedule.practice, *schedule.trials) if (trial.practice, trial.index) not in done]
    total = len(schedule.trials)

    def save_view() -> None:
        journal.flush()
        session = Session(log.path, tuple(log.events), ())
        write_view(setup.place, session, log.head)
        setup.on_progress(session.n_answered, total)

    save_view()
    return SessionRun(
        protocol=setup.preflight.experiment.protocol,
        trials=tuple(remaining),
        total=total,
        levels=levels,
        speeds=setup.preflight.speeds,
        rig=rig,
        window=window,
        log=log,
        save_view=save_view,
        tick=tick,
        clock=setup.clock,
    )


def _describe(setup: Setup, rig: Rig, window: AnswerWindow, masking: Masking, first: str) -> dict[str, Any]:
    noise = masking.describe()
    about = {
        **setup.facts,
        **({"masking": noise} if noise is not None else {}),
        "rig": {"identity": rig.identity, "address": rig.address},
        "window": window.describe(),
        "versions": versions(),
        "commit": commit(),
        "boot": boot(),
    }
    return about if first == "resume" else {**describe_start(setup.preflight, setup.schedule, setup.place), **about}


def _conclude(setup: Setup, log: SessionLog, journal: EventBuffer, ending: dict[str, str]) -> None:
    if ending["reason"] == "record fault":
        return  # the log takes nothing more
    journal.flush()
    session = Session(log.path, tuple(log.events), ())
    log.append("stop", **ending, complete=session.complete, n_answered=session.n_answered)
    write_view(setup.place, session, log.head)
