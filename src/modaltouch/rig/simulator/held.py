"""Sample-and-hold bursts of a generator: the resulting states of a beam, and the peaks of its outputs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.simulator.timeline import CONVERTER
from modaltouch.stimulus import BlockStates, Converter, DiagonalSystem, Timing

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

LARGEST_PHASE_STEP = 0.3
"""Phase of the fastest mode between computed instants [rad], for which the error of cubic interpolation is 2e-5."""

LONGEST_SILENCE = 10
"""Time over which a burst and its decay are followed, in durations of the burst [1]."""


@dataclass(frozen=True, eq=False)
class Held:
    """The held samples of single or repeated bursts, as voltages before the amplifier's pole.

    Attributes
    ----------
    voltage : (n_channels, n_samples) array
        Deviation from the voltage at rest [V].
    rest : (n_channels,) array
        Voltage at rest, between bursts [V].
    duration : float
        Duration of one burst [s].
    period : float
        Time from one burst to the next [s]; infinite for a single burst.
    delay : float
        Time from a trigger (at 0) to its burst [s].
    converter : Converter
        Converter of the generator.
    """

    voltage: FloatArray
    rest: FloatArray
    duration: float
    period: float
    delay: float = 0.0
    converter: Converter = CONVERTER

    @property
    def hold(self) -> float:
        """Duration of each sample [s]."""
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
        """Return times since the start of the latest burst [s]; times before a single burst stay negative."""
        if self.delay:
            time = time - self.delay
        if math.isinf(self.period):
            return time
        return time if time.min() >= 0 and time.max() < self.period else np.mod(time, self.period)


def start_state(system: DiagonalSystem, held: Held) -> ComplexArray:
    """Return the state at the beginning of a burst that follows many others, (n_states,) array."""
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
        The bursts.
    instant : float
        Time since a trigger, at most a period [s].
    first : bool
        Whether the burst starts from rest rather than after many bursts.
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
    """Return the largest magnitudes of outputs during one burst from rest and the pause after it, (n_outputs,) array.

    Parameters
    ----------
    system : DiagonalSystem
        The beam behind its amplifier.
    output : (n_outputs, n_states) complex array
        Output matrix; the outputs are the real part of its product with the states.
    held : Held
        The bursts.
    """
    voltage, _ = refined(system, held)
    n_samples = voltage.shape[1]
    finer = replace(held.converter, any_rate=True, max_points=n_samples)
    timing = replace(held.timing, converter=finer, n_samples=n_samples)
    return BlockStates.of(system, voltage, timing).peak(output)


def refined(system: DiagonalSystem, held: Held) -> tuple[FloatArray, float]:
    """Return the voltages on a grid in which no mode advances by more than LARGEST_PHASE_STEP, and its step [s]."""
    times = max(1, math.ceil(float(np.abs(system.exponent.imag).max()) * held.hold / LARGEST_PHASE_STEP))
    return held.voltage if times == 1 else np.repeat(held.voltage, times, axis=1), held.hold / times
