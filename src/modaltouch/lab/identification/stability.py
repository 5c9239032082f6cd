"""Poles by model order for a stability diagram: least-squares complex frequency domain (Guillaume et al. 2003)."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from modaltouch.lab.arrays import ComplexArray, FloatArray
from modaltouch.lab.identification.responses import FrequencyResponses

HIGHEST_ORDER = 50
"""Highest order of the denominator, in each band."""

BAND = 16.0
"""Highest over lowest frequency of a band [1]: one polynomial basis cannot resolve more."""

STABLE_FREQUENCY, STABLE_DAMPING = 0.01, 0.05
"""Largest relative changes of a stable pole from one order to the next [1]."""

HIGHEST_DAMPING = 0.2
"""Damping ratio above which a pole is not shown [1]."""


def poles_by_order(responses: FrequencyResponses) -> FloatArray:
    """Return the poles of every model order, fitted to all responses over their noise.

    Returns
    -------
    (4, n_poles) array
        Order, natural frequency [Hz], damping ratio, and stability: 0 for a new pole, 1 if the previous order has a
        pole of the same frequency, 2 if of the same damping ratio too.
    """
    frequency, white = responses.frequency, responses.response / np.sqrt(responses.noise)[:, None]
    n_bands = max(1, math.ceil(math.log(frequency[-1] / frequency[0]) / math.log(BAND)))
    edges = np.geomspace(frequency[0], frequency[-1], n_bands + 1)
    found = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        near = (frequency >= low / 1.2) & (frequency <= high * 1.2)
        before = np.full((4, 1), np.inf)
        for poles in _poles(frequency[near], white[..., near].reshape(-1, int(near.sum()))):
            _, own, ratio, stable = poles = poles[:, (poles[1] >= low) & (poles[1] <= high)]
            same = np.abs(before[1] / own[:, None] - 1) <= STABLE_FREQUENCY
            alike = same & (np.abs(before[2] / ratio[:, None] - 1) <= STABLE_DAMPING)
            stable[:] = same.any(axis=1) * 1.0 + alike.any(axis=1)
            before = poles
            found.append(poles)
    return np.concatenate(found, axis=1)


def _poles(frequency: FloatArray, white: ComplexArray) -> Iterator[FloatArray]:
    """Yield the poles of a common denominator of each order, with numerators of the same order.

    With the highest coefficient fixed at 1, spurious poles are unstable. All matrices of sums over bins are Toeplitz.
    """
    from scipy.linalg import toeplitz

    rate = float(frequency[-1] - frequency[0])
    # For a single response the coefficients of numerator and denominator must remain fewer than the bins.
    orders = np.arange(min(HIGHEST_ORDER, frequency.size // 3) + 1)
    basis = np.exp(-2j * np.pi * np.outer(orders, (frequency - frequency[0]) / rate))
    alone, power = basis.sum(axis=1), basis @ (np.abs(white) ** 2).sum(axis=0)
    mixed = [toeplitz(column, row) for row, column in zip(white @ basis.T, white @ basis.conj().T, strict=True)]
    # The Cholesky factor of a lower order is the leading block of that of a higher one: the numerators' contribution
    # adds up row by row.
    taken = np.linalg.solve(np.linalg.cholesky(toeplitz(alone.conj(), alone)), np.array(mixed))
    left = toeplitz(power.conj(), power)
    for n in orders:
        left = left - taken[:, n].conj().T @ taken[:, n]
        if n > 1:
            coefficient = np.append(np.linalg.solve(left[:n, :n], -left[:n, n]), 1.0)
            pole = -np.log(np.roots(coefficient[::-1])) * rate / (2 * np.pi)
            damped = frequency[0] + np.mod(pole.imag, rate)
            own = np.hypot(damped, pole.real)
            shown = (pole.real < 0) & (-pole.real < HIGHEST_DAMPING * own)
            yield np.stack([0.0 * own + n, own, -pole.real / own, 0.0 * own])[:, shown]
