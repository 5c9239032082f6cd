"""The clock that stamps everything in a record: the machine's own, or a virtual one; and how exact the former is."""

from __future__ import annotations

import heapq
import itertools
import time
import typing
from collections.abc import Callable


class Clock(typing.Protocol):
    """Tells the time and lets it pass; window, session, generator driver and twin each take one as a value."""

    def now(self) -> float:
        """Return the time since an arbitrary zero [s]."""

    def sleep(self, seconds: float) -> None:
        """Let time pass [s]."""


class SystemClock:
    """The machine's monotonic clock; every process of a machine reads the same time."""

    def now(self) -> float:
        """Return `time.perf_counter` [s]."""
        return time.perf_counter()

    def sleep(self, seconds: float) -> None:
        """Wait [s]; not at all for a time that is past."""
        time.sleep(max(seconds, 0.0))


class VirtualClock:
    """Time that passes only while somebody sleeps, and then at once.

    Parameters
    ----------
    start : float
        First reading [s].
    """

    def __init__(self, start: float = 0.0) -> None:
        self._now = start
        self._numbers = itertools.count()
        self._due: list[tuple[float, int, Callable[[], object]]] = []

    def now(self) -> float:
        """Return the virtual time [s]."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Let time pass [s]; what is due meanwhile is called in order, each at its instant."""
        end = self._now + max(seconds, 0.0)
        while self._due and self._due[0][0] <= end:
            instant, _, call = heapq.heappop(self._due)
            self._now = max(self._now, instant)
            call()
        self._now = max(self._now, end)

    def call_at(self, instant: float, call: Callable[[], object]) -> None:
        """Have a function called when an instant is reached [s]."""
        heapq.heappush(self._due, (instant, next(self._numbers), call))


SYSTEM_CLOCK = SystemClock()
"""The clock of every session that is not simulated in virtual time."""
