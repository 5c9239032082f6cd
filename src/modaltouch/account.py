"""What is told of a trial: to the record, and to the experimenter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from modaltouch.protocol import Protocol
from modaltouch.record.instants import describe_instants
from modaltouch.rig.interface import Firing
from modaltouch.trial import Response, Trial


def describe_answer(
    protocol: Protocol,
    speeds: tuple[float, float],
    trial: Trial,
    response: Response,
    firing: Firing,
    *,
    masked: bool | None,
    events: Sequence[dict[str, Any]],
) -> dict[str, Any]:
    """Return the trial event of the record: planned, commanded, confirmed and answered apart.

    Parameters
    ----------
    protocol : Protocol
        What is presented and asked.
    speeds : (left, right) of float
        Predicted peak speeds under the two fingers [m/s].
    trial, response, firing
        What was asked, answered, and confirmed by the instrument.
    masked : bool or None
        Whether noise masked the sound of the beam; None where none is asked for.
    events : sequence of dict
        The record so far.
    """
    values, answered = trial.as_dict(), firing.onset + response.counted_from + response.reaction_time
    return {
        "trial": values,
        "presentation": sum(event["event"] == "fired" and event["trial"] == values for event in events),
        "fingers": list(fingers(protocol, trial)),
        **({"catch": True} if trial.condition.is_catch else {}),
        **({"masked": masked} if masked is not None else {}),
        "planned": {
            "velocity_mm_s": trial.condition.velocity_mm_s,
            "speed_left_mm_s": round(speeds[0] * 1e3, 3),
            "speed_right_mm_s": round(speeds[1] * 1e3, 3),
        },
        "commanded": {"amplitude_Vpp": list(firing.commanded_amplitude)},
        "confirmed": firing.as_dict(),
        "response": response.as_dict(),
        "instants": describe_instants(
            onset=firing.onset,
            onset_uncertainty=firing.onset_uncertainty,
            period=1 / protocol.stimulus_of(trial.condition.stimulus).repetition_rate_Hz,
            answered=answered,
            answer_uncertainty=response.time_uncertainty,
            question=None if response.question_after is None else firing.onset + response.question_after,
            question_uncertainty=response.question_uncertainty,
            silent=trial.condition.is_catch,
        ),
        "supersedes": _superseded(events, values),
    }


def describe_trial(protocol: Protocol, speeds: tuple[float, float], trial: Trial) -> dict[str, Any]:
    """Return what the experimenter should know of a trial before it is on.

    Parameters
    ----------
    protocol, speeds, trial
        As for `describe_answer`.
    """
    return {
        "number": trial.index,
        "practice": trial.practice,
        "block": trial.block,
        **({"stimulus": trial.condition.stimulus} if trial.condition.stimulus else {}),
        "velocity_mm_s": trial.condition.velocity_mm_s,
        "predicted_left_mm_s": round(speeds[0] * 1e3, 1),
        "predicted_right_mm_s": round(speeds[1] * 1e3, 1),
        **describe_placement(protocol, trial),
    }


def describe_placement(protocol: Protocol, trial: Trial) -> dict[str, Any]:
    """Return which finger lies on which zone, and how answers are given.

    Parameters
    ----------
    protocol, trial
        As for `describe_answer`.
    """
    left, right = fingers(protocol, trial)
    condition = trial.condition
    return {
        "finger_condition": condition.finger_condition,
        "placement": condition.placement,
        "way": protocol.answers.way(condition.finger_condition),
        "zone_left": condition.zone_left,
        "zone_right": condition.zone_right,
        "finger_left": left,
        "finger_right": right,
    }


def fingers(protocol: Protocol, trial: Trial) -> tuple[str, str]:
    """Return the fingers on the left and on the right zone.

    Parameters
    ----------
    protocol, trial
        As for `describe_answer`.
    """
    return trial.condition.fingers(protocol.conditions.hand)


def _superseded(events: Sequence[dict[str, Any]], values: dict[str, Any]) -> int | None:
    """Return the line of the answer that a new one to the same trial replaces, if there is one."""
    trials = (event for event in reversed(events) if event["event"] == "trial")
    return next((event["n"] for event in trials if event["trial"] == values), None)
