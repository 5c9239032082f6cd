"""Results of an identification: natural frequencies, damping ratios and gains with 95 % intervals, and shapes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.common import NORMAL_95, ComplexArray, FloatArray
from modaltouch.lab.identification.kernel import N_REST, Evaluation, Poles, complex_residue, fitted
from modaltouch.lab.identification.peaks import HalfPower, half_power
from modaltouch.lab.identification.responses import FrequencyResponses
from modaltouch.lab.identification.shapes import (
    label_shapes,
    label_torsion,
    refuse_odd_point,
    shape_scatter,
    torsion_shapes,
    unit_shape,
)


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval."""

    # value, low, high: value and bounds of the interval, in the unit of the quantity
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
    "nonlinearity": "drive at half the voltage, and compare; if nothing changes, check the filters of sensor and "
    "analyser (one that is not listed, or none against aliasing), and the window and the trigger of the records",
    "drift": "let the beam warm up, measure without contact or leave the sensor in place, and scan all sets again",
    "a phase that differs between points or sets": "start all records at their excitation, and keep trigger, "
    "filters, range and coupling of the sensor the same in all of them",
    "a filter or window that is not listed": "give the bandwidth of the vibrometer in the apparatus file, couple "
    "sensor and analyser for direct current, record without a window, and set other filters far outside the band",
    "nonlinearity or a missing mode": "drive at half the voltage, and compare, or measure with finer bins",
    "a strange point": "check that it is of the same beam, the fastening, focus and trigger of the sensor there, and "
    "the sign of its phase; measure it again, or leave it out with --leave-out",
}
"""Remedies, by cause."""


@dataclass(frozen=True)
class Rest:
    """The residual of a fit within one half-power bandwidth of a mode on either side."""

    share: float  # amplitude in excess of the noise, relative to that of the responses [1]
    smooth: float  # the same for the part that is smooth over frequency, unlike noise [1]; 0 if that is small


@dataclass(frozen=True, eq=False)
class IdentifiedMode:
    """The estimates for one mode, in SI units."""

    label: int | None  # number as in the paper; None for torsion and other motions, or if no shape was measured
    # natural_frequency, damping_ratio: undamped natural frequency [Hz], damping ratio [1]
    natural_frequency: Estimate
    damping_ratio: Estimate
    # modal acceleration per volt of each excitation [m/s^2 per V]; empty if no shape was measured, or per force
    gain: tuple[Estimate, ...]
    # (n_points,): mode shape of unit mean square, positive at the right end; for torsion, at the right end on the
    # positive side [1]
    shape: FloatArray | None
    mac: float  # MAC of the shape with that of a uniform free-free beam [1]; NaN if no shape was measured
    half_power: HalfPower  # half-power estimates from the largest response
    # signed gain from the peak and its half-power bandwidth [m/s^2 per V]; NaN where `gain` is empty
    half_power_gain: float
    # median over the points at the peak, for the excitation that drives the mode most [1]; NaN if unknown
    coherence: float
    rest: Rest  # residual of the fit near the mode
    # (n,): complex residues at the points for the excitation that drives the mode most, or of all responses if the
    # points are unknown [m/s^2 per V]
    residue: ComplexArray
    # number of measurements whose scatter is included in the intervals; with one, repeatability is unknown
    n_repeats: int = 1
    # number of the torsional mode, identified from rows across the width; None for other modes
    torsion: int | None = None

    @property
    def name(self) -> str:
        """The label, such as `5`, or `T1` for torsion; the natural frequency if there is neither."""
        torsion = f"T{self.torsion}" if self.torsion else f"{self.natural_frequency.value:.6g} Hz"
        return str(self.label or torsion)


@dataclass(frozen=True, eq=False)
class Identification:
    """The modes of a beam, identified from responses."""

    modes: tuple[IdentifiedMode, ...]  # in order of frequency
    delay: Estimate  # delay of the velocity relative to the drive, in addition to that of the known low-pass [s]
    misfit: float  # mean square of the residual divided by that of the noise [1]
    responses: FrequencyResponses  # the responses that were fitted
    length: float | None  # length of the beam [m]
    fitted: ComplexArray  # (n_sets, n_points, n_bins): the fitted responses; NaN where nothing was fitted
    # poles of the joint fit, including those beyond the band; None if each mode was fitted separately
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


@dataclass(frozen=True, eq=False)
class ModalParameters:
    """A fit and the data needed to compute modal parameters from it."""

    responses: FrequencyResponses
    length: float | None
    fit: Evaluation
    clock_tolerance: float

    def identification(self) -> Identification:
        """Return the modes and the fitted responses."""
        fit = self.fit
        residue = self._scaled(fit.residue[: fit.n_modes])
        argand = self._scaled(complex_residue(fit))
        labels, torsion, likeness = self._labels(residue)
        modes = tuple(
            self._mode(k, residue[k], argand[k], (labels[k], torsion[k]), float(likeness[k]))
            for k in range(fit.n_modes)
            if fit.n_modes == 1 or self._inside[k]
        )
        late = float(fit.deviation[-1] / fit.problem.highest * self._local.max(initial=1.0))
        return Identification(
            modes=modes,
            delay=Estimate.of(fit.poles.delay + self.responses.offset, late),
            misfit=fit.variance,
            responses=self.responses,
            length=self.length,
            fitted=fitted(fit).reshape(self.responses.response.shape) * np.sqrt(self._level)[:, None, None],
            poles=fit.poles,
        )

    def _mode(
        self,
        k: int,
        residue: FloatArray,
        argand: ComplexArray,
        which: tuple[int | None, int | None],
        likeness: float,
    ) -> IdentifiedMode:
        fit, (label, torsion) = self.fit, which
        off = fit.deviation * self._local[k]
        frequency, ratio = float(fit.poles.natural_frequency[k]), float(fit.poles.damping_ratio[k])
        gain: tuple[Estimate, ...] = ()
        shape = None
        if label is not None and self.length is not None:
            shape = unit_shape(residue, self.responses.places, label, self.length)
            values = residue @ shape / (shape @ shape)
            scatter = shape_scatter(shape, self.responses.places, label, self.length)
            spread = np.hypot(self._gain_deviation(k, shape) * self._local[k], scatter * values)
            gain = tuple(Estimate.of(float(v), float(d)) for v, d in zip(values, spread, strict=True))
        elif torsion is not None and self.length is not None:
            expected = torsion_shapes([torsion], self.responses.places, self.length)[0]
            common = np.linalg.svd(residue, full_matrices=False)[2][0]
            shape = common * np.sqrt(common.size) * np.sign(common @ expected)
        driver, point = np.unravel_index(int(np.abs(residue).argmax()), residue.shape)
        magnitude = np.abs(self.responses.response[driver, point])
        peak = half_power(self.responses.frequency, magnitude, frequency, ratio * frequency)
        picked = float("nan")
        if gain and shape is not None and shape[point] != 0:
            # The gain from the peak is 2 xi w |H| / phi (section III-B of the paper, corrected).
            height = peak.height * 4 * np.pi * peak.peak_frequency * peak.damping_ratio
            picked = float(np.sign(residue[driver, point]) * height / shape[point])
        return IdentifiedMode(
            label=label,
            natural_frequency=Estimate.of(
                frequency, frequency * math.hypot(float(off[k]) * ratio, self.clock_tolerance / NORMAL_95)
            ),
            damping_ratio=Estimate.of(ratio, float(off[fit.n_modes + k]) * ratio),
            gain=gain,
            shape=shape,
            mac=likeness if shape is not None else float("nan"),
            half_power=peak,
            half_power_gain=picked,
            coherence=self._coherence(residue, frequency),
            rest=rest_about(fit, k),
            residue=argand.ravel() if self.responses.n_points == 1 else argand[driver],
            torsion=torsion,
        )

    def _scaled(self, residue: NDArray[Any]) -> NDArray[Any]:
        """Convert residues from the problem's scale to gain times shape, (n_modes, n_sets, n_points) [m/s^2 per V]."""
        column = 2 * np.pi * self.fit.poles.natural_frequency * self.fit.poles.damping_ratio
        residue = residue.reshape(-1, *self.responses.response.shape[:2])
        return np.asarray(residue * column[:, None, None] * np.sqrt(self._level)[None, :, None])

    @property
    def _inside(self) -> NDArray[np.bool_]:
        """Mask of the poles within the band; each pole beyond it represents all modes there."""
        own, frequency = self.fit.poles.natural_frequency, self.responses.frequency
        return np.asarray((own >= frequency[0]) & (own <= frequency[-1]))

    @property
    def _level(self) -> FloatArray:
        """Noise variance of each set, by which the problem scales its responses, (n_sets,) array."""
        return np.asarray(np.median(self.responses.noise, axis=1))

    def _labels(self, residue: FloatArray) -> tuple[Sequence[int | None], Sequence[int | None], FloatArray]:
        places, n_modes = self.responses.places, self.fit.n_modes
        if self.length is None or len(places) < 3:
            return [None] * n_modes, [None] * n_modes, np.full(n_modes, np.nan)
        self._refuse_strange_points()
        scaled = residue / np.sqrt(self._level)[None, :, None]
        # Only the sum of two poles within one width is certain; poles beyond the band are not modes.
        own = self.fit.poles.natural_frequency[self._inside]
        width = 2 * self.fit.poles.damping_ratio[self._inside] * own
        first = np.append(True, np.diff(own) > width[:-1])
        together = np.add.reduceat(scaled[self._inside], np.flatnonzero(first), axis=0)
        refuse_odd_point(together, places, self.length, self.responses.sets)
        common = np.array([np.linalg.svd(each, full_matrices=False)[2][0] for each in scaled])
        labels, likeness = label_shapes(common, places, self.length)
        torsion, twisted = label_torsion(common, labels, places, self.length)
        return labels, torsion, np.where([order is None for order in torsion], likeness, twisted)

    def _refuse_strange_points(self) -> None:
        """Refuse responses that have no mode in common, or points at which most of the response is not fitted."""
        if not self._inside.any():
            raise ValueError(
                "no resonance is common to the responses: check that all of them are of one beam, with one sign of the "
                "phase and one trigger, or choose another band"
            )
        n_bins = len(self.fit.left)
        of_point = n_bins, *self.responses.response.shape[:2]
        left, power = (
            (np.abs(each.reshape(of_point)) ** 2).sum(axis=(0, 1))
            for each in (self.fit.left, self.fit.problem.response)
        )
        smooth = neighbouring(self.fit.left.reshape(of_point)).sum(axis=0)
        share = np.maximum(left - 2 * n_bins * of_point[1], 0.0) / np.maximum(power, 1e-300)
        # Noise, as of a sensor out of focus, differs between neighbouring bins.
        strange = (share > STRANGE) & (share > 3 * np.median(share)) & (smooth > SMOOTH * left)
        if strange.any() and 3 * strange.sum() < strange.size:
            named = ", ".join(str(self.responses.places[point]) for point in np.flatnonzero(strange))
            raise ValueError(
                f"up to {share[strange].max():.0%} of the power of the response at {named} is not in the modes of the "
                f"other points: {REMEDIES['a strange point']}"
            )

    def _gain_deviation(self, k: int, shape: FloatArray) -> FloatArray:
        """Return the standard deviation of a mode's gains, from its residues and their dependence on the poles."""
        fit = self.fit
        n_sets, n_points = self.responses.response.shape[:2]
        column = 2 * np.pi * float(fit.poles.natural_frequency[k] * fit.poles.damping_ratio[k])
        weight = shape / (shape @ shape)
        on_shape = fit.residue.reshape(-1, n_sets, n_points) @ weight
        inverse = np.linalg.inv(fit.factor)
        alone = float((inverse[k] ** 2).sum()) * float(weight @ weight)
        spread = []
        for s in range(n_sets):
            own = np.concatenate([on_shape[: fit.n_modes, s]] * 2)
            slope = -np.append(fit.lost[k] * own, fit.lost_turned[k] @ on_shape[:, s])
            independent = (alone + float(slope @ fit.covariance @ slope)) * fit.variance
            rest = fit.rest[:, s * n_points : (s + 1) * n_points] @ weight
            each = inverse[k] @ fit.basis.T * rest
            n = each.size // 2
            common = float(((each[:n] + each[n:] + fit.scores @ (fit.covariance @ slope)) ** 2).sum())
            spread.append(column * np.sqrt(max(independent, common) * float(self._level[s])))
        return np.array(spread)

    @cached_property
    def _local(self) -> FloatArray:
        """Rms ratio of the residual near each mode to that over the band; 1 where a larger one may be chance [1]."""
        square = (np.abs(self.fit.left) ** 2).sum(axis=1)
        frequency = self.fit.problem.bins.centre
        worst = []
        for own, ratio in zip(self.fit.poles.natural_frequency, self.fit.poles.damping_ratio, strict=True):
            near = np.abs(frequency - own) <= 2 * max(ratio * own, self.responses.spacing)
            count = 2 * int(near.sum()) * self.fit.rest.shape[1]
            # The mode's own parameters absorb part of the scatter.
            free = max(count - self.fit.rest.shape[1] * (1 + N_REST / 4), 1.0)
            larger = float(square[near].sum()) / free / self.fit.variance
            worst.append(larger if larger > 1 + 3 * np.sqrt(2 / free) else 1.0)
        return np.sqrt(worst)

    def _coherence(self, residue: FloatArray, frequency: float) -> float:
        if self.responses.coherence is None:
            return float("nan")
        driver = int((residue**2).sum(axis=1).argmax())
        bin_ = int(np.abs(self.responses.frequency - frequency).argmin())
        return float(np.median(self.responses.coherence[driver, :, bin_]))


WELL_FITTED = 3.0
"""Misfit up to which the residual consists of noise alone [1]."""

STRANGE = 0.3
"""Residual power of a point, relative to that of its responses, above which other points do not explain it [1]."""

SMOOTH = 0.5
"""Correlation of the residual between neighbouring bins above which it is not noise [1]."""

FEWEST = 8
"""Minimum number of groups of bins near a mode for a meaningful correlation."""


def neighbouring(left: ComplexArray) -> FloatArray:
    """Return the sum of products of neighbouring values along the first axis; near the sum of squares if smooth."""
    return np.asarray((np.conj(left[:-1]) * left[1:]).real.sum(axis=0))


def rest_about(fit: Evaluation, k: int) -> Rest:
    """Return the residual of a fit near mode `k`."""
    problem = fit.problem
    own = float(fit.poles.natural_frequency[k])
    spacing = float(problem.bins.frequency[1] - problem.bins.frequency[0])
    near = np.abs(problem.bins.centre - own) <= 2 * max(float(fit.poles.damping_ratio[k]) * own, spacing)
    left = fit.left[near]
    power = max(float((np.abs(problem.response[near]) ** 2).sum()), 1e-300)
    share = float(np.sqrt(max(float((np.abs(left) ** 2).sum()) - 2 * left.size, 0.0) / power))
    if left.shape[0] < FEWEST:
        return Rest(share, 0.0)
    course = left @ np.linalg.eigh((left.conj().T @ left).real)[1][:, -1]
    neighbours = float(neighbouring(course))
    is_smooth = neighbours >= SMOOTH * float((np.abs(course) ** 2).sum())
    return Rest(share, float(np.sqrt(neighbours / power)) if is_smooth else 0.0)
