"""Assembly of a session from real or simulated parts; no other module distinguishes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from modaltouch import planning
from modaltouch.planning import Observer
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol import InputError, Protocol, Schedule, Trial, Turn
from modaltouch.record import RecordInputError, Session, SessionFolder
from modaltouch.rig import Generator, Rig
from modaltouch.session.setup import Setup, begin
from modaltouch.system import SYSTEM_CLOCK, Clock, VirtualClock
from modaltouch.window import Answerer, AnswerWindow, Event, Masking

if TYPE_CHECKING:
    from modaltouch.lab import Prober
    from modaltouch.rig import Simulator
    from modaltouch.session.markers import Markers
    from modaltouch.window import WindowOptions

AnswersBy = Literal["window", "simulated", "robot"]
"""A person at the window; a simulated participant without a window; one that types into the real window."""

SIMULATED = "simulated"
"""Address of the simulated rig."""


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
    group: str | None = None,
    any_gap: bool = False,
) -> Setup:
    """Return the setup of a new session.

    Parameters
    ----------
    preflight, participant
        The checked experiment and the participant id.
    session : int or None
        Number of the session; None for the participant's next.
    rig, answers, pilot, seed, results, window_options, observer
        As in `SessionParts` and on the command line.
    threshold_mm_s : float, optional
        The participant's threshold, if levels are calibrated by participant and it was measured in another way [mm/s].
    group : str, optional
        The participant's group; the one due if not given.
    any_gap : bool
        Whether to ignore the minimum time since the previous session.

    Raises
    ------
    RecordError
        If the participant id is not allowed, or the participant's next session does not exist or is not due.
    InputError
        If levels are calibrated by participant and the threshold is unknown, or no order meets the schedule's limits.
    """
    protocol = preflight.experiment.protocol
    place = SessionFolder(results, mode_of(rig, answers, pilot=pilot), protocol.protocol, participant, session or 1)
    drawn_as = place.session
    if session is None:
        from modaltouch.session.assignment import next_session

        place, drawn_as = next_session(place, protocol.schedule.n_sessions)
    given, preflight, gap = _on_occasion(preflight, place, drawn_as, seed, group, any_gap=any_gap)
    own_levels: dict[str, Any] = {}
    if threshold_mm_s is not None or protocol.conditions.sensation_levels is not None:
        from modaltouch.session.assignment import at_own_levels

        preflight, own_levels = at_own_levels(preflight, place, threshold_mm_s)
    parts = SessionParts(preflight, place, seed, rig, answers, window_options, observer or _usual(protocol, answers))
    setup = parts.setup(_drawn(preflight, participant, seed, drawn_as, given), own_levels | gap)
    if answers != "window" and (fields := setup.to_ask):
        rng = Schedule.random_generator(seed, participant, place.session, "people")
        setup = setup.with_people({name: each.draw(rng) for name, each in fields.items()})
    return replace(setup, drawn_as=drawn_as) if protocol.schedule.balance == "least_filled" else setup


def _drawn(preflight: Preflight, participant: str, seed: int, drawn_as: int, given: Turn | None) -> Schedule:
    """Draw a participant's schedule; refuse limits that no drawn order meets."""
    try:
        return Schedule.draw_from(preflight.findings, participant, seed, drawn_as, given=given)
    except InputError as error:
        error.add_note(f"this is the order of {participant}: another --seed draws another")
        raise


def _on_occasion(
    preflight: Preflight, place: SessionFolder, drawn_as: int, seed: int, group: str | None, *, any_gap: bool
) -> tuple[Turn | None, Preflight, dict[str, Any]]:
    """Return turn and preflight for the participant's group and the kind of session, and facts on the gap.

    The turn is None if it follows from the participant id.
    """
    schedule, groups = preflight.experiment.protocol.schedule, preflight.experiment.protocol.groups
    if not (groups or schedule.session_kinds or group):
        return None, preflight, {}
    from modaltouch.session.assignment import assign_group, is_early

    own, reason = assign_group(place, preflight.experiment.protocol, seed, group)
    kind = schedule.kind_of(drawn_as)
    early = is_early(place, preflight.experiment.protocol, drawn_as, datetime.now(UTC))
    if early and not any_gap:
        raise RecordInputError(early)
    facts = {"any_gap": True} if early else {}
    usual = Turn.of(place.participant, seed, drawn_as, groups)
    given = None if (own, reason) == (usual.group, usual.group_by) else replace(usual, group=own, group_by=reason)
    return given, preflight.at(own, "" if kind is None else kind.name), facts


def simulate_session(
    protocol: Path | str | Preflight,
    participant: str,
    results: Path | str = "results",
    *,
    seed: int = 1,
    observer: Observer | None = None,
    session: int = 1,
    threshold_mm_s: float | None = None,
) -> Session:
    """Run a session with a simulated participant, and return its record.

    Parameters
    ----------
    protocol : Path, str or Preflight
        Protocol file, name of a shipped protocol, or a preflight to share between sessions.
    participant : str
        Participant id.
    results : Path or str
        Results folder; the session is recorded in its simulated tree.
    seed : int
        Seed of the study.
    observer : Observer, optional
        Population from which the participant is drawn.
    session : int
        Number of the session; minimum gaps between sessions are ignored.
    threshold_mm_s : float, optional
        The participant's threshold, as for `wire_run`.

    Raises
    ------
    InputError
        With all faults of the protocol.
    RecordError
        If the session exists already or cannot be written.
    """
    preflight = protocol if isinstance(protocol, Preflight) else examine(protocol)
    return begin(
        wire_run(
            preflight.require(), participant, session=session, answers="simulated", seed=seed, results=Path(results),
            observer=observer, any_gap=True, threshold_mm_s=threshold_mm_s,
        )
    )  # fmt: skip


@dataclass
class SessionParts:
    """Parts of a sitting, opened on demand."""

    preflight: Preflight
    place: SessionFolder
    seed: int
    rig: str
    answers: AnswersBy
    window_options: WindowOptions | None
    observer: Observer
    after: float = 0.0
    """Lower bound of a virtual clock: the last time in the record of a resumed session [s]."""
    simulator: Simulator | None = None

    @cached_property
    def clock(self) -> Clock:
        """The machine's clock, or a virtual one if both rig and participant are simulated in this process."""
        is_virtual = self.rig == SIMULATED and self.answers == "simulated"
        return VirtualClock(max(SYSTEM_CLOCK.now(), self.after)) if is_virtual else SYSTEM_CLOCK

    def setup(self, schedule: Schedule, further: Mapping[str, Any]) -> Setup:
        """Return the setup of the sitting, with the participant's schedule and further facts for the record."""
        facts: dict[str, Any] = {"seed": self.seed, "rig_choice": self.rig, "answers_choice": self.answers}
        if self.answers != "window":
            facts["observer"] = self.observer.as_dict()
        return Setup(
            self.preflight,
            schedule,
            self.place,
            self.open_rig,
            self.open_window,
            self.open_masking,
            {**facts, **further},
            clock=self.clock,
            open_prober=self.open_prober if self.preflight.findings.measured else None,
            open_markers=self.open_markers,
        )

    @contextmanager
    def open_rig(self, log: Callable[..., None]) -> Iterator[Rig]:
        """Open the driver; start the twin first if the rig is simulated."""
        options: dict[str, Any] = {"address": self.rig, "clock": self.clock}
        with ExitStack() as stack:
            if self.rig == SIMULATED:
                from modaltouch.rig import Simulator

                who = self.seed, self.place.participant, self.place.session
                touched = self.preflight.findings.with_true_fingers(Schedule.random_generator(*who, "fingers"))
                follow = self.place.log if self.preflight.findings.measured else None
                self.simulator = stack.enter_context(Simulator(touched, clock=self.clock, follow=follow))
                options = self.simulator.driver_options
            yield stack.enter_context(Generator(apparatus=self.preflight.experiment.apparatus, log=log, **options))

    @contextmanager
    def open_prober(self, rig: Rig) -> Iterator[Prober]:
        """Open the prober on the vibrometer's scope, or on that of the twin if the rig is simulated."""
        from modaltouch.lab import Laboratory, Prober
        from modaltouch.rig import Scope

        apparatus, placements = self.preflight.experiment.apparatus, self.preflight.findings.placements
        expected = [] if placements is None else list(placements.all().values())
        opened = Scope.open(apparatus) if self.simulator is None else self.simulator.scope()
        with opened as scope:
            if self.simulator is not None:
                yield Prober(Laboratory(apparatus, rig, scope, "simulated", settling_time=0.0), expected)
            else:
                # The vibrometer is not re-aimed during a session.
                yield Prober(Laboratory(apparatus, rig, scope, "real"), expected)

    def open_window(self, tick: Callable[[], Event | None], log: Callable[..., None]) -> AnswerWindow:
        """Open the answer window, with a simulated participant unless a person answers."""
        experiment, answerer = self.preflight.experiment, None if self.answers == "window" else self._answerer()
        if answerer is not None and self.answers == "simulated":
            return answerer.open(experiment.protocol.answers, tick=tick, log=log, clock=self.clock)
        from modaltouch.window import WindowOptions

        return (self.window_options or WindowOptions()).open(
            experiment.protocol, experiment.texts, zones=experiment.apparatus.zone_spans,
            tick=tick, log=log, answerer=answerer, clock=self.clock,
        )  # fmt: skip

    def open_markers(self) -> Markers | None:
        """Open the marker stream if the protocol has one and the clock is real."""
        section = self.preflight.experiment.protocol.markers
        if section is None or not section.lsl or self.clock is not SYSTEM_CLOCK:
            return None
        from modaltouch.session.markers import Markers

        try:
            return Markers(f"{self.place.protocol}/{self.place.participant}/{self.place.session}", self.clock)
        except (ImportError, RuntimeError) as error:
            given, allowed = f"true, but pylsl cannot be used ({error})", "true if the extra `lsl` is installed"
            remedy = "run `pip install 'modaltouch[lsl]'`, or leave the section out"
            raise InputError([self.preflight.findings.problem(("markers", "lsl"), given, allowed, remedy)]) from error

    def open_masking(self, log: Callable[..., None]) -> Masking:
        """Open the masking noise if the protocol has it; it is silent unless a person answers."""
        experiment = self.preflight.experiment
        section = experiment.protocol.masking
        if section is None:
            return Masking()
        from modaltouch.window import MaskingNoise

        return MaskingNoise(section, experiment.apparatus).open(log, is_heard=self.answers == "window")

    def _answerer(self) -> Answerer:
        who = self.seed, self.place.participant, self.place.session
        person = self.observer.draw(Schedule.random_generator(*who, "observer"))
        section = self.preflight.experiment.protocol.answers
        rng = Schedule.random_generator(*who, "answers")
        return Answerer(person, self._felt, rng, section.offered, section.scale)

    def _felt(self, trial: Trial) -> tuple[float, ...]:
        """Return the felt speeds, those of the twin if there is one, else as predicted [m/s]."""
        peaks = predicted = self.preflight.speeds(trial)
        if self.simulator is not None:
            peaks = tuple(self.simulator.felt_velocity(trial.condition.zones).tolist())
        if self.observer.front_end == "peak" or trial.condition.is_catch:
            return peaks
        # The twin only provides peaks; other front ends use the predicted history, scaled to the twin's peak.
        level = self.preflight.played(trial.condition, trial.condition.velocity_mm_s) * 1e-3
        felt = self._felt_per_level[self.preflight.design_of(trial.condition)]
        return tuple(
            felt[zone] * level * peak / expected
            for zone, peak, expected in zip(trial.condition.zones, peaks, predicted, strict=True)
        )

    @cached_property
    def _felt_per_level(self) -> dict[str, dict[str, float]]:
        """Speed felt at each zone per unit of level, for each design, from the observer's front end [1]."""
        centres = {name: zone.centre_mm * 1e-3 for name, zone in self.preflight.experiment.apparatus.zones.items()}
        return {
            name: planning.felt_per_level(part.stimulus, centres, self.observer.front_end)
            for name, part in self.preflight.designs.items()
        }


def _usual(protocol: Protocol, answers: AnswersBy) -> Observer:
    """Return the default observer; `Observer()` is the shipped `paper`."""
    name = Observer.usual_name(protocol)
    return Observer() if name == "paper" or answers == "window" else Observer.read(name)


def mode_of(rig: str, answers: AnswersBy, *, pilot: bool) -> Literal["real", "pilot", "simulated"]:
    """Return the mode of a session, ``simulated`` if rig or answers are simulated."""
    if rig == SIMULATED or answers != "window":
        return "simulated"
    return "pilot" if pilot else "real"
