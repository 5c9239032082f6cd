"""Velocity and voltage over time, at whatever instants an instrument samples them, while bursts repeat."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.simulator.timeline import CONVERTER
from modaltouch.stimulus import BlockKernel, DiagonalSystem, Timing

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

FINEST_TURN = 0.3
"""Phase of the fastest mode from one computed instant to the next [rad]: cubics between them err by 2e-5."""

LONGEST_SILENCE = 10
"""Durations of a burst for which a decay is followed."""


@dataclass(frozen=True, eq=False)
class Held:
    """Samples that a generator holds, once or again and again, as volts before the amplifier's pole.

    Attributes
    ----------
    voltage : (n_channels, n_samples) array
        As a change from the level of rest [V].
    rest : (n_channels,) array
        Level between bursts [V].
    duration : float
        Of one burst [s].
    period : float
        From one burst to the next [s]; infinite for a single burst.
    delay : float
        From a trigger, where time begins, to its burst [s].
    """

    voltage: FloatArray
    rest: FloatArray
    duration: float
    period: float
    delay: float = 0.0

    @property
    def hold(self) -> float:
        """How long each sample is held [s]."""
        return self.duration / int(self.voltage.shape[1])

    @property
    def timing(self) -> Timing:
        """Clock of one burst."""
        return Timing(
            CONVERTER,
            n_samples=self.voltage.shape[1],
            duration=self.duration,
            focusing_instant=self.duration / 2,
            repetition_rate=1 / min(self.period, LONGEST_SILENCE * self.duration),
        )

    def within_period(self, time: FloatArray) -> FloatArray:
        """Return times since the latest burst began [s]; those before a single burst stay negative."""
        if self.delay:
            time = time - self.delay
        if math.isinf(self.period) or (time.min() >= 0 and time.max() < self.period):
            return time
        return np.mod(time, self.period)


def start_state(system: DiagonalSystem, held: Held) -> ComplexArray:
    """Return the state in which each burst finds the beam, after many, (n_states,) array."""
    if math.isinf(held.period):
        return np.zeros(system.exponent.size, dtype=complex)
    at_end = system.held_states(held.voltage, held.hold).sum(axis=0)
    silence = held.period - held.duration
    return np.asarray(at_end * np.exp(system.exponent * silence) / -np.expm1(system.exponent * held.period))


def state_at(system: DiagonalSystem, held: Held, instant: float, *, first: bool) -> ComplexArray:
    """Return the state at an instant of a burst, on the generator's true clock, (n_states,) array.

    Parameters
    ----------
    system : DiagonalSystem
        The beam behind its amplifier.
    held : Held
        What is played.
    instant : float
        From a trigger, at most a period [s].
    first : bool
        Whether it is the first burst, from rest, or one after many.
    """
    instant -= held.delay
    if instant < 0:
        if first or math.isinf(held.period):
            return np.zeros(system.exponent.size, dtype=complex)
        instant += held.period
    played = min(instant, held.duration + system.delay)
    state = system.state_at(held.voltage, held.timing, played)
    state = state * np.exp(system.exponent * (instant - played))
    since = instant - system.delay
    if first or since < 0:
        return np.asarray(state)
    return np.asarray(state + np.exp(system.exponent * since) * start_state(system, held))


def peak(system: DiagonalSystem, output: ComplexArray, held: Held) -> FloatArray:
    """Return the largest magnitudes of outputs from rest until the next burst, (n_outputs,) array.

    Parameters
    ----------
    system : DiagonalSystem
        The beam behind its amplifier.
    output : (n_outputs, n_states) complex array
        What is read off the states, as its real part.
    held : Held
        What is played.
    """
    voltage, hold = refined(system, held)
    kernel = BlockKernel.of(system, output, hold)
    reached = np.zeros(output.shape[0])
    state = np.zeros(system.exponent.size, dtype=complex)
    silence = min(held.period, LONGEST_SILENCE * held.duration) - held.duration
    n_silent = max(0, int(silence / hold) // BlockKernel.BLOCK_LENGTH * BlockKernel.BLOCK_LENGTH)
    for part in (voltage, np.zeros((voltage.shape[0], n_silent))):
        if part.size == 0 or (part is not voltage and (np.abs(output * state).sum(axis=1) <= reached).all()):
            break
        blocks = BlockKernel.blocks(part)
        begin, state = kernel.states(blocks, state)
        bounds = kernel.bounds(blocks, begin)
        for place, bound in enumerate(bounds):
            reached[place] = kernel.peak(place, blocks, begin, bound, float(reached[place]))
    return reached


def refined(system: DiagonalSystem, held: Held) -> tuple[FloatArray, float]:
    """Return the same voltages on a grid on which no mode turns by more than FINEST_TURN, and its step."""
    times = max(1, math.ceil(float(np.abs(system.exponent.imag).max()) * held.hold / FINEST_TURN))
    return held.voltage if times == 1 else np.repeat(held.voltage, times, axis=1), held.hold / times


SAME_POLE = 1e-6
"""Relative distance below which two poles count as one [1]."""

DECAYED_AT_ONCE = 8192
"""Instants of a decay computed together: bounds the memory."""


@dataclass(frozen=True, eq=False)
class Motion:
    """One output over time while bursts repeat.

    Attributes
    ----------
    held : Held
        What is played.
    hold : float
        Time between computed instants [s].
    value : (n_instants,) array
        Output at the computed instants of a burst.
    slope : (n_instants,) array
        Its slope there, but for the part that the voltage adds at once [1/s].
    push : (n_instants - 1,) array
        That part, after each instant until the next [1/s].
    exponent, decay : (n_states,) complex array
        After the burst the output is the real part of the sum of ``decay * exp(exponent * time)``.
    """

    held: Held
    hold: float
    value: FloatArray
    slope: FloatArray
    push: FloatArray
    exponent: ComplexArray
    decay: ComplexArray

    @classmethod
    def of(cls, system: DiagonalSystem, output: ComplexArray, held: Held, span: tuple[float, float]) -> Self:
        """Return an output that is the real part of ``output @ state``, among bursts that have repeated for long.

        Parameters
        ----------
        system : DiagonalSystem
            The beam behind its amplifier.
        output : (n_states,) complex array
            What is read off the states.
        held : Held
            What is played.
        span : (float, float)
            First and last instant that will be asked for, from the first sample of a burst at the beam [s].
        """
        voltage, hold = refined(system, held)
        span = span[0] - held.delay, span[1] - held.delay
        # What lies before a burst, or after its period, is the end of another.
        within = span[0] >= 0 and span[1] < held.period
        n_needed = min(voltage.shape[1], int(span[1] / hold) + 2) if within else voltage.shape[1]
        state = start_state(system, held)
        rows = np.stack([output, output * system.exponent])
        kernel = BlockKernel.of(system, rows, hold)
        # One sample more than is played, so that the last instant is the end of the burst.
        blocks = BlockKernel.blocks(np.pad(voltage[:, :n_needed], ((0, 0), (0, 1))))
        begin, _ = kernel.states(blocks, state)
        course = np.empty((2, n_needed + 1))
        kernel.respond(blocks, begin, course)
        at_end = system.held_states(held.voltage, held.hold)
        last = at_end.sum(axis=0) + state * np.exp(system.exponent * held.duration)
        push = (output @ system.input_gain).real @ voltage[:, :n_needed]
        return cls(held, hold, course[0], course[1], push, system.exponent, output * last)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the output at instants since the first sample of a burst reached the beam.

        Between computed instants it is a cubic, wrong by 2e-5 of the fastest mode's part; after the burst it is exact.
        A clock that begins samples late, by less than its own 4 ns, is not followed.

        Parameters
        ----------
        time : (n_times,) array
            Instants [s].
        """
        since = self.held.within_period(time)
        if since.min() >= 0 and since.max() < self.held.duration:
            return self._during(since)
        result = np.zeros(time.size)
        during = (since >= 0) & (since < self.held.duration)
        result[during] = self._during(since[during])
        after = np.flatnonzero(since >= self.held.duration)
        for start in range(0, after.size, DECAYED_AT_ONCE):
            some = after[start : start + DECAYED_AT_ONCE]
            result[some] = (np.exp(np.outer(since[some] - self.held.duration, self.exponent)) @ self.decay).real
        return result

    def _during(self, since: FloatArray) -> FloatArray:
        place = since / self.hold
        index = np.minimum(place.astype(np.intp), self.push.size - 1)
        part = place - index
        left, push = self.value[index], self.push[index]
        step = self.value[index + 1] - left
        from_left = (self.slope[index] + push) * self.hold - step
        from_right = step - (self.slope[index + 1] + push) * self.hold
        return np.asarray(left + part * (step + (1 - part) * (from_left * (1 - part) + from_right * part)))


@dataclass(frozen=True, eq=False)
class DriveVoltage:
    """The voltage that an amplifier gives to one channel while bursts repeat, exact at every instant.

    Attributes
    ----------
    held : Held
        What is played.
    channel : int
        Row of its voltages.
    pole : float or None
        Of the amplifier [rad/s]; None for one that follows at once.
    before : (n_samples + 1,) array
        Output at the start of each sample, and at the end of the burst, as a change from its rest [V].
    """

    held: Held
    channel: int
    pole: float | None
    before: FloatArray

    @classmethod
    def of(cls, held: Held, channel: int, bandwidth: float | None) -> Self:
        """Return the output of an amplifier of a bandwidth [Hz] for one row of voltages."""
        voltage = np.append(held.voltage[channel], 0.0)
        if bandwidth is None:
            return cls(held, channel, None, voltage)
        pole = 2 * np.pi * bandwidth
        exponent = np.array([-pole], dtype=complex)
        one = np.ones((1, 1), dtype=complex)
        system = DiagonalSystem(exponent, np.asarray(pole * one), one, one, 0.0)
        kernel = BlockKernel.of(system, one, held.hold)
        alone = Held(held.voltage[channel : channel + 1], held.rest[:1], held.duration, held.period)
        blocks = BlockKernel.blocks(voltage[None])
        begin, _ = kernel.states(blocks, start_state(system, alone))
        before = np.empty((1, voltage.size))
        kernel.respond(blocks, begin, before)
        return cls(held, channel, pole, before[0])

    def at(self, time: FloatArray) -> FloatArray:
        """Return the voltage at instants since the first sample of a burst reached the beam [V].

        Parameters
        ----------
        time : (n_times,) array
            Instants [s].
        """
        since, row = self.held.within_period(time), self.held.voltage[self.channel]
        index = np.clip((since / self.held.hold).astype(np.intp), 0, row.size)
        target = np.append(row, 0.0)[index]
        if self.pole is not None:
            left = np.maximum(since - index * self.held.hold, 0.0)
            target = target + (self.before[index] - target) * np.exp(-self.pole * left)
        return np.asarray(np.where(since < 0, 0.0, target) + self.held.rest[self.channel])


def low_passed(
    system: DiagonalSystem, output: ComplexArray, bandwidth: float | None
) -> tuple[DiagonalSystem, ComplexArray]:
    r"""Return equations and output behind a first-order low-pass, which is one state more.

    The state :math:`w = y - Re(\sum_j c_j x_j)` with :math:`c_j = r_j p/(p + s_j)` for an output r.x obeys an equation
    of its own, :math:`\dot w = -p w - Re(c B) v`.

    Parameters
    ----------
    system : DiagonalSystem
        The equations.
    output : (n_states,) complex array
        What is read off their states, as its real part.
    bandwidth : float or None
        Corner of the low-pass [Hz]; None for none.
    """
    if bandwidth is None:
        return system, output
    pole = 2 * np.pi * bandwidth
    if np.min(np.abs(pole + system.exponent)) < SAME_POLE * pole:
        # Two equal poles have no uncoupled form; a millionth apart they differ from it by a millionth.
        pole *= 1 + SAME_POLE
    passed = output * pole / (pole + system.exponent)
    none = np.zeros((system.n_modes, 1))
    behind = DiagonalSystem(
        exponent=np.append(system.exponent, -pole),
        input_gain=np.concatenate([system.input_gain, -(passed @ system.input_gain).real[None]]),
        velocity=np.concatenate([system.velocity, none], axis=1),
        displacement=np.concatenate([system.displacement, none], axis=1),
        delay=system.delay,
    )
    return behind, np.append(passed, 1.0)
