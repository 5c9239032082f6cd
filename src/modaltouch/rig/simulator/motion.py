"""Velocity, state and voltage at arbitrary instants of repeated bursts, for measurements, and hysteresis."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from modaltouch.rig.simulator.true_beam import ComplexArray, FloatArray, Held, refined
from modaltouch.stimulus import Amplifier, BlockKernel, DiagonalSystem

SAME_POLE = 1e-6
"""Relative distance below which two poles count as equal [1]."""

AT_ONCE = 32768
"""Number of instants per batch: limits the memory and keeps intermediate results in the cache."""

SPARE = 64
"""Number of instants computed beyond the last one requested, for records with another jitter."""

PLAYS = (0.2, 0.4, 0.6, 0.8)
"""Half-widths of the play operators of an actuator, as fractions of the amplifier's limit [1]."""


@dataclass(frozen=True, eq=False)
class TrueState:
    """The true state of the beam at an instant, a reference for measurements, known only for a twin.

    Attributes
    ----------
    label : tuple of int
        Labels of the modes of the table.
    velocity : (n_modes,) array
        Modal velocities of these modes [m/s].
    displacement : (n_modes,) array
        Modal displacements of these modes times natural angular frequency, w eta [m/s].
    unlisted_velocity : (n_unlisted,) array
        Modal velocities of the modes not in the table [m/s].
    """

    label: tuple[int, ...]
    velocity: FloatArray
    displacement: FloatArray
    unlisted_velocity: FloatArray


@dataclass(frozen=True, eq=False)
class StateHistory:
    """States of a beam during repeated bursts, from which the motion of every point follows.

    Attributes
    ----------
    system : DiagonalSystem
        The beam behind its amplifier.
    held : Held
        The bursts.
    hold : float
        Time between computed instants [s].
    voltage : (n_channels, n_instants) array
        Voltages as played, at the computed instants [V].
    begin : (n_states, n_blocks) complex array
        States before each block of instants.
    last : (n_states,) complex array
        State at the end of a burst.
    end : float
        End of the computed instants, from the first sample of a burst at the beam [s]; infinite for a whole burst.
    sides : dict
        Cached intermediate results shared by the motions of all points.
    """

    system: DiagonalSystem
    held: Held
    hold: float
    voltage: FloatArray
    begin: ComplexArray
    last: ComplexArray
    end: float
    sides: dict[Any, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, system: DiagonalSystem, held: Held, span: tuple[float, float]) -> Self:
        """Return the states after many bursts, for a span of instants since a first sample reached the beam [s]."""
        voltage, hold = refined(system, held)
        n_instants, end = voltage.shape[1], math.inf
        # Before a burst or after its period, another burst decays, which requires a whole burst.
        if span[0] >= 0 and span[1] < held.period:
            n_needed = int(span[1] / hold) + 2 + SPARE
            if n_needed < n_instants:
                n_instants, end = n_needed, (n_needed - 2) * hold
        state = start_state(system, held)
        kernel = BlockKernel.of(system, np.empty((0, state.size), dtype=complex), hold)
        # One extra sample, so that the last instant is the end of the burst.
        voltage = np.pad(voltage[:, :n_instants], ((0, 0), (0, 1)))
        begin, _ = kernel.states(BlockKernel.blocks(voltage), state)
        last = system.held_states(held.voltage, held.hold).sum(axis=0) + state * np.exp(system.exponent * held.duration)
        return cls(system, held, hold, voltage, begin, last, end)

    def covers(self, span: tuple[float, float]) -> bool:
        """Test whether every instant of a span is computed."""
        return math.isinf(self.end) or (span[0] >= 0 and span[1] < self.end)

    def motion(self, output: ComplexArray) -> Motion:
        """Return the motion of the output ``Re(output @ state)``; `output` is an (n_states,) complex array."""
        system = self.system
        kernel = BlockKernel.of(system, np.stack([output, output * system.exponent]), self.hold)
        course = np.empty((2, self.voltage.shape[1]))
        kernel.respond(BlockKernel.blocks(self.voltage), self.begin, course, self.sides)
        value, slope = course[0], course[1] * self.hold
        # The voltage held in each interval adds to the slope there.
        push = (output @ system.input_gain).real @ self.voltage[:, :-1] * self.hold
        step = np.diff(value)
        from_left, from_right = slope[:-1] + push - step, step - (slope[1:] + push)
        cubic = np.empty((4, step.size))
        cubic[0] = value[:-1]
        np.add(step, from_left, out=cubic[1])
        np.subtract(from_right, 2 * from_left, out=cubic[2])
        np.subtract(from_left, from_right, out=cubic[3])
        return Motion(self.held, self.hold, cubic, system.exponent, output * self.last)


@dataclass(frozen=True, eq=False)
class Motion:
    """One output over time during repeated bursts.

    Attributes
    ----------
    held : Held
        The bursts.
    hold : float
        Time between computed instants [s].
    cubic : (4, n_instants) array
        Coefficients, in ascending order, of a cubic between each computed instant (0) and the next (1).
    exponent, decay : (n_states,) complex array
        After the burst, the output is the real part of the sum of ``decay * exp(exponent * time)``, with time measured
        from the end of the burst.
    """

    held: Held
    hold: float
    cubic: FloatArray
    exponent: ComplexArray
    decay: ComplexArray

    def at(self, time: FloatArray) -> FloatArray:
        """Return the output at instants, (n_times,) array, as from `course`."""
        return np.asarray(self.course(time, 1)[0])

    def course(self, time: FloatArray, n_derivatives: int = 2) -> FloatArray:
        """Return the output and its time derivative at instants.

        Between computed instants the output is a cubic, with an error of 2e-5 of the contribution of the fastest mode;
        after the burst it is exact. The delay of samples to the next edge of the generator's clock, below its period of
        4 ns, is neglected.

        Parameters
        ----------
        time : (n_times,) array
            Instants, since the first sample of a burst reached the beam [s].
        n_derivatives : int
            1 for the output alone, 2 for both.

        Returns
        -------
        (n_derivatives, n_times) array
            The output, and its derivative [1/s].
        """
        since = self.held.within_period(time)
        result = np.empty((n_derivatives, time.size))
        for start in range(0, since.size, AT_ONCE):
            some, out = since[start : start + AT_ONCE], result[:, start : start + AT_ONCE]
            if some.min() >= 0 and some.max() < self.held.duration:
                self._during(some, out)
                continue
            out[:] = 0.0
            during, after = (some >= 0) & (some < self.held.duration), some >= self.held.duration
            played = np.empty((len(out), np.count_nonzero(during)))
            self._during(some[during], played)
            out[:, during] = played
            modes = np.stack([self.decay, self.decay * self.exponent][: len(out)], axis=1)
            out[:, after] = (np.exp(np.outer(some[after] - self.held.duration, self.exponent)) @ modes).real.T
        return result

    def _during(self, since: FloatArray, out: FloatArray) -> None:
        part = since / self.hold
        index = part.astype(np.intp)
        np.minimum(index, self.cubic.shape[1] - 1, out=index)
        part -= index
        zeroth, first, second, third = (row[index] for row in self.cubic)
        out[0] = zeroth + part * (first + part * (second + part * third))
        for slope in out[1:]:
            slope[:] = (first + part * (2 * second + 3 * part * third)) / self.hold


@dataclass(frozen=True, eq=False)
class DriveVoltage:
    """Output voltage of an amplifier on one channel during repeated bursts, exact at every instant.

    Attributes
    ----------
    held : Held
        The bursts.
    channel : int
        Row of the voltages.
    pole : float or None
        Pole of the amplifier [rad/s]; None for an amplifier without one.
    before : (n_samples + 1,) array
        Output at the start of each sample, and at the end of the burst, as the deviation from its value at rest [V].
    """

    held: Held
    channel: int
    pole: float | None
    before: FloatArray

    @classmethod
    def of(cls, held: Held, channel: int, bandwidth: float | None) -> Self:
        """Return the output of an amplifier with a bandwidth [Hz] for one row of voltages."""
        voltage = np.append(held.voltage[channel], 0.0)
        if bandwidth is None:
            return cls(held, channel, None, voltage)
        from scipy.signal import lfilter

        pole = 2 * np.pi * bandwidth
        faded = pole * held.hold
        before = lfilter([0.0, -math.expm1(-faded)], [1.0, -math.exp(-faded)], voltage)
        # The remainder of earlier bursts after their pause.
        left = before[-1] * math.exp(-pole * (held.period - held.duration)) / -math.expm1(-pole * held.period)
        return cls(held, channel, pole, before + left * np.exp(-faded * np.arange(voltage.size)))

    def at(self, time: FloatArray) -> FloatArray:
        """Return the voltage at instants since the first sample reached the beam [s], (n_times,) array [V]."""
        since, hold = self.held.within_period(time), self.held.hold
        target = np.append(self.held.voltage[self.channel], 0)
        index = np.clip((since / hold).astype(np.intp), 0, target.size - 1)
        voltage = target[index]
        if self.pole is not None:
            voltage += (self.before[index] - voltage) * np.exp(-self.pole * np.maximum(since - index * hold, 0.0))
        return np.asarray(np.where(since < 0, 0.0, voltage) + self.held.rest[self.channel])


def low_passed(
    system: DiagonalSystem, output: ComplexArray, bandwidth: float | None
) -> tuple[DiagonalSystem, ComplexArray]:
    """Return equations and output with a first-order low-pass, which adds one state for each channel.

    Beam and low-pass are linear, so their order is irrelevant: the low-pass is placed before the beam, like an
    amplifier, so that the equations are the same for every output. `bandwidth` is its corner frequency [Hz]; None for
    no low-pass.
    """
    if bandwidth is None:
        return system, output
    pole = 2 * np.pi * bandwidth
    if np.min(np.abs(pole + system.exponent)) < SAME_POLE * pole:
        # Equations with two equal poles cannot be uncoupled; shifting a pole by 1e-6 causes an error of 1e-6.
        pole *= 1 + SAME_POLE
    sensor = Amplifier(gain=1.0, limit=1.0, bandwidth=pole / (2 * np.pi), delay=system.delay)
    behind = DiagonalSystem.behind(sensor, system.exponent, system.input_gain, output[None], output[None])
    return behind, behind.velocity[0]


def start_state(system: DiagonalSystem, held: Held) -> ComplexArray:
    """Return the state at the beginning of a burst that follows many others, (n_states,) array."""
    if math.isinf(held.period):
        return np.zeros(system.exponent.size, dtype=complex)
    at_end = system.held_states(held.voltage, held.hold).sum(axis=0)
    silence = held.period - held.duration
    return np.asarray(at_end * np.exp(system.exponent * silence) / -np.expm1(system.exponent * held.period))


def state_at(system: DiagonalSystem, held: Held, instant: float, *, first: bool) -> ComplexArray:
    """Return the state at an instant since a trigger [s], on the generator's true clock, (n_states,) array.

    The instant is at most a period; the `first` burst starts from rest, others after many bursts.
    """
    played = min(instant, held.duration + system.delay)
    state = system.state_at(held.voltage, held.timing, played)
    state = state * np.exp(system.exponent * (instant - played))
    since = instant - system.delay
    if first or since < 0:
        return np.asarray(state)
    return np.asarray(state + np.exp(system.exponent * since) * start_state(system, held))


def lagging(voltage: FloatArray, share: float, limit: float) -> FloatArray:
    r"""Return the voltages for which an actuator without hysteresis would produce the same force.

    A share of the force follows play operators of equal weight, :math:`y_k = \max(v_k - r, \min(v_k + r, y_{k-1}))`
    (Prandtl and Ishlinskii; Visintin 1994, Differential Models of Hysteresis, sec. III.2). Their half-widths are evenly
    spaced, so that hysteresis loops grow with the square of the voltage, as in Rayleigh's law for piezoelectric
    ceramics (Damjanovic 1997, J. Appl. Phys. 82, 1788).

    Parameters
    ----------
    voltage : (n_channels, n_samples) array
        Voltages of repeated bursts, relative to rest [V].
    share : float
        Share of the force that lags [1].
    limit : float
        Limit of the amplifier [V].
    """
    result = (1 - share) * voltage
    for row, volts in zip(result, voltage, strict=True):
        turns = np.append(np.flatnonzero(np.diff(np.sign(np.diff(volts)))) + 1, volts.size - 1)
        # Between two turning points the voltage is monotonic, so the value at the first determines the rest.
        part = np.searchsorted(turns, np.arange(volts.size))
        for width in np.array(PLAYS) * limit:
            reached = 0.0
            for _ in range(2):  # the second burst begins where the first and every later one ends
                before = []
                for volt in volts[turns].tolist():
                    before.append(reached)
                    reached = max(volt - width, min(volt + width, reached))
            play = np.clip(np.array(before)[part], volts - width, volts + width)
            row += share / len(PLAYS) * (play - reached)
    return np.asarray(result)
