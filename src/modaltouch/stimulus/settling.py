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
CodeArray = NDArray[np.uint16]

GOAL = 3e-8
"""Error, as a fraction of the largest target, below which a mode is no longer urgent [1]."""

_VISITS = (600, 1000, 2000)
"""Samples visited on each channel; more only where fewer do not settle it."""

_SETTLED = 3e-7
"""Error, as a fraction of the largest target, at which no more samples are visited [1]."""


def settle(
    codes: CodeArray,
    volts_per_code: FloatArray,
    system: DiagonalSystem,
    timing: Timing,
    error: FloatArray,
    largest: float,
) -> CodeArray:
    """Return codes, each changed by one at most, that leave next to no error of rounding at the focusing instant.

    Parameters
    ----------
    codes : (n_channels, n_samples) array of uint16
        Rounded codes, 0 to 16382.
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

    Returns
    -------
    (n_channels, n_samples) array of uint16
        Codes, 0 to 16382.
    """
    best, smallest = codes, float(np.abs(error).max())
    for n_visits in _VISITS:
        if smallest <= _SETTLED * largest:
            break
        walk = _Walk(codes, volts_per_code, system, timing, largest * GOAL, n_visits)
        changed, left = walk.settle(error)
        if left < smallest:
            best, smallest = changed, left
    return best


class _Walk:
    """Samples visited from the focusing instant back, with what one code of theirs does to the modes."""

    def __init__(
        self,
        codes: CodeArray,
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
        span = np.max(np.log(step[urgent] / goal) / rate[urgent], initial=float(n_visits))
        span = max(2, int(min(span, n_before - 2)))
        ago = np.unique(np.geomspace(1, span, n_visits).astype(np.int64))
        ago = ago[ago < n_before]
        faded = decay(system.exponent, timing.hold, ago)
        channels = np.flatnonzero(volts_per_code)
        moves = [(read @ (effect[:, c, None] * faded)).real.T for c in channels]
        self.codes = codes
        self.place = [(int(c), n_before - 1 - int(m)) for m in ago for c in channels]
        self.move = np.stack(moves, axis=1).reshape(len(self.place), read.shape[0])
        reach = np.maximum(step * np.exp(-rate * ago[:, None]), goal)
        urgency = np.repeat(np.tile(reach**-2, (1, 2)), channels.size, axis=0)
        self.pull = self.move * urgency
        self.half = 0.5 * np.einsum("ij,ij->i", self.move, self.pull)

    def settle(self, error: FloatArray) -> tuple[CodeArray, float]:
        """Return the changed codes, and the largest error that they leave over [m/s]."""
        codes, left = self.codes.copy(), error.copy()
        for place, move, pull, half in zip(self.place, self.move, self.pull, self.half.tolist(), strict=True):
            gain = float(pull @ left)
            if abs(gain) > half:
                sign = 1 if gain > 0 else -1
                changed = int(codes[place]) + sign
                if 0 <= changed <= 2 * MID_CODE:
                    codes[place] = changed
                    left -= sign * move
        return codes, float(np.abs(left).max())
