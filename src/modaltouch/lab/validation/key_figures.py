"""The evidence as plain values with units in their keys, as tables, and as sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from modaltouch.lab.common import COMMON_FACTORS, GAINS, FloatArray, rounded
from modaltouch.lab.validation.evidence import (
    Evidence,
    contrast,
    mean_velocity,
    root_mean_square,
    spot_width,
    standard_error,
)
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
    stimulus = evidence.stimulus
    at_focus = float(np.interp(evidence.stimulus.target_field.centre, evidence.position, evidence.measured_field))
    time = evidence.times(evidence.course)
    near = np.abs(time - evidence.instant) < stimulus.timing.duration
    highest = int(np.abs(np.where(near, evidence.focus_course, 0.0)).argmax())
    error = evidence.achieved_coefficient - evidence.target
    worst = int(np.abs(error).argmax())
    drive = np.abs(evidence.course.drive).mean(axis=(0, 1)).max(axis=1)
    return {
        "law": evidence.stimulus.law,
        "velocity_mm_s": evidence.velocity * 1e3,
        "n_points": int(evidence.field.positions.size),
        "n_records": int(evidence.field.velocity.shape[1]),
        "selected_modes": [int(label) for label in stimulus.selected],
        "coefficients": coefficients(evidence),
        "worst_modal_error_mm_s": float(np.abs(error[worst])) * 1e3,
        "worst_mode": int(stimulus.model.label[worst]),
        "rms_modal_error_mm_s": root_mean_square(error) * 1e3,
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
        "torsion_on_outer_rows_mm_s": _torsion(evidence) if evidence.further_rows else None,
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
                zip(drive, stimulus.peak_drive(evidence.velocity), strict=True), 1
            )
        },
    }


def coefficients(evidence: Evidence) -> list[dict[str, Any]]:
    """Return the target, selected, predicted and achieved coefficients of the modelled modes [mm/s]."""
    labels = evidence.stimulus.model.label
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
        name: finite(spot_width(evidence.position, field, evidence.stimulus.target_field.centre, fraction) * 1e3)
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


LEAST_DRIVE = 0.9
"""Measured over predicted peak of a drive below which an amplifier may saturate [1]."""

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
    """Describe what each law reached, then what is implausible, from its `key_figures`, a sentence each."""
    implausible = (sentence for f in figures for sentence in (*_implausible_drives(f), *_implausible_speeds(f)))
    return [*map(_reached, figures), *implausible]


def _reached(f: Figures) -> str:
    width, above = (format_number(f[key]["measured"], decimals=1) for key in ("width_80_mm", "time_above_90_us"))
    return (
        f"Law “{f['law']}”: {f['velocity_at_focus_mm_s']:.1f} mm/s were measured at the focus, and "
        f"{f['velocity_mm_s']:g} mm/s were desired; the spot is {width} mm wide at 80 % (the paper: roughly 15 mm) "
        f"and stays above 90 % of its peak for {above} µs (the paper: roughly 20 µs). The worst modal error is "
        f"{f['worst_modal_error_mm_s']:.2f} mm/s, of mode {f['worst_mode']} (the paper: 6 mm/s)."
    )


def _implausible_drives(f: Figures) -> Iterator[str]:
    for output, peak in f["peak_drive_V"].items():
        # The record of an output without drive contains only the noise of its probe.
        if not LEAST_DRIVE * peak["predicted"] <= peak["measured"] <= GAINS[1] * max(peak["predicted"], 1.0):
            yield (
                f"The drive of output {output} with law “{f['law']}” was measured as {peak['measured']:.0f} V, and "
                f"{peak['predicted']:.0f} V were predicted: check that the amplifier does not saturate, which probe is "
                "at which amplifier, and `acquisition.probe_attenuation`."
            )


def _implausible_speeds(f: Figures) -> Iterator[str]:
    ratio = float(np.median([peak["measured"] / peak["predicted"] for peak in f["zone_peak_mm_s"].values()]))
    if not COMMON_FACTORS[0] <= ratio <= COMMON_FACTORS[1]:
        yield (
            f"With law “{f['law']}” the zones moved {ratio:.2f} times as fast as predicted: check that the vibrometer "
            "is set to the listed `acquisition.sensitivity_mm_s_per_V` and the amplifier to its `amplifier.gain`, and "
            "that the actuators have no strong hysteresis, or identify the beam again."
        )


def _error(f: Figures, key: str) -> str:
    return f"{f['field_error'][key]['rms_mm_s']:.2f}, {f['field_error'][key]['max_mm_s']:.2f}"


def _joined(values: dict[str, float | None], digits: int = 1) -> str:
    return ", ".join(format_number(value, decimals=digits) for value in values.values())


AROUND = 1.0e-3
"""Time shown before and after the focusing instant: 24 to 26 ms in Fig. 5 [s]."""

WINDOW = 4e-3
"""Length of the Hann window: about one period of a mode at 229 Hz [s]."""

STEP = 0.2e-3
"""Time between two windows [s]."""


def spectrogram(time: FloatArray, velocity: FloatArray, highest: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the amplitude of a velocity over frequency and time.

    Parameters
    ----------
    time : (n,) array
        Evenly spaced times [s].
    velocity : (n,) array
        The velocity [m/s].
    highest : float
        Highest frequency kept [Hz].

    Returns
    -------
    time : (n_times,) array
        Centres of the windows [s].
    frequency : (n_frequencies,) array
        Frequencies from 0 [Hz].
    amplitude : (n_frequencies, n_times) array
        Amplitude of the sine at each frequency [m/s].
    """
    from scipy.signal import spectrogram as of_windows

    step = (time[-1] - time[0]) / (time.size - 1)
    n_window, n_step = min(round(WINDOW / step), velocity.size), max(1, round(STEP / step))
    # Padding with zeros to four windows makes the figure smooth along frequency.
    frequency, middle, amplitude = of_windows(
        velocity, 1 / step, "hann", n_window, n_window - n_step, 4 * n_window, detrend=False, scaling="spectrum",
        mode="magnitude",
    )  # fmt: skip
    kept = frequency <= highest
    return time[0] + middle, frequency[kept], 2 * amplitude[kept]


def around_focus(evidence: Evidence, step: float) -> tuple[FloatArray, FloatArray]:
    """Return times around the focusing instant, about one step apart [s], and velocities, (n_positions, n_times)."""
    time = evidence.times(evidence.field)
    every = max(1, round(step / (time[1] - time[0])))
    near = np.flatnonzero(np.abs(time - evidence.instant) <= AROUND)[::every]
    return time[near], mean_velocity(evidence.field)[:, near]


def spectrogram_of(evidence: Evidence) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the spectrogram at the focus, up to a quarter above the highest modelled mode."""
    highest = 1.25 * float(evidence.stimulus.model.natural_frequency.max())
    return spectrogram(evidence.times(evidence.course), evidence.focus_course, highest)


def figure_tables(evidences: Sequence[Evidence]) -> dict[str, list[dict[str, Any]]]:
    """Return the data of the figures, by file name."""
    first = evidences[0]
    wished = [
        {"mode": label, "wished_mm_s": _round(value), "selected": label in first.stimulus.selected}
        for label, value in enumerate(first.target_coefficient.tolist(), 1)
    ]
    tables = {
        "fig_2.csv": wished,
        "fig_6.csv": [
            {"law": each.stimulus.law, **rounded(line, 3)} for each in evidences for line in coefficients(each)
        ],
        "fig_7.csv": [line for each in evidences for line in _field_lines(each)],
        "fig_8.csv": [line for each in evidences for line in _spectrum_lines(each)],
    }
    if first.further_rows:
        tables["fig_7_map.csv"] = [line for each in evidences for line in _width_lines(each)]
    return tables | {f"fig_5_{each.stimulus.law}.csv": _map_lines(each) for each in evidences}


def _field_lines(evidence: Evidence) -> list[dict[str, Any]]:
    place, errors = evidence.field.positions, standard_error(evidence.snapshots)
    smooth = {
        name: np.interp(place, evidence.position, field)
        for name, field in {
            "wished": evidence.target_field,
            "target": evidence.selected_field,
            "predicted": evidence.predicted_field,
        }.items()
    }
    return [
        {
            "law": evidence.stimulus.law,
            "position_mm": round(float(place[i]) * 1e3, 6),
            **{f"{name}_mm_s": _round(values[i]) for name, values in smooth.items()},
            "measured_mm_s": _round(evidence.measured_points[i]),
            "standard_error_mm_s": _round(errors[i]),
        }
        for i in range(place.size)
    ]


def _width_lines(evidence: Evidence) -> list[dict[str, Any]]:
    """Return field and highest speed over length and width."""
    return [
        {
            "law": evidence.stimulus.law,
            "position_mm": round(float(place) * 1e3, 6),
            "across_mm": round(scan.across * 1e3, 6),
            "velocity_mm_s": _round(velocity),
            "highest_speed_mm_s": _round(speed),
        }
        for scan, *row in zip(
            evidence.rows, evidence.field_over_width.mean(axis=1), evidence.speed_over_width, strict=True
        )
        for place, velocity, speed in zip(scan.positions, *row, strict=True)
    ]


def _map_lines(evidence: Evidence) -> list[dict[str, Any]]:
    time, velocity = around_focus(evidence, 10e-6)
    names = [f"velocity_mm_s_at_{place * 1e3:g}_mm" for place in evidence.field.positions]
    return [
        {"time_ms": round(float(instant) * 1e3, 5), **dict(zip(names, np.round(row * 1e3, 1).tolist(), strict=True))}
        for instant, row in zip(time, velocity.T, strict=True)
    ]


def _spectrum_lines(evidence: Evidence) -> list[dict[str, Any]]:
    """Return the spectrogram at the natural frequencies of the modelled modes."""
    (time, frequency, amplitude), model = spectrogram_of(evidence), evidence.stimulus.model
    rows = [int(np.abs(frequency - natural).argmin()) for natural in model.natural_frequency]
    names = [f"amplitude_mm_s_at_mode_{label}" for label in model.label]
    return [
        {"law": evidence.stimulus.law, "time_ms": round(float(instant) * 1e3, 4)}
        | {name: _round(value) for name, value in zip(names, column, strict=True)}
        for instant, column in zip(time, amplitude[rows].T, strict=True)
    ]


def _round(value: float) -> float | None:
    """Round a velocity in mm/s to 1 um/s; None if it is unknown."""
    return None if not np.isfinite(value) else round(float(value) * 1e3, 3)
