"""Answers from events: interpretation of events, and selection of the answer to a question.

The answer is one of a list, of which the first counts unless the protocol requires confirmation, or a number on a
scale.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NoReturn

from modaltouch.protocol import TIME_OUT, AnswersSection, Response, Trial
from modaltouch.window.controls import Entry
from modaltouch.window.display_loop import DisplayLoop, Moment
from modaltouch.window.interface import Event, SessionStopped
from modaltouch.window.layout import Layout, Picture
from modaltouch.window.pictures import Illustrator
from modaltouch.window.screen import canonical_key

DEVICES = {"key": "key", "click": "mouse", "answer": "console", "continue": "console"}
"""Device of an answer, by the kind of its event."""


@dataclass(frozen=True)
class Reader:
    """Interpretation of events, according to the protocol's keys and the window's layout."""

    layout: Layout  # layout with the answer buttons
    answers: AnswersSection  # the protocol's keys

    @cached_property
    def keys(self) -> dict[str, str]:
        """Answer, or action on a scale, by key."""
        return {canonical_key(key): answer for answer, given in self.answers.actions.items() for key in given}

    def answer(self, event: Event) -> str | None:
        """Return the answer given by an event, or its action on a scale; None for other events."""
        match event.kind:
            case "key":
                return self.keys.get(event.key) or self.keys.get(event.digit)
            case "click":
                return self.layout.answer_at(event.x, event.y)
            # The key that moved a mark is up; continuing at the console confirms a number.
            case "release" if self.answers.scale:
                return "release"
            case "continue" if self.answers.scale:
                return "confirm"
        return event.answer

    def goes_on(self, event: Event) -> bool:
        """Return whether the event continues to the next screen: a key, or a request at the console."""
        named = {event.key, event.digit} & set(map(canonical_key, self.answers.continue_keys))
        return event.kind == "continue" or (event.kind == "key" and bool(named))

    def name(self, event: Event) -> str:
        """Return the protocol's name of the pressed key."""
        return event.digit if event.digit and event.key not in self.keys else event.key

    def pauses(self, event: Event) -> bool:
        """Return whether the event requests a pause or closes the window."""
        return event.kind in ("close", "pause") or (event.kind == "key" and event.key == AnswersSection.PAUSE_KEY)

    def interrupts(self, event: Event) -> bool:
        """Return whether the event interrupts a trial: a pause, or a loss of keyboard focus."""
        # The experimenter can also answer at the console.
        return (event.kind == "blur" and self.answers.given_by == "participant") or self.pauses(event)


def is_press(event: Event) -> bool:
    """Return whether the event is a key press or a click, or a key typed at the console."""
    return event.kind in ("key", "click", "answer")


def describe_press(event: Event) -> dict[str, Any]:
    """Return the facts of a press for the record."""
    if event.kind == "answer":
        return {"key": event.key, "device": DEVICES["answer"]}
    if event.kind == "key":
        return {"key": event.key}
    return {"click": [round(event.x, 3), round(event.y, 3)]}


SETTLE = 0.25
"""Time after the appearance of a screen within which a press is attributed to the previous screen [s]."""


DOUBLE_WINDOW = 0.05
"""Time after the first answer within which a different one flags the trial as double [s]."""


Taken = tuple[str, Event] | None
"""An answer with its event; None after a time-out."""


class AskedQuestion:
    """A question on the display: shows it, takes its answer, and handles pauses."""

    def __init__(self, loop: DisplayLoop, pictures: Illustrator) -> None:
        self.pictures = pictures
        self.reader = Reader(pictures.layout, pictures.answers)
        """Interprets the events."""
        self._loop = loop

    def hold(self, trial: Trial | None, event: Event) -> Event:
        """Show the pause screen until the session continues, and return the event that continued it.

        Raises
        ------
        SessionStopped
            If the session was ended, or the event was the close button.
        """
        if event.kind == "close":
            self._end("window closed")
        by = {"by": "experimenter"} if event.kind == "pause" else {}
        name = "focus_lost" if event.kind == "blur" else "pause"
        self._loop.note(name, trial=trial.index if trial else None, **by)
        began = self._loop.clock.now()
        shown = self._loop.show(self.pictures.pause(trial), Moment("go_on", trial))
        while True:
            for press in self._loop.poll():
                if press.kind == "close":
                    self._end("window closed")
                if press.kind != "continue" and press.time < shown + SETTLE:
                    self.discard(press, "as the screen appeared", trial)
                elif press.kind == "key" and press.key == AnswersSection.END_KEY:
                    self._end("escape")
                elif self.reader.goes_on(press):
                    self._loop.note("continued", paused_s=round(press.time - began, 3))
                    return press

    def discard(self, event: Event, when: str, trial: Trial | None = None) -> None:
        """Record a press that does not count."""
        if is_press(event):
            self._loop.note("discarded", when=when, trial=trial.index if trial else None, **describe_press(event))

    def _end(self, reason: str) -> NoReturn:
        self._loop.note("stopped", reason=reason)
        raise SessionStopped(reason)

    def await_answer(
        self,
        trial: Trial | None,
        interrupt: Callable[[Event], NoReturn],
        times_out: Callable[[], bool],
        since: float | None = None,
    ) -> Taken:
        """Return the first answer and its event, or None after a time-out; later events stay unread.

        Parameters
        ----------
        trial : Trial
            The trial.
        interrupt : callable
            Called with an event that interrupts the trial; raises.
        times_out : callable
            Called at every poll; returns whether the time for an answer is up.
        since : float, optional
            Time of appearance of the question; that of the current picture if not given [s].
        """
        while True:
            events = self._loop.poll()
            for place, event in enumerate(events):
                if self.reader.interrupts(event):
                    interrupt(event)
                if event.kind == "answer" and event.time < (since or self._loop.shown):
                    # Typed at the console before the question appeared.
                    self._loop.note("discarded", when="before the question", **describe_press(event))
                    continue
                answer = self.reader.answer(event)
                if answer is not None:
                    self._loop.put_back(events[place + 1 :])
                    return answer, event
                if is_press(event):
                    self._loop.note("ignored", trial=trial.index if trial else None, **describe_press(event))
            if times_out():
                return None

    def await_confirmation(
        self,
        trial: Trial,
        progress: tuple[int, int],
        answer: str,
        event: Event,
        interrupt: Callable[[Event], NoReturn],
        stop_at_end: Callable[[], bool],
    ) -> tuple[str, Event]:
        """Return the answer once it is chosen a second time, with the event of the first choice.

        A chosen answer no longer times out, but `stop_at_end` is called at every poll, to stop the stimulus at its end.
        """
        while True:
            picture = self.pictures.question(trial, progress, chosen=answer, confirmed=False)
            self._loop.show(picture, Moment("confirm", trial))
            chosen = self.await_answer(trial, interrupt, stop_at_end)
            if chosen is None:
                continue
            again, press = chosen
            if again == answer and press.time < event.time + SETTLE:
                # Ignore a double click or the contact bounce of a foot switch.
                self._loop.note("discarded", when="as it was chosen", trial=trial.index, **describe_press(press))
                continue
            if again == answer:
                return answer, event
            self._loop.note("changed", trial=trial.index, first=answer, to=again, after_s=press.time - event.time)
            answer, event = again, press

    def watch_double(self, answer: str, event: Event) -> dict[str, Any]:
        """Return the facts of a different answer within `DOUBLE_WINDOW`, empty if there is none; never raises."""
        double: dict[str, Any] = {}
        rest: list[Event] = []
        while True:
            for other in self._loop.poll_quietly():
                second = self.reader.answer(other)
                if second is None:
                    rest.append(other)
                elif second != answer and other.time <= event.time + DOUBLE_WINDOW:
                    double = double or {"first": answer, "second": second, "after_s": other.time - event.time}
            if self._loop.clock.now() > event.time + DOUBLE_WINDOW:
                self._loop.put_back(rest)
                return double
            self._loop.clock.sleep(0.002)

    def take(
        self,
        moment: Moment,
        draw: Callable[[str | None], Picture],
        interrupt: Callable[[Event], NoReturn],
        times_out: Callable[[], bool],
    ) -> tuple[Taken, float | None]:
        """Return the answer, and its number on a scale."""
        trial, scale, since = moment.trial, self.pictures.answers.scale, self._loop.shown
        if scale is None:
            return self.await_answer(trial, interrupt, times_out), None
        entry = Entry(scale, self.pictures.layout.buttons.get("line"))

        def show() -> None:
            self._loop.show(draw(entry.text or None), replace(moment, entered=entry.text))

        def creeps_or_times_out() -> bool:
            if entry.creeps(self._loop.clock.now()):
                show()
            return times_out()

        while (done := self.await_answer(trial, interrupt, creeps_or_times_out, since)) is not None:
            if entry.take(*done):
                return (self.pictures.answers.offered[0].name, done[1]), entry.value
            show()
        if entry.text:
            number = trial.index if trial else None
            self._loop.note("discarded", when="not confirmed in time", trial=number, entered=entry.text)
        return None, None

    def respond(self, taken: Taken, value: float | None, since: float, answered_by: str) -> Response:
        """Return the response, or a time-out, with the reaction time counted from `since` [s]."""
        if taken is None:
            return Response(TIME_OUT, self._loop.clock.now() - since, answered_by=answered_by, device="none")
        answer, event = taken
        device, key = DEVICES[event.kind], self.reader.name(event) or answer
        return Response(answer, event.time - since, answered_by=answered_by, device=device, key=key, value=value)


def chosen(response: Response) -> str | None:
    """Return the choice shown on the screen; None after a time-out."""
    given = response.answer if response.value is None else f"{response.value:.10g}"
    return None if response.answer == TIME_OUT else given
