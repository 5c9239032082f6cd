"""Carries the events of instrument and window into the session log."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from modaltouch.record import SessionLog


class EventBuffer:
    """Carries the events of instrument and window into the session log.

    Events that come before the log exists are kept until it does. What is said to the instrument is gathered
    and written in one line a step: an fsync for each command would cost more than the command.
    """

    def __init__(self) -> None:
        self._log: SessionLog | None = None
        self._early: list[tuple[str, dict[str, Any]]] = []
        self._exchanges: list[dict[str, Any]] = []
        self.listener: Callable[[dict[str, Any]], None] = lambda exchange: None
        """Hears of each exchange with the instrument as it happens."""

    def open(self, log: SessionLog) -> None:
        """Write to this log from now on."""
        self._log = log

    def event(self, event: str, **facts: Any) -> None:
        """Write an event of the window."""
        if self._log is None:
            self._early.append((event, facts))
        else:
            self._log.append(event, **facts)

    def exchange(self, event: str, **facts: Any) -> None:
        """Keep an exchange with the instrument until `flush`."""
        self._exchanges.append({"what": event, **facts})
        self.listener({"event": "exchange", "what": event, **facts})

    def flush(self) -> None:
        """Write everything that was kept."""
        if self._log is None:
            return
        early, self._early = self._early, []
        for event, facts in early:
            self._log.append(event, **facts)
        if self._exchanges:
            exchanges, self._exchanges = self._exchanges, []
            self._log.append("rig", exchanges=exchanges)
