"""Descriptions of a session and its trials, for the record and the experimenter."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from modaltouch.preflight import Preflight
from modaltouch.protocol import Protocol, Response, Schedule, Trial
from modaltouch.record import RecordError, SessionFolder, SessionLog
from modaltouch.rig import Firing, RigError
from modaltouch.system import Interrupted
from modaltouch.window import SessionStopped, WindowError


def describe_start(preflight: Preflight, schedule: Schedule, place: SessionFolder) -> dict[str, Any]:
    """Return the start record's facts on the experiment, sufficient to repeat the session."""
    experiment, burst = preflight.experiment, preflight.stimulus.burst
    adaptive = experiment.protocol.adaptive
    return {
        "schema": SessionLog.SCHEMA,
        "mode": place.mode,
        "participant": place.participant,
        "session": place.session,
        "protocol": experiment.protocol.protocol,
        "apparatus": experiment.apparatus.apparatus,
        "language": experiment.texts.language,
        "instructions": experiment.texts.instructions,
        "question": experiment.texts.named(experiment.protocol.answers.question or experiment.texts.question),
        "design": experiment.protocol.model_dump(mode="json"),
        "sources": experiment.sources.as_dict(),
        **({"calibration_mark": preflight.calibration_mark} if preflight.calibration_mark else {}),
        "schedule": schedule.as_dict(),
        **({"adaptive": adaptive.algorithm} if adaptive is not None else {}),
        "stimulus": {
            "content_hash": burst.content_hash,
            "velocity_mm_s": burst.velocity * 1e3,
            "amplitude_Vpp": list(burst.amplitude),
            "stimuli": preflight.stimuli,
            "fields": preflight.fields,
            **({} if experiment.sources.at_samples else {"peaks": "between samples"}),
            **({"content_hashes": preflight.content_hashes} if len(preflight.designs) > 1 else {}),
        },
    }


def boot_id() -> str:
    """Return the identifier of the current boot; empty if the system provides none."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""


PRACTICE_FAILED = "practice not passed"
"""Reason for the end of a session after failed practice."""


def how_to_continue(reason: str, folder: Path) -> str:
    """Return advice on how to continue a session that ended early."""
    if reason == PRACTICE_FAILED:
        return f"`modaltouch resume --restart {folder}` starts it over, including practice"
    return f"continue with `modaltouch resume {folder}`"


def describe_ending(error: BaseException) -> dict[str, str]:
    """Return the reason for the early end of a session, for its stop record."""
    if isinstance(error, (SessionStopped, Interrupted)):
        return {"reason": error.reason if isinstance(error, SessionStopped) else error.signal_name}
    kinds = ((RigError, "rig fault"), (RecordError, "record fault"), (BaseException, "error"))
    reason = next(reason for kind, reason in kinds if isinstance(error, kind))
    reason = error.ending if isinstance(error, WindowError) else reason
    return {"reason": reason, "message": f"{type(error).__name__}: {error}"}


def describe_answer(
    protocol: Protocol,
    speeds: Callable[[Trial], tuple[float, ...]],
    trial: Trial,
    response: Response,
    firings: Sequence[Firing],
    *,
    masked: bool | None,
    events: Sequence[dict[str, Any]],
) -> dict[str, Any]:
    """Return the facts of a trial event: planned, commanded and confirmed stimulus, and response.

    `speeds` returns the predicted peak speeds under the fingers, from left to right [m/s]. Of the `firings`, one for
    each interval, that of `trial.interval` has the trial's condition. `masked` is None if the protocol has no noise,
    and `events` are those of this trial in the record so far.
    """
    values, last = trial.as_dict(), firings[-1]
    answered = last.onset + response.counted_from + response.reaction_time
    asked = None if response.question_after is None else last.onset + response.question_after
    # Any unconfirmed interval makes the trial unconfirmed.
    spoilt = next((each for each in firings if not each.confirmed), last)
    own = firings[trial.interval - 1]
    firing = replace(own, confirmed=spoilt.confirmed, reason=spoilt.reason, stalled=spoilt.stalled)
    parts = zip(protocol.presented(trial), firings, strict=True) if trial.interval else ()
    intervals = [
        {**_describe_stimulus(speeds(part), part, each), "first_burst": _first(part, each)} for part, each in parts
    ]
    return {
        "trial": values,
        "presentation": sum(
            event["event"] == "fired" and event["trial"] == values and event.get("interval", 1) == 1 for event in events
        ),
        "fingers": list(protocol.conditions.fingers_of(trial.condition)),
        **({"catch": True} if trial.condition.is_catch else {}),
        **({"masked": masked} if masked is not None else {}),
        **_describe_stimulus(speeds(trial), trial, firing),
        **({"intervals": intervals} if intervals else {}),
        "response": response.as_dict(),
        **({"correct": protocol.is_correct(trial, response.answer)} if intervals else {}),
        # A frame appears between the call of flip and its return, plus the unknown latency of the monitor. A key press
        # is time-stamped when it is read, at most one poll after it occurred.
        "instants": {
            "first_burst": _first(trial, firing),
            "question": None if asked is None else _between(asked - response.question_uncertainty, asked),
            "answer": _between(answered - response.time_uncertainty, answered),
        },
        "supersedes": _superseded(events, values),
    }


def _describe_stimulus(speeds: tuple[float, ...], part: Trial, firing: Firing) -> dict[str, Any]:
    """Return the planned, commanded, confirmed and played stimulus of a trial or an interval."""
    stimulus = part.condition.stimulus if part.interval else ""
    return {
        "planned": {
            "velocity_mm_s": part.condition.velocity_mm_s,
            **({"stimulus": stimulus} if stimulus else {}),
            **_by_side("speed_{}_mm_s", part, (round(speed * 1e3, 3) for speed in speeds)),
        },
        "commanded": {"amplitude_Vpp": list(firing.commanded_amplitude)},
        "confirmed": firing.as_dict(),
        "bursts": firing.bursts.as_dict(),
    }


def _first(part: Trial, firing: Firing) -> dict[str, float] | None:
    """Return the earliest and latest onset of the first burst; None if there is none or its onset is unknown."""
    bursts = firing.bursts
    # Unlike before the end of a stimulus, a fault at its end leaves open whether the first burst played.
    is_lost = bursts.asked is not None and bursts.played is None and bursts.first_s is None
    if part.condition.is_catch or firing.repetition == "wired" or is_lost:
        return None
    return _between(firing.onset - firing.onset_uncertainty, firing.onset + firing.onset_uncertainty)


def describe_trial(protocol: Protocol, speeds: tuple[float, ...], trial: Trial) -> dict[str, Any]:
    """Return the description of a trial shown to the experimenter before it begins."""
    return {
        "number": trial.index,
        "practice": trial.practice,
        "block": trial.block,
        **({"stimulus": trial.condition.stimulus} if trial.condition.stimulus else {}),
        **({"interval": trial.interval} if trial.interval else {}),
        "velocity_mm_s": trial.condition.velocity_mm_s,
        **_by_side("predicted_{}_mm_s", trial, (round(speed * 1e3, 1) for speed in speeds)),
        **describe_placement(protocol, trial),
    }


def describe_placement(protocol: Protocol, trial: Trial) -> dict[str, Any]:
    """Return the finger on each zone, and the way of answering."""
    condition = trial.condition
    return {
        "finger_condition": condition.finger_condition,
        "placement": condition.placement,
        "way": protocol.answers.way(condition.finger_condition),
        **_by_side("zone_{}", trial, condition.zones),
        **_by_side("finger_{}", trial, protocol.conditions.fingers_of(condition)),
    }


def _by_side(name: str, trial: Trial, values: Iterable[Any]) -> dict[str, Any]:
    """Return the values of the fingers by name, with the finger's side in each name."""
    return dict(zip(map(name.format, trial.condition.sides), values, strict=True))


def _superseded(events: Sequence[dict[str, Any]], values: dict[str, Any]) -> int | None:
    """Return the line of the answer superseded by a new answer to the same trial, if any.

    The lines of a presentation, `answered` and then `trial`, supersede only those of earlier presentations.
    """
    last = max((place for place, event in enumerate(events) if event["event"] == "fired"), default=len(events))
    answers = (event for event in reversed(events[:last]) if event["event"] in ("trial", "answered"))
    return next((event["n"] for event in answers if event["trial"] == values), None)


def _between(earliest: float, latest: float) -> dict[str, float]:
    return {"earliest_s": round(earliest, 6), "latest_s": round(latest, 6)}
