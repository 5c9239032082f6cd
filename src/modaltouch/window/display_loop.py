"""Display loop: keeps a picture on the display and polls for events about a thousand times per second."""

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
"""Time between two polls, the resolution of reaction times [s]."""
_REDRAW_INTERVAL = 0.25
"""Minimum time between two redraws of a window that was covered [s]."""


@dataclass(frozen=True)
class Moment:
    """State of the display as presented to a robot.

    Attributes
    ----------
    wants : str
        Expected action: ``go_on``, ``feel`` (a stimulus plays), ``answer``, ``confirm`` (the answer again) or
        ``nothing``.
    trial : Trial or None
        The current trial.
    onset : float
        Onset of its stimulus, by the window's clock [s].
    interval : int
        Number of the interval, from 1; 0 if the question follows it.
    asked : str
        Name of the further question; empty for the first question of a trial.
    entered : str
        Number entered on a scale so far.
    """

    wants: Literal["go_on", "feel", "answer", "confirm", "nothing"] = "nothing"
    trial: Trial | None = None
    onset: float = 0.0
    interval: int = 0
    asked: str = ""
    entered: str = ""


class WindowUser:
    """Base class of robots that use the window (`robot.Robot`); does nothing."""

    def see(self, moment: Moment, shown: float, picture: str) -> None:
        """Process the picture that appeared at `shown` [s]."""

    def act(self, now: float, type_key: Callable[..., None]) -> None:
        """Perform due actions for the last moment seen."""


class DisplayLoop:
    """A display with its current picture and pending events.

    Parameters
    ----------
    display : Screen
        The window.
    tick : callable
        Called at every poll; may raise, and returns the experimenter's request.
    log : callable
        Receives the window's events for the record.
    screenshots : Path, optional
        Folder for one PNG of each kind of picture.
    window_user : WindowUser
        A robot, or the base class for none.
    emergency_keys : frozenset of str
        Keys that end the session at once, on every screen.
    clock : Clock
        Clock of time stamps and polling; shared with the display.

    Raises
    ------
    WindowError
        If the folder for screenshots cannot be created.
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
        """Writes an event to the record immediately."""
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
        """Time when the picture appeared on the screen [s]."""
        self._drawn = 0.0
        self._is_stale = False
        self._last_poll = self.clock.now()
        self.poll_gap = 0.0
        """Time between the last two polls, the maximum age of an event of the last poll [s]."""
        self.flip_took = 0.0
        """Duration of the flip that showed the picture [s]."""
        if screenshots is not None:
            try:
                screenshots.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise WindowError(
                    f"the folder {screenshots} for screenshots cannot be made ({error.strerror}); give a folder you "
                    "may write to"
                ) from error

    def show(self, picture: Picture, moment: Moment | None = None) -> float:
        """Show a picture unless it is already shown, and return the time of its appearance [s]."""
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
        """Draw the next picture to the back buffer, so that `show` takes at most one frame."""
        if picture != self._ahead:
            self._display.draw(picture)
            self._ahead = picture

    def attend(self, moment: Moment) -> None:
        """Notify a robot of a moment without a new picture."""
        self._window_user.see(moment, self.clock.now(), self._picture.name if self._picture else "")

    def poll(self) -> list[Event]:
        """Tick, and return the events since the last poll; sleep a millisecond if there are none.

        Raises
        ------
        SessionStopped
            At an emergency key, including one read by `poll_quietly`.
        """
        asked = self._tick()
        self._window_user.act(self.clock.now(), self._display.type_key)
        events = self.poll_quietly()
        if self._is_emergency:
            raise SessionStopped("emergency stop")
        if asked is not None:
            # Only the keys of answers are time-stamped where they are read.
            events.append(asked if asked.kind == "answer" else replace(asked, time=self.clock.now()))
        self._refresh()
        if not events:
            self.clock.sleep(POLL_INTERVAL)
        return events

    def poll_quietly(self) -> list[Event]:
        """Return the events since the last poll without a tick, so that nothing can raise."""
        events = self._display.poll()
        self.poll_gap, self._last_poll = self.clock.now() - self._last_poll, self.clock.now()
        self._is_stale = self._is_stale or any(event.kind == "expose" for event in events)
        self._is_emergency |= any(event.kind == "key" and event.key in self._emergency_keys for event in events)
        unread = list(self._unread)
        self._unread.clear()
        return [*unread, *(event for event in events if event.kind != "expose")]

    def put_back(self, events: list[Event]) -> None:
        """Return events to the queue, for the next poll."""
        self._unread.extend(events)

    def log_later(self, event: str, **facts: Any) -> None:
        """Keep an event until `write_notes`, for use where nothing may raise."""
        self._unwritten.append((event, facts))

    def write_notes(self) -> None:
        """Write the kept events."""
        notes, self._unwritten = self._unwritten, []
        for event, facts in notes:
            self.note(event, **facts)

    def _refresh(self) -> None:
        """Redraw the picture after the window was covered."""
        if self._is_stale and self.clock.now() - self._drawn > _REDRAW_INTERVAL and self._picture is not None:
            self._display.draw(self._picture)
            self._drawn = self._display.flip()
            self._is_stale, self._ahead = False, None

    def _screenshot(self, picture: Picture) -> Path | None:
        """Return the file for the first screenshot of a kind of picture; None for further ones."""
        if self._screenshots is None or picture.name in self._kept:
            return None
        self._kept.add(picture.name)
        return self._screenshots / f"{picture.name}.png"
