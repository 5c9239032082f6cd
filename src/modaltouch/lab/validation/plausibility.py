"""Plausibility checks of the recordings of a validation, and their evaluation.

A fault of the sensor, its positions or its trigger differs in pattern from an error of the identified beam: the checks
allow each mode a gain and a delay of its own, and refuse what then remains at some points, or at all of them alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.common import FloatArray
from modaltouch.lab.scan import Scan
from modaltouch.lab.validation.evidence import Evidence, mean_velocity
from modaltouch.record import RecordInputError

LAGS = np.arange(-5e-6, 25e-6, 0.25e-6)
"""Trial delays of the measurement [s]."""


def measurement_delay(evidences: Sequence[Evidence]) -> float:
    """Return the delay of the measurement with the least-squares fit to the predictions of all laws [s].

    Vibrometer, amplifier and trigger each add microseconds, a large part of the period of the highest selected mode,
    so the field at the focusing instant can only be determined once the delay is removed.
    """
    missed = [_missed(each, mean_velocity(each.field)) for each in evidences]
    for evidence, as_given in zip(evidences, missed, strict=True):
        places, velocity = evidence.field.positions, mean_velocity(evidence.field)
        least = EXPLAINED * as_given.min()
        if _missed(evidence, -velocity).min() < least:
            raise RecordInputError(INVERTED)
        if np.allclose(places, -places[::-1]) and _missed(evidence, velocity[::-1]).min() < least:
            raise RecordInputError(
                "the field is the mirror image of the predicted one: count positions from mid-beam, positive to the "
                "participant's right, check which output drives which patches, and measure again"
            )
    own = [_delay_of(each) for each in missed]
    if np.ptp(own) > APART:
        named = ", ".join(f"{each * 1e6:.1f} us" for each in own)
        raise RecordInputError(
            f"the delay of the velocity differs between the laws ({named}): use the same trigger, filters and range "
            "throughout, check that the natural frequencies neither drift nor change with the amplitude, and measure "
            "again"
        )
    return _delay_of(np.sum(missed, axis=0))


def _delay_of(missed: FloatArray) -> float:
    """Return the delay with the least difference between measured and predicted fields [s]."""
    best = int(missed.argmin())
    if best in (0, LAGS.size - 1):
        raise RecordInputError(
            f"the recordings do not match the predictions at any delay from {LAGS[0] * 1e6:g} to {LAGS[-1] * 1e6:g} "
            "us: check wiring, trigger, sign and unit of the velocity, and the apparatus file"
        )
    before, at, after = missed[best - 1 : best + 2]
    return float(LAGS[best] + (LAGS[1] - LAGS[0]) * (before - after) / (2 * (before - 2 * at + after)))


def _missed(evidence: Evidence, velocity: FloatArray) -> FloatArray:
    """Return the squared difference between velocity and predicted field at each trial delay, (n_lags,) array."""
    time = evidence.field.time
    # A delay has the largest effect around the focusing instant.
    near = np.abs(time - evidence.instant) < NEAR
    if near.sum() < FEWEST_INSTANTS:
        raise RecordInputError("the recordings do not cover the focusing instant: check trigger and unit of the time")
    predicted = evidence.prediction.around(time[near][0] - 2 * LAGS[-1], time[near][-1] - 2 * LAGS[0])
    return np.array([np.square(velocity[:, near] - predicted(time[near] - lag)).sum() for lag in LAGS])


PLAUSIBLE, ALIKE, OFFSET = 2.0, 1.25, 0.02
"""Largest factor, up or down, between measured and predicted velocity, and between this factor at a point and that at
the others, and largest constant velocity relative to the level [1]; beyond, a setting differs from the apparatus file,
or changed during the scan."""

LATE, APART = 1e-6, 2e-6
"""Largest delay of a point relative to the others, and largest difference between the delays of the laws [s]."""

EXPLAINED = 0.25
"""Fraction of the squared difference from the prediction below which another cause must reduce it [1]."""

UNLIKE, STANDS_OUT = 0.01, 9.0
"""Mean square of a point's residual, relative to that of the velocity and to the median residual, above which the point
does not move with the modes [1]."""

AWAY, FARTHEST, N_SHIFTS = 0.005, 0.1, 81
"""Smallest shift of all points that is refused, and largest that is tried, relative to the length of the beam [1], and
the number of those tried, odd to include none."""

NEAR, AROUND = 0.25e-3, 1e-3
"""Time before and after the focusing instant in which delays and modes are fitted [s]."""

FEWEST_INSTANTS = 64
"""Minimum number of samples around the focusing instant."""

UNSTEADY = 0.1
"""Largest standard deviation of the sizes of the records at a point, relative to that of their mean [1]."""

INVERTED = (
    "the velocity has the opposite sign of the predicted one: invert the signal of the vibrometer, or the drive of all "
    "outputs if it is inverted, and measure again"
)


@dataclass(frozen=True, eq=False)
class ModalFit:
    """The field around the focusing instant, with a gain and a delay of its own for each mode.

    An identified beam may be wrong by these; a fault of a sensor or of its positions is not absorbed by them.
    """

    evidence: Evidence

    @cached_property
    def _factor(self) -> FloatArray:
        """Factors of the modes' predicted velocities, of their derivatives, and of a constant, (2 n_modes + 1,)."""
        field = self.evidence.field
        measured, histories = self._measured(field)
        return _fit(measured, self._shapes(field.positions), histories)[0]

    def _measured(self, scan: Scan) -> tuple[FloatArray, FloatArray]:
        """Return the measured velocities of a scan around the focusing instant, and the histories of the modes."""
        near = np.abs(scan.time - self.evidence.instant) < AROUND
        instants, model = self.evidence.times(scan)[near], self.evidence.stimulus.model
        predicted = self.evidence.prediction.around(instants[0] - LAGS[-1], instants[-1] + LAGS[-1])(instants)
        velocity = np.linalg.lstsq(model.shapes(self.evidence.field.positions).T, predicted)[0]
        turned = np.gradient(velocity, instants, axis=1) / (2 * np.pi * model.natural_frequency[:, None])
        return mean_velocity(scan)[:, near], np.concatenate([velocity, turned, np.ones((1, instants.size))])

    def _shapes(self, positions: FloatArray) -> FloatArray:
        shapes = self.evidence.stimulus.model.shapes(positions)
        return np.concatenate([shapes, shapes, np.ones((1, positions.size))])

    def refuse_shifted_points(self) -> None:
        """Refuse points whose velocities are those of the beam at positions which all lie the same distance away."""
        positions, length = self.evidence.field.positions, self.evidence.stimulus.model.length
        measured, histories = self._measured(self.evidence.field)
        shifts = np.linspace(-FARTHEST, FARTHEST, N_SHIFTS) * length
        places = [np.clip(positions + shift, -length / 2, length / 2) for shift in shifts]
        left = np.array([_fit(measured, self._shapes(each), histories)[1] for each in places])
        best = int(left.argmin())
        if abs(shifts[best]) > AWAY * length and left[best] < EXPLAINED * left[N_SHIFTS // 2]:
            raise RecordInputError(
                f"the beam moves as at points {shifts[best] * 1e3:+.2g} mm away: check the origin and the order of "
                "the positions, and the length of the beam in the apparatus file, and measure again"
            )

    def refuse_odd_points(self, scan: Scan) -> None:
        """Refuse the points of a scan that cannot be those of the beam, with the first fault that some of them have."""
        for odd, fault in self._faults(scan):
            if odd.any():
                where = ", ".join(f"{place * 1e3:g}" for place in scan.positions[odd])
                raise RecordInputError(f"{'' if odd.all() else f'at {where} mm '}{fault}, and measure again")

    def _faults(self, scan: Scan) -> Iterator[tuple[NDArray[np.bool_], str]]:
        """Yield each kind of fault, with the points that have it.

        The velocity of each point is fitted by that of the modes there, its derivative, and a constant.
        """
        (measured, histories), shapes = self._measured(scan), self._shapes(scan.positions)
        n_modes = len(histories) // 2
        predicted = shapes[:n_modes].T @ histories[:n_modes]
        expected = (shapes * self._factor[:, None])[:-1].T @ histories[:-1]
        slope = np.gradient(expected, float(np.ptp(scan.time)) / (scan.time.size - 1), axis=1)
        columns = np.stack([expected, -slope, np.ones_like(expected)], axis=1)
        fits = [np.linalg.lstsq(each.T, velocity)[0] for each, velocity in zip(columns, measured, strict=True)]
        factor, late, offset = np.array(fits).T
        rest = measured - np.einsum("pc,pct->pt", fits, columns)
        left, power = np.square(rest).mean(axis=1), np.square(expected).mean(axis=1)
        # Near a node the velocity is mostly that of modes which are not predicted.
        known = power > 0.25 * np.median(power)

        # Sway and hum, of another phase in each record, hardly vary within it.
        moving = scan.velocity - scan.velocity.mean(axis=2, keepdims=True)
        mean = moving.mean(axis=1)
        size = np.einsum("prt,pt->pr", moving, mean) / np.maximum(np.square(mean).sum(axis=1), 1e-30)[:, None]
        odd = known & (size.std(axis=1) > UNSTEADY)
        differ = np.ptp(size, axis=1).max(where=odd, initial=0.0)
        yield (
            odd,
            f"the records differ in size by up to {differ:.0%} of their mean: check focus and fastening of the sensor, "
            "and that nothing touches the beam",
        )
        # A point that moves unlike the modes there seems to have an offset, too.
        odd = (np.abs(factor - 1) < ALIKE - 1) & (offset**2 > 4 * left)
        odd &= np.abs(offset) > OFFSET * self.evidence.velocity
        yield (
            odd,
            f"the velocity has a constant offset of up to {np.abs(offset).max(where=odd, initial=0.0) * 1e3:.2g} mm/s: "
            "set the offsets of vibrometer and scope to zero, connect them to one earth, or use a high-pass",
        )
        times = factor * (expected * predicted).sum() / np.square(predicted).sum()
        yield self._odd_factor(scan, times, known)
        delay = late / factor - (np.median(late / factor) if scan is self.evidence.field else 0.0)
        odd = (np.abs(delay) > LATE) & (np.square(late[:, None] * slope).mean(axis=1) > EXPLAINED * left)
        latest = np.abs(delay).max(where=odd, initial=0.0)
        yield (
            odd,
            f"the velocity is up to {latest * 1e6:.1f} us late or early, relative to the other points: use the same "
            "trigger, filters and range at all points, let the beam reach a steady temperature",
        )
        # Off the mid-line there is torsion, which is not predicted.
        yield (
            (left > UNLIKE * np.median(power)) & (left > STANDS_OUT * np.median(left)) & (scan.across == 0),
            "the velocity is not that of the beam there: check the positions and their order, and focus, range and "
            "fastening of the sensor",
        )

    def _odd_factor(self, scan: Scan, times: FloatArray, known: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], str]:
        """Return the points that move by another factor of the prediction than the others, or all in a wrong field."""
        common = float(np.median(times[known]))
        odd = known & ~((times / common > 1 / ALIKE) & (times / common < ALIKE))
        allowed = f"at the other points {common:.2f} times"
        if common < 0 and not odd.any():
            raise RecordInputError(INVERTED)
        # The findings state a common factor of the zones.
        if scan is self.evidence.field and not odd.any() and not 1 / PLAUSIBLE < common < PLAUSIBLE:
            odd, allowed = np.ones_like(odd), f"allowed {1 / PLAUSIBLE:g} to {PLAUSIBLE:g}"
        ends = times.min(where=odd, initial=np.inf), times.max(where=odd, initial=-np.inf)
        return odd, (
            f"the beam moves {' to '.join(dict.fromkeys(f'{each:.2f}' for each in ends))} times as fast as predicted: "
            f"{allowed}; check the unit, the sensitivity, the range and the sign of the velocity, the positions, and "
            "the gain of the amplifier"
        )


def _fit(measured: FloatArray, shapes: FloatArray, histories: FloatArray) -> tuple[FloatArray, float]:
    """Return the factors of products of shapes and histories, and the squared difference that they leave."""
    overlap = ((shapes @ measured) * histories).sum(axis=1)
    factor = np.linalg.lstsq((shapes @ shapes.T) * (histories @ histories.T), overlap, rcond=1e-12)[0]
    return factor, float(np.square(measured).sum() - factor @ overlap)


def evaluate(evidences: Sequence[Evidence]) -> list[Evidence]:
    """Remove the common measurement delay from recordings made with the same instruments, and return them.

    Raises
    ------
    RecordInputError
        If velocities are unlike the predicted ones, at all points or at some.
    """
    lag = measurement_delay(evidences)
    evaluated = [replace(each, lag=lag) for each in evidences]
    for evidence in evaluated:
        fit = ModalFit(evidence)
        fit.refuse_shifted_points()
        for scan in (evidence.field, *evidence.further_rows, evidence.course):
            fit.refuse_odd_points(scan)
    return evaluated
