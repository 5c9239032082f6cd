"""Shape of the events of a session log: which members each has, and of which types."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

READABLE = (1, 2)
"""Readable versions of the log format."""

_NEEDED: dict[str, tuple[tuple[tuple[str, ...], type | tuple[type, ...]], ...]] = {
    "start": ((("mode",), str), (("participant",), str), (("protocol",), str), (("schedule", "n_trials"), int)),
    "start, to be repeated": (
        (("session",), int),
        (("seed",), int),
        (("rig_choice",), str),
        (("answers_choice",), str),
        (("design",), dict),
        *((("sources", file, key), str) for file in ("protocol", "apparatus", "texts") for key in ("text", "path")),
        (("schedule", "order_hash"), str),
        (("stimulus", "content_hash"), str),
        (("versions",), dict),
    ),
    "withdrawn": ((("lines",), list),),
    "closed": ((("begun_anew_as",), int),),
    "form": ((("name",), str), (("response", "answer"), str), (("response", "reaction_time"), (int, float))),
    "trial": (
        (("trial", "index"), int),
        (("trial", "block"), int),
        (("trial", "practice"), bool),
        (("trial", "repetition"), int),
        (("trial", "condition", "finger_condition"), str),
        (("trial", "condition", "zone_left"), str),
        (("trial", "condition", "zone_right"), str),
        (("trial", "condition", "velocity_mm_s"), (int, float)),
        (("confirmed", "confirmed"), bool),
        (("response", "answer"), str),
        (("response", "reaction_time"), (int, float)),
    ),
}
"""Required members of each kind of event, and their types."""


def check_shape(events: Iterable[dict[str, Any]], name: str, *, to_repeat: bool = False) -> tuple[str, ...]:
    """Return a problem for each event with missing or wrong members; empty if all events are valid.

    Parameters
    ----------
    events : iterable of dict
        Valid lines of a log.
    name : str
        Prefix of each problem.
    to_repeat : bool
        Whether the first line must also contain all inputs from which order and drive are computed.
    """
    problems = []
    for number, event in enumerate(events, 1):
        kind = event.get("event")
        clock = event.get("clock", 0.0)
        if not isinstance(kind, str) or not isinstance(event.get("n"), int) or not isinstance(clock, (int, float)):
            problems.append(f"{name}:{number}: is not an event of a session")
            continue
        if kind == "start" and event.get("schema", 1) not in READABLE:
            problems.append(
                f"{name}:{number}: was written in format {event.get('schema')}, but this program reads "
                f"{' and '.join(map(str, READABLE))}; use the version of the program that wrote it"
            )
        kind = "trial" if kind == "answered" else kind
        repeated = _NEEDED["start, to be repeated"] if to_repeat and kind == "start" else ()
        for path, types in (*_NEEDED.get(kind, ()), *repeated):
            value: Any = event
            for step in path:
                value = value.get(step) if isinstance(value, dict) else None
            if not isinstance(value, types) or (isinstance(value, bool) and types is not bool):
                problems.append(f"{name}:{number}: the event `{kind}` does not say its {'.'.join(path)}")
                break
    return tuple(problems)
