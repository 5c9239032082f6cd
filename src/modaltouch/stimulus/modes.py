"""Modes of a beam: shapes from theory or measurement, parameters from identification."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.stimulus.quantities import DesignError, FloatArray
from modaltouch.stimulus.shapes import mode_shapes

if TYPE_CHECKING:
    from modaltouch.stimulus.fingers import Finger, Load
    from modaltouch.stimulus.other_shapes import MeasuredShapes, TimoshenkoBeam

_POINTS = 4096
"""Number of points per batch when modes are summed."""


@dataclass(frozen=True, eq=False)
class ModalModel:
    """The modelled modes of a beam, that is, those with known parameters.

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
    basis : MeasuredShapes, optional
        Measured shapes of every mode, in the order of the labels; by default those of a slender beam.
    beam : TimoshenkoBeam, optional
        The bare beam, if shear and rotary inertia affect its bending modes; by default a slender one.
    fingers : tuple of Finger
        Fingertips on the beam, which couple the modes; the other attributes describe the untouched beam.
    mass : float, optional
        Moving mass of the beam [kg], needed with fingers.
    """

    label: tuple[int, ...]
    natural_frequency: FloatArray
    damping_ratio: FloatArray
    modal_gain: FloatArray
    length: float
    basis: MeasuredShapes | None = None
    beam: TimoshenkoBeam | None = None
    fingers: tuple[Finger, ...] = ()
    mass: float | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only, and reject fingers off the beam or on one of unknown mass."""
        for name in ("natural_frequency", "damping_ratio", "modal_gain"):
            values = np.array(getattr(self, name), dtype=float)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if self.fingers and self.mass is None:
            raise ValueError("fingers lie on a beam of unknown mass; give its moving mass: weigh it with its patches")
        for finger in self.fingers:
            if abs(finger.position) > self.length / 2:
                raise DesignError(
                    f"a finger lies at {finger.position * 1e3:g} mm, off the beam, which spans "
                    f"-{self.length * 500:g} to {self.length * 500:g} mm: place it on the beam",
                    "fingers",
                )

    def require_all_modes(self) -> None:
        """Raise if the table has too few modes to identify fingers.

        Raises
        ------
        ValueError
            If modes are missing.
        """
        lacking = sorted(set(range(1, max(self.label) + 1)) - set(self.label))
        if lacking:
            raise ValueError(
                f"the table lacks modes {', '.join(map(str, lacking))}, which fingers couple to the others; allowed: "
                "every mode up to the highest; run `modaltouch identify --modes all`, and name its apparatus file in "
                "the protocol"
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
        """Complex exponent -a + ib of the free decay of each mode, (n_modes,) array [1/s]."""
        damped = np.sqrt((1 - self.damping_ratio) * (1 + self.damping_ratio))
        return self.angular_frequency * (-self.damping_ratio + 1j * damped)

    @cached_property
    def loads(self) -> tuple[Load, ...]:
        """Contact over the beam's moving mass [1/kg], and finger, for each finger; empty for the untouched beam."""
        if self.mass is None:
            return ()
        mass, fingers = self.mass, self.fingers
        if self.basis is None and all(k % 2 for k in self.label):
            # With symmetric modes only, a finger and its mirror image are made bit-identical, to share one design.
            fingers = tuple(replace(finger, position=-abs(finger.position)) for finger in fingers)
        ordered = sorted(fingers, key=lambda finger: finger.position)
        return tuple((finger.contact(self.shapes, self.length) / mass, finger) for finger in ordered)

    def touched(self, fingers: tuple[Finger, ...]) -> ModalModel:
        """Return the same beam with other fingers on it."""
        return self if fingers == self.fingers else replace(self, fingers=fingers)

    def shapes(self, position: ArrayLike) -> FloatArray:
        """Return the mode shapes at positions on the beam [m], (n_modes, n_points) array [1]."""
        if self.basis is not None:
            return self.basis.at(position)
        if self.beam is not None:
            bending = [k for k in self.label if k > 2]
            shapes = mode_shapes(self.label, position, self.length)
            if bending:
                shapes[[k > 2 for k in self.label]] = self.beam.shapes([k - 2 for k in bending], position)
            return shapes
        return mode_shapes(self.label, position, self.length)

    def field(self, modal_velocity: FloatArray, position: ArrayLike) -> FloatArray:
        """Return the velocity at positions on the beam [m] for modal velocities [m/s], (n_points,) array [m/s].

        Points are processed in batches, to avoid an array of all modes at all points.
        """
        place = np.atleast_1d(np.asarray(position, dtype=float))
        field = np.empty(place.size)
        for start in range(0, place.size, _POINTS):
            some = slice(start, start + _POINTS)
            field[some] = modal_velocity @ self.shapes(place[some])
        return field
