"""Levels calibrated by participant: the threshold from an earlier session, and the levels derived from it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from modaltouch.preflight import Preflight
from modaltouch.protocol import InputError
from modaltouch.record import RecordError, SessionFolder, read_session

_SECTION = ("conditions", "sensation_levels")


def at_own_levels(
    preflight: Preflight, place: SessionFolder, given_mm_s: float | None = None
) -> tuple[Preflight, dict[str, Any]]:
    """Return the preflight at the participant's individual levels, if the protocol has them, and facts for the record.

    Parameters
    ----------
    preflight : Preflight
        The checked protocol.
    place : SessionFolder
        Folder of the participant's session; the session that measured the threshold is in the same tree.
    given_mm_s : float, optional
        The participant's threshold, if measured in another way [mm/s].

    Raises
    ------
    InputError
        If no threshold is known, or a level is outside the protocol's bounds.
    """
    section = preflight.experiment.protocol.conditions.sensation_levels
    if section is None:
        if given_mm_s is not None:
            _refuse(
                preflight, f"a threshold of {given_mm_s:g} mm/s, but the levels do not depend on a threshold", "none",
                "leave --threshold out", path=("conditions", "peak_velocities_mm_s"),
            )  # fmt: skip
        return preflight, {}
    given: dict[str, Any] = {"threshold_mm_s": given_mm_s, "found": "given"}
    own = _find(preflight, place, section.thresholds_from) if given_mm_s is None else given
    levels = section.levels(own["threshold_mm_s"])
    _refuse_beyond(preflight, place.participant, own, section.multiples, levels)
    facts = {**own, "multiples": list(section.multiples), "levels_mm_s": list(levels)}
    return preflight.with_levels(levels), {"sensation_levels": facts}


def _find(preflight: Preflight, place: SessionFolder, thresholds_from: str) -> dict[str, Any]:
    """Return the threshold from the participant's latest complete session of the other protocol, with its source."""
    log, damage = _latest(replace(place, protocol=thresholds_from))
    who = f"participant {place.participant}"
    anew = f"run that protocol with `-p {place.participant}`, or give the threshold with --threshold"
    if damage:
        _refuse(preflight, f"{thresholds_from!r}, whose latest session of {who} is damaged ({damage})",
                "a sound record", f"see `modaltouch doctor {log}`, or give the threshold with --threshold")  # fmt: skip
    if log is None:
        dataset = replace(place, protocol=thresholds_from).dataset
        _refuse(preflight, f"{thresholds_from!r}, but {who} has no complete session of it in {dataset}",
                "a protocol that has found the participant's threshold", anew)  # fmt: skip
    from modaltouch.analysis import analyse_responses, read_responses

    responses = read_responses(log, mode=place.mode)
    if not responses.is_adaptive:
        _refuse(preflight, f"{thresholds_from!r}, whose session {log.parent} is not adaptive",
                "an adaptive protocol", "name the one that finds thresholds")  # fmt: skip
    runs = analyse_responses(responses).as_dict()["thresholds"]
    silent = [run for run in runs if run["threshold_mm_s"] is None or run["is_uncertain"]]
    if silent:
        first = silent[0]
        why = first["why_not"] or "it is uncertain, since a constant probability explains the answers equally well"
        _refuse(
            preflight,
            f"{thresholds_from!r}, but {len(silent)} of {len(runs)} runs of {who} give no threshold "
            f"({first['finger_condition']} {first['pair']}: {why})",
            "a threshold from every run",
            anew,
        )
    mean = math.exp(math.fsum(math.log(run["threshold_mm_s"]) for run in runs) / len(runs))
    names = ("finger_condition", "pair", "stimulus", "threshold_mm_s", "threshold_low_mm_s", "threshold_high_mm_s")
    return {
        "threshold_mm_s": float(f"{mean:.4g}"),
        "found": "session",
        "session": log.relative_to(place.results).as_posix(),
        "last_check": read_session(log).chain.last_check,
        "runs": [{name: run[name] for name in names if name in run} for run in runs],
    }


def _latest(place: SessionFolder) -> tuple[Path | None, str]:
    """Return the log of a participant's latest complete or damaged session, and the damage.

    Sessions older than a damaged one are not used, since their threshold may differ.
    """
    for log in reversed(SessionFolder.logs_of(place.dataset / f"sub-{place.participant}")):
        try:
            session = read_session(log)
        except RecordError as error:
            return log, str(error)
        if session.problems:
            return log, session.problems[0]
        if session.complete:
            return log, ""
    return None, ""


def _refuse_beyond(
    preflight: Preflight,
    participant: str,
    own: dict[str, Any],
    multiples: tuple[float, ...],
    levels: tuple[float, ...],
) -> None:
    velocities = preflight.experiment.protocol.conditions.peak_velocities_mm_s
    low, high = min(velocities), max(velocities)
    beyond = [
        (at, multiple, level)
        for at, (multiple, level) in enumerate(zip(multiples, levels, strict=True))
        if not low <= level <= high
    ]
    if beyond:
        at, multiple, level = beyond[0]
        fits = low / min(multiples), high / max(multiples)
        _refuse(
            preflight,
            f"{multiple:g} times the threshold of participant {participant}, {own['threshold_mm_s']:g} mm/s, which "
            f"gives {level:g} mm/s",
            f"{low:g} to {high:g} mm/s, so thresholds of {fits[0]:.4g} to {fits[1]:.4g} mm/s",
            ("check the value of --threshold, or " if own["found"] == "given" else "")
            + "change the multiples or conditions.peak_velocities_mm_s for all participants",
            path=(*_SECTION, "multiples", at),
        )


def _refuse(
    preflight: Preflight,
    given: str,
    allowed: str,
    remedy: str,
    *,
    path: tuple[str | int, ...] = (*_SECTION, "thresholds_from"),
) -> NoReturn:
    """Raise an InputError at a path of the protocol."""
    reading = preflight.findings.protocol
    raise InputError([] if reading is None else [reading.problem(path, given, allowed, remedy)])
