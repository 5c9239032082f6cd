"""The experimenter's console: display of the session's state, and requests to the session (`Experimenter`).

``status``        state of the session from its events, as plain values with units
``consoles``      the session's side: live console in the terminal, plain lines without a terminal, JSON lines
``__main__``      the terminal's side, a separate process that draws and reads keys

Drawing and reading of keys run in a separate process: drawing takes about 10 ms of Python, and in a thread would delay
the window's polls and bias reaction times. If either process is killed, the other restores the terminal.
"""

from __future__ import annotations

import typing
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from modaltouch import window

if TYPE_CHECKING:
    from modaltouch.session.console.status import Status

Command = typing.Literal["pause", "go_on", "answer", "repeat", "note", "end_after_block", "stop", "emergency_stop"]

SessionState = dict[str, Any]
"""State of a session as plain values, with units in the keys (`status.Status.facts`)."""

AT_ONCE: dict[str, tuple[Command, str]] = {
    "p": ("pause", ""),
    "r": ("repeat", ""),
    "b": ("end_after_block", ""),
    " ": ("go_on", ""),
    "enter": ("go_on", ""),
    "x": ("emergency_stop", "EMERGENCY STOP"),
}
"""Command requested by a key at once, and the text shown."""

OWN_KEYS = frozenset({*AT_ONCE, "n", "q", "space", "escape"})
"""Keys reserved for the console, which never give an answer."""


@dataclass(frozen=True)
class Request:
    """A request of the experimenter."""

    # ``pause`` (or continue), ``go_on`` (from a waiting screen), ``answer`` (for the participant), ``repeat`` (the last
    # answered trial), ``note``, ``end_after_block`` (or cancel that), ``stop`` or ``emergency_stop``
    command: Command
    text: str = ""  # the note, or the answering key
    at: float = 0.0  # time when the answering key was read, by `clock.SYSTEM_CLOCK` [s]


class Console(AbstractContextManager["Console"]):
    """Base class of consoles, which shows nothing; methods must not raise or block."""

    def show(self, facts: SessionState) -> None:
        """Show the state of the session."""

    def requests(self) -> list[Request]:
        """Return the requests since the last call."""
        return []

    def close(self) -> None:
        """Stop showing, and restore the terminal."""

    def __exit__(self, *exc: object) -> None:
        self.close()


class Experimenter:
    """Link between session and console: forwards events to the console and requests to the session.

    `record` writes requests to the record, as ``record(event, **facts)``. `seconds_per_trial` is the approximate
    duration of a trial, for the console's state of the session [s].
    """

    def __init__(
        self,
        console: Console | None = None,
        record: Callable[..., Any] = lambda event, **facts: None,
        status: Status | None = None,
        *,
        seconds_per_trial: float = 5.0,
    ) -> None:
        self._console = console or Console()
        self._record = record
        self._requests: deque[Request] = deque()
        self._status = status
        if status is None and type(self._console) is not Console:
            from modaltouch.session.console.status import Status

            self._status = Status(seconds_per_trial)
        self._last: dict[str, Any] | None = None
        self._repeats: dict[str, Any] | None = None
        self.ends_after_block = False
        """Whether the session ends before the next block."""

    def tell(self, event: dict[str, Any], *, replayed: bool = False) -> None:
        """Process an event, recorded (new or replayed) or not, and show the changes."""
        if event["event"] in ("answered", "trial"):
            self._last = event
            if self._repeats is not None and self._repeats["n"] == event.get("answered"):
                # The request came between the lines `answered` and `trial` of one presentation, and the latter counts.
                self._repeats = event
        elif event["event"] == "withdrawn" and self._last is not None and self._last["n"] in event["lines"]:
            self._last = None
        if self._status is not None and self._status.take(event, replayed=replayed):
            self._console.show(self._status.facts())
        if event["event"] == "practice_round" or (event["event"] == "trial_next" and not event["trial"]["practice"]):
            self._leave_practice()

    def attend(self, *, window_waits: bool = True) -> window.Event | None:
        """Process requests up to the first that is an event for the window; called about every millisecond.

        Requests that came together, such as two digits of a number, are returned one at a time. Unless the window waits
        for an event, only an emergency stop is processed, and the others are kept. Raises SessionStopped if a request
        ends the session.
        """
        status = self._status
        if status is None:
            return None
        self._requests.extend(self._console.requests())
        if any(request.command == "emergency_stop" for request in self._requests):
            # Write nothing before the outputs are off; the stop record gives the reason.
            raise window.SessionStopped("emergency stop")
        while self._requests and window_waits:
            request = self._requests.popleft()
            # The answer has its own line; write nothing while a question is open.
            if request.command != "answer":
                self._record("experimenter", asks=request.command, **({"text": request.text} if request.text else {}))
            match request.command:
                case "stop":
                    raise window.SessionStopped("experimenter")
                case "answer" if (answer := status.answer_by(request.text)) is not None:
                    return window.Event(request.at, "answer", request.text, answer=answer)
                case "pause":
                    return window.Event(request.at, "continue" if status.facts()["state"] == "paused" else "pause")
                case "go_on":
                    return window.Event(request.at, "continue")
                case "end_after_block":
                    self.ends_after_block = not self.ends_after_block
                    self._show_requests()
                case "repeat":
                    is_refused = self._repeats is None and self._last is None
                    self._repeats = None if self._repeats is not None else self._last
                    self._show_requests(nothing_to_repeat=is_refused)
        return None

    def take_repeat(self) -> dict[str, Any] | None:
        """Return the event of the trial to be repeated, and clear the request; None if there is none."""
        repeats, self._repeats = self._repeats, None
        if repeats is not None:
            self._show_requests()
        return repeats

    def _leave_practice(self) -> None:
        """Disallow repeats of practice trials, once their round is judged or the main trials have begun."""
        if self._last is not None and self._last["trial"]["practice"]:
            self._last = None
        if self._repeats is not None and self._repeats["trial"]["practice"]:
            self._repeats = None
            self._show_requests(nothing_to_repeat=True)

    def _show_requests(self, *, nothing_to_repeat: bool = False) -> None:
        trial = {} if self._repeats is None else self._repeats["trial"]
        self.tell(
            {
                "event": "wishes",
                "ends_after_block": self.ends_after_block,
                "repeats_trial": trial.get("index"),
                "repeats_practice": trial.get("practice", False),
                "nothing_to_repeat": nothing_to_repeat,
            }
        )


def describe_time(seconds: float) -> str:
    """Format a time, in seconds below 90 s and in minutes above."""
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def describe_last(last: dict[str, Any] | None) -> str:
    """Return the text for the last answer."""
    if last is None:
        return "-"
    kind = "practice" if last["practice"] else "trial"
    since = {"first_burst": "first burst", "question": "question"}.get(last["counted_from"], last["counted_from"])
    return f"{last['answer']}, {last['reaction_time_s']:.2f} s after the {since} ({kind} {last['number']})"
