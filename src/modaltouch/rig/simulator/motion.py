"""Velocity and voltage over time, at whatever instants an instrument samples them, while bursts repeat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.simulator.held import Held, refined, start_state
from modaltouch.stimulus import BlockKernel, DiagonalSystem

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

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
