"""Mode shapes of a free-free beam from theory, good to rounding at any label."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

_ASIN_ITERATIONS = 12
"""The fixed point contracts by sech(4.73) = 0.018 at worst: twelve steps leave nothing in double precision."""


@cache
def characteristic_root(bending: int) -> float:
    r"""Return the root of :math:`\cos\lambda\,\cosh\lambda = 1` of a bending mode [1].

    The root is :math:`(2n+1)\pi/2 + d` with :math:`\sin d = (-1)^{n+1} \operatorname{sech} \lambda`, iterated
    on the small `d`; cosh is never formed, so that no mode overflows.

    Parameters
    ----------
    bending : int
        Number n of the bending mode, from 1.

    Raises
    ------
    ValueError
        If `bending` is below 1.

    Examples
    --------
    >>> round(characteristic_root(1), 9)
    4.730040745
    """
    if bending < 1:
        raise ValueError(f"bending mode {bending} does not exist; they count from 1: labels 1 and 2 are rigid")
    middle = (2 * bending + 1) * math.pi / 2
    sign = 1.0 if bending % 2 else -1.0
    deviation = 0.0
    for _ in range(_ASIN_ITERATIONS):
        decay = math.exp(-(middle + deviation))
        deviation = sign * math.asin(2 * decay / (1 + decay * decay))
    return middle + deviation


def mode_shapes(label: ArrayLike, position: ArrayLike, length: float, derivative: int = 0) -> FloatArray:
    r"""Return the mode shapes of a uniform free-free Euler-Bernoulli beam [1].

    Label 1 is the rigid translation, 2 the rigid rotation, k >= 3 the bending mode n = k - 2. Each has unit
    mean square over the beam and is positive at its right end. With y = x/L a symmetric bending mode is

    .. math:: \frac{\cos \lambda y}{\cos \lambda/2}
       + \frac{e^{-\lambda(1/2-|y|)} + e^{-\lambda(1/2+|y|)}}{1 + e^{-\lambda}},

    an antisymmetric one its sine analogue: no growing exponential, hence good to rounding at any label, where
    the textbook difference of cosh and sinh is meaningless from n = 12 on.

    Parameters
    ----------
    label : (n_modes,) array_like of int
        Mode labels of the paper, from 1.
    position : (n_points,) array_like
        Coordinate along the beam, origin at its middle [m].
    length : float
        Length of the beam [m].
    derivative : int
        0 for the shapes, 1 for their slopes, 2 for their curvatures, and so on.

    Returns
    -------
    (n_modes, n_points) array
        Mode shapes [1], or their derivatives along the beam [1/m to that order].

    Raises
    ------
    ValueError
        If a label is below 1, a position lies off the beam, or the derivative is negative.

    References
    ----------
    Goncalves, Brennan, Peplow, Tang (2018); Khasawneh and Segalman (2019), arXiv 1811.03222.
    """
    if derivative < 0:
        raise ValueError(f"the derivative {derivative} of a mode shape is asked; give 0 or above")
    labels = np.atleast_1d(np.asarray(label))
    y = scaled_position(position, length)
    shapes = np.empty((labels.size, y.size))
    for row, k in zip(shapes, labels.tolist(), strict=True):
        row[:] = _shape(int(k), y, derivative)
    return shapes / length**derivative


def scaled_position(position: ArrayLike, length: float) -> FloatArray:
    """Return positions as fractions of the length, -1/2 to 1/2 [1].

    Parameters
    ----------
    position : (n_points,) array_like
        Coordinate along the beam, origin at its middle [m].
    length : float
        Length of the beam [m].

    Raises
    ------
    ValueError
        If a position is not a number or lies off the beam.
    """
    y = np.atleast_1d(np.asarray(position, dtype=float)) / length
    outside = ~(np.abs(y) <= 0.5 * (1 + 1e-12))
    if outside.any():
        given = float(y[outside][0] * length * 1e3)
        raise ValueError(
            f"position {given:g} mm is not on the beam, which spans -{length * 500:g} to {length * 500:g} mm: "
            f"measure from mid-beam"
        )
    return np.asarray(np.clip(y, -0.5, 0.5))


def _shape(label: int, y: FloatArray, derivative: int) -> FloatArray:
    """Return one mode shape at y = x/L, or its derivative along y [1]."""
    if label < 1:
        raise ValueError(f"mode label {label} does not exist; labels count from 1 (the rigid translation)")
    if label <= 2:
        rigid = np.polynomial.Polynomial([1.0] if label == 1 else [0.0, math.sqrt(12.0)])
        return np.asarray(rigid.deriv(derivative)(y) if derivative else rigid(y)) * np.ones_like(y)
    root = characteristic_root(label - 2)
    side = np.where(y < 0, -1.0, 1.0)
    near = np.exp(-root * (0.5 - np.abs(y))) * side**derivative
    far = np.exp(-root * (0.5 + np.abs(y))) * (-side) ** derivative
    cosine, sine = np.cos(root * y), np.sin(root * y)
    if label % 2:
        wave = (cosine, -sine, -cosine, sine)[derivative % 4] / math.cos(root / 2)
        return np.asarray(root**derivative * (wave + (near + far) / (1 + math.exp(-root))))
    wave = (sine, cosine, -sine, -cosine)[derivative % 4] / math.sin(root / 2)
    return np.asarray(root**derivative * (wave + side * (near - far) / (1 - math.exp(-root))))
