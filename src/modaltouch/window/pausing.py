"""Pauses: Escape, a lost focus, the close button, and what each leads to."""

from __future__ import annotations

from typing import NoReturn

from modaltouch.trial import Trial
from modaltouch.window.events import Event
from modaltouch.window.interface import SessionStopped
from modaltouch.window.marks import Picture
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
    fingers_need : float
        Time for the fingers to return to the beam [s].
    """

    def __init__(self, stage: Stage, pictures: Illustrator, reader: Reader, fingers_need: float) -> None:
        self._stage = stage
        self._pictures = pictures
        self._reader = reader
        self._fingers_need = fingers_need

    def pause(self, trial: Trial | None, event: Event, ready: Picture | None) -> None:
        """Hold, then show `ready` while the fingers return; hold again if that is cut short.

        Raises
        ------
        SessionStopped
            If the session was ended.
        """
        cut: Event | None = event
        while cut is not None:
            self.hold(trial, cut)
            cut = self.let_fingers_return(ready)

    def hold(self, trial: Trial | None, event: Event) -> None:
        """Show the pause screen until the session goes on.

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
                    return

    def let_fingers_return(self, ready: Picture | None) -> Event | None:
        """Show the beam while the fingers return; return what cuts it short, or None."""
        if ready is None:
            return None
        self._stage.show(ready, Moment())
        end = self._stage.clock.now() + self._fingers_need
        while self._stage.clock.now() < end:
            for event in self._stage.poll():
                if self._reader.interrupts(event):
                    return event
                self.discard(event, "between trials")
        return None

    def discard(self, event: Event, when: str, trial: Trial | None = None) -> None:
        """Write down a press that does not count."""
        if is_press(event):
            self._stage.note("discarded", when=when, trial=trial.index if trial else None, **describe_press(event))

    def _end(self, reason: str) -> NoReturn:
        self._stage.note("stopped", reason=reason)
        raise SessionStopped(reason)
