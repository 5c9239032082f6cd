"""A burst: the codes of both channels that the generator plays at each trigger, and their amplitudes."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.correction import LevelCorrections, corrected
from modaltouch.stimulus.quantisation import Converter


@dataclass(frozen=True, eq=False)
class Burst:
    """Codes common to all levels; a level changes only the amplitudes.

    Attributes
    ----------
    codes : (n_channels, n_samples) array of uint16
        Codes of `converter`; the first and the last are its code for zero volts.
    duration : float
        Length of one burst [s].
    repetition_rate : float
        Bursts per second [Hz].
    velocity : float
        Level for which `amplitude` holds [m/s].
    amplitude : tuple of float
        Amplitude of each channel's full scale at `velocity` [V peak to peak, open circuit].
    converter : Converter
        Converter that turns the codes into voltages.
    corrections : tuple of (float, float)
        Levels [m/s], each with the amplitude factor that a calibration measured [1].
    """

    codes: NDArray[np.uint16]
    duration: float
    repetition_rate: float
    velocity: float
    amplitude: tuple[float, ...]
    converter: Converter
    corrections: LevelCorrections = ()

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the codes as they are sent: big-endian, channel after channel."""
        return hashlib.sha256(self.codes.astype(">u2").tobytes()).hexdigest()

    @cached_property
    def peaks(self) -> tuple[float, ...]:
        """Peak of each channel's record relative to half of full scale [1]."""
        return self._highest(self.codes)

    @cached_property
    def ends(self) -> tuple[float, ...]:
        """Larger magnitude of the first and last value of each channel's record, relative to half of full scale [1]."""
        return self._highest(self.codes[:, [0, -1]])

    @cached_property
    def shares(self) -> NDArray[np.float64]:
        """Amplitude of each channel relative to its full scale, (n_channels,) array [1]."""
        return self.converter.shares(self.codes)

    def _highest(self, codes: NDArray[np.uint16]) -> tuple[float, ...]:
        zero = self.converter.mid_code
        return tuple(float(code) for code in np.abs(codes.astype(np.int32) - zero).max(axis=1) / zero)

    def amplitude_for(self, velocity: float) -> tuple[float, ...]:
        """Return the amplitude of each channel at a level [m/s], on the instrument's grid [V peak to peak]."""
        level = corrected(velocity, self.corrections)
        return self.converter.amplitudes_at(self.amplitude, level, self.velocity, self.shares)

    def full_scale_for(self, velocity: float) -> tuple[float, ...]:
        """Return the amplitude of each channel's full scale at a level [m/s], [V peak to peak, open circuit]."""
        return tuple(a / share for a, share in zip(self.amplitude_for(velocity), self.shares.tolist(), strict=True))
