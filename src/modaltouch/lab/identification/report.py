"""An identification as Table I, as plain values, and as files: among them the apparatus file with the new table."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.identification.estimates import Estimate, Identification, IdentifiedMode
from modaltouch.protocol import InputError, Source, examine_apparatus
from modaltouch.report import csv_bytes, json_bytes, refuse_other, write_files
from modaltouch.stimulus import characteristic_root
from modaltouch.system import version

FloatArray = NDArray[np.float64]

WITHIN = 0.005
"""Largest deviation from the ratios of a free-free beam by which they count as recognised [1]."""

FEWEST = 3
"""Natural frequencies that it takes to recognise a beam; one more where shear and inertia are free."""


@dataclass(frozen=True)
class FreeFree:
    """The free-free beam that natural frequencies fit best.

    Attributes
    ----------
    first_frequency : float
        Of its first bending mode [Hz].
    shear : float
        How much shear and rotary inertia lower its modes, of the order (h/L)^2; 0 by Euler and Bernoulli [1].
    mode : tuple of (int or None)
        Bending mode of each natural frequency, from 1; None for what is none.
    deviation : float
        Largest relative deviation of the natural frequencies that are bending modes [1].
    recognised : bool
        Whether they are a free-free beam's.
    """

    first_frequency: float
    shear: float
    mode: tuple[int | None, ...]
    deviation: float
    recognised: bool


def roots(n: int) -> FloatArray:
    """Return the first roots of cos(x) cosh(x) = 1 above 0, (n,) array [1]."""
    return np.array([characteristic_root(k) for k in range(1, n + 1)])


def recognise(natural_frequency: Sequence[float]) -> FreeFree | None:
    r"""Return the free-free beam that natural frequencies fit best; None for fewer than three.

    By Euler and Bernoulli :math:`f_n \propto \lambda_n^2`. Shear and rotary inertia lower it by a factor that is
    :math:`1/\sqrt{1 + s \lambda_n^2}` to first order in s, the squared slenderness times a constant of the section. The
    lowest frequency is tried as each of the first three bending modes; others may be of torsion or across.

    Parameters
    ----------
    natural_frequency : sequence of float
        Increasing [Hz].
    """
    measured = np.asarray(natural_frequency, dtype=float)
    if measured.size < FEWEST:
        return None
    square = roots(measured.size + 8) ** 2
    tried = [
        _fit(measured, first, mode, float(shear), square)
        for first in range(min(3, measured.size))
        for mode in range(3)
        for shear in np.concatenate([[0.0], np.geomspace(1e-5, 1e-2, 121)])
    ]
    return max(tried, key=_worth)


def _fit(measured: FloatArray, first: int, mode: int, shear: float, square: FloatArray) -> FreeFree:
    """Return the beam of which one frequency is a given bending mode."""
    course = square / np.sqrt(1 + shear * square)
    ratio = measured[:, None] / measured[first] * course[mode] / course
    nearest = np.abs(np.log(ratio)).argmin(axis=1)
    # The scale that suits all that fit, instead of that of one alone.
    fits = np.abs(ratio[np.arange(measured.size), nearest] - 1) <= WITHIN
    scale = float(np.median(measured[fits] / course[nearest[fits]]))
    off = np.abs(measured / (scale * course[nearest]) - 1)
    fits = off <= WITHIN
    labels = [int(k) + 1 if fit else None for k, fit in zip(nearest, fits, strict=True)]
    found = [label for label in labels if label is not None]
    enough = FEWEST if shear == 0 else FEWEST + 1
    # Successive modes, each once: many high ones match anything.
    successive = len(set(found)) == len(found) and bool(found) and max(found) - min(found) + 1 <= len(found) + 1
    deviation = float(off[fits].max()) if fits.any() else 1.0
    recognised = successive and len(found) >= enough and 2 * len(found) > measured.size
    return FreeFree(scale * float(course[0]), shear, tuple(labels), deviation, recognised)


def _worth(tried: FreeFree) -> tuple[bool, int, float]:
    """Rank what was tried: recognised, with many modes, near them; shear and inertia only where they are needed."""
    n_found = sum(mode is not None for mode in tried.mode)
    return tried.recognised, n_found, -tried.deviation - (WITHIN / 2 if tried.shear > 0 else 0.0)


LEAST_COHERENCE = 0.5
"""Median coherence at a mode's peak below which nothing of it is believed [1]."""

COMMAND = "identify"
"""The command that owns the folder."""


def check_modes(identification: Identification, labels: Sequence[int]) -> None:
    """Refuse an identification that lacks a mode, or has seen it too weakly.

    Parameters
    ----------
    identification : Identification
        What was found.
    labels : sequence of int
        Modes that are wanted.

    Raises
    ------
    ValueError
        With every mode that is missing or incoherent, and what to do.
    """
    found = {mode.label: mode for mode in identification.modes if mode.label is not None}
    lines = []
    for label in labels:
        if label not in found:
            lines.append(
                f"mode {label} was not found: no resonance has its shape; drive harder, average more, or look higher "
                "with --highest-kHz"
            )
        elif found[label].coherence < LEAST_COHERENCE:
            lines.append(
                f"mode {label} has a coherence of {found[label].coherence:.2f} at its peak, at least "
                f"{LEAST_COHERENCE:g} is needed: drive harder (--drive-V) or average more (--averages)"
            )
    if lines:
        raise ValueError("\n".join(lines))


def mode_values(mode: IdentifiedMode, sets: Sequence[str]) -> dict[str, Any]:
    """Return what was found of a mode as plain values, units in the keys."""
    gains = {name: _pair(estimate, 1e3) for name, estimate in zip(sets, mode.gain, strict=False)}
    return {
        "label": mode.label,
        "natural_frequency_Hz": _pair(mode.natural_frequency),
        "damping_ratio": _pair(mode.damping_ratio),
        "gain_mm_s2_per_V": gains,
        "mac": _number(mode.mac),
        "coherence": _number(mode.coherence),
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
    """Return everything as plain values, as ``modaltouch identify --json`` prints it."""
    responses = identification.responses
    known = not math.isnan(identification.delay.value)
    beam = free_free(identification)
    return {
        "sets": list(responses.sets),
        "n_points": responses.n_points,
        "n_averages": responses.n_averages,
        "resolution_Hz": responses.spacing,
        "velocity_delay_us": _pair(identification.delay, 1e6) if known else None,
        "misfit": identification.misfit,
        "modes": [mode_values(mode, responses.sets) for mode in identification.modes],
        "free_free": None
        if beam is None
        else {
            "recognised": beam.recognised,
            "first_frequency_Hz": beam.first_frequency,
            "bending_modes": list(beam.mode),
            "shear": beam.shear,
            "deviation": beam.deviation,
        },
    }


def free_free(identification: Identification) -> FreeFree | None:
    """Return the free-free beam that the natural frequencies fit, where no shape says which mode they are of."""
    if any(mode.label for mode in identification.modes):
        return None
    return recognise([mode.natural_frequency.value for mode in identification.modes])


def table_csv(identification: Identification) -> bytes:
    """Return Table I with intervals, and half-power beside the fit, as CSV."""
    rows = []
    for mode in identification.modes:
        values = mode_values(mode, identification.responses.sets)
        row: dict[str, Any] = {"mode": values["label"] or ""}
        for name in ("natural_frequency_Hz", "damping_ratio"):
            row |= {
                name: values[name]["value"],
                f"{name}_low": values[name]["low"],
                f"{name}_high": values[name]["high"],
            }
        for set_name in identification.responses.sets:
            pair = values["gain_mm_s2_per_V"].get(set_name, {"value": "", "low": "", "high": ""})
            row |= {f"gain_{set_name}_mm_s2_per_V{end}": pair[key] for end, key in _ENDS}
        half = values["half_power"]
        row |= {
            "mac": values["mac"],
            "coherence": values["coherence"],
            "half_power_frequency_Hz": half["peak_frequency_Hz"],
            "half_power_damping_ratio": half["damping_ratio"],
            "half_power_gain_mm_s2_per_V": half["gain_mm_s2_per_V"],
            "half_power_bins": half["bins"],
            "half_power_warning": half["warning"],
        }
        rows.append({key: "" if value is None else value for key, value in row.items()})
    return csv_bytes(rows)


_ENDS = (("", "value"), ("_low", "low"), ("_high", "high"))


def shapes_csv(identification: Identification) -> bytes:
    """Return the measured shapes as `modaltouch.stimulus.measured` reads them."""
    positions = identification.responses.positions
    modes = [mode for mode in identification.modes if mode.label is not None and mode.shape is not None]
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["position_mm", *(f"mode_{mode.label}" for mode in modes)])
    for index, place in enumerate([] if positions is None else positions):
        values = [float(mode.shape[index]) for mode in modes if mode.shape is not None]
        writer.writerow([f"{place * 1e3:.6g}", *(f"{value:.6g}" for value in values)])
    return buffer.getvalue().encode()


def write_identification(
    folder: Path, identification: Identification, apparatus: tuple[str, str] | None, about: dict[str, Any]
) -> dict[str, Path]:
    """Write table, shapes, figures and apparatus file into a folder, all or nothing.

    Parameters
    ----------
    folder : Path
        Where they go.
    identification : Identification
        What was found.
    apparatus : (str, str) or None
        Name and text of the apparatus file; None where no gains were measured.
    about : dict
        What the manifest says besides.

    Raises
    ------
    RecordError
        If the folder holds something else, or cannot be written.
    """
    from modaltouch.lab.identification.figures import draw_coherence, draw_responses, draw_shapes
    from modaltouch.report import render

    refuse_other(folder, COMMAND)
    figures = {"responses": draw_responses(identification)}
    if identification.responses.coherence is not None:
        figures["coherence"] = draw_coherence(identification)
    shaped = any(mode.shape is not None for mode in identification.modes)
    if shaped:
        figures["fig_4"] = draw_shapes(identification)
    values = as_dict(identification)
    files = {
        "table_1.csv": table_csv(identification),
        "identification.json": json_bytes(values),
    }
    if shaped:
        files["shapes.csv"] = shapes_csv(identification)
    if apparatus is not None:
        files[apparatus[0]] = apparatus[1].encode()
    for name, figure in figures.items():
        files |= {f"{name}.{kind}": render(figure, kind) for kind in ("svg", "png")}
    return write_files(folder, files, {"version": version(), **about}, COMMAND)


def _pair(estimate: Estimate, scale: float = 1.0) -> dict[str, float | None]:
    return {name: _number(getattr(estimate, name) * scale) for name in ("value", "low", "high")}


def _number(value: float) -> float | None:
    """Return a number that JSON has, rounded beyond what any measurement gives."""
    return float(f"{value:.9g}") if math.isfinite(value) else None


SUFFIX = "_identified"


def identified_apparatus(
    source: Source, identification: Identification, labels: Sequence[int], facts: Mapping[str, Any]
) -> tuple[str, str]:
    """Return name and text of an apparatus file with the identified modes; everything else stays as it was.

    Parameters
    ----------
    source : Source
        The apparatus file that the beam was measured with.
    identification : Identification
        What was found.
    labels : sequence of int
        Modes that go into the table, in order.
    facts : mapping
        For the section ``identified``: date, mode, source, generator, scope, method.

    Returns
    -------
    name : str
        Of the file.
    text : str
        Of the file, which `modaltouch.protocol.apparatus.read_apparatus` reads.

    Raises
    ------
    InputError
        If it could not be read back.
    """
    from ruamel.yaml import YAML

    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.width = 120
    document = yaml.load(source.text)
    name = str(document["apparatus"])
    # The table is of this beam now: a second identification keeps the name.
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
    _, problems = examine_apparatus(Source(Path(file_name), text))
    if problems:
        raise InputError(problems)
    return file_name, text


def _figures(identification: Identification) -> dict[str, Any]:
    """Return how much was measured, and what was found that is of no single mode."""
    delay = identification.delay
    return {
        "n_points": identification.responses.n_points,
        "n_averages": identification.responses.n_averages,
        "velocity_delay_us": _round(delay.value * 1e6),
        "velocity_delay_interval_us": _interval(delay, 1e6),
        "misfit": _round(identification.misfit, 4),
    }


def _mode(mode: IdentifiedMode, sets: Sequence[str]) -> Any:
    gains = dict(zip(sets, mode.gain, strict=True))
    half = mode.half_power
    picked = f"half-power {half.verdict}" if half.verdict else f"half-power {half.damping_ratio:.4g}"
    method = "joint fit"
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
            "natural_frequency_Hz": f"{method}; picked peak {half.peak_frequency:.6g} Hz",
            "damping_ratio": f"{method}; {picked}",
            "gain_mm_s2_per_V": f"{method}, residues on the measured shape, MAC {mode.mac:.4f}, coherence "
            f"{mode.coherence:.3f}",
        },
    }


def _interval(estimate: Estimate, scale: float = 1.0) -> Any:
    return _flow([_round(estimate.low * scale), _round(estimate.high * scale)])


def _round(value: float, digits: int = 7) -> float:
    return float(f"{value:.{digits}g}")


def _flow(values: Any) -> Any:
    """Return values that are written on one line."""
    from ruamel.yaml.comments import CommentedMap, CommentedSeq

    made = CommentedSeq(values) if isinstance(values, list) else CommentedMap(values)
    made.fa.set_flow_style()
    return made
