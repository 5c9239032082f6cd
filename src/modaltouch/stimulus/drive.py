r"""The drive laws: voltages that bring every modelled mode from rest to its target, as the generator plays them.

The exact law finds the voltages of least weighted energy that bring all modes to (velocity = target, displacement = 0)
at the focusing instant. It accounts for the sample-and-hold, the amplifier's pole and delay, and the gain of every
channel for every mode. After the focusing instant the voltages either brake the modes to rest or are zero.

The law of the paper, equations (6) and (7), shows why the exact law is needed. These errata are corrected:

1. the gain of section III-B is printed with :math:`\omega^2`; at resonance
   :math:`|\dot\eta| = G|v|/(2\xi\omega)`;
2. equation (7) is printed with the factor :math:`4a^2/b`; inserting (6) in (5) gives
   :math:`\psi = 4a\,\dot\eta`;
4. equation (6) has :math:`e^{ct}`, equation (7) :math:`e^{a(t-t_F)}` with the same amplitude; the latter is
   meant;

and one is kept because it is the reason for the exact law:

3. the orbit (6) does not start at rest; started from rest, mode 1 ends 4 % short.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantities import ComplexArray, DesignError, FloatArray
from modaltouch.stimulus.reachability import GramianSolver, ReachabilityGramian, Taper

Law = Literal["exact", "paper"]
Release = Literal["braked", "free"]
Rounding = Literal["settled", "plain"]
Design = Literal["least_energy", "norm_4", "norm_8", "least_peak"]

Priority = Literal["field", "level"]

RISE = 1.0e-3
"""Length of the taper at the start of the drive, and at both ends of the braking after the focusing instant [s]."""

FALL = 0.4e-3
"""Length of the taper before the focusing instant, which keeps later speeds from exceeding the speed at it [s]."""

_REFINEMENTS = 8
_POLISHED = 9e-13
"""Residual of coupled modes, relative to the largest target, above which a further correction is made [1]."""

_ROUNDING = 16 * float(np.finfo(float).eps)
"""Rounding error of the residual, relative to the largest target; refinement cannot reduce it further [1]."""


@dataclass(frozen=True, eq=False)
class Drive:
    """Voltages of a burst, and how accurately they meet the targets."""

    voltage: FloatArray  # (n_channels, n_samples): voltages at the beam [V]
    # condition number of the scaled Gramian [1]; 1 for the law of the paper, which solves no equations
    condition_number: float
    residual: float  # largest deviation of a state from its target at the focusing instant, before rounding [m/s]
    n_before: int  # number of samples played before the focusing instant; later voltages do not affect it

    @property
    def before_focus(self) -> FloatArray:
        """Voltages that affect the focusing instant, (n_channels, n_before) array [V]."""
        return self.voltage[:, : self.n_before]


def check_drivable(model: ModalModel, target: FloatArray, timing: Timing) -> None:
    """Reject modes that cannot be driven to their targets [m/s] or that are too fast for the sampling rate.

    Raises ValueError if a mode with a target has no gain, or a mode lies at or above half the sampling rate.
    """
    for k, velocity, gain, frequency in zip(
        model.label, target, model.modal_gain, model.natural_frequency, strict=True
    ):
        if velocity != 0 and not gain.any():
            raise DesignError(
                f"mode {k} is asked for, but its gain is 0 m/s^2 per V on every channel; it must be driven by "
                f"at least one: identify the gain, or select other modes",
                "modal_gain",
                k,
            )
        if frequency >= timing.sampling_rate / 2:
            raise ValueError(
                f"mode {k} at {frequency:g} Hz is not below half the sampling rate of {timing.sampling_rate:g} Hz: "
                f"use more than {math.ceil(2 * frequency * timing.duration)} samples"
            )


@dataclass(frozen=True, eq=False)
class Steering:
    """Conditions on the voltages, for the driven modes only; modes without a gain stay at rest."""

    model: ModalModel
    system: DiagonalSystem  # their equations, with the amplifier
    timing: Timing
    # ``braked`` (brought to rest at the end of the burst) or ``free`` (zero volts after the focusing instant)
    release: Release
    velocity: FloatArray  # (n_modes,): target modal velocities at the focusing instant [m/s]
    # (n_modes,): target modal displacements times angular frequency [m/s]; 0 unless corrected by a calibration
    displacement: FloatArray

    @cached_property
    def driven(self) -> NDArray[np.intp]:
        """Indices of the modes driven by a channel and of those coupled to them by fingers."""
        driven = np.asarray(self.model.modal_gain.any(axis=1))
        if self.model.fingers:
            from modaltouch.stimulus.fingers import coupled_with

            driven = coupled_with(driven, self.model.loads)
        return np.flatnonzero(driven)

    @cached_property
    def read(self) -> ComplexArray:
        """Output matrix of the conditions, ``Re(read @ state)``: velocities, then displacements [m/s]."""
        return np.concatenate([self.system.velocity[self.driven], self.system.displacement[self.driven]])

    @cached_property
    def goal(self) -> FloatArray:
        """Target values of the conditions at the focusing instant, (n_conditions,) array [m/s]."""
        return np.concatenate([self.velocity[self.driven], self.displacement[self.driven]])

    @cached_property
    def reach(self) -> ReachabilityGramian:
        """Effect of the samples before the focusing instant on the conditions.

        Raises ValueError if a mode cannot be driven, or there are fewer samples than conditions.
        """
        check_drivable(self.model, self.velocity, self.timing)
        n_before, remainder = self._until_focus
        self._check_enough(n_before, "before the focusing instant")
        return self._reach(self.read, n_before, FALL, remainder)

    @property
    def braked_from(self) -> int:
        """First sample that has no effect before the focusing instant."""
        n_before, remainder = self._until_focus
        return n_before + (remainder > 0)

    @property
    def _until_focus(self) -> tuple[int, float]:
        return self.timing.samples_until(self.timing.focusing_instant - self.system.delay)

    def _reach(self, read: ComplexArray, n_samples: int, fall: float, remainder: float = 0.0) -> ReachabilityGramian:
        """Return the effect of `n_samples` samples on the outputs `read`, at a time `remainder` [s] after their end."""
        held = self.system.held_gain(self.timing.hold) * np.exp(self.system.exponent * remainder)[:, None]
        rate = self.timing.sampling_rate
        return ReachabilityGramian(
            row=read[:, None, :] * held.T,
            exponent=self.system.exponent,
            hold=self.timing.hold,
            taper=Taper.fitting(n_samples, RISE * rate, fall * rate),
        )

    @cached_property
    def solver(self) -> GramianSolver:
        """Solver for the multipliers of the conditions."""
        return self._solver(self.reach)

    def _solver(self, reach: ReachabilityGramian) -> GramianSolver:
        return GramianSolver.of(reach.gramian(), [self.model.label[i] for i in self.driven])

    def short(self, voltage: FloatArray) -> tuple[FloatArray, ComplexArray]:
        """Return the shortfall (goal minus value reached) of voltages from the burst's start, and the state reached."""
        state = self.system.state_at(voltage, self.timing, self.timing.focusing_instant)
        if self.system.real is None:
            return self.goal - (self.read @ state).real, state
        reached = self.system.real.reached(voltage, self.timing, self.timing.focusing_instant)
        return self.goal - reached.reshape(2, -1)[:, self.driven].ravel(), state

    def end(self, voltage: FloatArray, state: ComplexArray) -> None:
        """Write the voltages after the focusing instant, given the state at that instant."""
        if self.release == "braked":
            start, timing = self.braked_from, self.timing
            # Nothing reaches the beam between the focusing instant and the arrival of the first braking sample.
            ahead = start * timing.hold + self.system.delay - timing.focusing_instant
            self.brake(voltage, start, state * np.exp(self.system.exponent * ahead))

    def brake(self, voltage: FloatArray, start: int, state: ComplexArray) -> None:
        """Write the least-energy voltages, from sample `start` on, that bring every driven mode to rest by burst end.

        `state` is the state when sample `start` reaches the beam, after the amplifier's delay. Raises ValueError if
        there are too few samples left for the conditions.
        """
        timing, driven = self.timing, self.driven
        n_left = timing.n_samples - start
        self._check_enough(n_left, "after the focusing instant, or release it `free`")
        # Only the states of the beam must be at rest: those of the amplifier decay in the silence that follows.
        read = np.zeros((2 * driven.size, self.system.exponent.size), dtype=complex)
        if self.model.fingers:
            n_beam = self.system.n_beam
            read[:, :n_beam] = self.read[:, :n_beam]
        else:
            read[np.arange(driven.size), driven] = 1.0
            read[np.arange(driven.size) + driven.size, driven] = -1j
        reach = self._reach(read, n_left, RISE)
        left = state * np.exp(self.system.exponent * (timing.duration - start * timing.hold))
        reach.write(self._solver(reach).solve(-(read @ left).real), voltage[:, start:])

    def _check_enough(self, n_samples: int, where: str) -> None:
        """Reject fewer free samples than conditions; the first and the last sample are fixed at zero."""
        driving = self.model.modal_gain[self.driven] != 0
        alone = driving & (driving.sum(axis=1, keepdims=True) == 1)
        n_conditions = 2 * self.driven.size
        n_channels = max(1, int(driving.any(axis=0).sum()))
        least = 2 + max(-(-n_conditions // n_channels), 2 * int(alone.sum(axis=0).max(initial=0)))
        if n_samples < least:
            raise DesignError(
                f"{n_samples} samples are fewer than {n_conditions} conditions on {n_channels} channels need; at "
                f"least {least} must lie {where}: take more than {self.timing.n_samples} samples, or another focusing "
                f"instant",
                "focusing_instant",
            )


def exact_drive(steering: Steering) -> Drive:
    """Return the least-energy voltages that meet every condition, from rest."""
    nothing = np.zeros((steering.model.n_channels, steering.reach.taper.n_samples))
    rest = np.zeros(steering.system.exponent.size, dtype=complex)
    enough = _POLISHED if steering.system.coupled else _ROUNDING
    return _corrected(steering, nothing, steering.goal, rest, np.inf, enough)


def polished(steering: Steering, voltage: FloatArray) -> Drive:
    """Return the drive after least-energy corrections of the residual of voltages up to the focusing instant."""
    short, state = steering.short(voltage)
    return _corrected(steering, voltage, short, state, float(np.abs(short).max()), 0.0)


def _corrected(
    steering: Steering, voltage: FloatArray, short: FloatArray, state: ComplexArray, residual: float, enough: float
) -> Drive:
    """Correct voltages, given their shortfall and state, until the residual over the largest target is `enough`.

    The residual is computed by forward simulation of the voltages on the true clock. This removes the rounding error of
    the closed-form Gramian and the unevenness of the clock from the result.
    """
    change = np.empty_like(voltage)
    enough *= float(np.abs(steering.goal).max())
    for _ in range(_REFINEMENTS):
        if residual <= enough:
            break
        steering.reach.write(steering.solver.solve(short), change)
        tried = voltage + change
        short, tried_state = steering.short(tried)
        now = float(np.abs(short).max())
        if now >= 0.5 * residual:
            break
        voltage, state, residual = tried, tried_state, now
    whole = np.zeros((len(voltage), steering.timing.n_samples))
    whole[:, : voltage.shape[1]] = voltage
    steering.end(whole, state)
    return Drive(whole, steering.solver.condition_number, residual, voltage.shape[1])
