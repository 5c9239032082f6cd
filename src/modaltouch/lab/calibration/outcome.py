"""What a calibration finds: turn by turn, level by level, and all of it; whom it tells meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.calibration.plant import ModalState, Plant
from modaltouch.preflight import DesignInputs
from modaltouch.protocol import Apparatus
from modaltouch.stimulus import Correction

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Iteration:
    """What one turn of the loop measured at the reference level.

    Attributes
    ----------
    number : int
        0 is the stimulus as the apparatus file gives it.
    state : ModalState
        Of the modes at the focusing instant.
    errors : (float, float)
        Largest of velocity, and of w eta [m/s].
    peak_voltage : float
        Highest voltage at the beam [V].
    """

    number: int
    state: ModalState
    errors: tuple[float, float]
    peak_voltage: float

    @property
    def worst(self) -> float:
        """The larger of both errors [m/s]."""
        return max(self.errors)


@dataclass(frozen=True)
class Level:
    """A level as measured at the centre of the focus zone.

    Attributes
    ----------
    velocity : float
        The level [m/s].
    factor : float
        Of its amplitude [1].
    amplitude : tuple of float
        Of each output [V peak to peak, open circuit].
    at_focus : float
        Velocity at the focusing instant [m/s].
    spread : float
        Its standard error [m/s].
    highest : float
        Highest speed over the burst [m/s].
    """

    velocity: float
    factor: float
    amplitude: tuple[float, ...]
    at_focus: float
    spread: float
    highest: float


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """A finished calibration.

    Attributes
    ----------
    ground : DesignInputs
        The stimulus, as designed without a calibration.
    plant : Plant
        The identified rig.
    refined : Apparatus
        The apparatus with modes and amplifier as identified, in the units and digits of its file.
    target : (n_modes,) array
        Modal velocities wished at the reference level [m/s].
    correction : Correction
        Targets to aim at, and factors of the levels.
    points : (n_points,) array
        Where the beam was measured [m].
    turns : tuple of Iteration
        All turns, the first before any correction.
    best : Iteration
        The one whose targets are kept.
    levels : tuple of Level
        As verified.
    """

    ground: DesignInputs
    plant: Plant
    refined: Apparatus
    target: FloatArray
    correction: Correction
    points: FloatArray
    turns: tuple[Iteration, ...]
    best: Iteration
    levels: tuple[Level, ...]


def _quiet(*_: object) -> None:
    """Say nothing, stop at no moment."""


@dataclass(frozen=True)
class CalibrationProgress:
    """Whom to tell what the loop does.

    Attributes
    ----------
    check : callable
        Called before each record; raises where a signal has come.
    stimulus : callable
        Called with the name of each of several stimuli, before its targets are corrected.
    step : callable
        Called with what begins, in words, and how many records it takes.
    advance : callable
        Called after each record.
    turn : callable
        Called with each `Iteration` as soon as it is measured.
    """

    check: Callable[[], None] = _quiet
    stimulus: Callable[[str], None] = _quiet
    step: Callable[[str, int], None] = _quiet
    advance: Callable[[], None] = _quiet
    turn: Callable[[Iteration], None] = _quiet
