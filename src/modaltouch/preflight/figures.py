"""Predicted figures of the stimuli, as plain values in the units of their keys."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.preflight.design_inputs import DesignInputs
from modaltouch.protocol import Protocol
from modaltouch.stimulus import Stimulus

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
