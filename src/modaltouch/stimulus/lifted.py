r"""The highest speed if fingers are lifted off the beam during a burst, at the worst instant.

From that instant on, the beam moves without those fingers, from its current state. Its motion is the response as if the
fingers had never been there, plus the free decay of the difference between the two states,
:math:`y(t) = y_{left}(t) + \mathrm{Re} \sum_j c_j \delta_j(\tau) e^{s_j (t - \tau)}`. The moduli of its terms bound
the decay, which rules out most pairs of blocks of instants. Maxwell terms and second masses of the remaining fingers
are assumed to be in the state that they have without the lifted fingers.
"""

from __future__ import annotations

import numpy as np

from modaltouch.stimulus.dynamics import DiagonalSystem
from modaltouch.stimulus.quantities import ComplexArray, FloatArray
from modaltouch.stimulus.vibration import SHORT, BlockKernel

FINE = 0.4e-6
"""Approximate time between the instants at which speeds are computed [s]; lifting is tried at every sixteenth."""

_BLOCK = 16 * SHORT
"""Number of instants in a block, each of which has one upper bound."""

_BETWEEN = 1.1
"""Factor on the bounds that covers lifting between the instants tried: for fingers up to 0.3 g and 30 N s/m, moduli
rise by 8 % between them within a block, by 0.5 % over a burst [1]."""


def peaks_when_lifted(
    systems: tuple[DiagonalSystem, DiagonalSystem, DiagonalSystem],
    voltage: FloatArray,
    hold: float,
    shapes: FloatArray,
    known: FloatArray,
    floor: float,
) -> FloatArray:
    """Return the highest speed at each point for the worst instant of lifting, (n_points,) array [m/s].

    Parameters
    ----------
    systems : (DiagonalSystem, DiagonalSystem, DiagonalSystem)
        The beam with all fingers, and with the remaining ones, behind the amplifier; the latter without the amplifier.
    voltage : (n_channels, n_instants) array
        Voltages, held between instants about `FINE` apart [V].
    hold : float
        Time between instants [s].
    shapes : (n_modes, n_points) array
        Mode shapes at the points [1].
    known : (2, n_points) array
        Peaks with all fingers, and with the remaining ones [m/s].
    floor : float
        Smallest value returned; lower peaks are not resolved [m/s].
    """
    _, left, beam = systems
    peak: FloatArray = np.maximum(known.max(axis=0), floor)
    output, difference = shapes.T @ beam.velocity, _difference(systems, voltage, hold)
    if (known[1] + _BETWEEN * np.abs(output) @ np.abs(difference).max(axis=1) <= peak).all():
        return peak
    speed = np.empty((len(output), voltage.shape[1]))
    kernel = BlockKernel.of(left, shapes.T @ left.velocity, hold)
    kernel.write(lambda start, stop: voltage[:, start:stop], speed)
    return _raised(speed, output, difference, peak, beam.exponent * hold)


def _difference(
    systems: tuple[DiagonalSystem, DiagonalSystem, DiagonalSystem], voltage: FloatArray, hold: float
) -> ComplexArray:
    """Return the difference of the states at every `SHORT`-th instant, (n_states, n_instants / SHORT) array."""
    *both, beam = systems
    blocks, motion = BlockKernel.blocks(voltage), []
    for system in both:
        rest = np.zeros(system.exponent.size, dtype=complex)
        begin, _ = BlockKernel.of(system, np.empty((0, rest.size), dtype=complex), hold).states(blocks, rest)
        motion.append((np.concatenate([system.velocity, system.displacement]) @ begin).real)
    read = np.concatenate([beam.velocity, beam.displacement])
    parts = np.linalg.pinv(np.concatenate([read.real, -read.imag], axis=1)) @ (motion[0] - motion[1])
    real, imaginary = np.split(parts, 2)
    return np.asarray(real + 1j * imaginary)


def _raised(
    speed: FloatArray, output: ComplexArray, difference: ComplexArray, peak: FloatArray, rate: ComplexArray
) -> FloatArray:
    """Return the peaks, raised where the response without the fingers plus the decaying difference exceeds them.

    The `rate` is the exponents times the time between instants [1].
    """
    highest = BlockKernel.blocks(np.abs(speed), _BLOCK).max(axis=2)
    size = _BETWEEN * BlockKernel.blocks(np.abs(difference), _BLOCK // SHORT).max(axis=2)
    n_blocks = highest.shape[1]
    swing = np.exp(np.outer(np.arange(_BLOCK), rate)) * output[:, None]
    swing_parts = np.concatenate([swing.real, -swing.imag], axis=2)
    for block in range(n_blocks):
        later = np.maximum(np.arange(n_blocks - block) - 1, 0) * _BLOCK
        faded = np.exp(np.outer(rate.real, later)) * size[:, block, None]
        near = highest[:, block:] + np.abs(output) @ faded > peak[:, None]
        away = difference[:, block * _BLOCK // SHORT : (block + 1) * _BLOCK // SHORT]
        since = SHORT * np.arange(away.shape[1])
        for ahead in np.flatnonzero(near.any(axis=0)).tolist():
            begun = np.exp(np.outer(rate, ahead * _BLOCK - since)) * away
            begun_parts = np.concatenate([begun.real, begun.imag])
            for point in np.flatnonzero(near[:, ahead]).tolist():
                some = speed[point, (block + ahead) * _BLOCK :][:_BLOCK, None]
                found = np.abs(some + swing_parts[point, : some.size] @ begun_parts)
                if not ahead:  # no decay before the fingers are lifted
                    found[np.arange(some.size)[:, None] < since] = 0.0
                peak[point] = max(peak[point], found.max())
    return peak
