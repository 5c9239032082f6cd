"""Recorded sessions: the events of a log, the answers that count, and the table of answers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

from modaltouch.record.chain import Chain, UnreadableLineError, read_chain, read_object
from modaltouch.record.files import is_locked
from modaltouch.record.folders import find_log

SCHEMA = 2
"""Version of the log format, stated in the first line. Since version 2, bursts are counted, and an answer is written
on a separate line before its trial is confirmed."""

READABLE = (1, 2)
"""Readable versions of the log format."""

_NEEDED: dict[str, tuple[tuple[tuple[str, ...], type | tuple[type, ...]], ...]] = {
    "start": (
        (("mode",), str),
        (("participant",), str),
        (("protocol",), str),
        (("schedule", "n_trials"), int),
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


@dataclass(frozen=True)
class Session:
    """A recorded session.

    Attributes
    ----------
    path : Path
        The log.
    events : tuple of dict
        Valid lines of the log.
    chain : Chain
        Contents of the file, if read from one.
    """

    path: Path
    events: tuple[dict[str, Any], ...]
    chain: Chain = Chain()

    REPAIRS: ClassVar = ("stop", "closed", "recovered")
    """Events that may be written long after a sitting, when a record is repaired."""

    @classmethod
    def find(cls, path: Path) -> Session:
        """Read the session at a path: its log, its folder, or any folder with a single log.

        Raises
        ------
        RecordError
            If there is no session or more than one, or the log cannot be read.
        """
        return read_session(find_log(path))

    @classmethod
    def peek(cls, log: Path) -> Self:
        """Read only the first line of a session; no line if that is unreadable."""
        try:
            with log.open("rb") as file:
                return cls(log, (read_object(file.readline()),))
        except (OSError, UnreadableLineError):
            return cls(log, ())

    @property
    def problems(self) -> tuple[str, ...]:
        """All problems of the file; empty for an intact file."""
        return (*self.chain.problems, *self.faults)

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """Problems of the place, and of lines that lack members or have some of wrong types; empty without any."""
        faults = [] if self.start else [f"{self.path}:1: is not a start record"]
        for number, event in enumerate(self.events, 1):
            kind, clock = event.get("event"), event.get("clock", 0.0)
            if not isinstance(kind, str) or not isinstance(event.get("n"), int) or not isinstance(clock, (int, float)):
                faults.append(f"{self.path}:{number}: is not an event of a session")
                continue
            if kind == "start" and event.get("schema", 1) not in READABLE:
                faults.append(
                    f"{self.path}:{number}: was written in format {event.get('schema')}, but this program reads "
                    f"{' and '.join(map(str, READABLE))}; use the version of the program that wrote it"
                )
            for path, types in _NEEDED.get("trial" if kind == "answered" else kind, ()):
                value: Any = event
                for step in path:
                    value = value.get(step) if isinstance(value, dict) else None
                if not isinstance(value, types) or (isinstance(value, bool) and types is not bool):
                    faults.append(f"{self.path}:{number}: the event `{kind}` does not say its {'.'.join(path)}")
                    break
        own = f"sub-{self.participant}", f"ses-{self.start.get('session')}", "beh"
        found = self.path.parent.resolve().parts[-3:]
        # A copy elsewhere can be read, such as one that was sent by mail.
        if not faults and any(part.startswith(("sub-", "ses-")) and part not in own for part in found):
            faults.append(f"{self.path}: is the record of {own[0]}, {own[1]}; move it to {'/'.join(own)}")
        return tuple(faults)

    @property
    def is_running(self) -> bool:
        """Whether a process is recording the session now."""
        return is_locked(self.path)

    @cached_property
    def start(self) -> dict[str, Any]:
        """The start record; empty if the log does not begin with one."""
        return self.events[0] if self.events and self.events[0].get("event") == "start" else {}

    @property
    def ended(self) -> str | None:
        """Time of the last event, without those of a later repair; None if there is none."""
        return next((e.get("time") for e in reversed(self.events) if e.get("event") not in self.REPAIRS), None)

    @property
    def mode(self) -> str:
        """``real``, ``pilot`` or ``simulated``."""
        return str(self.start.get("mode", "unknown"))

    @property
    def participant(self) -> str:
        """Participant id."""
        return str(self.start.get("participant", ""))

    @property
    def protocol(self) -> str:
        """Name of the protocol."""
        return str(self.start.get("protocol", ""))

    @property
    def drawn_as(self) -> int:
        """Number of the session whose order this session uses: its own, or that of the session it restarted."""
        return int(self.start.get("schedule", {}).get("seeds", {}).get("session", self.start.get("session", 1)))

    @property
    def started_over_as(self) -> int | None:
        """Number of the session that restarted this session; None if it can be continued."""
        closed = [event["begun_anew_as"] for event in self.events if event.get("event") == "closed"]
        return int(closed[-1]) if closed else None

    @property
    def occasion(self) -> tuple[str, str]:
        """The participant's group and the kind of session; empty strings if the protocol has none."""
        schedule = self.start.get("schedule", {})
        return str(schedule.get("group", "")), str(schedule.get("session_kind", ""))

    @cached_property
    def multiples(self) -> dict[float, float]:
        """Multiple of the participant's threshold by level [mm/s]; empty if levels are not multiples of a threshold."""
        own = self.start.get("sensation_levels") or {"levels_mm_s": (), "multiples": ()}
        return dict(zip(own["levels_mm_s"], own["multiples"], strict=True))

    @cached_property
    def trials(self) -> tuple[dict[str, Any], ...]:
        """Trial events that count: answered, and neither superseded nor withdrawn."""
        counting: dict[int, dict[str, Any]] = {}
        for event in self.events:
            count(counting, event)
        return tuple(counting.values())

    def table(self) -> Iterator[dict[str, Any]]:
        """Yield the answers that count as table rows, values by column."""
        yield from map(self.row, self.trials)

    def row(self, event: dict[str, Any]) -> dict[str, Any]:
        """Return an answer as a table row, values by column; None for unknown values.

        The columns are those of the BIDS table (`modaltouch.record.view`), and for the analysis
        ``participant``, ``session``, ``double`` and ``response_uncertainty`` [s].
        """
        trial, response, condition = event["trial"], event["response"], event["trial"]["condition"]
        kinds = "bursts", "planned", "confirmed", "delivered"
        bursts, planned, confirmed, delivered = (event.get(name) or {} for name in kinds)
        others = (each["planned"] for n, each in enumerate(event.get("intervals", ()), 1) if n != trial["interval"])
        velocity = float(condition["velocity_mm_s"])
        fingers: list[str] = event.get("fingers") or []
        return {
            "participant": self.participant,
            "session": self.start.get("session", 1),
            "trial": trial["index"],
            "block": trial["block"],
            "practice": bool(trial["practice"]),
            "finger_condition": condition["finger_condition"],
            "zone_left": condition["zone_left"],
            "zone_between": condition.get("zone_between", ""),
            "zone_right": condition["zone_right"],
            "finger_left": fingers[0] if fingers else None,
            "finger_between": fingers[1] if len(fingers) > 2 else None,
            "finger_right": fingers[-1] if len(fingers) > 1 else None,
            "placement": condition.get("placement", "normal"),
            "velocity_mm_s": velocity,
            "multiple_of_threshold": self.multiples.get(velocity),
            "masked": bool(event.get("masked")),
            "catch": velocity == 0,
            "stimulus": condition.get("stimulus", ""),
            "interval": trial.get("interval"),
            "standard_mm_s": next((float(each["velocity_mm_s"]) for each in others), None),
            "repetition": trial["repetition"],
            "response": response["answer"],
            "correct": event.get("correct"),
            "response_time": float(response["reaction_time"]),
            "response_onset": response.get("onset", ""),
            "response_uncertainty": _uncertainty(event),
            "answered_by": response.get("answered_by", ""),
            "way": response.get("way", ""),
            "double": bool(response.get("double", False)),
            "confirmed": bool(confirmed.get("confirmed", False)),
            "onset": bursts.get("first_s"),
            "onset_uncertainty": bursts.get("uncertainty_s"),
            "n_bursts": bursts.get("whole"),
            "n_bursts_dropped": bursts.get("dropped"),
            "repetition_by": confirmed.get("repetition"),
            "presentation": event.get("presentation"),
            "device": response.get("device"),
            "speed_left_mm_s": planned.get("speed_left_mm_s"),
            "speed_between_mm_s": planned.get("speed_between_mm_s"),
            "speed_right_mm_s": planned.get("speed_right_mm_s"),
            "delivered_mm_s": max((v for k, v in delivered.items() if k.startswith("speed_")), default=None),
            "log_line": event["n"],
            **dict(zip(self.question_columns, self._further(response), strict=True)),
        }

    def _further(self, response: dict[str, Any]) -> Iterator[Any]:
        """Yield the number on the scale and the answers to further questions, in column order."""
        for name, asked in self.questions.items():
            if name == "value":
                yield response.get("value")
                continue
            further = response.get("further", {}).get(name, {})
            yield further.get("value" if asked.get("scale") else "answer")
            yield further.get("reaction_time")

    @cached_property
    def answered(self) -> frozenset[tuple[bool, int]]:
        """Completed trials as (practice, index): answered, with the stimulus confirmed by the instrument."""
        confirmed = (event["trial"] for event in self.trials if event["confirmed"]["confirmed"])
        return frozenset((trial["practice"], trial["index"]) for trial in confirmed)

    @property
    def n_answered(self) -> int:
        """Number of answered trials, practice excluded."""
        return sum(not practice for practice, _ in self.answered)

    @cached_property
    def form(self) -> dict[str, dict[str, Any]]:
        """Responses to the questions of the closing form."""
        # Without a form in the protocol, skip searching the events after each trial.
        events = self.events if self.start.get("design", {}).get("form") else ()
        return {event["name"]: event["response"] for event in events if event["event"] == "form"}

    @property
    def questions(self) -> dict[str, dict[str, Any]]:
        """Questions in addition to the first one of a trial, as in the protocol, by column."""
        answers = self.start.get("design", {}).get("answers", {})
        scale = {"value": {"scale": answers["scale"]}} if answers.get("scale") else {}
        return {**scale, **answers.get("then", {})}

    @cached_property
    def question_columns(self) -> tuple[str, ...]:
        """Columns of these questions: one for a number, two for an answer and its reaction time."""
        return tuple(
            each for name in self.questions for each in ([name] if name == "value" else [name, f"{name}_time"])
        )

    @property
    def lacks_trials(self) -> bool:
        """Whether any scheduled trial is unanswered, practice excluded."""
        return self.n_answered < int(self.start.get("schedule", {"n_trials": 1})["n_trials"])

    @property
    def complete(self) -> bool:
        """Whether all scheduled trials are answered, practice excluded, and the closing form is filled in."""
        asked = self.start.get("design", {}).get("form", {})
        return bool(self.start) and not self.lacks_trials and asked.keys() <= self.form.keys()

    @property
    def unfit(self) -> str:
        """Why the analysis leaves out a valid session; empty if all its answers can be used."""
        if not self.complete and self.started_over_as is not None:
            return f"closed: started over as session {self.started_over_as}"
        total = self.start.get("schedule", {}).get("n_trials", 0)
        if not self.complete and self.is_running:
            return f"running: {self.n_answered} of {total} trials answered"
        if not self.complete and not self.lacks_trials:
            return "incomplete: the form at the end is not filled in (continue with `modaltouch resume`)"
        if not self.complete:
            return f"incomplete: {self.n_answered} of {total} trials answered (continue with `modaltouch resume`)"
        kinds = self.start.get("design", {}).get("schedule", {}).get("sessions")
        kept = [kind["name"] for kind in kinds if not kind["analysed"]] if isinstance(kinds, list) else []
        return f"of the kind {self.occasion[1]}, which is not analysed (schedule.sessions)" * (self.occasion[1] in kept)


def count(counting: dict[int, dict[str, Any]], event: dict[str, Any]) -> None:
    """Update the trial events that count, by line number, with the next event.

    An answer is recorded at once, and again when the end of its stimulus is confirmed.
    """
    kind = event.get("event")
    withdrawn = (event.get("lines") or ()) if kind == "withdrawn" else ()
    for line in (event.get("supersedes"), event.get("answered") if kind == "trial" else None, *withdrawn):
        if isinstance(line, int):
            counting.pop(line, None)
    if kind in ("trial", "answered"):
        counting[event["n"]] = event


def _uncertainty(event: dict[str, Any]) -> float | None:
    """Return the uncertainty of a reaction time, that of its onset plus that of the answer [s]."""
    response, onset = event["response"], event.get("confirmed", {}).get("onset_uncertainty")
    if response.get("onset") != "first_burst":
        onset = response.get("question_uncertainty", 0.0)
    return None if onset is None else float(onset) + float(response.get("time_uncertainty", 0.0))


def read_session(path: Path) -> Session:
    """Read a session from its log.

    Parameters
    ----------
    path : Path
        The ``session.jsonl``.

    Raises
    ------
    RecordError
        If the file cannot be read.
    """
    chain = read_chain(path)
    return Session(path, chain.events, chain)
