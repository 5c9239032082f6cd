"""How strong each frequency is at each moment: the spectrogram of Fig. 8."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

WINDOW = 4e-3
"""Length of the Hann window: a mode of 229 Hz swings about once within it [s]."""

FINER = 4
"""Frequencies given for each that a window tells apart, so that the picture is smooth."""

STEP = 0.2e-3
"""From one window to the next [s]."""


@dataclass(frozen=True, eq=False)
class Spectrogram:
    """Amplitude of a velocity by frequency and time.

    Attributes
    ----------
    time : (n_times,) array
        Middle of each window [s].
    frequency : (n_frequencies,) array
        From 0 to the highest asked for [Hz].
    amplitude : (n_frequencies, n_times) array
        Amplitude of a steady sine that would give as much [m/s].
    """

    time: FloatArray
    frequency: FloatArray
    amplitude: FloatArray

    @classmethod
    def of(cls, time: FloatArray, velocity: FloatArray, highest: float) -> Self:
        """Return the spectrogram of a velocity.

        Parameters
        ----------
        time : (n_samples,) array
            Evenly spaced instants [s].
        velocity : (n_samples,) array
            Velocity of a point [m/s].
        highest : float
            Highest frequency that is kept [Hz].

        Raises
        ------
        ValueError
            If the record is shorter than a window.
        """
        step = (time[-1] - time[0]) / (time.size - 1)
        n_window, n_step = round(WINDOW / step), max(1, round(STEP / step))
        if velocity.size < n_window:
            raise ValueError(
                f"the record lasts {velocity.size * step * 1e3:g} ms, but a window of the spectrogram "
                f"{WINDOW * 1e3:g} ms: record longer"
            )
        window = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(n_window) + 0.5) / n_window)
        parts = np.lib.stride_tricks.sliding_window_view(velocity, n_window)[::n_step]
        frequency = np.fft.rfftfreq(FINER * n_window, step)
        kept = frequency <= highest
        amplitude = 2 / window.sum() * np.abs(np.fft.rfft(parts * window, FINER * n_window, axis=1)[:, kept])
        middle = time[0] + (np.arange(len(parts)) * n_step + (n_window - 1) / 2) * step
        return cls(middle, frequency[kept], amplitude.T)
