r"""The exact drive law: every modelled mode from rest to its target, as the generator plays it.

The voltages are those of least weighted energy that bring all modes at the focusing instant to (velocity = target,
displacement = 0), through the hold of the samples, the amplifier's pole and its delay, every channel driving every
mode. After it they brake the modes to rest, or are silent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.reachability import GramianSolver, ReachabilityGramian, Taper
from modaltouch.stimulus.timing import Timing
from modaltouch.stimulus.vibration import states_by_channel

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Law = Literal["exact", "paper"]
Release = Literal["braked", "free"]

RISE = 1.0e-3
"""Length of the taper at the start of a stretch [s]."""

FALL = 0.4e-3
"""Length of the taper before the focus, which keeps the speed after it from passing the speed at it [s]."""

_REFINEMENTS = 8
_ROUNDING = 16 * float(np.finfo(float).eps)
"""A residual this small, as a fraction of the largest target, is rounding: no refinement lessens it [1]."""


@dataclass(frozen=True, eq=False)
class Drive:
    """Voltages of a burst, and how well its equations were solved.

    Attributes
    ----------
    voltage : (n_channels, n_samples) array
        At the beam [V].
    condition_number : float
        Of the scaled Gramian [1]; 1 where nothing is solved (`paper`).
    residual : float
        Largest deviation of a state at the focusing instant from its target [m/s], of these voltages unrounded.
    n_before : int
        Samples played before the focusing instant; voltages after them do not act on it.
    """

    voltage: FloatArray
    condition_number: float
    residual: float
    n_before: int


def check_drivable(model: ModalModel, target: FloatArray, timing: Timing) -> None:
    """Refuse modes that cannot be driven to their targets, or whose oscillation the samples cannot follow.

    Parameters
    ----------
    model : ModalModel
        The modelled modes.
    target : (n_modes,) array
        Modal velocities at the focusing instant [m/s].
    timing : Timing
        Clock of the samples.

    Raises
    ------
    ValueError
        If a mode with a target has no gain, or a mode lies at or above half the sampling rate.
    """
    for k, wished, gain, frequency in zip(model.label, target, model.modal_gain, model.natural_frequency, strict=True):
        if wished != 0 and not gain.any():
            raise ValueError(
                f"mode {k} is asked for, but its gain is 0 m/s^2 per V on every channel; it must be driven by "
                f"at least one: identify the gain, or select other modes"
            )
        if frequency >= timing.sampling_rate / 2:
            raise ValueError(
                f"mode {k} at {frequency:g} Hz is not below half the sampling rate of "
                f"{timing.sampling_rate:g} Hz: take more than {math.ceil(2 * frequency * timing.duration)} "
                f"samples"
            )


def exact_drive(
    model: ModalModel,
    system: DiagonalSystem,
    timing: Timing,
    target: FloatArray,
    release: Release,
    displacement: FloatArray | None = None,
) -> Drive:
    """Return the cheapest voltages from rest to (velocity = target, displacement = 0) at the focusing instant.

    Parameters
    ----------
    model : ModalModel
        The modelled modes; all of them are steered, those with target 0 to rest.
    system : DiagonalSystem
        Their equations behind the amplifier.
    timing, target
        As for `check_drivable`.
    release : str
        ``braked`` (steered to rest at the end of the burst) or ``free`` (zero volts after the focus).
    displacement : (n_modes,) array, optional
        Modal displacements times angular frequency at the focusing instant, where a calibration wants others than
        0 [m/s].

    Raises
    ------
    ValueError
        If a mode cannot be driven, or there are fewer samples than conditions.
    """
    reach, read, wished, braked_from = steering(model, system, timing, target, displacement)
    n_before = reach.taper.n_samples
    voltage = np.zeros((model.n_channels, timing.n_samples))
    condition, residual, state = _steer(system, timing, reach, (read, wished), voltage[:, :n_before], _driven(model))
    if release == "braked":
        # No sample acts between the focusing instant and the arrival of the first that brakes.
        ahead = braked_from * timing.hold + system.delay - timing.focusing_instant
        brake(model, system, timing, voltage, braked_from, state * np.exp(system.exponent * ahead))
    return Drive(voltage, condition, residual, n_before)


def steering(
    model: ModalModel,
    system: DiagonalSystem,
    timing: Timing,
    target: FloatArray,
    displacement: FloatArray | None = None,
) -> tuple[ReachabilityGramian, ComplexArray, FloatArray, int]:
    """Return how the samples before the focusing instant reach the states there, and which states are wished.

    Parameters
    ----------
    model : ModalModel
        The modelled modes; those without any gain rest by themselves and are left out.
    system, timing, target
        As for `exact_drive`.
    displacement : (n_modes,) array, optional
        Modal displacements times angular frequency there; 0 if not given [m/s].

    Returns
    -------
    reach : ReachabilityGramian
        From the samples to the conditions.
    read : (n_conditions, n_states) complex array
        The conditions are the real part of ``read @ state``: velocities, then displacements times angular
        frequency.
    wished : (n_conditions,) array
        Their values at the focusing instant [m/s].
    free_from : int
        First sample that does not act before the focusing instant.

    Raises
    ------
    ValueError
        If a mode cannot be driven, or there are fewer samples than conditions.
    """
    check_drivable(model, target, timing)
    n_before, remainder = timing.samples_until(timing.focusing_instant - system.delay)
    driven = model.modal_gain.any(axis=1)
    _check_enough(model.modal_gain[driven], n_before, timing, "before the focusing instant")
    read = np.concatenate([system.velocity[driven], system.displacement[driven]])
    held = system.held_gain(timing.hold) * np.exp(system.exponent * remainder)[:, None]
    reach = ReachabilityGramian(
        row=read[:, None, :] * held.T,
        exponent=system.exponent,
        hold=timing.hold,
        taper=Taper.fitting(n_before, RISE * timing.sampling_rate, FALL * timing.sampling_rate),
    )
    resting = np.zeros(model.n_modes) if displacement is None else displacement
    wished = np.concatenate([target[driven], resting[driven]])
    return reach, read, wished, n_before + (remainder > 0)


def _steer(
    system: DiagonalSystem,
    timing: Timing,
    reach: ReachabilityGramian,
    goal: tuple[ComplexArray, FloatArray],
    voltage: FloatArray,
    label: list[int],
) -> tuple[float, float, ComplexArray]:
    """Write the voltages that read the goal at the focusing instant; return condition number, residual and state.

    The residual is measured forward, on the voltages as written and the clock as it is, and solved for again:
    that takes the rounding of the closed-form Gramian and the unevenness of the clock out of the result.
    """
    read, wished = goal
    solver = GramianSolver.of(reach.gramian(), label)
    weight = np.zeros_like(wished)
    best, kept, kept_state = np.inf, weight, np.zeros(system.exponent.size, dtype=complex)
    short = wished
    for _ in range(_REFINEMENTS):
        weight = weight + solver.solve(short)
        reach.write(reach.amplitudes(weight), voltage)
        state = states_by_channel(system, voltage, timing, timing.focusing_instant).sum(axis=0)
        short = wished - (read @ state).real
        residual = float(np.abs(short).max())
        if residual >= 0.5 * best:
            break
        best, kept, kept_state = residual, weight, state
        if residual <= _ROUNDING * float(np.abs(wished).max()):
            break
    if kept is not weight:
        reach.write(reach.amplitudes(kept), voltage)
    return solver.condition_number, best, kept_state


def brake(
    model: ModalModel,
    system: DiagonalSystem,
    timing: Timing,
    voltage: FloatArray,
    start: int,
    state: ComplexArray,
) -> None:
    """Write the cheapest voltages from a sample on that leave every driven mode at rest when the burst ends.

    Parameters
    ----------
    model : ModalModel
        The modelled modes.
    system, timing
        As for `exact_drive`.
    voltage : (n_channels, n_samples) array
        Voltages of the burst, zero from `start` on, which is overwritten [V].
    start : int
        First sample that brakes.
    state : (n_states,) complex array
        States when that sample arrives at the beam, after the amplifier's delay.

    Raises
    ------
    ValueError
        If there are fewer samples left than conditions.
    """
    driven = np.flatnonzero(model.modal_gain.any(axis=1))
    n_left = timing.n_samples - start
    _check_enough(model.modal_gain[driven], n_left, timing, "after the focusing instant, or release it `free`")
    # What is read at rest are the modes' own states: the amplifier's die out by themselves within the silence.
    read = np.zeros((2 * driven.size, system.exponent.size), dtype=complex)
    read[np.arange(driven.size), driven] = 1.0
    read[np.arange(driven.size) + driven.size, driven] = -1j
    held = system.held_gain(timing.hold)
    reach = ReachabilityGramian(
        row=read[:, None, :] * held.T,
        exponent=system.exponent,
        hold=timing.hold,
        taper=Taper.fitting(n_left, RISE * timing.sampling_rate, RISE * timing.sampling_rate),
    )
    left = state * np.exp(system.exponent * (timing.duration - start * timing.hold))
    weight = GramianSolver.of(reach.gramian(), _driven(model)).solve(-(read @ left).real)
    reach.write(reach.amplitudes(weight), voltage[:, start:])


def _driven(model: ModalModel) -> list[int]:
    """Return the labels of the modes that any channel drives."""
    return [label for label, gain in zip(model.label, model.modal_gain, strict=True) if gain.any()]


def _check_enough(gain: FloatArray, n_samples: int, timing: Timing, where: str) -> None:
    """Refuse fewer free samples than conditions; the first and the last of a stretch are not free."""
    driving = gain != 0
    alone = driving & (driving.sum(axis=1, keepdims=True) == 1)
    n_conditions = 2 * gain.shape[0]
    n_channels = max(1, int(driving.any(axis=0).sum()))
    least = 2 + max(-(-n_conditions // n_channels), 2 * int(alone.sum(axis=0).max(initial=0)))
    if n_samples < least:
        raise ValueError(
            f"{n_samples} samples are fewer than {n_conditions} conditions on {n_channels} channels need; at "
            f"least {least} must lie {where}: take more than {timing.n_samples} samples, or another focusing "
            f"instant"
        )
