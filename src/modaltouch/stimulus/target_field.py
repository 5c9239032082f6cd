"""The target field (the velocity to be reached at the focusing instant) and its projection on the modes of a beam."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.quantities import DesignError, FloatArray
from modaltouch.stimulus.shapes import gauss_legendre, mode_shapes

Shape = Literal[
    "triangle",
    "box",
    "half_cosine",
    "raised_cosine",
    "gaussian",
    "sampled",
]

_PROFILES: dict[Shape, Callable[[FloatArray], FloatArray]] = {
    "triangle": lambda u: 1 - u,
    "box": np.ones_like,
    "half_cosine": lambda u: np.cos(np.pi * u / 2),
    "raised_cosine": lambda u: 0.5 + 0.5 * np.cos(np.pi * u),
}
"""Shapes of bounded width, as functions of the distance from the centre over half the base [1]."""

_NODES = 16
_PHASE_PER_PANEL = 10.0
"""A 16-node Gauss rule integrates 10 rad of a sinusoid to 1e-22 of its own amplitude."""

_NOTHING = 1e-9
"""Fraction of the target field below which a projection is rounding error [1]."""


@dataclass(frozen=True)
class TargetField:
    """The velocity field to be reached at the focusing instant.

    Attributes
    ----------
    shape : str
        ``triangle``, ``box``, ``half_cosine``, ``raised_cosine``, ``gaussian``, or ``sampled`` (see `points`).
    base : float
        Width of the base of the shape [m]; for a Gaussian, the full width at half maximum; unused for a sampled field.
    centre : float
        Position at which the level is reached, the peak of a shape, origin at mid-beam [m].
    velocity : float
        Velocity at the centre at the focusing instant, for the highest level [m/s].
    n_decomposed : int
        Number of modes in the decomposition of the field, labels 1 to `n_decomposed`.
    selection : int or tuple of int
        Number of strongest modelled modes to excite, or their labels.
    further_centres : tuple of float
        Centres of additional copies of the shape [m]; where shapes overlap, the higher value applies.
    points : tuple of (float, float)
        Points of a sampled field: increasing positions [m] and relative velocities, interpolated linearly, zero
        outside.
    """

    shape: Shape = "triangle"
    base: float = 0.056
    centre: float = 0.0
    velocity: float = 0.2
    n_decomposed: int = 50
    selection: int | tuple[int, ...] = 6
    further_centres: tuple[float, ...] = ()
    points: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        """Reject a sampled field without a level at its centre."""
        if self.shape == "sampled" and self._at_centre() <= 0:
            raise DesignError(
                f"the sampled field has the relative velocity {self._at_centre():g} at its centre of "
                f"{self.centre * 1e3:g} mm, where the level holds; it must be above 0: centre it elsewhere",
                "points",
            )

    @property
    def centres(self) -> tuple[float, ...]:
        """Centres of all copies of the shape [m]."""
        return (self.centre, *self.further_centres)

    def profile(self, position: ArrayLike) -> FloatArray:
        """Return the target field at unit velocity at positions on the beam [m], (n_points,) array [1]."""
        place = np.atleast_1d(np.asarray(position, dtype=float))
        if self.shape == "sampled":
            return self._sampled(place) / self._at_centre()
        return np.asarray(np.max([self._around(place, centre) for centre in self.centres], axis=0))

    def _around(self, place: FloatArray, centre: float) -> FloatArray:
        """Return the shape around one centre [1]."""
        offset = np.abs(place - centre) / (self.base / 2)
        if self.shape == "gaussian":
            return np.asarray(np.exp(-math.log(2) * offset**2))
        return np.where(offset <= 1, _PROFILES[self.shape](np.minimum(offset, 1.0)), 0.0)

    def _sampled(self, place: FloatArray) -> FloatArray:
        """Return the linear interpolation of the points."""
        at, value = np.asarray(self.points, dtype=float).T
        return np.asarray(np.interp(place, at, value, left=0.0, right=0.0))

    def _at_centre(self) -> float:
        return float(self._sampled(np.array([self.centre]))[0])

    def edges(self, length: float) -> list[float]:
        """Return the discontinuities of the field and of its slope, and the ends of the beam, increasing [m]."""
        half = length / 2
        if self.shape == "sampled":
            inner = [at for at, _ in self.points]
        else:
            inner = [c + side * self.base / 2 for c in self.centres for side in (-1, 0, 1)]
            # Two overlapping copies of a shape cross midway between their centres.
            inner += [(a + b) / 2 for a in self.centres for b in self.centres if a < b]
        return [-half, *sorted({x for x in inner if -half < x < half}), half]


def quadrature(edges: list[float], phase_rate: float) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights [m] that integrate products of smooth pieces and mode shapes to rounding accuracy.

    The pieces are separated by `edges`, increasing [m]; `phase_rate` is the highest wave number of the integrand
    [rad/m].
    """
    node, weight = gauss_legendre(_NODES)
    borders: list[float] = []
    for left, right in zip(edges[:-1], edges[1:], strict=True):
        n_panels = max(1, math.ceil((right - left) * phase_rate / _PHASE_PER_PANEL))
        borders.extend((left + (right - left) * np.arange(n_panels) / n_panels).tolist())
    borders.append(edges[-1])
    border = np.asarray(borders)
    half = np.diff(border)[:, None] / 2
    middle = (border[:-1] + border[1:])[:, None] / 2
    return (middle + half * node).ravel(), (half * weight).ravel()


@dataclass(frozen=True, eq=False)
class Projection:
    """A target field projected on the modes of a model."""

    model: ModalModel
    target_field: TargetField

    def __post_init__(self) -> None:
        """Reject a field that is incompatible with the modelled modes."""
        half = self.model.length / 2
        off = [centre for centre in self.target_field.centres if abs(centre) > half]
        if off:
            raise ValueError(
                f"the field is centred at {off[0] * 1e3:g} mm, off the beam, which spans "
                f"-{half * 1e3:g} to {half * 1e3:g} mm: centre it on a zone"
            )
        beyond = [k for k in self.model.label if k > self.target_field.n_decomposed]
        if beyond:
            raise DesignError(
                f"mode {beyond[0]} is modelled, but the field is decomposed on {self.target_field.n_decomposed} modes "
                f"only: decompose on at least {max(self.model.label)}",
                "n_decomposed",
            )

    def _nodes(self, highest: int) -> tuple[FloatArray, FloatArray]:
        """Return nodes and weights that integrate the field times modes up to a label."""
        phase_rate = (highest + 1) * 2 * np.pi / self.model.length
        return quadrature(self.target_field.edges(self.model.length), phase_rate)

    def _coefficients(self, highest: int, shapes: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Return the coefficients of the field at unit velocity on orthogonal modes up to a label."""
        position, weight = self._nodes(highest)
        profile = self.target_field.profile(position)
        alive = profile != 0
        return np.asarray(shapes(position[alive]) @ (weight * profile)[alive] / self.model.length)

    @cached_property
    def decomposition(self) -> FloatArray:
        """Coefficients of the target field at unit velocity on modes 1 to `n_decomposed`, (n_decomposed,) array [1]."""
        n = self.target_field.n_decomposed
        return self._coefficients(n, lambda position: mode_shapes(np.arange(1, n + 1), position, self.model.length))

    @cached_property
    def coefficient(self) -> FloatArray:
        """Coefficients of the target field at unit velocity on the modelled modes, (n_modes,) array [1]."""
        if self.model.basis is not None:
            # With few scan points a sum would be off by a quarter; least squares is not.
            return self.model.basis.project(self.target_field.profile(self.model.basis.position))
        if self.model.beam is None:
            return self._coefficients(max(self.model.label), self.model.shapes)
        # With rotary inertia, the deflections alone are not quite orthogonal.
        position, weight = self._nodes(max(self.model.label))
        shapes, profile = self.model.shapes(position), self.target_field.profile(position)
        return np.asarray(np.linalg.solve((shapes * weight) @ shapes.T, shapes @ (weight * profile)))

    @cached_property
    def selected(self) -> tuple[int, ...]:
        """Labels of the modes that are excited, increasing."""
        if isinstance(self.target_field.selection, tuple):
            return tuple(sorted(self.target_field.selection))
        strongest = np.argsort(-np.abs(self.coefficient), kind="stable")[: self.target_field.selection]
        return tuple(sorted(self.model.label[i] for i in strongest))

    @cached_property
    def target(self) -> FloatArray:
        """Modal velocities at the focusing instant, (n_modes,) array [m/s], 0 for modes not selected.

        They are scaled so that the field at its centre equals the level.
        """
        kept = np.where(np.isin(self.model.label, self.selected), self.coefficient, 0.0)
        at_centre = float(kept @ self.model.shapes([self.target_field.centre])[:, 0])
        if at_centre < _NOTHING:
            raise DesignError(
                f"the field at {self.target_field.centre * 1e3:g} mm has a projection of {at_centre:.2g} on the modes "
                f"{', '.join(map(str, self.selected))}, which is not above zero within rounding: select modes that "
                "move there with the field, or move the field",
                "selection",
            )
        return kept * (self.target_field.velocity / at_centre)

    def field(self, position: ArrayLike) -> FloatArray:
        """Return the velocity of the selected modes at positions on the beam [m], (n_points,) array [m/s]."""
        return self.model.field(self.target, position)

    def residual(self, position: ArrayLike) -> FloatArray:
        """Return the target field minus the field reached at positions on the beam [m], (n_points,) array [m/s]."""
        return self.target_field.velocity * self.target_field.profile(position) - self.field(position)

    @cached_property
    def missing(self) -> tuple[int, ...]:
        """Labels of unselected modes above a tenth of the largest coefficient of the field, strongest first."""
        strength = np.abs(self.decomposition)
        order = np.argsort(-strength, kind="stable") + 1
        return tuple(int(k) for k in order if strength[k - 1] > 0.1 * strength.max() and k not in self.selected)

    def unreached(self) -> str:
        """Return a sentence on the part of the target field out of reach of the selected modes, and on missing modes.

        Symmetric wiring, for example, mirrors every field about mid-beam.
        """
        position = np.linspace(-self.model.length / 2, self.model.length / 2, 501)
        residual = self.residual(position)
        worst = int(np.abs(residual).argmax())
        modes = f"mode{'s' * (len(self.missing) > 1)} {', '.join(map(str, self.missing))}"
        lack = f", because of the missing {modes}" if self.missing else ""
        return (
            f"the field misses the target by {self.reconstruction_error:.0%} of its root mean square and by up "
            f"to {abs(residual[worst]) * 1e3:.0f} mm/s at {position[worst] * 1e3:.0f} mm{lack}"
        )

    @cached_property
    def reconstruction_error(self) -> float:
        """Ratio of the root mean squares of the residual and of the target field [1]."""
        position, weight = self._nodes(self.target_field.n_decomposed)
        ideal = self.target_field.velocity * self.target_field.profile(position)
        return math.sqrt(float(weight @ self.residual(position) ** 2) / float(weight @ ideal**2))

    def width(self, fraction: float) -> float:
        """Return the width of the field at a fraction of its value at the centre, above 0 and below 1 [m]."""
        level = fraction * self.target_field.velocity
        brackets = []
        for position, field in self._flanks:
            below = np.flatnonzero(field < level)
            if below.size == 0 or below[0] == 0:
                end = position[-1 if below.size == 0 else 0]
                brackets.append(np.full(31, end))
            else:
                brackets.append(np.linspace(position[below[0] - 1], position[below[0]], 31))
        above = self.field(np.concatenate(brackets)).reshape(2, -1) - level
        left, right = (float(np.interp(0.0, -one, place)) for one, place in zip(above, brackets, strict=True))
        return right - left

    @cached_property
    def _flanks(self) -> list[tuple[FloatArray, FloatArray]]:
        """Positions from the centre to the left and to the right end [m], each with the field there [m/s]."""
        half = self.model.length / 2
        # At least eight points per half wave of the highest mode.
        sides = [np.linspace(self.target_field.centre, end, 8 * max(self.selected) + 13) for end in (-half, half)]
        return list(zip(sides, self.field(np.concatenate(sides)).reshape(2, -1), strict=True))
