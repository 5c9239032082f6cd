"""The parts of one sitting, real or simulated, behind the interfaces of the session."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

from modaltouch.planning import FeltSpeeds, Observer
from modaltouch.preflight import Preflight
from modaltouch.protocol import ANSWERS, ANSWERS_WITH_NONE, Schedule, Trial
from modaltouch.record import SessionFolder
from modaltouch.rig import Rig, open_rig, same_process, start_simulator
from modaltouch.session.setup import Setup
from modaltouch.system import SYSTEM_CLOCK, Clock, VirtualClock
from modaltouch.window import (
    Answerer,
    AnswersBy,
    AnswerWindow,
    Masking,
    NoMasking,
    Tick,
    WindowOptions,
    open_masking,
    open_window,
)

if TYPE_CHECKING:
    from modaltouch.rig import Simulator

SIMULATED = "simulated"
"""What stands in a rig's place for the digital twin."""


class SessionParts:
    """The parts of one sitting, opened when the sitting asks for them.

    Parameters
    ----------
    preflight : Preflight
        The checked experiment.
    place : SessionFolder
        Where it is recorded.
    seed : int
        Seed of the study.
    rig : str
        ``simulated`` or a VISA address.
    answers : str
        ``window``, ``robot`` or ``simulated``.
    window_options : WindowOptions or None
        How the answer window is opened, where there is one.
    observer : Observer
        Population that a simulated participant is drawn from.
    after : float
        What a virtual clock must not read less than: the record's, where one is continued [s].
    """

    def __init__(
        self,
        preflight: Preflight,
        place: SessionFolder,
        *,
        seed: int,
        rig: str,
        answers: AnswersBy,
        window_options: WindowOptions | None,
        observer: Observer,
        after: float = 0.0,
    ) -> None:
        self._preflight = preflight
        self._place = place
        self._seed = seed
        self._rig = rig
        self._answers = answers
        self._window_options = window_options
        self._observer = observer
        self._simulator: Simulator | None = None
        # Nobody waits for a simulated participant before the twin in this very process.
        is_virtual = rig == SIMULATED and answers == "simulated"
        self.clock: Clock = VirtualClock(max(SYSTEM_CLOCK.now(), after)) if is_virtual else SYSTEM_CLOCK

    def setup(self, schedule: Schedule) -> Setup:
        """Return what the sitting is made of, with the participant's trials."""
        facts: dict[str, Any] = {"seed": self._seed, "rig_choice": self._rig, "answers_choice": self._answers}
        if self._answers != "window":
            facts["observer"] = self._observer.as_dict()
        opened = self.open_rig, self.open_window, self.open_masking
        return Setup(self._preflight, schedule, self._place, *opened, facts, clock=self.clock)

    @contextmanager
    def open_rig(self, log: Callable[..., None]) -> Iterator[Rig]:
        """Open the driver, on the twin's address where no other is given."""
        apparatus, address = self._preflight.experiment.apparatus, self._rig
        with ExitStack() as stack:
            options: dict[str, Any] = {}
            if self._rig == SIMULATED:
                self._simulator = stack.enter_context(start_simulator(apparatus, clock=self.clock))
                address = self._simulator.address
            if isinstance(self.clock, VirtualClock):
                options = {"clock": self.clock, "start_guard": same_process(self.clock)}
            yield stack.enter_context(open_rig(address, apparatus, log=log, **options))

    def open_window(self, tick: Tick, log: Callable[..., None]) -> AnswerWindow:
        """Open the answer window, with a simulated participant where no person answers."""
        experiment = self._preflight.experiment
        zones = experiment.apparatus.zones
        return open_window(
            self._answers,
            experiment.protocol,
            experiment.texts,
            zones=tuple(sorted(zones, key=lambda name: zones[name].centre_mm)),
            tick=tick,
            log=log,
            answerer=None if self._answers == "window" else self._answerer(),
            options=self._window_options,
            clock=self.clock,
        )

    def open_masking(self, log: Callable[..., None]) -> Masking:
        """Open the masking noise that the protocol wants, where there is a person to hear it."""
        experiment = self._preflight.experiment
        section = experiment.protocol.masking
        if self._answers != "window":
            return NoMasking("a simulated participant hears nothing" if section is not None else "")
        return open_masking(section, experiment.apparatus, log)

    def _answerer(self) -> Answerer:
        who = self._seed, self._place.participant, self._place.session
        person = self._observer.draw(Schedule.random_generator(*who, "observer"))
        offers_none = self._preflight.experiment.protocol.answers.offers_none
        answers = ANSWERS_WITH_NONE if offers_none else ANSWERS
        return Answerer(person, self._felt, Schedule.random_generator(*who, "answers"), answers)

    def _felt(self, trial: Trial) -> tuple[float, float]:
        """Return what the two fingers feel: on the twin where there is one, else as predicted."""
        predicted = self._preflight.speeds(trial)
        peaks = predicted
        if self._simulator is not None:
            left, right = self._simulator.felt_velocity(trial.condition.pair)
            peaks = float(left), float(right)
        if self._observer.front_end == "peak" or trial.condition.is_catch:
            return peaks
        # The twin tells peaks; what else is felt follows the predicted history, at the twin's size.
        level, sense = trial.condition.velocity_mm_s * 1e-3, self._senses[trial.condition.stimulus]
        left, right = (
            sense.at(zone, level) * peak / expected
            for zone, peak, expected in zip(trial.condition.pair, peaks, predicted, strict=True)
        )
        return left, right

    @cached_property
    def _senses(self) -> dict[str, FeltSpeeds]:
        """What the observer's front end makes of the predicted velocities of each stimulus."""
        zones = self._preflight.experiment.apparatus.zones
        centres = {name: zone.centre_mm * 1e-3 for name, zone in zones.items()}
        parts = self._preflight.parts.items()
        return {name: FeltSpeeds(part.stimulus, centres, self._observer.front_end) for name, part in parts}
