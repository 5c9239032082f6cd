"""Tail probabilities of sums of independent integer scores of participants, for batches of tests.

Each score has one of a few distributions (`laws`), so a test is a row of counts: the number of participants with each
distribution.

`Sums.tails` convolves test by test, with relative accuracy for the smallest p. `Sums.quick_tails` multiplies
characteristic functions, as the product of the counts and a table of logarithms shared by all tests. Its absolute error
is near 1e-14, negligible at any significance level, and thousands of tests take milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.analysis.convolution import Kernel, tail_probability

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]
Law = tuple[IntArray, FloatArray]
"""Values in increasing order, and their probabilities [1]."""

LEAST_P = 1e-14
"""Lower limit of the approximate p of batches of tests [1]."""

_AT_ONCE = 1_000_000
"""Maximum size of temporary arrays."""


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
            kernels = [Kernel(law, int(n)) for law, n in zip(self.laws, self.counts[row], strict=True) if n]
            lower, upper = (
                (self.mean[row] - distance[row]) // self.scale,
                -((-self.mean[row] - distance[row]) // self.scale),
            )
            p[row] = tail_probability(kernels, int(lower), int(upper))
        return p

    def quick_tails(self, distance: IntArray) -> FloatArray:
        """Approximate `tails` to within 1e-13, clipped at `LEAST_P`, for thousands of sums."""
        if not distance.any():
            return np.ones(len(distance))
        first, inverse = _different_rows(self.counts, distance)
        some = Sums(self.laws, self.means, self.scale, self.counts[first])
        return np.asarray(some._transformed(distance[first])[inverse])

    def _transformed(self, distance: IntArray) -> FloatArray:
        # Count in steps from the lowest value, so that a sum has values from 0 to width.
        unit = int(np.gcd.reduce(np.concatenate([values - values[0] for values, _ in self.laws])))
        width = (self.highest - self.lowest) // unit
        first = np.maximum(((self.mean - distance) // self.scale - self.lowest) // unit + 1, 0)
        last = np.minimum(-((-self.mean - distance) // self.scale) - self.lowest - 1, width * unit) // unit
        nodes = _Nodes(int(width.max()))
        # Distributions wider than the period do not occur in any sum.
        steps = (np.bincount((values - values[0]) // unit, weights) for values, weights in self.laws)
        waves = np.stack([np.fft.rfft(each, nodes.period)[1:] for each in steps])
        log_size, turn = np.log(np.maximum(np.abs(waves), 1e-300)), -np.angle(waves)

        def between(rows: slice) -> FloatArray:
            counts, n_values = self.counts[rows].astype(float), last[rows] - first[rows] + 1
            phase = _times(counts, turn) - (first[rows] + last[rows])[:, None] * nodes.angles
            product = np.exp(_times(counts, log_size)) * np.cos(phase)
            inner = np.einsum("tk,tk,k->t", product, nodes.sine(n_values), 1 / np.sin(nodes.angles))
            return np.asarray((n_values + 2 * inner) / nodes.period)

        step = max(1, _AT_ONCE // nodes.n_nodes)
        p = 1 - np.concatenate([between(slice(start, start + step)) for start in range(0, len(distance), step)])
        return np.where(distance == 0, 1.0, np.clip(p, LEAST_P, 1.0))


def _different_rows(counts: IntArray, distance: IntArray) -> tuple[IntArray, IntArray]:
    """Return the indices of unique tests, and the inverse indices; all tests if rows do not fit into an integer key."""
    n_participants, farthest = int(counts.sum(axis=1).max()), int(distance.max())
    if counts.shape[1] * np.log2(n_participants + 1) + np.log2(farthest + 1) >= 62:
        every = np.arange(len(counts))
        return every, every
    code = distance.copy()
    for column in counts.T:
        code = code * (n_participants + 1) + column
    _, first, inverse = np.unique(code, return_index=True, return_inverse=True)
    return first, inverse


def _times(rows: FloatArray, table: FloatArray) -> FloatArray:
    """Return the matrix product, computed in a single thread so that its rounding is reproducible."""
    return np.asarray(np.einsum("ts,sk->tk", rows, table))


class _Nodes:
    """Half-angles of the nodes at which the characteristic functions of sums from 0 to `width` are evaluated."""

    def __init__(self, width: int) -> None:
        # With an odd period, no cosine of an integer multiple is zero.
        self.period = (width + 1) | 1
        self._place = np.arange(1, (self.period - 1) // 2 + 1)
        self.angles = np.pi * self._place / self.period
        self._table = np.sin(np.pi * np.arange(2 * self.period) / self.period)
        self.n_nodes = max(int(self._place.size), 1)

    def sine(self, multiples: IntArray) -> FloatArray:
        """Return the sines of integer multiples of the angles, (n_multiples, n_nodes) array."""
        return np.asarray(self._table[(multiples[:, None] * self._place) % (2 * self.period)])
