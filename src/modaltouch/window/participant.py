"""Answer window: presents a session to the participant on a display."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from modaltouch.protocol import TIME_OUT, AnswersSection, Protocol, Response, Texts, Trial
from modaltouch.system import SYSTEM_CLOCK, Clock
from modaltouch.window.answering import SETTLE, AskedQuestion, chosen, is_press
from modaltouch.window.display_loop import DisplayLoop, Moment, Robot
from modaltouch.window.interface import (
    POLL_INTERVAL,
    AnswerWindow,
    Event,
    Log,
    Presentation,
    Tick,
    TrialInterrupted,
)
from modaltouch.window.layout import Picture, Spans
from modaltouch.window.pictures import Illustrator
from modaltouch.window.screen import Screen, canonical_key

_CONFIRMATION = 0.4
"""Maximum time for which the chosen answer is shown [s]."""
_COUNTDOWN = (3, 2, 1)
"""Numbers counted down while hands return to the beam, in equal steps of the time available."""
_STALL = 2.0
"""Duration of the message about a busy computer [s]."""
_FEEDBACK = 1.5
"""Duration of practice feedback [s]."""
_DISMISSAL = 3.0
"""Duration of the screen of a session that ends early [s]."""
_FAREWELL = 8.0
"""Maximum duration of the last screen without a key press [s]."""


class ParticipantWindow(AnswerWindow):
    """Answer window that shows instructions, placements and questions, and takes answers from keys, clicks and touches.

    Parameters
    ----------
    display : Screen
        The open window; closed by `close`.
    protocol : Protocol
        The protocol, with its questions and keys.
    texts : Texts
        All texts on the screen.
    zones : mapping of str to (float, float)
        As `layout.Spans`.
    theme : str
        Name of the colours in `layout.THEMES`.
    tick : callable
        Called about every millisecond while the window waits; may raise, and returns the experimenter's request.
    log : callable
        Receives the window's events for the record, as ``log(event, **facts)``.
    screenshots : Path, optional
        Folder for one PNG of each kind of screen.
    robot : Robot, optional
        Answers in place of a person, through the display's event queue.
    clock : Clock
        Clock of the time stamps; shared with the display.
    """

    def __init__(
        self,
        display: Screen,
        protocol: Protocol,
        texts: Texts,
        *,
        zones: Spans,
        theme: str,
        tick: Tick,
        log: Log,
        screenshots: Path | None = None,
        robot: Robot | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._clock = clock
        self._display = display
        self._answers = protocol.answers
        self._n_practice = protocol.schedule.practice_trials
        self._n_intervals = 0 if protocol.intervals is None else protocol.intervals.number
        self._texts = texts
        self._theme = theme
        self._zones, self._design = zones, protocol.conditions
        self._loop = DisplayLoop(
            display,
            tick=tick,
            log=log,
            screenshots=screenshots,
            robot=robot,
            emergency_keys=frozenset(map(canonical_key, protocol.answers.emergency_keys)),
            clock=clock,
        )
        self._answered_by = "simulated" if robot else ""
        self._first = self._asking(protocol.answers)
        self._pictures, self._reader = self._first.pictures, self._first.reader
        self._current: tuple[Trial, tuple[int, int]] | None = None
        self._answered, self._by_hand, self._onset = -math.inf, True, 0.0
        self._double: dict[str, Any] = {}

    def describe(self) -> dict[str, Any]:
        """Return size, backend and versions for the start record."""
        return {
            **self._display.describe(),
            "theme": self._theme,
            "language": self._texts.language,
            "answered_by": self._answered_by,
        }

    def welcome(self, trial: Trial) -> None:
        """Show the instructions until the participant continues, and prepare the first trial meanwhile."""
        self._loop.show(self._pictures.welcome(trial))
        self._make_ready(trial)
        self._go_on(lambda: self._pictures.welcome(trial))
        self._go_on(lambda: self._pictures.answering(trial))

    def place_fingers(self, trial: Trial) -> None:
        """Show which finger goes on which zone until confirmed."""
        self._make_ready(trial)
        self._go_on(lambda: self._pictures.placement(trial), trial)

    def settle(self, trial: Trial, progress: tuple[int, int], lead: float = 0.0) -> float:
        """Let the fingers come to rest before a stimulus, with a countdown if one was lifted to press."""
        self._current = (trial, self._count(trial, progress))
        while True:
            counts = self._by_hand and self._settles
            needed = self._answers.pause(trial.condition.finger_condition) if counts else self._answers.pause_s
            over = self._answered + needed
            now, end = self._clock.now(), over - lead
            if now >= end:
                return over
            steps = _COUNTDOWN if counts else (0,)
            # After a pause, the countdown restarts at the key that ended it.
            if all(
                self._rest_on(self._pictures.ready(*self._current, step), end - (end - now) * place / len(steps))
                for place, step in zip(reversed(range(len(steps))), steps, strict=True)
            ):
                return over

    def show_stall(self) -> None:
        """Show briefly that the computer was busy and that the last stimulus will be repeated."""
        self._rest_on(self._pictures.page("stalled", self._texts.stalled, waits=False), self._clock.now() + _STALL)
        self._answered = self._clock.now()

    def show_measuring(self, seconds: float) -> None:
        """Show for a time [s] that the beam is being measured; the screen then stays."""
        self._rest_on(self._pictures.page("measuring", self._texts.measuring, waits=False), self._clock.now() + seconds)

    def announce(self, text: str, progress: tuple[int, int] | None = None) -> None:
        """Show a text of the protocol, such as ``practice`` or ``rest``, until the participant continues."""
        self._go_on(lambda: self._pictures.page(text, str(getattr(self._texts, text)), progress))

    def feel(self, trial: Trial, progress: tuple[int, int], presentation: Presentation, until: float) -> None:
        """Show the number of the current interval, then the beam alone."""
        self._current = (trial, self._count(trial, progress))
        self._loop.attend(Moment("feel", trial, presentation.onset, presentation.interval))
        rest = self._pictures.ready(*self._current)
        self._feel(trial, rest, presentation, until=presentation.ends)
        presentation.stop()
        self._loop.show(rest)
        self._await(trial, presentation, until=until)

    def ask(self, trial: Trial, progress: tuple[int, int], presentation: Presentation) -> Response:
        """Show the trial and return the answer as soon as it is known.

        Raises
        ------
        TrialInterrupted
            If the trial was interrupted and must be repeated.
        SessionStopped
            If the session was ended.
        """
        answers, onset = self._answers, presentation.onset
        self._onset, stops_first = onset, answers.stimulus_until == "question"
        due = onset + answers.question_delay_s
        self._current = (trial, counted) = (trial, self._count(trial, progress))
        self._loop.attend(Moment("feel", trial, onset))
        question = self._pictures.question(trial, counted)
        if stops_first:
            self._feel(trial, question, presentation, until=presentation.ends)
            presentation.stop()
        self._feel(trial, question, replace(presentation, interval=0), until=due)
        asked = self._loop.show(question, Moment("answer", trial, onset))
        self.on_question(asked)
        flip_took = self._loop.flip_took
        # Events read now occurred while the question was being drawn and cannot answer it.
        for event in self._loop.poll_quietly():
            self._before_question(event, trial, presentation.stop)

        interrupt = partial(self._interrupt, trial, presentation.stop)
        draw = partial(self._pictures.question, trial, counted, confirmed=False)
        moment, is_over = Moment("answer", trial, onset), self._end_of(presentation, asked)
        taken, value = self._first.take(moment, draw, interrupt, is_over)
        gap = self._loop.poll_gap
        if taken is not None and value is None and answers.change_until_confirmed:
            taken = self._first.await_confirmation(trial, counted, *taken, interrupt, is_over)
        presentation.end()
        since, by = asked if stops_first else onset, self._answered_by or self._who(trial)
        response = self._first.respond(taken, value, since, by)
        self._answered = self._clock.now() if taken is None or answers.change_until_confirmed else taken[1].time
        self._double = self._first.watch_double(*taken) if taken is not None and value is None else {}
        return replace(
            response,
            onset="question" if stops_first else "first_burst",
            way=answers.way(trial.condition.finger_condition),
            double=bool(self._double),
            question_after=asked - onset,
            question_uncertainty=flip_took,
            time_uncertainty=gap,
        )

    def ask_further(self, name: str, asked: AnswersSection, trial: Trial | None = None) -> Response:
        """Ask a further question, after a trial or without one, and return its answer.

        Raises
        ------
        SessionStopped
            If the session was ended.
        """
        self._rest_on(None, self._answered + _CONFIRMATION)
        question = self._asking(asked)

        def draw(entered: str | None, *, confirmed: bool = False) -> Picture:
            if trial is None or self._current is None:
                return question.pictures.form(name, entered, confirmed=confirmed)
            return question.pictures.question(*self._current, chosen=entered, confirmed=confirmed, name=name)

        def interrupt(event: Event) -> NoReturn:
            self._hold(None, event)
            raise TrialInterrupted("asked again")

        while True:
            moment = Moment("answer", trial, asked=name)
            shown = self._loop.show(draw(None), moment)
            flip_took, limit = self._loop.flip_took, shown + (asked.time_out_s or math.inf)
            for event in self._loop.poll_quietly():
                self._first.discard(event, "before the question", trial)
            try:
                taken, value = question.take(moment, draw, interrupt, partial(self._is_past, limit))
            except TrialInterrupted:
                continue
            gap, by = self._loop.poll_gap, self._who(trial)
            response = question.respond(taken, value, shown, self._answered_by or by)
            self._answered = self._clock.now() if taken is None else taken[1].time
            if (given := chosen(response)) is not None:
                self._rest_on(draw(given, confirmed=True), self._answered + _CONFIRMATION)
            after = None if trial is None else shown - self._onset
            return replace(
                response, onset="question", question_after=after, question_uncertainty=flip_took, time_uncertainty=gap
            )

    def _is_past(self, instant: float) -> bool:
        return self._clock.now() >= instant

    def _asking(self, answers: AnswersSection) -> AskedQuestion:
        window = self._display.size, self._zones, self._theme
        return AskedQuestion(self._loop, Illustrator.of(*window, self._texts, answers, self._design))

    def _end_of(self, presentation: Presentation, asked: float) -> Callable[[], bool]:
        """Return a function to poll that stops the stimulus at its end and returns whether the answer timed out."""
        is_over = stops_first = self._answers.stimulus_until == "question"
        ends_with_it = not stops_first and self._answers.after_longest == "time_out"
        limit = asked + (self._answers.time_out_s or math.inf)

        def times_out() -> bool:
            nonlocal is_over
            if not is_over and self._clock.now() >= presentation.ends:
                is_over = True
                presentation.stop()
            return (is_over and ends_with_it) or self._clock.now() >= limit

        return times_out

    def confirm(self, response: Response) -> None:
        """Show the accepted answer, which is on disk."""
        self._by_hand = response.answer != TIME_OUT
        if self._current is not None:
            draw = partial(self._pictures.question, chosen=chosen(response)) if self._by_hand else self._pictures.ready
            self._loop.show(draw(*self._current), Moment())
        if self._double:
            self._loop.note("double", **self._double)

    def give_feedback(self, response: Response, expected: str) -> None:
        """Show briefly where the vibration was stronger, after a practice trial."""
        if self._current is not None and response.answer != TIME_OUT:
            picture = self._pictures.feedback(*self._current, response.answer, expected)
            self._rest_on(picture, self._clock.now() + _FEEDBACK)
            if self._settles:
                # The participant may put the finger back only after reading.
                self._answered = self._clock.now()

    def wait(self, seconds: float) -> None:
        """Wait for the pause between two trials, counted from the answer; the countdown of `settle` is part of it."""
        until = self._answered + seconds
        self._rest_on(None, min(until, self._answered + _CONFIRMATION))
        if self._clock.now() < until and self._current is not None and not self._settles:
            self._rest_on(self._pictures.ready(*self._current), until)

    def goodbye(self) -> None:
        """Thank the participant until a key press or for some seconds."""
        shown = self._loop.show(self._pictures.page("goodbye", self._texts.goodbye, waits=False), Moment("go_on"))
        while self._clock.now() < shown + _FAREWELL:
            for event in self._loop.poll():
                if event.kind == "close" or (is_press(event) and event.time > shown + SETTLE):
                    return

    def dismiss(self) -> None:
        """Show briefly that the session ends early; never raises, and does not tick."""
        # The display may be lost, too; the error that ended the session is the one to report.
        with contextlib.suppress(Exception):
            shown = self._loop.show(self._pictures.page("session_ended", self._texts.session_ended, waits=False))
            while self._clock.now() < shown + _DISMISSAL:
                self._loop.poll_quietly()
                self._clock.sleep(POLL_INTERVAL)

    def close(self) -> None:
        """Close the window; never raises."""
        self._display.close()

    def _make_ready(self, trial: Trial) -> None:
        """Prepare the trial's pictures, so that none is late."""
        progress, draw = (1, 1), self._pictures
        felt = [draw.feel(trial, progress, interval) for interval in range(self._n_intervals + 1)]
        for picture in (draw.placement(trial), *felt, draw.question(trial, progress)):
            self._display.prepare(picture)
        for answer in draw.layout.buttons if self._answers.scale is None else ():
            self._display.prepare(draw.question(trial, progress, chosen=answer))

    def _count(self, trial: Trial, progress: tuple[int, int]) -> tuple[int, int]:
        """Return the progress shown to the participant, with practice trials counted separately."""
        if not trial.practice:
            return progress
        n_trials = max(self._n_practice, 1)
        return (trial.index - 1) % n_trials + 1, n_trials

    def _who(self, trial: Trial | None) -> str:
        way = self._answers.given_by if trial is None else self._answers.way(trial.condition.finger_condition)
        return "experimenter" if way == "experimenter" else "participant"

    def _go_on(self, draw: Callable[[], Picture], trial: Trial | None = None) -> None:
        """Show a picture until a click or a key that continues."""
        shown = self._loop.show(draw(), Moment("go_on", trial))
        while True:
            for event in self._loop.poll():
                if self._reader.pauses(event):
                    self._hold(trial, event)
                    shown = self._loop.show(draw(), Moment("go_on", trial))
                elif event.time < shown + SETTLE:
                    self._first.discard(event, "as the screen appeared")
                elif event.kind == "click" or self._reader.goes_on(event):
                    self._note_press(event)
                    return
                elif event.kind == "key":
                    self._loop.note("ignored", key=event.key)

    def _rest_on(self, picture: Picture | None, until: float) -> bool:
        """Show a picture, or keep the current one, until a time; return False if a pause intervened.

        Presses do not count.
        """
        if picture is not None:
            self._loop.show(picture, Moment())
        while self._clock.now() < until:
            for event in self._loop.poll():
                if self._reader.interrupts(event):
                    self._hold(None, event)
                    return False
                self._first.discard(event, "between trials")
        return True

    def _hold(self, trial: Trial | None, event: Event) -> None:
        self._note_press(self._first.hold(trial, event))

    def _note_press(self, event: Event) -> None:
        """Store the time of a press, and whether it was at the window."""
        self._answered, self._by_hand = event.time, is_press(event)

    @property
    def _settles(self) -> bool:
        return self._current is not None and self._answers.settles(self._current[0].condition.finger_condition)

    def _feel(self, trial: Trial, ahead: Picture, presentation: Presentation, until: float) -> None:
        """Show the beam and the current interval until a time, and draw the next picture meanwhile."""
        if self._current is not None and self._clock.now() < until:
            self._loop.show(self._pictures.feel(*self._current, presentation.interval))
        self._loop.draw_ahead(ahead)
        self._await(trial, presentation, until)

    def _await(self, trial: Trial, presentation: Presentation, until: float) -> None:
        """Keep the current picture until a time; presses do not count."""
        while self._clock.now() < until:
            for event in self._loop.poll():
                self._before_question(event, trial, presentation.stop)

    def _before_question(self, event: Event, trial: Trial, stop: Callable[[], None]) -> None:
        if self._reader.interrupts(event):
            self._interrupt(trial, stop, event)
        self._first.discard(event, "before the question", trial)

    def _interrupt(self, trial: Trial, stop: Callable[[], None], event: Event) -> NoReturn:
        """Stop the stimulus, pause, and raise so that the trial is repeated."""
        stop()
        self._hold(trial, event)
        raise TrialInterrupted({"blur": "focus lost", "pause": "experimenter"}.get(event.kind, "escape"))
