"""What each level does to the beam, and what a lab may ask of its stimulus: plain values in the units of their keys."""

from __future__ import annotations

import math
from statistics import fmean
from typing import Any

import numpy as np

from modaltouch.preflight.design_inputs import DesignInputs
from modaltouch.protocol import Protocol
from modaltouch.stimulus import ModalModel, Stimulus

ANSWER_S, PLACEMENT_S, BREAK_S, INSTRUCTIONS_S = 1.5, 5.0, 30.0, 90.0
"""Guesses that go into the estimated duration: answering, moving the fingers, a break, the instructions [s]."""

ERRORS = {"natural_frequency": 0.001, "damping_ratio": 0.05, "modal_gain": 0.05}
"""Relative errors of the table of sensitivities [1]."""

SPREAD: dict[str, Any] = {"natural_frequency": 0.001, "damping_ratio": 0.02, "modal_gain": 0.02}
"""Relative standard deviations of the beams that are drawn [1]."""


def stimulus_figures(ground: DesignInputs, stimulus: Stimulus, level: float) -> dict[str, Any]:
    """Return what a level does to the beam, of the rounded codes as the generator plays them.

    Parameters
    ----------
    ground : DesignInputs
        What the stimulus was designed from.
    stimulus : Stimulus
        The stimulus of all levels.
    level : float
        Peak velocity at the focus [mm/s].
    """
    velocity = level * 1e-3
    labels = [str(label) for label in stimulus.model.label]
    reached, displacement = stimulus.achieved(velocity)
    centres = zone_centres(ground)
    at_focus = stimulus.velocity_at_focus(centres, velocity)
    peaks = stimulus.peak_velocity(centres, velocity)
    channels = [str(number + 1) for number in range(stimulus.model.n_channels)]
    return {
        "velocity_mm_s": level,
        "focus": ground.section.focus,
        "law": stimulus.law,
        "release": stimulus.release,
        "selected_modes": [int(label) for label in stimulus.selected],
        "target_mm_s": _by(labels, stimulus.target * velocity / stimulus.wish.velocity * 1e3),
        "achieved_mm_s": _by(labels, reached * 1e3),
        "achieved_displacement_mm_s": _by(labels, displacement * 1e3),
        "worst_modal_error_mm_s": finite(stimulus.worst_modal_error(velocity) * 1e3),
        "worst_modal_error_steady_mm_s": finite(stimulus.worst_modal_error(velocity, steady=True) * 1e3),
        "peak_drive_V": _by(channels, stimulus.peak_drive(velocity)),
        "amplitude_Vpp": _by(channels, stimulus.amplitude_for(velocity)),
        "n_samples": ground.section.n_samples,
        "sampling_rate_Hz": finite(stimulus.timing.sampling_rate),
        "fwhm_mm": finite(stimulus.projection.fwhm * 1e3),
        "width_80_mm": finite(stimulus.projection.width_80 * 1e3),
        "reconstruction_error": finite(stimulus.projection.reconstruction_error),
        "condition_number": finite(stimulus.drive.condition_number),
        "zone_at_focus_mm_s": _by(ground.apparatus.ordered_zones, at_focus * 1e3),
        "zone_peak_mm_s": _by(ground.apparatus.ordered_zones, peaks * 1e3),
    }


def contrasts(protocol: Protocol, zone_peak: dict[str, float]) -> list[dict[str, Any]]:
    """Return for each pair the speeds at its zones and how many times the faster is the slower.

    Parameters
    ----------
    protocol : Protocol
        The design.
    zone_peak : dict of str to float
        Largest speed at the centre of each zone [mm/s].
    """
    rows = []
    for left, right in protocol.conditions.zone_pairs:
        slower, faster = sorted((zone_peak[left], zone_peak[right]))
        rows.append(
            {
                "zone_left": left,
                "zone_right": right,
                "left_mm_s": zone_peak[left],
                "right_mm_s": zone_peak[right],
                "contrast": finite(faster / slower) if slower else None,
            }
        )
    return rows


def zone_centres(ground: DesignInputs) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the centres of the zones from left to right, (n_zones,) array [m]."""
    return np.array([zone.centre_mm for zone in ground.apparatus.ordered_zones.values()]) * 1e-3


def estimated_duration(protocol: Protocol) -> float:
    """Return about how long a session takes, answers, finger placements and breaks guessed [min].

    Parameters
    ----------
    protocol : Protocol
        The design.
    """
    answers, schedule = protocol.answers, protocol.schedule
    n_trials = protocol.n_trials + schedule.practice_trials
    before_question = answers.question_delay_s
    if answers.stimulus_until == "question":
        rate = protocol.stimulus.repetition_rate_Hz
        before_question = max(before_question, answers.n_bursts(rate) / rate)
    pause = fmean(map(answers.pause, protocol.conditions.finger_conditions))
    # The fingers move wherever the pair differs from the one before.
    n_pairs = len(protocol.conditions.zone_pairs)
    n_placements = 1 + (n_trials - 1) * (1 - 1 / n_pairs)
    n_breaks = (protocol.n_trials - 1) // schedule.break_after_trials if schedule.break_after_trials else 0
    seconds = (
        n_trials * (before_question + ANSWER_S + pause)
        + n_placements * PLACEMENT_S
        + n_breaks * BREAK_S
        + INSTRUCTIONS_S
    )
    return round(seconds / 60, 1)


def warnings(ground: DesignInputs, stimulus: Stimulus, figures: list[dict[str, Any]]) -> list[str]:
    """Return what a lab should know and the rig does not refuse.

    Parameters
    ----------
    ground, stimulus
        As for `stimulus_figures`.
    figures : list of dict
        As `stimulus_figures` returns them, one to each level.
    """
    said = []
    clocks = stimulus.timing.duration * stimulus.timing.clock_rate / stimulus.timing.n_samples
    if not math.isclose(clocks, round(clocks), rel_tol=1e-9):
        said.append(
            f"{stimulus.timing.n_samples} samples are held {clocks:.2f} clocks each, so their edges jitter; "
            f"125000 samples in 50 ms are held exactly 100"
        )
    if ground.apparatus.assumed_gains():
        modes = ", ".join(f"{label} ({name})" for label, name in ground.apparatus.assumed_gains())
        said.append(f"the gains of these modes are assumed, not measured: {modes}")
    if offered := ground.apparatus.offered_gains():
        gains = ", ".join(f"{label} ({name}) {gain:.4g}" for label, name, gain in offered)
        said.append(f"the patches offer gains that are not measured, in mm/s^2 per V by mode and set: {gains}")
    if stimulus.drive.condition_number > 1e6:
        said.append(f"the condition number is {stimulus.drive.condition_number:.1e}: two modes are nearly alike")
    worst = max(figures, key=lambda each: each["worst_modal_error_mm_s"] / each["velocity_mm_s"], default=None)
    if worst and worst["worst_modal_error_mm_s"] > 1e-3 * worst["velocity_mm_s"]:
        said.append(
            f"at {worst['velocity_mm_s']:g} mm/s the law `{stimulus.law}` misses a mode by "
            f"{worst['worst_modal_error_mm_s']:.2g} mm/s on the identified beam"
        )
    return said


def sensitivity_figures(ground: DesignInputs, stimulus: Stimulus) -> dict[str, Any]:
    """Return how well the beam must be identified: what errors of its parameters do to the field at the focus.

    Parameters
    ----------
    ground : DesignInputs
        What the stimulus was designed from.
    stimulus : Stimulus
        The stimulus, at its highest level.
    """
    from modaltouch.stimulus import focus_sensitivity, scatter

    half = ground.apparatus.beam.length_mm * 0.5e-3
    shapes = stimulus.model.shapes(np.linspace(-half, half, 201))
    rows = focus_sensitivity(stimulus).table(shapes, **ERRORS)
    spread = scatter(stimulus, zone_centres(ground), **SPREAD)
    return {
        "velocity_mm_s": stimulus.wish.velocity * 1e3,
        "table": [
            {
                "parameter": row["parameter"],
                "mode": row["mode"],
                "error": row["error"],
                "field_mm_s": float(row["field"]) * 1e3,
                "displacement_mm_s": float(row["displacement"]) * 1e3,
            }
            for row in rows
        ],
        "drawn": {
            "n_draws": len(spread.modal_error),
            "deviations": SPREAD,
            "zone_deviation_mm_s": dict(
                zip(ground.apparatus.ordered_zones, (spread.deviation * 1e3).tolist(), strict=True)
            ),
            "median_modal_error_mm_s": float(np.median(spread.modal_error)) * 1e3,
            "p95_modal_error_mm_s": float(np.quantile(spread.modal_error, 0.95)) * 1e3,
        },
    }


def design_figures(stimulus: Stimulus) -> list[dict[str, Any]]:
    """Return other voltages that reach the same states: what they cost, and what they shake that is not modelled.

    The mode that is not modelled is a supposed one between the two highest modelled, with their mean damping and
    the gains of the higher.

    Parameters
    ----------
    stimulus : Stimulus
        The stimulus, at its highest level.
    """
    unmodelled = _supposed_mode(stimulus.model)
    return [
        {
            "design": row["name"],
            "peak_drive_V": row["peak_voltage"],
            "energy_V2_s": row["energy"],
            "residual_mm_s": float(row["residual"]) * 1e3,
            "unmodelled_speed_mm_s": float(row["unmodelled_speed"]) * 1e3,
            "unmodelled_frequency_Hz": float(unmodelled.natural_frequency[0]),
        }
        for row in stimulus.compare_designs(unmodelled)
    ]


def sample_figures(ground: DesignInputs, stimulus: Stimulus, tolerance: float) -> dict[str, Any]:
    """Return the fewest samples that keep the field around the focus within a tolerance.

    Parameters
    ----------
    ground : DesignInputs
        What the stimulus was designed from.
    stimulus : Stimulus
        The stimulus on the count of samples that the protocol asks for.
    tolerance : float
        Allowed change of the field at the zones within 1 ms of the focusing instant, over the level [1].

    Raises
    ------
    ValueError
        If the tolerance is not above zero.
    """
    from modaltouch.stimulus import cheapest_samples

    found = cheapest_samples(stimulus, tolerance, zone_centres(ground))
    return {
        "tolerance": tolerance,
        "n_samples": found.n_samples,
        "error": found.error,
        "tried": [{"n_samples": n, "error": error} for n, error in found.tried],
        "said": str(found),
    }


def _supposed_mode(model: ModalModel) -> ModalModel:
    """Return a mode where the model has none."""
    order = np.argsort(model.natural_frequency)
    highest = order[-2:]
    between = float(np.exp(np.log(model.natural_frequency[highest]).mean()))
    ratio = float(model.damping_ratio[highest].mean())
    gain = model.modal_gain[order[-1:]]
    return ModalModel((max(model.label) + 1,), np.array([between]), np.array([ratio]), gain, model.length)


def finite(value: float) -> float | None:
    """Return a number for JSON, or None where it is not finite."""
    return float(value) if math.isfinite(value) else None


def _by(names: Any, values: Any) -> dict[str, float | None]:
    return {name: finite(float(value)) for name, value in zip(names, values, strict=True)}
