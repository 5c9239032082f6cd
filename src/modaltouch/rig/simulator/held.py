"""Samples that a generator holds, burst after burst: the states they bring a beam to, and the peaks of its outputs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.simulator.timeline import CONVERTER
from modaltouch.stimulus import BlockStates, Converter, DiagonalSystem, Timing

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
    converter : Converter
        Of the generator that holds them.
    """

    voltage: FloatArray
    rest: FloatArray
    duration: float
    period: float
    delay: float = 0.0
    converter: Converter = CONVERTER

    @property
    def hold(self) -> float:
        """How long each sample is held [s]."""
        return self.duration / int(self.voltage.shape[1])

    @property
    def timing(self) -> Timing:
        """Clock of one burst."""
        return Timing(
            self.converter,
            n_samples=self.voltage.shape[1],
            duration=self.duration,
            focusing_instant=self.duration / 2,
            repetition_rate=1 / min(self.period, LONGEST_SILENCE * self.duration),
        )

    def within_period(self, time: FloatArray) -> FloatArray:
        """Return times since the latest burst began [s]; those before a single burst stay negative."""
        if self.delay:
            time = time - self.delay
        if math.isinf(self.period):
            return time
        first, last = time.min(), time.max()
        if first >= 0 and last < self.period:
            return time
        if first < -self.period or last >= 2 * self.period:
            return np.mod(time, self.period)
        since = np.where(time < 0, time + self.period, time)
        np.subtract(since, self.period, out=since, where=since >= self.period)
        return since


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
    voltage, _ = refined(system, held)
    n_samples = voltage.shape[1]
    finer = replace(held.converter, any_rate=True, max_points=n_samples)
    timing = replace(held.timing, converter=finer, n_samples=n_samples)
    return BlockStates.of(system, voltage, timing).peak(output)


def refined(system: DiagonalSystem, held: Held) -> tuple[FloatArray, float]:
    """Return the same voltages on a grid on which no mode turns by more than FINEST_TURN, and its step."""
    times = max(1, math.ceil(float(np.abs(system.exponent.imag).max()) * held.hold / FINEST_TURN))
    return held.voltage if times == 1 else np.repeat(held.voltage, times, axis=1), held.hold / times
