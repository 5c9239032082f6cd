"""Modes of a free-free beam: their shapes from theory, their parameters from identification."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.stimulus.bounds import require_positive

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


@dataclass(frozen=True, eq=False)
class ModalModel:
    """The modelled modes of a beam: those whose parameters are known.

    Attributes
    ----------
    label : tuple of int
        Label of each mode, as in the paper.
    natural_frequency : (n_modes,) array
        Undamped natural frequency [Hz].
    damping_ratio : (n_modes,) array
        Damping ratio [1], above 0 and below 1.
    modal_gain : (n_modes, n_channels) array
        Modal acceleration per volt at the beam [m/s^2 per V]; 0 where a channel does not drive a mode.
    length : float
        Length of the beam [m].
    theory : str
        Where the shapes come from: ``euler_bernoulli``.
    """

    label: tuple[int, ...]
    natural_frequency: FloatArray
    damping_ratio: FloatArray
    modal_gain: FloatArray
    length: float
    theory: Literal["euler_bernoulli"] = "euler_bernoulli"

    def __post_init__(self) -> None:
        """Refuse what is no vibrating beam."""
        label = tuple(int(k) for k in self.label)
        object.__setattr__(self, "label", label)
        for name in ("natural_frequency", "damping_ratio", "modal_gain"):
            values = np.array(getattr(self, name), dtype=float)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        require_positive("the length of the beam", self.length, "m", "measure the beam")
        self._check_shapes()
        for k, frequency, ratio, gain in zip(
            label, self.natural_frequency, self.damping_ratio, self.modal_gain, strict=True
        ):
            _check_mode(k, float(frequency), float(ratio), gain)

    def _check_shapes(self) -> None:
        n_modes = len(self.label)
        if n_modes == 0:
            raise ValueError("no mode is modelled; a stimulus needs at least one: give its parameters")
        if len(set(self.label)) < n_modes:
            double = sorted({k for k in self.label if self.label.count(k) > 1})
            raise ValueError(f"mode label {double[0]} is given twice; each label stands once: remove one")
        if min(self.label) < 1:
            raise ValueError(f"mode label {min(self.label)} does not exist; labels count from 1")
        for name, values in (
            ("natural_frequency", self.natural_frequency),
            ("damping_ratio", self.damping_ratio),
            (
                "modal_gain",
                self.modal_gain[:, :1].ravel() if self.modal_gain.ndim == 2 else self.modal_gain[:0],
            ),
        ):
            if values.shape != (n_modes,):
                raise ValueError(
                    f"{name} has shape {getattr(self, name).shape}, but {n_modes} modes are labelled: "
                    f"give one value (for the gain one row of at least one channel) to each mode"
                )

    @property
    def n_modes(self) -> int:
        """Number of modelled modes."""
        return len(self.label)

    @property
    def n_channels(self) -> int:
        """Number of generator channels."""
        return int(self.modal_gain.shape[1])

    @cached_property
    def angular_frequency(self) -> FloatArray:
        """Undamped natural angular frequency of each mode, (n_modes,) array [rad/s]."""
        return 2 * np.pi * self.natural_frequency

    @cached_property
    def exponent(self) -> NDArray[np.complex128]:
        """Complex exponent -a + ib of each mode's free decay, (n_modes,) array [1/s]."""
        damped = np.sqrt((1 - self.damping_ratio) * (1 + self.damping_ratio))
        return self.angular_frequency * (-self.damping_ratio + 1j * damped)

    def shapes(self, position: ArrayLike) -> FloatArray:
        """Return the mode shapes at points of the beam, (n_modes, n_points) array [1].

        Parameters
        ----------
        position : (n_points,) array_like
            Coordinate along the beam, origin at its middle [m].
        """
        return mode_shapes(self.label, position, self.length)


def _check_mode(label: int, frequency: float, ratio: float, gain: FloatArray) -> None:
    """Refuse parameters that no vibration mode has."""
    require_positive(f"the natural frequency of mode {label}", frequency, "Hz", "identify the mode, or leave it out")
    if not (math.isfinite(ratio) and 0 < ratio < 1):
        raise ValueError(
            f"the damping ratio of mode {label} is {ratio}; it must lie above 0 and below 1: "
            f"give the ratio, not per cent, and identify the mode again if it does not decay"
        )
    if not np.isfinite(gain).all():
        raise ValueError(
            f"a modal gain of mode {label} is {gain[~np.isfinite(gain)][0]} m/s^2 per V; it must be a finite "
            f"number: give 0 where a channel does not drive the mode"
        )
