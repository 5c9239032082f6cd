r"""Bending modes of a short beam by Timoshenko theory, with shear and rotary inertia.

With y = x/L from mid-beam and the frequency parameter :math:`b^2 = \rho A L^4 \omega^2 / EI`, the deflection is a sum
of :math:`\cosh b\alpha y` and :math:`\cos b\beta y`, or of their odd counterparts, with

.. math:: \alpha^2, \beta^2 = \tfrac12 [\mp (r^2 + s^2) + \sqrt{(r^2 - s^2)^2 + 4/b^2}],

:math:`r^2 = I/AL^2` (rotary inertia) and :math:`s^2 = EI/kAGL^2` (shear). Above the cut-off frequency
:math:`b r s = 1` alpha is imaginary and the hyperbolic branch becomes trigonometric; all expressions use
:math:`\alpha^2`, :math:`\cosh` and :math:`\sinh/\alpha`, which are real and smooth there. Symmetric and antisymmetric
modes are solved separately, so that close roots of the two kinds are never confused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.quantities import FloatArray, require_positive
from modaltouch.stimulus.shapes import scaled_position

_STEP = 0.05
"""Step of the phase of the trigonometric branch in the root search [rad]."""


@dataclass(frozen=True)
class TimoshenkoBeam:
    """A uniform free-free beam of rectangular cross-section.

    Attributes
    ----------
    length, thickness : float
        Length, and thickness in the direction of bending [m].
    youngs_modulus : float
        Young's modulus [Pa].
    density : float
        Density [kg/m^3].
    poissons_ratio : float
        Poisson's ratio [1].
    shear_factor : float
        Shear coefficient of the cross-section [1]; 5/6 for a rectangle.
    """

    length: float
    thickness: float
    youngs_modulus: float = 70e9
    density: float = 2700.0
    poissons_ratio: float = 0.33
    shear_factor: float = 5 / 6

    def __post_init__(self) -> None:
        """Reject unphysical values."""
        for name, unit in (
            ("length", "m"),
            ("thickness", "m"),
            ("youngs_modulus", "Pa"),
            ("density", "kg/m^3"),
            ("shear_factor", ""),
        ):
            require_positive(f"the {name.replace('_', ' ')} of the beam", getattr(self, name), unit, "measure it")
        if not -1 < self.poissons_ratio <= 0.5:
            raise ValueError(
                f"Poisson's ratio is {self.poissons_ratio}; it lies above -1 and up to 0.5: metals have 0.3"
            )

    @cached_property
    def rotary(self) -> float:
        """Squared radius of gyration over the squared length, r^2 [1]."""
        return self.thickness**2 / (12 * self.length**2)

    @cached_property
    def shear(self) -> float:
        """Ratio of bending to shear stiffness, s^2 [1]."""
        return self.rotary * 2 * (1 + self.poissons_ratio) / self.shear_factor

    def natural_frequency(self, bending: int) -> float:
        """Return the natural frequency of bending mode `bending`, from 1 [Hz].

        Odd modes are symmetric; above the cut-off frequency the two kinds need not alternate.
        """
        wave_speed = math.sqrt(self.youngs_modulus / self.density)
        return self._root(bending) * math.sqrt(self.rotary) * wave_speed / (2 * math.pi * self.length)

    def shapes(self, bending: ArrayLike, position: ArrayLike) -> FloatArray:
        """Return the deflections of bending modes at positions on the beam [m], (n_modes, n_points) array [1].

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

        if bending < 1:
            raise ValueError(f"bending mode {bending} does not exist; they count from 1")
        symmetric, wanted = bool(bending % 2), (bending + 1) // 2
        # The phase b beta of the n-th mode of one symmetry is about 2 pi n, less where both branches are trigonometric.
        phase = np.arange(1.0, (2 * wanted + 3) * math.pi, _STEP)
        grid = self._parameter(phase)
        value = self._determinant(grid, symmetric)
        change = np.flatnonzero(np.sign(value[1:]) != np.sign(value[:-1]))
        ends = grid[change[wanted - 1]], grid[change[wanted - 1] + 1]
        return float(brentq(lambda b: self._determinant(np.array([b]), symmetric)[0], *ends, xtol=1e-300))

    def _parameter(self, phase: FloatArray) -> FloatArray:
        """Return the frequency parameters for given phases b beta [1]."""
        # b^2 beta^2 = q: r^2 s^2 B^2 - (1 + (r^2 + s^2) q) B + q^2 = 0 for B = b^2, the lower branch.
        q = phase**2
        r2, s2 = self.rotary, self.shear
        middle = 1 + (r2 + s2) * q
        return np.asarray(np.sqrt(2 * q**2 / (middle + np.sqrt(middle**2 - 4 * r2 * s2 * q**2))))
