"""The experimenter's side of a session, while the window belongs to the participant.

Here: what a console shows, and what can be requested at it. Beside it:

``status``        the session's events -> its state, as plain values with units
``experimenter``  the experimenter's requests, kept until the session acts upon them
``consoles``      the session's side: the console in the terminal, JSON lines, or plain lines if there is no terminal
``__main__``      the terminal's side, a separate process: draws, and reads keys (``drawing``, ``keyboard``)

Drawing and reading keys take place in a separate process. Drawing the terminal takes about ten milliseconds of
Python; a thread would delay the window's polls by as much, and falsify reaction times. If either process is killed,
the other one restores the terminal.
"""

from __future__ import annotations

import typing
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

Command = typing.Literal["pause", "go_on", "answer", "repeat", "note", "end_after_block", "stop", "emergency_stop"]
COMMANDS: tuple[Command, ...] = typing.get_args(Command)

SessionState = dict[str, Any]
"""State of a session: plain values, keys with units (`status.Status.facts`)."""


AT_ONCE: dict[str, tuple[Command, str]] = {
    "p": ("pause", ""),
    "r": ("repeat", ""),
    "b": ("end_after_block", ""),
    " ": ("go_on", ""),
    "enter": ("go_on", ""),
    "x": ("emergency_stop", "EMERGENCY STOP"),
}
"""Command that a key requests at once, and the text then shown."""

OWN_KEYS = frozenset({*AT_ONCE, "n", "q", "space", "escape"})
"""Keys of the console itself, which never give an answer."""


@dataclass(frozen=True)
class Request:
    """A request of the experimenter.

    Attributes
    ----------
    command : str
        ``pause`` (and go on), ``go_on`` (from a screen that waits), ``answer`` (for the participant), ``repeat`` (the
        last answered trial once more), ``note``, ``end_after_block`` (and take it back), ``stop`` or
        ``emergency_stop``.
    text : str
        The note, or the key that answers.
    at : float
        When the answering key was read, by `clock.SYSTEM_CLOCK` [s].
    """

    command: Command
    text: str = ""
    at: float = 0.0


class Console(AbstractContextManager["Console"]):
    """Shows the state of a session and takes requests; nothing here may raise or wait. This one shows nothing."""

    def show(self, facts: SessionState) -> None:
        """Show the state of the session."""

    def requests(self) -> list[Request]:
        """Return what was asked for since the last call."""
        return []

    def close(self) -> None:
        """Show nothing more, and restore the terminal."""

    def __exit__(self, *exc: object) -> None:
        self.close()
