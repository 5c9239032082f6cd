"""A wished field as the modes see it: projection, selection, and what stays out of reach."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.shapes import mode_shapes
from modaltouch.stimulus.target_field import TargetField

FloatArray = NDArray[np.float64]
_NODES = 16
_PHASE_PER_PANEL = 10.0
"""A 16-node Gauss rule integrates 10 rad of a sinusoid to 1e-22 of its own amplitude."""

_NOTHING = 1e-9
"""A projection below this fraction of the wish is rounding, not vibration."""


@lru_cache(maxsize=1)
def _gauss_rule() -> tuple[FloatArray, FloatArray]:
    # By the eigenvalues of the recurrence's matrix (Golub and Welsch): numpy.polynomial takes longer to import than
    # the whole stimulus to design.
    k = np.arange(1, _NODES)
    beside = k / np.sqrt(4.0 * k**2 - 1)
    node, vector = np.linalg.eigh(np.diag(beside, 1) + np.diag(beside, -1))
    return node, 2 * vector[0] ** 2


def quadrature(edges: list[float], phase_rate: float) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights that integrate products of smooth pieces and mode shapes to rounding.

    Parameters
    ----------
    edges : list of float
        Ends of the smooth pieces, increasing [m].
    phase_rate : float
        Fastest phase of the integrand along the beam [rad/m].

    Returns
    -------
    position : (n_nodes,) array
        Nodes [m].
    weight : (n_nodes,) array
        Weights [m].
    """
    node, weight = _gauss_rule()
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
    """A wish as the modes of a model see it.

    Attributes
    ----------
    model : ModalModel
        The modelled modes.
    wish : TargetField
        The wished field.
    """

    model: ModalModel
    wish: TargetField

    def __post_init__(self) -> None:
        """Refuse a wish that the modelled modes cannot follow."""
        half = self.model.length / 2
        off = [centre for centre in self.wish.centres if abs(centre) > half]
        if off:
            raise ValueError(
                f"the field is centred at {off[0] * 1e3:g} mm, off the beam, which spans "
                f"-{half * 1e3:g} to {half * 1e3:g} mm: centre it on a zone"
            )
        selection = self.wish.selection
        if isinstance(selection, tuple):
            for k in selection:
                if k not in self.model.label:
                    raise ValueError(
                        f"mode {k} is selected but not modelled; modelled are "
                        f"{', '.join(map(str, self.model.label))}: identify it, or leave it out"
                    )
        elif selection > self.model.n_modes:
            raise ValueError(
                f"{selection} modes are to be selected, but {self.model.n_modes} are modelled: "
                f"select at most {self.model.n_modes}"
            )
        beyond = [k for k in self.model.label if k > self.wish.n_decomposed]
        if beyond:
            raise ValueError(
                f"mode {beyond[0]} is modelled, but the field is decomposed on {self.wish.n_decomposed} modes "
                f"only: decompose on at least {max(self.model.label)}"
            )

    @cached_property
    def _nodes(self) -> tuple[FloatArray, FloatArray]:
        phase_rate = (self.wish.n_decomposed + 1) * 2 * np.pi / self.model.length
        return quadrature(self.wish.edges(self.model.length), phase_rate)

    @cached_property
    def decomposition(self) -> FloatArray:
        """Coefficients of the wish at unit velocity on modes 1 to `n_decomposed`, (n_decomposed,) array [1]."""
        position, weight = self._nodes
        profile = self.wish.profile(position)
        alive = profile != 0
        labels = np.arange(1, self.wish.n_decomposed + 1)
        shapes = mode_shapes(labels, position[alive], self.model.length)
        return np.asarray(shapes @ (weight * profile)[alive] / self.model.length)

    @cached_property
    def coefficient(self) -> FloatArray:
        """Coefficients of the wish at unit velocity on the modelled modes, (n_modes,) array [1]."""
        if self.model.basis is not None:
            # Few scan points: least squares, where a sum over them would err by a quarter.
            return self.model.basis.project(self.wish.profile(self.model.basis.position))
        phase_rate = (max(self.model.label) + 1) * 2 * np.pi / self.model.length
        position, weight = quadrature(self.wish.edges(self.model.length), phase_rate)
        profile = self.wish.profile(position)
        if self.model.beam is not None:
            # Deflections alone are not quite orthogonal where the section's rotation carries inertia.
            shapes = self.model.shapes(position)
            return np.asarray(np.linalg.solve((shapes * weight) @ shapes.T, shapes @ (weight * profile)))
        alive = profile != 0
        shapes = self.model.shapes(position[alive])
        return np.asarray(shapes @ (weight * profile)[alive] / self.model.length)

    @cached_property
    def selected(self) -> tuple[int, ...]:
        """Labels of the modes that are excited, increasing."""
        if isinstance(self.wish.selection, tuple):
            return tuple(sorted(self.wish.selection))
        strongest = np.argsort(-np.abs(self.coefficient), kind="stable")[: self.wish.selection]
        return tuple(sorted(self.model.label[i] for i in strongest))

    @cached_property
    def target(self) -> FloatArray:
        """Modal velocities at the focusing instant, (n_modes,) array [m/s], 0 for modes not selected.

        Scaled so that they add up to the wished velocity at the centre of the field.
        """
        chosen = np.isin(self.model.label, self.selected)
        kept = np.where(chosen, self.coefficient, 0.0)
        at_centre = float(kept @ self.model.shapes([self.wish.centre])[:, 0])
        if at_centre < _NOTHING:
            raise ValueError(
                f"the field at {self.wish.centre * 1e3:g} mm projects to {at_centre:.2g} of itself on the "
                f"modes {', '.join(map(str, self.selected))}, which is nothing: select modes that move there, "
                f"or move the field"
            )
        return kept * (self.wish.velocity / at_centre)

    def field(self, position: ArrayLike) -> FloatArray:
        """Return the velocity field that the selected modes make, (n_points,) array [m/s].

        Parameters
        ----------
        position : (n_points,) array_like
            Coordinate along the beam, origin at its middle [m].
        """
        return self.model.field(self.target, position)

    def residual(self, position: ArrayLike) -> FloatArray:
        """Return what of the wish stays unreached, wish less field, (n_points,) array [m/s].

        Parameters
        ----------
        position : (n_points,) array_like
            Coordinate along the beam, origin at its middle [m].
        """
        return self.wish.velocity * self.wish.profile(position) - self.field(position)

    @cached_property
    def missing(self) -> tuple[int, ...]:
        """Labels that the wish needs and the field lacks, strongest first: over a tenth of the strongest."""
        strength = np.abs(self.decomposition)
        order = np.argsort(-strength, kind="stable") + 1
        least = 0.1 * strength.max()
        return tuple(int(k) for k in order if strength[k - 1] > least and k not in self.selected)

    def unreached(self) -> str:
        """Return in words what of the wish the selected modes do not reach, and for lack of which modes.

        Symmetric wiring, for one, mirrors every field at mid-beam: what it adds there and lacks here is said,
        never silently taken for the wish.
        """
        position = np.linspace(-self.model.length / 2, self.model.length / 2, 501)
        residual = self.residual(position)
        worst = int(np.abs(residual).argmax())
        lack = f", for lack of modes {', '.join(map(str, self.missing))}" if self.missing else ""
        return (
            f"the field misses the wish by {self.reconstruction_error:.0%} of its root mean square and by up "
            f"to {abs(residual[worst]) * 1e3:.0f} mm/s at {position[worst] * 1e3:.0f} mm{lack}"
        )

    @cached_property
    def reconstruction_error(self) -> float:
        """Root mean square of the residual over that of the wish [1]."""
        position, weight = self._nodes
        wished = self.wish.velocity * self.wish.profile(position)
        return math.sqrt(float(weight @ self.residual(position) ** 2) / float(weight @ wished**2))

    def width(self, fraction: float) -> float:
        """Return how wide the field is at a fraction of its value at the centre [m].

        Parameters
        ----------
        fraction : float
            Of the velocity at the centre, above 0 and below 1 [1].

        Raises
        ------
        ValueError
            If the fraction lies outside.
        """
        if not 0 < fraction < 1:
            raise ValueError(f"a width is asked at {fraction} of the centre; give a fraction above 0 and below 1")
        level = fraction * self.wish.velocity
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
        """Positions from the centre to the left and to the right end [m], and the field there [m/s]."""
        half = self.model.length / 2
        # Eight points to a half wave of the highest mode at least.
        sides = [np.linspace(self.wish.centre, end, 8 * max(self.selected) + 13) for end in (-half, half)]
        return list(zip(sides, self.field(np.concatenate(sides)).reshape(2, -1), strict=True))
