"""The command ``modaltouch validate``: recordings of both drive laws, their evaluation, and a page of results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from modaltouch.lab.identification.shapes import check_points
from modaltouch.lab.laboratory import SILENT_PROGRESS, SIMULATED, MeasurementProgress, open_laboratory
from modaltouch.lab.output import rounded, title_of
from modaltouch.lab.recorded_files import RecordedFiles
from modaltouch.lab.scan import Scan, rows_over
from modaltouch.lab.validation.evidence import Evidence, evaluate
from modaltouch.lab.validation.figures import (
    PAPER_WORST,
    around_focus,
    draw_coefficients,
    draw_decomposition,
    draw_drives,
    draw_fields,
    draw_maps,
    draw_over_width,
    draw_spectrograms,
    draw_zones,
    spectrogram_of,
)
from modaltouch.lab.validation.key_figures import coefficients, findings, key_figures, validation_table
from modaltouch.lab.validation.recording import Observation, complete, read_laws, record_laws
from modaltouch.preflight import Preflight, examine
from modaltouch.report import ReportFigure, page_files, refuse_other, write_files
from modaltouch.system import commit, version

COMMAND = "validate"
"""The command that owns the folder."""

MAP_CSV_STEP = 10e-6
"""Time step of the map's table [s]."""


def write_validation(
    evidences: Sequence[Evidence], pairs: Sequence[tuple[str, str]], context: dict[str, Any], folder: Path
) -> dict[str, Any]:
    """Write page, figures and tables, and return the plain values with the path of each file.

    Parameters
    ----------
    evidences : sequence of Evidence
        The evidence for each law.
    pairs : sequence of (str, str)
        Pairs of zones touched by two fingers.
    context : dict
        Plain values on the validation: ``title`` and ``protocol`` (its file), ``apparatus``, ``mode``, ``generator``,
        ``scope``, ``limit`` (highest voltage at the beam [V]), ``calibration`` (its file or None) and ``commit``.
    folder : Path
        Folder for the results.

    Raises
    ------
    RecordError
        If the folder holds something else or cannot be written.
    """
    refuse_other(folder, COMMAND)
    figures, lag = [key_figures(each, pairs) for each in evidences], evidences[0].lag * 1e6
    shown = ("protocol", "apparatus", "mode", "generator", "scope", "calibration")
    # Anything below a millionth of a unit is not significant.
    values = rounded({key: context[key] for key in shown} | {"measurement_lag_us": lag, "laws": figures}, 6)
    files = page_files(
        "modaltouch.lab",
        "validation",
        [ReportFigure(name, *each) for name, each in _draw(evidences, context["limit"]).items()],
        title=f"Validation: {context['title']}",
        occasion=context,
        level=format(round(evidences[0].observation.velocity * 1e3, 6), "g"),
        laws=[each.law for each in evidences],
        figures=figures,
        lag=lag,
        paper_worst=PAPER_WORST,
        findings=findings(figures),
        rows=validation_table(figures),
    )
    tables = {"validation.json": values, **_tables(evidences)}
    written = write_files(folder, files | tables, {"version": version()}, COMMAND)
    return {**values, "files": {name: str(path) for name, path in written.items()}}


def validate(
    protocol: Path,
    *,
    calibration: Path | None = None,
    rig: str = SIMULATED,
    out: Path | None = None,
    scan: Path | None = None,
    points: int = 41,
    averages: int = 10,
    rows: int = 1,
    record: Path | None = None,
    progress: MeasurementProgress = SILENT_PROGRESS,
) -> dict[str, Any]:
    """Play the drive of both laws, scan the beam, and report the measured fields with the target and the prediction.

    Parameters
    ----------
    protocol : Path
        A YAML file, or the name of a shipped protocol.
    calibration : Path, optional
        Calibration file to use instead of the one named in the protocol.
    rig : str
        ``simulated``, or the generator's VISA address.
    out : Path, optional
        Folder for page, figures and tables; ``validation/<protocol>`` if not given.
    scan : Path, optional
        Folder for the recordings; an interrupted scan is resumed from it, a complete one needs no rig.
    points, averages : int
        Points along the beam, and records at each.
    rows : int
        Number of rows of points to measure across the width, odd; torsion requires three or more. A complete scan is
        read with all its rows.
    record : Path, optional
        Folder into which another scope saves its records as files; a PicoScope is used if not given.
    progress : MeasurementProgress, optional
        Reports progress and lets the user interrupt.

    Raises
    ------
    InputError
        If the protocol or its calibration has faults.
    ValueError
        If the points are too few to distinguish the modelled modes.
    RecordError
        If a folder holds something else or cannot be written.
    RigError
        If the rig fails.
    """
    preflight = examine(protocol, calibration, marked=True).of_untouched_beam().of_one_stimulus()
    folder = out or Path("validation") / preflight.experiment.protocol.protocol
    refuse_other(folder, COMMAND)
    model = preflight.stimulus.model
    check_points(np.linspace(-model.length / 2, model.length / 2, points), model.label, model.length)
    beside = [across for across in rows_over(preflight.experiment.apparatus, rows) if across]
    observed = _observe(preflight, rig, scan, points, averages, beside, record, progress)
    context = _context(preflight, protocol, observed[0].field)
    return write_validation(evaluate(observed), preflight.experiment.protocol.conditions.pairs, context, folder)


def _observe(
    preflight: Preflight,
    rig: str,
    folder: Path | None,
    points: int,
    averages: int,
    rows: Sequence[float],
    record: Path | None,
    progress: MeasurementProgress,
) -> list[Observation]:
    """Take the recordings, or read earlier ones."""
    experiment, (inputs, stimulus) = preflight.experiment, preflight.sound
    if folder is not None and complete(folder, rows):
        return read_laws(inputs, folder)
    with progress.interruptible() as heard:
        scope = RecordedFiles(record, experiment.apparatus, heard) if record else None
        with open_laboratory(experiment.apparatus, rig, heard, scope=scope) as laboratory:
            return record_laws(
                inputs,
                laboratory,
                stimulus.target_field.velocity,
                n_points=points,
                n_records=averages,
                rows=rows,
                folder=folder,
                source=experiment.sources.apparatus,
            )


def _context(preflight: Preflight, protocol: Path, field: Scan) -> dict[str, Any]:
    experiment, calibration = preflight.experiment, preflight.findings.calibration
    return {
        "title": title_of(preflight),
        "protocol": str(protocol),
        "apparatus": experiment.apparatus.apparatus,
        "mode": field.mode,
        "generator": field.facts["settings"]["generator"],
        "scope": field.facts["settings"]["scope"],
        "limit": experiment.apparatus.amplifier.limit_V,
        "calibration": None if calibration is None else str(calibration.source.path),
        "commit": commit(),
    }


def _draw(evidences: Sequence[Evidence], limit: float) -> dict[str, tuple[Figure, str]]:
    """Draw the figures, each with its caption, by file name."""
    drawn = {
        "fig_2": (
            draw_decomposition(evidences[0]),
            "Fig. 2: the desired field decomposed on the modes of the beam. The strongest of the modelled modes are "
            "selected; the other modelled modes are at rest at the focusing instant.",
        ),
        "fig_5": (
            draw_maps(evidences),
            "Fig. 5: measured velocity by position and time. Black lines: half of the level. The dotted line is the "
            "focusing instant.",
        ),
        "fig_6": (
            draw_coefficients(evidences),
            "Fig. 6: desired coefficients of the selected modes, those predicted on the identified beam, and "
            "those measured (least squares over all points at the focusing instant). Right: their difference with 95 % "
            "intervals from record to record.",
        ),
        "fig_7": (
            draw_fields(evidences),
            "Fig. 7: the field at the focusing instant, points with 95 % intervals, and the difference of the "
            "measured field from the desired one and from that of the selected modes [mm/s].",
        ),
        "fig_8": (
            draw_spectrograms(evidences),
            "Fig. 8: spectrogram of the measured velocity at the focus (Hann window of 4 ms). Marks on the left: the "
            "modelled modes, with the selected ones in bold.",
        ),
    }
    if evidences[0].observation.rows:
        drawn["fig_7_map"] = (
            draw_over_width(evidences),
            "Fig. 7 over the width: measured velocity at the focusing instant, the highest speed within 1 ms of it, "
            "and torsion, which grows linearly across the beam.",
        )
    for evidence in evidences:
        drawn[f"zones_{evidence.law}"] = (
            draw_zones(evidence),
            f"Velocity at the centre of each zone over time, law “{evidence.law}”.",
        )
    drawn["drive"] = (draw_drives(evidences, limit), "Drive as measured at the beam.")
    return drawn


def _tables(evidences: Sequence[Evidence]) -> dict[str, list[dict[str, Any]]]:
    """Return the data of the figures, by file name."""
    first = evidences[0]
    wished = [
        {"mode": label, "wished_mm_s": _round(value), "selected": label in first.observation.stimulus.selected}
        for label, value in enumerate(first.target_coefficient.tolist(), 1)
    ]
    tables = {
        "fig_2.csv": wished,
        "fig_6.csv": [{"law": each.law, **rounded(line, 3)} for each in evidences for line in coefficients(each)],
        "fig_7.csv": [line for each in evidences for line in _field_lines(each)],
        "fig_8.csv": [line for each in evidences for line in _spectrum_lines(each)],
    }
    if first.observation.rows:
        tables["fig_7_map.csv"] = [line for each in evidences for line in _width_lines(each)]
    return tables | {f"fig_5_{each.law}.csv": _map_lines(each) for each in evidences}


def _field_lines(evidence: Evidence) -> list[dict[str, Any]]:
    place = evidence.observation.field.positions
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
            "law": evidence.law,
            "position_mm": round(float(place[i]) * 1e3, 6),
            **{f"{name}_mm_s": _round(values[i]) for name, values in smooth.items()},
            "measured_mm_s": _round(evidence.measured_points[i]),
            "standard_error_mm_s": _round(evidence.points_error[i]),
        }
        for i in range(place.size)
    ]


def _width_lines(evidence: Evidence) -> list[dict[str, Any]]:
    """Return field and highest speed over length and width."""
    return [
        {
            "law": evidence.law,
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
    time, velocity = around_focus(evidence, MAP_CSV_STEP)
    names = [f"velocity_mm_s_at_{place * 1e3:g}_mm" for place in evidence.observation.field.positions]
    return [
        {"time_ms": round(float(instant) * 1e3, 5), **dict(zip(names, np.round(row * 1e3, 1).tolist(), strict=True))}
        for instant, row in zip(time, velocity.T, strict=True)
    ]


def _spectrum_lines(evidence: Evidence) -> list[dict[str, Any]]:
    """Return the spectrogram at the natural frequencies of the modelled modes."""
    (time, frequency, amplitude), model = spectrogram_of(evidence), evidence.observation.stimulus.model
    rows = [int(np.abs(frequency - natural).argmin()) for natural in model.natural_frequency]
    names = [f"amplitude_mm_s_at_mode_{label}" for label in model.label]
    return [
        {"law": evidence.law, "time_ms": round(float(instant) * 1e3, 4)}
        | {name: _round(value) for name, value in zip(names, column, strict=True)}
        for instant, column in zip(time, amplitude[rows].T, strict=True)
    ]


def _round(value: float) -> float | None:
    """Round a velocity in mm/s to 1 um/s; None if it is unknown."""
    return None if not np.isfinite(value) else round(float(value) * 1e3, 3)
