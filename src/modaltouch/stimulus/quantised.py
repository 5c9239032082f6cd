"""Codes as the generator plays them: the resulting motion, and code changes that cancel rounding errors at the focus.

Rounding leaves an error in the states at the focusing instant. The choice of codes to change to cancel it is a lattice
problem: small integer steps whose effects add up to the error. It is solved backwards in time. The effect of one code
on a fast mode is large just before the focusing instant and decays towards earlier times. Samples are therefore visited
from the focusing instant backwards, and a code is changed if that reduces the error, with the error of each mode
relative to the effect that the remaining codes can still have on it. Each error thus shrinks together with that effect.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.stimulus.burst import Timing
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantities import ComplexArray, FloatArray
from modaltouch.stimulus.synthesis import decay
from modaltouch.stimulus.vibration import BlockStates

GOAL = 3e-8
"""Error, relative to the largest target, below which a mode needs no further reduction [1]."""

_VISITS = (300, 600, 1000, 2000)
"""Numbers of samples visited on each channel, tried in turn until the error is small enough."""

_SETTLED = 3e-7
"""Error, relative to the largest target, at which no more samples are visited [1]."""

_TOGETHER = 64
"""Number of moves per batch of mutual effects."""


@dataclass(frozen=True, eq=False)
class QuantisedStimulus:
    """The codes of a burst played on the beam of the design.

    Results proportional to the level are computed once.
    """

    model: ModalModel  # the beam, with its fingers if any
    amplifier: Amplifier  # its pole and delay are used
    timing: Timing
    codes: FloatArray  # (n_channels, n_samples): codes relative to mid-scale [1]
    # States already computed, and peaks by position or finger, for each ratio of the channels.
    _responses: dict[tuple[float, ...], tuple[BlockStates, dict[Any, float]]] = field(default_factory=dict, init=False)

    @cached_property
    def system(self) -> DiagonalSystem:
        """The beam behind the amplifier."""
        return DiagonalSystem.of(self.model, self.amplifier)

    @cached_property
    def highest(self) -> FloatArray:
        """Largest magnitude of each channel's codes, (n_channels,) array [1]."""
        return np.asarray(np.abs(self.codes).max(axis=1))

    @cached_property
    def _states_per_volt(self) -> ComplexArray:
        """States at the focusing instant for codes of 1 V each, (n_channels, n_states) array."""
        return self.system.states_by_channel(self.codes, self.timing, self.timing.focusing_instant)

    @cached_property
    def _left_per_volt(self) -> ComplexArray:
        """States when the end of the burst reaches the beam, for codes of 1 V each, (n_channels, n_states) array."""
        return self.system.states_by_channel(self.codes, self.timing, self.timing.duration + self.system.delay)

    def states_at_focus(self, unit: FloatArray) -> ComplexArray:
        """Return the states at the focusing instant of the first burst for codes of `unit` volts, (n_states,) array."""
        return np.asarray(unit @ self._states_per_volt)

    def states_steady(self, unit: FloatArray) -> ComplexArray:
        """Return the states at the focusing instant in the steady state of the repeated burst, (n_states,) array."""
        timing, exponent = self.timing, self.system.exponent
        end = timing.duration + self.system.delay
        left = unit @ self._left_per_volt
        period = 1 / timing.repetition_rate
        carried = np.exp(exponent * (period - end + timing.focusing_instant)) / -np.expm1(exponent * period)
        return np.asarray(self.states_at_focus(unit) + left * carried)

    def _response(self, unit: FloatArray) -> tuple[BlockStates, dict[Any, float], float]:
        """Return the states, the known peaks, and the factor [V per code] that applies to both.

        Levels with the same ratio of the channels share one response.
        """
        largest = float(unit.max()) or 1.0
        ratio = tuple(round(float(u), 12) for u in unit / largest)
        if ratio not in self._responses:
            # Gains include the volts per code, so that no array of voltages is needed.
            gain = self.system.input_gain * (unit / largest)
            self._responses[ratio] = BlockStates.of(replace(self.system, input_gain=gain), self.codes, self.timing), {}
        return *self._responses[ratio], largest

    def velocity_at_focus(self, positions: ArrayLike, unit: FloatArray) -> FloatArray:
        """Return the velocity at points of the beam at the focusing instant, (n_positions,) array [m/s].

        `positions` are from mid-beam [m]; `unit` is the voltage of one code at the beam, (n_channels,) array [V].
        """
        return self.model.field(self.system.read(self.states_at_focus(unit))[0], positions)

    def peak_velocity(self, positions: ArrayLike, unit: FloatArray) -> FloatArray:
        """Return the highest speed at points of the beam until the next burst, (n_positions,) array [m/s]."""
        place = np.atleast_1d(np.asarray(positions, dtype=float)).tolist()
        response, known, scale = self._response(unit)
        if not all(point in known for point in place):
            output = self.model.shapes(place).T @ self.system.velocity
            known.update(zip(place, response.peak(output).tolist(), strict=True))
        return np.array([known[point] for point in place]) * scale


def settle(
    codes: FloatArray,
    volts_per_code: FloatArray,
    system: DiagonalSystem,
    timing: Timing,
    error: FloatArray,
    largest: float,
) -> FloatArray:
    """Change codes by at most one so that almost no rounding error remains at the focusing instant; return them [1].

    The array is changed in place, and only if that reduces the error: target minus value reached, modal velocities,
    then displacements times angular frequency, (2 n_modes,) array [m/s]. `volts_per_code` is at the beam, (n_channels,)
    array [V], 0 for a silent channel; `largest` is the largest modal target [m/s].
    """
    best: _Walk | None = None
    changes, smallest = np.zeros(0), float(np.abs(error).max())
    for n_visits in _VISITS:
        if smallest <= _SETTLED * largest:
            break
        walk = _Walk(codes, volts_per_code, system, timing, largest * GOAL, n_visits)
        tried, left = walk.settle(error)
        if left < smallest:
            best, changes, smallest = walk, tried, left
    if best is not None:
        codes[best.channel, best.sample] += changes
    return codes


class _Walk:
    """Samples visited backwards from the focusing instant, and the effect of one code of each on the modes."""

    def __init__(
        self,
        codes: FloatArray,
        volts_per_code: FloatArray,
        system: DiagonalSystem,
        timing: Timing,
        goal: float,
        n_visits: int,
    ) -> None:
        n_before, remainder = timing.samples_until(timing.focusing_instant - system.delay)
        effect = system.held_gain(timing.hold) * volts_per_code * np.exp(system.exponent * remainder)[:, None]
        read = np.concatenate([system.velocity, system.displacement])
        step = np.abs(effect[: system.n_beam]).max(axis=1)
        rate = -system.exponent.real[: system.n_beam] * timing.hold
        urgent = step > goal
        with np.errstate(over="ignore", divide="ignore"):
            # An almost undamped mode responds to every sample.
            span = np.max(np.log(step[urgent] / goal) / rate[urgent], initial=float(n_visits))
        span = max(2, int(min(span, n_before - 2)))
        # Rounding down creates duplicates, which are dropped; the first sample keeps its code.
        ago = np.geomspace(1, span, n_visits).astype(np.int64)
        ago = ago[np.diff(ago, prepend=0) > 0]
        ago = ago[ago < n_before]
        faded = decay(system.exponent, timing.hold, ago)
        channels = np.flatnonzero(volts_per_code)
        move = np.empty((ago.size, channels.size, read.shape[0]))
        for place, channel in enumerate(channels.tolist()):
            move[:, place] = (read @ (_on_clock(effect[:, channel], system, timing, n_before - 1 - ago) * faded)).real.T
        reach = np.maximum(step * np.exp(-rate * ago[:, None]), goal)
        self.codes = codes
        self.highest = timing.converter.mid_code
        self.channel = np.tile(channels, ago.size)
        self.sample = np.repeat(n_before - 1 - ago, channels.size)
        self.move = move.reshape(-1, read.shape[0])
        if system.coupled:
            self.pull = _pull_of_coupled(self.move, goal)
        else:
            by_mode = move.reshape(ago.size, channels.size, 2, -1) / (reach**2)[:, None, None]
            self.pull = by_mode.reshape(self.move.shape)
        self.half = 0.5 * np.einsum("ij,ij->i", self.move, self.pull)

    def settle(self, error: FloatArray) -> tuple[FloatArray, float]:
        """Return the change of each visited code, and the largest remaining error [m/s]."""
        left = error.copy()
        change = np.zeros(self.half.size)
        at_limit = np.abs(self.codes[self.channel, self.sample]) >= self.highest
        half = np.where(at_limit, np.inf, self.half)
        for start in range(0, half.size, _TOGETHER):
            some = slice(start, start + _TOGETHER)
            move, pull = self.move[some], self.pull[some]
            change[some] = _changes(pull @ left, move @ pull.T, half[some].tolist())
            left -= change[some] @ move
        return change, float(np.abs(left).max())


def _pull_of_coupled(move: FloatArray, goal: float) -> FloatArray:
    """Return moves, each weighted by the combined effect of itself and the remaining moves on the modes."""
    pull, left = np.empty_like(move), goal**2 * np.eye(move.shape[1])
    for start in reversed(range(0, len(move), _TOGETHER)):
        some = slice(start, start + _TOGETHER)
        left = left + move[some].T @ move[some]
        pull[some] = np.linalg.solve(left, move[some].T).T
    return pull


def _changes(gain: FloatArray, together: FloatArray, half: list[float]) -> list[float]:
    """Choose code changes of -1, 0 or 1, one after the other, to reduce the error."""
    changes = [0.0] * len(half)
    for i, least in enumerate(half):
        now = gain.item(i)
        if now > least:
            changes[i] = 1.0
            gain -= together[i]
        elif now < -least:
            changes[i] = -1.0
            gain += together[i]
    return changes


def _on_clock(effect: ComplexArray, system: DiagonalSystem, timing: Timing, sample: NDArray[np.int64]) -> ComplexArray:
    """Return the effect of a code held for its true duration on the clock, (n_states, n or 1) array."""
    if timing.clock_error is None:
        return effect[:, None]
    s = system.exponent[:, None]
    late, next_late = timing.clock_error[sample], timing.clock_error[sample + 1]
    grown = np.exp(s * timing.hold)
    return np.asarray(effect[:, None] * (1 + (grown * np.expm1(-s * late) - np.expm1(-s * next_late)) / (grown - 1)))
