"""Modes of a beam: shapes from theory or measurement, parameters from identification."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.stimulus.quantities import EXTREME, FloatArray, require_positive
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
        """Reject unphysical values."""
        label = tuple(int(k) for k in self.label)
        object.__setattr__(self, "label", label)
        for name in ("natural_frequency", "damping_ratio", "modal_gain"):
            values = np.array(getattr(self, name), dtype=float)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        require_positive("the length of the beam", self.length, "m", "measure the beam")
        self._check_labels()
        self._check_shapes()
        self._check_fingers()
        for k, frequency, ratio, gain in zip(
            label, self.natural_frequency, self.damping_ratio, self.modal_gain, strict=True
        ):
            _check_mode(k, float(frequency), float(ratio), gain)

    def _check_labels(self) -> None:
        n_modes = len(self.label)
        if n_modes == 0:
            raise ValueError("no mode is modelled; a stimulus needs at least one: give its parameters")
        if len(set(self.label)) < n_modes:
            double = sorted({k for k in self.label if self.label.count(k) > 1})
            raise ValueError(f"mode label {double[0]} is given twice; each label may appear once: remove one")
        if min(self.label) < 1:
            raise ValueError(f"mode label {min(self.label)} does not exist; labels count from 1")
        for name, values in (
            ("natural_frequency", self.natural_frequency),
            ("damping_ratio", self.damping_ratio),
            ("modal_gain", self.modal_gain[:, :1].ravel() if self.modal_gain.ndim == 2 else self.modal_gain[:0]),
        ):
            if values.shape != (n_modes,):
                raise ValueError(
                    f"{name} has shape {getattr(self, name).shape}, but {n_modes} modes are labelled: "
                    f"give one value (for the gain one row of at least one channel) to each mode"
                )

    def _check_shapes(self) -> None:
        if self.beam is not None and self.beam.length != self.length:
            raise ValueError(
                f"the Timoshenko beam is {self.beam.length:g} m long, the model {self.length:g} m: give one length"
            )
        if self.basis is not None and (self.basis.label, self.basis.length) != (self.label, self.length):
            raise ValueError(
                f"the measured basis has the modes {self.basis.label} on {self.basis.length:g} m, the model "
                f"{self.label} on {self.length:g} m: give one shape to each mode, in the same order"
            )

    def _check_fingers(self) -> None:
        if self.mass is not None:
            require_positive("the moving mass of the beam", self.mass, "kg", "weigh the beam with its patches")
        elif self.fingers:
            raise ValueError("fingers lie on a beam of unknown mass; give its moving mass: weigh it with its patches")
        for finger in self.fingers:
            if abs(finger.position) > self.length / 2:
                raise ValueError(
                    f"a finger lies at {finger.position * 1e3:g} mm, off the beam, which spans "
                    f"-{self.length * 500:g} to {self.length * 500:g} mm: place it on the beam"
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

    def patch_gains(self, patches: Sequence[tuple[float, float]]) -> FloatArray:
        """Return the theoretical relative modal gains of patches wired together; see `stimulus.other_shapes`."""
        from modaltouch.stimulus.other_shapes import patch_gains

        return patch_gains(self.label, patches, self.length)

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


def _check_mode(label: int, frequency: float, ratio: float, gain: FloatArray) -> None:
    """Reject unphysical parameters of a mode, and gains too small or too large to compute with."""
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
    lost = gain[(gain != 0) & ~((np.abs(gain) >= 1 / EXTREME) & (np.abs(gain) <= EXTREME))]
    if lost.size:
        raise ValueError(
            f"a modal gain of mode {label} is {lost[0]:g} m/s^2 per V; its magnitude must lie between "
            f"{1 / EXTREME:g} and {EXTREME:g}: give 0 where a channel does not drive the mode"
        )
