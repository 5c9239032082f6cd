"""Signals that end a session: noted when they come, acted upon at the next safe moment."""

from __future__ import annotations

import signal
from types import FrameType
from typing import Self

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))


class Interrupted(BaseException):
    """A signal told the session to end.

    Not an `Exception`, so that no library's ``except Exception`` can swallow it.

    Attributes
    ----------
    signal_name : str
        ``SIGINT``, ``SIGTERM``, ...
    """

    def __init__(self, signal_name: str) -> None:
        super().__init__(signal_name)
        self.signal_name = signal_name


class Interruption:
    """Notes the signals in `SIGNALS` while it is active; `check` raises once one has come.

    A handler that raised at an arbitrary instruction could tear a line of the record or skip an `output off`; a note
    cannot. A second SIGINT raises at once, in case the program hangs.
    """

    def __init__(self) -> None:
        self.pending = ""
        self._previous: dict[int, object] = {}

    def check(self) -> None:
        """Raise `Interrupted` if a signal has come.

        Raises
        ------
        Interrupted
            With the signal's name.
        """
        if self.pending:
            raise Interrupted(self.pending)

    def __enter__(self) -> Self:
        self._previous = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def __exit__(self, *exc: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.pending == "SIGINT" and number == signal.SIGINT:
            raise Interrupted("SIGINT")
        self.pending = signal.Signals(number).name
