"""What a design tolerates: errors of the identified beam, and fewer samples.

For the sensitivity to each beam parameter, the designed voltages are applied to a different beam. Open-loop focusing is
limited by the identification, not by the drive, whose residual of 1e-13 means nothing without this table. Fingers
couple the modes, so that each parameter then affects all of them.

The state at the focusing instant hardly depends on the number of samples, since the law is exact on any clock; more
samples improve the field in the milliseconds around it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantities import FloatArray
from modaltouch.stimulus.stimulus import Stimulus
from modaltouch.stimulus.vibration import history

_STEP = 1e-5
"""Relative step of a parameter for its derivative [1]: 0.05 rad of phase at 30 kHz by the focusing instant."""

LEAST_SAMPLES_PER_CYCLE = 2.5
"""Fewest samples per cycle of the highest mode, whatever the tolerance [1]."""

_AROUND = 1e-3
"""Half-width of the time window around the focusing instant in which fields are compared [s]."""


def focus_sensitivity(
    stimulus: Stimulus,
    positions: ArrayLike,
    *,
    natural_frequency: float = 0.001,
    damping_ratio: float = 0.05,
    modal_gain: float = 0.05,
) -> list[dict[str, float | int | str]]:
    """Return the first-order effects of given relative errors at the focusing instant, worst first.

    Derivatives are fourth-order central differences at the reference level.

    Parameters
    ----------
    stimulus : Stimulus
        The design.
    positions : (n_points,) array_like
        Points of the field, origin at mid-beam [m].
    natural_frequency, damping_ratio, modal_gain : float
        Relative errors of one mode [1]; that of the gain is common to all channels.

    Returns
    -------
    list of dict
        ``parameter``, ``mode``, ``error`` [1], ``field`` (largest change of the velocity at the points
        [m/s]) and ``displacement`` (largest change of any w eta [m/s]).
    """
    errors = {"natural_frequency": natural_frequency, "damping_ratio": damping_ratio, "modal_gain": modal_gain}
    shapes = stimulus.model.shapes(positions)
    rows: list[dict[str, float | int | str]] = []
    for name, error in errors.items():
        for place, label in enumerate(stimulus.model.label):
            velocity, displacement = error * derivative(stimulus, name, place)
            field, moved = float(np.abs(velocity @ shapes).max()), float(np.abs(displacement).max())
            rows.append({"parameter": name, "mode": label, "error": error, "field": field, "displacement": moved})
    return sorted(rows, key=lambda row: -float(row["field"]))


def derivative(stimulus: Stimulus, name: str, place: int) -> FloatArray:
    """Return the derivatives of modal velocities and w eta at the focusing instant with respect to one parameter.

    Parameters
    ----------
    stimulus : Stimulus
        The design.
    name : str
        ``natural_frequency``, ``damping_ratio`` or ``modal_gain`` (of all channels).
    place : int
        Index of the mode in the model.

    Returns
    -------
    (2, n_modes) array
        Derivatives with respect to a relative change [m/s].
    """
    change = np.zeros((2, stimulus.model.n_modes))
    for step, weight in ((-2, 1), (-1, -8), (1, 8), (2, -1)):
        values = getattr(stimulus.model, name).copy()
        values[place] *= 1 + step * _STEP
        change += weight * _reached(stimulus, replace(stimulus.model, **{name: values}))
    return change / (12 * _STEP)


def _reached(stimulus: Stimulus, beam: ModalModel) -> FloatArray:
    """Return modal velocities and w eta of another beam at the focusing instant under the designed voltages."""
    system, timing = DiagonalSystem.of(beam, stimulus.amplifier), stimulus.timing
    return np.stack(system.read(system.state_at(stimulus.voltage, timing, timing.focusing_instant)))


def scatter(
    stimulus: Stimulus,
    positions: ArrayLike,
    *,
    natural_frequency: float = 0.001,
    damping_ratio: float = 0.02,
    modal_gain: float = 0.02,
    n_draws: int = 200,
    seed: int = 0,
) -> tuple[FloatArray, FloatArray]:
    """Return the motion of beams drawn at random around the identified one under the designed voltages.

    Parameters
    ----------
    stimulus : Stimulus
        The design.
    positions : (n_points,) array_like
        Points of the field, origin at mid-beam [m].
    natural_frequency, damping_ratio, modal_gain : float
        Relative standard deviations, log-normal, independent for each mode [1].
    n_draws : int
        Number of beams drawn, at least 2.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    field : (n_draws, n_points) array
        Velocity at the points at the focusing instant [m/s].
    modal_error : (n_draws,) array
        Largest of ``|velocity - target|`` and ``|w eta|`` over the modes [m/s].
    """
    rng = np.random.default_rng(seed)
    model = stimulus.model
    shapes = model.shapes(positions)
    field, worst = np.empty((n_draws, shapes.shape[1])), np.empty(n_draws)
    for draw in range(n_draws):
        factor = np.exp(rng.normal(size=(3, model.n_modes)))
        beam = replace(
            model,
            natural_frequency=model.natural_frequency * factor[0] ** natural_frequency,
            damping_ratio=np.minimum(model.damping_ratio * factor[1] ** damping_ratio, 0.999),
            modal_gain=model.modal_gain * (factor[2] ** modal_gain)[:, None],
        )
        velocity, displacement = _reached(stimulus, beam)
        field[draw] = velocity @ shapes
        worst[draw] = max(np.abs(velocity - stimulus.target).max(), np.abs(displacement).max())
    return field, worst


@dataclass(frozen=True)
class SampleCount:
    """The smallest sufficient number of samples, and the errors of the numbers tried.

    Attributes
    ----------
    stimulus : Stimulus
        The design with that number of samples.
    error : float
        Largest deviation from the field of the finest design around the focusing instant, over the level [1].
    tried : tuple of (int, float)
        Numbers of samples tried, and their errors [1].
    """

    stimulus: Stimulus
    error: float
    tried: tuple[tuple[int, float], ...]

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return self.stimulus.timing.n_samples

    def __str__(self) -> str:
        """Return a sentence with the number chosen and the reason."""
        finest = self.tried[-1][0]
        return (
            f"{self.n_samples} samples give the field of {finest} samples to within {self.error:.1e} of the level; "
            f"tried {', '.join(f'{n}: {error:.1e}' for n, error in self.tried)}"
        )


def cheapest_samples(finest: Stimulus, tolerance: float, positions: ArrayLike) -> SampleCount:
    """Return the smallest number of samples, each an integer number of clock cycles, that keeps the field.

    Parameters
    ----------
    finest : Stimulus
        The design with the most samples, the reference.
    tolerance : float
        Allowed change of the field within 1 ms of the focusing instant, over the level [1].
    positions : (n_positions,) array_like
        Points at which the field is compared, origin at mid-beam [m].

    Returns
    -------
    SampleCount
        At least 2.5 samples per cycle of the highest mode; the finest design if no other is sufficient.
    """
    shapes, most = finest.model.shapes(positions), finest.timing.n_samples
    reference, focus = _history(finest), finest.timing.focusing_instant
    begin, end = max(0.0, focus - _AROUND), min(finest.timing.duration, focus + _AROUND)
    tried: list[tuple[int, float]] = []
    for count in _counts(finest):
        stimulus = replace(finest, timing=replace(finest.timing, n_samples=count))
        samples = (begin * stimulus.timing.sampling_rate - 1e-6, end * stimulus.timing.sampling_rate + 1e-6)
        around = np.arange(math.ceil(samples[0]), math.floor(samples[1]) + 1)
        change = _history(stimulus)[:, around] - reference[:, around * (most // count)]
        error = float(np.abs(shapes.T @ change).max()) / finest.target_field.velocity
        tried.append((count, error))
        if error <= tolerance:
            break
    else:
        stimulus, error = finest, 0.0
    return SampleCount(stimulus, error, (*tried, (most, 0.0)))


def _counts(finest: Stimulus) -> Iterator[int]:
    """Yield, in increasing order, the even divisors of the finest number with an integer number of clocks per sample.

    A protocol accepts even numbers only.
    """
    timing = finest.timing
    highest = float(finest.model.natural_frequency.max())
    least = max(2, math.ceil(LEAST_SAMPLES_PER_CYCLE * highest * timing.duration))
    for count in range(least + least % 2, timing.n_samples, 2):
        if timing.n_samples % count == 0 and replace(timing, n_samples=count).clock_error is None:
            yield count


def _history(stimulus: Stimulus) -> FloatArray:
    return history(stimulus.system, stimulus.system.velocity, stimulus.voltage, stimulus.timing)
