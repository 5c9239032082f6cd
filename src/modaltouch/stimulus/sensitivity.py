r"""Sensitivity of the field at the focus to errors of each beam parameter: how accurately a beam must be identified.

The designed voltages are applied to a different beam. Open-loop focusing is limited by the identification, not by the
drive, whose residual of 1e-13 means nothing without this table. Fingers couple the modes, so that each parameter then
affects all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantities import FloatArray
from modaltouch.stimulus.stimulus import Stimulus

_STEP = 1e-5
"""Relative step of a parameter for its derivative [1]: 0.05 rad of phase at 30 kHz by the focusing instant."""


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


@dataclass(frozen=True, eq=False)
class Scatter:
    """Response of randomly drawn beams to a design.

    Attributes
    ----------
    field : (n_draws, n_points) array
        Velocity at the points at the focusing instant [m/s].
    modal_error : (n_draws,) array
        Largest of |velocity - target| and |w eta| over the modes [m/s].
    """

    field: FloatArray
    modal_error: FloatArray

    @property
    def deviation(self) -> FloatArray:
        """Standard deviation of the velocity at each point, (n_points,) array [m/s]."""
        return np.asarray(self.field.std(axis=0, ddof=1))


def scatter(
    stimulus: Stimulus,
    positions: ArrayLike,
    *,
    natural_frequency: float = 0.001,
    damping_ratio: float = 0.02,
    modal_gain: float = 0.02,
    n_draws: int = 200,
    seed: int = 0,
) -> Scatter:
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

    Raises
    ------
    ValueError
        If a deviation is negative, or fewer than two beams are drawn.
    """
    if n_draws < 2:
        raise ValueError(f"{n_draws} beams are drawn; a scatter needs at least 2: draw 200")
    for name, value in (("frequency", natural_frequency), ("damping", damping_ratio), ("gain", modal_gain)):
        if not value >= 0:
            raise ValueError(f"the relative deviation of the {name} is {value}; it must be 0 or above")
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
    return Scatter(field, worst)
