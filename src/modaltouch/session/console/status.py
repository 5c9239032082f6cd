"""State of a session derived from its events, as plain values with units."""

from __future__ import annotations

import statistics
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from string import ascii_lowercase
from typing import Any

from modaltouch.protocol import AnswerList, AnswersSection
from modaltouch.session.console import OWN_KEYS, SessionState

HASTY = 0.1
"""Time too short for a reaction; a faster answer was prepared before its question [s]."""


def is_hasty(event: dict[str, Any]) -> bool:
    """Return whether a trial was answered faster than a reaction is possible."""
    response = event["response"]
    since = response["reaction_time"]
    if response.get("onset") == "first_burst" and response.get("question_after") is not None:
        since -= response["question_after"]
    return bool(since < HASTY)


def typed_keys(keys: Mapping[str, Sequence[str]], answers: Sequence[str] | None) -> dict[str, list[str]]:
    """Return the console keys of each answer in `answers`, in the order on the screen, the protocol's keys first.

    For a scale (`answers` is None), return the keys of its actions except confirmation, which is a key of the console.

    Reserved keys of the console are never assigned. A terminal does not distinguish the digits of the keypad. Each
    answer also gets the number of its position on the screen, unless that is a key of another answer; an answer without
    any key gets the first free digit or letter.

    Examples
    --------
    >>> typed_keys({"left": ["left", "num_4"], "both": ["n"], "right": ["right", "2"]}, ("left", "both", "right"))
    {'left': ['left', '4', '1'], 'both': ['5'], 'right': ['right', '2', '3']}
    """
    if answers is None:
        return {
            what: [key for key in named if key not in OWN_KEYS] for what, named in keys.items() if what != "confirm"
        }
    given = [(name, answer) for answer in answers for name in keys[answer] if name not in OWN_KEYS]
    wanted = [(name, answer) for name, answer in given if not name.startswith("num_")]
    wanted += [(name[4:], answer) for name, answer in given if name[:4] == "num_" and name[4:].isdecimal()]
    wanted += [(str(place), answer) for place, answer in enumerate(answers, start=1)]
    taken: dict[str, str] = {}
    for key, answer in wanted:
        taken.setdefault(key, answer)
    for answer in answers:
        if answer not in taken.values():
            free = (key for key in f"123456789{ascii_lowercase}" if key not in taken and key not in OWN_KEYS)
            taken[next(free)] = answer
    return {answer: [key for key, whose in taken.items() if whose == answer] for answer in answers}


TROUBLES = frozenset(
    {
        "connection_lost",
        "reconnect_failed",
        "instrument_errors",
        "upload_repeated",
        "unconfirmed",
        "close_failed",
        "probe_refused",
    }
)
"""Events of the rig shown to the experimenter."""
_QUIET = frozenset({"rig", "exchange", "discarded", "ignored"})
"""Events that do not change the display."""
_LONGEST = 300.0
"""Duration above which a trial included a break and is not used to estimate the pace [s]."""


class Status:
    """State of a session, updated by its events.

    Parameters
    ----------
    seconds_per_trial : float
        Assumed duration of a trial until three have been timed [s].
    """

    def __init__(self, seconds_per_trial: float = 5.0) -> None:
        self._guess = seconds_per_trial
        self._began = time.perf_counter()
        self._facts: SessionState = {
            "event": "",
            "line": None,
            "replayed": False,
            "participant": "",
            "session": 0,
            "mode": "",
            "protocol": "",
            "state": "waiting",
            "paused_by": "",
            "stopped_by": "",
            "trial": None,
            "generator": {"identity": "", "outputs": "off", "amplitude_Vpp": [], "confirmed": None, "last_error": ""},
            "last": None,
            "question": None,
            "too_early": "",
            "ends_after_block": False,
            "repeats_trial": None,
            "repeats_practice": False,
            "nothing_to_repeat": False,
            "n_notes": 0,
        }
        self._total = 0
        self._nothing: str | None = None
        self._keys: dict[str, list[str]] = {}
        self._further: dict[str, Any] | None = None
        self._trials: dict[int, dict[str, Any]] = {}
        self._answers: Counter[str] = Counter()
        self._signs: dict[str, dict[int, None]] = {sign: {} for sign in ("hasty", "double", "caught", "missed")}
        self._durations: list[float] = []
        self._answered_at: float | None = None
        self._held = "waiting"
        self._unmasked = ""

    def take(self, event: dict[str, Any], *, replayed: bool = False) -> bool:
        """Process an event, recorded or not, and return whether the display changes.

        Parameters
        ----------
        event : dict
            Event with its name under ``event``, and its line number under ``n`` if recorded.
        replayed : bool
            Whether it is replayed from an earlier sitting.
        """
        name = str(event["event"])
        self._react(name, event)
        trouble = event.get("what", name)
        if trouble in TROUBLES:
            self._facts["generator"]["last_error"] = _words(trouble, event)
        elif name in _QUIET and not event.get("device"):
            return False
        self._facts |= {"event": name, "line": event.get("n"), "replayed": replayed}
        return True

    def _react(self, name: str, event: dict[str, Any]) -> None:
        facts = self._facts
        match name:
            case "start":
                self._on_start(event)
            case "resume":
                self._on_resume(event)
            case "fired":
                self._on_fired(event)
            case "answered":
                self._on_answered(event)
            case "trial":
                self._on_trial(event)
            case "masking":
                self._unmasked = self._unmasked if event["state"] == "off" else ""
            case "masking_lost":
                self._unmasked = f"the beam is not masked: {event['reason']}"
            case "trial_next":
                facts |= {"state": "waiting", "trial": event["trial"], "nothing_to_repeat": False}
            case "question_next":
                keys = event["keys"]
                keys = typed_keys(keys, None if event["rates"] else tuple(keys))
                facts["question"] = self._further = {"open": True, "keys": keys}
            case "discarded" if event.get("device"):
                facts["too_early"] = str(event["key"])
            case "form":
                self._ask(on=False)
            case "trial_cut":
                self._cut()
            case "withdrawn":
                for index in [index for index, trial in self._trials.items() if trial["n"] in event["lines"]]:
                    self._discount(index)
            case "pause" | "focus_lost":
                further = self._further
                self._cut()
                self._further = further  # asked again after the pause
                # A pause during a break returns to the break.
                self._held = "break" if facts["state"] == "break" else "waiting"
                usual = "participant" if name == "pause" else "lost focus"
                facts |= {"state": "paused", "paused_by": str(event.get("by", usual))}
                self._answered_at = None
            case "continued":
                facts |= {"state": self._held, "paused_by": "", "question": self._further or facts["question"]}
            case "rest":
                facts["state"], self._answered_at = "break", None
            case "experimenter":
                facts["n_notes"] += event["asks"] == "note"
            case "wishes":
                names = ("ends_after_block", "repeats_trial", "repeats_practice", "nothing_to_repeat")
                facts |= {each: event[each] for each in names}
            case "stop":
                self._cut()
                facts |= {"state": "ended", "stopped_by": event["reason"]}

    def answer_by(self, key: str) -> str | None:
        """Return the answer currently given by a key of the console, if any."""
        question = self._facts["question"]
        keys = question["keys"].items() if question is not None and question["open"] else ()
        return next((answer for answer, named in keys if key in named), None)

    def facts(self) -> SessionState:
        """Return the state of the session."""
        left = max(self._total - len(self._trials), 0)
        # Use the median of the last 20 trials once three have been timed.
        pace = statistics.median(self._durations[-20:]) if len(self._durations) >= 3 else self._guess
        return {
            **self._facts,
            "generator": dict(self._facts["generator"]),
            "n_answered": len(self._trials),
            "n_trials": self._total,
            "answers": dict(+self._answers),
            "elapsed_s": round(time.perf_counter() - self._began, 1),
            "time_left_s": round(left * pace, 1),
            "warnings": list(filter(None, (self._unmasked, *self._describe_signs()))),
        }

    def _describe_signs(self) -> Iterator[str]:
        """Yield a warning for each kind of suspect answers: how many, and the last of them."""
        for sign, words in (
            ("hasty", f"answered within {HASTY * 1e3:.0f} ms of the question, last in trial"),
            ("missed", f"of {len(self._signs['caught'])} catch trials answered as if something was felt, last trial"),
            ("double", "two answers at once, last in trial"),
        ):
            if which := self._signs[sign]:
                times = "once" if len(which) == 1 else f"{len(which)} times"
                yield f"{len(which) if sign == 'missed' else times} {words} {next(reversed(which))}"

    def _on_start(self, event: dict[str, Any]) -> None:
        facts = self._facts
        facts |= {name: event.get(name, facts[name]) for name in ("participant", "session", "mode", "protocol")}
        self._total = event["schedule"]["n_trials"]
        answers = event.get("design", {}).get("answers", {})
        offered = AnswerList.of(answers)
        self._nothing = next((answer.name for answer in offered if answer.means_nothing_felt), None)
        if "experimenter" in (answers.get("given_by"), *answers.get("ways", {}).values()):
            section = AnswersSection.model_validate(answers) if answers.get("scale") else None
            keys = answers["keys"] if section is None else section.actions
            self._keys = typed_keys(keys, offered.names if section is None else None)
            facts["question"] = {"open": False, "keys": self._keys}
        self._on_resume(event)

    def _on_resume(self, event: dict[str, Any]) -> None:
        self._facts["generator"]["identity"] = event["rig"]["identity"]
        self._facts |= {"state": "waiting", "paused_by": "", "stopped_by": ""}
        self._answered_at = None
        self._ask(on=False)

    def _ask(self, *, on: bool) -> None:
        """Enable or disable answers at the console."""
        self._facts["too_early"], self._further = "", None
        if self._facts["question"] is not None:
            self._facts["question"] = {"keys": self._keys, "open": on}

    def _on_fired(self, event: dict[str, Any]) -> None:
        firing = event["confirmed"]
        self._facts["state"] = "trial"
        if (trial := self._facts["trial"]) is not None and "interval" in event:  # no trial is announced in a replay
            self._facts["trial"] = {**trial, "plays": event["interval"]}
        self._ask(on=(trial or {}).get("way") == "experimenter")
        self._facts["generator"] |= {
            "outputs": "on",
            "amplitude_Vpp": list(firing["commanded_amplitude"]),
            # A stimulus is not yet confirmed at its beginning, which is a fault only if a reason is given.
            "confirmed": firing["confirmed"] or (False if firing.get("reason") else None),
        }

    def _on_trial(self, event: dict[str, Any]) -> None:
        self._ask(on=False)
        firing, index = event["confirmed"], event["trial"]["index"]
        self._facts["generator"] |= {"outputs": "off", "confirmed": firing["confirmed"]}
        if firing.get("stalled"):
            trouble = f"trial {index}: the computer was held up, and the stimulus is repeated"
            self._facts["generator"]["last_error"] = trouble
        # Since log format 2, the answer is already known from the line `answered`.
        if event.get("answered") is None:
            self._on_answered(event)
        if firing["confirmed"] and not event["trial"]["practice"]:
            self._count(index, event)

    def _count(self, index: int, event: dict[str, Any]) -> None:
        """Count a trial with all its answers, in place of an earlier presentation."""
        self._discount(index)
        self._trials[index] = event
        answer = str(event["response"]["answer"])
        self._answers[answer] += 1
        caught = self._nothing is not None and event["trial"]["condition"]["velocity_mm_s"] == 0
        found = is_hasty(event), event["response"].get("double"), caught, caught and answer != self._nothing
        for which, holds in zip(self._signs.values(), found, strict=True):
            if holds:
                which[index] = None

    def _discount(self, index: int) -> None:
        if (event := self._trials.pop(index, None)) is not None:
            self._answers[str(event["response"]["answer"])] -= 1
            for which in self._signs.values():
                which.pop(index, None)

    def _on_answered(self, event: dict[str, Any]) -> None:
        self._ask(on=False)
        value = event["response"].get("value")
        self._facts["last"] = {
            "line": event.get("n"),
            "number": event["trial"]["index"],
            "practice": event["trial"]["practice"],
            "answer": event["response"]["answer"] + (f" {value:.10g}" if value is not None else ""),
            "reaction_time_s": round(event["response"]["reaction_time"], 3),
            "counted_from": event["response"].get("onset", ""),
        }
        self._facts["state"] = "waiting"
        if self._answered_at is not None and event["clock"] - self._answered_at < _LONGEST:
            self._durations.append(event["clock"] - self._answered_at)
        self._answered_at = event["clock"]

    def _cut(self) -> None:
        """Show that the outputs are off, and disable answers."""
        self._facts["generator"]["outputs"] = "off"
        self._ask(on=False)


def _words(name: str, event: dict[str, Any]) -> str:
    """Return the text for a fault of the rig."""
    errors = event.get("errors")
    details = (
        ", ".join(map(str, errors)) if errors else event.get("reason") or event.get("confirmed", {}).get("reason", "")
    )
    return f"{name.replace('_', ' ')}: {details}" if details else name.replace("_", " ")
