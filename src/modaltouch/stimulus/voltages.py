"""A wish turned into voltages: what it takes, and how near the reached field comes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.drive import Drive, Law, Release, exact_drive
from modaltouch.stimulus.dynamics import Amplifier, DiagonalSystem, modal_system
from modaltouch.stimulus.field import Projection
from modaltouch.stimulus.modes import ModalModel
from modaltouch.stimulus.paper_law import paper_drive
from modaltouch.stimulus.target_field import TargetField
from modaltouch.stimulus.timing import Timing

FloatArray = NDArray[np.float64]

LAWLESS = ("projection", "system", "fwhm", "width_80", "reconstruction_error")
"""What is computed and does not depend on the drive law."""


@dataclass(frozen=True, eq=False)
class Voltages:
    """Voltages for a wish, before they are codes. Everything is computed when first asked for, and only then.

    Attributes
    ----------
    model : ModalModel
        The identified beam.
    wish : TargetField
        The wished field; its velocity is the reference level.
    timing : Timing
        Samples, clock and focusing instant.
    amplifier : Amplifier
        Between generator and beam.
    law : str
        ``exact`` or ``paper``.
    release : str
        ``braked`` or ``free``.
    """

    model: ModalModel
    wish: TargetField
    timing: Timing
    amplifier: Amplifier
    law: Law
    release: Release

    @cached_property
    def projection(self) -> Projection:
        """The wish as the modelled modes see it."""
        return Projection(self.model, self.wish)

    @property
    def selected(self) -> tuple[int, ...]:
        """Labels of the modes that are excited, increasing."""
        return self.projection.selected

    @property
    def target(self) -> FloatArray:
        """Modal velocities wished at the focusing instant at the reference level, (n_modes,) array [m/s]."""
        return self.projection.target

    @cached_property
    def aim(self) -> tuple[FloatArray, FloatArray]:
        """What the exact law steers the model to at the reference level: the target, and no displacement.

        Modal velocities, and displacements times angular frequency, two (n_modes,) arrays [m/s].
        """
        return self.target, np.zeros_like(self.target)

    @cached_property
    def system(self) -> DiagonalSystem:
        """The modal equations behind the amplifier."""
        return modal_system(self.model, self.amplifier)

    @cached_property
    def drive(self) -> Drive:
        """Voltages before rounding, and how well they were solved for."""
        if self.law == "paper":
            return paper_drive(self.model, self.system, self.timing, self.target, self.release)
        velocity, displacement = self.aim
        return exact_drive(self.model, self.system, self.timing, velocity, self.release, displacement)

    @property
    def voltage(self) -> FloatArray:
        """Voltages at the beam before rounding, at the reference level, (n_channels, n_samples) array [V]."""
        return self.drive.voltage

    @cached_property
    def peak_voltage(self) -> FloatArray:
        """Highest voltage at the beam at the reference level, either sign, (n_channels,) array [V]."""
        return np.asarray(np.maximum(self.voltage.max(axis=1), -self.voltage.min(axis=1)))

    @property
    def highest_velocity(self) -> float:
        """Level at which the first channel reaches the amplifier's limit [m/s]."""
        return self.wish.velocity * self.amplifier.limit / float(self.peak_voltage.max())

    @property
    def condition_number(self) -> float:
        """Condition number of the scaled Gramian that was solved [1]; 1 for the paper's law: none is."""
        return self.drive.condition_number

    @cached_property
    def reconstruction_error(self) -> float:
        """Root mean square of what the selected modes leave of the wish, over that of the wish [1]."""
        return self.projection.reconstruction_error

    @cached_property
    def fwhm(self) -> float:
        """Width of the reached field at half its centre's velocity [m]."""
        return self.projection.width(0.5)

    @cached_property
    def width_80(self) -> float:
        """Width of the reached field at 80 % of its centre's velocity [m]."""
        return self.projection.width(0.8)
