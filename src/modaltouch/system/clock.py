"""The clock that stamps everything in a record: the machine's own, or a virtual one; and how well it keeps time."""

from __future__ import annotations

import heapq
import itertools
import time
import typing
from collections.abc import Callable, Mapping
from typing import Any


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


_WAIT_MS = 1.0
"""Pause of a window between two polls [ms]."""
_LATE_MS = 5.0
"""A machine that oversleeps by more is busy, or saves power [ms]."""


def measure_clock(n: int = 500) -> tuple[dict[str, Any], str]:
    """Return how accurately this machine keeps time, and what that means; takes about `n` milliseconds.

    Parameters
    ----------
    n : int
        Number of waits of a millisecond.

    Returns
    -------
    figures : dict
        ``name`` of the system's clock behind `time.perf_counter`; ``is_monotonic``, whether it can never be set back;
        ``drift_ppm``, how much faster the time of day ran meanwhile, large while the network corrects it; the
        smallest step seen (``step_ms``), and how long a wait of 1 ms takes (``wait_median_ms``, ``wait_p95_ms``,
        ``wait_max_ms``).
    verdict : str
        What they mean for an experiment, and what to do.
    """
    import statistics  # only here: every command loads this module

    about = time.get_clock_info("perf_counter")
    day, began = time.time(), time.perf_counter()
    waits = []
    for _ in range(n):
        started = time.perf_counter()
        time.sleep(_WAIT_MS / 1e3)
        waits.append((time.perf_counter() - started) * 1e3)
    passed = time.perf_counter() - began
    figures = {
        "name": about.implementation,
        "is_monotonic": about.monotonic and not about.adjustable,
        "drift_ppm": round((time.time() - day - passed) / passed * 1e6, 1),
        "step_ms": round(min(_step() for _ in range(100)) * 1e3, 6),
        "wait_median_ms": round(statistics.median(waits), 6),
        "wait_p95_ms": round(statistics.quantiles(waits, n=20)[-1], 6),
        "wait_max_ms": round(max(waits), 6),
    }
    return figures, judge_clock(figures)


def judge_clock(figures: Mapping[str, Any]) -> str:
    """Return what the figures of a clock mean for an experiment, and what to do."""
    lines = []
    if not figures["is_monotonic"] or figures["step_ms"] > 0.1:
        lines.append(
            f"The clock {figures['name']} steps by {figures['step_ms']:.2g} ms or can be set: state this with every "
            "reaction time, or use another machine."
        )
    median, p95 = figures["wait_median_ms"], figures["wait_p95_ms"]
    advice = "close other programs, and switch power saving off" if p95 > _WAIT_MS + _LATE_MS else "good"
    lines.append(f"A wait of 1 ms takes {median:.2f} ms, 95 % of them under {p95:.1f} ms: {advice}.")
    if abs(figures["drift_ppm"]) > 500:
        lines.append("The time of day is being corrected: wait a few minutes.")
    return " ".join(lines)


def _step() -> float:
    first = then = time.perf_counter()
    while then == first:
        then = time.perf_counter()
    return then - first
