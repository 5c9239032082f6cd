"""Output of an identification: Table I, plain values and files, including the apparatus file with the new table.

Responses and mode shapes are exported for other programs as a universal file (data sets 164, 2411, 58 and 55) or CSV.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np

from modaltouch.lab.identification.files import CSV_COLUMNS
from modaltouch.lab.identification.modal_parameters import Estimate, Identification, IdentifiedMode
from modaltouch.lab.identification.responses import along
from modaltouch.lab.identification.shapes import over_width, phase_collinearity
from modaltouch.lab.identification.verdict import misfit_verdict, repeatability, warnings
from modaltouch.protocol import Apparatus, InputError, Problem, Source
from modaltouch.record import RecordError
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
        "coherence": _number(mode.coherence),
        "left": {"share": _number(mode.rest.share), "smooth": _number(mode.rest.smooth)},
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
            **{name: values[name] for name in ("mac", "phase_collinearity", "coherence")},
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
    """Return the measured shapes in the format read for a stimulus, each the mean over the rows of points."""
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
    found: Identification,
    folder: Path,
    mode: str,
    sources: str | list[str],
    *,
    labels: Sequence[int] = (),
    apparatus: tuple[str, str] | None = None,
    export_to: Path | None = None,
) -> dict[str, Any]:
    """Write table, shapes, figures and apparatus file, and return the plain values with the path of each file.

    Parameters
    ----------
    found : Identification
        The modes.
    folder : Path
        Folder for the results.
    mode, sources
        ``simulated``, ``real`` or ``file``, and the files or folders from which the responses were read.
    labels, apparatus
        Modes of the new table, and name and text of the apparatus file; None without shapes, hence without gains.
    export_to : Path, optional
        File to which the responses and shapes are written for other programs.

    Raises
    ------
    RecordError
        If the folder holds something else or cannot be written.
    """
    from modaltouch.lab.identification.figures import draw_all

    refuse_other(folder, COMMAND)
    values = as_dict(found)
    files: dict[str, Any] = {"table_1.csv": table_rows(found), "identification.json": values}
    if found.shaped:
        files["shapes.csv"] = shape_rows(found)
    if found.shaped and np.any(found.responses.across):
        files["shapes_map.csv"] = map_rows(found)
    table: dict[str, Any] = {"apparatus_file": None}
    if apparatus is not None:
        name, files[name] = apparatus
        table = {"table_modes": list(labels), "apparatus_file": str(folder / name)}
    about = {"version": version(), "sources": sources}
    written = write_files(folder, files, about, COMMAND, **draw_all(found))
    if export_to is not None:
        export(found, export_to)
        written[export_to.name] = export_to
    return {**values, "mode": mode, **table, "files": {name: str(path) for name, path in written.items()}}


def _pair(estimate: Estimate, scale: float = 1.0) -> dict[str, float | None]:
    return {name: _number(getattr(estimate, name) * scale) for name in ("value", "low", "high")}


def _number(value: float) -> float | None:
    """Round a number to nine digits; None if it is not finite, which JSON cannot represent."""
    return float(f"{value:.9g}") if math.isfinite(value) else None


SUFFIX = "_identified"


def identified_apparatus(
    source: Source, identification: Identification, labels: Sequence[int], facts: Mapping[str, Any]
) -> tuple[str, str]:
    """Return name and text of the apparatus file with the identified modes in its table.

    The apparatus has a new name and a section ``identified``, and modes in the new table are removed from the unlisted
    modes of the twin; everything else is kept.

    Parameters
    ----------
    source : Source
        The apparatus file with which the beam was measured.
    identification, labels
        The modes found, and those of the new table, in order.
    facts : mapping
        For the section ``identified``: date, mode, source, generator, scope, method.

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
    # A repeated identification keeps the name.
    document["apparatus"] = name if name.endswith(SUFFIX) else f"{name[: 64 - len(SUFFIX)]}{SUFFIX}"
    document["modes"] = [_mode(identification.by_label[label], identification.responses.sets) for label in labels]
    document.pop("identified", None)
    document["identified"] = {
        **facts,
        "n_points": identification.responses.n_points,
        "n_averages": identification.responses.n_averages,
        "velocity_delay_us": _round(identification.delay.value * 1e6),
        "velocity_delay_interval_us": _interval(identification.delay, 1e6),
        "misfit": _round(identification.misfit, 4),
        "warnings": warnings(identification),
        "replaced_sha256": source.sha256,
    }
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
    """Mark values to be written on one line in YAML."""
    from ruamel.yaml.comments import CommentedMap, CommentedSeq

    made = CommentedSeq(values) if isinstance(values, list) else CommentedMap(values)
    made.fa.set_flow_style()
    return made


ENDINGS = (".uff", ".unv", ".csv")
"""File extensions of an export, which determine its format."""


def check_export(path: Path) -> None:
    """Refuse, before any measurement, a file whose extension is not in `ENDINGS`.

    Raises
    ------
    InputError
        If the extension is not allowed; the message lists the allowed ones.
    """
    if path.suffix.lower() not in ENDINGS:
        given = f"--export with the ending '{path.suffix}'"
        raise InputError(
            [Problem(str(path), 0, 0, "", given, ", ".join(ENDINGS), "give the file one of these endings")]
        )


def export(identification: Identification, path: Path) -> None:
    """Write the measured responses and, in a universal file, the mode shapes, atomically.

    Parameters
    ----------
    identification : Identification
        The responses and the modes found.
    path : Path
        The file; its extension is one of `ENDINGS`.

    Raises
    ------
    RecordError
        If it cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix.lower() == ".csv":
            with part.open("w", encoding="utf-8", newline="") as file:
                file.writelines(_lines(identification))
        else:
            import pyuff

            with catch_warnings():
                # pyuff does not close its file object for binary data.
                simplefilter("ignore", ResourceWarning)
                pyuff.UFF(str(part)).write_sets(list(_sets(identification)), mode="overwrite")
        part.replace(path)
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror}; name another file with --export") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _lines(identification: Identification) -> Iterator[str]:
    """Yield the header and one line per number, in the format that `identify` reads."""
    responses = identification.responses
    coherence, rows = responses.coherence, bool(np.any(responses.across))
    further = ("coherence", "across_mm") if rows else ("coherence",)
    yield ",".join((*CSV_COLUMNS, *further[coherence is None :])) + "\n"
    for s, name in enumerate(responses.sets):
        for p in range(responses.n_points):
            place = "" if responses.positions is None else f"{responses.positions[p] * 1e3:.9g}"
            row = f",{responses.places[p].across * 1e3:.9g}" if rows else ""
            for k, (frequency, value) in enumerate(zip(responses.frequency, responses.response[s, p], strict=True)):
                certain = "" if coherence is None else f",{coherence[s, p, k]:.9g}"
                yield f"{frequency:.12g},{name},{place},{value.real:.9g},{value.imag:.9g}{certain}{row}\n"


def _sets(identification: Identification) -> Iterator[dict[str, Any]]:
    """Yield the data sets in the order of their references to each other, in SI units."""
    responses = identification.responses
    nodes, origin = np.arange(1, responses.n_points + 1), np.zeros(responses.n_points)
    yield {
        "type": 164, "units_code": 1, "units_description": "SI: Meter (newton)", "temp_mode": 1,
        "length": 1.0, "force": 1.0, "temp": 1.0, "temp_offset": 273.15,
    }  # fmt: skip
    if responses.positions is not None:
        yield {
            "type": 2411, "node_nums": nodes, "def_cs": nodes * 0, "disp_cs": nodes * 0, "color": nodes * 0 + 11,
            "x": responses.positions, "y": origin + responses.across, "z": origin,
        }  # fmt: skip
    for s, name in enumerate(responses.sets):
        for p in range(responses.n_points):
            yield {
                "type": 58, "binary": 1, "func_type": 4,
                "id1": f"velocity per {responses.per or 'unit of excitation'}, {name}",
                "id2": "NONE", "id3": "NONE", "id4": "NONE", "id5": "NONE",
                "rsp_node": p + 1, "rsp_dir": 3, "ref_node": responses.n_points + 1 + s, "ref_dir": 3,
                "ord_data_type": 6, "abscissa_spacing": 1, "abscissa_spec_data_type": 18,
                "ordinate_spec_data_type": 11, "orddenom_spec_data_type": 13 if responses.per == "N" else 0,
                "x": responses.frequency, "data": responses.response[s, p],
            }  # fmt: skip
    for number, mode in enumerate(identification.modes, start=1):
        if mode.shape is not None:
            yield {
                "type": 55, "id1": f"mode {mode.name}, of unit mean square", "id2": "NONE",
                "id3": "NONE", "id4": "NONE", "id5": "NONE", "model_type": 1, "analysis_type": 2, "data_ch": 2,
                "spec_data_type": 8, "data_type": 2, "n_data_per_node": 3, "load_case": 1,
                "mode_n": mode.label or number, "freq": mode.natural_frequency.value, "modal_m": 1.0,
                "modal_damp_vis": mode.damping_ratio.value, "modal_damp_his": 0.0,
                "node_nums": nodes, "r1": origin, "r2": origin, "r3": mode.shape,
            }  # fmt: skip
