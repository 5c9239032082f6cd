"""Single-code changes that take the error of rounding out of the states at the focusing instant.

Which codes to change is a lattice problem: small integer steps whose effects add up to what rounding left over. It is
solved backwards in time. One code moves a fast mode by much just before the focus and by ever less before that, so
samples are visited from the focus back, and a code is changed wherever that lessens the error, each mode's error
counted in what a code can still do to it. The error of every mode then shrinks with the steps that are left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.burst import MID_CODE
from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.synthesis import decay
from modaltouch.stimulus.timing import Timing

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

GOAL = 3e-8
"""Error, as a fraction of the largest target, below which a mode is no longer urgent [1]."""

_VISITS = (300, 600, 1000, 2000)
"""Samples visited on each channel; more only where fewer do not settle it."""

_SETTLED = 3e-7
"""Error, as a fraction of the largest target, at which no more samples are visited [1]."""

_TOGETHER = 64
"""Moves whose effects on each other are computed at once."""


def settle(
    codes: FloatArray,
    volts_per_code: FloatArray,
    system: DiagonalSystem,
    timing: Timing,
    error: FloatArray,
    largest: float,
) -> FloatArray:
    """Return codes, each changed by one at most, that leave next to no error of rounding at the focusing instant [1].

    The codes given are changed in place where that is better: they are those returned.

    Parameters
    ----------
    codes : (n_channels, n_samples) array
        Rounded codes, -8191 to 8191 [1].
    volts_per_code : (n_channels,) array
        At the beam [V]; 0 for a silent channel.
    system : DiagonalSystem
        The beam behind its amplifier.
    timing : Timing
        Clock of the samples.
    error : (2 n_modes,) array
        Modal velocities, then displacements times angular frequency, that the codes leave over, wished less
        reached [m/s].
    largest : float
        Largest modal target [m/s].
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
    """Samples visited from the focusing instant back, with what one code of theirs does to the modes."""

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
        step = np.abs(effect[: system.n_modes]).max(axis=1)
        rate = -system.exponent.real[: system.n_modes] * timing.hold
        urgent = step > goal
        with np.errstate(over="ignore", divide="ignore"):
            # A mode that hardly decays feels every sample.
            span = np.max(np.log(step[urgent] / goal) / rate[urgent], initial=float(n_visits))
        span = max(2, int(min(span, n_before - 2)))
        # Equal neighbours after rounding down are dropped; the first sample keeps its code.
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
        self.channel = np.tile(channels, ago.size)
        self.sample = np.repeat(n_before - 1 - ago, channels.size)
        self.move = move.reshape(-1, read.shape[0])
        self.pull = (move.reshape(ago.size, channels.size, 2, -1) / (reach**2)[:, None, None]).reshape(self.move.shape)
        self.half = 0.5 * np.einsum("ij,ij->i", self.move, self.pull)

    def settle(self, error: FloatArray) -> tuple[FloatArray, float]:
        """Return the change of each code visited, and the largest error that they leave over [m/s]."""
        left = error.copy()
        change = np.zeros(self.half.size)
        at_limit = np.abs(self.codes[self.channel, self.sample]) >= MID_CODE
        half = np.where(at_limit, np.inf, self.half)
        for start in range(0, half.size, _TOGETHER):
            some = slice(start, start + _TOGETHER)
            move, pull = self.move[some], self.pull[some]
            change[some] = _changes(pull @ left, move @ pull.T, half[some].tolist())
            left -= change[some] @ move
        return change, float(np.abs(left).max())


def _changes(gain: FloatArray, together: FloatArray, half: list[float]) -> list[float]:
    """Return the changes of codes, -1, 0 or 1, one after the other wherever that lessens the error."""
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
    """Return what a code does that is held as long as the clock holds that sample, (n_states, n or 1) array."""
    if timing.lateness is None:
        return effect[:, None]
    s = system.exponent[:, None]
    late, next_late = timing.lateness[sample], timing.lateness[sample + 1]
    grown = np.exp(s * timing.hold)
    return np.asarray(effect[:, None] * (1 + (grown * np.expm1(-s * late) - np.expm1(-s * next_late)) / (grown - 1)))
