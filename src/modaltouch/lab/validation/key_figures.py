"""The evidence as plain values in the units of their keys."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.validation.evidence import Evidence
from modaltouch.lab.validation.measures import contrast, root_mean_square, spot_width
from modaltouch.preflight import finite

FloatArray = NDArray[np.float64]


def key_figures(evidence: Evidence, pairs: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Return what one drive law was seen to do.

    Parameters
    ----------
    evidence : Evidence
        Of the law.
    pairs : sequence of (str, str)
        Zones that two fingers touch together.
    """
    observation = evidence.observation
    stimulus = observation.stimulus
    at_focus = float(np.interp(evidence.centre, evidence.position, evidence.measured_field))
    near = np.abs(evidence.course_time - evidence.instant) < stimulus.timing.duration
    highest = int(np.abs(np.where(near, evidence.focus_course, 0.0)).argmax())
    return {
        "law": evidence.law,
        "velocity_mm_s": observation.velocity * 1e3,
        "n_points": int(observation.field.positions.size),
        "n_records": int(observation.field.velocity.shape[1]),
        "selected_modes": [int(label) for label in stimulus.selected],
        "coefficients": coefficients(evidence),
        **_modal_error(evidence),
        "unmodelled_motion_mm_s": _largest(list(evidence.further_coefficient.values())),
        "velocity_at_focus_mm_s": at_focus * 1e3,
        "highest_velocity_at_focus_mm_s": abs(float(evidence.focus_course[highest])) * 1e3,
        "highest_velocity_instant_ms": float(evidence.course_time[highest]) * 1e3,
        "field_error": {
            "measured_from_wished": _distance(evidence.measured_field, evidence.wished_field),
            "measured_from_selected_modes": _distance(evidence.measured_field, evidence.target_field),
            "measured_from_predicted": _distance(evidence.measured_field, evidence.predicted_field),
            "predicted_from_wished": _distance(evidence.predicted_field, evidence.wished_field),
        },
        "width_50_mm": _widths(evidence, 0.5),
        "width_80_mm": _widths(evidence, 0.8),
        "time_above_90_us": {
            "measured": finite(evidence.time_above_90 * 1e6),
            "predicted": finite(evidence.predicted_time_above_90 * 1e6),
        },
        "zone_peak_mm_s": {
            zone: {"measured": peak * 1e3, "predicted": evidence.predicted_zone_peak[zone] * 1e3}
            for zone, peak in evidence.zone_peak.items()
        },
        "contrasts": [_contrast(evidence, left, right) for left, right in pairs],
        "peak_drive_V": {
            str(number): {"measured": float(measured), "predicted": float(predicted)}
            for number, (measured, predicted) in enumerate(
                zip(peak_drive(evidence), stimulus.peak_drive(observation.velocity), strict=True), 1
            )
        },
    }


def coefficients(evidence: Evidence) -> list[dict[str, Any]]:
    """Return the coefficients of the modelled modes: wished, selected, predicted, achieved [mm/s]."""
    labels = evidence.observation.stimulus.model.label
    columns = zip(
        labels,
        evidence.target,
        evidence.predicted_coefficient,
        evidence.achieved_coefficient,
        evidence.coefficient_error,
        strict=True,
    )
    return [
        {
            "mode": int(label),
            "wished_mm_s": float(evidence.wished_coefficient[label - 1]) * 1e3,
            "target_mm_s": float(target) * 1e3,
            "predicted_mm_s": float(predicted) * 1e3,
            "achieved_mm_s": float(achieved) * 1e3,
            "standard_error_mm_s": finite(float(error) * 1e3),
        }
        for label, target, predicted, achieved, error in columns
    ]


def peak_drive(evidence: Evidence) -> FloatArray:
    """Return the highest voltage measured at the beam throughout the burst, (n_channels,) array [V]."""
    drive = evidence.observation.course.drive
    return np.asarray(np.abs(drive).mean(axis=(0, 1)).max(axis=1))


def _modal_error(evidence: Evidence) -> dict[str, Any]:
    error = evidence.achieved_coefficient - evidence.target
    worst = int(np.abs(error).argmax())
    return {
        "worst_modal_error_mm_s": float(np.abs(error[worst])) * 1e3,
        "worst_mode": int(evidence.observation.stimulus.model.label[worst]),
        "rms_modal_error_mm_s": root_mean_square(error) * 1e3,
    }


def _largest(values: list[float]) -> float:
    return float(np.abs(values).max(initial=0.0)) * 1e3


def _distance(one: FloatArray, other: FloatArray) -> dict[str, float]:
    return {"rms_mm_s": root_mean_square(one - other) * 1e3, "max_mm_s": float(np.abs(one - other).max()) * 1e3}


def _widths(evidence: Evidence, fraction: float) -> dict[str, float | None]:
    fields = {
        "measured": evidence.measured_field,
        "predicted": evidence.predicted_field,
        "wished": evidence.wished_field,
    }
    return {
        name: finite(spot_width(evidence.position, field, evidence.centre, fraction) * 1e3)
        for name, field in fields.items()
    }


def _contrast(evidence: Evidence, left: str, right: str) -> dict[str, Any]:
    measured, predicted = evidence.zone_peak, evidence.predicted_zone_peak
    return {
        "zone_left": left,
        "zone_right": right,
        "left_mm_s": measured[left] * 1e3,
        "right_mm_s": measured[right] * 1e3,
        "measured": finite(contrast(measured[left], measured[right])),
        "predicted": finite(contrast(predicted[left], predicted[right])),
    }
