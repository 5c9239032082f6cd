"""What the identified beam does under the codes as played, and by how much a measurement comes after it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.record.chain import RecordInputError
from modaltouch.stimulus.vibration import velocity_history
from modaltouch.validation.recording import Observation

FloatArray = NDArray[np.float64]

LAGS = np.arange(-5e-6, 25e-6, 0.25e-6)
"""Delays of the measurement that are tried [s]."""

COMPARED = 0.25e-3
"""Around the focusing instant, where a delay shows most [s]."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Velocities of the identified beam under the codes as played.

    Attributes
    ----------
    time : (n_times,) array
        From the start of a burst [s].
    field : (n_positions, n_times) array
        Along the beam [m/s].
    course : (n_zones, n_times) array
        At the centres of the zones [m/s].
    """

    time: FloatArray
    field: FloatArray
    course: FloatArray

    @classmethod
    def of(cls, observation: Observation) -> Prediction:
        """Return the prediction at the positions of an observation."""
        stimulus, timing = observation.stimulus, observation.stimulus.timing
        places = observation.field.positions
        played = velocity_history(
            stimulus.model,
            stimulus.voltage_played(observation.velocity),
            timing,
            [*places, *observation.course.positions],
            stimulus.amplifier,
        )
        time = np.asarray(np.arange(timing.n_samples) * timing.hold + stimulus.amplifier.delay, dtype=float)
        return cls(time, played[: places.size], played[places.size :])

    def around(self, first: float, last: float) -> Callable[[FloatArray], FloatArray]:
        """Return what gives the field, (n_positions, n_instants) array [m/s], at instants of a stretch of time [s]."""
        from scipy.interpolate import CubicSpline

        near = (self.time >= first) & (self.time <= last)
        field: Callable[[FloatArray], FloatArray] = CubicSpline(self.time[near], self.field[:, near], axis=1)
        return field


def measurement_lag(observations: Sequence[Observation], predictions: Sequence[Prediction]) -> float:
    """Return the delay by which the measurement follows the prediction best, by least squares [s].

    Vibrometer, amplifier and trigger each come late by microseconds, which the highest selected mode turns into a
    large part of its period: without taking the delay out, no field at the focusing instant can be told.

    Raises
    ------
    RecordInputError
        If none of the delays tried is better than its neighbours.
    """
    missed = np.zeros(LAGS.size)
    for observation, prediction in zip(observations, predictions, strict=True):
        scan = observation.field
        near = np.abs(scan.time - observation.stimulus.timing.focusing_instant) < COMPARED
        measured = scan.velocity[:, :, near].mean(axis=1)
        predicted = prediction.around(scan.time[near][0] - 2 * LAGS[-1], scan.time[near][-1] - 2 * LAGS[0])
        for place, lag in enumerate(LAGS):
            missed[place] += float(np.square(measured - predicted(scan.time[near] - lag)).sum())
    best = int(missed.argmin())
    if best in (0, LAGS.size - 1):
        raise RecordInputError(
            f"the recordings do not follow the predictions with any delay from {LAGS[0] * 1e6:g} to "
            f"{LAGS[-1] * 1e6:g} us: check wiring, trigger and apparatus file"
        )
    before, at, after = missed[best - 1 : best + 2]
    return float(LAGS[best] + (LAGS[1] - LAGS[0]) * (before - after) / (2 * (before - 2 * at + after)))
