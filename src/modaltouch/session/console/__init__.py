"""The experimenter's console: display of the session's state, and requests to the session.

``status``        state of the session from its events, as plain values with units
``experimenter``  requests of the experimenter, kept until the session acts on them
``consoles``      the session's side: live console in the terminal, plain lines without a terminal, JSON lines
``__main__``      the terminal's side, a separate process that draws and reads keys (``keyboard``)

Drawing and reading of keys run in a separate process: drawing takes about 10 ms of Python, and in a thread would delay
the window's polls and bias reaction times. If either process is killed, the other restores the terminal.
"""

from __future__ import annotations

import typing
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

Command = typing.Literal["pause", "go_on", "answer", "repeat", "note", "end_after_block", "stop", "emergency_stop"]
COMMANDS: tuple[Command, ...] = typing.get_args(Command)

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
    """A request of the experimenter.

    Attributes
    ----------
    command : str
        ``pause`` (or continue), ``go_on`` (from a waiting screen), ``answer`` (for the participant), ``repeat`` (the
        last answered trial), ``note``, ``end_after_block`` (or cancel that), ``stop`` or ``emergency_stop``.
    text : str
        The note, or the answering key.
    at : float
        Time when the answering key was read, by `clock.SYSTEM_CLOCK` [s].
    """

    command: Command
    text: str = ""
    at: float = 0.0


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
