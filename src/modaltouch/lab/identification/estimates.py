"""Results of an identification, with the 95 % interval of every estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from modaltouch.lab.arrays import NORMAL_95, ComplexArray, FloatArray
from modaltouch.lab.identification.kernel import Poles
from modaltouch.lab.identification.peaks import HalfPower
from modaltouch.lab.identification.responses import FrequencyResponses


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval.

    Attributes
    ----------
    value, low, high : float
        Value and bounds of the interval, in the unit of the quantity.
    """

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, deviation: float) -> Estimate:
        """Return an estimate with a given value and standard deviation."""
        return cls(value, value - NORMAL_95 * deviation, value + NORMAL_95 * deviation)

    def widened(self, uncertainty: float) -> Estimate:
        """Add a relative half-width [1] to the interval in quadrature."""
        half = [math.hypot(self.value - end, uncertainty * self.value) for end in (self.low, self.high)]
        return Estimate(self.value, self.value - half[0], self.value + half[1])

    def __contains__(self, value: float) -> bool:
        """Return whether the interval covers a value."""
        return self.low <= value <= self.high


REMEDIES = {
    "noise": "average more, or drive harder",
    "nonlinearity": "drive at half the voltage, and compare; if nothing changes, check the sensor's filters, and the "
    "window and the trigger of the records",
    "drift": "let the beam warm up, and scan again",
    "a missing mode": "measure with finer bins or at more points, or leave that band out",
    "nonlinearity or a missing mode": "drive at half the voltage, and compare, or measure with finer bins",
}
"""Remedies, by cause."""


@dataclass(frozen=True)
class Rest:
    """The residual of a fit within one half-power bandwidth of a mode on either side.

    Attributes
    ----------
    share : float
        Amplitude in excess of the noise, relative to that of the responses [1].
    smooth : float
        The same for the part that is smooth over frequency, unlike noise [1].
    cause : str
        The most probable cause, a key of `REMEDIES`.
    """

    share: float
    smooth: float
    cause: str


@dataclass(frozen=True, eq=False)
class IdentifiedMode:
    """The estimates for one mode, in SI units.

    Attributes
    ----------
    label : int or None
        Number as in the paper; None for torsion and other motions, or if no shape was measured.
    natural_frequency, damping_ratio : Estimate
        Undamped natural frequency [Hz], damping ratio [1].
    gain : tuple of Estimate
        Modal acceleration per unit of each excitation [m/s^2 per V]; empty if no shape was measured.
    shape : (n_points,) array or None
        Mode shape of unit mean square, positive at the right end; for torsion, at the right end on the positive side
        [1].
    mac : float
        MAC of the shape with that of a uniform free-free beam [1]; NaN if no shape was measured.
    half_power : HalfPower
        Half-power estimates from the largest response.
    half_power_gain : float
        Signed gain from the peak and its half-power bandwidth [m/s^2 per V]; NaN without a shape.
    coherence : float
        Median over the points at the peak, for the excitation that drives the mode most [1]; NaN if unknown.
    rest : Rest
        Residual of the fit near the mode.
    residue : (n,) complex array
        Complex residues at the points for the excitation that drives the mode most, or of all responses if the points
        are unknown [m/s^2 per V].
    n_repeats : int
        Number of measurements whose scatter is included in the intervals; with one, repeatability is unknown.
    torsion : int or None
        Number of the torsional mode, identified from rows across the width; None for other modes.
    """

    label: int | None
    natural_frequency: Estimate
    damping_ratio: Estimate
    gain: tuple[Estimate, ...]
    shape: FloatArray | None
    mac: float
    half_power: HalfPower
    half_power_gain: float
    coherence: float
    rest: Rest
    residue: ComplexArray
    n_repeats: int = 1
    torsion: int | None = None

    @property
    def name(self) -> str:
        """The label, such as `5`, or `T1` for torsion; the natural frequency if there is neither."""
        torsion = f"T{self.torsion}" if self.torsion else f"{self.natural_frequency.value:.6g} Hz"
        return str(self.label or torsion)


@dataclass(frozen=True, eq=False)
class Identification:
    """The modes of a beam, identified from responses.

    Attributes
    ----------
    modes : tuple of IdentifiedMode
        In order of frequency.
    delay : Estimate
        Delay of the velocity relative to the drive, in addition to that of the known low-pass [s].
    misfit : float
        Mean square of the residual divided by that of the noise [1].
    responses : FrequencyResponses
        The responses that were fitted.
    length : float or None
        Length of the beam [m].
    fitted : (n_sets, n_points, n_bins) complex array
        The fitted responses; NaN where nothing was fitted.
    poles : Poles or None
        Poles of the joint fit, including those beyond the band; None if each mode was fitted separately.
    """

    modes: tuple[IdentifiedMode, ...]
    delay: Estimate
    misfit: float
    responses: FrequencyResponses
    length: float | None
    fitted: ComplexArray
    poles: Poles | None = None

    @property
    def shaped(self) -> list[tuple[IdentifiedMode, FloatArray]]:
        """Modes with their shapes: bending modes, and torsion if it was measured by rows across the width."""
        return [(mode, mode.shape) for mode in self.modes if mode.shape is not None]

    def with_sensitivity_uncertainty(self, uncertainty: float) -> Identification:
        """Include the uncertainty of the vibrometer's sensitivity in the intervals of the gains.

        Parameters
        ----------
        uncertainty : float
            Half-width of the sensitivity's 95 % interval, relative to its value [1].
        """
        modes = (replace(mode, gain=tuple(gain.widened(uncertainty) for gain in mode.gain)) for mode in self.modes)
        return replace(self, modes=tuple(modes))

    @property
    def by_label(self) -> dict[int, IdentifiedMode]:
        """The labelled modes."""
        return {mode.label: mode for mode in self.modes if mode.label is not None}
