"""Theoretical mode shapes of a free-free beam, accurate to rounding at any label, and the modal gains of patches."""

from __future__ import annotations

import math
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.quantities import FloatArray

_ASIN_ITERATIONS = 12
"""The iteration contracts by sech(4.73) = 0.018 at worst: twelve steps converge in double precision."""


@cache
def characteristic_root(bending: int) -> float:
    r"""Return the root of :math:`\cos\lambda\,\cosh\lambda = 1` of a bending mode [1].

    The root is :math:`(2n+1)\pi/2 + d` with :math:`\sin d = (-1)^{n+1} \operatorname{sech} \lambda`, a fixed-point
    iteration for the small `d`; cosh is never computed, so that no mode overflows.

    Parameters
    ----------
    bending : int
        Number n of the bending mode, from 1.

    Examples
    --------
    >>> round(characteristic_root(1), 9)
    4.730040745
    """
    middle = (2 * bending + 1) * math.pi / 2
    sign = 1.0 if bending % 2 else -1.0
    deviation = 0.0
    for _ in range(_ASIN_ITERATIONS):
        decay = math.exp(-(middle + deviation))
        deviation = sign * math.asin(2 * decay / (1 + decay * decay))
    return middle + deviation


def mode_shapes(label: ArrayLike, position: ArrayLike, length: float) -> FloatArray:
    r"""Return the mode shapes of a uniform free-free Euler-Bernoulli beam [1].

    Label 1 is the rigid translation, 2 the rigid rotation, k >= 3 the bending mode n = k - 2. Each has unit
    mean square over the beam and is positive at its right end. With y = x/L a symmetric bending mode is

    .. math:: \frac{\cos \lambda y}{\cos \lambda/2}
       + \frac{e^{-\lambda(1/2-|y|)} + e^{-\lambda(1/2+|y|)}}{1 + e^{-\lambda}},

    an antisymmetric one its sine analogue. Neither contains a growing exponential, so both are accurate to rounding at
    any label, whereas the textbook difference of cosh and sinh loses all digits from n = 12 on.

    Parameters
    ----------
    label : (n_modes,) array_like of int
        Mode labels of the paper, from 1.
    position : (n_points,) array_like
        Coordinate along the beam, origin at its middle [m].
    length : float
        Length of the beam [m].

    Returns
    -------
    (n_modes, n_points) array
        Mode shapes [1].

    Raises
    ------
    ValueError
        If a position lies off the beam.

    References
    ----------
    Goncalves, Brennan, Peplow, Tang (2018); Khasawneh and Segalman (2019), arXiv 1811.03222.
    """
    labels = np.atleast_1d(np.asarray(label))
    y = scaled_position(position, length)
    shapes = np.empty((labels.size, y.size))
    shapes[labels == 1], shapes[labels == 2] = 1.0, math.sqrt(12.0) * y
    for parity in (0, 1):
        rows = np.flatnonzero((labels > 2) & (labels % 2 == parity))
        shapes[rows] = _bending(labels[rows].tolist(), y, symmetric=parity == 1)
    return shapes


def scaled_position(position: ArrayLike, length: float) -> FloatArray:
    """Return positions as fractions of the length [1]; raises ValueError if one is not from -1/2 to 1/2."""
    y = np.atleast_1d(np.asarray(position, dtype=float)) / length
    outside = ~(np.abs(y) <= 0.5 * (1 + 1e-12))
    if outside.any():
        given = float(y[outside][0] * length * 1e3)
        raise ValueError(
            f"position {given:g} mm is not on the beam, which spans -{length * 500:g} to {length * 500:g} mm: "
            f"measure from mid-beam"
        )
    return np.asarray(np.clip(y, -0.5, 0.5))


@lru_cache(maxsize=16)
def gauss_legendre(n: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of the Gauss-Legendre rule, two (n,) arrays, after Golub and Welsch (1969).

    NumPy's rule would import all its polynomials, which takes longer than designing the whole stimulus.
    """
    order = np.arange(1, n)
    beside = order / np.sqrt(4.0 * order**2 - 1)
    nodes, vectors = np.linalg.eigh(np.diag(beside, 1) + np.diag(beside, -1))
    return nodes, 2 * vectors[0] ** 2


def _bending(labels: list[int], y: FloatArray, *, symmetric: bool) -> FloatArray:
    """Return bending modes of one symmetry at y = x/L, (n_modes, n_points) array."""
    root = np.array([characteristic_root(label - 2) for label in labels]).reshape(-1, 1)
    near, far, decay = np.exp(-root * (0.5 - np.abs(y))), np.exp(-root * (0.5 + np.abs(y))), np.exp(-root)
    if symmetric:
        return np.asarray(np.cos(root * y) / np.cos(root / 2) + (near + far) / (1 + decay))
    side = np.where(y < 0, -1.0, 1.0)
    return np.asarray(np.sin(root * y) / np.sin(root / 2) + side * (near - far) / (1 - decay))
