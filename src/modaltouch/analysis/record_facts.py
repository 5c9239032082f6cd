"""What the session logs tell beside the answers: what was presented, what went wrong, and how to repeat it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from modaltouch.analysis.responses import Responses
from modaltouch.record.log import Session

FAULTS = {
    "trial_cut": "trials cut and offered again",
    "unconfirmed": "amplitudes the instrument did not confirm at once",
    "resume": "sessions interrupted and resumed",
    "stop": "sittings ended early",
    "rig": "troubles with the instrument, all overcome or followed by an end",
    "torn": "lines cut while they were written",
}

RIG_TROUBLES = frozenset(
    {"connection_lost", "reconnect_failed", "instrument_errors", "upload_repeated", "unknown_model", "close_failed"}
)
"""What the rig's journal calls the events that a reader of the report should know of."""


@dataclass(frozen=True)
class Presented:
    """One level of one finger condition, as planned and as the instrument confirmed it."""

    finger_condition: str
    velocity_mm_s: str
    n_trials: int
    n_confirmed: int
    commanded: str
    confirmed: str


@dataclass(frozen=True)
class RecordFacts:
    """What the report says of the sessions.

    Attributes
    ----------
    sessions : tuple of dict
        One for each session: participant, session, day, number of answers, number of events that need a look.
    presented : tuple of Presented
        Planned against confirmed, level by level.
    faults : tuple of (str, int, str)
        Kind, number, and in which sessions.
    settings : dict of str to str
        Instrument, seed, hashes and versions, the same for all sessions or listed.
    """

    sessions: tuple[dict[str, Any], ...]
    presented: tuple[Presented, ...]
    faults: tuple[tuple[str, int, str], ...]
    settings: dict[str, str]


def describe_record(responses: Responses) -> RecordFacts | None:
    """Return what the logs of the analysed sessions tell; None for a CSV, which has none.

    Parameters
    ----------
    responses : Responses
        Answers with their sessions.
    """
    if not responses.sessions:
        return None
    sessions = responses.sessions
    return RecordFacts(
        tuple(_session_row(session) for session in sessions),
        tuple(_presented(sessions)),
        tuple(_faults(sessions)),
        _settings(sessions),
    )


def _name(session: Session) -> str:
    return f"{session.participant} (session {session.start.get('session', 1)})"


def _session_row(session: Session) -> dict[str, Any]:
    return {
        "participant": session.participant,
        "session": session.start.get("session", 1),
        "day": str(session.start.get("time", ""))[:10],
        "n_answers": sum(not event["trial"]["practice"] for event in session.trials),
        "n_practice": sum(bool(event["trial"]["practice"]) for event in session.trials),
        "n_events": sum(_is_fault(event, kind) for event in session.events for kind in FAULTS),
    }


def _presented(sessions: Sequence[Session]) -> Iterator[Presented]:
    groups: dict[tuple[str, float], list[dict[str, Any]]] = {}
    for session in sessions:
        for event in session.trials:
            if not event["trial"]["practice"]:
                condition = event["trial"]["condition"]
                key = (str(condition["finger_condition"]), float(condition["velocity_mm_s"]))
                groups.setdefault(key, []).append(event)
    for (finger_condition, velocity), events in sorted(groups.items()):
        sent = [event.get("commanded", {}).get("amplitude_Vpp", []) for event in events]
        read = [event.get("confirmed", {}).get("confirmed_amplitude", []) for event in events]
        confirmed = sum(bool(event.get("confirmed", {}).get("confirmed")) for event in events)
        yield Presented(finger_condition, f"{velocity:g}", len(events), confirmed, _ranges(sent), _ranges(read))


def _ranges(amplitudes: Sequence[Sequence[float]]) -> str:
    """Return the amplitude of each channel over trials, as in ``1.234, 0.987 to 0.988``."""
    if not amplitudes or len({len(values) for values in amplitudes}) != 1:
        return "not told"
    texts = []
    for channel in zip(*amplitudes, strict=True):
        low, high = min(channel), max(channel)
        texts.append(f"{low:g}" if low == high else f"{low:g} to {high:g}")
    return ", ".join(texts)


def _is_fault(event: dict[str, Any], kind: str) -> bool:
    if kind == "torn":
        return bool(event.get("torn"))
    if kind == "rig":
        said = {str(event.get("event")), *(str(exchange.get("what")) for exchange in event.get("exchanges", ()))}
        return bool(said & RIG_TROUBLES)
    # Every sitting ends with a stop; only one before the last trial is a deviation.
    return event.get("event") == kind and not (kind == "stop" and event.get("complete"))


def _faults(sessions: Sequence[Session]) -> Iterator[tuple[str, int, str]]:
    for kind, words in FAULTS.items():
        found = Counter(_name(session) for session in sessions for event in session.events if _is_fault(event, kind))
        if found:
            where = ", ".join(f"{name}: {n}" if n > 1 else name for name, n in found.most_common(8))
            yield words, sum(found.values()), where + (" and others" if len(found) > 8 else "")


def _settings(sessions: Sequence[Session]) -> dict[str, str]:
    starts = [session.start for session in sessions]
    facts = {
        "rig": [start.get("rig", {}).get("identity") for start in starts],
        "rig address": [start.get("rig", {}).get("address") for start in starts],
        "protocol": [start.get("protocol") for start in starts],
        "apparatus": [start.get("apparatus") for start in starts],
        "study seed": [start.get("seed") for start in starts],
        "burst": [str(start.get("stimulus", {}).get("content_hash", ""))[:16] for start in starts],
        "modaltouch": [start.get("versions", {}).get("modaltouch") for start in starts],
        "commit": [str(start.get("commit", ""))[:13] for start in starts],
        "python": [start.get("versions", {}).get("python") for start in starts],
    }
    return {name: text for name, values in facts.items() if (text := _unanimous(values))}


def _unanimous(values: Sequence[object]) -> str:
    known = Counter(str(value) for value in values if value not in (None, ""))
    if len(known) <= 1:
        return next(iter(known), "")
    return "; ".join(f"{value} ({n} sessions)" for value, n in known.most_common(4))
