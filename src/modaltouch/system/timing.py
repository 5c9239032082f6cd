"""Measurement of how accurately this machine keeps time, and what that means for an experiment."""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping
from typing import Any

_WAIT_MS = 1.0
"""Time between two polls of a window [ms]."""
_LATE_MS = 5.0
"""Overshoot of a wait above which the machine is busy or saving power [ms]."""


def measure_clock(n: int = 500) -> tuple[dict[str, Any], str]:
    """Measure the accuracy of this machine's clock and assess it; takes about `n` milliseconds.

    Parameters
    ----------
    n : int
        Number of waits of 1 ms.

    Returns
    -------
    figures : dict
        ``name`` of the system clock behind `time.perf_counter`; ``is_monotonic``; ``drift_ppm``, the drift of the time
        of day relative to it, which is large during network time corrections; ``step_ms``, the smallest step observed;
        and the duration of a 1 ms wait (``wait_median_ms``, ``wait_p95_ms``, ``wait_max_ms``).
    verdict : str
        Consequences for an experiment and recommended action.
    """
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
    return figures, assess_clock(figures)


def assess_clock(figures: Mapping[str, Any]) -> str:
    """Return the consequences of the figures of a clock for an experiment, and the recommended action."""
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
