"""Results of a check as plain values, as printed by ``modaltouch check --json``, with its warnings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from modaltouch.preflight.exploration import touched_figures
from modaltouch.preflight.single_design import DesignInputs, design, estimated_duration, stimulus_figures
from modaltouch.protocol import Apparatus, Findings, Protocol
from modaltouch.rig import instrument_of
from modaltouch.stimulus import Law, Stimulus

if TYPE_CHECKING:
    from modaltouch.preflight import Preflight

DESIGN_FIGURES = ("sensation_levels", "n_trials", "n_catch_trials", "n_practice_trials", "estimated_duration_min")

_FASTER = 1 + 2e-3
"""Ratio to the focus zone's speed above which another zone counts as faster, beyond rounding of the codes [1]."""

_UNREACHED = 0.25
"""Relative RMS error above which the target field counts as missed; the paper's six modes have 0.06 [1]."""

LOUD = 80.0
"""Level above which exposure for hours may harm hearing (2003/10/EC, lower action value) [dB SPL]."""

_ALPHA = 0.05
"""Significance level of the analysis [1]."""

_LONG = 60.0
"""Duration of a session beyond which attention and skin tire [min]."""


def check_results(preflight: Preflight, *, compare: bool = False, fingers: str | None = None) -> dict[str, Any]:
    """Return all results of a check; with `compare`, also those of the other drive law.

    `fingers` are those of a file, or shipped ones, or ``none``; those of the protocol if not given.
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
        "stimuli": _levels(preflight, fingers),
        **{name: [] for name in ("unknown_gains", "assumed_gains")},
    }
    if preflight.others:
        values["occasions"] = [occasion_figures(each.findings) for each in (preflight, *preflight.others)]
    if reading is not None and reading.value is not None:
        values |= design_figures_of(reading.value)
    if preflight.problems:
        return values
    apparatus = preflight.sound[0].apparatus
    values |= {
        "warnings": _warnings(preflight),
        "unknown_gains": [{"mode": label, "set": name} for label, name in apparatus.unknown_gains()],
        "assumed_gains": [{"mode": label, "set": name} for label, name in apparatus.assumed_gains()],
    }
    if compare:
        values["comparison"] = comparison(preflight)
    return values


def comparison(preflight: Preflight) -> list[dict[str, Any]]:
    """Return the predicted figures of each level under the other drive law, on the same rig."""
    if preflight.variants:
        return [{"stimulus": name, **each} for name, part in preflight.parts.items() for each in comparison(part)]
    if preflight.placed:
        return []  # the other law applies to the untouched beam
    inputs, stimulus = preflight.sound
    other: Law = "paper" if stimulus.law == "exact" else "exact"
    compared = design(inputs, law=other)
    return [stimulus_figures(inputs, compared, level) for level in inputs.levels.values()]


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
    findings = preflight.findings if fingers is None else preflight.findings.under(fingers)
    touched = [
        each
        for part in preflight.parts.values()
        for each in touched_figures(findings, {name: each.sound for name, each in part.by_placement.items()})
    ]
    return [{**row, "touched": each} for row, each in zip(rows, touched, strict=True)]


def _warnings(preflight: Preflight) -> list[str]:
    protocol, apparatus = preflight.experiment.protocol, preflight.experiment.apparatus
    return [
        *([f"the calibration misses its limits: {preflight.calibration_mark}"] if preflight.calibration_mark else []),
        *_stimulus_warnings(preflight),
        *placement_warnings({name: part.sound[0] for name, part in preflight.designs.items()}),
        *design_warnings(protocol),
        *answer_warnings(protocol),
        *interval_warnings(protocol),
        *generator_warnings(apparatus),
        *sound_warnings(protocol, apparatus),
    ]


def _stimulus_warnings(preflight: Preflight) -> list[str]:
    warnings: list[tuple[str, list[str]]] = []
    for name, part in preflight.parts.items():
        given = *part.sound, part.stimuli
        warnings.append((name, [*field_warnings(*given), *stimulus_warnings(*given)]))
    shared = [each for each in warnings[0][1] if all(each in own for _, own in warnings)]
    return [*shared, *(f"stimulus {name}: {each}" for name, own in warnings for each in own if each not in shared)]


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


def field_warnings(inputs: DesignInputs, stimulus: Stimulus, figures: list[dict[str, Any]]) -> Iterator[str]:
    """Yield warnings about a field that is fastest outside the focus or misses its target."""
    top = max(figures, key=lambda each: float(each["velocity_mm_s"]), default=None)
    if top is not None:
        peaks, focus = top["zone_peak_mm_s"], inputs.section.focus
        at_focus = peaks[focus] or 0.0
        faster = {name: peak for name, peak in peaks.items() if peak is not None and peak > _FASTER * at_focus}
        if faster:
            others = ", ".join(f"zone {name} at up to {peak:.0f} mm/s" for name, peak in faster.items())
            yield (
                f"at {top['velocity_mm_s']:g} mm/s the focus {focus} is not where the beam moves fastest: zone "
                f"{focus} moves at up to {at_focus:.0f} mm/s, {others}"
            )
    if stimulus.projection.reconstruction_error > _UNREACHED:
        yield f"at {stimulus.target_field.velocity * 1e3:g} mm/s {stimulus.projection.unreached()}"


def placement_warnings(designs: Mapping[str, DesignInputs]) -> list[str]:
    """Return a warning with the factors on the levels if placements are equalised in a band."""
    band = next(iter(designs.values())).section.equalise_band_Hz
    if band is None:
        return []
    shares = ", ".join(f"{name} {inputs.share:g}" for name, inputs in designs.items())
    return [
        f"the velocity from {band[0]:g} to {band[1]:g} Hz at the focus is made the same at every placement: levels are "
        f"multiplied by {shares}"
    ]


def stimulus_warnings(inputs: DesignInputs, stimulus: Stimulus, figures: list[dict[str, Any]]) -> Iterator[str]:
    """Yield warnings about clock jitter, unmeasured gains, ill-conditioned modes and modal errors."""
    clocks = stimulus.timing.duration * stimulus.timing.converter.clock_rate / stimulus.timing.n_samples
    if not stimulus.timing.converter.any_rate and not math.isclose(clocks, round(clocks), rel_tol=1e-9):
        yield (
            f"{stimulus.timing.n_samples} samples are held {clocks:.2f} clocks each, so their edges jitter; "
            f"125000 samples in 50 ms are held exactly 100"
        )
    if inputs.apparatus.assumed_gains():
        modes = ", ".join(f"{label} ({name})" for label, name in inputs.apparatus.assumed_gains())
        yield f"the gains of these modes are assumed, not measured: {modes}"
    if stimulus.drive.condition_number > 1e6:
        yield f"the condition number is {stimulus.drive.condition_number:.1e}: two modes are nearly alike"
    worst = max(figures, key=lambda each: each["worst_modal_error_mm_s"] / each["velocity_mm_s"], default=None)
    short = worst and worst["worst_modal_error_mm_s"] > 1e-3 * worst["velocity_mm_s"]
    if worst and short and stimulus.priority == "level":
        yield (
            f"priority level: at {worst['velocity_mm_s']:g} mm/s the level is exact and a mode misses the field by "
            f"{worst['worst_modal_error_mm_s']:.2g} mm/s, so the spectrum is different; do not compare it with "
            f"sessions that have priority field"
        )
    elif worst and short:
        yield (
            f"at {worst['velocity_mm_s']:g} mm/s the law `{stimulus.law}` misses a mode by "
            f"{worst['worst_modal_error_mm_s']:.2g} mm/s on the identified beam"
        )


_UNPROMISED = {
    "timer": "with the generator's free timer, the first burst is known to within a period and no burst is counted",
    "continuous": "with a continuous record, the first burst is known by its command and no burst is counted",
    "wired": "the pulse source at the trigger input counts the bursts; this program neither counts nor times them",
}


def generator_warnings(apparatus: Apparatus) -> Iterator[str]:
    """Yield warnings about a generator without a driver, and about a repetition other than ``single``."""
    section, instrument = apparatus.generator, instrument_of(apparatus)
    if section.model not in instrument.models:
        yield (
            f"there is no driver for the generator {section.model}: that of the {instrument.models[0]} will be used; "
            "`rig check` says whether it works"
        )
    if section.repeats != "single":
        former = " (`burst` is its former name)" if section.repetition == "burst" else ""
        yield (
            f"generator.repetition is {section.repeats}{former}: {_UNPROMISED[section.repeats]}, and only the watchdog "
            "process ends it if this program dies; `single` promises all three"
        )


_PARTS = {
    "conditions": "the design is not crossed ({}): each crossed part is tested separately",
    "groups": "each group is tested separately; groups are compared by one value per participant",
    "schedule": "each kind of session is tested separately; kinds are compared within each participant",
}


def design_warnings(protocol: Protocol) -> Iterator[str]:
    """Yield warnings about pairs without a finger on the focus, tests that are impossible, and long sessions."""
    conditions, presented, untouched = protocol.conditions, dict[str, str](), dict[str, list[str]]()
    for name in protocol.stimulus_names:
        section = protocol.stimulus_of(name)
        own = f"{section}, {protocol.n_bursts(name)} bursts, masked {protocol.is_masked(name)}"
        if (other := presented.setdefault(own, name)) != name:
            yield f"the stimuli {other} and {name} are the same: no answer can tell them apart"
        foci = dict.fromkeys((section.focus, *section.further_foci))
        without = ["-".join(zones) for zones in conditions.contacts if not foci.keys() & set(zones)]
        noun = "any pair" if conditions.zone_pairs else "any zones"
        where = noun if len(without) == len(conditions.contacts) else ", ".join(without)
        if without:
            untouched.setdefault(f"no finger touches the focus {', '.join(foci)} on {where}", []).append(name)
    for warning, names in untouched.items():
        own = f"{'stimulus' if len(names) == 1 else 'stimuli'} {', '.join(names)}: "
        yield f"{own if names != [''] else ''}{warning}"
    kinds = protocol.schedule.session_kinds
    is_analysed = not kinds or any(each.analysed for each in kinds)
    if not is_analysed:
        yield "no kind of session is analysed (schedule.sessions): there will be nothing for `analyse`"
    if len(protocol.groups) == 1:
        yield "there is only one group: nothing can be compared between groups; add another, or leave it out"
    pairs, levels, _ = map(set, zip(*protocol.cells(conditions.finger_conditions[0]), strict=True))
    n_pairs, n_fingers = len(pairs), len(conditions.finger_conditions)
    is_fixed = is_analysed and protocol.adaptive is None  # runs are compared with each other, and have no parts
    if is_fixed and (by := protocol.uncrossed_by):
        yield _PARTS[by[0]].format(".".join(by))
    elif is_fixed and not kinds:  # the protocol may be that of a training
        numbers = {"level": len(levels), "finger condition": n_fingers, "pair of zones": n_pairs}
        alone = " and one ".join(noun for noun, number in numbers.items() if number == 1)
        if alone:
            yield f"there is only one {alone}: no test can show whether that matters"
        # If all participants agree, p is 2/2^n; Holm's method multiplies the smallest p by the number of tests.
        fewest = 1 + math.ceil(math.log2(n_pairs * n_fingers / _ALPHA))
        if protocol.answers.offered.compares:
            yield f"with fewer than {fewest} participants no test can tell which zone of a pair is chosen more"
    idle = [key for key in ("practice_feedback", "practice_criterion") if getattr(protocol.schedule, key)]
    if idle and not (protocol.schedule.practice_trials or kinds):
        yield f"schedule.{idle[0]} has no effect, since practice_trials is 0: there is no practice"
    minutes = estimated_duration(protocol)
    if minutes > _LONG:
        yield (
            f"a session takes about {minutes:.0f} min, longer than an hour: use fewer repetitions, or several sessions"
        )


def answer_warnings(protocol: Protocol) -> Iterator[str]:
    """Yield warnings about catch trials without `none`, answers that name no finger, unknown tasks and idle lengths."""
    n_catches, offered, scale = protocol.schedule.catch_trials, protocol.answers.offered, protocol.answers.scale
    if n_catches and not protocol.answers.has_none_answer and scale is None:
        yield (
            f"the {n_catches} catch trials of a block cannot be answered correctly, since there is no answer none: "
            "they show what is guessed, not how often; add `none` to answers.keys"
        )
    if not offered.refers and scale is None:
        nothing = offered.naming()
        which = "whatever it feels" if nothing is None else f"but {nothing.name} where it feels nothing"
        yield (
            f"no answer names a finger ({', '.join(offered.names)}): a simulated participant answers at random, {which}"
        )
    if protocol.task == "other":
        yield "the question is that of the texts, which must suit these answers; else write answers.question"
    written = protocol.answers.model_fields_set
    idle = [key for key in ("presentation_bursts", "presentation_s") if key in written]
    if idle and "stimulus_until" not in written:
        yield (
            f"answers.{idle[0]} has no effect, since stimulus_until is `answer` if it is not given; write "
            "`stimulus_until: question` for a stimulus of that length"
        )


def interval_warnings(protocol: Protocol) -> list[str]:
    """Return warnings about interval trials without a right answer, and answers that are never right."""
    section, answers = protocol.intervals, protocol.answers
    if section is None or answers.scale is not None or protocol.adaptive is not None:
        return []
    meanings = {answer.interval for answer in answers.offered}
    if meanings == {None}:
        return ["no answer refers to an interval, so none is right; write answers.intervals, such as {first: 1}"]
    cells = [cell for name in protocol.conditions.finger_conditions for cell in protocol.cells(name)]
    given = section.standard
    alike = sum(given.velocity_mm_s in (None, level) and given.stimulus in (None, own) for _, level, own in cells)
    if alike and "same" not in meanings and section.asked == "comparison":
        return [
            f"the comparison is the standard in {alike} of {len(cells)} cells: all intervals are alike there and "
            "no answer is right; leave these out (conditions.exclude), or offer `same` (answers.intervals)"
        ]
    if "same" in meanings and alike in (0, len(cells)):
        never = "different" if alike else "same"
        return [
            f"the comparison is the standard in {alike} of {len(cells)} cells: `{never}` is right in no trial, "
            "and there is no d'; let the standard's level or stimulus be one of several of the conditions"
        ]
    return []


def sound_warnings(protocol: Protocol, apparatus: Apparatus) -> list[str]:
    """Return warnings about masking noise at an unknown or harmful level."""
    section, sound = protocol.masking, apparatus.sound
    level = None if section is None else section.level(sound)
    if level is None:
        return []
    if sound.full_scale_dB_SPL is None:
        return [f"masking noise at {level:g} dB FS: its level at the ear is unknown, as the device is not calibrated"]
    if level + sound.full_scale_dB_SPL > LOUD:
        return [
            f"masking noise at {level + sound.full_scale_dB_SPL:g} dB SPL: above {LOUD:g} dB it may harm hearing "
            "within hours; keep sessions short and the total of a day in mind"
        ]
    return []
