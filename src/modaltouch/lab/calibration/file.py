"""Results of a calibration, and their conversion to the contents of the calibration file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.lab.calibration.plant import ModalState, Plant
from modaltouch.lab.common import NORMAL_95, FloatArray, write_yaml
from modaltouch.preflight import DesignInputs
from modaltouch.protocol import Apparatus, Calibration
from modaltouch.stimulus import Correction
from modaltouch.system import commit, versions

CERTAIN = 3.0
"""Deviation, in standard errors, below which it may be noise and is not corrected [1]."""

LEAST_TRIM = 5e-3
"""Relative deviation of a level below which its amplitude is not corrected [1]."""


@dataclass(frozen=True)
class Iteration:
    """Measurements of one iteration of the loop."""

    number: int  # number of the iteration; 0 for the stimulus designed from the apparatus file
    state: ModalState  # state of the modes at the focusing instant
    errors: tuple[float, float]  # largest error of velocity, and of w eta [m/s]
    peak_voltage: float  # highest voltage at the beam [V]
    n_taken: int  # number of records taken since the calibration began

    @property
    def worst(self) -> float:
        """The larger of the two errors [m/s]."""
        return max(self.errors)

    def __str__(self) -> str:
        """Return a line of text for the operator."""
        name = f"iteration {self.number}" if self.number else "before     "
        velocity, displacement = (error * 1e3 for error in self.errors)
        return (
            f"{name}  worst velocity error {velocity:7.3f} mm/s, worst w eta error {displacement:7.3f} mm/s, "
            f"peak {self.peak_voltage:.0f} V"
        )


@dataclass(frozen=True)
class Level:
    """A level as measured at the centre of the focus zone."""

    velocity: float  # the level [m/s]
    factor: float  # correction factor of its amplitude [1]
    amplitude: tuple[float, ...]  # amplitude of each output [V peak to peak, open circuit]
    at_focus: float  # velocity at the focusing instant [m/s]
    # relative excess of the listed modes' part of it over the velocity expected from the points along the beam [1]
    excess: float
    spread: float  # standard error of `at_focus`, excluding the vibrometer's sensitivity [m/s]
    highest: float  # highest speed during the burst [m/s]
    sensitivity_doubt: float = 0.0  # relative half-width of the 95 % interval of the vibrometer's sensitivity [1]

    @property
    def trim(self) -> float:
        """Correction factor of the level's amplitude [1]; 1 if noise may explain the deviation."""
        if abs(self.at_focus - self.velocity) < max(LEAST_TRIM * self.velocity, CERTAIN * self.spread):
            return 1.0
        factor = self.velocity / self.at_focus if self.at_focus > 0 else math.inf
        # Larger deviations are not corrected by amplitude; the level misses its limit.
        return round(factor, 6) if 0.5 < factor < 2 else 1.0

    @property
    def true_half_width(self) -> float:
        """Half-width of the 95 % interval of the true velocity [m/s]."""
        noise = NORMAL_95 * self.spread
        # If the focus and the other points disagree, either may be correct.
        beyond = max(abs(self.excess / (1 + self.excess) * self.at_focus) - noise, 0.0)
        return math.hypot(noise, self.sensitivity_doubt * self.at_focus, beyond)


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """A finished calibration."""

    inputs: DesignInputs  # the stimulus, as designed without a calibration
    plant: Plant  # the identified rig
    refined: Apparatus  # the apparatus with identified modes and amplifier, in the units and digits of its file
    target: FloatArray  # (n_modes,): target modal velocities at the reference level [m/s]
    correction: Correction  # corrected targets, and correction factors of the levels
    points: FloatArray  # (n_points,): positions at which the beam was measured [m]
    turns: tuple[Iteration, ...]  # all iterations, the first without correction
    best: Iteration  # the iteration whose targets are kept
    levels: tuple[Level, ...]  # the verified levels
    halfway: Iteration  # the same measurement at about half the reference level
    halfway_level: float  # that level [m/s]
    drive_peak: FloatArray  # (n_channels,): highest drive predicted for each output at the highest level [V]
    drive_shortfall: FloatArray  # (n_channels,): relative shortfall of the measured drive's peaks at that level [1]

    @property
    def reading_change(self) -> float:
        """Common relative change of all speeds since the identification, on which iteration 1 is based [1]."""
        return float(self.turns[1].state.velocity @ self.target / (self.target @ self.target)) - 1


DIGITS = 6
"""Decimals of a target in mm/s in the file; the rounding is a thousandth of the noise."""


def significant(state: ModalState, target: FloatArray) -> FloatArray:
    """Return the deviations of a state from its targets, reduced by possible noise, (2, n_modes) array [m/s].

    A deviation of a few standard errors is corrected in part, a smaller one not at all, so that the loop does not
    follow the noise of its measurements.
    """
    error = np.stack([state.velocity - target, state.displacement])
    doubt = CERTAIN * state.spread / np.maximum(np.abs(error), 1e-30)
    return np.asarray(error * np.maximum(1 - doubt**2, 0.0))


def corrected_inputs(inputs: DesignInputs, refined: Apparatus, correction: Correction) -> DesignInputs:
    """Return the design inputs of a stimulus with the identified rig and a correction."""
    used = inputs.apparatus.model_copy(update={"modes": refined.modes, "amplifier": refined.amplifier})
    return replace(inputs, apparatus=used, correction=correction)


def refined_apparatus(apparatus: Apparatus, plant: Plant) -> Apparatus:
    """Return an apparatus with identified modes and amplifier, rounded to the digits of the calibration file."""
    channel = {name: actuators.channel - 1 for name, actuators in apparatus.actuator_sets.items()}
    modes = []
    for row, mode in enumerate(apparatus.modes):
        gains = {name: _digits(plant.model.modal_gain[row, place] * 1e3) for name, place in channel.items()}
        update = {
            "natural_frequency_Hz": _digits(plant.model.natural_frequency[row]),
            "damping_ratio": _digits(plant.model.damping_ratio[row]),
            "gain_mm_s2_per_V": gains,
            "assumed": (),
        }
        modes.append(mode.model_copy(update=update))
    bandwidth = plant.amplifier.bandwidth
    amplifier = apparatus.amplifier.model_copy(
        update={
            "gain_V_per_V": _digits(plant.amplifier.gain),
            "bandwidth_kHz": None if bandwidth is None else _digits(bandwidth * 1e-3),
            "delay_us": _digits(plant.amplifier.delay * 1e6),
        }
    )
    return apparatus.model_copy(update={"modes": tuple(modes), "amplifier": amplifier})


def _digits(value: float) -> float:
    return float(f"{value:.9g}")


HEAD = """\
# Corrections that make these stimuli accurate on this rig: written by `modaltouch calibrate`, read by `modaltouch run`.
# It holds for one apparatus file, the stimuli in it and one generator; measure again rather than edit it.
"""


def write_calibration(calibration: Calibration, out: Path) -> dict[str, Any]:
    """Write the file, which must not exist, and return its plain values with its path."""
    values = calibration.model_dump(mode="json")
    write_yaml(out, HEAD, values)
    return {**values, "file": str(out)}


def calibration_of(
    outcomes: Mapping[str, CalibrationResult],
    *,
    protocol: str,
    apparatus: Apparatus,
    generator: str,
    scope: str,
    mode: str,
    person: str,
    made: datetime,
    marks: Mapping[str, Mapping[str, Any]] | None = None,
) -> Calibration:
    """Convert a finished calibration to the form and units of its file.

    Parameters
    ----------
    outcomes : mapping of str to CalibrationResult
        The result for each stimulus on one rig, by name; a single stimulus has an empty name.
    protocol, apparatus
        Name of the protocol, and the apparatus as in its file.
    generator, scope, mode : str
        Identities of the instruments, and ``simulated`` or ``real``.
    person, made
        Name of the operator, and the time with its offset from UTC.
    marks : mapping of str to mapping, optional
        ``missed`` and ``causes`` of each stimulus; empty for one within its limits.
    """
    change, first = commit(), next(iter(outcomes.values()))
    shared = {
        "calibration": 1,
        "made": made.isoformat(timespec="seconds"),
        "made_by": f"modaltouch {versions()['modaltouch']}" + (f", commit {change[:12]}" if change else ""),
        "person": person,
        "protocol": protocol,
        "apparatus": {"name": apparatus.apparatus, "sha256": apparatus.measured_hash},
        "instruments": {"generator": generator.strip(), "scope": scope, "mode": mode},
        "amplifier": first.refined.amplifier.model_dump(include={"gain_V_per_V", "bandwidth_kHz", "delay_us"}),
        "measuring_chain": {
            "vibrometer_delay_us": round(max(first.plant.vibrometer.delay, 0.0) * 1e6, 4),
            "vibrometer_lag_us": round(first.plant.vibrometer.lag * 1e6, 4),
            "clock_offset_ppm": round(first.plant.drive.clock * 1e6, 3),
        },
        "unlisted_modes_Hz": tuple(sorted(round(float(abs(pole)) / (2 * np.pi), 1) for pole in first.plant.unlisted)),
        "positions_mm": tuple(round(float(point) * 1e3, 6) for point in first.points),
    }
    own = {name: _own(outcome) | dict((marks or {}).get(name, {})) for name, outcome in outcomes.items()}
    return Calibration.of(shared | own.get("", {"stimuli": own}))


def _own(outcome: CalibrationResult) -> dict[str, Any]:
    """Return the results for one stimulus."""
    return {
        "stimulus": outcome.inputs.section,
        "focus_centre_mm": outcome.inputs.centre_mm,
        "reference_mm_s": outcome.inputs.reference,
        "iterations": tuple(
            {
                "iteration": turn.number,
                "worst_velocity_error_mm_s": round(turn.errors[0] * 1e3, 4),
                "worst_displacement_error_mm_s": round(turn.errors[1] * 1e3, 4),
                "peak_voltage_V": round(turn.peak_voltage, 2),
            }
            for turn in outcome.turns
        ),
        "modes": tuple(_modes(outcome)),
        "levels": tuple(
            {
                "velocity_mm_s": round(level.velocity * 1e3, 6),
                "amplitude_factor": level.factor,
                "amplitude_Vpp": level.amplitude,
                "at_focus_mm_s": round(level.at_focus * 1e3, 3),
                "uncertainty_mm_s": round(level.true_half_width * 1e3, 3),
                "highest_mm_s": round(level.highest * 1e3, 2),
            }
            for level in outcome.levels
        ),
    }


def _modes(outcome: CalibrationResult) -> list[dict[str, Any]]:
    rows, after = [], outcome.best.state
    for row, mode in enumerate(outcome.refined.modes):
        wished = outcome.target[row]
        before, kept = (
            (round((state.velocity[row] - wished) * 1e3, 4), round(state.displacement[row] * 1e3, 4))
            for state in (outcome.turns[0].state, after)
        )
        rows.append(
            {
                "label": mode.label,
                "natural_frequency_Hz": mode.natural_frequency_Hz,
                "damping_ratio": mode.damping_ratio,
                "gain_mm_s2_per_V": mode.gain_mm_s2_per_V,
                "wished_mm_s": round(wished * 1e3, DIGITS),
                "target_mm_s": round(outcome.correction.velocity[row] * 1e3, DIGITS),
                "target_displacement_mm_s": round(outcome.correction.displacement[row] * 1e3, DIGITS),
                "error_before_mm_s": before,
                "error_after_mm_s": kept,
                "uncertainty_mm_s": round(float(after.true_half_width[:, row].max()) * 1e3, 4),
            }
        )
    return rows
