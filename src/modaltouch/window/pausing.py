"""Pauses: Escape, a lost focus, the close button, and what each leads to."""

from __future__ import annotations

from typing import NoReturn

from modaltouch.trial import Trial
from modaltouch.window.events import Event
from modaltouch.window.interface import SessionStopped
from modaltouch.window.pictures import Illustrator
from modaltouch.window.reading import Reader, describe_press, is_press
from modaltouch.window.stage import Moment, Stage

SETTLE = 0.25
"""A press this soon after a screen appeared was meant for the one before [s]."""


class Pauser:
    """Holds a session until the participant or the experimenter decides.

    Parameters
    ----------
    stage, pictures, reader
        Where it is shown, what is shown, and what the answers mean.
    """

    def __init__(self, stage: Stage, pictures: Illustrator, reader: Reader) -> None:
        self._stage = stage
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
        self._stage.note(name, trial=trial.index if trial else None, **by)
        began = self._stage.clock.now()
        shown = self._stage.show(self._pictures.pause(trial), Moment("go_on", trial))
        while True:
            for press in self._stage.poll():
                if press.kind == "close":
                    self._end("window closed")
                if press.kind != "continue" and press.time < shown + SETTLE:
                    self.discard(press, "as the screen appeared", trial)
                elif self._reader.ends(press):
                    self._end("escape")
                elif self._reader.goes_on(press):
                    self._stage.note("continued", paused_s=round(press.time - began, 3))
                    return press

    def discard(self, event: Event, when: str, trial: Trial | None = None) -> None:
        """Write down a press that does not count."""
        if is_press(event):
            self._stage.note("discarded", when=when, trial=trial.index if trial else None, **describe_press(event))

    def _end(self, reason: str) -> NoReturn:
        self._stage.note("stopped", reason=reason)
        raise SessionStopped(reason)
