"""Measures how soon the generator does as it is told, with nothing played: its outputs stay off."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass
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
    times : dict of str to float
        ``open``, from nothing to a known state, watchdog and all; ``level_median``, ``level_p95`` and ``level_max``,
        both amplitudes set and read back, and the error queue read; ``off_median``, ``off_p95`` and ``off_max``, both
        outputs switched off and every setting compared [s].
    """

    address: str
    identity: str
    n: int
    times: dict[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as plain values, times in milliseconds."""
        times = {f"{name}_ms": round(value * 1e3, 3) for name, value in self.times.items()}
        return {"address": self.address, "identity": self.identity, "n": self.n, **times}

    @property
    def verdict(self) -> str:
        """What the figures mean for an experiment, and what to do."""
        level, off = self.times["level_p95"], self.times["off_p95"]
        said = (
            f"A level is set and confirmed within {level * 1e3:.1f} ms, both outputs are off within {off * 1e3:.1f} ms "
            "(95 %)"
        )
        if level <= _PROMPT:
            return f"{said}: good."
        if level <= _SLOW:
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
    amplitudes = itertools.cycle(_AMPLITUDES)
    commands: dict[str, Callable[[], object]] = {"level": lambda: set_levels((next(amplitudes),) * 2), "off": rig.stop}
    times = {"open": opened}
    for name, command in commands.items():
        taken = np.empty(n)
        for k in range(n):
            started = time.perf_counter()
            command()
            taken[k] = time.perf_counter() - started
            rig.heartbeat()
        median, p95, longest = np.quantile(taken, (0.5, 0.95, 1.0)).tolist()
        times |= {f"{name}_median": median, f"{name}_p95": p95, f"{name}_max": longest}
    return CommandLatency(rig.address, rig.identity, n, times)
