"""Simulated participant: a psychophysical observer that answers without a window."""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from modaltouch.protocol import TIME_OUT, AnswerList, AnswersSection, Response, ScaleSection, Trial
from modaltouch.system import SYSTEM_CLOCK, Clock, VirtualClock
from modaltouch.window.interface import AnswerWindow, Log, Presentation, Tick, TrialInterrupted

Rated = tuple[str, float | None, float]
"""An answer, its number on a scale, and its reaction time [s]."""


@dataclass(frozen=True)
class Answerer:
    """A simulated observer that answers according to the felt speeds.

    Attributes
    ----------
    participant : modaltouch.planning.Participant
        Decides on answers, ratings and comparisons; any model with the same three methods will do.
    felt : callable
        Peak speeds under the fingers in a trial, from left to right [m/s].
    generator : numpy.random.Generator
        Source of random numbers. It is never advanced: each trial has a separate stream, so that a resumed session and
        repeated trials get the same answers as an uninterrupted session.
    """

    participant: Any
    felt: Callable[[Trial], tuple[float, ...]]
    generator: np.random.Generator
    answers: AnswerList = field(default_factory=lambda: AnswerList.of({}))
    scale: ScaleSection | None = None
    _intervals: list[tuple[float, ...]] = field(default_factory=list)
    _remembered: dict[Trial, tuple[float, ...]] = field(default_factory=dict, repr=False)

    def feel(self, trial: Trial, interval: int) -> None:
        """Store the felt speeds of an interval (from 1) before the last one of a trial."""
        self._intervals[interval - 1 :] = [self.felt(trial)]

    def answer(self, trial: Trial) -> tuple[str, float]:
        """Return the answer to a trial and its reaction time [s], given the currently felt stimulus."""
        speeds, stream = self._feel(trial), self._stream(int(trial.practice), trial.index)
        if self._intervals and any(answer.interval for answer in self.answers):
            intervals = [*self._intervals, speeds]
            return cast("tuple[str, float]", self.participant.compare(intervals, stream, self.answers))
        # A single finger counts as two that feel the same, and can only detect a stimulus.
        of = speeds[0], speeds[-1], trial.condition.finger_condition
        return cast("tuple[str, float]", self.participant.answer(*of, stream, self.answers, *speeds[1:-1]))

    def first(self, trial: Trial) -> Rated:
        """Return the answer to the first question of a trial, in the form of `rate`."""
        if self.scale is not None:
            return self.rate(trial, self.scale, self.answers.names)
        answer, reaction_time = self.answer(trial)
        return answer, None, reaction_time

    def rate(self, trial: Trial | None, scale: ScaleSection | None, names: Iterable[str], name: str = "") -> Rated:
        """Return the answer to a question about strength, its number on a scale, and the reaction time [s].

        A stronger vibration gives a larger number, or a later answer in the list. Without a trial, all are equally
        likely.

        Parameters
        ----------
        trial : Trial or None
            The presented trial, if any.
        scale : ScaleSection or None
            The scale; None for a list of answers.
        names : iterable of str
            The answers.
        name : str
            Name of a further question; empty for the first.
        """
        number, listed = zlib.crc32(name.encode()), list(names)
        if trial is None:
            stream = self._stream(2, 0, number)
            share, reaction_time = float(stream.random()), self.participant.rate((0.0,), stream)[1]
        else:
            stream = self._stream(int(trial.practice), trial.index, number)
            # Further questions come when the beam is at rest, so use the stored speeds.
            speeds = self._remembered.get(trial) if name else None
            share, reaction_time = self.participant.rate(speeds or self._feel(trial), stream)
        if scale is not None:
            return listed[0], scale.at(share), reaction_time
        return listed[int(share * len(listed))], None, reaction_time

    def open(self, section: AnswersSection, *, tick: Tick, log: Log, clock: Clock) -> AnswerWindow:
        """Return the simulated answer window, in which this observer answers according to a protocol's section."""
        before = section.question_delay_s if section.stimulus_until == "answer" else 0.0
        return SimulatedParticipant(
            self, tick=tick, log=log, stimulus_until=section.stimulus_until, after_longest=section.after_longest,
            time_out=before + (section.time_out_s or math.inf), clock=clock,
        )  # fmt: skip

    def _feel(self, trial: Trial) -> tuple[float, ...]:
        """Return the currently felt speeds, and store them for this trial."""
        self._remembered.clear()
        return self._remembered.setdefault(trial, self.felt(trial))

    def _stream(self, *key: int) -> np.random.Generator:
        """Return the random generator of an answer, spawned from the seed of `generator`."""
        seed = cast("np.random.SeedSequence", self.generator.bit_generator.seed_seq)
        return np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, *key)))


class SimulatedParticipant(AnswerWindow):
    """Answer window of an observer model.

    It ticks every `step` seconds: every 1 ms if not given, or 10 ms on a virtual clock. `stimulus_until` and
    `after_longest` are those of the protocol; `time_out` is the longest reaction time [s].
    """

    def __init__(
        self,
        answerer: Answerer,
        *,
        tick: Tick,
        log: Log = lambda event, **facts: None,
        stimulus_until: str = "answer",
        after_longest: str = "ask",
        time_out: float = math.inf,
        clock: Clock = SYSTEM_CLOCK,
        step: float | None = None,
    ) -> None:
        self._answerer = answerer
        self._ticks = tick
        self._log = log
        self._onset_is = "question" if stimulus_until == "question" else "first_burst"
        self._after_longest, self._time_out = after_longest, time_out
        self._clock = clock
        self._step = step or (1e-2 if isinstance(clock, VirtualClock) else 1e-3)

    def describe(self) -> dict[str, Any]:
        """Return the backend for the start record."""
        return {"backend": "simulated", "answered_by": "simulated"}

    def _look(self, *shown: object, **named: object) -> None:
        self._tick()

    welcome = place_fingers = show_stall = announce = goodbye = _look

    def settle(self, trial: Trial, progress: tuple[int, int], lead: float = 0.0) -> float:
        """Return at once, since `wait` has passed."""
        self._tick()
        return self._clock.now() + lead

    def feel(self, trial: Trial, progress: tuple[int, int], presentation: Presentation, until: float) -> None:
        """Store the felt speeds of an interval, and wait for the interval and the gap after it."""
        self._answerer.feel(trial, presentation.interval)
        self._pass_until(presentation.ends, presentation)
        presentation.stop()
        self._pass_until(until, presentation)

    def ask(self, trial: Trial, progress: tuple[int, int], presentation: Presentation) -> Response:
        """Return the observer's answer once its reaction time has passed."""
        answer, value, reaction_time = self._answerer.first(trial)
        stops_first = self._onset_is == "question"
        start = presentation.ends if stops_first else presentation.onset
        if stops_first:
            self._pass_until(start, presentation)
            presentation.stop()
        limit = math.inf if stops_first or self._after_longest != "time_out" else presentation.ends - start
        limit = min(limit, self._time_out)
        if not stops_first and start + reaction_time > presentation.ends:
            self._pass_until(presentation.ends, presentation)
            presentation.stop()
        self._pass_until(start + min(reaction_time, limit), presentation)
        presentation.end()
        return _respond(answer, value, reaction_time, limit, self._onset_is)

    def ask_further(self, name: str, asked: AnswersSection, trial: Trial | None = None) -> Response:
        """Return the observer's answer to a further question once its reaction time has passed."""
        answer, value, reaction_time = self._answerer.rate(trial, asked.scale, asked.offered.names, name)
        limit = asked.time_out_s or math.inf
        self._pass(min(reaction_time, limit))
        return _respond(answer, value, reaction_time, limit, "question")

    def _pass_until(self, instant: float, presentation: Presentation) -> None:
        if self._pass(instant - self._clock.now()):
            presentation.stop()
            raise TrialInterrupted("experimenter")

    def wait(self, seconds: float) -> None:
        """Wait for the pause between two trials."""
        self._pass(seconds)

    show_measuring = wait

    def _pass(self, seconds: float) -> bool:
        """Wait while ticking, and return whether a pause intervened."""
        paused = self._tick()
        end = self._clock.now() + seconds
        while (left := end - self._clock.now()) > 0:
            self._clock.sleep(min(left, self._step))
            paused |= self._tick()
        return paused

    def _tick(self) -> bool:
        """Tick, hold if the experimenter requests a pause, and return whether that was the case."""
        if not self._is_asked("pause"):
            return False
        began = self._clock.now()
        self._log("pause", trial=None, by="experimenter")
        while not self._is_asked("continue"):
            time.sleep(1e-3)
        self._log("continued", paused_s=round(self._clock.now() - began, 3))
        return True

    def _is_asked(self, kind: str) -> bool:
        event = self._ticks()
        return event is not None and event.kind == kind


def _respond(answer: str, value: float | None, reaction_time: float, limit: float, onset: str) -> Response:
    """Return the response, or a time-out, with the reaction time counted from an onset [s]."""
    if reaction_time > limit:
        return Response(TIME_OUT, limit, onset=onset, answered_by="simulated", device="none")
    return Response(answer, reaction_time, onset=onset, answered_by="simulated", device="model", value=value)
