"""Fast sampling of sums of decaying sinusoids: coarse steps times fine steps, one matrix product per channel.

Steps are counted backwards from the end, where each exponential is 1, so that nothing overflows in bursts of any
length. Chunks are processed from the end, so that memory does not grow with the number of samples.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.quantities import ComplexArray, FloatArray

BLOCK = 256
"""Samples per block: rows of 2 kB keep the fine steps in the first-level cache."""

CHUNK = 512
"""Blocks per chunk, which bounds the memory; one chunk holds the generator's longest record."""

_DEAD = 2.0**-53
"""Magnitude of an exponential, relative to the channel's largest, below which it is lost to rounding [1]."""

_WORTH = 64
"""Smallest saving in blocks for which a matrix product is split in two."""

_STEP = 8
"""Granularity of lifetimes in blocks: the number of rows that a matrix product processes at a time."""

_TWO_PI = np.longdouble("6.283185307179586476925286766559005768")


def decay(exponent: ComplexArray, hold: float, steps: NDArray[np.int64]) -> ComplexArray:
    """Return exp(exponent * hold * steps), phases reduced modulo 2 pi before rounding, (n, n_steps) array [1]."""
    per_step = exponent.imag.astype(np.longdouble) * (np.longdouble(hold) / _TWO_PI)
    turns = per_step[:, None] * steps
    turns -= np.rint(turns)
    phase = turns.astype(np.float64) * (2 * math.pi)
    magnitude = np.exp((exponent.real * hold)[:, None] * steps)
    powers = np.empty(phase.shape, dtype=complex)
    np.multiply(magnitude, np.cos(phase), out=powers.real)
    np.multiply(magnitude, np.sin(phase), out=powers.imag)
    return powers


def exponential_tables(exponent: ComplexArray, hold: float, n_blocks: int) -> tuple[ComplexArray, ComplexArray]:
    """Return tables of the decays towards the end, by samples within a block and by blocks.

    They cover BLOCK - 1 down to 0 samples, (n, BLOCK) array, and `n_blocks` down to 0 blocks, (n_blocks + 1, n) array.
    Each table is the product of two short ones, so that few exponentials are evaluated.
    """
    return _exponential_tables(exponent.tobytes(), hold, n_blocks)


@lru_cache(maxsize=8)
def _exponential_tables(exponents: bytes, hold: float, n_blocks: int) -> tuple[ComplexArray, ComplexArray]:
    """Return the tables of `exponential_tables`, read-only and cached: a design uses the same ones many times."""
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
    ``sum(amplitude[c] * exp(exponent * hold * (n_samples - 1 - n)))``. Exponentials are skipped where they are
    negligible, and so are silent channels. `amplitude` is a (n_channels, n) array [V], `exponent` an (n,) array of real
    parts at most 0 [1/s], `hold` the length of a sample [s]; each row of `out` is contiguous.
    """
    threshold = [_DEAD * max(each, default=0.0) for each in np.abs(amplitude).tolist()]
    stop = out.shape[1]
    while stop > 0:
        start = max(0, stop - CHUNK * BLOCK)
        faded = amplitude
        if stop < out.shape[1]:
            faded = amplitude * decay(exponent, hold, np.array([out.shape[1] - stop]))[:, 0]
        _write_chunk(faded, exponent, hold, threshold, out[:, start:stop])
        stop = start


def _write_chunk(
    amplitude: ComplexArray, exponent: ComplexArray, hold: float, threshold: list[float], out: FloatArray
) -> None:
    """Write the sums of one chunk; block j from the end begins j blocks before the end, and the first may be short."""
    n_blocks = out.shape[1] // BLOCK
    order, fine, coarse, rate = _by_decay_time(exponent.tobytes(), hold, n_blocks)
    ordered = amplitude.take(order, axis=1)
    lives = [
        [_life(size, least, fading, n_blocks + 1) for size, fading in zip(sizes, rate, strict=True)]
        for sizes, least in zip(np.abs(ordered).tolist(), threshold, strict=True)
    ]
    # Exponentials that are zero on some channels are computed there too: skipping them would save less than a tenth.
    if all(map(any, lives)):
        _write_rows(coarse, ordered, fine, list(map(max, zip(*lives, strict=True))), out)
        return
    for channel, alive_for in enumerate(lives):
        row = slice(channel, channel + 1)
        _write_rows(coarse, ordered[row], fine, alive_for, out[row])


@lru_cache(maxsize=4)
def _by_decay_time(
    exponents: bytes, hold: float, n_blocks: int
) -> tuple[NDArray[np.intp], ComplexArray, ComplexArray, list[float]]:
    """Sort exponentials by increasing decay rate; return the order, the sorted tables and decay rates per block."""
    exponent = np.frombuffer(exponents, dtype=complex)
    fine, coarse = exponential_tables(exponent, hold, n_blocks)
    order = np.argsort(-exponent.real, kind="stable")
    rate = -exponent.real[order] * (hold * BLOCK)
    # The real part of a product is the dot product of one factor with the conjugate of the other, as real 2-vectors.
    return order, fine[order], np.ascontiguousarray(coarse[:, order].conj()), rate.tolist()


def _life(size: float, threshold: float, rate: float, longest: int) -> int:
    """Return the number of last blocks in which an exponential matters, rounded up to a multiple of `_STEP`."""
    if size <= threshold:
        return 0
    if threshold == 0.0:
        return longest
    loudness = math.log(size / threshold)
    return longest if loudness >= rate * longest else min(longest, (int(loudness / rate) // _STEP + 1) * _STEP)


def _write_rows(
    coarse: ComplexArray, amplitude: ComplexArray, fine: ComplexArray, alive_for: list[int], rows: FloatArray
) -> None:
    """Write channels in stretches of blocks, each computed with the leading exponentials that matter in it.

    Stretches too short for a separate matrix product are merged into the next, longer one.
    """
    if not any(alive_for):
        rows[:] = 0.0
        return
    n_blocks, head = divmod(rows.shape[1], BLOCK)
    reach = max(alive_for)
    rows[:, : max(0, head + (n_blocks - reach) * BLOCK)] = 0.0
    turned = amplitude[:, :, None] * fine
    right = np.empty((*turned.shape[:2], 2, BLOCK))
    right[:, :, 0], right[:, :, 1] = turned.real, turned.imag
    left, right = coarse.view(np.float64), right.reshape(len(rows), -1, BLOCK)
    body = rows[:, head:].reshape(len(rows), n_blocks, BLOCK)
    for n_alive in range(1, len(alive_for) + 1):
        shorter = max(alive_for[n_alive:], default=0)
        if reach - shorter < _WORTH and shorter:
            continue
        first, last, used = n_blocks - reach, n_blocks - shorter, right[:, : 2 * n_alive]
        if first < 0:
            first = 0
            np.matmul(left[0, : 2 * n_alive], used[:, :, BLOCK - head :], out=rows[:, :head])
        np.matmul(left[first + 1 : last + 1, : 2 * n_alive], used, out=body[:, first:last])
        reach = shorter
