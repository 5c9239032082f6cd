"""Sums of decaying sinusoids, sampled fast: coarse steps times fine steps, one matrix product per channel.

Everything is counted in steps *before* an end, where each exponential is 1: nothing overflows however long a
burst.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

BLOCK = 256
"""Samples per block: rows of 2 kB keep the fine steps in the first-level cache."""

_DEAD = 2.0**-57
"""An exponential below this fraction of the channel's largest is lost in its rounding."""

_TWO_PI = np.longdouble("6.283185307179586476925286766559005768")


def decay(exponent: ComplexArray, hold: float, steps: NDArray[np.int64]) -> ComplexArray:
    """Return exp(exponent * hold * steps), the phase reduced to one turn before it is rounded.

    Parameters
    ----------
    exponent : (n,) complex array
        Exponents [1/s].
    hold : float
        Length of a step [s].
    steps : (n_steps,) array of int
        Steps to take [1].

    Returns
    -------
    (n, n_steps) complex array
        The powers [1].
    """
    turns = np.outer(exponent.imag.astype(np.longdouble) * np.longdouble(hold) / _TWO_PI, steps)
    phase = ((turns - np.rint(turns)) * _TWO_PI).astype(np.float64)
    magnitude = np.exp(np.outer(exponent.real * hold, steps))
    powers = np.empty(phase.shape, dtype=complex)
    np.multiply(magnitude, np.cos(phase), out=powers.real)
    np.multiply(magnitude, np.sin(phase), out=powers.imag)
    return powers


def synthesise(amplitude: ComplexArray, exponent: ComplexArray, hold: float, out: FloatArray) -> None:
    """Write sums of exponentials that end, at full amplitude, on the last sample.

    Sample n of channel c is the real part of ``sum(amplitude[c] * exp(exponent * hold * (n_samples - 1 -
    n)))``. Exponentials that have not yet begun to matter, and channels that carry nothing, cost nothing.

    Parameters
    ----------
    amplitude : (n_channels, n) complex array
        Amplitudes at the last sample [V].
    exponent : (n,) complex array
        Exponents, real parts at most 0 [1/s].
    hold : float
        Length of a sample [s].
    out : (n_channels, n_samples) array
        Where the samples go [V]; each row contiguous.
    """
    n_samples = out.shape[1]
    n_blocks, head = divmod(n_samples, BLOCK)
    steps = np.arange(BLOCK - 1, -1, -1)
    fine = decay(exponent, hold, steps)
    coarse = decay(exponent, hold, BLOCK * np.arange(n_blocks, -1, -1))
    for channel, row in zip(amplitude, out, strict=True):
        alive_for = _blocks_alive(channel, exponent, hold, n_blocks + 1)
        order = np.argsort(-alive_for, kind="stable")
        counts = alive_for[order]
        body = row[head:].reshape(n_blocks, BLOCK)
        stop = 0
        for n_alive in range(1, order.size + 1):
            # Between two deaths, counted from the end, the same exponentials are alive.
            reach = int(counts[n_alive - 1])
            shorter = int(counts[n_alive]) if n_alive < order.size else 0
            if reach == shorter:
                continue
            kept = order[:n_alive]
            _write_blocks(channel[kept], coarse[kept], fine[kept], body, row[:head], (reach, shorter))
            stop = max(stop, reach)
        row[: max(0, n_samples - stop * BLOCK)] = 0.0


def _blocks_alive(
    amplitude: ComplexArray, exponent: ComplexArray, hold: float, n_blocks: int
) -> NDArray[np.int64]:
    """Return for how many blocks before the end each exponential matters."""
    size = np.abs(amplitude)
    largest = size.max(initial=0.0)
    counts = np.zeros(size.shape, dtype=np.int64)
    loud = size > _DEAD * largest
    fading = np.abs(exponent.real[loud]) * hold * BLOCK
    with np.errstate(divide="ignore", over="ignore"):
        life = np.log(size[loud] / (_DEAD * largest)) / fading
    counts[loud] = np.minimum(np.floor(np.minimum(life, n_blocks)) + 1, n_blocks)
    return counts


def _write_blocks(
    amplitude: ComplexArray,
    coarse: ComplexArray,
    fine: ComplexArray,
    body: FloatArray,
    head: FloatArray,
    reach: tuple[int, int],
) -> None:
    """Write the blocks from `reach[0]` to `reach[1]` blocks before the end; the short first block is `head`."""
    n_blocks = body.shape[0]
    first, last = n_blocks - reach[0], n_blocks - reach[1]
    rotated = amplitude[:, None] * coarse[:, first + 1 : last + 1]
    left = np.concatenate([rotated.real, -rotated.imag]).T
    right = np.concatenate([fine.real, fine.imag])
    start = max(first, 0)
    if first < 0 and head.size:
        head[:] = left[0] @ right[:, BLOCK - head.size :]
    if last > start:
        np.matmul(left[start - first :], right, out=body[start:last])
