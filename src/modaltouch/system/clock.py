"""Clocks for all time stamps of a record, real or virtual."""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable


class SystemClock:
    """The monotonic clock of the machine, the same for all its processes."""

    def now(self) -> float:
        """Return `time.perf_counter` [s]."""
        return time.perf_counter()

    def sleep(self, seconds: float) -> None:
        """Wait for a duration [s]; return immediately if it is not positive."""
        time.sleep(max(seconds, 0.0))


class VirtualClock:
    """A clock whose time advances only in `sleep`, without waiting.

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
        """Advance the time by a duration [s]; make the calls due in between, in order, each at its instant."""
        end = self._now + max(seconds, 0.0)
        while self._due and self._due[0][0] <= end:
            instant, _, call = heapq.heappop(self._due)
            self._now = max(self._now, instant)
            call()
        self._now = max(self._now, end)

    def call_at(self, instant: float, call: Callable[[], object]) -> None:
        """Schedule a call at an instant [s]."""
        heapq.heappush(self._due, (instant, next(self._numbers), call))


Clock = SystemClock | VirtualClock
"""A clock, an argument of window, session, generator driver and twin."""

SYSTEM_CLOCK = SystemClock()
"""Clock of all sessions except those simulated in virtual time."""
