r"""A clock that begins some samples late: what the steps of voltage between them then do.

A step late by d reaches a state of exponent s as :math:`e^{-sd}` instead of 1. Its series in d turns lateness into
further inputs, the steps times powers of d, of which few are needed: a clock of 250 MHz turns a mode of 90 kHz by 0.002
between two of its edges.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.timing import Timing

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_LEFT = 1e-12
"""What the series may leave of its first term: four terms for 90 kHz on 250 MHz [1]."""


def late_gains(system: DiagonalSystem, timing: Timing) -> list[ComplexArray]:
    """Return what a step late by d leaves in the states at the end of its sample, term by term in d.

    Returns
    -------
    list of (n_states, n_channels) complex arrays
        Array k - 1 is the gain of ``step * d**k``; none where the clock is never late.
    """
    if timing.lateness is None:
        return []
    s = system.exponent
    turn = float(np.abs(s).max() * timing.lateness.max())
    gain = (np.exp(s * timing.hold) / s)[:, None] * system.input_gain
    gains: list[ComplexArray] = []
    left = 1.0
    while left > _LEFT:
        term = len(gains) + 1
        gain = gain * (-s / term)[:, None]
        gains.append(gain)
        left *= turn / (term + 1)
    return gains


def late_steps(voltage: FloatArray, timing: Timing, start: int, stop: int) -> Iterator[FloatArray]:
    """Yield the steps at the starts of samples times their lateness, then times its square, and so on.

    Parameters
    ----------
    voltage : (n_channels, n_samples) array
        Held samples from the start of the burst [V].
    timing : Timing
        Clock of the samples.
    start, stop : int
        First sample, and the one after the last.

    Yields
    ------
    (n_channels, stop - start) array
        The same array each time; nothing where the clock is never late [V s, V s^2, ...].
    """
    if timing.lateness is None:
        return
    # The record ends with its last sample: what follows is silence, never late.
    late = np.zeros(stop - start)
    playing = timing.lateness[start : min(stop, timing.n_samples)]
    late[: playing.size] = playing
    before = voltage[:, start - 1, None] if start else np.zeros((len(voltage), 1))
    steps = np.diff(voltage[:, start:stop], axis=1, prepend=before)
    while True:
        steps *= late
        yield steps


def clock_pushes(system: DiagonalSystem, timing: Timing) -> ComplexArray:
    """Return what a unit of each of `clock_inputs` leaves in the states after a sample, (n_states, n_inputs) array."""
    return np.concatenate([system.held_gain(timing.hold), *late_gains(system, timing)], axis=1)


def clock_inputs(voltage: FloatArray, timing: Timing, start: int, stop: int, n_inputs: int) -> FloatArray:
    """Return the voltages of some samples, and below them what their lateness adds.

    Parameters
    ----------
    voltage, timing, start, stop
        As for `late_steps`.
    n_inputs : int
        As many as `clock_pushes` has columns.

    Returns
    -------
    (n_inputs, stop - start) array
        Voltages, then steps times their lateness, its square, and so on.
    """
    if timing.lateness is None:
        return voltage[:, start:stop]
    inputs = np.empty((n_inputs, stop - start))
    n_channels = len(voltage)
    inputs[:n_channels] = voltage[:, start:stop]
    rows = range(n_channels, n_inputs, n_channels)
    for row, term in zip(rows, late_steps(voltage, timing, start, stop), strict=False):
        inputs[row : row + n_channels] = term
    return inputs
