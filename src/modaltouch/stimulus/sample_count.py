"""The smallest number of samples that keeps the field around the focusing instant within a tolerance.

The state at the focusing instant hardly depends on that number, since the law is exact on any clock; more samples
improve the field in the milliseconds around it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.quantities import FloatArray, require_positive
from modaltouch.stimulus.stimulus import Stimulus
from modaltouch.stimulus.vibration import history

LEAST_SAMPLES_PER_CYCLE = 2.5
"""Fewest samples per cycle of the highest mode, whatever the tolerance [1]."""

_AROUND = 1e-3
"""Half-width of the time window around the focusing instant in which fields are compared [s]."""


@dataclass(frozen=True)
class SampleCount:
    """The smallest sufficient number of samples, and the errors of the numbers tried.

    Attributes
    ----------
    stimulus : Stimulus
        The design with that number of samples.
    error : float
        Largest deviation from the field of the finest design around the focusing instant, over the level [1].
    tried : tuple of (int, float)
        Numbers of samples tried, and their errors [1].
    """

    stimulus: Stimulus
    error: float
    tried: tuple[tuple[int, float], ...]

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return self.stimulus.timing.n_samples

    def __str__(self) -> str:
        """Return a sentence with the number chosen and the reason."""
        finest = self.tried[-1][0]
        return (
            f"{self.n_samples} samples keep the field within {self.error:.1e} of that of {finest} samples; "
            f"tried {', '.join(f'{n}: {error:.1e}' for n, error in self.tried)}"
        )


def cheapest_samples(finest: Stimulus, tolerance: float, positions: ArrayLike) -> SampleCount:
    """Return the smallest number of samples, each an integer number of clock cycles, that keeps the field.

    Parameters
    ----------
    finest : Stimulus
        The design with the most samples, the reference.
    tolerance : float
        Allowed change of the field within 1 ms of the focusing instant, over the level [1].
    positions : (n_positions,) array_like
        Points at which the field is compared, origin at mid-beam [m].

    Returns
    -------
    SampleCount
        At least 2.5 samples per cycle of the highest mode; the finest design if no other is sufficient.

    Raises
    ------
    ValueError
        If the tolerance is not above zero.
    """
    require_positive("the tolerance on the field", tolerance, "", "1e-3 of the level is a good start")
    shapes, most = finest.model.shapes(positions), finest.timing.n_samples
    reference, focus = _history(finest), finest.timing.focusing_instant
    begin, end = max(0.0, focus - _AROUND), min(finest.timing.duration, focus + _AROUND)
    tried: list[tuple[int, float]] = []
    for count in _counts(finest):
        stimulus = replace(finest, timing=replace(finest.timing, n_samples=count))
        samples = (begin * stimulus.timing.sampling_rate - 1e-6, end * stimulus.timing.sampling_rate + 1e-6)
        around = np.arange(math.ceil(samples[0]), math.floor(samples[1]) + 1)
        change = _history(stimulus)[:, around] - reference[:, around * (most // count)]
        error = float(np.abs(shapes.T @ change).max()) / finest.target_field.velocity
        tried.append((count, error))
        if error <= tolerance:
            break
    else:
        stimulus, error = finest, 0.0
    return SampleCount(stimulus, error, (*tried, (most, 0.0)))


def _counts(finest: Stimulus) -> Iterator[int]:
    """Yield, in increasing order, the even divisors of the finest number with an integer number of clocks per sample.

    A protocol accepts even numbers only.
    """
    timing = finest.timing
    highest = float(finest.model.natural_frequency.max())
    least = max(2, math.ceil(LEAST_SAMPLES_PER_CYCLE * highest * timing.duration))
    for count in range(least + least % 2, timing.n_samples, 2):
        if timing.n_samples % count == 0 and replace(timing, n_samples=count).clock_error is None:
            yield count


def _history(stimulus: Stimulus) -> FloatArray:
    return history(stimulus.system, stimulus.system.velocity, stimulus.voltage, stimulus.timing)
