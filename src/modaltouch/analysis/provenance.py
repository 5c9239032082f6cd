"""Facts from the session logs besides the answers: presented stimuli, faults, settings, and participants."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from statistics import fmean, quantiles
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from modaltouch.protocol import TIME_OUT

if TYPE_CHECKING:
    from modaltouch.record import Session

Shared = TypeVar("Shared")
Presented = tuple[str, float, tuple[float, ...], tuple[float, ...], bool]

FAULTS = {
    "trial_cut": "trials interrupted and presented again",
    "unconfirmed": "amplitudes that the instrument did not confirm at once",
    "resume": "interruptions, after which the session was resumed",
    "stop": "sittings ended early",
    "rig": "instrument problems, all overcome or followed by the end of the session",
    "masking_lost": "losses of the masking noise",
    "drifted": "trials whose whole 95 % interval lies more than 5 % above or below the predicted speed",
    "unheard": "trials for which the vibrometer gave no delivered speed",
    "torn": "lines cut while they were written",
}

RIG_TROUBLES = frozenset(
    {"connection_lost", "reconnect_failed", "instrument_errors", "upload_repeated", "unknown_model", "close_failed"}
)
"""Names of the rig events that are reported as faults."""


@dataclass(frozen=True, eq=False)
class SessionFacts:
    """Facts about one session besides its answers; small, so that a thousand fit in memory.

    Attributes
    ----------
    participant : str
        Participant id.
    number : int
        Session number of this participant.
    day : str
        Start date.
    n_answers, n_practice : int
        Number of answers in trials, and in practice.
    presented : Counter
        Counts of identically presented trials: finger condition, level (peak velocity [mm/s], or multiple of the
        participant's threshold), amplitudes of all channels as sent and as read back [V peak to peak], whether
        confirmed.
    faults : Counter
        Events that need attention, by kind.
    settings : dict
        Instrument, seed, hashes and versions.
    threshold_mm_s : float or None
        The participant's threshold, if levels are multiples of it [mm/s].
    people : dict
        Numbers and choices entered for the participant, by the protocol's name with its unit.
    form : dict
        Numbers and words from the form at the end, by question.
    occasion : (str, str)
        Group and kind of session; empty if there are none.
    design : (str, str, str)
        Group, kind of session, and the protocol's sections as JSON.
    """

    participant: str
    number: int
    day: str
    n_answers: int
    n_practice: int
    presented: Counter[Presented]
    faults: Counter[str]
    settings: dict[str, object]
    threshold_mm_s: float | None = None
    people: dict[str, float | str] = field(default_factory=dict)
    form: dict[str, float | str] = field(default_factory=dict)
    occasion: tuple[str, str] = ("", "")
    design: tuple[str, str, str] = ("", "", "{}")

    @property
    def name(self) -> str:
        """Participant and session in words."""
        return f"{self.participant} (session {self.number})"


@lru_cache(maxsize=4096)
def share(kind: str, value: Shared) -> Shared:
    """Return the first value of a kind that equals this, so that what many sessions have in common is held once."""
    return value


def take_facts(session: Session) -> SessionFacts:
    """Extract the facts besides the answers from a session."""
    start, trials = session.start, session.trials
    counted = [event for event in trials if not event["trial"]["practice"]]
    return SessionFacts(
        participant=session.participant,
        number=start.get("session", 1),
        day=str(start.get("time", ""))[:10],
        n_answers=len(counted),
        n_practice=len(trials) - len(counted),
        presented=Counter(share("presented", _presentation(event, session.multiples)) for event in counted),
        faults=Counter(kind for event in session.events for kind in _kinds_of_fault(event)),
        settings={name: share(name, value) for name, value in _settings_of(start).items()},
        threshold_mm_s=(start.get("sensation_levels") or {}).get("threshold_mm_s"),
        people=dict(_people(start)),
        form={name: each.get("value", each["answer"]) for name, each in session.form.items()},
        occasion=session.occasion,
        design=share("design", (*session.occasion, json.dumps(_common_design(start), sort_keys=True))),
    )


def _common_design(start: dict[str, Any]) -> dict[str, Any]:
    """Return the recorded design without what is each participant's own, the levels by threshold."""
    design = start.get("design", {})
    if not start.get("sensation_levels"):
        return dict(design)
    own = {name: value for name, value in design["conditions"].items() if name != "peak_velocities_mm_s"}
    return {**design, "conditions": own}


def _people(start: dict[str, Any]) -> Iterator[tuple[str, float | str]]:
    answers = start.get("people", {})
    for name, asked in start.get("design", {}).get("people", {}).items():
        if asked["kind"] in ("number", "choice") and not asked["identifies"] and answers.get(name) is not None:
            yield f"{name} [{asked['unit']}]" if asked["unit"] else name, answers[name]


def describe_record(sessions: Sequence[SessionFacts]) -> dict[str, Any] | None:
    """Summarise the facts about the analysed sessions for the report; None for a CSV, which has no sessions.

    Returns
    -------
    dict
        ``sessions``; ``presented``, the planned and confirmed stimuli by level, with numbers of trials and amplitudes
        in words; ``faults``, each with its number and sessions; ``settings``, listed if they differ between sessions;
        ``people``, a line for each number or choice that the protocol asks for; ``form``, as by `summarise_form`.
    """
    if not sessions:
        return None
    return {
        "sessions": sessions,
        "presented": list(_presented(sessions)),
        "faults": list(_faults(sessions)),
        "settings": _settings(sessions),
        "people": list(_describe_people(sessions)),
        "form": list(summarise_form(sessions)),
    }


def version_notes(sessions: Sequence[SessionFacts]) -> Iterator[str]:
    """Yield a note for each group and kind of session that was recorded with several versions of the protocol."""
    counted = Counter(session.design for session in sessions)
    for _, own in groupby(sorted(counted), key=lambda design: design[:2]):
        versions = list(own)
        first, *others = [json.loads(design) for *_, design in versions]
        keys = dict.fromkeys(key for other in others for key in _differing(first, other))
        if keys:
            numbers = " and ".join(str(counted[each]) for each in versions)
            yield (
                f"Versions of the protocol that differ in {', '.join(keys)} are analysed together ({numbers} sessions)"
            )


def _differing(first: dict[str, Any], other: dict[str, Any]) -> Iterator[str]:
    """Yield the keys with different values; one that a version lacks, as older programs record fewer, is at default."""
    for name in sorted(first.keys() | other.keys()):
        one, two = (_value(version, name) for version in (first, other))
        if isinstance(one, dict) and isinstance(two, dict):
            keys = sorted(one.keys() | two.keys())
            yield from (f"{name}.{key}" for key in keys if _value(one, name, key) != _value(two, name, key))
        elif one != two:
            yield name


def _value(section: dict[str, Any], *path: str) -> Any:
    """Return the value at the last key of a path in a recorded section; the default of the protocol if it lacks it."""
    if path[-1] in section:
        return section[path[-1]]
    from pydantic_core import to_jsonable_python

    from modaltouch.protocol import Protocol

    model: Any = Protocol
    for name in path[:-1]:
        annotation = getattr(model.model_fields.get(name), "annotation", None)  # of a later program
        model = next((each for each in (annotation, *get_args(annotation)) if hasattr(each, "model_fields")), None)
    asked = model.model_fields.get(path[-1]) if model else None
    return to_jsonable_python(asked.get_default()) if asked and not asked.is_required() else None


def _describe_people(sessions: Sequence[SessionFacts]) -> Iterator[str]:
    """Yield the mean and range of each number, and the count of each choice, over participants."""
    for name in dict.fromkeys(name for session in sessions for name in session.people):
        values = list({each.participant: each.people[name] for each in sessions if name in each.people}.values())
        counted = ", ".join(f"{n} {value}" for value, n in Counter(values).most_common())
        numbers = [value for value in values if not isinstance(value, str)]
        summary = f"mean {fmean(numbers):.1f}, range {min(numbers):g} to {max(numbers):g}" if numbers else counted
        yield f"{name}: {summary} (n = {len(values)})"


def form_files(sessions: Sequence[SessionFacts]) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of ``form.csv``, one per session, with empty fields for time-outs; no file without a form."""
    names = dict.fromkeys(name for session in sessions for name in session.form)
    rows = [
        {"participant": each.participant, "session": each.number, "group": each.occasion[0],
         "session_kind": each.occasion[1]}
        | {name: answer if (answer := each.form.get(name)) != TIME_OUT else None for name in names}
        for each in sessions
    ]  # fmt: skip
    return {"form.csv": rows} if names else {}


def summarise_form(sessions: Sequence[SessionFacts]) -> Iterator[dict[str, Any]]:
    """Yield the median and quartiles over participants of each number of the form, and the count of each word.

    Groups and kinds of session are summarised separately. Numbers are averaged over a participant's sessions of a kind;
    words are counted in every session.
    """
    by_question: dict[tuple[str, str, str], dict[str, list[float | str]]] = {}
    for session in sessions:
        for name, answer in session.form.items():
            if answer != TIME_OUT:
                by_question.setdefault((name, *session.occasion), {}).setdefault(session.participant, []).append(answer)
    for (name, group, kind), own in by_question.items():
        words = Counter(answer for given in own.values() for answer in given if isinstance(answer, str))
        quartiles: list[float] | list[None] = [None] * 3
        if not words:
            numbers = [fmean(map(float, given)) for given in own.values()]
            quartiles = quantiles(numbers * max(1, 3 - len(numbers)), n=4, method="inclusive")
        yield {
            "question": name, "group": group, "session_kind": kind, "n": len(own),
            "median": quartiles[1], "quartile_low": quartiles[0], "quartile_high": quartiles[2],
            "answers": dict(words.most_common()),
        }  # fmt: skip


def _presentation(event: dict[str, Any], multiples: dict[float, float]) -> Presented:
    condition, confirmed = event["trial"]["condition"], event.get("confirmed", {})
    velocity = float(condition["velocity_mm_s"])
    sent = tuple(event.get("commanded", {}).get("amplitude_Vpp", ()))
    read = tuple(confirmed.get("confirmed_amplitude", ()))
    return (
        condition["finger_condition"],
        multiples.get(velocity, velocity),
        sent,
        read,
        bool(confirmed.get("confirmed")),
    )


def _presented(sessions: Sequence[SessionFacts]) -> Iterator[dict[str, Any]]:
    together = sum((session.presented for session in sessions), Counter[Presented]())
    for (finger_condition, level), own in groupby(sorted(together), key=lambda each: each[:2]):
        alike = list(own)
        yield {
            "finger_condition": finger_condition.replace("_", " "),
            "level": f"{level:g}" if level else "0 (nothing played)",
            "n_trials": sum(together[each] for each in alike),
            "n_confirmed": sum(together[each] for each in alike if each[-1]),
            "commanded": _in_words([sent for *_, sent, _, _ in alike]),
            "confirmed": _in_words([read for *_, read, _ in alike]),
        }


def _in_words(amplitudes: Sequence[tuple[float, ...]]) -> str:
    """Return the range of amplitudes of each channel over trials, as in ``1.234, 0.987 to 0.988``."""
    if len({len(each) for each in amplitudes}) > 1:
        return "not recorded"
    ranges = [(min(channel), max(channel)) for channel in zip(*amplitudes, strict=True)]
    return ", ".join(f"{low:g}" if low == high else f"{low:g} to {high:g}" for low, high in ranges)


def _kinds_of_fault(event: dict[str, Any]) -> Iterator[str]:
    if event.get("torn"):
        yield "torn"
    kind = event.get("event")
    if kind in RIG_TROUBLES or any(exchange.get("what") in RIG_TROUBLES for exchange in event.get("exchanges", ())):
        yield "rig"
    # A stop event ends every run of a session; only one before the last trial is a fault.
    faults = ("trial_cut", "unconfirmed", "resume", "masking_lost")
    if kind in faults or (kind == "stop" and not event.get("complete")):
        yield kind
    delivered = event.get("delivered", {})
    yield from ["drifted"] * delivered.get("drifted", False) + ["unheard"] * ("refused" in delivered)


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
        "calibration": start.get("calibration_mark") and f"misses its limits: {start['calibration_mark']}",
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
    facts = {name: _unanimous([session.settings[name] for session in sessions]) for name in sessions[0].settings}
    return {name: text for name, text in facts.items() if text}


def _unanimous(values: Sequence[object]) -> str:
    known = Counter(str(value) for value in values if value not in (None, ""))
    if len(known) <= 1 and known.total() in (0, len(values)):
        return next(iter(known), "")
    listed = [f"{value} (sessions: {n})" for value, n in known.most_common(4)]
    return "; ".join([*listed, *[f"{len(known) - 4} others"] * (len(known) > 4)])
