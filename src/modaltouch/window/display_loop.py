"""Display loop: keeps a picture on the display, polls for events every millisecond, and lets a robot type."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from modaltouch.protocol import Protocol, Texts, Trial
from modaltouch.system import SYSTEM_CLOCK, Clock
from modaltouch.window.controls import Entry, as_read
from modaltouch.window.interface import POLL_INTERVAL, Event, Log, SessionStopped, Tick, WindowError
from modaltouch.window.layout import Picture
from modaltouch.window.screen import Screen, canonical_key, display_lost
from modaltouch.window.simulated import Answerer


@dataclass(frozen=True)
class Moment:
    """State of the display as presented to a robot."""

    # expected action: ``go_on``, ``feel`` (a stimulus plays), ``answer``, ``confirm`` (the answer again) or ``nothing``
    wants: Literal["go_on", "feel", "answer", "confirm", "nothing"] = "nothing"
    trial: Trial | None = None  # the current trial
    onset: float = 0.0  # onset of its stimulus, by the window's clock [s]
    interval: int = 0  # number of the interval, from 1; 0 if the question follows it
    asked: str = ""  # name of the further question; empty for the first question of a trial
    entered: str = ""  # number entered on a scale so far


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
    robot : Robot, optional
        Answers in place of a person.
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
        robot: Robot | None = None,
        emergency_keys: frozenset[str] = frozenset(),
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.clock = clock
        self._display = display
        self._tick = tick
        self.note = log
        """Writes an event to the record immediately."""
        self._screenshots = screenshots
        self._robot = robot
        self._emergency_keys = emergency_keys
        self._is_emergency = self._is_lost = False
        self._kept: set[str] = set()
        self._unread: deque[Event] = deque()
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
        if moment is not None and self._robot is not None:
            self._robot.see(moment, self.shown, picture.name)
        return self.shown

    def draw_ahead(self, picture: Picture) -> None:
        """Draw the next picture to the back buffer, so that `show` takes at most one frame."""
        if picture != self._ahead:
            self._display.draw(picture)
            self._ahead = picture

    def attend(self, moment: Moment) -> None:
        """Notify a robot of a moment without a new picture."""
        if self._robot is not None:
            self._robot.see(moment, self.clock.now(), self._picture.name if self._picture else "")

    def poll(self) -> list[Event]:
        """Tick, and return the events since the last poll; sleep a millisecond if there are none.

        Raises
        ------
        SessionStopped
            At an emergency key, including one read by `poll_quietly`.
        WindowError
            If the display is lost.
        """
        asked = self._tick()
        if self._robot is not None:
            self._robot.act(self.clock.now(), self._display.type_key)
        events = self.poll_quietly()
        if self._is_emergency:
            raise SessionStopped("emergency stop")
        if self._is_lost:
            raise display_lost()
        if asked is not None:
            # Only the keys of answers are time-stamped where they are read.
            events.append(asked if asked.kind == "answer" else replace(asked, time=self.clock.now()))
        # Redraw after the window was covered, at most every 0.25 s: one that is moved is exposed all the time.
        if self._is_stale and self.clock.now() - self._drawn > 0.25 and self._picture is not None:
            self._display.draw(self._picture)
            self._drawn = self._display.flip()
            self._is_stale, self._ahead = False, None
        if not events:
            self.clock.sleep(POLL_INTERVAL)
        return events

    def poll_quietly(self) -> list[Event]:
        """Return the events since the last poll without a tick, so that nothing can raise."""
        events = self._display.poll()
        self.poll_gap, self._last_poll = self.clock.now() - self._last_poll, self.clock.now()
        self._is_stale = self._is_stale or any(event.kind == "expose" for event in events)
        self._is_lost |= any(event.kind == "lost" for event in events)
        self._is_emergency |= any(event.kind == "key" and event.key in self._emergency_keys for event in events)
        unread = list(self._unread)
        self._unread.clear()
        return [*unread, *(event for event in events if event.kind != "expose")]

    def put_back(self, events: list[Event]) -> None:
        """Return events to the queue, for the next poll."""
        self._unread.extend(events)

    def _screenshot(self, picture: Picture) -> Path | None:
        """Return the file for the first screenshot of a kind of picture; None for further ones."""
        if self._screenshots is None or picture.name in self._kept:
            return None
        self._kept.add(picture.name)
        return self._screenshots / f"{picture.name}.png"


_HOLD = 0.06
"""Minimum time for which a key is held down, and up before the next press [s]."""
_SHORTEST_VIEW = 0.12
"""Minimum time from the appearance of a question to its answer [s]."""
_AGAIN = 1.0
"""Time after which a key that had no effect is typed again [s]."""
_TRIES = 60
"""Maximum number of attempts, about a minute; counted, not timed, so that suspending the machine does not matter."""


class Robot:
    """Robot that types an observer's answers into the window at its reaction times, until the window accepts them.

    Its keys take the same path as any key press: pyglet's queue, the event tap, the window's rules. A session that it
    answers therefore tests the whole path, on every platform and independently of the display server.

    Parameters
    ----------
    texts : Texts, optional
        Texts on the screen; scales run from right to left if the texts do.
    """

    def __init__(
        self, answerer: Answerer, protocol: Protocol, *, patience: float = 0.6, texts: Texts | None = None
    ) -> None:
        answers = protocol.answers
        self._answerer = answerer
        asked = {"": answers, **answers.further, **protocol.closing}
        self._asked = {name: each if texts is None else as_read(each, texts) for name, each in asked.items()}
        self._continue_key = canonical_key(answers.continue_keys[0])
        self._counts_from_question = answers.stimulus_until == "question"
        self._patience = patience
        self._felt: tuple[str, float | None, float] = ("", None, 0.0)
        self._seen: tuple[Moment, str] = (Moment(), "")
        self._wanted, self._due, self._tries = "", 0.0, 0
        self._down, self._moved = "", 0.0

    def see(self, moment: Moment, shown: float, picture: str) -> None:
        """Choose the key for the picture that appeared at `shown` [s]."""
        if (moment, picture) == self._seen:
            return
        self._seen, self._wanted, self._tries = (moment, picture), "", 0
        if moment.wants in ("go_on", "confirm"):
            self._wanted = self._continue_key if moment.wants == "go_on" else self._key(moment)
            self._due = shown + self._patience
        elif moment.wants == "feel" and moment.trial is not None:
            # Feel now, since the stimulus may have stopped by the time of the question.
            if moment.interval:
                self._answerer.feel(moment.trial, moment.interval)
            else:
                self._felt = self._answerer.first(moment.trial)
        elif moment.wants == "answer":
            if moment.asked and not moment.entered:
                asked = self._asked[moment.asked]
                self._felt = self._answerer.rate(moment.trial, asked.scale, asked.offered.names, moment.asked)
            start = shown if self._counts_from_question or moment.asked else moment.onset
            due = max(start + self._felt[2], shown + _SHORTEST_VIEW)
            self._wanted, self._due = self._key(moment), shown if moment.entered else due

    def _key(self, moment: Moment) -> str:
        """Return the key that answers, or moves the number on a scale towards the answer."""
        asked, (answer, value, _) = self._asked[moment.asked], self._felt
        if asked.scale is not None and value is not None:
            answer = Entry(asked.scale, text=moment.entered).towards(value)
        return canonical_key(asked.actions[answer][0])

    def act(self, now: float, type_key: Callable[..., None]) -> None:
        """Press or release the key that is due; raise `WindowError` if the window accepts none for a minute."""
        # The previous key has been read; had it been accepted, another key would be due.
        if self._down and now >= self._moved + _HOLD:
            type_key(self._down, down=False)
            self._down, self._moved = "", now
        elif self._wanted and not self._down and now >= max(self._due, self._moved + _HOLD):
            if self._tries == _TRIES:
                raise WindowError(
                    f"nothing has moved for {_TRIES * _AGAIN:g} s: the screen {self._seen[1]!r} stays, though the "
                    f"robot typed {self._wanted!r} {_TRIES} times; test keys with `modaltouch doctor --timing`"
                )
            type_key(self._wanted, down=True)
            self._down, self._moved, self._due = self._wanted, now, now + _AGAIN
            self._tries += 1
