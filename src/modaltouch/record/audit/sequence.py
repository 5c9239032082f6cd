"""The course of a session: each line against those before it and against the order that its seed draws."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from datetime import datetime

from modaltouch.protocol import Schedule, Trial, judge_round
from modaltouch.record.audit.experiment import UNTOLD
from modaltouch.record.audit.presentation import (
    Event,
    TrialExpectation,
    check_amplitudes,
    check_answered,
    check_bursts,
    check_instants,
)
from modaltouch.record.session import Session

Key = tuple[bool, int]
"""Whether a trial is practice, and its index."""

_MOST = 20
"""Faults that are told one by one."""

_SAME = ("trial", "presentation", "fingers", "planned", "commanded", "response", "supersedes")
"""What the line of an answer and that of its finished trial have alike."""


class EventSequence:
    """Goes through the lines of a session and keeps what does not hold.

    Parameters
    ----------
    session : Session
        As its log tells it.
    given : TrialExpectation
        What its trials are checked against.
    schedule : Schedule
        The order drawn again.
    """

    def __init__(self, session: Session, given: TrialExpectation, schedule: Schedule) -> None:
        self.problems: list[str] = []
        self._n_finished = self._n_settled = 0
        self._session, self._given = session, given
        self._order: dict[Key, Trial] = {(t.practice, t.index): t for t in (*schedule.practice, *schedule.trials)}
        self._n_practice, self._n_trials = len(schedule.practice), len(schedule.trials)
        recovered = [n for n, e in enumerate(session.events, 1) if e["event"] == "recovered" and e.get("missing")]
        # What was lost before it leaves gaps that nobody can check.
        self._whole_from = max(recovered, default=0)
        self._counted: dict[int, Event] = {}
        self._done: Counter[Key] = Counter()
        self._n_fired: Counter[tuple[bool, int, float]] = Counter()
        self._pending: Trial | None = None
        self._last_line: dict[tuple[bool, int, float], int] = {}
        self._trial, self._written, self._faulty = next(iter(self._order.values())), dict[str, object](), False
        self._next = 1
        self._unfinished: dict[int, Event] = {}
        self._settled: tuple[Trial, Trial] | None = None
        self._passed = False
        self._boot, self._clock, self._before = "", float("-inf"), ""

    def walk(self) -> None:
        """Check every line."""
        ways = {
            "fired": self._fired,
            "answered": self._answered,
            "trial": self._answered,
            "unconfirmed": self._named,
            "trial_cut": self._named,
            "withdrawn": self._withdrawn,
            "practice_round": self._judged,
            "stop": self._stopped,
        }
        for number, event in enumerate(self._session.events, 1):
            try:
                faults = [*self._stamped(number, event)]
                faults += ways[event["event"]](number, event) if event["event"] in ways else []
            except UNTOLD as error:
                faults = [f"the event `{event['event']}` does not say what it must ({type(error).__name__}: {error})"]
            self._before = event["event"]
            self.problems += [f"{self._session.path}:{number}: {fault}" for fault in faults]
        if (beyond := len(self.problems) - _MOST) > 1:
            self.problems[_MOST:] = [f"{self._session.path}: {beyond} more such faults"]

    @property
    def lines(self) -> list[str]:
        """What holds, in words; nothing of a session in which anything does not."""
        if self.problems:
            return []
        lines = [f"{self._n_finished} answers, each at its place, its level and its amplitudes"]
        if self._given.schema > 1:
            lines[0] += ", its bursts and its instants in accord"
        if self._given.protocol.adaptive is not None:
            lines.append(f"levels of {self._n_settled} trials follow from the answers before them")
        return lines

    def _stamped(self, number: int, event: Event) -> Iterator[str]:
        """Check number, time and clock of a line."""
        if event["n"] != number:
            yield f"is numbered {event['n']}"
        if datetime.fromisoformat(event["time"]).tzinfo is None:
            yield f"its time {event['time']} names no zone"
        kind, clock = event["event"], float(event["clock"])
        # These may have been written after a restart of the machine, and do not say so.
        unknown = kind in ("closed", "recovered") or "torn" in event or (self._before == "stop" and kind != "resume")
        boot = str(event.get("boot", "")) if kind in ("start", "resume") else "" if unknown else self._boot
        if boot == self._boot and boot and not clock >= self._clock:
            yield f"its clock says {clock} s, the line before {self._clock} s"
        self._boot, self._clock = boot, clock

    def _named(self, number: int, event: Event) -> Iterator[str]:
        """Check that a line speaks of a trial of the order, and at its level; this is then the one at hand."""
        if event["trial"] == self._written and not self._faulty:
            return
        trial = self._trial = Trial.from_dict(event["trial"])
        self._written, self._faulty = event["trial"], True
        key = trial.practice, trial.index
        planned = self._order.get(key)
        if planned is None:
            yield f"{_name(trial)} is none of the {self._n_trials} trials, {self._n_practice} of practice, of its order"
            return
        if self._given.protocol.adaptive is not None and number > self._whole_from:
            planned = self._settle(planned)
        self._faulty = trial != planned
        if not self._faulty:
            return
        there, here = ({**t.as_dict(), **t.as_dict()["condition"]} for t in (planned, trial))
        differing = next(name for name in here if name != "condition" and here[name] != there.get(name))
        if differing == "velocity_mm_s" and self._given.protocol.adaptive is not None:
            yield (
                f"the answers before {_name(trial)} lead to {there[differing]:g} mm/s, the record says "
                f"{here[differing]:g} mm/s"
            )
            return
        yield f"{_name(trial)} has the {differing} {here[differing]}, its order has {there.get(differing)}"

    def _settle(self, planned: Trial) -> Trial:
        """Return a trial of an adaptive run at the level to which the answers that count so far lead."""
        if self._settled is None or self._settled[0] != planned:
            self._settled = planned, self._given.restored.levels.settle(planned, self._counted.values())
        return self._settled[1]

    def _fired(self, number: int, event: Event) -> Iterator[str]:
        yield from self._named(number, event)
        trial, due = self._trial, self._due()
        if number > self._whole_from and (trial.practice, trial.index) != due:
            yield f"{_name(trial)} was presented out of its order; due was {_name(self._order[due]) if due else 'none'}"
        self._pending = trial
        self._n_fired[_key(trial)] += 1
        for fault in check_amplitudes(event, trial, self._given):
            yield f"{_name(trial)}: {fault}"

    def _due(self) -> Key | None:
        """Return which trial comes next: the first that is left of practice, then of those that count."""
        practice = next(((True, n) for n in range(1, self._n_practice + 1) if not self._done[True, n]), None)
        while self._done[False, self._next]:
            self._next += 1
        counting = (False, self._next) if self._next <= self._n_trials else None
        return counting if practice is None or self._passed else practice

    def _answered(self, number: int, event: Event) -> Iterator[str]:
        """Check the line of an answer, or of a trial that is finished."""
        yield from self._named(number, event)
        trial, schema = self._trial, self._given.schema
        faults = [*check_amplitudes(event, trial, self._given), *check_answered(event, trial, self._given)]
        if schema > 1:
            faults += check_instants(event, trial)
        is_answer = event["event"] == "answered" or schema == 1
        if number > self._whole_from and is_answer:
            faults += self._follows(event, trial)
            self._pending = None
        if event["event"] == "answered":
            self._counted[number] = self._unfinished[number] = event
            faults += ["is confirmed before its end"] if event["confirmed"]["confirmed"] else []
        else:
            self._n_finished += 1
            self._n_settled += not (trial.practice or trial.condition.is_catch)
            faults += check_bursts(event, trial, self._given) if schema > 1 else []
            faults += self._finishes(event) if schema > 1 and number > self._whole_from else []
            self._counted[number] = event
            self._done[trial.practice, trial.index] += bool(event["confirmed"]["confirmed"])
            self._last_line[_key(trial)] = number
        if event.get("supersedes"):
            self._take_back(event["supersedes"])
        for fault in faults:
            yield f"{_name(trial)}: {fault}"

    def _follows(self, event: Event, trial: Trial) -> Iterator[str]:
        """Check that an answer follows its stimulus, and names the answer that it replaces."""
        if self._pending != trial:
            yield "was answered without having been presented"
        n_fired = self._n_fired[_key(trial)]
        if event["presentation"] != n_fired:
            yield f"is called presentation {event['presentation']}, its stimulus began {n_fired} times"
        # An answer whose stimulus was never confirmed to have ended may be named as well.
        unfinished = [n for n, each in self._unfinished.items() if each["trial"] == event["trial"]]
        before = self._last_line.get(_key(trial))
        if event["supersedes"] not in (before, *unfinished):
            yield f"replaces the answer of line {event['supersedes']}, its last one is of line {before}"

    def _finishes(self, event: Event) -> Iterator[str]:
        """Check that a finished trial says what its answer said, and that no other does."""
        answer = self._unfinished.pop(event["answered"], None)
        self._counted.pop(event["answered"], None)
        if answer is None:
            yield f"finishes the answer of line {event['answered']}, which is none that waits for its end"
            return
        differing = [name for name in _SAME if answer.get(name) != event.get(name)]
        differing += ["answer"] if answer["instants"]["answer"] != event["instants"]["answer"] else []
        if differing:
            yield f"has another {differing[0]} than line {event['answered']}, where it was answered"

    def _take_back(self, line: int) -> None:
        """Count an answer no more."""
        gone = self._counted.pop(line, None)
        if gone is not None:
            trial = gone["trial"]
            self._done[trial["practice"], trial["index"]] -= bool(gone["confirmed"]["confirmed"])
            self._next = 1

    def _withdrawn(self, number: int, event: Event) -> Iterator[str]:
        for line in event["lines"]:
            if number > self._whole_from and line not in self._counted:
                yield f"withdraws line {line}, which is no answer that counts"
            self._take_back(line)
        self._settled, self._written = None, {}

    def _judged(self, number: int, event: Event) -> Iterator[str]:
        """Check a verdict on a round of practice."""
        self._passed = self._passed or bool(event["passed"])
        section = self._given.protocol.schedule
        outcome = judge_round(self._counted.values(), event["round"], section.practice_trials)
        found = outcome.n_judged, outcome.n_agreed, outcome.passes(section.practice_criterion)
        if number > self._whole_from and found != (event["n_judged"], event["n_agreed"], event["passed"]):
            yield f"in round {event['round']} of practice {found[1]} of {found[0]} answers agreed; it says otherwise"

    def _stopped(self, number: int, event: Event) -> Iterator[str]:
        """Check how many trials a sitting says it left behind."""
        n_done = sum(n > 0 for (practice, _), n in self._done.items() if not practice)
        if number > self._whole_from and (event["n_answered"], event["complete"]) != (n_done, n_done >= self._n_trials):
            yield f"says that {event['n_answered']} trials are answered, {n_done} are"


def _key(trial: Trial) -> tuple[bool, int, float]:
    """Return what tells a trial from others, and an adaptive one from the same at another level."""
    return trial.practice, trial.index, trial.condition.velocity_mm_s


def _name(trial: Trial) -> str:
    return f"practice trial {trial.index}" if trial.practice else f"trial {trial.index}"
