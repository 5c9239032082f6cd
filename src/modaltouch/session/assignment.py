"""What the records on disk decide for a participant: the next session, group, balanced order, and own levels.

A participant's turn determines the order of finger conditions, the placement and the row of a Latin square. If turns
follow the participant number, p01 has the first and p02 the second, and a drop-out leaves a gap. If they follow the
records, a new participant gets the turn filled by the fewest participants, so that gaps are closed. A turn is filled by
a participant whose latest session is complete or running. Participants whose latest session is incomplete may still
resume it, and are counted only to break ties.

Levels calibrated by participant are multiples of the threshold found in an earlier session.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from functools import lru_cache
from pathlib import Path
from typing import Any, NoReturn

from modaltouch.preflight import Preflight
from modaltouch.protocol import InputError, Protocol, Turn
from modaltouch.record import RecordError, RecordInputError, Session, SessionFolder, read_session

LEAST_FILLED = "least filled in the records"
"""Reason recorded for a turn or group that is decided by the records."""


def assign_turn(
    place: SessionFolder, protocol: Protocol, drawn_as: int, group: str = ""
) -> tuple[Turn, dict[str, Any]]:
    """Return the turn of a participant whose session begins, and the facts of its assignment for the record.

    Call while holding the lock of the dataset.

    Parameters
    ----------
    drawn_as : int
        Number of the session, without restarted ones; each session has the turn after that of the previous one.
    group : str
        The participant's group; orders are balanced within it.

    Raises
    ------
    RecordError
        If a session cannot be read.
    """
    n_turns, reason = Turn.period(protocol), "the participant's earlier sessions"
    own, filled, left = _tally(
        place, lambda first: first_turn(first, protocol) % n_turns if first.occasion[0] == group else None
    )
    if own is None:
        own, reason = min(range(n_turns), key=lambda turn: (filled[turn], left[turn], turn)), LEAST_FILLED
    turn = Turn(own + drawn_as - 1, reason)
    return turn, {
        "rule": "least_filled",
        "turn": turn.number,
        "reason": reason,
        "n_turns": n_turns,
        "filled": {str(turn): n for turn, n in sorted(filled.items())},
        "left_incomplete": {str(turn): n for turn, n in sorted(left.items())},
    }


def assign_group(place: SessionFolder, protocol: Protocol, seed: int, given: str | None = None) -> tuple[str, str]:
    """Return a participant's group and the reason for it; empty if the protocol has no groups.

    Raises
    ------
    RecordInputError
        If there is no such group, or the participant belongs to another one.
    """
    names = list(protocol.groups)
    if given is not None and given not in names:
        listed = ", ".join(names) or "none, as the protocol has no section groups"
        raise RecordInputError(f"given --group {given}; allowed: {listed}; leave it out for the group that is due")
    if not names:
        return "", ""
    own, filled, left = _tally(place, lambda first: first.occasion[0])
    if own is not None:
        if given not in (None, own):
            raise RecordInputError(f"given --group {given}, but participant {place.participant} belongs to group {own}")
        return own, "the participant's earlier sessions"
    if given is not None:
        return given, "given"
    if protocol.schedule.balance == "least_filled":
        return min(names, key=lambda name: (filled[name], left[name])), LEAST_FILLED
    turn = Turn.of(place.participant, seed, 1, names)
    return turn.group, turn.group_by


def is_early(place: SessionFolder, protocol: Protocol, drawn_as: int, now: datetime) -> str:
    """Return an error message if a session would begin too early for its kind or out of turn; else an empty string."""
    kind = protocol.schedule.kind_of(drawn_as)
    logs = SessionFolder.logs_of(place.dataset / f"sub-{place.participant}")
    if kind is not None and len(logs) < drawn_as - 1:
        return (
            f"given session {drawn_as}, of the kind '{kind.name}', but participant {place.participant} has had "
            f"{len(logs)}; allowed: session {len(logs) + 1}; leave --session out, or begin it anyway with --any-gap, "
            f"which is then recorded"
        )
    last = read_session(logs[-1]).ended if kind is not None and kind.min_gap_days and logs else None
    if kind is None or last is None:
        return ""
    ended = datetime.fromisoformat(last)
    due = ended + timedelta(days=kind.min_gap_days)
    said = (
        f"{logs[-1]}: the session before ended {ended:%Y-%m-%d %H:%M} UTC, and a session of the kind '{kind.name}' "
        f"has min_gap_days: {kind.min_gap_days:g} (schedule.sessions), so it may begin from {due:%Y-%m-%d %H:%M} "
        "UTC on; wait, or begin it anyway with --any-gap, which is then recorded"
    )
    return "" if now >= due else said


def next_session(place: SessionFolder, n_sessions: int) -> tuple[SessionFolder, int]:
    """Return the folder of a participant's next session, and its number without restarted sessions.

    Raises
    ------
    RecordError
        If a session cannot be read, the latest is not complete, or the participant has had all sessions.
    """
    every = [read_session(log) for log in SessionFolder.logs_of(place.dataset / f"sub-{place.participant}")]
    for each in every:
        if each.faults:
            fault = each.problems[0]
            way = f"see `modaltouch doctor {each.path.parent}`, or give --session"
            raise RecordError(f"{fault}; so the participant's next session is not known: {way}")
    if not every:
        return replace(place, session=1), 1
    latest = every[-1]
    number = SessionFolder.number_of(latest.path) + 1
    faults = "".join(f"\n{fault}" for fault in latest.problems)
    if latest.is_running:
        replace(place, session=number - 1).refuse_existing()
    if not latest.complete:
        raise RecordError(
            f"{latest.path}: this session exists already and is not complete; continue it with `modaltouch resume "
            f"{latest.path.parent}`, or begin another with --session {number}{faults}"
        )
    held = [session for session in every if session.started_over_as is None]
    if len(held) >= n_sessions:
        what = "its one session" if n_sessions == 1 else f"all {n_sessions} sessions"
        raise RecordError(
            f"{latest.path}: participant {place.participant} exists already and has had {what} of the protocol, and "
            f"nothing is overwritten; give another participant id, or --session {number} for one more{faults}"
        )
    return replace(place, session=number), len(held) + 1


def propose_participant(dataset: Path) -> str:
    """Return the id after the last one in a dataset: ``p08`` after ``p07``; ``p01`` for the first.

    Parameters
    ----------
    dataset : Path
        A folder of ``sub-<id>`` folders; it need not exist.
    """
    found = [re.match(r"([A-Za-z]*)(\d+)\Z", folder.name[4:]) for folder in dataset.glob("sub-*") if folder.is_dir()]
    numbered = [match.groups() for match in found if match]
    letters, digits = max(numbered, key=lambda parts: int(parts[1]), default=("p", "00"))
    return f"{letters}{int(digits) + 1:0{len(digits)}d}"


def _tally(place: SessionFolder, kind_of: Callable[[Session], Any]) -> tuple[Any, Counter[Any], Counter[Any]]:
    """Return the kind of a participant, and the numbers of others of each kind, with and without a complete session.

    The kind follows from the start record of the first session; those of kind None are left out. The latest session
    counts, also if it is running; a damaged one is not complete.
    """
    own, filled, left = None, Counter[Any](), Counter[Any]()
    for folder in sorted(place.dataset.glob("sub-*")):
        logs = SessionFolder.logs_of(folder)
        first = Session.peek(logs[0]) if logs else None
        kind = kind_of(first) if first is not None and first.start else None
        if kind is not None and folder.name == f"sub-{place.participant}":
            own = kind
        elif kind is not None:
            changed = logs[-1].stat().st_mtime_ns if logs[-1].exists() else 0  # a broken link is reported when read
            is_filled = _is_complete(logs[-1], changed) or Session.peek(logs[-1]).is_running
            (filled if is_filled else left)[kind] += 1
    return own, filled, left


@lru_cache(maxsize=4096)
def _is_complete(log: Path, changed: int) -> bool:
    """Test whether a session is complete; a whole cohort asks of each unchanged log only once."""
    return read_session(log).complete


def first_turn(session: Session, protocol: Protocol) -> int:
    """Return the turn of a participant's first session, derived from any session."""
    start = session.start
    groups = start.get("design", {}).get("groups", ())
    turn = Turn.recorded(start) or Turn.of(session.participant, int(start["seed"]), session.drawn_as, groups)
    return turn.as_now(start, protocol).number - (session.drawn_as - 1)


_SECTION = ("conditions", "sensation_levels")


def at_own_levels(
    preflight: Preflight, place: SessionFolder, given_mm_s: float | None = None
) -> tuple[Preflight, dict[str, Any]]:
    """Return the preflight at the participant's individual levels, if the protocol has them, and facts for the record.

    Parameters
    ----------
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
    velocities = preflight.experiment.protocol.conditions.peak_velocities_mm_s
    low, high = min(velocities), max(velocities)
    for at, (multiple, level) in enumerate(zip(section.multiples, levels, strict=True)):
        if not low <= level <= high:
            fits = low / min(section.multiples), high / max(section.multiples)
            _refuse(
                preflight,
                f"{multiple:g} times the threshold of participant {place.participant}, {own['threshold_mm_s']:g} mm/s, "
                f"which gives {level:g} mm/s",
                f"{low:g} to {high:g} mm/s, so thresholds of {fits[0]:.4g} to {fits[1]:.4g} mm/s",
                ("check the value of --threshold, or " if own["found"] == "given" else "")
                + "change the multiples or conditions.peak_velocities_mm_s for all participants",
                path=(*_SECTION, "multiples", at),
            )
    facts = {**own, "multiples": list(section.multiples), "levels_mm_s": list(levels)}
    return preflight.with_levels(levels), {"sensation_levels": facts}


def _find(preflight: Preflight, place: SessionFolder, thresholds_from: str) -> dict[str, Any]:
    """Return the threshold from the participant's latest complete session of the other protocol, with its source."""
    dataset, who = replace(place, protocol=thresholds_from).dataset, f"participant {place.participant}"
    read = (read_session(log) for log in reversed(SessionFolder.logs_of(dataset / f"sub-{place.participant}")))
    # Sessions older than a damaged one are not used, since their threshold may differ.
    latest = next((each for each in read if each.problems or each.complete), None)
    anew = f"run that protocol with `-p {place.participant}`, or give the threshold with --threshold"
    if latest is None:
        _refuse(preflight, f"{thresholds_from!r}, but {who} has no complete session of it in {dataset}",
                "a protocol that has found the participant's threshold", anew)  # fmt: skip
    log = latest.path
    if latest.problems:
        _refuse(preflight, f"{thresholds_from!r}, whose latest session of {who} is damaged ({latest.problems[0]})",
                "a sound record", f"see `modaltouch doctor {log}`, or give the threshold with --threshold")  # fmt: skip
    from modaltouch.analysis import analyse_responses, read_responses

    responses = read_responses(log, mode=place.mode)
    if not responses.is_adaptive:
        _refuse(preflight, f"{thresholds_from!r}, whose session {log.parent} is not adaptive",
                "an adaptive protocol", "name the one that finds thresholds")  # fmt: skip
    runs = analyse_responses(responses).as_dict()["thresholds"]
    if silent := [run for run in runs if run["threshold_mm_s"] is None or run["is_uncertain"]]:
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
        "last_check": latest.chain.last_check,
        "runs": [{name: run[name] for name in names if name in run} for run in runs],
    }


def _refuse(
    preflight: Preflight,
    given: str,
    allowed: str,
    remedy: str,
    *,
    path: tuple[str | int, ...] = (*_SECTION, "thresholds_from"),
) -> NoReturn:
    raise InputError([preflight.findings.problem(path, given, allowed, remedy)])
