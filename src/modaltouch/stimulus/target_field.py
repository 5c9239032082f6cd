"""The velocity field wished at the focusing instant: a shape at one or more places, or points from a file."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.stimulus.bounds import require_finite, require_positive

FloatArray = NDArray[np.float64]
Shape = Literal["triangle", "box", "half_cosine", "raised_cosine", "gaussian", "sampled"]

_PROFILES: dict[Shape, Callable[[FloatArray], FloatArray]] = {
    "triangle": lambda u: 1 - u,
    "box": np.ones_like,
    "half_cosine": lambda u: np.cos(np.pi * u / 2),
    "raised_cosine": lambda u: 0.5 + 0.5 * np.cos(np.pi * u),
}
"""Fields of bounded width against the distance from their centre, 1 at their edge [1]."""


@dataclass(frozen=True)
class TargetField:
    """The velocity field wished at the focusing instant.

    Attributes
    ----------
    shape : str
        ``triangle``, ``box``, ``half_cosine``, ``raised_cosine``, ``gaussian``, or ``sampled`` (see `points`).
    base : float
        Width of the field where it leaves zero [m]; for a Gaussian, which never does, its full width at half
        maximum; without meaning for a sampled field.
    centre : float
        Where the level holds, the peak of a shape, origin at mid-beam [m].
    velocity : float
        Velocity at the centre at the focusing instant, for the highest level [m/s].
    n_decomposed : int
        The wish is decomposed on modes 1 to this label.
    selection : int or tuple of int
        Number of strongest modelled modes to excite, or their labels.
    further_centres : tuple of float
        Where else the same shape is wished at the same time [m]; where shapes overlap the higher counts.
    points : tuple of (float, float)
        Positions [m], increasing, and velocities relative to each other of a sampled field: straight lines
        between, zero outside.
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
        """Refuse a wish that no beam can be asked."""
        if self.shape not in get_args(Shape):
            raise ValueError(f"the field shape {self.shape!r} is unknown; allowed: {', '.join(get_args(Shape))}")
        require_positive("the base of the field", self.base, "m", "the shipped field has 56 mm")
        for centre in self.centres:
            require_finite("the centre of the field", centre, "m", "give a point of the beam")
        require_positive("the velocity level", self.velocity, "m/s", "the paper has 0.08 to 0.2 m/s")
        if self.n_decomposed < 1:
            raise ValueError(f"the field is decomposed on {self.n_decomposed} modes; at least 1 is needed: give 50")
        if isinstance(self.selection, tuple):
            if not self.selection or len(set(self.selection)) < len(self.selection):
                raise ValueError(f"the selected modes are {self.selection}; give at least one label, each once")
        elif self.selection < 1:
            raise ValueError(f"{self.selection} modes are to be selected; at least 1 is needed: give 6")
        if self.shape == "sampled":
            self._check_points()

    def _check_points(self) -> None:
        values = np.asarray(self.points, dtype=float)
        if values.ndim != 2 or values.shape[0] < 2 or values.shape[1] != 2:
            raise ValueError(f"a sampled field has {len(self.points)} points; give at least 2, each with a velocity")
        if not np.isfinite(values).all():
            worst = values[~np.isfinite(values).all(axis=1)][0]
            raise ValueError(f"a point of the sampled field is ({worst[0]}, {worst[1]}); give finite numbers")
        if (np.diff(values[:, 0]) <= 0).any():
            first = int(np.flatnonzero(np.diff(values[:, 0]) <= 0)[0]) + 1
            raise ValueError(
                f"the sampled field goes from {values[first - 1, 0]:g} m to {values[first, 0]:g} m; positions "
                f"must increase: sort them and leave out doubles"
            )
        if self._at_centre() <= 0:
            raise ValueError(
                f"the sampled field has the relative velocity {self._at_centre():g} at its centre of "
                f"{self.centre * 1e3:g} mm, where the level holds; it must be above 0: centre it elsewhere"
            )

    @property
    def centres(self) -> tuple[float, ...]:
        """Every place where the field is wished [m]."""
        return (self.centre, *self.further_centres)

    def profile(self, position: ArrayLike) -> FloatArray:
        """Return the wished field at unit velocity, (n_points,) array [1].

        Parameters
        ----------
        position : (n_points,) array_like
            Coordinate along the beam, origin at its middle [m].
        """
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
        """Return the points joined by straight lines."""
        at, value = np.asarray(self.points, dtype=float).T
        return np.asarray(np.interp(place, at, value, left=0.0, right=0.0))

    def _at_centre(self) -> float:
        return float(self._sampled(np.array([self.centre]))[0])

    def edges(self, length: float) -> list[float]:
        """Return the points where the field or its slope jumps, with the ends of the beam, increasing [m].

        Parameters
        ----------
        length : float
            Length of the beam [m].
        """
        half = length / 2
        if self.shape == "sampled":
            inner = [at for at, _ in self.points]
        else:
            inner = [c + side * self.base / 2 for c in self.centres for side in (-1, 0, 1)]
            # Two overlapping shapes of one kind cross midway between their centres.
            inner += [(a + b) / 2 for a in self.centres for b in self.centres if a < b]
        return [-half, *sorted({x for x in inner if -half < x < half}), half]
