"""The evidence on one page, and as files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from modaltouch.lab.validation.evidence import Evidence
from modaltouch.lab.validation.figures import (
    PAPER_WORST,
    around_focus,
    draw_coefficients,
    draw_decomposition,
    draw_drives,
    draw_fields,
    draw_maps,
    draw_spectrograms,
    draw_zones,
    spectrogram_of,
)
from modaltouch.lab.validation.key_figures import coefficients, findings, summary
from modaltouch.report import (
    csv_bytes,
    embed_svg,
    json_bytes,
    level_label,
    refuse_other,
    render,
    render_page,
    write_files,
)
from modaltouch.system import version

COMMAND = "validate"
"""The command that owns the folder."""

MAP_CSV_STEP = 10e-6
"""From one instant of the map's table to the next [s]."""


@dataclass(frozen=True)
class ValidationContext:
    """What was validated, and where.

    Attributes
    ----------
    title : str
        Of the protocol.
    protocol : str
        Its file.
    apparatus : str
        Name of the apparatus.
    mode : str
        ``simulated`` or ``real``.
    generator, scope : str
        What they call themselves.
    limit : float
        Highest voltage at the beam [V].
    calibration : str
        File of the calibration that the exact law was corrected by; empty without one.
    commit : str
        Of the program.
    """

    title: str
    protocol: str
    apparatus: str
    mode: str
    generator: str
    scope: str
    limit: float
    calibration: str
    commit: str


def write_evidence(
    folder: Path, evidences: Sequence[Evidence], figures: Sequence[dict[str, Any]], occasion: ValidationContext
) -> dict[str, Path]:
    """Write page, figures and tables into a folder, and return where each file lies.

    Parameters
    ----------
    folder : Path
        Where the files go; made where it does not exist.
    evidences : sequence of Evidence
        Of each law.
    figures : sequence of dict
        As `key_figures` returns them, one to each law.
    occasion : ValidationContext
        What was validated.

    Raises
    ------
    RecordError
        If the folder holds something else, or cannot be written.
    """
    refuse_other(folder, COMMAND)
    pictures = _draw(evidences, occasion)
    files: dict[str, bytes] = {}
    vectors = {}
    for name, (figure, _) in pictures.items():
        vectors[name] = render(figure, "svg")
        files |= {f"{name}.svg": vectors[name], f"{name}.png": render(figure, "png")}
    values = as_dict(evidences, figures, occasion)
    files["validation.json"] = json_bytes(values)
    files |= _tables(evidences)
    page = render_page(
        "modaltouch.lab.validation",
        "validation.html.j2",
        title=f"Validation: {occasion.title}",
        occasion=occasion,
        level=level_label(round(evidences[0].observation.velocity * 1e3, 6)),
        laws=[each.law for each in evidences],
        figures=figures,
        lag=evidences[0].lag * 1e6,
        paper_worst=PAPER_WORST,
        findings=findings(figures),
        rows=summary(figures),
        pictures=[
            {"name": name, "caption": caption, "uri": embed_svg(vectors[name])}
            for name, (_, caption) in pictures.items()
        ],
        version=version(),
    )
    return write_files(folder, {"validation.html": page.encode(), **files}, {"version": version()}, COMMAND)


def as_dict(
    evidences: Sequence[Evidence], figures: Sequence[dict[str, Any]], occasion: ValidationContext
) -> dict[str, Any]:
    """Return everything as plain values, as ``modaltouch validate --json`` prints it."""
    values = {
        "protocol": occasion.protocol,
        "apparatus": occasion.apparatus,
        "mode": occasion.mode,
        "generator": occasion.generator,
        "scope": occasion.scope,
        "calibration": occasion.calibration or None,
        "measurement_lag_us": evidences[0].lag * 1e6,
        "laws": list(figures),
    }
    return {key: _plain(value) for key, value in values.items()}


def _plain(value: Any) -> Any:
    """Return plain values with every number to a millionth of its unit: what lies below is no measurement."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return round(value, 6) if isinstance(value, float) else value


def _draw(evidences: Sequence[Evidence], occasion: ValidationContext) -> dict[str, tuple[Figure, str]]:
    """Return each figure with its caption, by its file's name."""
    drawn = {
        "fig_2": (
            draw_decomposition(evidences[0]),
            "Fig. 2: the wished field decomposed on the modes of the beam. The strongest of the modelled modes are "
            "selected; the others of them are to rest at the focusing instant.",
        ),
        "fig_5": (
            draw_maps(evidences),
            "Fig. 5: measured velocity by position and time. Black lines: half of the level. The dotted line is the "
            "focusing instant.",
        ),
        "fig_6": (
            draw_coefficients(evidences),
            "Fig. 6: coefficients of the selected modes as wished, as predicted on the identified beam, and as "
            "measured (least squares over all points at the focusing instant). Right: their difference with 95 % "
            "intervals from record to record.",
        ),
        "fig_7": (
            draw_fields(evidences),
            "Fig. 7: the field at the focusing instant, points with 95 % intervals, and how far the measured field is "
            "from the wished one and from that of the selected modes [mm/s].",
        ),
        "fig_8": (
            draw_spectrograms(evidences),
            "Fig. 8: spectrogram of the measured velocity at the focus (Hann window of 4 ms). Marks at the left: the "
            "modelled modes, the selected ones bold.",
        ),
    }
    for evidence in evidences:
        drawn[f"zones_{evidence.law}"] = (
            draw_zones(evidence),
            f"Velocity at the centre of each zone over time, law “{evidence.law}”.",
        )
    drawn["drive"] = (draw_drives(evidences, occasion.limit), "Drive as measured at the beam.")
    return drawn


def _tables(evidences: Sequence[Evidence]) -> dict[str, bytes]:
    """Return the numbers behind the figures, by file name."""
    first = evidences[0]
    wished = [
        {"mode": label, "wished_mm_s": _round(value), "selected": label in first.observation.stimulus.selected}
        for label, value in enumerate(first.wished_coefficient.tolist(), 1)
    ]
    tables = {
        "fig_2.csv": wished,
        "fig_6.csv": [{"law": each.law, **_rounded(line)} for each in evidences for line in coefficients(each)],
        "fig_7.csv": [line for each in evidences for line in _field_lines(each)],
        "fig_8.csv": [line for each in evidences for line in _spectrum_lines(each)],
    }
    for each in evidences:
        tables[f"fig_5_{each.law}.csv"] = _map_lines(each)
    return {name: csv_bytes(lines) for name, lines in tables.items()}


def _field_lines(evidence: Evidence) -> list[dict[str, Any]]:
    place = evidence.observation.field.positions
    smooth = {
        name: np.interp(place, evidence.position, getattr(evidence, f"{name}_field"))
        for name in ("wished", "target", "predicted")
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


def _map_lines(evidence: Evidence) -> list[dict[str, Any]]:
    time, velocity = around_focus(evidence, MAP_CSV_STEP)
    names = [f"velocity_mm_s_at_{place * 1e3:g}_mm" for place in evidence.observation.field.positions]
    return [
        {"time_ms": round(float(instant) * 1e3, 5), **dict(zip(names, np.round(row * 1e3, 1).tolist(), strict=True))}
        for instant, row in zip(time, velocity.T, strict=True)
    ]


def _spectrum_lines(evidence: Evidence) -> list[dict[str, Any]]:
    """Return the spectrogram at the natural frequencies of the modelled modes."""
    one, model = spectrogram_of(evidence), evidence.observation.stimulus.model
    rows = [int(np.abs(one.frequency - frequency).argmin()) for frequency in model.natural_frequency]
    names = [f"amplitude_mm_s_at_mode_{label}" for label in model.label]
    return [
        {"law": evidence.law, "time_ms": round(float(instant) * 1e3, 4)}
        | {name: _round(value) for name, value in zip(names, column, strict=True)}
        for instant, column in zip(one.time, one.amplitude[rows].T, strict=True)
    ]


def _round(value: float) -> float | None:
    """Return a velocity in mm/s to the micrometre per second; None where it is not known."""
    return None if not np.isfinite(value) else round(float(value) * 1e3, 3)


def _rounded(line: dict[str, Any]) -> dict[str, Any]:
    return {key: round(value, 3) if isinstance(value, float) else value for key, value in line.items()}
