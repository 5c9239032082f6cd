"""What is kept of a recording of a periodic excitation: its spectra, up to a highest frequency."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.arrays import ComplexArray, FloatArray
from modaltouch.rig import Recording


class LowTransform:
    r"""The lowest lines of a Fourier transform, by decimation in time.

    With :math:`Y_s` the transform of every r-th sample from s on, :math:`X_k = \sum_s e^{-2\pi i k s/n} Y_s(k)`. The r
    short transforms fit into the cache and take a quarter of the time of the full one, most lines of which are not
    needed. Single precision adds a millionth of a converter's noise.

    Parameters
    ----------
    n_samples : int
        Length of a record.
    n_lines : int
        Number of lines, from the first one above 0 Hz.
    """

    def __init__(self, n_samples: int, n_lines: int) -> None:
        self._n_parts = next(r for r in (8, 4, 2, 1) if n_samples % r == 0 and (r == 1 or n_samples >= 2 * r * n_lines))
        self._lines = slice(1, n_lines + 1)
        turns = np.outer(np.arange(1, n_lines + 1) / n_samples, np.arange(self._n_parts))
        self._turned = np.exp(-2j * np.pi * turns).astype(np.complex64)

    def __call__(self, record: FloatArray) -> ComplexArray:
        """Return the lines of a record, (n_lines,) array."""
        from scipy.fft import rfft

        parts = rfft(record.astype(np.float32).reshape(-1, self._n_parts), axis=0)[self._lines]
        return np.asarray(np.einsum("kr,kr->k", parts, self._turned), dtype=complex)


low_transform = lru_cache(maxsize=1)(LowTransform)
"""Cached, since the records of a scan have the same length at every point."""


class Spectra:
    """Reduces each recording of a periodic excitation to its powers and cross power, averaged over its records.

    Parameters
    ----------
    highest : float
        Highest frequency kept [Hz].
    """

    __name__ = "spectra"

    def __init__(self, highest: float) -> None:
        self.highest = highest

    def __call__(self, recording: Recording) -> Mapping[str, NDArray[Any]]:
        """Return the averaged spectra of the velocity and the first drive."""
        n = recording.time.size
        frequency = np.fft.rfftfreq(n, 1 / recording.sampling_rate)
        frequency = frequency[1 : int(np.searchsorted(frequency, self.highest, side="right"))]
        transform = low_transform(n, frequency.size)
        # One record at a time: all of them together would take a hundred megabytes.
        velocity, drive = (
            np.array([transform(record) for record in records]) / n
            for records in (recording.velocity, recording.drive[:, 0])
        )
        return {
            "frequency": frequency,
            "drive_power": (np.abs(drive) ** 2).mean(axis=0),
            "velocity_power": (np.abs(velocity) ** 2).mean(axis=0),
            "cross_power": (np.conj(drive) * velocity).mean(axis=0),
            "n_records": np.array(recording.velocity.shape[0]),
        }
