"""The beam forward: from sampled voltages to states, velocity histories and peak speeds.

Each state is a one-pole, x' = exponent x + input_gain v, held samples: within a block of 32 samples every
output is one matrix product of the block's voltages and the state at its start; the states at the starts follow
by a second level of blocks. Work is done chunk by chunk, so that memory does not grow with the burst.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.stimulus.blocks import SHORT, BlockKernel
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem, modal_system
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.synthesis import BLOCK, decay, ladders
from modaltouch.stimulus.timing import Timing

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Chunk = tuple[int, FloatArray, ComplexArray, ComplexArray]

_CHUNK = 32_768
"""Samples per chunk: bounds the memory, and keeps a chunk of voltages in the second-level cache."""

_CHUNKS_AT_ONCE = 5
"""Chunks whose bounds are compared before any is computed: the longest record of the generator."""

_LATENESS_TERMS = 6
"""A clock late by up to one period of 250 MHz turns a 90 kHz mode by 2e-3: six terms leave 1e-18."""


def moments(voltage: FloatArray, exponent: ComplexArray, hold: float) -> ComplexArray:
    """Return the sums of voltage * exp(exponent * time from the end of the sample to the end of the last).

    Parameters
    ----------
    voltage : (n_channels, n_samples) array
        Samples [V].
    exponent : (n_states,) complex array
        Exponents [1/s].
    hold : float
        Length of a sample [s].

    Returns
    -------
    (n_channels, n_states) complex array
        The sums [V].
    """
    n_blocks, head = divmod(voltage.shape[1], BLOCK)
    fine, coarse = ladders(exponent, hold, n_blocks)
    n_states = exponent.size
    fine_real = np.concatenate([fine.real, fine.imag]).T
    sums = np.empty((voltage.shape[0], n_states), dtype=complex)
    for channel, row in enumerate(voltage):
        blocks = np.empty((n_blocks + 1, 2 * n_states))
        blocks[0] = row[:head] @ fine_real[BLOCK - head :]
        np.matmul(row[head:].reshape(n_blocks, BLOCK), fine_real, out=blocks[1:])
        per_block = blocks[:, :n_states] + 1j * blocks[:, n_states:]
        sums[channel] = np.einsum("je,je->e", per_block, coarse)
    return sums


def states_by_channel(system: DiagonalSystem, voltage: FloatArray, timing: Timing, instant: float) -> ComplexArray:
    """Return the states that each channel alone leaves at an instant, from rest, on the generator's clock.

    Parameters
    ----------
    system : DiagonalSystem
        The beam behind its amplifier.
    voltage : (n_channels, n_samples) array
        Held samples at the beam from the start of the burst [V].
    timing : Timing
        Clock of the samples.
    instant : float
        From the start of the burst, up to its end plus the delay [s].

    Returns
    -------
    (n_channels, n_states) complex array
        States of `system`; their sum over the channels is the state of the beam.
    """
    n_whole, remainder = timing.samples_until(instant - system.delay)
    n_whole = min(n_whole, voltage.shape[1])
    hold = timing.hold
    played = voltage[:, :n_whole]
    states = moments(played, system.exponent, hold) * system.held_gain(hold).T
    states = states + _late_states(system, played, timing, n_whole)
    if remainder:
        states = states * np.exp(system.exponent * remainder)
        if n_whole < min(voltage.shape[1], timing.n_samples):
            states = states + voltage[:, n_whole, None] * system.held_gain(remainder).T
    return np.asarray(states)


def _late_states(system: DiagonalSystem, voltage: FloatArray, timing: Timing, n_whole: int) -> ComplexArray | float:
    """Return what a clock adds that begins some samples late: steps of voltage arrive late by `lateness`."""
    if timing.lateness is None or n_whole == 0:
        return 0.0
    # A step late by d reaches the state as exp(-s d) instead of 1: a Taylor series in d, summed by `moments`.
    steps = np.diff(voltage, axis=1, prepend=0.0)
    late = timing.lateness[:n_whole]
    total = np.zeros((voltage.shape[0], system.exponent.size), dtype=complex)
    factor = np.ones_like(system.exponent)
    for term in range(1, _LATENESS_TERMS + 1):
        factor = factor * -system.exponent / term
        total = total + moments(steps * late**term, system.exponent, timing.hold) * factor
    # The last sample ends at the ideal end: what follows it begins later, but belongs to the next instant.
    to_end = np.exp(system.exponent * timing.hold) / system.exponent
    return np.asarray(total * to_end * system.input_gain.T)


def velocity_history(
    model: ModalModel,
    voltage: FloatArray,
    timing: Timing,
    positions: ArrayLike,
    amplifier: Amplifier | None = None,
) -> FloatArray:
    """Return the velocity at points of the beam during a burst that starts from rest.

    Parameters
    ----------
    model : ModalModel
        The beam: the identified one, or another, such as the true one of a simulated rig.
    voltage : (n_channels, n_samples) array
        Held samples at the beam [V].
    timing : Timing
        Clock of the samples.
    positions : (n_positions,) array_like
        Where, origin at mid-beam [m].
    amplifier : Amplifier, optional
        Pole and delay before the beam.

    Returns
    -------
    (n_positions, n_samples) array
        Velocity at the start of each sample as it arrives, at ``n * hold + delay`` [m/s].
    """
    system = modal_system(model, amplifier)
    output = model.shapes(positions).T @ system.velocity
    return _history(system, output, _checked(voltage, model), timing.hold)


def modal_history(
    model: ModalModel, voltage: FloatArray, timing: Timing, amplifier: Amplifier | None = None
) -> FloatArray:
    """Return the modal velocities during a burst that starts from rest.

    Parameters
    ----------
    model : ModalModel
        The beam.
    voltage : (n_channels, n_samples) array
        Held samples at the beam [V].
    timing : Timing
        Clock of the samples.
    amplifier : Amplifier, optional
        Pole and delay before the beam.

    Returns
    -------
    (n_modes, n_samples) array
        Modal velocities at the start of each sample as it arrives [m/s].
    """
    system = modal_system(model, amplifier)
    return _history(system, system.velocity, _checked(voltage, model), timing.hold)


def peak_velocity(
    model: ModalModel,
    voltage: FloatArray,
    timing: Timing,
    positions: ArrayLike,
    amplifier: Amplifier | None = None,
) -> FloatArray:
    """Return the highest speed at points of the beam, from rest until the next burst would begin.

    Parameters
    ----------
    model : ModalModel
        The beam.
    voltage : (n_channels, n_samples) array
        Held samples at the beam [V].
    timing : Timing
        Clock of the samples.
    positions : (n_positions,) array_like
        Where, origin at mid-beam [m].
    amplifier : Amplifier, optional
        Pole and delay before the beam.

    Returns
    -------
    (n_positions,) array
        Largest magnitude of the velocity at the starts of the samples, and of the decay after them [m/s].
    """
    system = modal_system(model, amplifier)
    output = model.shapes(positions).T @ system.velocity
    checked = _checked(voltage, model)
    kernel = BlockKernel.of(system, output, timing.hold)
    peak, left, end = np.zeros(output.shape[0]), np.zeros(system.exponent.size, dtype=complex), 0
    for some in _batches(_chunks(kernel, checked, system.exponent.size)):
        bounds = [kernel.bounds(blocks, begin) for _, blocks, begin, _ in some]
        for place in range(peak.size):
            # The likeliest chunk first: what it reaches spares most of the others.
            for i in sorted(range(len(some)), key=lambda i: -bounds[i][place].max()):
                _, blocks, begin, _ = some[i]
                peak[place] = kernel.peak(place, blocks, begin, bounds[i][place], float(peak[place]))
        start, blocks, _, left = some[-1]
        end = start + blocks[0].size
    silence = max(0, int(timing.sampling_rate / timing.repetition_rate) - end)
    return _peak_of_decay(output * left, system.exponent, timing.hold, silence, peak)


def _batches(items: Iterator[Chunk]) -> Iterator[list[Chunk]]:
    """Yield lists of _CHUNKS_AT_ONCE items."""
    while some := list(islice(items, _CHUNKS_AT_ONCE)):
        yield some


def _peak_of_decay(
    amplitude: ComplexArray, exponent: ComplexArray, hold: float, n_samples: int, peak: FloatArray
) -> FloatArray:
    """Return the higher of `peak` and the decay after it, which is followed only while it could be higher."""
    for start in range(0, n_samples, BLOCK):
        now = amplitude * decay(exponent, hold, np.array([start]))[:, 0]
        if (np.abs(now).sum(axis=1) <= peak).all():
            break
        steps = np.arange(min(BLOCK, n_samples - start))
        speed = np.abs((now @ decay(exponent, hold, steps)).real)
        peak = np.maximum(peak, speed.max(axis=1))
    return peak


def _checked(voltage: FloatArray, model: ModalModel) -> FloatArray:
    values = np.ascontiguousarray(voltage, dtype=float)
    if values.ndim != 2 or values.shape[0] != model.n_channels:
        raise ValueError(
            f"voltages of shape {values.shape} do not fit a beam with {model.n_channels} channels: "
            f"give one row of samples to each channel"
        )
    if not np.isfinite(values).all():
        raise ValueError("a voltage is not a finite number: every sample must be")
    return values


def _history(system: DiagonalSystem, output: ComplexArray, voltage: FloatArray, hold: float) -> FloatArray:
    """Return the outputs at the starts of the samples, (n_outputs, n_samples) array [m/s]."""
    kernel = BlockKernel.of(system, output, hold)
    history = np.empty((output.shape[0], voltage.shape[1]))
    for start, blocks, begin, _ in _chunks(kernel, voltage, system.exponent.size):
        kernel.respond(blocks, begin, history[:, start : start + blocks[0].size])
    return history


def _chunks(kernel: BlockKernel, voltage: FloatArray, n_states: int) -> Iterator[Chunk]:
    """Yield chunks (first sample, blocks, states at their starts, state after them) of the response from rest.

    Samples beyond the last whole block come as a block of their own, filled up with zeros.
    """
    state = np.zeros(n_states, dtype=complex)
    n_channels, n_samples = voltage.shape
    whole = n_samples - n_samples % SHORT
    for start in [*range(0, whole, _CHUNK), *([whole] if whole < n_samples else [])]:
        if start < whole:
            piece = voltage[:, start : min(start + _CHUNK, whole)]
        else:
            piece = np.zeros((n_channels, SHORT))
            piece[:, : n_samples - whole] = voltage[:, whole:]
        blocks = piece.reshape(n_channels, -1, SHORT)
        begin, state = kernel.states(blocks, state)
        yield start, blocks, begin, state
