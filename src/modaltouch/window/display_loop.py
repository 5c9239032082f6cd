"""Keeps one picture on the display and collects its events, about a thousand times a second."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from modaltouch.protocol import Trial
from modaltouch.system import SYSTEM_CLOCK, Clock
from modaltouch.window.interface import Event, Log, SessionStopped, Tick, WindowError
from modaltouch.window.shapes import Picture

if TYPE_CHECKING:
    from modaltouch.window.screen import Screen

POLL_INTERVAL = 1e-3
"""Rest between two polls: the resolution of a reaction time [s]."""
_REDRAW_INTERVAL = 0.25
"""Least time between two redraws of a window that was covered [s]."""


@dataclass(frozen=True)
class Moment:
    """What the participant faces.

    Attributes
    ----------
    wants : str
        ``go_on``, ``feel`` (a stimulus plays), ``answer``, ``confirm`` (the answer once more) or ``nothing``.
    trial : Trial or None
        The trial that is on.
    onset : float
        When its stimulus began, by the window's clock [s].
    interval : int
        Which of several intervals it is, from 1; 0 if the question follows it.
    asked : str
        Name of the further question that is asked; empty for the first of a trial.
    entered : str
        What stands on a scale so far.
    """

    wants: Literal["go_on", "feel", "answer", "confirm", "nothing"] = "nothing"
    trial: Trial | None = None
    onset: float = 0.0
    interval: int = 0
    asked: str = ""
    entered: str = ""


class WindowUser:
    """A robot in front of the window (`robot.Robot`), or nobody, as here."""

    def see(self, moment: Moment, shown: float, picture: str) -> None:
        """Take in the picture that appeared at `shown` [s]."""

    def act(self, now: float, type_key: Callable[..., None]) -> None:
        """Do what is due; the moment last seen still holds."""


class DisplayLoop:
    """One display, the picture on it, and the events to be read.

    Parameters
    ----------
    display : Screen
        The window.
    tick : callable
        Called at every poll; may raise, and returns what the experimenter asks for.
    log : callable
        Takes the window's events for the record.
    screenshots : Path, optional
        Folder for one PNG of each kind of picture.
    window_user : WindowUser
        A robot, or nobody.
    emergency_keys : frozenset of str
        Keys that end the session at once, on every screen.
    clock : Clock
        Stamps events and times the pause between two polls; shared with the display.

    Raises
    ------
    WindowError
        If the folder for screenshots cannot be made.
    """

    def __init__(
        self,
        display: Screen,
        *,
        tick: Tick,
        log: Log,
        screenshots: Path | None,
        window_user: WindowUser,
        emergency_keys: frozenset[str] = frozenset(),
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.clock = clock
        self._display = display
        self._tick = tick
        self.note = log
        """Writes an event into the record now."""
        self._screenshots = screenshots
        self._window_user = window_user
        self._emergency_keys = emergency_keys
        self._is_emergency = False
        self._kept: set[str] = set()
        self._unread: deque[Event] = deque()
        self._unwritten: list[tuple[str, dict[str, Any]]] = []
        self._picture: Picture | None = None
        self._ahead: Picture | None = None
        self.shown = 0.0
        """When the picture appeared on the screen [s]."""
        self._drawn = 0.0
        self._is_stale = False
        self._last_poll = self.clock.now()
        self.poll_gap = 0.0
        """Time between the last two polls: the longest an event of the last one can have waited [s]."""
        self.flip_took = 0.0
        """How long it took to bring the picture onto the screen [s]."""
        if screenshots is not None:
            try:
                screenshots.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise WindowError(
                    f"the folder {screenshots} for screenshots cannot be made ({error.strerror}); give a folder you "
                    "may write to"
                ) from error

    def show(self, picture: Picture, moment: Moment | None = None) -> float:
        """Show a picture unless it is on already, and return when it appeared [s]."""
        if picture != self._picture:
            self.draw_ahead(picture)
            screenshot = self._screenshot(picture)
            began = self.clock.now()
            self.shown = self._drawn = self._display.flip(screenshot)
            self.flip_took = self.shown - began
            self._picture, self._ahead = picture, None
            self._is_stale = False
        if moment is not None:
            self._window_user.see(moment, self.shown, picture.name)
        return self.shown

    def draw_ahead(self, picture: Picture) -> None:
        """Draw the next picture out of sight, so that `show` takes no longer than a frame."""
        if picture != self._ahead:
            self._display.draw(picture)
            self._ahead = picture

    def attend(self, moment: Moment) -> None:
        """Tell a robot about a moment that shows no new picture."""
        self._window_user.see(moment, self.clock.now(), self._picture.name if self._picture else "")

    def poll(self) -> list[Event]:
        """Tick, and return what happened since the last poll; sleep a millisecond if nothing did.

        Raises
        ------
        SessionStopped
            At an emergency key, even one that was read by `poll_quietly`.
        """
        asked = self._tick()
        self._window_user.act(self.clock.now(), self._display.type_key)
        events = self.poll_quietly()
        if self._is_emergency:
            raise SessionStopped("emergency stop")
        if asked is not None:
            # Only the key of an answer is stamped where it is read.
            events.append(asked if asked.kind == "answer" else replace(asked, time=self.clock.now()))
        self._refresh()
        if not events:
            self.clock.sleep(POLL_INTERVAL)
        return events

    def poll_quietly(self) -> list[Event]:
        """Return what happened since the last poll, without a tick, so that nothing can raise."""
        events = self._display.poll()
        self.poll_gap, self._last_poll = self.clock.now() - self._last_poll, self.clock.now()
        self._is_stale = self._is_stale or any(event.kind == "expose" for event in events)
        self._is_emergency |= any(event.kind == "key" and event.key in self._emergency_keys for event in events)
        unread = list(self._unread)
        self._unread.clear()
        return [*unread, *(event for event in events if event.kind != "expose")]

    def put_back(self, events: list[Event]) -> None:
        """Leave events to be returned by the next poll."""
        self._unread.extend(events)

    def log_later(self, event: str, **facts: Any) -> None:
        """Keep an event until `write_notes`, while nothing may raise."""
        self._unwritten.append((event, facts))

    def write_notes(self) -> None:
        """Write the events that were kept."""
        notes, self._unwritten = self._unwritten, []
        for event, facts in notes:
            self.note(event, **facts)

    def _refresh(self) -> None:
        """Draw again what another window has covered."""
        if self._is_stale and self.clock.now() - self._drawn > _REDRAW_INTERVAL and self._picture is not None:
            self._display.draw(self._picture)
            self._drawn = self._display.flip()
            self._is_stale, self._ahead = False, None

    def _screenshot(self, picture: Picture) -> Path | None:
        """Return the file for the first screenshot of this kind of picture."""
        if self._screenshots is None or picture.name in self._kept:
            return None
        self._kept.add(picture.name)
        return self._screenshots / f"{picture.name}.png"
