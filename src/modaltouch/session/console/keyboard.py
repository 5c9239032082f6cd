"""Single key presses from a terminal, without Enter and echo, and their interpretation as requests.

Most keys act at once; a note is typed as text, and stopping requires confirmation. If the experimenter enters the
answers, their keys work here too while a trial is on. The console's keys keep their meaning then: `x` is always the
emergency stop.
"""

from __future__ import annotations

import codecs
import os
import re
import select
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from modaltouch.session.console import AT_ONCE, Command, Request, SessionState

if sys.platform != "win32":
    import termios

_ARROWS = ("up", "down", "right", "left")
_NAMED_KEYS = {
    **{"\r": "enter", "\n": "enter", "\x7f": "backspace", "\b": "backspace", "\x1b": "escape"},
    **{f"\x1b{opening}{letter}": name for opening in "[O" for letter, name in zip("ABCD", _ARROWS, strict=True)},
    **{f"\x1bO{letter}": f"f{number}" for number, letter in enumerate("PQRS", start=1)},
    **{
        f"\x1b[{code}~": f"f{number}" for number, code in enumerate((11, 12, 13, 14, 15, 17, 18, 19, 20, 21, 23, 24), 1)
    },
}
"""Control characters and sequences of terminals (xterm and VT220) for keys that print nothing."""
_WINDOWS_KEYS = {
    **dict(zip("HPMK", _ARROWS, strict=True)),
    **{chr(58 + number): f"f{number}" for number in range(1, 11)},
    "\x85": "f11",
    "\x86": "f12",
}
"""Codes after NUL or 0xE0 on the Windows console for arrow and function keys."""
_KEY = re.compile(r"\x1b[\[O][^@-~]*[@-~]?|.", re.DOTALL)
"""Input of a key: an escape sequence or a character."""


@contextmanager
def open_keyboard(descriptor: int) -> Iterator[Keyboard]:
    """Yield a keyboard that reads single keys from a terminal within the context.

    Ctrl-C remains a signal, but Ctrl-Z and Ctrl-S do not stop the session.

    Parameters
    ----------
    descriptor : int
        File descriptor of the terminal; ignored on Windows, which uses the process's console.
    """
    if sys.platform == "win32":
        yield WindowsKeyboard()
        return
    before, settings = save_terminal(descriptor), termios.tcgetattr(descriptor)
    settings[0] &= ~(termios.IXON | termios.ICRNL)
    settings[3] &= ~(termios.ICANON | termios.ECHO)
    for name in ("VSUSP", "VQUIT"):
        settings[6][getattr(termios, name)] = b"\0"
    settings[6][termios.VMIN], settings[6][termios.VTIME] = 1, 0
    try:
        termios.tcsetattr(descriptor, termios.TCSANOW, settings)
        yield UnixKeyboard(descriptor)
    finally:
        restore_terminal(descriptor, before)


def save_terminal(descriptor: int) -> list[Any] | None:
    """Return the settings of a terminal; None if not available."""
    if sys.platform == "win32":
        return None
    try:
        return termios.tcgetattr(descriptor)
    except termios.error:
        return None


def restore_terminal(descriptor: int, before: list[Any] | None) -> None:
    """Restore the settings of a terminal, unless it is gone."""
    if sys.platform == "win32" or before is None:
        return
    # TCSANOW: waiting for output to drain would block forever on a stopped terminal.
    with suppress(termios.error):
        termios.tcsetattr(descriptor, termios.TCSANOW, before)


class UnixKeyboard:
    """Keyboard of a Unix terminal."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._decode = codecs.getincrementaldecoder("utf-8")(errors="replace").decode

    def read(self, patience: float) -> list[str]:
        """Return the keys pressed within `patience` [s]; empty if none.

        Raises
        ------
        EOFError
            If the terminal is gone.
        """
        if not select.select([self._descriptor], [], [], patience)[0]:
            return []
        text = self._receive()
        # On a slow line, a sequence may arrive in pieces; after 50 ms, the key is Escape itself.
        while re.search(r"\x1b([\[O][^@-~]*)?\Z", text) and select.select([self._descriptor], [], [], 0.05)[0]:
            text += self._receive()
        return split_keys(text)

    def _receive(self) -> str:
        try:
            data = os.read(self._descriptor, 1024)
        except OSError as error:
            raise EOFError from error
        if not data:
            raise EOFError
        return self._decode(data)


class WindowsKeyboard:
    """Keyboard of a Windows console."""

    def read(self, patience: float) -> list[str]:
        """Return the keys pressed within `patience` [s]; empty if none."""
        import msvcrt

        keys: list[str] = []
        end = time.monotonic() + patience
        while not keys and time.monotonic() < end:
            while msvcrt.kbhit():  # type: ignore[attr-defined,unused-ignore]
                letter = msvcrt.getwch()  # type: ignore[attr-defined,unused-ignore]
                if letter in ("\0", "\xe0"):
                    name = _WINDOWS_KEYS.get(msvcrt.getwch())  # type: ignore[attr-defined,unused-ignore]
                    keys += [name] if name else []
                else:
                    keys += split_keys(letter)
            time.sleep(0.01)
        return keys


Keyboard = UnixKeyboard | WindowsKeyboard
"""Source of keys: printable characters, and names of others (`enter`, `backspace`, `escape`, `left`, `f12`)."""


def split_keys(text: str) -> list[str]:
    r"""Decode the characters sent by a terminal into keys; unknown sequences are dropped.

    Examples
    --------
    >>> split_keys("p\x1b[24~\r\x1b[A\x1b[Z")
    ['p', 'f12', 'enter', 'up']
    """
    keys = (_NAMED_KEYS.get(typed, typed) for typed in _KEY.findall(text))
    return [key for key in keys if key.isprintable()]


LONGEST_NOTE = 500
"""Maximum length of a note [characters]."""


class Dialogue:
    """Interpretation of keys as requests.

    Parameters
    ----------
    emergency : sequence of str
        Names of the emergency keys, which act even while a note is typed; the first is shown.
    """

    def __init__(self, emergency: Sequence[str] = ("f12",)) -> None:
        self._emergency = frozenset(key for key in emergency if len(key) > 1)
        self.emergency = next(iter(emergency), "x")
        self._note: str | None = None
        self._asks_to_stop = False
        self._answers: dict[str, str] = {}
        self._is_open = False
        self.prompt = ""
        """Line with the last request or the text being typed."""

    def hear(self, facts: SessionState) -> None:
        """Update the keys of answers, and whether a question is open, from the state of the session."""
        question = facts.get("question") or {"open": False, "keys": {}}
        self._answers = {key: answer for answer, keys in question["keys"].items() for key in keys}
        self._is_open = question["open"]

    def press(self, key: str) -> Request | None:
        """Process a key and return the resulting request, if any."""
        if key in self._emergency:
            return self._ask("emergency_stop", "EMERGENCY STOP")
        if self._note is not None:
            return self._type(key)
        if self._asks_to_stop:
            self._asks_to_stop, self.prompt = False, ""
            return self._ask("stop", "stopping") if key in ("y", "Y") else None
        if key in AT_ONCE:
            return self._ask(*AT_ONCE[key])
        self.prompt = ""
        match key:
            case "n":
                self._note, self.prompt = "", "note (Enter keeps it, Escape drops it): _"
            case "q":
                self._asks_to_stop, self.prompt = True, "stop the session now? y: yes, any other key: no"
            case _ if key in self._answers and self._is_open:
                self.prompt = f"typed: {self._answers[key]}"
                return Request("answer", key)
            case _ if key in self._answers:
                self.prompt = f"{self._answers[key]} is not accepted: no trial is running"
        return None

    def _ask(self, command: Command, prompt: str) -> Request:
        self.prompt = prompt
        return Request(command)

    def _type(self, key: str) -> Request | None:
        note = self._note or ""
        if key in ("enter", "escape"):
            self._note, self.prompt = None, ""
            return Request("note", note.strip()) if key == "enter" and note.strip() else None
        if key == "backspace":
            note = note[:-1]
        elif len(key) == 1:
            note = (note + key)[:LONGEST_NOTE]
        self._note = note
        # Keep the end of a long note visible.
        full = f", full at {LONGEST_NOTE} characters" if len(note) == LONGEST_NOTE else ""
        self.prompt = f"note (Enter keeps it, Escape drops it{full}): {note[-34:]}_"
        return None
