"""A finished calibration as a file that people and the session read."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.lab.calibration.corrections import DIGITS
from modaltouch.lab.calibration.outcome import CalibrationResult, Iteration, Level
from modaltouch.protocol import Apparatus, Calibration
from modaltouch.record import prepare_file, replace_file
from modaltouch.system import commit, versions

INTERVAL = 1.96
"""Half width of a 95 % interval, in standard errors [1]."""

HEAD = """\
# What makes these stimuli true on this rig: written by `modaltouch calibrate`, read by `modaltouch run`.
# It holds for one apparatus file, the stimuli in it and one generator; measure again rather than edit it.
"""


@dataclass(frozen=True)
class CalibrationContext:
    """What a calibration was made of and with.

    Attributes
    ----------
    protocol : str
        Name of the protocol.
    apparatus : Apparatus
        As its file gives it.
    generator, scope : str
        Their identities.
    mode : str
        ``simulated`` or ``real``.
    person : str
        Who made it.
    made : datetime
        When, with its offset from UTC.
    """

    protocol: str
    apparatus: Apparatus
    generator: str
    scope: str
    mode: str
    person: str
    made: datetime


def calibration_of(outcomes: Mapping[str, CalibrationResult], circumstances: CalibrationContext) -> Calibration:
    """Return a finished calibration in the form and the units of its file.

    Parameters
    ----------
    outcomes : mapping of str to CalibrationResult
        What came of each stimulus, by name, on one rig; of one alone, under an empty name.
    circumstances : CalibrationContext
        What it was made with.
    """
    shared = _shared(next(iter(outcomes.values())), circumstances)
    if "" in outcomes:
        return Calibration.of({**shared, **_own(outcomes[""])})
    return Calibration.of({**shared, "stimuli": {name: _own(outcome) for name, outcome in outcomes.items()}})


def _shared(outcome: CalibrationResult, at: CalibrationContext) -> dict[str, Any]:
    """Return what holds for the rig, whichever stimulus."""
    plant, refined = outcome.plant, outcome.refined
    change = commit()
    return {
        "calibration": 1,
        "made": at.made.isoformat(timespec="seconds"),
        "made_by": f"modaltouch {versions()['modaltouch']}" + (f", commit {change[:12]}" if change else ""),
        "person": at.person,
        "protocol": at.protocol,
        "apparatus": {"name": at.apparatus.apparatus, "sha256": at.apparatus.measured_hash},
        "instruments": {"generator": at.generator.strip(), "scope": at.scope, "mode": at.mode},
        "amplifier": {
            "gain_V_per_V": refined.amplifier.gain_V_per_V,
            "bandwidth_kHz": refined.amplifier.bandwidth_kHz,
            "delay_us": refined.amplifier.delay_us,
        },
        "measuring_chain": {
            "vibrometer_delay_us": round(max(plant.sight.delay, 0.0) * 1e6, 4),
            "vibrometer_lag_us": round(plant.sight.lag * 1e6, 4),
            "clock_offset_ppm": round(plant.drive.clock * 1e6, 3),
        },
        "unlisted_modes_Hz": tuple(sorted(round(float(abs(pole)) / (2 * np.pi), 1) for pole in plant.unlisted)),
        "positions_mm": tuple(round(float(point) * 1e3, 6) for point in outcome.points),
    }


def _own(outcome: CalibrationResult) -> dict[str, Any]:
    """Return what holds for one stimulus."""
    return {
        "stimulus": outcome.ground.section,
        "focus_centre_mm": outcome.ground.centre_mm,
        "reference_mm_s": outcome.ground.reference,
        "iterations": tuple(_iteration(turn) for turn in outcome.turns),
        "modes": tuple(_modes(outcome)),
        "levels": tuple(_level(level) for level in outcome.levels),
    }


def _iteration(turn: Iteration) -> dict[str, Any]:
    return {
        "iteration": turn.number,
        "worst_velocity_error_mm_s": round(turn.errors[0] * 1e3, 4),
        "worst_displacement_error_mm_s": round(turn.errors[1] * 1e3, 4),
        "peak_voltage_V": round(turn.peak_voltage, 2),
    }


def _modes(outcome: CalibrationResult) -> list[dict[str, Any]]:
    aim, before, after = outcome.correction, outcome.turns[0].state, outcome.best.state
    rows = []
    for row, mode in enumerate(outcome.refined.modes):
        wished = outcome.target[row]
        errors = [
            (round((state.velocity[row] - wished) * 1e3, 4), round(state.displacement[row] * 1e3, 4))
            for state in (before, after)
        ]
        rows.append(
            {
                "label": mode.label,
                "natural_frequency_Hz": mode.natural_frequency_Hz,
                "damping_ratio": mode.damping_ratio,
                "gain_mm_s2_per_V": mode.gain_mm_s2_per_V,
                "wished_mm_s": round(wished * 1e3, DIGITS),
                "target_mm_s": round(aim.velocity[row] * 1e3, DIGITS),
                "target_displacement_mm_s": round(aim.displacement[row] * 1e3, DIGITS),
                "error_before_mm_s": errors[0],
                "error_after_mm_s": errors[1],
                "uncertainty_mm_s": round(INTERVAL * after.spread[row] * 1e3, 4),
            }
        )
    return rows


def _level(level: Level) -> dict[str, Any]:
    return {
        "velocity_mm_s": round(level.velocity * 1e3, 6),
        "amplitude_factor": level.factor,
        "amplitude_Vpp": level.amplitude,
        "at_focus_mm_s": round(level.at_focus * 1e3, 3),
        "uncertainty_mm_s": round(INTERVAL * level.spread * 1e3, 3),
        "highest_mm_s": round(level.highest * 1e3, 2),
    }


def calibration_text(calibration: Calibration) -> str:
    """Return the text of a calibration file."""
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 200
    yaml.allow_unicode = True
    stream = io.StringIO()
    yaml.dump(calibration.model_dump(mode="json"), stream)
    return HEAD + stream.getvalue()


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration file in one step; an existing one is not overwritten.

    Parameters
    ----------
    path : Path
        Where it goes; its folder is made.
    calibration : Calibration
        What it holds.

    Raises
    ------
    RecordError
        If there is a file already, or it cannot be written.
    """
    prepare_file(path)
    replace_file(path, calibration_text(calibration).encode(), "free the place, or give another file with --out")
