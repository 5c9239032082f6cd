"""Timing of a burst: its samples, the clock that plays them, and the focusing instant."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from modaltouch.stimulus.quantisation import Converter
from modaltouch.stimulus.quantities import FloatArray, require_positive

_ON_GRID = 1e-6
"""Distance from the sample grid, in samples, below which an instant counts as on it [1]."""


@dataclass(frozen=True)
class Timing:
    """One burst on the generator's clock.

    Attributes
    ----------
    converter : Converter
        Converter of the generator, with its clock and the length of its longest record.
    n_samples : int
        Number of samples of each channel, at least 2.
    duration : float
        Length of the burst [s].
    focusing_instant : float
        Time from the start of the burst to the instant at which the target field is reached [s].
    repetition_rate : float
        Bursts per second [Hz].
    """

    converter: Converter
    n_samples: int = 125_000
    duration: float = 0.05
    focusing_instant: float = 0.025
    repetition_rate: float = 7.0

    def __post_init__(self) -> None:
        """Refuse a burst that the generator cannot play."""
        if not 2 <= self.n_samples <= self.converter.max_points:
            raise ValueError(
                f"a burst of {self.n_samples} samples does not fit the generator, which holds 2 to "
                f"{self.converter.max_points}: take 125000 over 50 ms, which it holds exactly 100 clocks each"
            )
        require_positive("the duration of the burst", self.duration, "s", "50 ms is the paper's")
        require_positive("the repetition rate", self.repetition_rate, "Hz", "7 Hz is the paper's")
        require_positive("the clock rate", self.clock_rate, "Hz", "the generator's data sheet states it")
        require_positive("the focusing instant", self.focusing_instant, "s", "25 ms is the paper's")
        if self.duration * self.repetition_rate > 1 + 1e-12:
            raise ValueError(
                f"a burst of {self.duration * 1e3:g} ms does not fit the period of "
                f"{1e3 / self.repetition_rate:g} ms: shorten the burst or lower the repetition rate of "
                f"{self.repetition_rate:g} Hz"
            )
        if self.focusing_instant < self.hold * (1 - _ON_GRID):
            raise ValueError(
                f"the focusing instant of {self.focusing_instant:g} s is shorter than one sample of "
                f"{self.hold:g} s: set it later, or take more samples"
            )
        if self.focusing_instant > self.duration * (1 + 1e-12):
            raise ValueError(
                f"the focusing instant of {self.focusing_instant * 1e3:g} ms lies beyond the burst of "
                f"{self.duration * 1e3:g} ms: set it earlier, or lengthen the burst"
            )
        if self.hold * self.clock_rate < 1 - 1e-12:
            raise ValueError(
                f"{self.n_samples} samples in {self.duration:g} s exceed the clock rate of {self.clock_rate:g} Hz: "
                f"take at most {int(self.duration * self.clock_rate)}"
            )

    @property
    def clock_rate(self) -> float:
        """Clock of the generator [Hz]."""
        return self.converter.clock_rate

    @property
    def hold(self) -> float:
        """Duration of each sample [s]."""
        return self.duration / self.n_samples

    @property
    def sampling_rate(self) -> float:
        """Samples per second [Hz]."""
        return self.n_samples / self.duration

    def samples_until(self, instant: float) -> tuple[int, float]:
        """Return the number of samples that end by an instant, and the remaining time.

        Parameters
        ----------
        instant : float
            Time from the start of the burst [s].

        Returns
        -------
        n_samples : int
            Number of whole samples that end by then, at most all of them.
        remainder : float
            Time from the end of the last of them to the instant [s]; 0 on the grid.
        """
        steps = instant * self.sampling_rate
        nearest = round(steps)
        whole = nearest if abs(steps - nearest) < _ON_GRID else int(np.floor(steps))
        whole = max(0, min(whole, self.n_samples))
        remainder = (steps - whole) * self.hold
        return whole, 0.0 if abs(remainder) < _ON_GRID * self.hold else remainder

    @cached_property
    def clock_error(self) -> FloatArray | None:
        """Delay with which the clock begins each sample, (n_samples + 1,) array [s], or None if it is never late.

        A clock that adapts to any rate is never late. A phase accumulator plays sample
        ``floor(clock * n_samples / n_clocks)``: if the number of clock cycles in a burst is not a multiple of the
        number of samples, sample n begins at the first clock edge at or after ``n * hold``.
        """
        clocks = self.duration * self.clock_rate / self.n_samples
        if self.converter.any_rate or abs(clocks - round(clocks)) < 1e-9 * clocks:
            return None
        ideal = np.arange(self.n_samples + 1) * clocks
        late = np.ceil(ideal - 1e-6) - ideal
        return np.asarray(np.maximum(late, 0.0) / self.clock_rate)
