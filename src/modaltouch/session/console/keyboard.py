"""Single keys from a terminal, without Enter and without echo, and the terminal as it was afterwards."""

from __future__ import annotations

import codecs
import os
import select
import sys
import time
import typing
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_ARROWS = ("up", "down", "right", "left")
_NAMED_KEYS = {
    **{f"\x1b{opening}{letter}": name for opening in "[O" for letter, name in zip("ABCD", _ARROWS, strict=True)},
    **{f"\x1bO{letter}": f"f{number}" for number, letter in enumerate("PQRS", start=1)},
    **{
        f"\x1b[{code}~": f"f{number}" for number, code in enumerate((11, 12, 13, 14, 15, 17, 18, 19, 20, 21, 23, 24), 1)
    },
}
"""What terminals send for arrows and function keys (xterm and VT220)."""
_WINDOWS_KEYS = {
    **dict(zip("HPMK", _ARROWS, strict=True)),
    **{chr(58 + number): f"f{number}" for number in range(1, 11)},
    "\x85": "f11",
    "\x86": "f12",
}
"""What follows a NUL or an 0xE0 in Windows's console for arrows and function keys."""
_NAMES = {"\r": "enter", "\n": "enter", "\x7f": "backspace", "\b": "backspace", "\x1b": "escape"}
_SEQUENCE_PAUSE = 0.05
"""The rest of a key's sequence comes within this time, or it is Escape itself [s]."""


class Keyboard(typing.Protocol):
    """Gives keys: a printable character as itself, others by name (`enter`, `backspace`, `escape`, `left`, `f12`)."""

    def read(self, patience: float) -> list[str]:
        """Return the keys that come within some time [s]; empty if none does."""


@contextmanager
def open_keyboard(descriptor: int) -> Iterator[Keyboard]:
    """Give the keys of a terminal, one by one, until the end of the context.

    Ctrl-C stays a signal. What would stop the session in the midst of a stimulus (Ctrl-Z, Ctrl-S) does not.

    Parameters
    ----------
    descriptor : int
        The terminal; without meaning on Windows, where it is the process's console.
    """
    if sys.platform == "win32":
        yield WindowsKeyboard()
        return
    before = save_terminal(descriptor)
    try:
        _take_single_keys(descriptor)
        yield UnixKeyboard(descriptor)
    finally:
        restore_terminal(descriptor, before)


def save_terminal(descriptor: int) -> list[Any] | None:
    """Return how a terminal is set; None where there is nothing to be set."""
    if sys.platform == "win32":
        return None
    import termios

    try:
        return termios.tcgetattr(descriptor)
    except termios.error:
        return None


def restore_terminal(descriptor: int, before: list[Any] | None) -> None:
    """Set a terminal as it was; a terminal that is gone needs nothing."""
    if sys.platform == "win32" or before is None:
        return
    import termios

    # TCSANOW: draining what was written would wait for ever on a terminal that somebody has stopped.
    try:
        termios.tcsetattr(descriptor, termios.TCSANOW, before)
    except termios.error:
        return


def _take_single_keys(descriptor: int) -> None:
    import termios

    settings = termios.tcgetattr(descriptor)
    settings[0] &= ~(termios.IXON | termios.ICRNL)
    settings[3] &= ~(termios.ICANON | termios.ECHO)
    for name in ("VSUSP", "VQUIT"):
        settings[6][getattr(termios, name)] = b"\0"
    settings[6][termios.VMIN], settings[6][termios.VTIME] = 1, 0
    termios.tcsetattr(descriptor, termios.TCSANOW, settings)


class UnixKeyboard:
    """Keys of a Unix terminal.

    Parameters
    ----------
    descriptor : int
        The terminal, set to give single keys.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._decode = codecs.getincrementaldecoder("utf-8")(errors="replace").decode

    def read(self, patience: float) -> list[str]:
        """Return the keys that come within some time [s]; empty if none does.

        Raises
        ------
        EOFError
            If the terminal is gone.
        """
        if not self._has_more(patience):
            return []
        text = self._receive()
        # Over a slow line a sequence may come in pieces.
        while (
            text.endswith(("\x1b", "\x1b[", "\x1bO")) and select.select([self._descriptor], [], [], _SEQUENCE_PAUSE)[0]
        ):
            text += self._receive()
        return split_keys(text)

    def _has_more(self, patience: float) -> bool:
        return bool(select.select([self._descriptor], [], [], patience)[0])

    def _receive(self) -> str:
        try:
            data = os.read(self._descriptor, 1024)
        except OSError as error:
            raise EOFError from error
        if not data:
            raise EOFError
        return self._decode(data)


class WindowsKeyboard:
    """Keys of the console of a Windows process."""

    def read(self, patience: float) -> list[str]:
        """Return the keys that come within some time [s]; empty if none does."""
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


def split_keys(text: str) -> list[str]:
    r"""Return the keys that a terminal's characters stand for; unknown sequences are left out.

    Examples
    --------
    >>> split_keys("p\x1b[24~\r\x1b[A\x1b[Z")
    ['p', 'f12', 'enter', 'up']
    """
    keys: list[str] = []
    place = 0
    while place < len(text):
        if text.startswith(("\x1b[", "\x1bO"), place):
            end = place + 2
            while end < len(text) and not ("@" <= text[end] <= "~"):
                end += 1
            name = _NAMED_KEYS.get(text[place : end + 1])
            keys += [name] if name else []
            place = end + 1
            continue
        letter = text[place]
        name = _NAMES.get(letter)
        if name or letter.isprintable():
            keys.append(name or letter)
        place += 1
    return keys
