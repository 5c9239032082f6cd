"""Tail probabilities of sums of independent integer scores of participants, for batches of tests.

Each score has one of a few distributions (`laws`), so a test is a row of counts: the number of participants with each
distribution.

`Sums.tails` convolves test by test. Small problems are convolved directly: all terms are positive, so even the smallest
p is accurate to machine precision. Large problems use the FFT, with an absolute error
below 1e-13.

`Sums.quick_tails` multiplies characteristic functions, as the product of the counts and a table of logarithms shared by
all tests. Its absolute error is near 1e-14, negligible at any significance level, and thousands of tests take
milliseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]
Law = tuple[IntArray, FloatArray]
"""Values in increasing order, and their probabilities [1]."""
Term = tuple[IntArray, FloatArray, int]
"""A distribution, and the number of participants whose score has it."""

LEAST_P = 1e-14
"""Lower limit of approximate p values [1]."""

DIRECT_COST = 100_000_000
"""Maximum number of additions for direct convolution; about 0.15 s."""

# Number of equal terms above which the transform of one is raised to their number.
_FEW_COPIES = 16

# Below this fraction of the frequencies, the rest of the characteristic function is computed one by one; and the
# magnitude below which it does not count.
_FEW_ALIVE, _NEGLIGIBLE = 64, 1e-25

# Maximum size of temporary arrays.
_AT_ONCE = 1_000_000


@dataclass(frozen=True, eq=False)
class Sums:
    """Null distributions of sums of integers.

    Attributes
    ----------
    laws : sequence of (values, probabilities)
        Possible distributions of a participant's score.
    means : (n_laws,) array of int
        Mean of each distribution times `scale`, so that distances from the mean are integers.
    scale : int
        Factor that makes the means integers.
    counts : (n_tests, n_laws) array of int
        Number of participants with each distribution, by test.
    """

    laws: Sequence[Law]
    means: IntArray
    scale: int
    counts: IntArray

    @cached_property
    def mean(self) -> IntArray:
        """Mean of each sum, times `scale`."""
        return np.asarray(self.counts @ self.means)

    @cached_property
    def lowest(self) -> IntArray:
        """Lowest value of each sum."""
        return np.asarray(self.counts @ np.array([values[0] for values, _ in self.laws], dtype=np.int64))

    @cached_property
    def highest(self) -> IntArray:
        """Highest value of each sum."""
        return np.asarray(self.counts @ np.array([values[-1] for values, _ in self.laws], dtype=np.int64))

    @property
    def farthest(self) -> IntArray:
        """Largest possible distance of each sum from its mean, times `scale`."""
        return np.asarray(np.maximum(self.mean - self.lowest * self.scale, self.highest * self.scale - self.mean))

    def tails(self, distance: IntArray) -> FloatArray:
        """Return the probability of at least this distance of each sum from its mean, (n_tests,) array [1].

        Parameters
        ----------
        distance : (n_tests,) array of int
            Distance from the mean times `scale`, on either side.
        """
        p = np.ones(len(distance))
        for row in np.flatnonzero(distance):
            terms = [(*law, int(n)) for law, n in zip(self.laws, self.counts[row], strict=True) if n]
            lower, upper = (
                (self.mean[row] - distance[row]) // self.scale,
                -((-self.mean[row] - distance[row]) // self.scale),
            )
            p[row] = tail_probability(terms, int(lower), int(upper))
        return p

    def quick_tails(self, distance: IntArray) -> FloatArray:
        """Approximate `tails` to within 1e-13, clipped at `LEAST_P`, for thousands of sums."""
        if not distance.any():
            return np.ones(len(distance))
        first, inverse = distinct_rows(np.column_stack([self.counts, distance]))
        some = Sums(self.laws, self.means, self.scale, self.counts[first])
        return np.asarray(some._transformed(distance[first])[inverse])

    def _transformed(self, distance: IntArray) -> FloatArray:
        from scipy.sparse import csr_array

        # Count in steps from the lowest value, so that a sum has values from 0 to width.
        unit = int(np.gcd.reduce(np.concatenate([values - values[0] for values, _ in self.laws])))
        width = (self.highest - self.lowest) // unit
        first = np.maximum(((self.mean - distance) // self.scale - self.lowest) // unit + 1, 0)
        last = np.minimum(-((-self.mean - distance) // self.scale) - self.lowest - 1, width * unit) // unit
        # The characteristic function is evaluated at half-angles. With an odd period, no cosine of an integer multiple
        # is zero.
        period = (int(width.max()) + 1) | 1
        place = np.arange(1, (period - 1) // 2 + 1)
        angles, sines = np.pi * place / period, np.sin(np.pi * np.arange(2 * period) / period)
        # Distributions wider than the period do not occur in any sum.
        steps = (np.bincount((values - values[0]) // unit, weights) for values, weights in self.laws)
        waves = np.stack([np.fft.rfft(each, period)[1:] for each in steps])
        log_size, turn = np.log(np.maximum(np.abs(waves), 1e-300)), -np.angle(waves)

        def between(rows: slice) -> FloatArray:
            # The product of a sparse matrix runs in a single thread, so that its rounding is reproducible.
            counts, n_values = csr_array(self.counts[rows].astype(float)), last[rows] - first[rows] + 1
            phase = counts @ turn - (first[rows] + last[rows])[:, None] * angles
            product = np.exp(counts @ log_size) * np.cos(phase)
            sine = sines[(n_values[:, None] * place) % (2 * period)]
            inner = np.einsum("tk,tk,k->t", product, sine, 1 / np.sin(angles))
            return np.asarray((n_values + 2 * inner) / period)

        step = max(1, _AT_ONCE // max(place.size, 1))
        p = 1 - np.concatenate([between(slice(start, start + step)) for start in range(0, len(distance), step)])
        return np.where(distance == 0, 1.0, np.clip(p, LEAST_P, 1.0))


def distinct_rows(table: IntArray) -> tuple[IntArray, IntArray]:
    """Return the index of each distinct row, in lexicographic order, and the inverse indices.

    Parameters
    ----------
    table : (n_rows, n_columns) array of int
        Values from 0.
    """
    code, size = np.zeros(len(table), dtype=np.int64), 1
    for column in table.T:
        n_values = int(column.max(initial=0)) + 1
        if size * n_values >= 2**62:
            known, code = np.unique(code, return_inverse=True)
            size = known.size
        code, size = code * n_values + column, size * n_values
    _, first, inverse = np.unique(code, return_index=True, return_inverse=True)
    return first, inverse


def tail_probability(terms: Sequence[Term], lower: int, upper: int) -> float:
    """Return the two-sided tail probability P(sum <= lower) + P(sum >= upper) [1].

    Parameters
    ----------
    terms : sequence of (values, probabilities, count)
        Distributions of the independent terms of the sum, and how many terms have each.
    lower, upper : int
        Bounds of the two tails, lower < upper.
    """
    width = sum(count * int(values[-1] - values[0]) for values, _, count in terms) + 1
    n_copies = sum(count * len(values) for values, _, count in terms)
    if n_copies * width <= 2 * DIRECT_COST:
        offset, pmf = _add_copies(terms)
        low, high = max(lower - offset + 1, 0), max(upper - offset, 0)
        return float(pmf[:low].sum() + pmf[high:].sum())
    return min(max(_transformed_tails(terms, lower, upper), LEAST_P), 1.0)


def _add_copies(terms: Sequence[Term]) -> tuple[int, FloatArray]:
    offset, pmf = 0, np.ones(1)
    for values, weights, count in terms:
        for _ in range(count):
            offset, pmf = offset + int(values[0]), _add_term(pmf, values - values[0], weights)
    return offset, pmf


def _add_term(pmf: FloatArray, steps: IntArray, weights: FloatArray) -> FloatArray:
    """Return the distribution of a sum with one more term, whose values are counted from its lowest."""
    grown = np.zeros(pmf.size + int(steps.max()))
    for step, weight in zip(steps.tolist(), weights.tolist(), strict=True):
        grown[step : step + pmf.size] += weight * pmf
    return grown


def _transformed_tails(terms: Sequence[Term], lower: int, upper: int) -> float:
    """Compute `tail_probability` by FFT, with an absolute error below 1e-13."""
    means = [float(steps @ weights) for steps, weights, _ in terms]
    mean = sum(count * each for (_, _, count), each in zip(terms, means, strict=True))
    variance = sum(
        count * float((steps - each) ** 2 @ weights) for (steps, weights, count), each in zip(terms, means, strict=True)
    )
    span = max(int(steps[-1] - steps[0]) for steps, _, _ in terms)
    # A window replaces the full range: beyond it lie less than exp(-45) of the sum, by Bernstein's inequality.
    margin = 15 * span + math.sqrt((15 * span) ** 2 + 90 * variance)
    first, last = math.floor(mean - margin), math.ceil(mean + margin)
    size = 1 << (last - first + 1).bit_length()
    spectrum, block = np.ones(size // 2 + 1, dtype=complex), np.ones(1)
    alive = np.arange(spectrum.size)
    for values, weights, count in terms:
        steps = values - values[0]
        if alive.size < size // _FEW_ALIVE:
            angle = 2 * np.pi / size * (steps[:, np.newaxis] * alive % size)
            spectrum[alive] *= (weights @ np.exp(-1j * angle)) ** count
        elif count > _FEW_COPIES:
            spectrum *= np.fft.rfft(_add_term(np.ones(1), steps, weights), size) ** count
        else:
            # Terms with many different distributions are added up before they are transformed together.
            if block.size + count * span > size // 4:
                spectrum *= np.fft.rfft(block, size)
                block = np.ones(1)
                # A product of a hundred factors is negligible at most frequencies, where no more need be computed.
                alive = np.flatnonzero(np.abs(spectrum) > _NEGLIGIBLE)
            for _ in range(count):
                block = _add_term(block, steps, weights)
    spectrum *= np.fft.rfft(block, size)
    lowest = sum(count * int(values[0]) for values, _, count in terms)
    inner = np.arange(max(lower + 1, first), min(upper, last + 1))
    return 1 - float(np.fft.irfft(spectrum, size)[(inner - lowest) % size].sum())
