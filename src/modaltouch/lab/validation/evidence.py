"""Evaluation of the recordings of one drive law: coefficients, field, spot width, duration, speeds, contrast."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from modaltouch.lab.common import FloatArray
from modaltouch.lab.scan import Scan
from modaltouch.stimulus import Stimulus, mode_shapes


def spot_width(position: FloatArray, field: FloatArray, centre: float, fraction: float) -> float:
    """Return the width of a field around its focus, at a fraction of its value there [m].

    The field is interpolated linearly between increasing positions [m]; its sign at the centre counts as positive. The
    width is NaN if the field is zero at the centre, and extends to the end of a field that does not fall so far.
    """
    at_centre = float(np.interp(centre, position, field))
    if at_centre == 0:
        return math.nan
    above = field / at_centre - fraction
    falls = np.flatnonzero(np.diff(above >= 0))
    places = position[falls] - above[falls] * np.diff(position)[falls] / np.diff(above)[falls]
    left, right = places[places < centre], places[places > centre]
    return float(right.min(initial=position[-1]) - left.max(initial=position[0]))


def root_mean_square(values: FloatArray) -> float:
    """Return the root mean square, in the unit of the values."""
    return math.sqrt(float(np.mean(np.square(values))))


def contrast(one: float, other: float) -> float:
    """Return the ratio of the faster of two speeds to the slower [1]; infinite if one zone is at rest."""
    slower, faster = sorted((abs(one), abs(other)))
    return faster / slower if slower > 0 else math.inf


def mean_velocity(scan: Scan) -> FloatArray:
    """Return the mean over the records, (n_positions, n_samples) array [m/s]."""
    return np.asarray(scan.velocity.mean(axis=1))


FINE = 401
"""Number of points at which smooth fields are drawn and their widths evaluated."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Velocities predicted for the identified beam and the codes as played, over time since the start of a burst [s].

    Attributes
    ----------
    field, course : (n_points, n_times) array
        Velocity along the beam, and at the centres of the zones [m/s].
    """

    time: FloatArray
    field: FloatArray
    course: FloatArray

    def around(self, first: float, last: float) -> Callable[[FloatArray], FloatArray]:
        """Return a function from instants in an interval [s] to the field, (n_points, n_instants) [m/s]."""
        from scipy.interpolate import CubicSpline

        near = (self.time >= first) & (self.time <= last)
        interpolated: Callable[[FloatArray], FloatArray] = CubicSpline(self.time[near], self.field[:, near], axis=1)
        return interpolated


@dataclass(frozen=True, eq=False)
class Evidence:
    """The measured effect of one drive law, with target and prediction, at the level as played.

    Attributes
    ----------
    stimulus, velocity
        The stimulus that was played, and its level [m/s].
    zones : dict of str to float
        Zones and their centres, from left to right [m].
    focus : str
        Zone of the focus.
    field, course : Scan
        Velocity along the beam around the focusing instant, and at the centres of the zones throughout the burst.
    further_rows : tuple of Scan
        The field on further rows across the width.
    lag : float
        Delay of the measurement relative to the prediction, subtracted from all times here [s].
    """

    stimulus: Stimulus
    velocity: float
    zones: dict[str, float]
    focus: str
    field: Scan
    course: Scan
    further_rows: tuple[Scan, ...] = ()
    lag: float = 0.0

    @cached_property
    def prediction(self) -> Prediction:
        """The velocities predicted at the same positions."""
        timing, places = self.stimulus.timing, self.field.positions
        played = self.stimulus.velocity_history([*places, *self.course.positions], self.velocity)
        time = np.asarray(np.arange(timing.n_samples) * timing.hold + self.stimulus.amplifier.delay, dtype=float)
        return Prediction(time, played[: places.size], played[places.size :])

    @property
    def instant(self) -> float:
        """The focusing instant [s]."""
        return self.stimulus.timing.focusing_instant

    @property
    def target(self) -> FloatArray:
        """Target coefficients of the modelled modes, 0 for those not selected, (n_modes,) array [m/s]."""
        stimulus = self.stimulus
        return stimulus.target * (self.velocity / stimulus.target_field.velocity)

    @cached_property
    def target_coefficient(self) -> FloatArray:
        """Coefficients of the target field on all modes of its decomposition, from mode 1 [m/s]."""
        return self.stimulus.projection.decomposition * self.velocity

    @cached_property
    def predicted_coefficient(self) -> FloatArray:
        """Coefficients predicted for the codes on the identified beam, (n_modes,) array [m/s]."""
        return self.stimulus.achieved(self.velocity)[0]

    @cached_property
    def position(self) -> FloatArray:
        """Positions of the smooth fields, (FINE,) array [m]."""
        half = self.stimulus.model.length / 2
        return np.linspace(-half, half, FINE)

    @cached_property
    def target_field(self) -> FloatArray:
        """The target field, (FINE,) array [m/s]."""
        return self.stimulus.target_field.profile(self.position) * self.velocity

    @cached_property
    def selected_field(self) -> FloatArray:
        """The field of the selected modes, (FINE,) array [m/s]."""
        return self.target @ self.stimulus.model.shapes(self.position)

    @cached_property
    def predicted_field(self) -> FloatArray:
        """The field predicted for the codes on the identified beam, (FINE,) array [m/s]."""
        return self.predicted_coefficient @ self.stimulus.model.shapes(self.position)

    @cached_property
    def snapshots(self) -> FloatArray:
        """Field at the focusing instant in each record, (n_records, n_positions) array [m/s]."""
        return self._at_focus(self.field)

    def _at_focus(self, scan: Scan) -> FloatArray:
        from scipy.interpolate import CubicSpline

        time = self.times(scan)
        near = np.abs(time - self.instant) < 2e-5
        return np.asarray(CubicSpline(time[near], scan.velocity[:, :, near], axis=2)(self.instant).T)

    @property
    def measured_points(self) -> FloatArray:
        """Mean field at the focusing instant, (n_positions,) array [m/s]."""
        return np.asarray(self.snapshots.mean(axis=0))

    @cached_property
    def rows(self) -> list[Scan]:
        """Scans of the field on the mid-line and any further rows, from edge to edge."""
        return sorted((self.field, *self.further_rows), key=lambda scan: scan.across)

    @cached_property
    def field_over_width(self) -> FloatArray:
        """Velocity of each row at the focusing instant in each record, (n_rows, n_records, n_positions) array [m/s]."""
        return np.array([self._at_focus(scan) for scan in self.rows])

    @cached_property
    def speed_over_width(self) -> FloatArray:
        """Highest speed of each row during the scan of the field, (n_rows, n_positions) array [m/s]."""
        return np.array([np.abs(mean_velocity(scan)).max(axis=1) for scan in self.rows])

    @property
    def torsion(self) -> FloatArray:
        """Velocity of the outer rows due to torsion in each record, (n_records, n_positions) array [m/s].

        It is the least-squares part of the velocity that is proportional to the distance from the mid-line.
        """
        across = np.array([scan.across for scan in self.rows])
        return np.asarray(np.tensordot(across, self.field_over_width, 1) * (across[-1] / (across @ across)))

    @cached_property
    def fitted_labels(self) -> tuple[int, ...]:
        """Labels of the modes fitted to the measured field: the modelled ones and further ones if the points allow."""
        stimulus = self.stimulus
        # Without the two modes above the modelled ones, their motion would be attributed to others.
        most = min(max(stimulus.model.label) + 2, self.field.positions.size * 2 // 3)
        return tuple(sorted({*stimulus.model.label, *range(1, most + 1)}))

    def _shapes(self, position: FloatArray) -> FloatArray:
        """Return the shapes of the fitted modes, from the model or else from theory."""
        model = self.stimulus.model
        shapes = mode_shapes(self.fitted_labels, position, model.length)
        shapes[[self.fitted_labels.index(label) for label in model.label]] = model.shapes(position)
        return shapes

    @cached_property
    def _projections(self) -> FloatArray:
        """Coefficients of every snapshot on the fitted modes, (n_records, n_fitted) array [m/s]."""
        shapes = self._shapes(self.field.positions)
        return np.asarray(np.linalg.lstsq(shapes.T, self.snapshots.T, rcond=None)[0].T)

    @property
    def _modelled(self) -> list[int]:
        return [self.fitted_labels.index(label) for label in self.stimulus.model.label]

    @property
    def achieved_coefficient(self) -> FloatArray:
        """Least-squares coefficients of the measured field on the modelled modes, (n_modes,) array [m/s]."""
        return np.asarray(self._projections.mean(axis=0)[self._modelled])

    @property
    def coefficient_error(self) -> FloatArray:
        """Standard error of `achieved_coefficient` from the scatter of the records, (n_modes,) array [m/s]."""
        return np.asarray(standard_error(self._projections)[self._modelled])

    @property
    def unmodelled_motion(self) -> float:
        """Largest coefficient of the measured field on a fitted but not modelled mode [m/s]."""
        others = np.delete(self._projections.mean(axis=0), self._modelled)
        return float(np.abs(others).max(initial=0.0))

    @cached_property
    def measured_field(self) -> FloatArray:
        """The smooth field through the measured points, (FINE,) array [m/s]."""
        return np.asarray(self._projections.mean(axis=0) @ self._shapes(self.position))

    def times(self, scan: Scan) -> FloatArray:
        """Return the times of a scan minus the lag [s]."""
        return scan.time - self.lag

    @cached_property
    def zone_velocity(self) -> FloatArray:
        """Mean velocity at the zones throughout the burst, (n_zones, n_times) array [m/s]."""
        return mean_velocity(self.course)

    @property
    def _focus_row(self) -> int:
        return list(self.zones).index(self.focus)

    @property
    def focus_course(self) -> FloatArray:
        """Mean velocity at the focus throughout the burst, (n_times,) array [m/s]."""
        return np.asarray(self.zone_velocity[self._focus_row])

    @property
    def time_above_90(self) -> dict[str, float]:
        """Time for which the velocity at the focus stays above 90 % of its peak near the focusing instant [s].

        ``measured`` and ``predicted``.
        """
        courses = {
            "measured": (self.times(self.course), self.focus_course),
            "predicted": (self.prediction.time, self.prediction.course[self._focus_row]),
        }
        return {name: self._above_90(*course) for name, course in courses.items()}

    def _above_90(self, time: FloatArray, velocity: FloatArray) -> float:
        near = np.abs(time - self.instant) < 0.1e-3
        time, velocity = time[near], velocity[near]
        return spot_width(time, velocity, float(time[np.abs(velocity).argmax()]), 0.9)

    @property
    def zone_peak(self) -> dict[str, dict[str, float]]:
        """Highest speed at the centre of each zone throughout the burst, ``measured`` and ``predicted`` [m/s]."""
        peaks = (np.abs(course).max(axis=1).tolist() for course in (self.zone_velocity, self.prediction.course))
        both = zip(*peaks, strict=True)
        return {
            zone: dict(zip(("measured", "predicted"), each, strict=True))
            for zone, each in zip(self.zones, both, strict=True)
        }


def standard_error(records: FloatArray) -> FloatArray:
    """Return the standard error of the mean over the records; NaN for a single record."""
    n = records.shape[0]
    return np.asarray(records.std(axis=0, ddof=1) / np.sqrt(n)) if n > 1 else np.full(records.shape[1:], np.nan)
