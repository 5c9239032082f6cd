"""Tail probabilities of sums of independent integers, by convolution.

Small problems are convolved directly: all terms are positive, so p is accurate to machine precision. Large problems use
the FFT of the exponentially tilted distribution, centred on the tail; this keeps the *relative* error of even the
smallest p near 1e-10 (without tilting, the FFT loses all p below 1e-16).

References
----------
Keich, "Efficiently computing p-values by exponential shifts", J. Comput. Biol. 12 (2005) 416-430.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

DIRECT_COST = 100_000_000
"""Maximum number of additions for direct convolution; about 0.15 s."""

_STEEPEST = 50.0
"""Tilt that concentrates a sum of integers at the end of its range [1]."""


@dataclass(frozen=True, eq=False)
class Kernel:
    """The distribution of a score, and the number of participants with this distribution.

    Attributes
    ----------
    distribution : (steps, weights)
        Values of the score in increasing order, and their probabilities [1].
    count : int
        Number of participants.
    """

    distribution: tuple[IntArray, FloatArray]
    count: int

    @property
    def ends(self) -> tuple[int, int]:
        """Lowest and highest score."""
        return int(self.distribution[0][0]), int(self.distribution[0][-1])


def tail_probability(kernels: Sequence[Kernel], lower: int, upper: int) -> float:
    """Return the two-sided tail probability P(sum <= lower) + P(sum >= upper) [1].

    Parameters
    ----------
    kernels : sequence of Kernel
        Distributions of the independent terms of the sum.
    lower, upper : int
        Bounds of the two tails, lower < upper.
    """
    width = sum(kernel.count * (kernel.ends[1] - kernel.ends[0]) for kernel in kernels) + 1
    n_copies = sum(kernel.count * len(kernel.distribution[0]) for kernel in kernels)
    if n_copies * width <= 2 * DIRECT_COST:
        offset, pmf = _add_copies(kernels)
        low, high = max(lower - offset + 1, 0), max(upper - offset, 0)
        return float(pmf[:low].sum() + pmf[high:].sum())
    return _tilted_tail(kernels, upper, 1) + _tilted_tail(kernels, lower, -1)


def _add_copies(kernels: Sequence[Kernel]) -> tuple[int, FloatArray]:
    offset, pmf = 0, np.ones(1)
    for kernel in kernels:
        steps, weights = kernel.distribution
        low, high = kernel.ends
        for _ in range(kernel.count):
            grown = np.zeros(pmf.size + high - low)
            for step, weight in zip((steps - low).tolist(), weights.tolist(), strict=True):
                grown[step : step + pmf.size] += weight * pmf
            offset, pmf = offset + low, grown
    return offset, pmf


def _tilted_tail(kernels: Sequence[Kernel], bound: int, side: int) -> float:
    """Return P(sum >= bound) for side 1, P(sum <= bound) for side -1."""
    parts = [
        (steps * side, weights, kernel.count)
        for kernel in kernels
        for steps, weights in [(kernel.distribution[0], kernel.distribution[1])]
    ]
    target = bound * side
    top = sum(count * int(steps.max()) for steps, _, count in parts)
    if target > top:
        return 0.0
    if target == top:
        return math.exp(sum(count * math.log(float(weights[np.argmax(steps)])) for steps, weights, count in parts))
    tilt = _tilt_towards(parts, target)
    mean, deviation = _moments(parts, tilt)
    span = max(int(steps.max() - steps.min()) for steps, _, _ in parts)
    # The tilted probability this far from the mean is negligible, so a window replaces the full range.
    margin = 14 * deviation + 40 * span
    last = min(top, math.ceil(mean + margin))
    size = 1 << max(last - min(target, math.floor(mean - margin)), span + 1).bit_length()
    spectrum = np.ones(size // 2 + 1, dtype=complex)
    log_scale, origin = 0.0, 0
    for steps, weights, count in parts:
        first = int(steps.min())
        tilted = np.zeros(size)
        log_weight = np.log(weights) + tilt * (steps - first)
        log_sum = float(np.logaddexp.reduce(log_weight))
        tilted[steps - first] = np.exp(log_weight - log_sum)
        spectrum *= np.fft.rfft(tilted) ** count
        log_scale += count * log_sum
        origin += count * first
    reach = np.arange(target, last + 1) - origin
    pmf = np.maximum(np.fft.irfft(spectrum, size)[reach % size], 1e-300)
    return float(np.sum(np.exp(log_scale - tilt * reach + np.log(pmf))))


def _tilt_towards(parts: Sequence[tuple[IntArray, FloatArray, int]], target: int) -> float:
    """Find the non-negative exponential tilt for which the mean of the sum equals the target."""
    from scipy.optimize import brentq

    def short(tilt: float) -> float:
        return target - _moments(parts, tilt)[0]

    if short(0.0) <= 0:
        return 0.0
    return _STEEPEST if short(_STEEPEST) > 0 else float(brentq(short, 0.0, _STEEPEST))


def _moments(parts: Sequence[tuple[IntArray, FloatArray, int]], tilt: float) -> tuple[float, float]:
    """Return mean and standard deviation of the tilted sum."""
    mean = variance = 0.0
    for steps, weights, count in parts:
        log_weight = np.log(weights) + tilt * (steps - steps.max())
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        centre = float((steps * weight).sum())
        mean += count * centre
        variance += count * float(((steps - centre) ** 2 * weight).sum())
    return mean, math.sqrt(variance)
