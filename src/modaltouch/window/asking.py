"""One question at the window: shown, and answered by one of a list or by a number on a scale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NoReturn

from modaltouch.protocol import TIME_OUT, AnswersSection, Response
from modaltouch.window.answering import AnswerTaker
from modaltouch.window.display_loop import DisplayLoop, Moment
from modaltouch.window.interface import Event
from modaltouch.window.meanings import DEVICES, Reader
from modaltouch.window.pictures import Illustrator
from modaltouch.window.rating import Entry
from modaltouch.window.shapes import Picture

Taken = tuple[str, Event] | None
"""An answer with its event; None where time was up."""


@dataclass(frozen=True)
class AskedQuestion:
    """What shows one question and takes its answer.

    Attributes
    ----------
    answers : AnswersSection
        How it is answered.
    loop, pictures, reader, taker
        Where it is shown, what is shown, what events mean, and who waits for one.
    """

    answers: AnswersSection
    loop: DisplayLoop
    pictures: Illustrator
    reader: Reader
    taker: AnswerTaker

    @classmethod
    def prepare(cls, loop: DisplayLoop, pictures: Illustrator) -> AskedQuestion:
        """Return the question that the pictures show."""
        reader = Reader.of(pictures.answers, pictures.layout)
        return cls(pictures.answers, loop, pictures, reader, AnswerTaker(loop, pictures, reader))

    def take(
        self,
        moment: Moment,
        draw: Callable[[str | None], Picture],
        interrupt: Callable[[Event], NoReturn],
        times_out: Callable[[], bool],
    ) -> tuple[Taken, float | None]:
        """Return the answer, and the number where it is one on a scale.

        Parameters
        ----------
        moment : Moment
            What the participant faces.
        draw : callable
            The question with what stands on the scale.
        interrupt, times_out
            As for `AnswerTaker.await_answer`.
        """
        trial, scale, since = moment.trial, self.answers.scale, self.loop.shown
        if scale is None:
            return self.taker.await_answer(trial, interrupt, times_out), None
        entry = Entry(scale, self.pictures.layout.buttons.get("line"))

        def show() -> None:
            self.loop.show(draw(entry.text or None), replace(moment, entered=entry.text))

        def creeps_or_times_out() -> bool:
            if entry.creeps(self.loop.clock.now()):
                show()
            return times_out()

        while (done := self.taker.await_answer(trial, interrupt, creeps_or_times_out, since)) is not None:
            if entry.take(*done):
                return (self.answers.offered[0].name, done[1]), entry.value
            show()
        return None, None

    def respond(self, taken: Taken, value: float | None, since: float, answered_by: str) -> Response:
        """Return what was answered, or that time was up, counted from `since` [s]."""
        if taken is None:
            return Response(TIME_OUT, self.loop.clock.now() - since, answered_by=answered_by, device="none")
        answer, event = taken
        device, key = DEVICES[event.kind], self.reader.name(event) or answer
        return Response(answer, event.time - since, answered_by=answered_by, device=device, key=key, value=value)


def chosen(response: Response) -> str | None:
    """Return what the screen shows as chosen; None where time was up."""
    given = response.answer if response.value is None else f"{response.value:.10g}"
    return None if response.answer == TIME_OUT else given
