"""A burst: the two channels' codes that the generator plays at each trigger, and their amplitude."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.correction import Trims, trimmed

MID_CODE = 8191
"""Code of zero volts; codes run from 0 to 16382."""


@dataclass(frozen=True, eq=False)
class Burst:
    """Codes common to all levels; a level changes the amplitude alone.

    The generator plays ``(code - 8191) / 8191 * amplitude / 2`` volts into an open circuit.

    Attributes
    ----------
    codes : (n_channels, n_samples) array of uint16
        Unsigned 14-bit codes, 0 to 16382; first and last are 8191.
    duration : float
        Length of one burst [s].
    repetition_rate : float
        Bursts per second [Hz].
    velocity : float
        Level for which `amplitude` holds [m/s].
    amplitude : tuple of float
        Amplitude of each channel at `velocity` [V peak to peak, open circuit].
    trims : tuple of (float, float)
        Levels [m/s], each with the factor of its amplitude that a calibration measured [1].
    """

    codes: NDArray[np.uint16]
    duration: float
    repetition_rate: float
    velocity: float
    amplitude: tuple[float, ...]
    trims: Trims = ()

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the codes as they travel: big-endian, channel after channel."""
        return hashlib.sha256(self.codes.astype(">u2").tobytes()).hexdigest()

    def amplitude_for(self, velocity: float) -> tuple[float, ...]:
        """Return the amplitude of each channel at a level, on the instrument's grid [V peak to peak].

        Parameters
        ----------
        velocity : float
            Peak velocity at the focus [m/s].
        """
        return amplitudes_at(self.amplitude, trimmed(velocity, self.trims), self.velocity)


def amplitudes_at(amplitude: tuple[float, ...], velocity: float, reference: float) -> tuple[float, ...]:
    """Return amplitudes at a level, on the instrument's grid [V peak to peak].

    Parameters
    ----------
    amplitude : tuple of float
        Of each channel at the reference level [V peak to peak].
    velocity, reference : float
        The level, and that for which the amplitudes hold [m/s].
    """
    return tuple(round_amplitude(a * velocity / reference) for a in amplitude)


def round_amplitude(amplitude: float) -> float:
    """Return an amplitude on the generator's grid: four digits, never finer than 0.1 mV [V peak to peak]."""
    return max(round(float(f"{amplitude:.4g}"), 4), 0.0)
