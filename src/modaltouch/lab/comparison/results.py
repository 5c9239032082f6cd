"""What came out of a comparison: plain values, and which method is best at what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from modaltouch.lab.comparison.contest import Contest, DriveAssessment
from modaltouch.lab.comparison.methods import MethodDrive
from modaltouch.preflight import finite
from modaltouch.report import say_number

Row = dict[str, Any]


@dataclass(frozen=True)
class Criterion:
    """Something that methods are compared by.

    Attributes
    ----------
    key : str
        Of the value in a method's row.
    name : str
        As it is printed, without its unit.
    unit : str
        Empty for a pure number.
    best : str
        ``low``, ``high``, ``level`` (close to the target) or ``none``.
    digits : int
        Decimals that are printed.
    """

    key: str
    name: str
    unit: str
    best: str
    digits: int = 1

    def winners(self, rows: Sequence[Row], level: float) -> list[Row]:
        """Return the rows that are best, several where what is printed is equal."""
        known = [row for row in rows if row[self.key] is not None]
        if self.best == "none" or not known:
            return []
        costs = [self._cost(round(float(row[self.key]), self.digits), level) for row in known]
        return [row for row, value in zip(known, costs, strict=True) if value == min(costs)]

    def _cost(self, value: float, level: float) -> float:
        if self.best == "level":
            return round(abs(value - level), self.digits)
        return value if self.best == "low" else -value

    def printed(self, row: Row) -> str:
        """Return a row's value as it is printed."""
        return say_number(row[self.key], decimals=self.digits)


def criteria(rows: Sequence[Row]) -> list[Criterion]:
    """Return what methods are compared by; the contrasts are those of the protocol's pairs."""
    pairs = [(key, "") for key in rows[0] if key.startswith("contrast_")]
    pairs += [(key, " under fingers 10 mm wide") for key in rows[0] if key.startswith("finger_contrast_")]
    return [
        Criterion("at_focus_mm_s", "velocity at the focus, at the focusing instant", "mm/s", "level"),
        Criterion("rms_error_mm_s", "distance from the target field, rms", "mm/s", "low", 2),
        Criterion("max_error_mm_s", "distance from the target field, largest", "mm/s", "low", 2),
        Criterion("rms_from_selected_mm_s", "distance from the field of the selected modes, rms", "mm/s", "low", 2),
        Criterion("outside_mm_s", "highest speed then where rest is the target", "mm/s", "low"),
        Criterion("width_50_mm", "spot width at 50 %", "mm", "none"),
        Criterion("width_80_mm", "spot width at 80 %", "mm", "none"),
        Criterion("highest_at_focus_mm_s", "highest speed at the focus, throughout", "mm/s", "level"),
        Criterion("highest_mm_s", "highest speed anywhere, throughout", "mm/s", "low"),
        *(Criterion(key, f"contrast of {_pair(key)}{where}", "", _wanted(rows, key), 2) for key, where in pairs),
        Criterion("peak_voltage_V", "peak voltage", "V", "low"),
        Criterion("energy_V2_s", "energy", "V² s", "low", 2),
        Criterion("reach_mm_s", "velocity at the focus at the voltage limit", "mm/s", "high", 0),
        Criterion("recordings", "recordings before the first focus", "", "low", 0),
        Criterion("further_recordings", "recordings for each further focus", "", "low", 0),
        Criterion("changed_at_focus_spread_mm_s", "other beams: spread of the velocity at the focus", "mm/s", "low", 2),
        Criterion(
            "changed_rms_error_mm_s", "other beams: distance from the target field, rms, median", "mm/s", "low", 2
        ),
        Criterion("changed_drift_mm_s", "other beams: change of the field, rms, median", "mm/s", "low", 2),
    ]


def _pair(key: str) -> str:
    """Return the zones that a contrast's key ends in, as they are printed."""
    return f"({', '.join(key.split('_')[-2:])})"


def _wanted(rows: Sequence[Row], key: str) -> str:
    """More contrast is better where one of the two zones is the focus; two others are to move alike."""
    return "high" if rows[0]["focus"] in key.split("_")[-2:] else "none"


def method_row(
    designed: MethodDrive, verdict: DriveAssessment, changed: Sequence[DriveAssessment], contest: Contest, focus: str
) -> Row:
    """Return all of a method's figures."""
    limit = contest.known.amplifier.limit
    n_channels, n_points = contest.known.responses.response.shape[:2]
    row: Row = {
        "method": designed.method.key,
        "name": designed.method.name,
        "idea": designed.method.idea,
        "focus": focus,
        "at_focus_mm_s": verdict.at_focus * 1e3,
        "rms_error_mm_s": verdict.rms_error * 1e3,
        "max_error_mm_s": verdict.max_error * 1e3,
        "rms_from_selected_mm_s": verdict.rms_from_selected * 1e3,
        "outside_mm_s": verdict.outside * 1e3,
        "width_50_mm": finite(verdict.width_50 * 1e3),
        "width_80_mm": finite(verdict.width_80 * 1e3),
        "highest_at_focus_mm_s": verdict.zone_peak[focus] * 1e3,
        "highest_mm_s": None if verdict.highest is None else verdict.highest * 1e3,
        "zone_peak_mm_s": {zone: peak * 1e3 for zone, peak in verdict.zone_peak.items()},
        **{f"contrast_{left}_{right}": finite(value) for (left, right), value in verdict.contrasts.items()},
        **{
            f"finger_contrast_{left}_{right}": finite(value)
            for (left, right), value in verdict.finger_contrasts.items()
        },
        "peak_voltage_V": designed.peak_voltage,
        "energy_V2_s": designed.energy,
        "reach_mm_s": verdict.at_focus * 1e3 * limit / designed.peak_voltage,
        "computing_time_s": designed.computing_time,
        "recordings": designed.method.recordings(n_points, n_channels),
        "further_recordings": designed.method.further_recordings(n_channels),
    }
    return row | _changed(verdict, changed)


def _changed(verdict: DriveAssessment, changed: Sequence[DriveAssessment]) -> Row:
    if not changed:
        keys = ("at_focus_low_mm_s", "at_focus_high_mm_s", "at_focus_spread_mm_s", "rms_error_mm_s", "drift_mm_s")
        return {f"changed_{key}": None for key in keys}
    at_focus = np.array([each.at_focus for each in changed]) * 1e3
    low, high = np.percentile(at_focus, [5, 95])
    drift = [float(np.sqrt(np.mean((each.field - verdict.field) ** 2))) * 1e3 for each in changed]
    return {
        "changed_at_focus_low_mm_s": float(low),
        "changed_at_focus_high_mm_s": float(high),
        "changed_at_focus_spread_mm_s": float(high - low),
        "changed_rms_error_mm_s": float(np.median([each.rms_error for each in changed])) * 1e3,
        "changed_drift_mm_s": float(np.median(drift)),
    }


def rows_of(contest: Contest, focus: str) -> list[Row]:
    """Return the figures of every method.

    Parameters
    ----------
    contest : Contest
        The comparison.
    focus : str
        Zone of the focus.
    """
    parts = zip(contest.designed, contest.verdicts, contest.changed, strict=True)
    return [method_row(designed, verdict, changed, contest, focus) for designed, verdict, changed in parts]
