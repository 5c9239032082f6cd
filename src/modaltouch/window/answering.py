"""Takes an answer from what a person does: the first one counts, unless the protocol has it confirmed."""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

from modaltouch.protocol import Trial
from modaltouch.window.display_loop import DisplayLoop, Moment
from modaltouch.window.interface import Event, Progress, SessionStopped
from modaltouch.window.meanings import Reader, describe_press, is_press
from modaltouch.window.pictures import Illustrator

SETTLE = 0.25
"""A press this soon after a screen appeared was meant for the one before [s]."""


DOUBLE_WINDOW = 0.05
"""A different answer this soon after the first flags the trial as double [s]."""


class AnswerTaker:
    """Waits for answers at one window, and holds the session in a pause.

    Parameters
    ----------
    loop, pictures, reader
        Where it is shown, what is shown, and what the events mean.
    """

    def __init__(self, loop: DisplayLoop, pictures: Illustrator, reader: Reader) -> None:
        self._loop = loop
        self._pictures = pictures
        self._reader = reader

    def hold(self, trial: Trial | None, event: Event) -> Event:
        """Show the pause screen until the session goes on, and return what made it go on.

        Raises
        ------
        SessionStopped
            If the session was ended, or the event was the close button.
        """
        if event.kind == "close":
            self._end("window closed")
        name = "focus_lost" if event.kind == "blur" else "pause"
        by = {"by": "experimenter"} if event.kind == "pause" else {}
        self._loop.note(name, trial=trial.index if trial else None, **by)
        began = self._loop.clock.now()
        shown = self._loop.show(self._pictures.pause(trial), Moment("go_on", trial))
        while True:
            for press in self._loop.poll():
                if press.kind == "close":
                    self._end("window closed")
                if press.kind != "continue" and press.time < shown + SETTLE:
                    self.discard(press, "as the screen appeared", trial)
                elif self._reader.ends(press):
                    self._end("escape")
                elif self._reader.goes_on(press):
                    self._loop.note("continued", paused_s=round(press.time - began, 3))
                    return press

    def discard(self, event: Event, when: str, trial: Trial | None = None) -> None:
        """Write down a press that does not count."""
        if is_press(event):
            self._loop.note("discarded", when=when, trial=trial.index if trial else None, **describe_press(event))

    def _end(self, reason: str) -> NoReturn:
        self._loop.note("stopped", reason=reason)
        raise SessionStopped(reason)

    def await_answer(
        self,
        trial: Trial | None,
        interrupt: Callable[[Event], NoReturn],
        times_out: Callable[[], bool] | None = None,
        since: float | None = None,
    ) -> tuple[str, Event] | None:
        """Return the first answer and its event, or None once time is up; what came after it is left to be read.

        Parameters
        ----------
        trial : Trial
            What is asked.
        interrupt : callable
            Called with an event that cuts the trial; raises.
        times_out : callable, optional
            Asked at every poll whether the time for an answer is up.
        since : float, optional
            When the question came; the picture that is on if not given [s].
        """
        while True:
            events = self._loop.poll()
            for place, event in enumerate(events):
                if self._reader.interrupts(event):
                    interrupt(event)
                if event.kind == "answer" and event.time < (since or self._loop.shown):
                    # Typed at the console before the question came, and on its way since.
                    self._loop.note("discarded", when="before the question", **describe_press(event))
                    continue
                answer = self._reader.answer(event)
                if answer is not None:
                    self._loop.put_back(events[place + 1 :])
                    return answer, event
                if is_press(event):
                    self._loop.note("ignored", trial=trial.index if trial else None, **describe_press(event))
            if times_out is not None and times_out():
                return None

    def await_confirmation(
        self,
        trial: Trial,
        progress: Progress,
        answer: str,
        event: Event,
        interrupt: Callable[[Event], NoReturn],
    ) -> tuple[str, Event]:
        """Return the answer that is chosen a second time, with the event that chose it first.

        Parameters
        ----------
        trial, progress
            What is asked, and where the session stands.
        answer, event
            What was chosen first.
        interrupt : callable
            Called with an event that cuts the trial; raises.
        """
        while True:
            picture = self._pictures.question(trial, progress, chosen=answer, confirmed=False)
            self._loop.show(picture, Moment("confirm", trial))
            chosen = self.await_answer(trial, interrupt)
            if chosen is None:
                continue
            again, press = chosen
            if again == answer and press.time < event.time + SETTLE:
                # A double click, or a foot switch whose contact bounces, decides nothing twice.
                self._loop.note("discarded", when="as it was chosen", trial=trial.index, **describe_press(press))
                continue
            if again == answer:
                return answer, event
            self._loop.note("changed", trial=trial.index, first=answer, to=again, after_s=press.time - event.time)
            answer, event = again, press

    def watch_double(self, answer: str, event: Event) -> bool:
        """Return whether a different answer comes within `DOUBLE_WINDOW`; nothing here may raise."""
        is_double = False
        rest: list[Event] = []
        while True:
            for other in self._loop.poll_quietly():
                second = self._reader.answer(other)
                if second is None:
                    rest.append(other)
                elif second != answer and other.time <= event.time + DOUBLE_WINDOW:
                    is_double = True
                    after = other.time - event.time
                    self._loop.note_later("double", first=answer, second=second, after_s=after)
            if self._loop.clock.now() > event.time + DOUBLE_WINDOW:
                self._loop.put_back(rest)
                return is_double
            self._loop.clock.sleep(0.002)
