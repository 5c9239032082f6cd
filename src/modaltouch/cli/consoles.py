"""Which console a session gets: the live one in a terminal, else plain lines; JSON lines beside it on request."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from modaltouch.console.interface import Console


@contextmanager
def open_console(events: Path | None, emergency_keys: Sequence[str], *, plain: bool) -> Iterator[Console]:
    """Give the experimenter's console of one sitting.

    Raises
    ------
    typer.BadParameter
        If the events can be written nowhere.
    """
    from modaltouch.console.interface import Consoles

    consoles: list[Console] = []
    if events is not None:
        from modaltouch.console.lines import EventLines

        try:
            consoles.append(EventLines(events))
        except OSError as error:
            raise typer.BadParameter(
                f"given --events {events}, which cannot be written ({error.strerror}); give a file in a folder you "
                "may write to, or a named pipe (`mkfifo`)"
            ) from error
    from modaltouch.console.lines import PlainLines

    shown: Console = PlainLines(sys.stderr)
    if has_terminal() and not plain:
        from modaltouch.console.terminal import TerminalConsole

        # A machine that can start no more processes shows plain lines.
        with suppress(OSError):
            shown = TerminalConsole(sys.stdin.fileno(), sys.stderr.fileno(), emergency_keys, instead=shown)
    consoles.append(shown)
    with Consoles(consoles) as console:
        yield console


def has_terminal() -> bool:
    """Return whether somebody can type at this process and see what it draws."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()) or os.environ.get("TERM") == "dumb":
        return False
    # A job in the background would be stopped by the first key it reads.
    return sys.platform == "win32" or os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
