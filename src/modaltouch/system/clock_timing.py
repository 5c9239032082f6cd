"""How exactly a machine keeps time: the steps of its clock, its waits, its drift."""

from __future__ import annotations

import statistics
import time
from dataclasses import asdict, dataclass
from typing import Any

_WAIT = 1e-3
"""What a window rests between two polls [s]."""
_LATE = 5e-3
"""A machine that oversleeps by more is busy, or saves power [s]."""


@dataclass(frozen=True)
class ClockTiming:
    """What was measured of the clock.

    Attributes
    ----------
    name : str
        Of the system's clock behind `time.perf_counter`.
    is_monotonic : bool
        Whether it can never be set back.
    step : float
        Smallest step that was seen [s].
    wait_median, wait_p95, wait_max : float
        How long a wait of 1 ms takes [s].
    drift_ppm : float
        How much faster the time of day ran than the clock meanwhile [ppm]; large while the network sets it right.
    """

    name: str
    is_monotonic: bool
    step: float
    wait_median: float
    wait_p95: float
    wait_max: float
    drift_ppm: float

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as plain values, times in milliseconds."""
        values = asdict(self)
        for name in ("step", "wait_median", "wait_p95", "wait_max"):
            values[f"{name}_ms"] = round(values.pop(name) * 1e3, 6)
        return values

    @property
    def verdict(self) -> str:
        """What the figures mean for an experiment, and what to do."""
        lines = []
        if not self.is_monotonic or self.step > 1e-4:
            lines.append(
                f"The clock {self.name} steps by {self.step * 1e3:.2g} ms or can be set: state this with every "
                "reaction time, or use another machine."
            )
        said = f"A wait of 1 ms takes {self.wait_median * 1e3:.2f} ms, 95 % of them under {self.wait_p95 * 1e3:.1f} ms"
        if self.wait_p95 > _WAIT + _LATE:
            lines.append(f"{said}: close other programs, and switch power saving off.")
        else:
            lines.append(f"{said}: good.")
        if abs(self.drift_ppm) > 500:
            lines.append("The time of day is just being set: wait some minutes.")
        return " ".join(lines)


def measure_clock(n: int = 500) -> ClockTiming:
    """Return how exactly this machine keeps time; takes about as many milliseconds.

    Parameters
    ----------
    n : int
        Waits of a millisecond.
    """
    about = time.get_clock_info("perf_counter")
    day, began = time.time(), time.perf_counter()
    waits = []
    for _ in range(n):
        started = time.perf_counter()
        time.sleep(_WAIT)
        waits.append(time.perf_counter() - started)
    passed = time.perf_counter() - began
    return ClockTiming(
        name=about.implementation,
        is_monotonic=about.monotonic and not about.adjustable,
        step=min(_step() for _ in range(100)),
        wait_median=statistics.median(waits),
        wait_p95=statistics.quantiles(waits, n=20)[-1],
        wait_max=max(waits),
        drift_ppm=round((time.time() - day - passed) / passed * 1e6, 1),
    )


def _step() -> float:
    first = then = time.perf_counter()
    while then == first:
        then = time.perf_counter()
    return then - first
