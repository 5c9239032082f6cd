"""The clock that stamps everything in a record: the machine's own, or a virtual one."""

from __future__ import annotations

import heapq
import itertools
import time
import typing
from collections.abc import Callable


class Clock(typing.Protocol):
    """Tells the time and waits; window, session, generator driver and twin each take one as an argument."""

    def now(self) -> float:
        """Return the time since an arbitrary zero [s]."""

    def sleep(self, seconds: float) -> None:
        """Let time pass [s]."""


class SystemClock:
    """The machine's monotonic clock; all its processes read the same time."""

    def now(self) -> float:
        """Return `time.perf_counter` [s]."""
        return time.perf_counter()

    def sleep(self, seconds: float) -> None:
        """Wait [s]; return at once if the time is not positive."""
        time.sleep(max(seconds, 0.0))


class VirtualClock:
    """A clock whose time passes only in `sleep`, and there at once.

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
        """Advance the time [s]; call whatever falls due in between, in order and each at its instant."""
        end = self._now + max(seconds, 0.0)
        while self._due and self._due[0][0] <= end:
            instant, _, call = heapq.heappop(self._due)
            self._now = max(self._now, instant)
            call()
        self._now = max(self._now, end)

    def call_at(self, instant: float, call: Callable[[], object]) -> None:
        """Call a function when an instant is reached [s]."""
        heapq.heappush(self._due, (instant, next(self._numbers), call))


SYSTEM_CLOCK = SystemClock()
"""The clock of every session that is not simulated in virtual time."""
