"""Results of a check as plain values, as printed by ``modaltouch check --json``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from modaltouch.preflight import advice
from modaltouch.preflight.exploration import continuous_figures, touched_figures
from modaltouch.preflight.figures import estimated_duration, finite, stimulus_figures
from modaltouch.protocol import Findings, Protocol
from modaltouch.stimulus import Law

if TYPE_CHECKING:
    from modaltouch.preflight import Preflight

DESIGN_FIGURES = ("sensation_levels", "n_trials", "n_catch_trials", "n_practice_trials", "estimated_duration_min")


def check_results(preflight: Preflight, *, compare: bool = False, fingers: str | None = None) -> dict[str, Any]:
    """Return all results of a check.

    Parameters
    ----------
    preflight : Preflight
        The examined protocol.
    compare : bool
        Whether to include the other drive law.
    fingers : str, optional
        Fingers of a file, or shipped ones, or ``none``; those of the protocol if not given.
    """
    findings, reading = preflight.findings, preflight.findings.protocol
    values: dict[str, Any] = {
        "protocol": reading.sound("protocol") if reading else None,
        "title": reading.sound("title") if reading else None,
        "file": str(reading.source.path) if reading else None,
        "apparatus": findings.apparatus.sound("apparatus") if findings.apparatus else None,
        "calibration": _calibration(findings),
        **dict.fromkeys(DESIGN_FIGURES),
        "problems": [problem.as_dict() for problem in preflight.problems],
        "warnings": [],
        "defaults": findings.defaults(),
        "stimuli": _levels(preflight, fingers),
        **{name: [] for name in ("contrasts", "unknown_gains", "assumed_gains", "offered_gains")},
    }
    if preflight.others:
        values["occasions"] = [occasion_figures(each.findings) for each in (preflight, *preflight.others)]
    if reading is not None and reading.value is not None:
        values |= design_figures_of(reading.value)
    if preflight.problems:
        return values
    apparatus = preflight.sound[0].apparatus
    values |= {
        "warnings": _warnings(preflight, fingers, values["defaults"]),
        "contrasts": _contrasts(preflight),
        "unknown_gains": [{"mode": label, "set": name} for label, name in apparatus.unknown_gains()],
        "assumed_gains": [{"mode": label, "set": name} for label, name in apparatus.assumed_gains()],
        "offered_gains": [
            {"mode": label, "set": name, "gain_mm_s2_per_V": gain} for label, name, gain in apparatus.offered_gains()
        ],
    }
    if compare:
        values |= {"comparison": comparison(preflight), "continuous_fallback": continuous_figures(*preflight.sound)}
    return values


def comparison(preflight: Preflight) -> list[dict[str, Any]]:
    """Return the predicted figures of each level under the other drive law, on the same rig."""
    if preflight.variants:
        return [{"stimulus": name, **each} for name, part in preflight.parts.items() for each in comparison(part)]
    if preflight.placed:
        return []  # the other law applies to the untouched beam
    inputs, stimulus = preflight.sound
    other: Law = "paper" if stimulus.law == "exact" else "exact"
    compared = stimulus.under_law(other)
    return [stimulus_figures(inputs, compared, level) for level in inputs.levels.values()]


def _touched(preflight: Preflight, fingers: str | None) -> list[dict[str, dict[str, Any]]]:
    """Return the figures of each level of each stimulus under fingers, by placement."""
    findings = preflight.findings if fingers is None else preflight.findings.under(fingers)
    return [
        row
        for part in preflight.parts.values()
        for row in touched_figures(findings, {name: each.sound for name, each in part.by_placement.items()})
    ]


def _levels(preflight: Preflight, fingers: str | None) -> list[dict[str, Any]]:
    """Return the figures of each level; with fingers, those of the first placement and under each placement."""
    if preflight.problems:
        return []
    rows = [
        {**({"stimulus": name} if preflight.variants else {}), **row}
        for name, part in preflight.parts.items()
        for row in next(iter(part.placed.values()), part).stimuli
    ]
    if fingers == "none" or (fingers is None and preflight.findings.fingers is None):
        return rows
    return [{**row, "touched": each} for row, each in zip(rows, _touched(preflight, fingers), strict=True)]


def _warnings(preflight: Preflight, fingers: str | None, defaults: list[dict[str, Any]]) -> list[str]:
    findings, protocol, apparatus = preflight.findings, preflight.experiment.protocol, preflight.experiment.apparatus
    return [
        *([f"the calibration misses its limits: {preflight.calibration_mark}"] if preflight.calibration_mark else []),
        *_stimulus_warnings(preflight),
        *advice.placement_warnings({name: part.sound[0] for name, part in preflight.designs.items()}),
        *advice.contact_warnings(findings if fingers in (None, "none") else findings.under(fingers)),
        *advice.design_warnings(protocol),
        *advice.answer_warnings(protocol),
        *advice.interval_warnings(protocol),
        *advice.generator_warnings(apparatus),
        *advice.sound_warnings(protocol, apparatus),
        *advice.default_warnings(defaults),
    ]


def _stimulus_warnings(preflight: Preflight) -> list[str]:
    warnings: list[tuple[str, list[str]]] = []
    for name, part in preflight.parts.items():
        inputs, stimulus = part.sound
        own = [
            *advice.field_warnings(inputs, stimulus, part.stimuli),
            *advice.stimulus_warnings(inputs, stimulus, part.stimuli),
        ]
        warnings.append((name, own))
    shared = [each for each in warnings[0][1] if all(each in own for _, own in warnings)]
    return [*shared, *(f"stimulus {name}: {each}" for name, own in warnings for each in own if each not in shared)]


def _contrasts(preflight: Preflight) -> list[dict[str, Any]]:
    protocol = preflight.experiment.protocol
    return [
        {**named, **row}
        for named, each in preflight.named_designs()
        for row in contrasts(protocol, each.stimuli[-1]["zone_peak_mm_s"], named.get("placement", "").split(" ")[0])
    ]


def _calibration(findings: Findings) -> dict[str, Any] | None:
    """Return the calibration used and its remaining errors; None without a calibration."""
    reading = findings.calibration
    if reading is None or (value := reading.value) is None:
        return None
    return {
        "file": str(reading.source.path),
        "sha256": reading.source.sha256,
        "made": value.made,
        "generator": value.instruments.generator,
        "reference_mm_s": max(each.reference_mm_s for each in value.by_stimulus.values()),
        "worst_modal_error_mm_s": max(each.worst_error_mm_s for each in value.by_stimulus.values()),
        "mark": value.mark,
    }


def contrasts(protocol: Protocol, zone_peak: dict[str, float], placement: str = "") -> Iterator[dict[str, Any]]:
    """Yield the speeds at the zones of each pair, and the ratio of the faster to the slower."""
    for left, right in protocol.conditions.pairs:
        if placement and {left, right} != set(placement.split("-")):
            continue
        slower, faster = sorted((zone_peak[left], zone_peak[right]))
        yield {
            "zone_left": left,
            "zone_right": right,
            "left_mm_s": zone_peak[left],
            "right_mm_s": zone_peak[right],
            "contrast": finite(faster / slower) if slower else None,
        }


def design_figures_of(protocol: Protocol) -> dict[str, Any]:
    """Return numbers of trials, session duration and threshold bounds; empty if no finger has a zone."""
    if not protocol.conditions.contacts:
        return {}
    own, velocities = protocol.conditions.sensation_levels, protocol.conditions.peak_velocities_mm_s
    return {
        "sensation_levels": own
        and {
            "thresholds_from": own.thresholds_from,
            "multiples": list(own.multiples),
            "thresholds_mm_s": [round(each, 4) for each in own.thresholds(min(velocities), max(velocities))],
        },
        "n_trials": protocol.n_trials,
        "n_catch_trials": protocol.schedule.catch_trials * len(protocol.conditions.finger_conditions),
        "n_practice_trials": protocol.schedule.practice_trials,
        "estimated_duration_min": estimated_duration(protocol),
    }


def occasion_figures(findings: Findings) -> dict[str, Any]:
    """Return group, kind of session, levels, numbers of trials and duration; values are None for a faulty protocol."""
    protocol = None if findings.protocol is None else findings.protocol.value
    known = {} if protocol is None else design_figures_of(protocol)
    return {
        "group": findings.occasion.group,
        "session_kind": findings.occasion.kind,
        "peak_velocities_mm_s": None if protocol is None else list(protocol.conditions.peak_velocities_mm_s),
        **{name: known.get(name) for name in ("n_trials", "n_practice_trials", "estimated_duration_min")},
    }
