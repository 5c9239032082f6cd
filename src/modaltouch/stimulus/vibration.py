"""The beam forward: from sampled voltages to states, velocity histories and peak speeds.

Each state is a one-pole, x' = exponent x + input_gain v, held samples: within a block of 32 samples every
output is one matrix product of the block's voltages and the state at its start; the states at the starts follow
by a second level of blocks. Work is done chunk by chunk, so that memory does not grow with the burst.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem, modal_system
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.synthesis import BLOCK, decay
from modaltouch.stimulus.timing import Timing

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_SHORT = 32
"""Samples per block of the forward response: a 32 x 32 product stays in the first-level cache."""

_CHUNK = 32_768
"""Samples per chunk: bounds the memory, and keeps a chunk of voltages in the second-level cache."""

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
    fine = decay(exponent, hold, np.arange(BLOCK - 1, -1, -1))
    coarse = decay(exponent, hold, BLOCK * np.arange(n_blocks, -1, -1))
    fine_real = np.concatenate([fine.real, fine.imag]).T.copy()
    n_states = exponent.size
    sums = np.empty((voltage.shape[0], n_states), dtype=complex)
    for channel, row in enumerate(voltage):
        blocks = np.empty((n_blocks + 1, 2 * n_states))
        blocks[0] = row[:head] @ fine_real[BLOCK - head :]
        np.matmul(row[head:].reshape(n_blocks, BLOCK), fine_real, out=blocks[1:])
        per_block = blocks[:, :n_states] + 1j * blocks[:, n_states:]
        sums[channel] = np.einsum("je,ej->e", per_block, coarse)
    return sums


def states_by_channel(
    system: DiagonalSystem, voltage: FloatArray, timing: Timing, instant: float
) -> ComplexArray:
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


def _late_states(
    system: DiagonalSystem, voltage: FloatArray, timing: Timing, n_whole: int
) -> ComplexArray | float:
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
    history = np.empty((output.shape[0], voltage.shape[1]))
    for start, part in _responses(system, output, _checked(voltage, model), timing.hold):
        history[:, start : start + part.shape[1]] = part
    return history


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
    history = np.empty((model.n_modes, voltage.shape[1]))
    for start, part in _responses(system, system.velocity, _checked(voltage, model), timing.hold):
        history[:, start : start + part.shape[1]] = part
    return history


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
    peak = np.zeros(output.shape[0])
    for _, part in _responses(system, output, checked, timing.hold):
        np.maximum(peak, part.max(axis=1), out=peak)
        np.maximum(peak, -part.min(axis=1), out=peak)
    left = (moments(checked, system.exponent, timing.hold) * system.held_gain(timing.hold).T).sum(axis=0)
    silence = int((1 / timing.repetition_rate - timing.duration) * timing.sampling_rate)
    return _peak_of_decay(output * left, system.exponent, timing.hold, silence, peak)


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


def _responses(
    system: DiagonalSystem, output: ComplexArray, voltage: FloatArray, hold: float
) -> Iterator[tuple[int, FloatArray]]:
    """Yield chunks (first sample, (n_outputs, n) velocities) of the response from rest."""
    held = system.held_gain(hold)
    steps = np.arange(_SHORT)
    powers = decay(system.exponent, hold, steps)
    # What a volt i samples ago does to each output: n_outputs x n_channels x _SHORT.
    kernel = np.einsum("pe,ec,ei->pci", output, held, powers, optimize=True).real
    after = np.subtract.outer(steps, steps) - 1
    toeplitz = np.where(after.T >= 0, kernel[:, :, np.maximum(after.T, 0)], 0.0)
    from_state = output[:, :, None] * powers
    free = np.concatenate([from_state.real, -from_state.imag], axis=1)
    into_state = held.T[:, :, None] * powers[:, ::-1]
    forced = np.concatenate([into_state.real, into_state.imag], axis=1).transpose(0, 2, 1)
    state = np.zeros(system.exponent.size, dtype=complex)
    n_samples = voltage.shape[1]
    for start in range(0, n_samples, _CHUNK):
        piece = voltage[:, start : start + _CHUNK]
        n_piece = piece.shape[1]
        n_blocks = -(-n_piece // _SHORT)
        blocks = np.zeros((voltage.shape[0], n_blocks * _SHORT))
        blocks[:, :n_piece] = piece
        blocks = blocks.reshape(-1, n_blocks, _SHORT)
        pushed = np.matmul(blocks, forced).sum(axis=0)
        n_states = system.exponent.size
        begin, state = _scan(
            system.exponent, hold * _SHORT, pushed[:, :n_states] + 1j * pushed[:, n_states:], state
        )
        begin_real = np.concatenate([begin.real, begin.imag], axis=1)
        part = np.empty((output.shape[0], n_blocks, _SHORT))
        for p in range(output.shape[0]):
            used = np.flatnonzero(output[p])
            columns = np.concatenate([used, used + n_states])
            np.matmul(begin_real[:, columns], free[p, columns], out=part[p])
            for channel in np.flatnonzero(kernel[p].any(axis=1)):
                part[p] += blocks[channel] @ toeplitz[p, channel]
        yield start, part.reshape(output.shape[0], -1)[:, :n_piece]


def _scan(
    exponent: ComplexArray, step: float, pushed: ComplexArray, state: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return the states before each block and after all: x[j + 1] = exp(exponent step) x[j] + pushed[j]."""
    n_blocks, n_states = pushed.shape
    if n_blocks <= _SHORT:
        ratio = decay(exponent, step, np.array([1]))[:, 0]
        begin = np.empty((n_blocks, n_states), dtype=complex)
        for j in range(n_blocks):
            begin[j] = state
            state = ratio * state + pushed[j]
        return begin, state
    n_groups, rest = divmod(n_blocks, _SHORT)
    powers = decay(exponent, step, np.arange(_SHORT + 1))
    after = np.subtract.outer(np.arange(_SHORT), np.arange(_SHORT)) - 1
    triangle = np.where(after >= 0, powers[:, np.maximum(after, 0)], 0.0)
    groups = pushed[: n_groups * _SHORT].reshape(n_groups, _SHORT, n_states).transpose(2, 1, 0)
    within = triangle @ groups
    total = (powers[:, _SHORT - 1 :: -1][:, None, :] @ groups)[:, 0].T
    starts, state = _scan(exponent, step * _SHORT, total, state)
    begin = (within + powers[:, :_SHORT, None] * starts.T[:, None, :]).transpose(2, 1, 0).reshape(-1, n_states)
    if rest:
        tail, state = _scan(exponent, step, pushed[n_groups * _SHORT :], state)
        begin = np.concatenate([begin, tail])
    return begin, state
