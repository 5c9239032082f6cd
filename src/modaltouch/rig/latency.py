"""Measures how soon the generator does as it is told, with nothing played: its outputs stay off."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from modaltouch.rig.interface import Rig

_AMPLITUDES = (0.02, 0.03)
"""Amplitudes between which the level goes to and fro, the lowest there are [V peak to peak]."""
_PROMPT_MS = 10.0
"""A level is set, read back and found without error sooner than this on a healthy connection [ms]."""
_SLOW_MS = 50.0
"""What the program itself may take between an answer and the next burst; an instrument slower than that shows [ms]."""


def measure(
    rig: Rig, set_levels: Callable[[tuple[float, ...]], object], opened: float, *, n: int
) -> tuple[dict[str, Any], str]:
    """Return how soon a generator does as it is told, and what that means.

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

    Returns
    -------
    figures : dict
        ``address``, ``identity`` and ``n``; ``open_ms``, from nothing to a known state, watchdog and all; median, 95 %
        and maximum of ``level``, both amplitudes set and read back and the error queue read, and of ``off``, both
        outputs switched off and every setting compared (``level_median_ms``, ``off_p95_ms``, ...).
    verdict : str
        What they mean for an experiment, and what to do.
    """
    amplitudes = itertools.cycle(_AMPLITUDES)
    commands: dict[str, Callable[[], object]] = {"level": lambda: set_levels((next(amplitudes),) * 2), "off": rig.stop}
    figures = {"address": rig.address, "identity": rig.identity, "n": n, "open_ms": round(opened * 1e3, 3)}
    for name, command in commands.items():
        taken = np.empty(n)
        for k in range(n):
            started = time.perf_counter()
            command()
            taken[k] = (time.perf_counter() - started) * 1e3
            rig.heartbeat()
        median, p95, longest = np.quantile(taken, (0.5, 0.95, 1.0)).round(3).tolist()
        figures |= {f"{name}_median_ms": median, f"{name}_p95_ms": p95, f"{name}_max_ms": longest}
    return figures, judge_latency(figures)


def judge_latency(figures: Mapping[str, Any]) -> str:
    """Return what the figures of a generator mean for an experiment, and what to do."""
    level, off = figures["level_p95_ms"], figures["off_p95_ms"]
    advice = "good"
    if level > _SLOW_MS:
        advice = (
            "too slow. Connect the generator directly or through one switch, not over a radio link or a busy "
            "network, and measure again"
        )
    elif level > _PROMPT_MS:
        advice = "each trial begins that much later; a dedicated cable to the generator is faster"
    taken = f"A level is set and confirmed within {level:.1f} ms, both outputs are off within {off:.1f} ms (95 %)"
    return f"{taken}: {advice}."
