"""The beam forward: from sampled voltages to states, velocity histories and peak speeds.

Each state is a one-pole, x' = exponent x + input_gain v, held samples: within a short block of samples every
output is one matrix product of the block's voltages and the state at its start; the states at the starts follow
by a second level of blocks. Work is done chunk by chunk, so that memory does not grow with the burst.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.stimulus.block_states import BlockStates
from modaltouch.stimulus.blocks import BlockKernel
from modaltouch.stimulus.clock_quantisation import clock_inputs, clock_pushes, late_gains, late_steps
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem, modal_system
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.synthesis import BLOCK, CHUNK, decay, ladders
from modaltouch.stimulus.timing import Timing

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def moments(
    voltage: FloatArray, exponent: ComplexArray, hold: float, driven: NDArray[np.bool_] | None = None
) -> ComplexArray:
    """Return the sums of voltage * exp(exponent * time from the end of the sample to the end of the last).

    Parameters
    ----------
    voltage : (n_channels, n_samples) array
        Samples [V].
    exponent : (n_states,) complex array
        Exponents [1/s].
    hold : float
        Length of a sample [s].
    driven : (n_channels, n_states) array of bool, optional
        Which sums are asked for; all, if not given.

    Returns
    -------
    (n_channels, n_states) complex array
        The sums [V]; 0 where not asked for.
    """
    n_samples = voltage.shape[1]
    sums = np.zeros((voltage.shape[0], exponent.size), dtype=complex)
    for stop in range(n_samples, 0, -CHUNK * BLOCK):
        part = _chunk_moments(voltage[:, max(0, stop - CHUNK * BLOCK) : stop], exponent, hold, driven)
        sums += part if stop == n_samples else part * decay(exponent, hold, np.array([n_samples - stop]))[:, 0]
    return sums


def _chunk_moments(
    voltage: FloatArray, exponent: ComplexArray, hold: float, driven: NDArray[np.bool_] | None
) -> ComplexArray:
    """Return the moments of so many samples that their blocks' sums may all be kept."""
    n_blocks, head = divmod(voltage.shape[1], BLOCK)
    fine, coarse = ladders(exponent, hold, n_blocks)
    sums = np.zeros((voltage.shape[0], exponent.size), dtype=complex)
    for channel, row in enumerate(voltage):
        asked = slice(None) if driven is None else np.flatnonzero(driven[channel])
        some = fine[asked]
        n_some = len(some)
        fine_real = np.concatenate([some.real, some.imag]).T
        blocks = np.empty((n_blocks + 1, 2 * n_some))
        blocks[0] = row[:head] @ fine_real[BLOCK - head :]
        np.matmul(row[head:].reshape(n_blocks, BLOCK), fine_real, out=blocks[1:])
        per_block = blocks[:, :n_some] + 1j * blocks[:, n_some:]
        sums[channel, asked] = np.einsum("je,je->e", per_block, coarse[:, asked])
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
    if instant <= system.delay:
        # Nothing has arrived yet.
        return np.zeros((voltage.shape[0], system.exponent.size), dtype=complex)
    n_whole, remainder = timing.samples_until(instant - system.delay)
    n_whole = min(n_whole, voltage.shape[1])
    hold = timing.hold
    played = voltage[:, :n_whole]
    driven = system.input_gain.T != 0
    states = moments(played, system.exponent, hold, driven) * system.held_gain(hold).T
    for gain, late in zip(late_gains(system, timing), late_steps(played, timing, 0, n_whole), strict=False):
        states += moments(late, system.exponent, hold, driven) * gain.T
    if remainder:
        states = states * np.exp(system.exponent * remainder)
        if n_whole < min(voltage.shape[1], timing.n_samples):
            wait = 0.0 if timing.lateness is None else min(float(timing.lateness[n_whole]), remainder)
            begun = system.held_gain(remainder - wait)
            states = states + voltage[:, n_whole, None] * begun.T
            if wait and n_whole:
                # Until the clock begins it, the sample before goes on.
                states = states + voltage[:, n_whole - 1, None] * (system.held_gain(remainder) - begun).T
    return np.asarray(states)


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
    return _history(system, output, _checked(voltage, model), timing)


def modal_history(
    model: ModalModel, voltage: FloatArray, timing: Timing, amplifier: Amplifier | None = None
) -> FloatArray:
    """Return the modal velocities as each sample arrives, (n_modes, n_samples) array [m/s], from rest.

    Parameters
    ----------
    model : ModalModel
        The beam.
    voltage, timing, amplifier
        As for `velocity_history`.
    """
    system = modal_system(model, amplifier)
    return _history(system, system.velocity, _checked(voltage, model), timing)


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
    model, voltage, timing
        As for `modal_history`.
    positions, amplifier
        As for `velocity_history`.

    Returns
    -------
    (n_positions,) array
        Largest magnitude of the velocity at the starts of the samples, and of the decay after them [m/s].
    """
    system = modal_system(model, amplifier)
    return BlockStates.of(system, _checked(voltage, model), timing).peak(model.shapes(positions).T @ system.velocity)


def _checked(voltage: FloatArray, model: ModalModel) -> FloatArray:
    values = np.ascontiguousarray(voltage, dtype=float)
    if values.ndim != 2 or values.shape[0] != model.n_channels:
        raise ValueError(
            f"voltages of shape {values.shape} do not fit a beam with {model.n_channels} channels: "
            f"give one row of samples to each channel"
        )
    # The square of every sample goes into one number: no array as large as the burst is needed to find none bad.
    if not math.isfinite(np.vdot(values, values)) and not np.isfinite(values).all():
        channel, sample = np.argwhere(~np.isfinite(values))[0].tolist()
        raise ValueError(
            f"sample {sample} of channel {channel + 1} is {values[channel, sample]} V; every sample must be a finite "
            f"number: mend it where it comes from"
        )
    return values


def _history(system: DiagonalSystem, output: ComplexArray, voltage: FloatArray, timing: Timing) -> FloatArray:
    """Return the outputs at the starts of the samples, (n_outputs, n_samples) array [m/s]."""
    kernel = BlockKernel(system.exponent, clock_pushes(system, timing), output, timing.hold)
    n_inputs = kernel.push.shape[1]
    history = np.empty((output.shape[0], voltage.shape[1]))
    kernel.write(lambda start, stop: clock_inputs(voltage, timing, start, stop, n_inputs), history)
    return history
