"""How few samples will do: the cheapest count that keeps the field around the focus within a tolerance.

The state at the focusing instant hardly depends on the count, since the law is exact for its own clock; what
more samples buy is the field in the milliseconds around it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.quantities import FloatArray, require_positive
from modaltouch.stimulus.stimulus import Stimulus
from modaltouch.stimulus.vibration import modal_history

LEAST_SAMPLES_PER_CYCLE = 2.5
"""Of the highest mode, whatever the tolerance [1]."""

_AROUND = 1e-3
"""Half of the stretch around the focusing instant that is compared [s]."""


@dataclass(frozen=True)
class SampleCount:
    """The cheapest count of samples, and what every count that was tried would cost in accuracy.

    Attributes
    ----------
    stimulus : Stimulus
        The design on the cheapest count.
    error : float
        Largest change of the field around the focus against the finest count, over its peak [1].
    tried : tuple of (int, float)
        Counts tried, and their errors [1].
    """

    stimulus: Stimulus
    error: float
    tried: tuple[tuple[int, float], ...]

    @property
    def n_samples(self) -> int:
        """The cheapest count."""
        return self.stimulus.timing.n_samples

    def __str__(self) -> str:
        """Say what was picked, and why."""
        finest = self.tried[-1][0]
        return (
            f"{self.n_samples} samples keep the field within {self.error:.1e} of that of {finest} samples; "
            f"tried {', '.join(f'{n}: {error:.1e}' for n, error in self.tried)}"
        )


def cheapest_samples(finest: Stimulus, tolerance: float, positions: ArrayLike) -> SampleCount:
    """Return the fewest samples, each held for whole clocks, that keep the field around the focus.

    Parameters
    ----------
    finest : Stimulus
        The design on the finest count, which the others are measured by.
    tolerance : float
        Allowed change of the field within 1 ms of the focusing instant, over the level [1].
    positions : (n_positions,) array_like
        Where the field is compared, origin at mid-beam [m].

    Returns
    -------
    SampleCount
        Never fewer than 2.5 samples per cycle of the highest mode; the finest count where no other will do.

    Raises
    ------
    ValueError
        If the tolerance is not above zero.
    """
    require_positive("the tolerance on the field", tolerance, "", "1e-3 of the level is a good start")
    shapes = finest.model.shapes(positions)
    reference = _around_focus(finest, finest.timing.n_samples)
    tried: list[tuple[int, float]] = []
    for count in _counts(finest):
        stimulus = replace(finest, timing=replace(finest.timing, n_samples=count))
        stride = finest.timing.n_samples // count
        change = _around_focus(stimulus, count) - reference[:, _offset(finest, stride) :: stride]
        error = float(np.abs(shapes.T @ change).max()) / finest.wish.velocity
        tried.append((count, error))
        if error <= tolerance:
            return SampleCount(stimulus, error, (*tried, (finest.timing.n_samples, 0.0)))
    return SampleCount(finest, 0.0, (*tried, (finest.timing.n_samples, 0.0)))


def _counts(finest: Stimulus) -> Iterator[int]:
    """Yield the counts that divide the finest, each sample held whole clocks, from the fewest on."""
    timing = finest.timing
    highest = float(finest.model.natural_frequency.max())
    least = max(2, math.ceil(LEAST_SAMPLES_PER_CYCLE * highest * timing.duration))
    for count in range(least, timing.n_samples):
        if timing.n_samples % count == 0 and replace(timing, n_samples=count).lateness is None:
            yield count


def _window(stimulus: Stimulus) -> tuple[float, float]:
    """Return where the compared stretch begins and ends [s]."""
    timing = stimulus.timing
    return max(0.0, timing.focusing_instant - _AROUND), min(timing.duration, timing.focusing_instant + _AROUND)


def _around_focus(stimulus: Stimulus, count: int) -> FloatArray:
    """Return the modal velocities around the focusing instant, (n_modes, n) array [m/s]."""
    begin, end = _window(stimulus)
    rate = count / stimulus.timing.duration
    first, last = math.ceil(begin * rate - 1e-6), math.floor(end * rate + 1e-6)
    history = modal_history(stimulus.model, stimulus.voltage, stimulus.timing, stimulus.amplifier)
    return history[:, first : last + 1]


def _offset(finest: Stimulus, stride: int) -> int:
    """Return the first sample of the finest window that a coarser clock has too."""
    begin, _ = _window(finest)
    first = math.ceil(begin * finest.timing.sampling_rate - 1e-6)
    return -first % stride
