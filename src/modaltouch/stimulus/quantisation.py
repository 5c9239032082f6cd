"""From volts to codes: a generator's converter, which rounds voltages to codes and amplitudes to a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.quantities import FloatArray

_LONGEST_STRETCH = 1.05
"""Largest ratio of full scale to the peak, which costs a fifteenth of a bit [1]."""


@dataclass(frozen=True)
class Converter:
    """An instrument's converter: code ``c`` stands for ``(c / mid_code - 1) * full_scale / 2`` volts.

    Attributes
    ----------
    mid_code : int
        Code of zero volts; codes run from 0 to twice that.
    max_points : int
        Length of the longest record [points].
    clock_rate : float
        Rate of its clock [Hz].
    amplitude_digits, amplitude_decimals : int
        Most significant digits and most decimals of an amplitude in volts peak to peak.
    of_record : bool
        Whether an amplitude spans the record, from its lowest code to its highest; else it spans all codes, the full
        scale.
    any_rate : bool
        Whether its clock adapts to the sampling rate, so that no sample begins late.
    """

    mid_code: int
    max_points: int
    clock_rate: float
    amplitude_digits: int
    amplitude_decimals: int
    of_record: bool = False
    any_rate: bool = False

    def shares(self, codes: FloatArray | NDArray[np.uint16]) -> FloatArray:
        """Return the amplitude of each channel of a record relative to its full scale, (n_channels,) array [1]."""
        shares = np.ones(codes.shape[0])
        if self.of_record:
            span = np.subtract(codes.max(axis=1), codes.min(axis=1), dtype=float)
            np.divide(span, 2 * self.mid_code, out=shares, where=span > 0)
        return shares

    def round_amplitude(self, amplitude: float) -> float:
        """Return an amplitude rounded to the instrument's grid [V peak to peak]."""
        return max(round(float(f"{amplitude:.{self.amplitude_digits}g}"), self.amplitude_decimals), 0.0)

    def amplitudes_at(
        self, full_scale: tuple[float, ...], velocity: float, reference: float, shares: FloatArray
    ) -> tuple[float, ...]:
        """Return the amplitudes at a level, on the instrument's grid, from the full scales at a reference level [V]."""
        each = zip(full_scale, shares.tolist(), strict=True)
        return tuple(self.round_amplitude(full * velocity / reference * share) for full, share in each)

    def full_scale(self, least: float, shares: tuple[float, ...]) -> float:
        """Return a full scale, at or above the least, for which the amplitudes of all levels are close to the grid.

        Parameters
        ----------
        least : float
            Smallest amplitude that holds the peak [V peak to peak].
        shares : tuple of float
            Levels as fractions of the highest [1].

        Returns
        -------
        float
            Of the amplitudes up to 5 % above the least, the one whose products with `shares` are closest to the grid;
            the smallest, if several are [V peak to peak].
        """
        if least <= 0:
            return 0.0
        step = max(10.0 ** (np.floor(np.log10(least)) + 1 - self.amplitude_digits), 10.0**-self.amplitude_decimals)
        first = int(np.ceil(least / step - 1e-9))
        last = max(first, int(least * _LONGEST_STRETCH / step))
        best, smallest_miss = self.round_amplitude(first * step), np.inf
        for count in range(first, last + 1):
            candidate = self.round_amplitude(count * step)
            # Above a power of ten the grid is coarser than `step`: rounding may leave the range at either end.
            if not least * (1 - 1e-12) <= candidate <= max(least * _LONGEST_STRETCH, first * step) * (1 + 1e-12):
                continue
            miss = max((abs(self.round_amplitude(candidate * s) / (candidate * s) - 1) for s in shares), default=0.0)
            if miss < smallest_miss - 1e-12:
                best, smallest_miss = candidate, miss
            if smallest_miss < 1e-12:
                break
        return best

    def round_to_codes(self, voltage: FloatArray, volts_per_code: FloatArray) -> FloatArray:
        """Return the nearest signed codes; the first and the last are 0, where the generator idles.

        Parameters
        ----------
        voltage : (n_channels, n_samples) array
            Voltages at the beam [V].
        volts_per_code : (n_channels,) array
            Voltage of one code at the beam [V]; 0 for a silent channel.

        Returns
        -------
        (n_channels, n_samples) array
            Whole numbers from minus to plus `mid_code` [1].

        Raises
        ------
        ValueError
            If a voltage exceeds the full scale.
        """
        steps = np.empty(voltage.shape)
        for channel, (row, unit, out) in enumerate(zip(voltage, volts_per_code, steps, strict=True)):
            if unit <= 0:
                out[:] = 0.0
                continue
            np.rint(np.divide(row, unit, out=out), out=out)
            if max(out.max(), -out.min()) > self.mid_code:
                raise ValueError(
                    f"channel {channel + 1} peaks at {np.abs(row).max():g} V, beyond its full scale of "
                    f"{unit * self.mid_code:g} V: raise the full scale"
                )
        steps[:, 0] = steps[:, -1] = 0.0
        return steps

    def unsigned(self, signed: FloatArray) -> NDArray[np.uint16]:
        """Return codes for the generator from codes relative to mid-scale, array of the same shape."""
        codes = np.empty(signed.shape, dtype=np.uint16)
        return np.add(signed, self.mid_code, out=codes, casting="unsafe")

    def signed(self, codes: NDArray[np.uint16]) -> FloatArray:
        """Return codes relative to mid-scale from codes for the generator, array of the same shape."""
        return np.subtract(codes, self.mid_code, dtype=float)
