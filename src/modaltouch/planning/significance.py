"""The exact tests of the analysis, for thousands of experiments at once.

Scores of participants are independent, so the distribution of their sum is a convolution: a product of
characteristic functions. A participant's function depends only on the size of the score, so a whole test is one
row of counts (participants of each size) times one table of logarithms, the null distributions being shared by all
experiments. Absolute error is near 1e-14, which no level of significance can see; `modaltouch.analysis.exact` and
`modaltouch.analysis.trend` give the same p with full relative accuracy, one test at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis import draws_without_replacement, level_scores

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

LEAST_P = 1e-14
"""Smaller p are given as this."""

_AT_ONCE = 1_000_000
"""Entries of the largest temporary array."""

_EXACT_UP_TO = 40
"""Signs of so many participants give p in steps that rounding can tell apart."""


def sign_flip_p(scores: ArrayLike) -> FloatArray:
    """Return the p of exact sign-flip tests of net scores, (..., n_participants) array of int, as (...,) array [1]."""
    values = np.asarray(scores)
    sizes = np.abs(values)
    largest = int(sizes.max(initial=0))
    if largest == 0:
        return np.ones(values.shape[:-1])
    counts = _count(sizes.reshape(-1, values.shape[-1]), range(1, largest + 1))
    total = np.abs(values.sum(axis=-1)).reshape(-1).astype(np.int64)
    p = _once_each(np.column_stack([counts, total]), values.shape[-1] * largest, _sign_flip_rows)
    return p.reshape(values.shape[:-1])


def trend_p(chosen: ArrayLike, levels: Sequence[float], n_repetitions: int = 1) -> FloatArray:
    """Return the p of exact trend tests, as `modaltouch.analysis.trend.trend_test`, (...,) array [1].

    Parameters
    ----------
    chosen : (..., n_participants, n_levels) array of int
        How often the answer was chosen at each level; the last two axes are one test.
    levels : sequence of float
        Levels, as scores of the trend.
    n_repetitions : int
        Presentations of each level.
    """
    values = np.asarray(chosen)
    scores = level_scores(levels)
    n_answers = n_repetitions * len(scores)
    shape = values.shape[:-2]
    if scores.max() == 0 or values.size == 0:
        return np.ones(shape)
    totals = values.sum(axis=-1)
    moving = (totals > 0) & (totals < n_answers)
    counts = _count(totals.reshape(-1, totals.shape[-1]), range(1, n_answers))
    observed = np.where(moving, values @ scores, 0).sum(axis=-1).reshape(-1)

    def rows(some: IntArray) -> FloatArray:
        return _trend_rows(some, tuple(scores.tolist()), n_repetitions)

    p = _once_each(np.column_stack([counts, observed]), int(scores.max()) * n_answers * totals.shape[-1], rows)
    return p.reshape(shape)


def multinomial_p(counts: ArrayLike) -> FloatArray:
    """Return the p of multinomial tests of three counts, (..., 3) array, against equal chances, (...,) array [1]."""
    values = np.sort(np.asarray(counts, dtype=np.int64), axis=-1)
    totals = values.sum(axis=-1)
    p = np.ones(totals.shape)
    for n in np.unique(totals).tolist():
        here = totals == n
        some = values[here]
        p[here] = _multinomial_table(n)[some[:, 0], some[:, 1]]
    return p


def holm_p(p: FloatArray) -> FloatArray:
    """Return Holm's adjusted p within families along the last axis, (..., n_tests) array [1]."""
    order = np.argsort(p, axis=-1, kind="stable")
    steps = np.arange(p.shape[-1], 0, -1)
    rising = np.maximum.accumulate(np.minimum(np.take_along_axis(p, order, axis=-1) * steps, 1.0), axis=-1)
    adjusted = np.empty_like(rising)
    np.put_along_axis(adjusted, order, rising, axis=-1)
    return adjusted


def _count(values: NDArray[np.integer], sizes: range) -> IntArray:
    """Return how many participants of each test have each size, (n_tests, n_sizes) array."""
    return np.column_stack([(values == size).sum(axis=1) for size in sizes]).astype(np.int64)


def _once_each(keys: IntArray, most: int, compute: Callable[[IntArray], FloatArray]) -> FloatArray:
    """Compute each different row once, where a row fits into one whole number; else every row."""
    n_participants = int(keys[:, :-1].sum(axis=1).max())
    if (keys.shape[1] - 1) * np.log2(n_participants + 1) + np.log2(most + 1) >= 62:
        return compute(keys)
    code = keys[:, -1].copy()
    for column in keys[:, :-1].T:
        code = code * (n_participants + 1) + column
    _, first, inverse = np.unique(code, return_index=True, return_inverse=True)
    return np.asarray(compute(keys[first])[inverse])


def _sign_flip_rows(keys: IntArray) -> FloatArray:
    """Return p for rows of counts of the sizes 1, 2, ... and the size of the sum."""
    counts, total = keys[:, :-1], keys[:, -1]
    sizes = np.arange(1, counts.shape[1] + 1)
    reach = counts @ sizes
    # With b the sum of the sizes that count as minus, the sum is reach - 2 b; b lies on 0 ... reach.
    nodes = _Nodes(int(reach.max()))
    turned = np.cos(nodes.angles * sizes[:, None])
    log_size, negative = np.log(np.abs(turned)), (turned < 0).astype(float)

    def tail(rows: slice) -> FloatArray:
        some = counts[rows].astype(float)
        product = np.exp(_times(some, log_size)) * (1 - 2 * (_times(some, negative) % 2))
        wave = nodes.sine(reach[rows] + 1) - nodes.sine(total[rows] - 1)
        inner = np.einsum("tk,tk,k->t", product, wave, 1 / np.sin(nodes.angles))
        return np.asarray(((reach[rows] - total[rows]) / 2 + 1 + inner) / nodes.period)

    n_informative = counts.sum(axis=1)
    p = np.where(total == 0, 1.0, np.minimum(2 * _in_slices(tail, len(keys), nodes), 1.0))
    steps = 2.0 ** np.minimum(n_informative, _EXACT_UP_TO)
    p = np.where(n_informative <= _EXACT_UP_TO, np.rint(p * steps) / steps, p)
    return np.asarray(np.maximum(p, np.maximum(2.0 ** (1.0 - np.maximum(n_informative, 1)), LEAST_P)))


def _trend_rows(keys: IntArray, scores: tuple[int, ...], n_repetitions: int) -> FloatArray:
    """Return p for rows of counts of the totals 1, 2, ... and the observed sum of scores."""
    counts, observed = keys[:, :-1], keys[:, -1]
    n_levels, drawn = len(scores), np.arange(1, counts.shape[1] + 1)
    laws = draws_without_replacement(np.array(scores, dtype=np.int64), n_repetitions)[1:-1]
    lowest = counts @ np.array([sums[0] for sums, _ in laws])
    highest = counts @ np.array([sums[-1] for sums, _ in laws])
    # Everything is multiplied by the number of levels, so that the expectation is a whole number too.
    expected = counts @ drawn * sum(scores)
    distance = np.abs(observed * n_levels - expected)
    first = np.maximum((expected - distance) // n_levels + 1 - lowest, 0)
    last = np.minimum(-(-(expected + distance) // n_levels) - 1, highest) - lowest
    nodes = _Nodes(int((highest - lowest).max()))
    waves = np.stack([weights @ np.exp(2j * (sums - sums[0])[:, None] * nodes.angles) for sums, weights in laws])
    log_size, turn = np.log(np.maximum(np.abs(waves), 1e-300)), np.angle(waves)

    def between(rows: slice) -> FloatArray:
        some, width = counts[rows].astype(float), last[rows] - first[rows] + 1
        phase = _times(some, turn) - (first[rows] + last[rows])[:, None] * nodes.angles
        product = np.exp(_times(some, log_size)) * np.cos(phase)
        inner = np.einsum("tk,tk,k->t", product, nodes.sine(width), 1 / np.sin(nodes.angles))
        return np.asarray((width + 2 * inner) / nodes.period)

    p = 1 - _in_slices(between, len(keys), nodes)
    return np.where(distance == 0, 1.0, np.clip(p, LEAST_P, 1.0))


def _times(rows: FloatArray, table: FloatArray) -> FloatArray:
    """Return the matrix product in one thread, whose sums are the same on every machine and beside every process."""
    return np.asarray(np.einsum("ts,sk->tk", rows, table))


class _Nodes:
    """Half the angles at which characteristic functions are read: as many as a sum from 0 to `width` needs."""

    def __init__(self, width: int) -> None:
        # An odd number of nodes: no cosine of a whole multiple is zero.
        self.period = (width + 1) | 1
        self._place = np.arange(1, (self.period - 1) // 2 + 1)
        self.angles = np.pi * self._place / self.period
        self._table = np.sin(np.pi * np.arange(2 * self.period) / self.period)

    @property
    def n_nodes(self) -> int:
        """Number of angles."""
        return int(self._place.size)

    def sine(self, multiples: IntArray) -> FloatArray:
        """Return the sines of whole multiples of the angles, (n_multiples, n_nodes) array."""
        return np.asarray(self._table[(multiples[:, None] * self._place) % (2 * self.period)])


def _in_slices(compute: Callable[[slice], FloatArray], n_rows: int, nodes: _Nodes) -> FloatArray:
    """Compute rows in slices of bounded memory."""
    step = max(1, _AT_ONCE // max(nodes.n_nodes, 1))
    return np.concatenate([compute(slice(start, start + step)) for start in range(0, n_rows, step)])


@lru_cache(maxsize=1024)
def _multinomial_table(n: int) -> FloatArray:
    """Return p by the smallest and the middle count of n answers."""
    from modaltouch.analysis import multinomial_tests

    outcomes = [
        (low, middle, n - low - middle) for low in range(n // 3 + 1) for middle in range(low, (n - low) // 2 + 1)
    ]
    table = np.ones((n // 3 + 1, n // 2 + 1))
    tests = multinomial_tests(outcomes)
    for (low, middle, _), test in zip(outcomes, tests, strict=True):
        table[low, middle] = test.p
    return table
