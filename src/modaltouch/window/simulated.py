"""A simulated participant: a psychophysical observer that answers, with no window."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from modaltouch.observer import Participant
from modaltouch.trial import ANSWERS, Answer, Response, Trial
from modaltouch.window.interface import Log, Progress, Tick, TrialInterrupted


@dataclass(frozen=True)
class Answerer:
    """Someone who answers by what the fingers feel.

    Attributes
    ----------
    participant : Participant
        Drawn from an observer model.
    felt : callable
        Peak speeds under the left and the right finger in a trial [m/s].
    generator : numpy.random.Generator
        Source of chance. It is never advanced: each trial has a stream of its own, so that a resumed session
        and a repeated trial get the same answers as an uninterrupted one.
    answers : tuple of Answer
        Answers that the protocol offers.
    """

    participant: Participant
    felt: Callable[[Trial], tuple[float, float]]
    generator: np.random.Generator
    answers: tuple[Answer, ...] = ANSWERS

    def answer(self, trial: Trial) -> tuple[Answer, float]:
        """Return the answer to a trial and its reaction time [s].

        Raises
        ------
        ValueError
            If the generator was not made from a seed sequence.
        """
        seed = self.generator.bit_generator.seed_seq
        if not isinstance(seed, np.random.SeedSequence):
            raise ValueError(
                f"given a generator seeded by {type(seed).__name__}; allowed: one with a SeedSequence, such as "
                "numpy.random.default_rng(seed)"
            )
        key = (*seed.spawn_key, int(trial.practice), trial.index)
        stream = np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=key))
        left, right = self.felt(trial)
        return self.participant.answer(left, right, trial.condition.finger_condition, stream, self.answers)


class SimulatedParticipant:
    """Answers every trial by an observer model.

    Parameters
    ----------
    answerer : Answerer
        Who answers.
    tick : callable
        Called at every step; may raise, and a wish to pause is obeyed.
    log : callable
        Takes the pauses for the record.
    stimulus_until : str
        ``answer``, or ``question`` where the stimulus stops before the question.
    waits : bool
        Whether reaction times and pauses really pass.
    """

    def __init__(
        self,
        answerer: Answerer,
        *,
        tick: Tick,
        log: Log = lambda event, **facts: None,
        stimulus_until: str = "answer",
        waits: bool = False,
    ) -> None:
        self._answerer = answerer
        self._ticks = tick
        self._log = log
        self._onset_is = "question" if stimulus_until == "question" else "first_burst"
        self._waits = waits

    def describe(self) -> dict[str, Any]:
        """Return the backend for the start record."""
        return {"backend": "simulated", "answered_by": "simulated", "waits": self._waits}

    def welcome(self, trial: Trial) -> None:
        """Read nothing."""
        self._tick()

    def place_fingers(self, trial: Trial) -> None:
        """Place the fingers at once."""
        self._tick()

    def settle(self, trial: Trial, progress: Progress) -> None:
        """Never lift a finger."""
        self._tick()

    def tell_stall(self) -> None:
        """Read nothing."""
        self._tick()

    def announce(self, text: str) -> None:
        """Read nothing."""
        self._tick()

    def ask(self, trial: Trial, progress: Progress, *, onset: float, stop: Callable[[], None]) -> Response:
        """Return the observer's answer."""
        answer, reaction_time = self._answerer.answer(trial)
        if self._pass(reaction_time):
            raise TrialInterrupted("experimenter")
        stop()
        return Response(
            answer=answer,
            reaction_time=reaction_time,
            onset=self._onset_is,
            answered_by="simulated",
            device="model",
        )

    def confirm(self, response: Response) -> None:
        """Look at nothing."""

    def give_feedback(self, response: Response, expected: Answer) -> None:
        """Learn nothing."""

    def wait(self, seconds: float) -> None:
        """Go on at once, unless time passes."""
        self._pass(seconds)

    def rest(self, progress: Progress) -> None:
        """Need no break."""
        self._tick()

    def goodbye(self) -> None:
        """Leave."""
        self._tick()

    def dismiss(self) -> None:
        """Leave."""

    def close(self) -> None:
        """Do nothing; there is no window."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _pass(self, seconds: float) -> bool:
        """Tick once, or for as long as the time takes; return whether a pause came between."""
        paused = self._tick()
        end = time.perf_counter() + seconds if self._waits else 0.0
        while time.perf_counter() < end:
            paused |= self._tick()
            time.sleep(1e-3)
        return paused

    def _tick(self) -> bool:
        """Tick, hold where the experimenter wishes it, and return whether that was so."""
        if self._ticks() != "pause":
            return False
        began = time.perf_counter()
        self._log("pause", trial=None, by="experimenter")
        while self._ticks() != "continue":
            time.sleep(1e-3)
        self._log("continued", paused_s=round(time.perf_counter() - began, 3))
        return True
