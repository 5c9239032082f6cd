"""Velocity and voltage over time, at whatever instants an instrument samples them, while bursts repeat."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.simulator.held import ComplexArray, FloatArray, Held, refined, start_state
from modaltouch.stimulus import Amplifier, BlockKernel, DiagonalSystem

SAME_POLE = 1e-6
"""Relative distance below which two poles count as one [1]."""

AT_ONCE = 8192
"""Instants computed together: bounds the memory, and keeps what is computed in the cache."""

SPARE = 64
"""Computed instants beyond the last that is asked for: records of another jitter find theirs [1]."""


@dataclass(frozen=True, eq=False)
class StateHistory:
    """States of a beam while bursts repeat, from which the motion of every point is read.

    Attributes
    ----------
    system : DiagonalSystem
        The beam behind its amplifier.
    held : Held
        What is played.
    hold : float
        Time between computed instants [s].
    voltage : (n_channels, n_instants) array
        As played, at the computed instants [V].
    begin : (n_states, n_blocks) complex array
        States before each block of instants.
    last : (n_states,) complex array
        State at the end of a burst.
    end : float
        Up to when it is computed, from the first sample of a burst at the beam [s]; infinite for a whole burst.
    """

    system: DiagonalSystem
    held: Held
    hold: float
    voltage: FloatArray
    begin: ComplexArray
    last: ComplexArray
    end: float

    @classmethod
    def of(cls, system: DiagonalSystem, held: Held, span: tuple[float, float]) -> Self:
        """Return the states among bursts that have repeated for long.

        Parameters
        ----------
        system : DiagonalSystem
            The beam behind its amplifier.
        held : Held
            What is played.
        span : (float, float)
            First and last instant that will be asked for, from the first sample of a burst at the beam [s].
        """
        voltage, hold = refined(system, held)
        n_instants, end = voltage.shape[1], math.inf
        # What lies before a burst, or after its period, is the end of another.
        if span[0] >= held.delay and span[1] < held.delay + held.period:
            n_needed = int((span[1] - held.delay) / hold) + 2 + SPARE
            if n_needed < n_instants:
                n_instants, end = n_needed, held.delay + (n_needed - 2) * hold
        state = start_state(system, held)
        kernel = BlockKernel.of(system, np.empty((0, state.size), dtype=complex), hold)
        # One sample more than is played, so that the last instant is the end of the burst.
        voltage = np.pad(voltage[:, :n_instants], ((0, 0), (0, 1)))
        begin, _ = kernel.states(BlockKernel.blocks(voltage), state)
        last = system.held_states(held.voltage, held.hold).sum(axis=0) + state * np.exp(system.exponent * held.duration)
        return cls(system, held, hold, voltage, begin, last, end)

    def covers(self, span: tuple[float, float]) -> bool:
        """Return whether every instant of a span is computed."""
        return math.isinf(self.end) or (span[0] >= self.held.delay and span[1] < self.end)

    def motion(self, output: ComplexArray) -> Motion:
        """Return an output that is the real part of ``output @ state``; `output` is an (n_states,) complex array."""
        system = self.system
        kernel = BlockKernel.of(system, np.stack([output, output * system.exponent]), self.hold)
        course = np.empty((2, self.voltage.shape[1]))
        kernel.respond(BlockKernel.blocks(self.voltage), self.begin, course)
        value, slope = course[0], course[1] * self.hold
        # The voltage adds its own part to the slope at once, from each instant until the next.
        push = (output @ system.input_gain).real @ self.voltage[:, :-1] * self.hold
        step = np.diff(value)
        from_left, from_right = slope[:-1] + push - step, step - (slope[1:] + push)
        cubic = np.stack([value[:-1], step + from_left, from_right - 2 * from_left, from_left - from_right])
        return Motion(self.held, self.hold, cubic, system.exponent, output * self.last)


@dataclass(frozen=True, eq=False)
class Motion:
    """One output over time while bursts repeat.

    Attributes
    ----------
    held : Held
        What is played.
    hold : float
        Time between computed instants [s].
    cubic : (4, n_instants) array
        Coefficients, from the constant on, of the output from each computed instant (0) to the next (1).
    exponent, decay : (n_states,) complex array
        After the burst the output is the real part of the sum of ``decay * exp(exponent * time)``.
    """

    held: Held
    hold: float
    cubic: FloatArray
    exponent: ComplexArray
    decay: ComplexArray

    def at(self, time: FloatArray) -> FloatArray:
        """Return the output at instants, (n_times,) array, as `course` gives it."""
        return np.asarray(self.course(time, 1)[0])

    def course(self, time: FloatArray, n_derivatives: int = 2) -> FloatArray:
        """Return output and slope at instants since the first sample of a burst reached the beam.

        Between computed instants it is a cubic, wrong by 2e-5 of the fastest mode's part; after the burst it is exact.
        A clock that begins samples late, by less than its own 4 ns, is not followed.

        Parameters
        ----------
        time : (n_times,) array
            Instants [s].
        n_derivatives : int
            1 for the output alone.

        Returns
        -------
        (n_derivatives, n_times) array
            The output, and its slope over time [1/s].
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
        from scipy.signal import lfilter

        pole = 2 * np.pi * bandwidth
        faded = pole * held.hold
        before = lfilter([0.0, -math.expm1(-faded)], [1.0, -math.exp(-faded)], voltage)
        # What the bursts before have left, after their pause.
        left = before[-1] * math.exp(-pole * (held.period - held.duration)) / -math.expm1(-pole * held.period)
        return cls(held, channel, pole, before + left * np.exp(-faded * np.arange(voltage.size)))

    def at(self, time: FloatArray) -> FloatArray:
        """Return the voltage at instants since the first sample of a burst reached the beam [V].

        Parameters
        ----------
        time : (n_times,) array
            Instants [s].
        """
        since, index, left = self._places(time)
        target, change = self._parts(index, left)
        return np.asarray(np.where(since < 0, 0.0, target + change) + self.held.rest[self.channel])

    def sampled(self, time: FloatArray) -> SampledDrive:
        """Return the voltage at instants since the first sample of a burst reached the beam, (n_times,) array [s]."""
        since, index, left = self._places(time)
        target, change = self._parts(index, left)
        target += self.held.rest[self.channel]
        room = np.where(index < self.held.voltage.shape[1], self.held.hold - left, np.inf)
        for other in (left, since, self.held.period - since):
            np.minimum(room, other, out=room)
        return SampledDrive(self, time, target, change, room)

    def _places(self, time: FloatArray) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
        """Return times since the latest burst began, the sample held then, and for how long it is [s, 1, s]."""
        since = self.held.within_period(time)
        index = np.clip((since / self.held.hold).astype(np.intp), 0, self.held.voltage.shape[1])
        return since, index, np.maximum(since - index * self.held.hold, 0.0)

    def _parts(self, index: NDArray[np.intp], left: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what the amplifier tends to, as a change from rest, and what it still has to go [V]."""
        target = np.append(self.held.voltage[self.channel], 0.0)[index]
        if self.pole is None:
            return target, np.zeros(target.size)
        return target, (self.before[index] - target) * np.exp(-self.pole * left)


@dataclass(frozen=True, eq=False)
class SampledDrive:
    """The voltage of one channel at the instants of a scope, which its trigger moves a little.

    Attributes
    ----------
    drive : DriveVoltage
        At every instant.
    time : (n_times,) array
        Instants since the first sample of a burst reached the beam [s].
    target, change : (n_times,) array
        What the amplifier tends to there, and what it still has to go [V].
    room : (n_times,) array
        How far each instant may move before it is in another sample, or another burst [s].
    """

    drive: DriveVoltage
    time: FloatArray
    target: FloatArray
    change: FloatArray
    room: FloatArray

    def moved(self, shifts: FloatArray) -> Iterator[FloatArray]:
        """Yield the voltage moved by each shift [s] in turn [V], each in an array of its own."""
        anew = np.flatnonzero(self.room <= np.abs(shifts).max())
        for shift in shifts:
            voltage = self.change * (1.0 if self.drive.pole is None else math.exp(-self.drive.pole * shift))
            voltage += self.target
            if anew.size:
                voltage[anew] = self.drive.at(self.time[anew] + shift)
            yield voltage


def low_passed(
    system: DiagonalSystem, output: ComplexArray, bandwidth: float | None
) -> tuple[DiagonalSystem, ComplexArray]:
    """Return equations and output behind a first-order low-pass, which is a state more for each channel.

    Beam and low-pass are linear, so that their order does not matter: the low-pass is put where an amplifier is. The
    equations are so the same for every output.

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
    sensor = Amplifier(gain=1.0, limit=1.0, bandwidth=pole / (2 * np.pi), delay=system.delay)
    behind = DiagonalSystem.behind(sensor, system.exponent, system.input_gain, output[None], output[None])
    return behind, behind.velocity[0]
