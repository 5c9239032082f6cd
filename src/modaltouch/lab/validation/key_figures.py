"""The evidence as plain values with units in their keys, as a table, and as sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from modaltouch.lab.arrays import FloatArray
from modaltouch.lab.calibration.plausibility import COMMON_FACTORS, GAINS
from modaltouch.lab.validation.evidence import Evidence, contrast, root_mean_square, spot_width, standard_error
from modaltouch.preflight import finite
from modaltouch.report import format_number


def key_figures(evidence: Evidence, pairs: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Return the key figures of one drive law.

    Parameters
    ----------
    evidence : Evidence
        The evidence for the law.
    pairs : sequence of (str, str)
        Pairs of zones touched by two fingers.
    """
    observation = evidence.observation
    stimulus = observation.stimulus
    at_focus = float(np.interp(evidence.centre, evidence.position, evidence.measured_field))
    time = evidence.times(observation.course)
    near = np.abs(time - evidence.instant) < stimulus.timing.duration
    highest = int(np.abs(np.where(near, evidence.focus_course, 0.0)).argmax())
    return {
        "law": evidence.law,
        "velocity_mm_s": observation.velocity * 1e3,
        "n_points": int(observation.field.positions.size),
        "n_records": int(observation.field.velocity.shape[1]),
        "selected_modes": [int(label) for label in stimulus.selected],
        "coefficients": coefficients(evidence),
        **_modal_error(evidence),
        "unmodelled_motion_mm_s": evidence.unmodelled_motion * 1e3,
        "velocity_at_focus_mm_s": at_focus * 1e3,
        "highest_velocity_at_focus_mm_s": abs(float(evidence.focus_course[highest])) * 1e3,
        "highest_velocity_instant_ms": float(time[highest]) * 1e3,
        "field_error": {
            "measured_from_wished": _distance(evidence.measured_field, evidence.target_field),
            "measured_from_selected_modes": _distance(evidence.measured_field, evidence.selected_field),
            "measured_from_predicted": _distance(evidence.measured_field, evidence.predicted_field),
            "predicted_from_wished": _distance(evidence.predicted_field, evidence.target_field),
        },
        "torsion_on_outer_rows_mm_s": _torsion(evidence) if observation.rows else None,
        "width_50_mm": _widths(evidence, 0.5),
        "width_80_mm": _widths(evidence, 0.8),
        "time_above_90_us": {name: finite(each * 1e6) for name, each in evidence.time_above_90.items()},
        "zone_peak_mm_s": {
            zone: {name: peak * 1e3 for name, peak in each.items()} for zone, each in evidence.zone_peak.items()
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
    """Return the target, selected, predicted and achieved coefficients of the modelled modes [mm/s]."""
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
            "wished_mm_s": float(evidence.target_coefficient[label - 1]) * 1e3,
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


def _distance(one: FloatArray, other: FloatArray) -> dict[str, float]:
    return {"rms_mm_s": root_mean_square(one - other) * 1e3, "max_mm_s": float(np.abs(one - other).max()) * 1e3}


def _torsion(evidence: Evidence) -> dict[str, float | None]:
    """Return the torsion on the outer rows at the focusing instant, and its expectation from noise alone [mm/s]."""
    measured, noise = evidence.torsion.mean(axis=0), standard_error(evidence.torsion)
    return {"rms": root_mean_square(measured) * 1e3, "noise": finite(root_mean_square(noise) * 1e3)}


def _widths(evidence: Evidence, fraction: float) -> dict[str, float | None]:
    fields = {
        "measured": evidence.measured_field,
        "predicted": evidence.predicted_field,
        "wished": evidence.target_field,
    }
    return {
        name: finite(spot_width(evidence.position, field, evidence.centre, fraction) * 1e3)
        for name, field in fields.items()
    }


def _contrast(evidence: Evidence, left: str, right: str) -> dict[str, Any]:
    one, other = evidence.zone_peak[left], evidence.zone_peak[right]
    return {
        "zone_left": left,
        "zone_right": right,
        "left_mm_s": one["measured"] * 1e3,
        "right_mm_s": other["measured"] * 1e3,
        **{name: finite(contrast(one[name], other[name])) for name in ("measured", "predicted")},
    }


Figures = dict[str, Any]


def validation_table(figures: Sequence[Figures]) -> list[dict[str, Any]]:
    """Return the table of `key_figures`; each row has a quantity, its unit, and one cell per law."""
    rows: list[tuple[str, str, Callable[[Figures], str]]] = [
        ("velocity at the focus, at the focusing instant", "mm/s", lambda f: f"{f['velocity_at_focus_mm_s']:.1f}"),
        (
            "highest velocity at the focus, and when",
            "mm/s, ms",
            lambda f: f"{f['highest_velocity_at_focus_mm_s']:.1f} at {f['highest_velocity_instant_ms']:.3f}",
        ),
        (
            "worst modal error (its mode)",
            "mm/s",
            lambda f: f"{f['worst_modal_error_mm_s']:.2f} ({f['worst_mode']})",
        ),
        ("modal error, root mean square", "mm/s", lambda f: f"{f['rms_modal_error_mm_s']:.2f}"),
        ("largest coefficient of a mode not modelled", "mm/s", lambda f: f"{f['unmodelled_motion_mm_s']:.2f}"),
        ("field minus desired: rms, largest", "mm/s", lambda f: _error(f, "measured_from_wished")),
        (
            "field minus that of the selected modes: rms, largest",
            "mm/s",
            lambda f: _error(f, "measured_from_selected_modes"),
        ),
        ("field minus prediction: rms, largest", "mm/s", lambda f: _error(f, "measured_from_predicted")),
        ("spot width at 50 %: measured, predicted, desired", "mm", lambda f: _joined(f["width_50_mm"])),
        ("spot width at 80 %: measured, predicted, desired", "mm", lambda f: _joined(f["width_80_mm"])),
        ("time above 90 % of the peak: measured, predicted", "µs", lambda f: _joined(f["time_above_90_us"])),
    ]
    table = [{"quantity": name, "unit": unit, "cells": [cell(f) for f in figures]} for name, unit, cell in rows]
    first, both = figures[0], ("measured", "predicted")
    if first["torsion_on_outer_rows_mm_s"] is not None:
        cells = [_joined(f["torsion_on_outer_rows_mm_s"], 2) for f in figures]
        table.append(
            {"quantity": "torsion on the outer rows, rms: measured, by noise alone", "unit": "mm/s", "cells": cells}
        )
    further = [
        *((f"peak speed at {zone}", "mm/s", [_joined(f["zone_peak_mm_s"][zone], 0) for f in figures])
          for zone in first["zone_peak_mm_s"]),
        *((f"contrast of ({pair['zone_left']}, {pair['zone_right']})", "1",
           [_joined({key: f["contrasts"][i][key] for key in both}, 2) for f in figures])
          for i, pair in enumerate(first["contrasts"])),
        *((f"peak drive of output {output}", "V", [_joined(f["peak_drive_V"][output], 0) for f in figures])
          for output in first["peak_drive_V"]),
    ]  # fmt: skip
    return table + [{"quantity": f"{name}: measured, predicted", "unit": unit, "cells": c} for name, unit, c in further]


def findings(figures: Sequence[Figures]) -> list[str]:
    """Describe the findings from the `key_figures` of the laws, a sentence each."""
    said = [_reached(f) for f in figures]
    if len(figures) > 1:
        said.append(_compared(figures))
    said += [_limits(f) for f in figures[:1]]
    return said + [sentence for f in figures for sentence in (*_implausible_drives(f), *_implausible_speeds(f))]


def _reached(f: Figures) -> str:
    width, above = (format_number(f[key]["measured"], decimals=1) for key in ("width_80_mm", "time_above_90_us"))
    return (
        f"Law “{f['law']}”: {f['velocity_at_focus_mm_s']:.1f} mm/s were measured at the focus, and "
        f"{f['velocity_mm_s']:g} mm/s were desired; the spot is {width} mm wide at 80 % (the paper: roughly 15 mm) "
        f"and stays above 90 % of its peak for {above} µs (the paper: roughly 20 µs). The worst modal error is "
        f"{f['worst_modal_error_mm_s']:.2f} mm/s, of mode {f['worst_mode']} (the paper: 6 mm/s)."
    )


def _compared(figures: Sequence[Figures]) -> str:
    best = min(figures, key=lambda f: float(f["worst_modal_error_mm_s"]))
    others = [f for f in figures if f is not best]
    parts = [
        f"that of law “{f['law']}” is {f['worst_modal_error_mm_s'] / best['worst_modal_error_mm_s']:.1f} times as large"
        for f in others
    ]
    field = min(figures, key=lambda f: float(f["field_error"]["measured_from_selected_modes"]["rms_mm_s"]))
    return (
        f"Law “{best['law']}” has the smaller worst modal error: {', '.join(parts)}. "
        f"The measured field is closest to that of the selected modes with law “{field['law']}”, "
        f"{field['field_error']['measured_from_selected_modes']['rms_mm_s']:.2f} mm/s rms."
    )


def _implausible_drives(f: Figures) -> Iterator[str]:
    for output, peak in f["peak_drive_V"].items():
        # The record of an output without drive contains only the noise of its probe.
        if not GAINS[0] * peak["predicted"] <= peak["measured"] <= GAINS[1] * max(peak["predicted"], 1.0):
            yield (
                f"The drive of output {output} with law “{f['law']}” was measured as {peak['measured']:.0f} V, and "
                f"{peak['predicted']:.0f} V were predicted: check which probe is at which amplifier, and "
                "`acquisition.probe_attenuation`."
            )


def _implausible_speeds(f: Figures) -> Iterator[str]:
    ratio = float(np.median([peak["measured"] / peak["predicted"] for peak in f["zone_peak_mm_s"].values()]))
    if not COMMON_FACTORS[0] <= ratio <= COMMON_FACTORS[1]:
        yield (
            f"With law “{f['law']}” the zones moved {ratio:.2f} times as fast as predicted: check that the vibrometer "
            "is set to the listed `acquisition.sensitivity_mm_s_per_V` and the amplifier to its `amplifier.gain`, or "
            "identify the beam again."
        )


def _limits(f: Figures) -> str:
    reachable = f["field_error"]["predicted_from_wished"]
    return (
        f"No drive of these modes can make the desired field itself: the prediction of law “{f['law']}” is "
        f"{reachable['rms_mm_s']:.1f} mm/s rms and at most {reachable['max_mm_s']:.1f} mm/s away from it."
    )


def _error(f: Figures, key: str) -> str:
    return f"{f['field_error'][key]['rms_mm_s']:.2f}, {f['field_error'][key]['max_mm_s']:.2f}"


def _joined(values: dict[str, float | None], digits: int = 1) -> str:
    return ", ".join(format_number(value, decimals=digits) for value in values.values())
