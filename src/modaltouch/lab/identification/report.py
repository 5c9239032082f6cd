"""An identification as Table I, as plain values and as files, including the apparatus file with the new table."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.lab.identification.estimates import Estimate, Identification, IdentifiedMode
from modaltouch.lab.identification.responses import along
from modaltouch.lab.identification.shapes import over_width, phase_collinearity, phase_deviation, recognise
from modaltouch.lab.identification.verdict import misfit_verdict, repeatability, warnings
from modaltouch.protocol import Apparatus, Source
from modaltouch.report import refuse_other, write_files
from modaltouch.system import version

COMMAND = "identify"
"""The command that owns the folder."""


def mode_values(mode: IdentifiedMode, sets: Sequence[str]) -> dict[str, Any]:
    """Return the estimates for a mode as plain values, units in the keys."""
    gains = {name: _pair(estimate, 1e3) for name, estimate in zip(sets, mode.gain, strict=False)}
    return {
        "label": mode.label,
        "torsion": mode.torsion,
        "n_repeats": mode.n_repeats,
        "natural_frequency_Hz": _pair(mode.natural_frequency),
        "damping_ratio": _pair(mode.damping_ratio),
        "gain_mm_s2_per_V": gains,
        "mac": _number(mode.mac),
        "phase_collinearity": _number(phase_collinearity(mode.residue)),
        "phase_deviation_deg": _number(math.degrees(phase_deviation(mode.residue))),
        "coherence": _number(mode.coherence),
        "left": {"share": _number(mode.rest.share), "smooth": _number(mode.rest.smooth), "cause": mode.rest.cause},
        "half_power": {
            "peak_frequency_Hz": _number(mode.half_power.peak_frequency),
            "damping_ratio": _number(mode.half_power.damping_ratio),
            "gain_mm_s2_per_V": _number(mode.half_power_gain * 1e3),
            "bins": _number(mode.half_power.n_bins),
            "resolved": mode.half_power.verdict == "",
            "warning": mode.half_power.verdict,
        },
    }


def as_dict(identification: Identification) -> dict[str, Any]:
    """Return the identification as plain values, as ``modaltouch identify --json`` prints it."""
    responses = identification.responses
    known = not math.isnan(identification.delay.value)
    # Without shapes to label the modes, their natural frequencies may reveal a free-free beam.
    labelled = any(mode.label for mode in identification.modes)
    beam = None if labelled else recognise([mode.natural_frequency.value for mode in identification.modes])
    return {
        "sets": list(responses.sets),
        "n_points": responses.n_points,
        "n_averages": responses.n_averages,
        "repeatability": repeatability(identification),
        "resolution_Hz": responses.spacing,
        "velocity_delay_us": _pair(identification.delay, 1e6) if known else None,
        "time_offset_us": _number(responses.offset * 1e6),
        "misfit": identification.misfit,
        "misfit_verdict": misfit_verdict(identification),
        "warnings": warnings(identification),
        "modes": [mode_values(mode, responses.sets) for mode in identification.modes],
        "free_free": None if beam is None else beam.as_dict(),
    }


def table_rows(identification: Identification) -> list[dict[str, Any]]:
    """Return Table I as rows for CSV, with intervals and with the half-power estimates beside the fit."""
    rows = []
    for mode in identification.modes:
        values = mode_values(mode, identification.responses.sets)
        row: dict[str, Any] = {"mode": mode.name if mode.label or mode.torsion else ""}
        quantities = {name: values[name] for name in ("natural_frequency_Hz", "damping_ratio")}
        gains = values["gain_mm_s2_per_V"]
        quantities |= {f"gain_{name}_mm_s2_per_V": gains.get(name, {}) for name in identification.responses.sets}
        for name, pair in quantities.items():
            row |= {f"{name}{end}": pair.get(key) for end, key in _ENDS}
        half = values["half_power"]
        row |= {
            "repeatability": f"over {mode.n_repeats} measurements" if mode.n_repeats > 1 else "unknown",
            **{name: values[name] for name in ("mac", "phase_collinearity", "phase_deviation_deg", "coherence")},
            "half_power_frequency_Hz": half["peak_frequency_Hz"],
            "half_power_damping_ratio": half["damping_ratio"],
            "half_power_gain_mm_s2_per_V": half["gain_mm_s2_per_V"],
            "half_power_bins": half["bins"],
            "half_power_warning": half["warning"],
        }
        rows.append(row)
    return rows


_ENDS = (("", "value"), ("_low", "low"), ("_high", "high"))


def shape_rows(identification: Identification) -> list[dict[str, str]]:
    """Return the measured shapes as the stimulus reads them, each the mean over the rows of points."""
    places = identification.responses.places
    shapes = {mode.label: over_width(shape, places) for mode, shape in identification.shaped if mode.label}
    return [
        {"position_mm": f"{place * 1e3:.6g}"}
        | {f"mode_{label}": f"{shape[index]:.6g}" for label, shape in shapes.items()}
        for index, place in enumerate(along(places)[0])
    ]


def map_rows(identification: Identification) -> list[dict[str, str]]:
    """Return the measured shapes over length and width, including torsion."""
    return [
        {"position_mm": f"{place.along * 1e3:.6g}", "across_mm": f"{place.across * 1e3:.6g}"}
        | {f"mode_{mode.name}": f"{shape[index]:.6g}" for mode, shape in identification.shaped}
        for index, place in enumerate(identification.responses.places)
    ]


def write_identification(
    folder: Path, identification: Identification, apparatus: tuple[str, str] | None, about: dict[str, Any]
) -> dict[str, Path]:
    """Write table, shapes, figures and apparatus file into a folder, all or nothing.

    Parameters
    ----------
    folder : Path
        Folder for the files.
    identification : Identification
        The modes found.
    apparatus : (str, str) or None
        Name and text of the apparatus file; None where no gains were measured.
    about : dict
        Further entries of the manifest.

    Raises
    ------
    RecordError
        If the folder holds something else or cannot be written.
    """
    from modaltouch.lab.identification import figures as draw

    refuse_other(folder, COMMAND)
    figures = {
        "responses": draw.draw_responses(identification),
        "fits": draw.draw_fits(identification),
        "stability": draw.draw_stability(identification),
    }
    if any(mode.residue.size > 1 for mode in identification.modes):
        figures["complexity"] = draw.draw_complexity(identification)
    if identification.responses.coherence is not None:
        figures["coherence"] = draw.draw_coherence(identification)
    files: dict[str, Any] = {"table_1.csv": table_rows(identification), "identification.json": as_dict(identification)}
    if identification.shaped:
        figures["fig_4"] = draw.draw_shapes(identification)
        files["shapes.csv"] = shape_rows(identification)
    if identification.shaped and np.any(identification.responses.across):
        figures["fig_4_map"] = draw.draw_shape_maps(identification)
        files["shapes_map.csv"] = map_rows(identification)
    if apparatus is not None:
        files[apparatus[0]] = apparatus[1]
    return write_files(folder, files, {"version": version(), **about}, COMMAND, figures)


def _pair(estimate: Estimate, scale: float = 1.0) -> dict[str, float | None]:
    return {name: _number(getattr(estimate, name) * scale) for name in ("value", "low", "high")}


def _number(value: float) -> float | None:
    """Return a number rounded to nine digits; None if it is not finite, since JSON has no such number."""
    return float(f"{value:.9g}") if math.isfinite(value) else None


SUFFIX = "_identified"


def identified_apparatus(
    source: Source, identification: Identification, labels: Sequence[int], facts: Mapping[str, Any]
) -> tuple[str, str]:
    """Return name and text of the apparatus file with the identified modes in its table.

    The apparatus gets a new name and a section ``identified``, and modes now in the table are removed from the twin's
    unlisted ones; the rest is kept.

    Parameters
    ----------
    source : Source
        The apparatus file with which the beam was measured.
    identification : Identification
        The modes found.
    labels : sequence of int
        Modes of the new table, in order.
    facts : mapping
        For the section ``identified``: date, mode, source, generator, scope, method.

    Returns
    -------
    name : str
        Name of the file.
    text : str
        Its contents, which `modaltouch.protocol.Apparatus` reads.

    Raises
    ------
    InputError
        If the text cannot be read back.
    """
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.width = 120
    document = yaml.load(source.text)
    name = str(document["apparatus"])
    # A second identification keeps the name.
    document["apparatus"] = name if name.endswith(SUFFIX) else f"{name[: 64 - len(SUFFIX)]}{SUFFIX}"
    document["modes"] = [_mode(identification.mode(label), identification.responses.sets) for label in labels]
    document.pop("identified", None)
    document["identified"] = {**facts, **_figures(identification), "replaced_sha256": source.sha256}
    unlisted = document.get("twin", {}).get("unlisted_modes")
    if unlisted:
        kept = [each for each in unlisted if each.get("family") == "torsion" or each["label"] not in labels]
        if len(kept) < len(unlisted):
            document["twin"]["unlisted_modes"] = kept
    buffer = io.StringIO()
    yaml.dump(document, buffer)
    text = buffer.getvalue()
    file_name = f"{document['apparatus']}.yaml"
    Apparatus.read(Source(Path(file_name), text))
    return file_name, text


def _figures(identification: Identification) -> dict[str, Any]:
    """Return the extent of the measurement, and the results that belong to no single mode."""
    delay = identification.delay
    return {
        "n_points": identification.responses.n_points,
        "n_averages": identification.responses.n_averages,
        "velocity_delay_us": _round(delay.value * 1e6),
        "velocity_delay_interval_us": _interval(delay, 1e6),
        "misfit": _round(identification.misfit, 4),
        "warnings": warnings(identification),
    }


def _mode(mode: IdentifiedMode, sets: Sequence[str]) -> Any:
    gains = dict(zip(sets, mode.gain, strict=True))
    half = mode.half_power
    picked = f"half-power {half.verdict}" if half.verdict else f"half-power {half.damping_ratio:.4g}"
    return {
        "label": mode.label,
        "natural_frequency_Hz": _round(mode.natural_frequency.value),
        "damping_ratio": _round(mode.damping_ratio.value),
        "gain_mm_s2_per_V": _flow({name: _round(gain.value * 1e3) for name, gain in gains.items()}),
        "intervals_95": {
            "natural_frequency_Hz": _interval(mode.natural_frequency),
            "damping_ratio": _interval(mode.damping_ratio),
            "gain_mm_s2_per_V": _flow({name: _interval(gain, 1e3) for name, gain in gains.items()}),
        },
        "provenance": {
            "natural_frequency_Hz": f"joint fit; picked peak {half.peak_frequency:.6g} Hz",
            "damping_ratio": f"joint fit; {picked}",
            "gain_mm_s2_per_V": f"joint fit, residues on the measured shape, MAC {mode.mac:.4f}, coherence "
            f"{mode.coherence:.3f}",
        },
    }


def _interval(estimate: Estimate, scale: float = 1.0) -> Any:
    return _flow([_round(estimate.low * scale), _round(estimate.high * scale)])


def _round(value: float, digits: int = 7) -> float:
    return float(f"{value:.{digits}g}")


def _flow(values: Any) -> Any:
    """Return values that YAML writes on one line."""
    from ruamel.yaml.comments import CommentedMap, CommentedSeq

    made = CommentedSeq(values) if isinstance(values, list) else CommentedMap(values)
    made.fa.set_flow_style()
    return made
