"""A burst as the generator plays it: clock, converter, codes and amplitudes of both channels."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.quantities import FloatArray

_LONGEST_STRETCH = 1.05
"""Largest ratio of full scale to peak; it costs a fifteenth of a bit [1]."""


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
        Largest number of significant digits and of decimals of an amplitude in volts peak to peak.
    of_record : bool
        Whether an amplitude spans the record, from its lowest to its highest code, rather than the full scale.
    any_rate : bool
        Whether the clock adapts to the sampling rate, so that no sample begins late.
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
        """Return a full scale, at or slightly above the least, that puts the amplitudes of all levels near the grid.

        Parameters
        ----------
        least : float
            Smallest amplitude that holds the peak [V peak to peak].
        shares : tuple of float
            Levels as fractions of the highest [1].

        Returns
        -------
        float
            Amplitude at most 5 % above the least whose products with `shares` are closest to the grid; the smallest of
            several that are equally close [V peak to peak].
        """
        if least <= 0:
            return 0.0
        step = max(10.0 ** (np.floor(np.log10(least)) + 1 - self.amplitude_digits), 10.0**-self.amplitude_decimals)
        first = int(np.ceil(least / step - 1e-9))
        last = max(first, int(least * _LONGEST_STRETCH / step))
        best, smallest_miss = self.round_amplitude(first * step), np.inf
        for count in range(first, last + 1):
            candidate = self.round_amplitude(count * step)
            # Above a power of ten the grid is coarser than `step`, and rounding may leave the range.
            if not least * (1 - 1e-12) <= candidate <= max(least * _LONGEST_STRETCH, first * step) * (1 + 1e-12):
                continue
            miss = max((abs(self.round_amplitude(candidate * s) / (candidate * s) - 1) for s in shares), default=0.0)
            if miss < smallest_miss - 1e-12:
                best, smallest_miss = candidate, miss
            if smallest_miss < 1e-12:
                break
        return best

    def round_to_codes(self, voltage: FloatArray, volts_per_code: FloatArray) -> FloatArray:
        """Return the nearest signed codes; the first and the last are 0, the level at which the generator idles.

        Parameters
        ----------
        voltage : (n_channels, n_samples) array
            Voltages at the beam [V].
        volts_per_code : (n_channels,) array
            Voltage of one code at the beam [V]; 0 for a silent channel.

        Returns
        -------
        (n_channels, n_samples) array
            Integers from ``-mid_code`` to ``mid_code`` [1].

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
        """Convert codes relative to mid-scale to the generator's codes, array of the same shape."""
        return np.add(signed, self.mid_code, out=np.empty(signed.shape, dtype=np.uint16), casting="unsafe")

    def signed(self, codes: NDArray[np.uint16]) -> FloatArray:
        """Convert the generator's codes to codes relative to mid-scale, array of the same shape."""
        return np.subtract(codes, self.mid_code, dtype=float)


_ON_GRID = 1e-6
"""Tolerance for an instant to lie on the sample grid [samples]."""


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
    at_samples : bool
        Whether peaks are sought at the starts of samples only, as in earlier versions, and not between long ones.
    """

    converter: Converter
    n_samples: int = 125_000
    duration: float = 0.05
    focusing_instant: float = 0.025
    repetition_rate: float = 7.0
    at_samples: bool = False

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
            Number of whole samples that end by then, at most `Timing.n_samples`.
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
        """Delay of the start of each sample on the clock, (n_samples + 1,) array [s], or None if it is never late.

        A clock that adapts to any rate is never late. A phase accumulator plays sample
        ``floor(clock * n_samples / n_clocks)``: if the number of clock cycles in a burst is not a multiple of the
        number of samples, sample n begins at the first clock edge at or after ``n * hold``.
        """
        clocks = self.duration * self.converter.clock_rate / self.n_samples
        if self.converter.any_rate or abs(clocks - round(clocks)) < 1e-9 * clocks:
            return None
        ideal = np.arange(self.n_samples + 1) * clocks
        late = np.ceil(ideal - 1e-6) - ideal
        return np.asarray(np.maximum(late, 0.0) / self.converter.clock_rate)

    def late_steps(self, voltage: FloatArray, start: int, stop: int) -> Iterator[FloatArray]:
        """Yield the steps of samples times their delay [s], times its square, and so on, each in the same array."""
        if self.clock_error is None:
            return
        # The silence after the last sample of the record is never late.
        late = np.zeros(stop - start)
        playing = self.clock_error[start : min(stop, self.n_samples)]
        late[: playing.size] = playing
        before = voltage[:, start - 1, None] if start else np.zeros((len(voltage), 1))
        steps = np.diff(voltage[:, start:stop], axis=1, prepend=before)
        while True:
            steps *= late
            yield steps


LevelCorrections = tuple[tuple[float, float], ...]
"""Pairs of level [m/s] and amplitude factor [1]."""


@dataclass(frozen=True, eq=False)
class Correction:
    """Corrected targets of the exact law, for which the real beam reaches the target field.

    Attributes
    ----------
    velocity, displacement : (n_modes,) arrays
        Target modal velocities, and target modal displacements times angular frequency, for the level `reference`
        [m/s].
    reference : float
        Level of these targets; those of other levels are proportional [m/s].
    corrections : tuple of (float, float)
        Levels [m/s], each with its amplitude factor [1].
    """

    velocity: FloatArray
    displacement: FloatArray
    reference: float
    corrections: LevelCorrections = ()

    def at(self, level: float) -> tuple[FloatArray, FloatArray]:
        """Return the targets for a level: modal velocities, and displacements times angular frequency [m/s]."""
        share = level / self.reference
        return self.velocity * share, self.displacement * share


def corrected(velocity: float, corrections: LevelCorrections) -> float:
    """Return the level to set in order to reach a level [m/s].

    Between two calibrated levels, as in adaptive runs, the factor is interpolated linearly in the logarithm of the
    level; outside their range the level is set unchanged.
    """
    own = next((factor for level, factor in corrections if math.isclose(level, velocity)), None)
    if own is not None:
        return velocity * own
    below = max((each for each in corrections if each[0] < velocity), default=None)
    above = min((each for each in corrections if each[0] > velocity), default=None)
    if below is None or above is None:
        return velocity
    share = math.log(velocity / below[0]) / math.log(above[0] / below[0])
    return velocity * (below[1] + share * (above[1] - below[1]))


@dataclass(frozen=True, eq=False)
class Burst:
    """Codes shared by all levels, and the amplitudes that set the level.

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
        Levels [m/s], each with its measured amplitude factor [1].
    """

    codes: NDArray[np.uint16]
    duration: float
    repetition_rate: float
    velocity: float
    amplitude: tuple[float, ...]
    converter: Converter
    corrections: LevelCorrections = ()

    @classmethod
    def holding(
        cls,
        voltage: FloatArray,
        to_beam: float,
        velocity: float,
        converter: Converter,
        duration: float,
        repetition_rate: float,
    ) -> Burst:
        """Return the burst that plays given voltages, with the smallest full scale that holds each channel's peak.

        Parameters
        ----------
        voltage : (n_channels, n_samples) array
            Voltages at the beam [V].
        to_beam : float
            Voltage at the beam per open-circuit voltage of the generator [V/V].
        velocity : float
            Level at which they are played [m/s].
        converter : Converter
            Converter of the generator.
        duration, repetition_rate : float
            Length of the burst [s], and bursts per second [Hz].
        """
        amplitude = tuple(converter.full_scale(2 * float(np.abs(row).max()) / to_beam, (1.0,)) for row in voltage)
        codes = converter.round_to_codes(voltage, np.array(amplitude) * (to_beam / 2 / converter.mid_code))
        return cls(converter.unsigned(codes), duration, repetition_rate, velocity, amplitude, converter)

    def commanded(self, to_beam: float, velocity: float | None = None) -> FloatArray:
        """Return the voltages that the codes command at the beam, (n_channels, n_samples) array [V].

        Parameters
        ----------
        to_beam : float
            Voltage at the beam per open-circuit voltage of the generator [V/V].
        velocity : float, optional
            Level [m/s]; `Burst.velocity` if not given.
        """
        full_scale = self.amplitude if velocity is None else self.full_scale_for(velocity)
        unit = np.array(full_scale) * (to_beam / 2 / self.converter.mid_code)
        return np.asarray(self.converter.signed(self.codes) * unit[:, None])

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the codes in transfer format: big-endian, channel after channel."""
        return hashlib.sha256(self.codes.astype(">u2").tobytes()).hexdigest()

    @cached_property
    def peaks(self) -> tuple[float, ...]:
        """Peak of each channel's record relative to half of full scale [1]."""
        return self._highest(self.codes)

    @cached_property
    def ends(self) -> tuple[float, ...]:
        """Larger magnitude of the first and the last sample of each channel, relative to half of full scale [1]."""
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
