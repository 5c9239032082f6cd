"""The answer window: leads one participant through a session on a display."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn, Self

from modaltouch.protocol import Protocol, Texts
from modaltouch.trial import Answer, Condition, Response, Trial
from modaltouch.window.events import Event
from modaltouch.window.interface import Log, Progress, SessionStopped, TrialInterrupted
from modaltouch.window.layout import lay_out
from modaltouch.window.pictures import Illustrator
from modaltouch.window.reading import Reader, describe_press, is_press
from modaltouch.window.stage import Display, Moment, Nobody, Sitter, Stage
from modaltouch.window.theme import Theme

DOUBLE_WINDOW = 0.05
"""A different answer this soon after the first flags the trial as double [s]."""
_SETTLE = 0.25
"""A press this soon after a screen appeared was meant for the one before [s]."""
_CONFIRMATION = 0.4
"""How long the chosen answer stays marked, at most [s]."""
_FAREWELL = 8.0
"""How long the last screen stays if nobody presses a key [s]."""


class ParticipantWindow:
    """Shows instructions, placements and questions, and takes answers from keys, clicks and touches.

    Parameters
    ----------
    display : Display
        The open window; closed by `close`.
    protocol : Protocol
        What is asked, and by which keys it is answered.
    texts : Texts
        Every word on the screen.
    zones : tuple of str
        Names of the beam's zones, from the participant's left.
    theme : Theme
        Colours.
    tick : callable
        Called about every millisecond; may raise.
    log : callable
        Takes the window's events for the record.
    screenshots : Path, optional
        Folder for one PNG of each kind of screen.
    robot : Sitter, optional
        Answers in a person's place, through the display's own event queue.
    """

    def __init__(
        self,
        display: Display,
        protocol: Protocol,
        texts: Texts,
        *,
        zones: tuple[str, ...],
        theme: Theme,
        tick: Callable[[], None],
        log: Log,
        screenshots: Path | None = None,
        robot: Sitter | None = None,
    ) -> None:
        self._display = display
        self._answers = protocol.answers
        self._n_practice = protocol.schedule.practice_trials
        self._texts = texts
        layout = lay_out(*display.size, zones)
        self._pictures = Illustrator(layout, theme, texts, protocol.answers, protocol.conditions.hand)
        self._stage = Stage(display, tick=tick, log=log, screenshots=screenshots, sitter=robot or Nobody())
        self._answered_by = "simulated" if robot else protocol.answers.given_by
        self._reader = Reader.of(protocol.answers, layout)
        self._current: tuple[Trial, Progress] | None = None
        conditions = protocol.conditions
        first = Condition(conditions.finger_conditions[0], *conditions.zone_pairs[0], 0.0)
        self._example = Trial(index=1, block=0, condition=first, practice=True)
        self._make_ready(self._example)

    def describe(self) -> dict[str, Any]:
        """Return size, backend and versions for the start record."""
        return {**self._display.describe(), "language": self._texts.language, "answered_by": self._answered_by}

    def welcome(self) -> None:
        """Show the instructions until the participant goes on."""
        self._go_on(lambda: self._pictures.welcome(self._example))
        self._go_on(lambda: self._pictures.answering(self._example))

    def place_fingers(self, trial: Trial) -> None:
        """Show which finger goes on which zone until it is confirmed."""
        self._make_ready(trial)
        self._go_on(lambda: self._pictures.placement(trial), trial)

    def announce(self, text: str) -> None:
        """Show one text of the protocol, ``practice`` or ``start``, until the participant goes on."""
        words = str(getattr(self._texts, text))
        self._go_on(lambda: self._pictures.page(text, words))

    def ask(self, trial: Trial, progress: Progress, *, onset: float, stop: Callable[[], None]) -> Response:
        """Show the trial and return the answer as soon as it is known.

        Raises
        ------
        TrialInterrupted
            If the trial was cut and must be offered again.
        SessionStopped
            If the session was ended.
        """
        answers = self._answers
        stops_first = answers.stimulus_until == "question"
        due = onset + max(answers.question_delay_s, answers.presentation_s if stops_first else 0.0)
        if trial.practice:
            progress = Progress(progress.number, max(self._n_practice, progress.number))
        self._current = (trial, progress)
        self._feel(trial, progress, stop, until=onset + answers.presentation_s if stops_first else due)
        if stops_first:
            stop()
            self._feel(trial, progress, stop, until=due)
        asked = self._stage.show(self._pictures.question(trial, progress), Moment("answer", trial, onset))
        # What is read now was pressed while the question was being drawn: it cannot answer it.
        for event in self._stage.poll_quietly():
            self._before_question(event, trial, stop)
        answer, event = self._await_answer(trial, stop)
        gap = self._stage.poll_gap
        stop()
        return Response(
            answer=answer,
            reaction_time=event.time - (asked if stops_first else onset),
            onset="question" if stops_first else "first_burst",
            answered_by=self._answered_by,
            device="key" if event.kind == "key" else "mouse",
            key=event.key or answer,
            double=self._watch_double(answer, event),
            question_after=asked - onset,
            time_uncertainty=gap,
        )

    def confirm(self, response: Response) -> None:
        """Show which answer was taken; it is on the disk."""
        if self._current is not None:
            self._stage.show(self._pictures.question(*self._current, chosen=response.answer), Moment())
        self._stage.write_notes()

    def wait(self, seconds: float) -> None:
        """Let the pause between two trials pass."""
        start = time.perf_counter()
        while time.perf_counter() < start + seconds:
            if self._current is not None and time.perf_counter() > start + _CONFIRMATION:
                self._stage.show(self._pictures.ready(*self._current), Moment())
            for event in self._stage.poll():
                if self._reader.interrupts(event):
                    self._pause(None, event)
                    return
                self._discard(event, "between trials")

    def rest(self, progress: Progress) -> None:
        """Show the break until the participant goes on."""
        self._go_on(lambda: self._pictures.page("rest", self._texts.rest, progress))

    def goodbye(self) -> None:
        """Thank the participant, until a key is pressed or some seconds have passed."""
        picture = self._pictures.page("goodbye", self._texts.goodbye, waits=False)
        shown = self._stage.show(picture, Moment("go_on"))
        while time.perf_counter() < shown + _FAREWELL:
            for event in self._stage.poll():
                if event.kind == "close" or (is_press(event) and event.time > shown + _SETTLE):
                    return

    def close(self) -> None:
        """Close the window; never raises."""
        self._display.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _make_ready(self, trial: Trial) -> None:
        """Draw the trial's pictures out of sight, so that none of them is late."""
        progress = Progress(1, 1)
        for picture in (
            self._pictures.placement(trial),
            self._pictures.feel(trial, progress),
            self._pictures.question(trial, progress),
            *(self._pictures.question(trial, progress, chosen=answer) for answer in self._pictures.layout.buttons),
        ):
            self._stage.prepare(picture)

    def _go_on(self, draw: Callable[[], Any], trial: Trial | None = None) -> None:
        """Show a picture until a key to go on or a click."""
        shown = self._stage.show(draw(), Moment("go_on", trial))
        while True:
            for event in self._stage.poll():
                if self._reader.pauses(event):
                    self._hold(trial, event)
                    shown = self._stage.show(draw(), Moment("go_on", trial))
                elif event.time < shown + _SETTLE:
                    self._discard(event, "as the screen appeared")
                elif event.kind == "click" or self._reader.goes_on(event):
                    return
                elif event.kind == "key":
                    self._stage.note("ignored", key=event.key)

    def _feel(self, trial: Trial, progress: Progress, stop: Callable[[], None], until: float) -> None:
        """Show the beam until a time; presses do not count yet."""
        if time.perf_counter() < until:
            self._stage.show(self._pictures.feel(trial, progress), Moment("nothing", trial))
        while time.perf_counter() < until:
            for event in self._stage.poll():
                self._before_question(event, trial, stop)

    def _before_question(self, event: Event, trial: Trial, stop: Callable[[], None]) -> None:
        if self._reader.interrupts(event):
            self._interrupt(trial, event, stop)
        self._discard(event, "before the question", trial)

    def _await_answer(self, trial: Trial, stop: Callable[[], None]) -> tuple[Answer, Event]:
        """Return the first answer and its event; what came after it is left to be read."""
        while True:
            events = self._stage.poll()
            for place, event in enumerate(events):
                if self._reader.interrupts(event):
                    self._interrupt(trial, event, stop)
                answer = self._reader.answer(event)
                if answer is not None:
                    self._stage.put_back(events[place + 1 :])
                    return answer, event
                if is_press(event):
                    self._stage.note("ignored", trial=trial.index, **describe_press(event))

    def _watch_double(self, answer: Answer, event: Event) -> bool:
        """Return whether a different answer comes within `DOUBLE_WINDOW`; nothing here may raise."""
        is_double = False
        rest: list[Event] = []
        while True:
            for other in self._stage.poll_quietly():
                second = self._reader.answer(other)
                if second is None:
                    rest.append(other)
                elif second != answer and other.time <= event.time + DOUBLE_WINDOW:
                    is_double = True
                    self._stage.note_later("double", first=answer, second=second, after_s=other.time - event.time)
            if time.perf_counter() > event.time + DOUBLE_WINDOW:
                self._stage.put_back(rest)
                return is_double
            time.sleep(0.002)

    def _interrupt(self, trial: Trial, event: Event, stop: Callable[[], None]) -> None:
        """Stop the stimulus, pause, and have the trial offered again."""
        stop()
        reason = "focus lost" if event.kind == "blur" else "escape"
        self._pause(trial, event)
        raise TrialInterrupted(reason)

    def _pause(self, trial: Trial | None, event: Event) -> None:
        """Pause, then give the fingers as much time to return as between two trials."""
        cut: Event | None = event
        while cut is not None:
            self._hold(trial, cut)
            cut = self._settle()

    def _hold(self, trial: Trial | None, event: Event) -> None:
        """Show the pause screen until the session goes on or ends."""
        if event.kind == "close":
            self._end("window closed")
        self._stage.note("focus_lost" if event.kind == "blur" else "pause", trial=trial.index if trial else None)
        began = time.perf_counter()
        shown = self._stage.show(self._pictures.pause(trial), Moment("go_on", trial))
        while True:
            for press in self._stage.poll():
                if press.kind == "close":
                    self._end("window closed")
                if press.time < shown + _SETTLE:
                    self._discard(press, "as the screen appeared", trial)
                elif self._reader.ends(press):
                    self._end("escape")
                elif self._reader.goes_on(press):
                    self._stage.note("continued", paused_s=round(press.time - began, 3))
                    return

    def _settle(self) -> Event | None:
        """Show the beam for the length of a pause between trials; return what cuts it short, or None."""
        if self._current is None:
            return None
        self._stage.show(self._pictures.ready(*self._current), Moment())
        end = time.perf_counter() + self._answers.pause_s
        while time.perf_counter() < end:
            for event in self._stage.poll():
                if self._reader.interrupts(event):
                    return event
                self._discard(event, "between trials")
        return None

    def _end(self, reason: str) -> NoReturn:
        self._stage.note("stopped", reason=reason)
        raise SessionStopped(reason)

    def _discard(self, event: Event, when: str, trial: Trial | None = None) -> None:
        if is_press(event):
            self._stage.note("discarded", when=when, trial=trial.index if trial else None, **describe_press(event))
