"""Measures how soon the generator does as it is told, with nothing played: its outputs stay off."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from modaltouch.rig.interface import Rig

_AMPLITUDES = (0.02, 0.03)
"""Amplitudes between which the level goes to and fro, the lowest there are [V peak to peak]."""
_PROMPT = 10e-3
"""A level is set, read back and found without error sooner than this on a healthy connection [s]."""
_SLOW = 50e-3
"""What the program itself may take between an answer and the next burst; an instrument slower than that shows [s]."""


@dataclass(frozen=True)
class CommandLatency:
    """What was measured of a generator.

    Attributes
    ----------
    address, identity : str
        Which one.
    n : int
        Commands of each kind.
    open : float
        From nothing to a known state, watchdog and all [s].
    level_median, level_p95, level_max : float
        Both amplitudes set and read back, and the error queue read [s].
    off_median, off_p95, off_max : float
        Both outputs switched off and every setting compared [s].
    """

    address: str
    identity: str
    n: int
    open: float
    level_median: float
    level_p95: float
    level_max: float
    off_median: float
    off_p95: float
    off_max: float

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as plain values, times in milliseconds."""
        times = {
            f"{name}_ms": round(value * 1e3, 3) for name, value in asdict(self).items() if isinstance(value, float)
        }
        return {"address": self.address, "identity": self.identity, "n": self.n, **times}

    @property
    def verdict(self) -> str:
        """What the figures mean for an experiment, and what to do."""
        said = (
            f"A level is set and confirmed within {self.level_p95 * 1e3:.1f} ms, both outputs are off within "
            f"{self.off_p95 * 1e3:.1f} ms (95 %)"
        )
        if self.level_p95 <= _PROMPT:
            return f"{said}: good."
        if self.level_p95 <= _SLOW:
            return f"{said}: each trial begins that much later; a dedicated cable to the generator is faster."
        return (
            f"{said}: too slow. Connect the generator directly or by one switch, not by a radio link or a busy "
            "network, and measure again."
        )


def measure(rig: Rig, set_levels: Callable[[tuple[float, ...]], object], opened: float, *, n: int) -> CommandLatency:
    """Return how soon a generator does as it is told.

    Parameters
    ----------
    rig : Rig
        The generator, its outputs off.
    set_levels : callable
        Sets both amplitudes and confirms them.
    opened : float
        How long opening it took [s].
    n : int
        Commands of each kind.
    """
    levels, offs = np.empty(n), np.empty(n)
    for k in range(n):
        started = time.perf_counter()
        set_levels((_AMPLITUDES[k % 2],) * 2)
        levels[k] = time.perf_counter() - started
        rig.heartbeat()
    for k in range(n):
        started = time.perf_counter()
        rig.stop()
        offs[k] = time.perf_counter() - started
        rig.heartbeat()
    return CommandLatency(rig.address, rig.identity, n, opened, *_summarise(levels), *_summarise(offs))


def _summarise(times: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[float, float, float]:
    return float(np.median(times)), float(np.quantile(times, 0.95)), float(times.max())
