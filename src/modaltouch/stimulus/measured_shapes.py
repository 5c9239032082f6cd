"""Mode shapes measured on a scan grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.quantities import FloatArray
from modaltouch.stimulus.shapes import mode_shapes

WORST_CONDITION = 1e6
"""Condition number above which shapes on their grid count as linearly dependent [1]."""


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
        if shape.shape != (len(self.label), position.size) or position.ndim != 1:
            raise ValueError(
                f"the array of shapes has the shape {shape.shape}, but {len(self.label)} modes are labelled on "
                f"{position.size} points: give one row to each mode and one column to each point"
            )
        if not (np.isfinite(shape).all() and np.isfinite(position).all()):
            raise ValueError("a measured shape or position is not a finite number: leave out that point or mode")
        if (np.diff(position) <= 0).any() or np.abs(position).max(initial=0.0) > self.length / 2 * (1 + 1e-9):
            raise ValueError(
                f"the scan grid runs from {position[0] * 1e3:g} to {position[-1] * 1e3:g} mm; it must "
                f"increase and lie on the beam of {self.length * 1e3:g} mm: sort it, and measure from mid-beam"
            )
        if (np.abs(shape).max(axis=1) == 0).any():
            still = self.label[int(np.flatnonzero(np.abs(shape).max(axis=1) == 0)[0])]
            raise ValueError(f"mode {still} is zero at every point: measure it again, or leave it out")
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
        raise ValueError(
            f"{len(self.label)} shapes on {self.position.size} points are linearly dependent (condition number "
            f"{self.condition_number:.1e}, allowed {WORST_CONDITION:.0e}); the closest are modes "
            f"{self.label[one]} and {self.label[other]}: scan more points, or leave one out"
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
        if values.shape != self.position.shape:
            raise ValueError(
                f"the field has the shape {values.shape}, but the scan grid has {self.position.size} points: sample it "
                "there"
            )
        return np.asarray(np.linalg.lstsq(self.shape.T, values, rcond=None)[0])

    def at(self, position: ArrayLike) -> FloatArray:
        """Return the shapes at positions between the points of the grid, (n_modes, n_positions) array [1].

        Interpolation uses the theoretical shapes fitted to them on the grid: linear interpolation would lose a third of
        a mode sampled at two and a half points per half wave.
        """
        coefficient = self._fit(self.position, self.shape)
        return np.asarray(coefficient @ mode_shapes(self._fitted(self.position), position, self.length))
