"""Sums of decaying sinusoids, sampled fast: coarse steps times fine steps, one matrix product per channel.

Everything is counted in steps *before* an end, where each exponential is 1: nothing overflows however long a
burst. Work is done in chunks from the end, so that no memory grows with the number of samples.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

BLOCK = 256
"""Samples per block: rows of 2 kB keep the fine steps in the first-level cache."""

CHUNK = 512
"""Blocks per chunk: bounds the memory; one chunk holds the longest record of the generator."""

_DEAD = 2.0**-57
"""An exponential below this fraction of the channel's largest is lost in its rounding."""

_WORTH = 24
"""Blocks that must be spared before a matrix product is split in two."""

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
    per_step = exponent.imag.astype(np.longdouble) * (np.longdouble(hold) / _TWO_PI)
    turns = per_step[:, None] * steps
    turns -= np.rint(turns)
    phase = turns.astype(np.float64) * (2 * math.pi)
    magnitude = np.exp((exponent.real * hold)[:, None] * steps)
    powers = np.empty(phase.shape, dtype=complex)
    np.multiply(magnitude, np.cos(phase), out=powers.real)
    np.multiply(magnitude, np.sin(phase), out=powers.imag)
    return powers


def ladders(exponent: ComplexArray, hold: float, n_blocks: int) -> tuple[ComplexArray, ComplexArray]:
    """Return the decays towards an end, by samples within a block and by blocks.

    Each table is the product of two short ones: few exponentials are evaluated.

    Parameters
    ----------
    exponent : (n,) complex array
        Exponents [1/s].
    hold : float
        Length of a sample [s].
    n_blocks : int
        Blocks to step over.

    Returns
    -------
    fine : (n, BLOCK) complex array
        Over BLOCK - 1 down to 0 samples [1].
    coarse : (n_blocks + 1, n) complex array
        Over `n_blocks` down to 0 blocks [1].
    """
    return _ladders(exponent.tobytes(), hold, n_blocks)


@lru_cache(maxsize=8)
def _ladders(exponents: bytes, hold: float, n_blocks: int) -> tuple[ComplexArray, ComplexArray]:
    """Return the ladders, read-only: a design climbs the same ones again and again."""
    exponent = np.frombuffer(exponents, dtype=complex)
    rung, stride = math.isqrt(BLOCK), math.isqrt(n_blocks) + 1
    short, long = np.arange(rung - 1, -1, -1), np.arange(stride - 1, -1, -1)
    steps = np.concatenate([short, rung * short, BLOCK * long, BLOCK * stride * long])
    powers = decay(exponent, hold, steps)
    low, high = powers[:, :rung], powers[:, rung : 2 * rung]
    fine = (high[:, :, None] * low[:, None, :]).reshape(exponent.size, BLOCK)
    blocks = powers.T[2 * rung :]
    coarse = (blocks[stride:, None, :] * blocks[:stride]).reshape(stride * stride, exponent.size)
    coarse = coarse[-n_blocks - 1 :]
    fine.setflags(write=False)
    coarse.setflags(write=False)
    return fine, coarse


def synthesise(amplitude: ComplexArray, exponent: ComplexArray, hold: float, out: FloatArray) -> None:
    """Write sums of exponentials that end, at full amplitude, on the last sample.

    Sample n of channel c is the real part of
    ``sum(amplitude[c] * exp(exponent * hold * (n_samples - 1 - n)))``. Exponentials that have not yet begun to
    matter, and channels that carry nothing, cost nothing.

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
    threshold = _DEAD * np.abs(amplitude).max(axis=1, initial=0.0)
    stop = out.shape[1]
    while stop > 0:
        start = max(0, stop - CHUNK * BLOCK)
        if start == 0 and stop == out.shape[1]:
            faded = amplitude
        else:
            faded = amplitude * decay(exponent, hold, np.array([out.shape[1] - stop]))[:, 0]
        if (np.abs(faded).max(axis=1, initial=0.0) <= threshold).all():
            out[:, :stop] = 0.0
            return
        _write_chunk(faded, exponent, hold, threshold, out[:, start:stop])
        stop = start


def _write_chunk(
    amplitude: ComplexArray, exponent: ComplexArray, hold: float, threshold: FloatArray, out: FloatArray
) -> None:
    """Write the sums of one chunk; block j from the end begins j blocks before it, the first may be short."""
    n_blocks, head = divmod(out.shape[1], BLOCK)
    fine, coarse = ladders(exponent, hold, n_blocks)
    alive = _blocks_alive(amplitude, exponent, hold, threshold, n_blocks + 1)
    by_life = np.argsort(-alive, axis=1, kind="stable")
    for channel, lives, order, row in zip(amplitude, alive, by_life, out, strict=True):
        alive_for = [life for life in lives[order].tolist() if life]
        if not alive_for:
            row[:] = 0.0
            continue
        kept = order[: len(alive_for)]
        right = np.empty((kept.size, 2, BLOCK))
        right[:, 0] = fine.real[kept]
        np.negative(fine.imag[kept], out=right[:, 1])
        left = (coarse.take(kept, axis=1) * channel[kept]).view(np.float64)
        body = row[head:].reshape(n_blocks, BLOCK)
        for reach, shorter, n_alive in _groups(alive_for):
            first, last = n_blocks - reach, n_blocks - shorter
            start = max(first, 0)
            used = right[:n_alive].reshape(2 * n_alive, BLOCK)
            if first < 0 and head:
                row[:head] = left[0, : 2 * n_alive] @ used[:, BLOCK - head :]
            if last > start:
                np.matmul(left[start + 1 : last + 1, : 2 * n_alive], used, out=body[start:last])
        row[: max(0, head + (n_blocks - alive_for[0]) * BLOCK)] = 0.0


def _blocks_alive(
    amplitude: ComplexArray, exponent: ComplexArray, hold: float, threshold: FloatArray, n_blocks: int
) -> NDArray[np.int64]:
    """Return for how many blocks before the end each exponential matters, (n_channels, n) array."""
    size = np.abs(amplitude)
    tiny = 1e-300
    loudness = np.maximum(size / np.maximum(threshold, tiny)[:, None], 1.0)
    life = np.log(loudness) / np.maximum(np.abs(exponent.real) * (hold * BLOCK), tiny)
    return np.asarray(np.where(loudness > 1.0, np.minimum(life + 1, n_blocks), 0).astype(np.int64))


def _groups(alive_for: list[int]) -> list[tuple[int, int, int]]:
    """Return stretches (from, to blocks before the end, exponentials alive), the longest-lived first.

    Stretches shorter than what a matrix product costs by itself are joined to the next, longer one.
    """
    groups: list[tuple[int, int, int]] = []
    reach = alive_for[0] if alive_for else 0
    for n_alive, shorter in enumerate([*alive_for[1:], 0], start=1):
        if reach - shorter >= _WORTH or (shorter == 0 and reach > 0):
            groups.append((reach, shorter, n_alive))
            reach = shorter
    return groups
