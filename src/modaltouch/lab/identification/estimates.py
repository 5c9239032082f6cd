"""What an identification comes to: every number with its 95 % interval."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from modaltouch.lab.arrays import ComplexArray, FloatArray
from modaltouch.lab.identification.peaks import HalfPower, Poles
from modaltouch.lab.identification.responses import FrequencyResponses
from modaltouch.lab.identification.rest import Rest

NORMAL_95 = 1.959963984540054
"""Half-width of a 95 % interval in standard deviations."""


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval.

    Attributes
    ----------
    value, low, high : float
        In the unit of the quantity.
    """

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, deviation: float) -> Estimate:
        """Return the estimate of a value of a standard deviation."""
        return cls(value, value - NORMAL_95 * deviation, value + NORMAL_95 * deviation)

    def widened(self, uncertainty: float) -> Estimate:
        """Return it with a further uncertainty in its interval, in quadrature: a half width over the value [1]."""
        half = [math.hypot(self.value - end, uncertainty * self.value) for end in (self.low, self.high)]
        return Estimate(self.value, self.value - half[0], self.value + half[1])

    def __contains__(self, value: float) -> bool:
        """Return whether the interval covers a value."""
        return self.low <= value <= self.high


@dataclass(frozen=True, eq=False)
class IdentifiedMode:
    """What was found of one mode, in SI units.

    Attributes
    ----------
    label : int or None
        As in the paper; None for what is no bending mode of the mid-line, or where no shape was measured.
    natural_frequency, damping_ratio : Estimate
        Undamped natural frequency [Hz], damping ratio [1].
    gain : tuple of Estimate
        Modal acceleration per unit of each excitation [m/s^2 per V]; empty where no shape was measured.
    shape : (n_points,) array or None
        Of unit mean square, positive at the right end; of torsion over the points, on its positive side [1].
    mac : float
        Likeness of the shape with that of a uniform free-free beam [1]; NaN where no shape was measured.
    half_power : HalfPower
        Of the highest response.
    half_power_gain : float
        What peak and half-power bandwidth make of the gain [m/s^2 per V], sign included; NaN without a shape.
    coherence : float
        Median over the points at the peak, for the excitation that drives it most [1]; NaN where unknown.
    rest : Rest
        What the fit leaves about it.
    residue : (n,) complex array
        Of the points under the excitation that drives it most, or of all responses where the points are unknown, where
        residues may be complex [m/s^2 per V].
    n_repeats : int
        Measurements whose scatter the intervals hold; with one, repeatability is unknown.
    torsion : int or None
        Which torsional mode it is, told by rows over the width; None for what is none.
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
        """Its label, as `T1` of torsion; its natural frequency where it has none."""
        torsion = f"T{self.torsion}" if self.torsion else f"{self.natural_frequency.value:.6g} Hz"
        return str(self.label or torsion)


@dataclass(frozen=True, eq=False)
class Identification:
    """What responses say of a beam.

    Attributes
    ----------
    modes : tuple of IdentifiedMode
        In order of frequency.
    delay : Estimate
        Of the velocity against the drive, beyond the known low-pass [s].
    misfit : float
        Mean square of what the fit leaves over that of the noise [1].
    responses : FrequencyResponses
        What was fitted.
    length : float or None
        Length of the beam [m].
    fitted : (n_sets, n_points, n_bins) complex array
        What the fit makes of the responses; NaN where nothing was fitted.
    poles : Poles or None
        Of the joint fit, those beyond the band included; None where each mode was fitted by itself.
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
        """The modes with a shape, and that: of bending, and of torsion where rows over the width show it."""
        return [(mode, mode.shape) for mode in self.modes if mode.shape is not None]

    def with_sensitivity_uncertainty(self, uncertainty: float) -> Identification:
        """Return it with the uncertainty of the vibrometer's sensitivity in the gains' intervals.

        Parameters
        ----------
        uncertainty : float
            Half width of its 95 % interval, relative to the sensitivity [1].
        """
        modes = (replace(mode, gain=tuple(gain.widened(uncertainty) for gain in mode.gain)) for mode in self.modes)
        return replace(self, modes=tuple(modes))

    def mode(self, label: int) -> IdentifiedMode:
        """Return the mode of a label.

        Raises
        ------
        KeyError
            If it was not found.
        """
        for mode in self.modes:
            if mode.label == label:
                return mode
        found = ", ".join(str(mode.label) for mode in self.modes if mode.label)
        raise KeyError(f"mode {label} was not found; the modes found are {found}")
