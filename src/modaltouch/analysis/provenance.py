"""What the session logs tell beside the answers: what was presented, what went wrong, and how to repeat it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from modaltouch.record import Session

Ranges = list[tuple[float, float]] | None
"""Lowest and highest value of each channel; None where trials differ in their number of channels."""

FAULTS = {
    "trial_cut": "trials cut and offered again",
    "unconfirmed": "amplitudes the instrument did not confirm at once",
    "resume": "sessions interrupted and resumed",
    "stop": "sittings ended early",
    "rig": "troubles with the instrument, all overcome or followed by an end",
    "masking_lost": "losses of the masking noise",
    "torn": "lines cut while they were written",
}

RIG_TROUBLES = frozenset(
    {"connection_lost", "reconnect_failed", "instrument_errors", "upload_repeated", "unknown_model", "close_failed"}
)
"""What the rig's journal calls the events that a reader of the report should know of."""


@dataclass(frozen=True)
class ConfirmedLevel:
    """One level of one finger condition, as planned and as the instrument confirmed it."""

    finger_condition: str
    level: str
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
    presented : tuple of ConfirmedLevel
        Planned against confirmed, level by level.
    faults : tuple of (str, int, str)
        Kind, number, and in which sessions.
    settings : dict of str to str
        Instrument, seed, hashes and versions, the same for all sessions or listed.
    """

    sessions: tuple[dict[str, Any], ...]
    presented: tuple[ConfirmedLevel, ...]
    faults: tuple[tuple[str, int, str], ...]
    settings: dict[str, str]


@dataclass
class LevelFacts:
    """What was sent and read back at one level of one finger condition.

    Attributes
    ----------
    n_trials, n_confirmed : int
        Answers, and those whose stimulus the instrument confirmed.
    commanded, confirmed : list of (float, float), or None
        Lowest and highest amplitude of each channel, sent and read back [V peak to peak]; None where trials tell
        different numbers of channels.
    """

    n_trials: int = 0
    n_confirmed: int = 0
    commanded: Ranges = field(default_factory=list)
    confirmed: Ranges = field(default_factory=list)

    def add(self, other: LevelFacts) -> None:
        """Take the trials of another session in."""
        first = self.n_trials == 0
        self.n_trials += other.n_trials
        self.n_confirmed += other.n_confirmed
        self.commanded = other.commanded if first else _widen(self.commanded, other.commanded)
        self.confirmed = other.confirmed if first else _widen(self.confirmed, other.confirmed)


@dataclass(frozen=True, eq=False)
class SessionFacts:
    """What remains of a session's log once its answers are taken; small, so that a thousand fit in memory.

    Attributes
    ----------
    participant : str
        Participant id.
    number : int
        Which session of the participant.
    day : str
        Date of its beginning.
    n_answers, n_practice : int
        Answers that count, and those of practice.
    levels : dict
        What was presented, by finger condition and level: peak velocity [mm/s], or multiple of the own threshold.
    faults : Counter
        Events that need a look, by kind.
    settings : dict
        Instrument, seed, hashes and versions.
    threshold_mm_s : float or None
        The participant's own threshold, where levels are multiples of it [mm/s].
    """

    participant: str
    number: int
    day: str
    n_answers: int
    n_practice: int
    levels: dict[tuple[str, float], LevelFacts]
    faults: Counter[str]
    settings: dict[str, object]
    threshold_mm_s: float | None = None

    @property
    def name(self) -> str:
        """Participant and session in words."""
        return f"{self.participant} (session {self.number})"


def take_facts(session: Session) -> SessionFacts:
    """Return what a session's log tells beside the answers."""
    start, trials, multiples = session.start, session.trials, session.multiples
    counted = [event for event in trials if not event["trial"]["practice"]]
    by_level: dict[tuple[str, float], list[dict[str, Any]]] = {}
    for event in counted:
        condition = event["trial"]["condition"]
        velocity = float(condition["velocity_mm_s"])
        key = (str(condition["finger_condition"]), multiples.get(velocity, velocity))
        by_level.setdefault(key, []).append(event)
    return SessionFacts(
        participant=session.participant,
        number=start.get("session", 1),
        day=str(start.get("time", ""))[:10],
        n_answers=len(counted),
        n_practice=len(trials) - len(counted),
        levels={key: _level_facts(events) for key, events in by_level.items()},
        faults=Counter(kind for event in session.events for kind in _kinds_of_fault(event)),
        settings=_settings_of(start),
        threshold_mm_s=(start.get("sensation_levels") or {}).get("threshold_mm_s"),
    )


def describe_record(sessions: Sequence[SessionFacts]) -> RecordFacts | None:
    """Return what the logs of the analysed sessions tell; None for a CSV, which has none."""
    if not sessions:
        return None
    return RecordFacts(
        tuple(_session_row(session) for session in sessions),
        tuple(_presented(sessions)),
        tuple(_faults(sessions)),
        _settings(sessions),
    )


def _session_row(session: SessionFacts) -> dict[str, Any]:
    return {
        "participant": session.participant,
        "session": session.number,
        "day": session.day,
        "n_answers": session.n_answers,
        "n_practice": session.n_practice,
        "n_events": session.faults.total(),
        "threshold_mm_s": session.threshold_mm_s,
    }


def _level_facts(events: Sequence[dict[str, Any]]) -> LevelFacts:
    """Return what a session's trials at one level tell of it."""
    sent = [event.get("commanded", {}).get("amplitude_Vpp", []) for event in events]
    confirmed = [event.get("confirmed", {}) for event in events]
    read = [told.get("confirmed_amplitude", []) for told in confirmed]
    n_confirmed = sum(bool(told.get("confirmed")) for told in confirmed)
    return LevelFacts(len(events), n_confirmed, _ranges(sent), _ranges(read))


def _ranges(amplitudes: Sequence[Sequence[float]]) -> Ranges:
    """Return the lowest and highest amplitude of each channel over trials."""
    if len({len(each) for each in amplitudes}) > 1:
        return None
    return [(min(channel), max(channel)) for channel in zip(*amplitudes, strict=True)]


def _widen(ranges: Ranges, others: Ranges) -> Ranges:
    if ranges is None or others is None or len(ranges) != len(others):
        return None
    return [(min(a, c), max(b, d)) for (a, b), (c, d) in zip(ranges, others, strict=True)]


def _presented(sessions: Sequence[SessionFacts]) -> Iterator[ConfirmedLevel]:
    together: dict[tuple[str, float], LevelFacts] = {}
    for session in sessions:
        for key, level in session.levels.items():
            together.setdefault(key, LevelFacts()).add(level)
    for (finger_condition, planned), level in sorted(together.items(), key=lambda item: item[0]):
        sent, read = _in_words(level.commanded), _in_words(level.confirmed)
        yield ConfirmedLevel(finger_condition, f"{planned:g}", level.n_trials, level.n_confirmed, sent, read)


def _in_words(ranges: Ranges) -> str:
    """Return the amplitude of each channel over trials, as in ``1.234, 0.987 to 0.988``."""
    if ranges is None:
        return "not recorded"
    return ", ".join(f"{low:g}" if low == high else f"{low:g} to {high:g}" for low, high in ranges)


def _kinds_of_fault(event: dict[str, Any]) -> Iterator[str]:
    if event.get("torn"):
        yield "torn"
    kind = event.get("event")
    if kind in RIG_TROUBLES or any(exchange.get("what") in RIG_TROUBLES for exchange in event.get("exchanges", ())):
        yield "rig"
    # Every sitting ends with a stop; only one before the last trial is a deviation.
    told = ("trial_cut", "unconfirmed", "resume", "masking_lost")
    if kind in told or (kind == "stop" and not event.get("complete")):
        yield kind


def _faults(sessions: Sequence[SessionFacts]) -> Iterator[tuple[str, int, str]]:
    for kind, words in FAULTS.items():
        found: Counter[str] = Counter()
        for session in sessions:
            if session.faults[kind]:
                found[session.name] += session.faults[kind]
        if found:
            where = ", ".join(f"{name}: {n}" if n > 1 else name for name, n in found.most_common(8))
            yield words, sum(found.values()), where + (" and others" if len(found) > 8 else "")


def _settings_of(start: dict[str, Any]) -> dict[str, object]:
    return {
        "rig": start.get("rig", {}).get("identity"),
        "rig address": start.get("rig", {}).get("address"),
        "protocol": start.get("protocol"),
        "apparatus": start.get("apparatus"),
        "masking noise": _masking_in_words(start.get("masking")),
        "study seed": start.get("seed"),
        "burst": str(start.get("stimulus", {}).get("content_hash", ""))[:16],
        "modaltouch": start.get("versions", {}).get("modaltouch"),
        "commit": str(start.get("commit", ""))[:13],
        "python": start.get("versions", {}).get("python"),
    }


def _masking_in_words(masking: dict[str, Any] | None) -> str:
    if not masking:
        return ""
    if masking["state"] != "masked":
        return f"none: {masking['reason']}"
    at_ear = masking["level_dB_SPL"]
    level = f"{masking['level_dB_FS']:g} dB FS" + (f", {at_ear:g} dB SPL" if at_ear is not None else "")
    return f"{masking['noise']}, {level}, on {masking['device']}"


def _settings(sessions: Sequence[SessionFacts]) -> dict[str, str]:
    names = sessions[0].settings
    facts = {name: _unanimous([session.settings[name] for session in sessions]) for name in names}
    return {name: text for name, text in facts.items() if text}


def _unanimous(values: Sequence[object]) -> str:
    known = Counter(str(value) for value in values if value not in (None, ""))
    if len(known) <= 1:
        return next(iter(known), "")
    return "; ".join(f"{value} ({n} sessions)" for value, n in known.most_common(4))
