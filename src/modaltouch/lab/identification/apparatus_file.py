"""Writes what was identified into a copy of the apparatus file: values, intervals, and where each comes from."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from modaltouch.lab.identification.estimates import Estimate, Identification, IdentifiedMode
from modaltouch.protocol import Apparatus, Source

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
        Of the file, which `Apparatus.read` reads.

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
    Apparatus.read(Source(Path(file_name), text))
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
