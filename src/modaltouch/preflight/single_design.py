"""A single design: its inputs, taken from the valid parts of the files, the stimulus, and its predicted figures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol import Apparatus, Findings, Protocol, StimulusSection
from modaltouch.rig import instrument_of
from modaltouch.stimulus import Correction, Law, Release, Stimulus, TargetField, Timing, design_stimulus

if TYPE_CHECKING:
    from modaltouch.stimulus import Finger

_NEEDED = ("stimulus", "beam", "actuator_sets", "modes", "amplifier", "generator")


@dataclass(frozen=True)
class DesignInputs:
    """Inputs of the design of a stimulus.

    Attributes
    ----------
    section : StimulusSection
        The protocol's stimulus section.
    apparatus : Apparatus
        The apparatus, corrected by the calibration if there is one; only sections that a stimulus needs are present.
    centre_mm : float
        Centre of the focus zone [mm].
    levels : dict of tuple to float
        Valid levels by their keys in the protocol, the peak velocities and that of a standard [mm/s].
    velocity_limit : float
        Safety limit [mm/s]; infinite if it is not valid.
    correction : Correction or None
        Correction of the targets from a calibration.
    points : tuple of (float, float)
        Positions [mm] and relative velocities of a sampled field.
    fingers : tuple of Finger
        Fingertips on the beam; empty for the untouched beam.
    share : float
        Ratio of `levels` to the nominal levels, if placements are equalised in a band [1].
    at_samples : bool
        As in `Timing`.
    """

    section: StimulusSection
    apparatus: Apparatus
    centre_mm: float
    levels: dict[tuple[str | int, ...], float]
    velocity_limit: float
    correction: Correction | None = None
    points: tuple[tuple[float, float], ...] = ()
    fingers: tuple[Finger, ...] = ()
    share: float = 1.0
    at_samples: bool = False

    @property
    def reference(self) -> float:
        """Highest level within the safety limit, at which the codes span the generator's range [mm/s]."""
        return max(
            [level for level in self.levels.values() if level <= self.velocity_limit],
            default=min(self.levels.values()),
        )

    @property
    def loads(self) -> list[Finger]:
        """Fingers as they load the modes; equal ones share a design."""
        return [load for _, load in self.apparatus.modal_model().touched(self.fingers).loads]

    @property
    def highest_amplitude(self) -> float:
        """Generator's highest amplitude whose full scale is within the amplifier's limit [Vpp]."""
        return 2 * instrument_of(self.apparatus).highest_level(self.apparatus)


def find_design_inputs(findings: Findings) -> DesignInputs | None:
    """Return the inputs of the design; None if the files lack any of them."""
    protocol, apparatus = findings.protocol, findings.apparatus
    if protocol is None or apparatus is None:
        return None
    # Faults of single keys are handled below; faults between keys invalidate the section.
    between = set(findings.problems) - set(protocol.problems) - set(apparatus.problems)
    if any(problem.path.split(".")[0].split("[")[0] in _NEEDED for problem in between):
        return None
    section = protocol.sound("stimulus")
    parts = {name: apparatus.sound(name) for name in _NEEDED if name != "stimulus"}
    if section is None or any(part is None for part in parts.values()):
        return None
    zones = dict(apparatus.items("zones"))
    if any(zone not in zones for zone in (section.focus, *section.further_foci)):
        return None
    points = section.field.points or ()
    if section.field.shape == "sampled" and findings.field is not None:
        points = findings.points()
    if points is None or not findings.levels:
        return None
    limit = apparatus.sound("safety", "velocity_limit_mm_s")
    used = Apparatus.model_construct(apparatus="", zones=zones, **parts)
    reading = findings.calibration
    calibration = None if reading is None or reading.value is None else reading.value.alone("")
    correction = None
    if reading is not None and calibration is not None:
        # Use a calibration only if it has no fault.
        if apparatus.value is None or any(problem.file == str(reading.source.path) for problem in findings.problems):
            return None
        used = calibration.applied(used)
        correction = Correction(
            velocity=np.array([mode.target_mm_s for mode in calibration.modes]) * 1e-3,
            displacement=np.array([mode.target_displacement_mm_s for mode in calibration.modes]) * 1e-3,
            reference=calibration.reference_mm_s * 1e-3,
            corrections=tuple((level.velocity_mm_s * 1e-3, level.amplitude_factor) for level in calibration.levels),
        )
    elif reading is not None and reading.value is not None:
        return None  # a calibration of other stimuli
    return DesignInputs(
        section=section,
        apparatus=used,
        centre_mm=zones[section.focus].centre_mm,
        levels=findings.levels,
        velocity_limit=float("inf") if limit is None else limit,
        correction=correction,
        points=points,
        at_samples=findings.at_samples,
    )


def design(
    inputs: DesignInputs, *, law: Law | None = None, release: Release | None = None, on_grid: bool = True
) -> Stimulus:
    """Design the stimulus of a protocol.

    Parameters
    ----------
    inputs : DesignInputs
        Inputs of the design.
    law : str, optional
        Drive law; the protocol's if not given.
    release : str, optional
        Drive after the focusing instant; the protocol's if not given.
    on_grid : bool
        Whether to put all levels on the generator's amplitude grid, for which full scale may exceed the peak by 5 %;
        otherwise full scale equals the peak.

    Raises
    ------
    ValueError
        If the design fails.
    """
    section, reference = inputs.section, inputs.reference
    levels = tuple(sorted({level for level in inputs.levels.values() if level <= reference})) or (reference,)
    target_field = TargetField(
        shape=section.field.shape,
        base=section.field.base_mm * 1e-3,
        centre=inputs.centre_mm * 1e-3,
        velocity=reference * 1e-3,
        n_decomposed=section.decomposed_modes,
        selection=section.selected_modes,
        further_centres=tuple(inputs.apparatus.zones[name].centre_mm * 1e-3 for name in section.further_foci),
        points=tuple((position * 1e-3, velocity) for position, velocity in inputs.points),
    )
    timing = Timing(
        instrument_of(inputs.apparatus).converter,
        n_samples=section.n_samples,
        duration=section.duration_ms * 1e-3,
        focusing_instant=section.focusing_instant_ms * 1e-3,
        repetition_rate=section.repetition_rate_Hz,
        at_samples=inputs.at_samples,
    )
    return design_stimulus(
        inputs.apparatus.modal_model().touched(inputs.fingers),
        target_field,
        timing,
        inputs.apparatus.amplifier_values(),
        law=law or section.law,
        release=release or section.release,
        levels=tuple(level * 1e-3 for level in levels) if on_grid else None,
        load_factor=inputs.apparatus.generator.load_factor,
        design=section.design if (law or section.law) == "exact" else "least_energy",
        priority=section.priority if (law or section.law) == "exact" else "field",
        correction=inputs.correction,
    )


def design_to_fit(inputs: DesignInputs, *, release: Release | None = None) -> Stimulus:
    """Return the stimulus, without the 5 % of full scale reserved for the amplitude grid if that does not fit.

    Parameters and errors are those of `design`.
    """
    stimulus = design(inputs, release=release)
    within = float(stimulus.peak_voltage.max()) <= inputs.apparatus.amplifier.limit_V
    if within and max(stimulus.burst.full_scale_for(stimulus.target_field.velocity)) > inputs.highest_amplitude:
        return design(inputs, release=release, on_grid=False)
    return stimulus


ANSWER_S, PLACEMENT_S, BREAK_S, INSTRUCTIONS_S = 1.5, 5.0, 30.0, 90.0
"""Assumed durations of an answer, a finger placement, a break and the instructions [s]."""

_POINTS_PER_ZONE = 5
"""Points per zone at which speed is computed, a quarter of the shortest wavelength of Table I apart."""

FIELD_POINTS = 201
"""Points from end to end of the beam at which a field is recorded."""


def stimulus_figures(inputs: DesignInputs, stimulus: Stimulus, level: float) -> dict[str, Any]:
    """Return the predicted figures of a level, for the rounded codes that the generator plays."""
    velocity = level * 1e-3
    labels = [str(label) for label in stimulus.model.label]
    reached, displacement = stimulus.achieved(velocity)
    centres = finger_places(inputs)
    at_focus = stimulus.velocity_at_focus(centres, velocity)
    peaks = stimulus.peak_velocity(centres, velocity)
    channels = [str(number + 1) for number in range(stimulus.model.n_channels)]
    return {
        "velocity_mm_s": level,
        "focus": inputs.section.focus,
        "law": stimulus.law,
        "release": stimulus.release,
        "selected_modes": [int(label) for label in stimulus.selected],
        "target_mm_s": by_name(labels, stimulus.target * velocity / stimulus.target_field.velocity * 1e3),
        "achieved_mm_s": by_name(labels, reached * 1e3),
        "achieved_displacement_mm_s": by_name(labels, displacement * 1e3),
        "worst_modal_error_mm_s": finite(stimulus.worst_modal_error(velocity) * 1e3),
        "worst_modal_error_steady_mm_s": finite(stimulus.worst_modal_error(velocity, steady=True) * 1e3),
        "peak_drive_V": by_name(channels, stimulus.peak_drive(velocity)),
        "amplitude_Vpp": by_name(channels, stimulus.burst.amplitude_for(velocity)),
        "n_samples": inputs.section.n_samples,
        "sampling_rate_Hz": finite(stimulus.timing.sampling_rate),
        "fwhm_mm": finite(stimulus.projection.width(0.5) * 1e3),
        "width_80_mm": finite(stimulus.projection.width(0.8) * 1e3),
        "reconstruction_error": finite(stimulus.projection.reconstruction_error),
        "condition_number": finite(stimulus.drive.condition_number),
        "zone_at_focus_mm_s": by_name(inputs.apparatus.ordered_zones, at_focus * 1e3),
        "zone_peak_mm_s": by_name(inputs.apparatus.ordered_zones, peaks * 1e3),
    }


def field_figures(inputs: DesignInputs, stimulus: Stimulus) -> dict[str, Any]:
    """Return the target and predicted field at the focusing instant, at the highest level, for the report."""
    level, half = max(inputs.levels.values()), inputs.apparatus.beam.length_mm / 2
    place = np.linspace(-half, half, FIELD_POINTS) * 1e-3
    target = stimulus.target_field.profile(place) * level
    predicted = stimulus.velocity_at_focus(place, level * 1e-3) * 1e3
    return {
        "focus": inputs.section.focus,
        "law": stimulus.law,
        "velocity_mm_s": level,
        "length_mm": inputs.apparatus.beam.length_mm,
        "zones_mm": {name: list(zone.edges) for name, zone in inputs.apparatus.ordered_zones.items()},
        "target_mm_s": target.round(3).tolist(),
        "predicted_mm_s": predicted.round(3).tolist(),
    }


def zone_centres(inputs: DesignInputs) -> NDArray[np.float64]:
    """Return the centres of the zones from left to right, (n_zones,) array [m]."""
    return np.array([zone.centre_mm for zone in inputs.apparatus.ordered_zones.values()]) * 1e-3


def finger_places(inputs: DesignInputs) -> NDArray[np.float64]:
    """Return the finger position in each zone, or the zone's centre, from left to right, (n_zones,) array [m]."""
    places = zone_centres(inputs)
    for finger in inputs.fingers:
        places[np.abs(places - finger.position).argmin()] = finger.position
    return places


def zone_points(inputs: DesignInputs) -> NDArray[np.float64]:
    """Return the points at which the speed of each zone is computed, (n_zones, n_points) array [m]."""
    edges = [zone.edges for zone in inputs.apparatus.ordered_zones.values()]
    half = inputs.apparatus.beam.length_mm / 2
    return np.clip([np.linspace(*edge, _POINTS_PER_ZONE) for edge in edges], -half, half) * 1e-3


def speeds_when_lifted(
    inputs: DesignInputs, stimulus: Stimulus, level: float, floor: float
) -> dict[str, NDArray[np.float64]]:
    """Return the peak speeds at the zones' points if fingers are lifted, at least `floor`, by description [m/s]."""
    speeds: dict[str, NDArray[np.float64]] = {}
    if not inputs.fingers:
        return speeds
    points, unit, n = zone_points(inputs).ravel(), stimulus.volts_per_code(level * 1e-3), len(inputs.fingers)
    touched = stimulus.touched(inputs.fingers)
    for left in (left for n_left in range(n) for left in combinations(inputs.fingers, n_left)):
        text = (
            f" once {('a finger is', 'two fingers are')[n - len(left) - 1] if left else 'all fingers are'} taken away"
        )
        found = touched.peak_when_lifted(stimulus.touched(left), points, unit, floor)
        speeds[text] = np.maximum(speeds.get(text, 0.0), found)
    return speeds


def errors_of_gains(inputs: DesignInputs, stimulus: Stimulus, level: float) -> NDArray[np.float64]:
    """Return an upper bound of the speeds that errors of identified gains add at the points of the zones [m/s].

    Every gain is off by the farther end of its interval, all in the worst combination, on the beam without fingers.
    """
    model, sets = stimulus.model, inputs.apparatus.actuator_sets
    modes, error = {mode.label: mode for mode in inputs.apparatus.modes}, np.zeros_like(model.modal_gain)
    for row, mode in enumerate(modes[label] for label in model.label):
        for name, ends in (mode.intervals_95.gain_mm_s2_per_V if mode.intervals_95 else {}).items():
            gain = mode.gain_mm_s2_per_V.get(name, 0.0)
            error[row, sets[name].channel - 1] = max(abs(end - gain) for end in ends) * 1e-3
    points = zone_points(inputs).ravel()
    if not error.any():
        return np.zeros(points.size)
    unit, bare = stimulus.volts_per_code(level * 1e-3), stimulus.touched(())
    alone = [replace(bare.model, modal_gain=error * (np.arange(unit.size) == output)) for output in range(unit.size)]
    peaks = sum(replace(bare, model=each).modal_peaks(unit) for each in alone)
    return np.asarray(peaks @ np.abs(model.shapes(points)))


def estimated_duration(protocol: Protocol) -> float:
    """Return the estimated duration of a session, with assumed times for answers, placements and breaks [min].

    Parameters
    ----------
    protocol : Protocol
        The protocol.
    """
    answers, schedule = protocol.answers, protocol.schedule
    n_trials = protocol.n_trials + schedule.practice_trials
    before_question = answers.question_delay_s
    if answers.stimulus_until == "question":
        names = protocol.stimulus_names
        lengths = [protocol.n_bursts(name) / protocol.stimulus_of(name).repetition_rate_Hz for name in names]
        length = float(np.mean(lengths))
        before_question = max(before_question, length)
        if (intervals := protocol.intervals) is not None:
            before_question += (intervals.number - 1) * (length + intervals.gap_s)
    pause = float(np.mean([answers.pause(each) for each in protocol.conditions.finger_conditions]))
    # The fingers move whenever the pair changes.
    n_placements = 1 + (n_trials - 1) * (1 - 1 / len(protocol.conditions.contacts))
    n_breaks = (protocol.n_trials - 1) // schedule.break_after_trials if schedule.break_after_trials else 0
    seconds = (
        n_trials * (before_question + ANSWER_S * (1 + len(answers.then)) + pause)
        + ANSWER_S * len(protocol.form)
        + n_placements * PLACEMENT_S
        + n_breaks * BREAK_S
        + INSTRUCTIONS_S
    )
    return round(seconds / 60, 1)


def finite(value: float) -> float | None:
    """Return a number for JSON, or None if it is not finite."""
    return float(value) if math.isfinite(value) else None


def by_name(names: Any, values: Any) -> dict[str, float | None]:
    """Return numbers by name for JSON; None for those that are not finite."""
    return {name: finite(float(value)) for name, value in zip(names, values, strict=True)}
