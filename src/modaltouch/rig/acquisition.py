"""Settings and results of a measurement of the velocity of a point of the beam and of its drive.

The simulated vibrometer and scope are used like real ones::

    with simulator.scope() as scope:
        scope.configure(Acquisition(sampling_rate=500e3, n_samples=131_072, n_records=10, drives=(1,)))
        for position in np.linspace(-0.05, 0.05, 41):
            recording = scope.measure(position)

Meanwhile the generator plays (`modaltouch.rig.interface.Rig`), and its trigger starts every record. The zero-order hold
of its samples produces images around multiples of the sample rate. If the scope samples no faster than the generator,
these alias onto the drive, and a transfer function lacks the droop and the half-sample delay of the hold. Therefore
sample a few times faster than the record is played.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.rig.interface import RigError

FloatArray = NDArray[np.float64]

INPUT_RANGES = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""Input ranges of a PicoScope 3404 [V, peak]."""

OUTPUTS = (1, 2)
"""Generator outputs whose drive can be measured."""


@dataclass(frozen=True)
class Acquisition:
    """Settings of vibrometer and scope for a measurement.

    Attributes
    ----------
    sampling_rate : float
        Samples per second [Hz]; the scope uses its nearest available rate, which is stated in the recording.
    n_samples : int
        Samples per record, including those before the trigger.
    n_records : int
        Number of consecutive records, each started by the generator's trigger; they are not averaged, so that coherence
        can be computed.
    drives : tuple of int
        Generator outputs whose voltage at the beam is measured together with the velocity.
    start : float
        Time of the first sample relative to the trigger at the start of a burst [s]; negative for pre-trigger samples.
    velocity_range, drive_range : float, optional
        Highest expected velocity [m/s] and voltage at the beam [V]; the smallest sufficient input range is used.
        None for the full range of the vibrometer or of the scope input.
    """

    sampling_rate: float = 500e3
    n_samples: int = 131_072
    n_records: int = 1
    drives: tuple[int, ...] = (1,)
    start: float = 0.0
    velocity_range: float | None = None
    drive_range: float | None = None

    def __post_init__(self) -> None:
        """Reject settings impossible for any scope."""
        for name, value, unit in (
            ("sampling_rate", self.sampling_rate, "Hz"),
            ("velocity_range", self.velocity_range, "m/s"),
            ("drive_range", self.drive_range, "V"),
        ):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} is {value} {unit}: give a number above 0")
        for name, number, least in (("n_samples", self.n_samples, 2), ("n_records", self.n_records, 1)):
            if number < least:
                raise ValueError(f"{name} is {number}: give at least {least}")
        if not math.isfinite(self.start):
            raise ValueError(f"start is {self.start} s: give a finite time from the trigger")
        if len(set(self.drives)) < len(self.drives) or not set(self.drives) <= set(OUTPUTS):
            raise ValueError(f"drives are {self.drives}: name each generator output of {OUTPUTS} at most once")

    @property
    def n_channels(self) -> int:
        """Scope inputs in use."""
        return 1 + len(self.drives)


@dataclass(frozen=True, eq=False)
class Recording:
    """A measurement at one position, in SI units.

    Attributes
    ----------
    position : float
        Position along the beam, origin at mid-beam [m].
    time : (n_samples,) array
        Time since the trigger, on the clock of the scope [s].
    velocity : (n_records, n_samples) array
        Velocity of the point [m/s].
    drive : (n_records, n_drives, n_samples) array
        Voltage at the beam of each measured drive [V].
    sampling_rate : float
        Sampling rate on the clock of the scope [Hz].
    overloaded : tuple of str
        Signals that reached their full scale in any record: ``velocity``, ``drive 1``, ``drive 2``.
    """

    position: float
    time: FloatArray
    velocity: FloatArray
    drive: FloatArray
    sampling_rate: float
    overloaded: tuple[str, ...]


@dataclass(frozen=True)
class Inputs:
    """Scale factors of the scope inputs, and the choice of input ranges.

    Attributes
    ----------
    sensitivity, highest_velocity : float
        Sensitivity of the vibrometer [m/s per V] and its full scale [m/s].
    attenuation : float
        Attenuation of the probes that measure the drive [V at the beam per V].
    """

    sensitivity: float
    highest_velocity: float
    attenuation: float

    def ranges(self, acquisition: Acquisition) -> tuple[float, float]:
        """Return the input ranges for velocity and drive [V, peak at the input].

        Raises
        ------
        RigError
            If no range of the scope or the vibrometer is wide enough.
        """
        wanted = acquisition.velocity_range or self.highest_velocity
        if wanted > self.highest_velocity * (1 + 1e-9):
            raise RigError(
                f"a velocity of {wanted * 1e3:g} mm/s is to be measured, but the vibrometer's range ends at "
                f"{self.highest_velocity * 1e3:g} mm/s; choose a wider range at the vibrometer, and enter it in the "
                "apparatus file"
            )
        velocity = self._smallest(wanted / self.sensitivity, f"{wanted * 1e3:g} mm/s")
        if acquisition.drive_range is None:
            return velocity, INPUT_RANGES[-1]
        return velocity, self._smallest(acquisition.drive_range / self.attenuation, f"{acquisition.drive_range:g} V")

    @staticmethod
    def _smallest(volts: float, what: str) -> float:
        fitting = [each for each in INPUT_RANGES if each >= volts * (1 - 1e-9)]
        if not fitting:
            raise RigError(
                f"{what} is {volts:g} V at the scope's input: at most {INPUT_RANGES[-1]:g} V; use another sensitivity "
                "or a probe with more attenuation, and enter it in the apparatus file"
            )
        return fitting[0]
