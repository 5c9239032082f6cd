"""Every method that is compared: from the same knowledge to the voltages of a burst."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.comparison.inverse_filter import inverse_filter, inverse_filter_at_instant
from modaltouch.lab.comparison.time_reversal import one_bit_reversal, time_reversal
from modaltouch.lab.comparison.training_data import TrainingData
from modaltouch.stimulus import (
    MID_CODE,
    Burst,
    Law,
    Release,
    design_stimulus,
    full_scale,
    round_to_codes,
    unsigned_codes,
)

FloatArray = NDArray[np.float64]

SMALLEST_AMPLITUDE = 0.02
"""What a silent output is set to [V peak to peak]."""


@dataclass(frozen=True)
class Method:
    """A way from what is known to the voltages.

    Attributes
    ----------
    key : str
        Short name, for tables and JSON.
    name : str
        As it is printed.
    idea : str
        What it does and where it comes from, in a sentence.
    needs : str
        ``modes`` (an identification, once for every focus), ``focus`` (recordings at each focus) or ``field``
        (recordings at all control points).
    design : callable
        Returns the voltages at the beam, (n_channels, n_samples) array [V].
    """

    key: str
    name: str
    idea: str
    needs: str
    design: Callable[[TrainingData, Release], FloatArray]

    def recordings(self, n_points: int, n_channels: int) -> int:
        """Return how many recordings must have been made before the first focus."""
        return n_channels * (1 if self.needs == "focus" else n_points)

    def further_recordings(self, n_channels: int) -> int:
        """Return how many more each further focus costs."""
        return n_channels if self.needs == "focus" else 0


def _by_law(law: Law) -> Callable[[TrainingData, Release], FloatArray]:
    def design(known: TrainingData, release: Release) -> FloatArray:
        stimulus = design_stimulus(
            known.model, known.wish, known.timing, known.amplifier, law=law, release=release, rounding="plain"
        )
        # As for the rivals: what needs more than the limit is played at the limit.
        return stimulus.voltage * min(1.0, known.amplifier.limit / float(stimulus.peak_voltage.max()))

    return design


def _rival(way: Callable[[TrainingData], FloatArray]) -> Callable[[TrainingData, Release], FloatArray]:
    def design(known: TrainingData, release: Release) -> FloatArray:
        return way(known)

    return design


METHODS = (
    Method(
        "exact",
        "exact law",
        "every identified mode from rest to its target by the least weighted energy, then braked (this program)",
        "modes",
        _by_law("exact"),
    ),
    Method(
        "paper",
        "paper's law",
        "each selected mode along its reversed free decay by the output that drives it best (the paper, eq. 6, 7)",
        "modes",
        _by_law("paper"),
    ),
    Method(
        "time_reversal",
        "time reversal",
        "each output plays its impulse response at the focus backwards (Hudin, Lozada & Hayward, IEEE Trans. Haptics "
        "8(2), 2015)",
        "focus",
        _rival(time_reversal),
    ),
    Method(
        "one_bit",
        "1-bit time reversal",
        "the signs of the same alone (Derode, Tourin & Fink, J. Appl. Phys. 85, 1999)",
        "focus",
        _rival(one_bit_reversal),
    ),
    Method(
        "inverse_filter",
        "inverse filter",
        "regularised least squares at every frequency towards a pulse of the wished field and rest at every other time "
        "(Pantera & Hudin, World Haptics 2019 and IEEE Trans. Haptics 13(3), 2020)",
        "field",
        _rival(inverse_filter),
    ),
    Method(
        "inverse_instant",
        "inverse filter at t_F",
        "regularised least squares towards the wished field at the focusing instant alone, a law without a model",
        "field",
        _rival(inverse_filter_at_instant),
    ),
)
"""In the order of every table and figure."""


@dataclass(frozen=True, eq=False)
class MethodDrive:
    """A method's drive.

    Attributes
    ----------
    method : Method
        Whose it is.
    voltage : (n_channels, n_samples) array
        At the beam, before rounding [V].
    burst : Burst
        As the generator plays it.
    computing_time : float
        From the knowledge to the voltages [s].
    """

    method: Method
    voltage: FloatArray
    burst: Burst
    computing_time: float

    @property
    def peak_voltage(self) -> float:
        """Highest voltage of any channel, either sign [V]."""
        return float(np.abs(self.voltage).max())

    @property
    def energy(self) -> float:
        """Integral of the squared voltages over the burst [V^2 s]."""
        hold = self.burst.duration / int(self.voltage.shape[1])
        return float((self.voltage**2).sum()) * hold


def design_all(known: TrainingData, release: Release, load_factor: float) -> list[MethodDrive]:
    """Return the drive of every method.

    Parameters
    ----------
    known : TrainingData
        What each of them is given.
    release : str
        What the laws do after the focus; the rivals have ways of their own.
    load_factor : float
        Share of the generator's open-circuit voltage that reaches the amplifier's input [1].
    """
    # What methods share is computed before the clock starts: it belongs to the recordings.
    _ = known.towards
    return [_designed(method, known, release, load_factor) for method in METHODS]


def _designed(method: Method, known: TrainingData, release: Release, load_factor: float) -> MethodDrive:
    started = time.perf_counter()
    voltage = method.design(known, release)
    took = time.perf_counter() - started
    return MethodDrive(method, voltage, as_burst(voltage, known, load_factor), took)


def as_burst(voltage: FloatArray, known: TrainingData, load_factor: float) -> Burst:
    """Return voltages as the generator plays them.

    Parameters
    ----------
    voltage : (n_channels, n_samples) array
        At the beam [V].
    known : TrainingData
        Clock, level and amplifier.
    load_factor : float
        Share of the generator's open-circuit voltage that reaches the amplifier's input [1].
    """
    to_beam = known.amplifier.gain * load_factor
    amplitude = tuple(
        full_scale(2 * max(float(np.abs(row).max()) / to_beam, SMALLEST_AMPLITUDE / 2), (1.0,)) for row in voltage
    )
    codes = round_to_codes(voltage, np.asarray(amplitude) * (to_beam / 2 / MID_CODE))
    timing = known.timing
    return Burst(unsigned_codes(codes), timing.duration, timing.repetition_rate, known.wish.velocity, amplitude)
