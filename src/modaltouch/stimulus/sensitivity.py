r"""How well a lab must identify its beam: what an error of each parameter does to the field at the focus.

The voltages stay as they were designed; the beam differs. Open loop is limited by identification, not by the
codes: their 1e-13 means nothing without this table. Fingers couple the modes: each parameter then moves them all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.fingers import CoupledModes, eigenvectors
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantities import ComplexArray, FloatArray
from modaltouch.stimulus.stimulus import Stimulus

_WORST_CONDITION = 1e4
"""Condition number of the eigenvectors above which their derivatives are not trusted [1]."""

_MEET = 1e-5
"""Relative distance of exponents below which a difference quotient is a derivative [1]."""


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of the state at the focus by relative changes of the parameters, at the reference level.

    Each array holds velocities first, then displacements times angular frequency; the modes that move come before
    those whose parameter changes. Without fingers a mode depends on its own parameters alone.

    Attributes
    ----------
    label : tuple of int
        Label of each mode.
    natural_frequency : (2, n_modes, n_modes) array
        Per relative change of the natural frequency [m/s].
    damping_ratio : (2, n_modes, n_modes) array
        Per relative change of the damping ratio [m/s].
    modal_gain : (2, n_modes, n_modes, n_channels) array
        Per relative change of each channel's gain [m/s].
    """

    label: tuple[int, ...]
    natural_frequency: FloatArray
    damping_ratio: FloatArray
    modal_gain: FloatArray

    def table(
        self,
        shapes: FloatArray,
        *,
        natural_frequency: float = 0.001,
        damping_ratio: float = 0.05,
        modal_gain: float = 0.05,
    ) -> list[dict[str, float | int | str]]:
        """Return what given relative errors do, one row to each parameter of each mode, the worst first.

        Parameters
        ----------
        shapes : (n_modes, n_points) array
            Mode shapes where the field is looked at [1].
        natural_frequency, damping_ratio, modal_gain : float
            Relative errors [1]; the gain's is common to all channels.

        Returns
        -------
        list of dict
            ``parameter``, ``mode``, ``error`` [1], ``field`` (largest change of the velocity at the points
            [m/s]) and ``displacement`` (largest change of any w eta [m/s]).
        """
        effects = {
            "natural_frequency": (natural_frequency, self.natural_frequency),
            "damping_ratio": (damping_ratio, self.damping_ratio),
            "modal_gain": (modal_gain, self.modal_gain.sum(axis=3)),
        }
        rows: list[dict[str, float | int | str]] = [
            {
                "parameter": name,
                "mode": label,
                "error": error,
                "field": float(np.abs(effect[0, :, k] @ shapes).max() * error),
                "displacement": float(np.abs(effect[1, :, k]).max() * error),
            }
            for name, (error, effect) in effects.items()
            for k, label in enumerate(self.label)
        ]
        return sorted(rows, key=lambda row: -float(row["field"]))


def focus_sensitivity(stimulus: Stimulus) -> Sensitivity:
    r"""Return the derivatives of the state at the focusing instant, in closed form, on the clock as it is.

    In the eigenvectors V of the equations :math:`\dot x = A x + B v` a change :math:`A'` of the matrix moves state j by
    :math:`\sum_k (V^{-1} A' V)_{jk} \sum_c (V^{-1} B)_{kc} \frac{r_c(s_j) - r_c(s_k)}{s_j - s_k}`, where
    :math:`r_c(s)` is the response of :math:`\dot x = s x + v_c`; for j = k the quotient is its derivative.

    Parameters
    ----------
    stimulus : Stimulus
        The design.
    """
    model, n = stimulus.model, stimulus.model.n_modes
    omega, damping = model.angular_frequency, 2 * model.damping_ratio * model.angular_frequency
    coupled, exponent, vectors = _trusted_eigenvectors(model)
    inverse = np.linalg.inv(vectors)
    pushed, below = inverse @ coupled.force, inverse[:, n : 2 * n]
    reached, slope = _responses(stimulus, exponent)
    gap = (exponent[:, None] - exponent)[:, :, None]
    meet = np.abs(gap) <= _MEET * np.abs(exponent)[:, None]
    quotient = np.where(meet, (slope[:, None] + slope) / 2, (reached[:, None] - reached) / np.where(meet, 1, gap))
    passed_on = np.einsum("jkc,kc->jk", quotient, pushed @ model.modal_gain) @ vectors[: 2 * n].T
    by_displacement, by_velocity = passed_on[:, :n], passed_on[:, n:]
    by_ratio = -damping * pushed * by_velocity
    stiffer = -2 * omega * pushed - below @ coupled.matrix[n : 2 * n, :n]
    changes = (
        omega * inverse[:, :n] * by_velocity + stiffer * by_displacement + by_ratio,
        by_ratio,
        pushed[:, :, None] * model.modal_gain * reached[:, None],
    )
    read = np.stack([vectors[n : 2 * n], vectors[:n]])
    return Sensitivity(model.label, *(np.tensordot(read, change, axes=1).real for change in changes))


def _trusted_eigenvectors(model: ModalModel) -> tuple[CoupledModes, ComplexArray, ComplexArray]:
    """Return equations that each modal acceleration drives, their exponents and eigenvectors.

    Where these are lost, at critical damping, the fingers are taken a few millionths off.
    """
    given = model.angular_frequency, model.damping_ratio, np.eye(model.n_modes)
    for off in (0.0, 1e-6):
        loads = [(contact, finger.scaled(1 + off * (2 + i))) for i, (contact, finger) in enumerate(model.loads)]
        coupled = CoupledModes.of(*given, loads)
        exponent, vectors = eigenvectors(coupled.matrix)
        if np.linalg.cond(vectors) <= _WORST_CONDITION:
            break
    return coupled, exponent, vectors


def _responses(stimulus: Stimulus, exponent: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return r(s), the response behind the amplifier, and dr/ds at the focus, two (n_states, n_channels) arrays."""
    timing, amplifier = stimulus.timing, stimulus.amplifier
    n_before, remainder = timing.samples_until(timing.focusing_instant - amplifier.delay)
    n_begun = min(n_before + (remainder > 0), timing.n_samples)
    ago: FloatArray = np.asarray(remainder + timing.hold * (n_before - np.arange(n_begun)))
    if timing.clock_error is not None:
        ago = np.maximum(ago - timing.clock_error[:n_begun], 0.0)
    step = np.diff(stimulus.voltage[:, :n_begun], axis=1, prepend=0.0)
    reached, slope = _response_to_steps(step, ago, exponent)
    if amplifier.bandwidth is None:
        return reached, slope
    pole = 2 * np.pi * amplifier.bandwidth
    lagging, _ = _response_to_steps(step, ago, np.array([-pole], dtype=complex))
    left = pole * lagging[0].real
    share = (1 / (pole + exponent))[:, None]
    slope = pole * share * slope - pole * share**2 * reached + share**2 * left
    return pole * share * reached - share * left, slope


def _response_to_steps(step: FloatArray, ago: FloatArray, exponent: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return x of x' = s x + v, and dx/ds, after steps of v some time ago, two (n_states, n_channels) arrays."""
    reached, slope = np.empty((2, exponent.size, step.shape[0]), dtype=complex)
    for k, s in enumerate(exponent):
        if s.imag < 0:  # follows its conjugate
            reached[k], slope[k] = reached[k - 1].conj(), slope[k - 1].conj()
            continue
        # One state at a time bounds the memory.
        grown = np.expm1(s * ago) / s
        reached[k] = step @ grown
        slope[k] = step @ (ago * np.exp(s * ago) - grown) / s
    return reached, slope


@dataclass(frozen=True, eq=False)
class Scatter:
    """What an uncertain beam makes of a design.

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
    """Return what beams drawn around the identified one make of the voltages as designed.

    Parameters
    ----------
    stimulus : Stimulus
        The design.
    positions : (n_points,) array_like
        Where the field is looked at, origin at mid-beam [m].
    natural_frequency, damping_ratio, modal_gain : float
        Relative standard deviations, log-normal, each mode on its own [1].
    n_draws : int
        Beams drawn, at least 2.
    seed : int
        Of the random numbers.

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
    model, timing = stimulus.model, stimulus.timing
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
        system = DiagonalSystem.of(beam, stimulus.amplifier)
        velocity, displacement = system.read(system.state_at(stimulus.voltage, timing, timing.focusing_instant))
        field[draw] = velocity @ shapes
        worst[draw] = max(np.abs(velocity - stimulus.target).max(), np.abs(displacement).max())
    return Scatter(field, worst)
