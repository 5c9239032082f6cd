"""Mode shapes of a short beam by Timoshenko theory, or measured on a scan grid, and gains of piezoelectric patches."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.quantities import DesignError, FloatArray
from modaltouch.stimulus.shapes import mode_shapes, scaled_position

WORST_CONDITION = 1e6
"""Condition number above which shapes on their grid count as linearly dependent [1]."""

_STEP = 0.05
"""Step of the phase of the trigonometric branch in the root search [rad]."""


@dataclass(frozen=True)
class TimoshenkoBeam:
    r"""A uniform free-free beam of rectangular cross-section, with shear and rotary inertia (Timoshenko theory).

    With y = x/L from mid-beam and the frequency parameter :math:`b^2 = \rho A L^4 \omega^2 / EI`, the deflection is a
    sum of :math:`\cosh b\alpha y` and :math:`\cos b\beta y`, or of their odd counterparts, with

    .. math:: \alpha^2, \beta^2 = \tfrac12 [\mp (r^2 + s^2) + \sqrt{(r^2 - s^2)^2 + 4/b^2}],

    :math:`r^2 = I/AL^2` (rotary inertia) and :math:`s^2 = EI/kAGL^2` (shear). Above the cut-off frequency
    :math:`b r s = 1` alpha is imaginary and the hyperbolic branch becomes trigonometric; all expressions use
    :math:`\alpha^2`, :math:`\cosh` and :math:`\sinh/\alpha`, which are real and smooth there. Symmetric and
    antisymmetric modes are solved separately, so that close roots of the two kinds are never confused.

    Attributes
    ----------
    length, thickness : float
        Length, and thickness in the direction of bending [m].
    poissons_ratio : float
        Poisson's ratio [1].
    shear_factor : float
        Shear coefficient of the cross-section [1]; 5/6 for a rectangle.
    """

    length: float
    thickness: float
    poissons_ratio: float = 0.33
    shear_factor: float = 5 / 6

    @cached_property
    def rotary(self) -> float:
        """Squared radius of gyration over the squared length, r^2 [1]."""
        return self.thickness**2 / (12 * self.length**2)

    @cached_property
    def shear(self) -> float:
        """Ratio of bending to shear stiffness, s^2 [1]."""
        return self.rotary * 2 * (1 + self.poissons_ratio) / self.shear_factor

    def shapes(self, bending: ArrayLike, position: ArrayLike) -> FloatArray:
        """Return the deflections of bending modes at positions on the beam [m], (n_modes, n_points) array [1].

        Odd modes are symmetric; above the cut-off frequency the two kinds need not alternate in frequency.
        They have unit mean square, are positive at the right end, and are orthogonal only together with the rotations
        of the cross-section.
        """
        y = scaled_position(position, self.length)
        node, weight = np.polynomial.legendre.leggauss(64 + 4 * int(np.max(bending)))
        shapes = []
        for n in np.atleast_1d(np.asarray(bending)).tolist():
            b = self._root(int(n))
            mean_square = float(weight @ self._deflection(b, int(n), node / 2) ** 2) / 2
            end = float(self._deflection(b, int(n), np.array([0.5]))[0])
            shapes.append(self._deflection(b, int(n), y) / math.copysign(math.sqrt(mean_square), end))
        return np.asarray(shapes)

    def wave_numbers(self, b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return alpha^2 and beta^2 at frequency parameters [1]."""
        r2, s2 = self.rotary, self.shear
        root = np.sqrt((r2 - s2) ** 2 + 4 / b**2)
        # Half the difference would suffer from cancellation near the cut-off frequency.
        beta2 = ((r2 + s2) + root) / 2
        return (1 / b**2 - r2 * s2) / beta2, beta2

    def _branches(self, b: FloatArray, alpha2: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return cosh(b alpha y) and sinh(b alpha y) / alpha over e^(b alpha / 2), or cos and sin / |alpha|."""
        alpha = np.sqrt(np.abs(alpha2))
        rising = np.where(alpha2 > 0, b * alpha, 0.0)
        fade = np.exp(rising * (np.abs(y) - 0.5))
        fall = np.exp(-2 * rising * np.abs(y))
        phase = b * alpha * y
        tiny = np.maximum(alpha, 1e-300)
        even = np.where(alpha2 > 0, fade * (1 + fall) / 2, np.cos(phase))
        odd = np.where(alpha2 > 0, np.sign(y) * fade * (1 - fall) / 2, np.sin(phase)) / tiny
        return even, np.where(alpha < 1e-12, b * y, odd)

    def _determinant(self, b: FloatArray, symmetric: bool) -> FloatArray:
        """Return the characteristic determinant, zero if moment and shear force vanish at both ends."""
        alpha2, beta2 = self.wave_numbers(b)
        even, odd = self._branches(b, alpha2, np.full_like(b, 0.5))
        beta = np.sqrt(beta2)
        cosine, sine = np.cos(b * beta / 2), np.sin(b * beta / 2)
        if symmetric:
            return (alpha2 + self.shear) * even * sine / beta + (beta2 - self.shear) * cosine * odd
        return (alpha2 + self.shear) * alpha2 * odd * cosine / beta - (beta2 - self.shear) * sine * even

    def _deflection(self, b: float, bending: int, y: FloatArray) -> FloatArray:
        """Return the deflection with zero moment at both ends."""
        parameter = np.array([b])
        alpha2, beta2 = self.wave_numbers(parameter)
        even, odd = self._branches(parameter, alpha2, y)
        end_even, end_odd = self._branches(parameter, alpha2, np.array([0.5]))
        phase = b * np.sqrt(beta2)
        inner, outer = alpha2 + self.shear, beta2 - self.shear
        if bending % 2:
            return np.asarray(inner * end_even * np.cos(phase * y) + outer * np.cos(phase / 2) * even)
        return np.asarray(inner * end_odd * np.sin(phase * y) + outer * np.sin(phase / 2) * odd)

    def _root(self, bending: int) -> float:
        """Return the frequency parameter of a bending mode, from the sign changes of the determinant."""
        from scipy.optimize import brentq

        symmetric, wanted = bool(bending % 2), (bending + 1) // 2
        # The phase b beta of the n-th mode of one symmetry is about 2 pi n, less where both branches are trigonometric.
        q = np.arange(1.0, (2 * wanted + 3) * math.pi, _STEP) ** 2
        # b^2 beta^2 = q: r^2 s^2 B^2 - (1 + (r^2 + s^2) q) B + q^2 = 0 for B = b^2, the lower branch.
        middle = 1 + (self.rotary + self.shear) * q
        grid = np.sqrt(2 * q**2 / (middle + np.sqrt(middle**2 - 4 * self.rotary * self.shear * q**2)))
        value = self._determinant(grid, symmetric)
        change = np.flatnonzero(np.sign(value[1:]) != np.sign(value[:-1]))
        ends = grid[change[wanted - 1]], grid[change[wanted - 1] + 1]
        return float(brentq(lambda b: self._determinant(np.array([b]), symmetric)[0], *ends, xtol=1e-300))


@dataclass(frozen=True, eq=False)
class MeasuredShapes:
    """Mode shapes sampled along the beam, each scaled to unit mean square and positive at the right end.

    Attributes
    ----------
    label : tuple of int
        Label of each mode.
    position : (n_points,) array
        Scan grid, origin at mid-beam, increasing [m].
    shape : (n_modes, n_points) array
        Shapes on the grid, given in any unit and scaled [1].
    length : float
        Length of the beam [m].
    """

    label: tuple[int, ...]
    position: FloatArray
    shape: FloatArray
    length: float

    def __post_init__(self) -> None:
        """Reject shapes that are linearly dependent; scale the others."""
        position = np.array(self.position, dtype=float)
        shape = np.array(self.shape, dtype=float)
        if (np.diff(position) <= 0).any() or np.abs(position).max(initial=0.0) > self.length / 2 * (1 + 1e-9):
            raise DesignError(
                f"the scan grid runs from {position[0] * 1e3:g} to {position[-1] * 1e3:g} mm; it must "
                f"increase and lie on the beam of {self.length * 1e3:g} mm: sort it, and measure from mid-beam",
                "basis",
            )
        if (np.abs(shape).max(axis=1) == 0).any():
            still = self.label[int(np.flatnonzero(np.abs(shape).max(axis=1) == 0)[0])]
            raise DesignError(f"mode {still} is zero at every point: measure it again, or leave it out", "basis")
        object.__setattr__(self, "position", position)
        # The mean square over the beam is that of the smooth fit, more accurate than a sum over a few points. Since the
        # theoretical shapes are orthonormal, it is the sum of the squared coefficients.
        size = np.sqrt((self._fit(position, shape) ** 2).sum(axis=1))
        end = np.sign(shape[:, -1])
        object.__setattr__(self, "shape", shape / (size * np.where(end == 0, 1.0, end))[:, None])
        self._check_rank()

    def _fit(self, position: FloatArray, shape: FloatArray) -> FloatArray:
        """Return the coefficients of the shapes in the theoretical shapes, (n_modes, n_fitted) array."""
        theory = mode_shapes(self._fitted(position), position, self.length)
        return np.asarray(np.linalg.lstsq(theory.T, shape.T, rcond=None)[0].T)

    def _fitted(self, position: FloatArray) -> range:
        """Return the labels of the theoretical shapes resolved by the grid."""
        return range(1, max(2, min(max(self.label) + 4, position.size * 2 // 3)) + 1)

    def _check_rank(self) -> None:
        """Reject modes that the grid cannot distinguish; the message names the closest pair."""
        if self.condition_number <= WORST_CONDITION:
            return
        size = np.linalg.norm(self.shape, axis=1)
        likeness = np.abs(self.shape @ self.shape.T) / np.outer(size, size) - 2 * np.eye(len(self.label))
        one, other = np.unravel_index(int(likeness.argmax()), likeness.shape)
        raise DesignError(
            f"{len(self.label)} shapes on {self.position.size} points are linearly dependent (condition number "
            f"{self.condition_number:.1e}, allowed {WORST_CONDITION:.0e}); the closest are modes "
            f"{self.label[one]} and {self.label[other]}: scan more points, or leave one out",
            "basis",
        )

    @cached_property
    def condition_number(self) -> float:
        """Condition number of the shapes on their grid, the largest noise amplification of least squares [1]."""
        if self.position.size < len(self.label):
            return math.inf
        singular = np.linalg.svd(self.shape, compute_uv=False)
        return float(singular[0] / singular[-1]) if singular[-1] > 0 else math.inf

    def project(self, field: ArrayLike) -> FloatArray:
        """Return the coefficients of a field on the scan grid by least squares, (n_modes,) array."""
        values = np.asarray(field, dtype=float)
        return np.asarray(np.linalg.lstsq(self.shape.T, values, rcond=None)[0])

    def at(self, position: ArrayLike) -> FloatArray:
        """Return the shapes at positions between the points of the grid, (n_modes, n_positions) array [1].

        Interpolation uses the theoretical shapes fitted to them on the grid: linear interpolation would lose a third of
        a mode sampled at two and a half points per half wave.
        """
        coefficient = self._fit(self.position, self.shape)
        return np.asarray(coefficient @ mode_shapes(self._fitted(self.position), position, self.length))
