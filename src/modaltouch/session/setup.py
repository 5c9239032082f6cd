"""Setup of a sitting, new or resumed: open instrument, window and record, then run the trial loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Self

from modaltouch import protocol
from modaltouch.preflight import Preflight, estimated_duration
from modaltouch.protocol import InputError, Schedule
from modaltouch.record import (
    RecordError,
    RecordInputError,
    Session,
    SessionFolder,
    SessionLog,
    read_session,
)
from modaltouch.rig import Rig, instrument_of
from modaltouch.session.console import Console, Experimenter
from modaltouch.session.events import boot_id, describe_ending, describe_start, how_to_continue
from modaltouch.session.loop import SessionRun, conduct
from modaltouch.system import SYSTEM_CLOCK, Clock, Interruption, commit, versions
from modaltouch.window import AnswerWindow, Event, Masking

if TYPE_CHECKING:
    from modaltouch.lab import Prober
    from modaltouch.session.markers import Markers


@dataclass(frozen=True)
class Setup:
    """The parts of a sitting.

    Attributes
    ----------
    preflight : Preflight
        The checked experiment.
    schedule : Schedule
        The participant's trials.
    place : SessionFolder
        Folder of the record.
    open_rig : callable
        Opens the instrument as a context, given a function that receives each exchange with it.
    open_window : callable
        Opens the answer window, given the tick to call while waiting and a function that receives its events.
    open_masking : callable
        Opens the masking noise, given a function that receives its events.
    facts : dict
        Further facts for the start record: rig, answers, seed.
    replaces : SessionFolder or None
        Interrupted session that this one starts over.
    n_answered : int
        Trials of an interrupted session whose answers are kept.
    drawn_as : int or None
        Number of the session without restarted ones, if the records on disk decide the participant's turn
        (`schedule.balance`); `schedule` is then redrawn when the log is created.
    console : Console
        Shows the experimenter the state of the session and takes requests; closed by the caller.
    clock : Clock
        Clock of window, instrument and record, real or virtual.
    open_prober : callable or None
        Opens the prober of fingers, given the open instrument; None if fingers are not measured.
    open_markers : callable
        Opens the marker stream for other devices, if any.
    """

    preflight: Preflight
    schedule: Schedule
    place: SessionFolder
    open_rig: Callable[[Callable[..., None]], AbstractContextManager[Rig]]
    open_window: Callable[[Callable[[], Event | None], Callable[..., None]], AnswerWindow]
    open_masking: Callable[[Callable[..., None]], Masking] = lambda log: Masking()
    facts: dict[str, Any] = field(default_factory=dict)
    replaces: SessionFolder | None = None
    n_answered: int = 0
    drawn_as: int | None = None
    console: Console = field(default_factory=Console)
    clock: Clock = SYSTEM_CLOCK
    open_prober: Callable[[Rig], AbstractContextManager[Prober]] | None = None
    open_markers: Callable[[], Markers | None] = lambda: None

    @property
    def to_ask(self) -> Mapping[str, Any]:
        """Unanswered questions about the participant: those of the protocol before the first session, then none."""
        fields = self.preflight.experiment.protocol.people
        if not fields or "people" in self.facts:
            return {}
        earlier = SessionFolder.logs_of(self.place.dataset / f"sub-{self.place.participant}")
        return {} if any("people" in Session.peek(log).start for log in earlier) else fields

    def with_people(self, answers: Mapping[str, float | str | None]) -> Self:
        """Return the setup with the participant's answers to `to_ask`.

        Raises
        ------
        RecordInputError
            If a required consent is refused; nothing may then be recorded.
        """
        for name, each in self.to_ask.items():
            if each.kind == "consent" and each.required and answers.get(name) != "yes":
                raise RecordInputError(f"no {name} was given: the session does not begin, and nothing is recorded")
        return replace(self, facts=self.facts | {"people": dict(answers)})


class EventBuffer:
    """Buffer between the events of instrument and window and the session log.

    Events are kept until the log exists. Exchanges with the instrument are collected and written as one line per step,
    since an fsync per command would take longer than the command.
    """

    def __init__(self) -> None:
        self.log: SessionLog | None = None
        """The log, once it is open."""
        self._early: list[tuple[str, dict[str, Any]]] = []
        self._exchanges: list[dict[str, Any]] = []
        self.listener: Callable[[dict[str, Any]], None] = lambda exchange: None
        """Called immediately with each exchange with the instrument."""

    def event(self, event: str, **facts: Any) -> None:
        """Write an event of the window, or keep it until the log exists."""
        if self.log is None:
            self._early.append((event, facts))
        else:
            self.log.append(event, **facts)

    def exchange(self, event: str, **facts: Any) -> None:
        """Keep an exchange with the instrument until `flush`."""
        self._exchanges.append({"what": event, **facts})
        self.listener({"event": "exchange", "what": event, **facts})

    def flush(self) -> None:
        """Write all kept events and exchanges."""
        if self.log is None:
            return
        early, self._early = self._early, []
        for event, facts in early:
            self.log.append(event, **facts)
        if self._exchanges:
            exchanges, self._exchanges = self._exchanges, []
            self.log.append("rig", exchanges=exchanges)


def begin(setup: Setup) -> Session:
    """Run a new session and return its record.

    Raises
    ------
    RecordError
        If the session exists already or cannot be written.
    RigError, WindowError, SessionStopped, Interrupted
        If the session ended early; the outputs are off and all answers are kept.
    """
    setup.place.refuse_existing()
    if setup.to_ask:
        raise RecordInputError(
            f"participant {setup.place.participant} has not been asked yet: {', '.join(setup.to_ask)} (section people)"
        )
    return sit(
        setup, lambda place, facts: SessionLog.create(place.log, "start", timed_by=setup.clock, **facts), "start"
    )


def sit(setup: Setup, open_log: Callable[[SessionFolder, dict[str, Any]], SessionLog], first: str) -> Session:
    """Run a sitting and return the record of the session.

    `open_log` opens the log in a folder, given the facts of its first line, whose event is `first`: ``start`` or
    ``resume``.
    """
    buffer = EventBuffer()
    seconds = estimated_duration(setup.preflight.experiment.protocol) * 60 / max(len(setup.schedule.trials), 1)
    experimenter = Experimenter(setup.console, buffer.event, seconds_per_trial=seconds)
    buffer.listener = experimenter.tell
    markers = setup.open_markers()
    with Interruption() as interruption, ExitStack() as stack:
        rig = stack.enter_context(setup.open_rig(buffer.exchange))
        setup = _of_generator(setup, rig)
        prober = None if setup.open_prober is None else stack.enter_context(setup.open_prober(rig))
        if prober is None:
            rig.load(*setup.preflight.bursts)

        def tick(*, window_waits: bool = True) -> Event | None:
            interruption.check()
            rig.heartbeat()
            return experimenter.attend(window_waits=window_waits)

        masking = stack.enter_context(setup.open_masking(buffer.event))
        window = stack.enter_context(setup.open_window(tick, buffer.event))
        if markers is not None:
            window.on_question = markers.send_question
            setup = replace(setup, facts=setup.facts | {"markers": markers.describe()})
        setup.place.describe_dataset(setup.preflight.experiment.protocol.title)
        with setup.place.hold_dataset():
            setup = _with_assigned_turn(setup)
            log = stack.enter_context(open_log(setup.place, _describe(setup, rig, window, masking, first)))
        buffer.log = log
        _follow(log, experimenter, markers, first)
        ending = {"reason": "finished"}
        try:
            setup.place.list_participants(log.events[0])
            masking.start()
            run = _session_run(setup, rig, window, log, buffer, partial(tick, window_waits=False), prober)
            conduct(replace(run, experimenter=experimenter, masking=masking))
        except BaseException as error:
            ending = describe_ending(error)
            if setup.place.log.exists():
                error.add_note(f"everything answered is kept; {how_to_continue(ending['reason'], setup.place.folder)}")
            raise
        finally:
            # Switch the outputs off first, then finish the record.
            rig.close()
            with suppress(RecordError):  # already reported
                masking.stop(hurry=ending["reason"] != "finished")
            _conclude(setup, log, buffer, ending)
            if ending["reason"] in ("rig fault", "record fault", "experimenter", "emergency stop"):
                window.dismiss()
    return read_session(setup.place.log)


def _follow(log: SessionLog, experimenter: Experimenter, markers: Markers | None, first: str) -> None:
    """Replay the record to the experimenter's console, then forward new events to it and to the markers."""
    begun = max(event["n"] for event in log.events if event["event"] == first)
    for event in log.events:
        experimenter.tell(event, replayed=event["n"] < begun)

    def tell(event: dict[str, Any]) -> None:
        if markers is not None:
            markers.follow(event)
        experimenter.tell(event)

    log.listener = tell


def _with_assigned_turn(setup: Setup) -> Setup:
    """Return the setup with the schedule of the turn assigned from the records on disk, if they decide it."""
    if setup.drawn_as is None:
        return setup
    from modaltouch.session.assignment import LEAST_FILLED, assign_group, assign_turn

    drawn, design = setup.schedule, setup.preflight.experiment.protocol
    if drawn.group_by == LEAST_FILLED:
        due, _ = assign_group(setup.place, design, drawn.seed)
        if due != drawn.group:
            raise RecordInputError(
                f"the group {drawn.group} for participant {drawn.participant}, but another session has taken that "
                f"place since; now {due} is due: begin again, or keep it with --group {drawn.group}"
            )
    turn, balance = assign_turn(setup.place, design, setup.drawn_as, drawn.group)
    turn = replace(turn, group=drawn.group, group_by=drawn.group_by)
    schedule = Schedule.draw_from(setup.preflight.findings, drawn.participant, drawn.seed, drawn.session, given=turn)
    return replace(setup, schedule=schedule, facts={**setup.facts, "balance": balance})


def _of_generator(setup: Setup, rig: Rig) -> Setup:
    """Return the setup for the connected generator; refuse one other than that of the calibration."""
    if problem := setup.preflight.findings.generator_problem(rig.identity):
        raise InputError([problem])
    instrument = instrument_of(setup.preflight.experiment.apparatus)
    if instrument.is_simulated(rig.identity) and setup.place.mode != "simulated":
        # The address may be that of a simulator, whose data must never be stored with real data.
        setup = replace(setup, place=replace(setup.place, mode="simulated"))
        setup.place.refuse_existing()
    return setup


def _session_run(
    setup: Setup,
    rig: Rig,
    window: AnswerWindow,
    log: SessionLog,
    buffer: EventBuffer,
    tick: Callable[[], Event | None],
    prober: Prober | None,
) -> SessionRun:
    done, schedule, preflight = log.session.answered, setup.schedule, setup.preflight

    def save_view() -> None:
        buffer.flush()
        log.write_view(setup.place)

    save_view()
    own, designs, probing = preflight.experiment.protocol, tuple(preflight.designs), None
    if prober is not None:
        from modaltouch.session.probing import Probing

        probing = Probing(preflight, prober, rig, window, log, setup.clock)
    # With measured fingers, the latest measurement determines the design.
    latest = probing or setup
    return SessionRun(
        protocol=own,
        trials=tuple(t for t in (*schedule.practice, *schedule.trials) if (t.practice, t.index) not in done),
        total=len(schedule.trials),
        levels=None if own.adaptive is None else protocol.Levels(own),
        speeds=lambda trial: latest.preflight.speeds(trial),
        which=probing.which if probing else lambda trial: designs.index(preflight.design_of(trial.condition)),
        played=lambda trial, level: latest.preflight.played(trial.condition, level),
        probing=probing,
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
        "boot": boot_id(),
    }
    return about if first == "resume" else {**describe_start(setup.preflight, setup.schedule, setup.place), **about}


def _conclude(setup: Setup, log: SessionLog, buffer: EventBuffer, ending: dict[str, str]) -> None:
    if ending["reason"] == "record fault":
        return  # the log accepts no further events
    buffer.flush()
    session = log.session
    log.append("stop", **ending, complete=session.complete, n_answered=session.n_answered)
    log.write_view(setup.place)
