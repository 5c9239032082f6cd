"""Check of each line of a session against earlier lines, the order drawn from the seed, and its trial.

Level, amplitudes and speeds of a trial must follow from its position in the order, and its bursts and instants must be
consistent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime

from modaltouch import preflight, protocol
from modaltouch.protocol import Schedule, Trial
from modaltouch.record.expectation import (
    MALFORMED,
    SPEED,
    Event,
    Expectation,
    check_amplitudes,
    check_answered,
    check_bursts,
    check_delivered,
    check_form,
    check_instants,
    check_intervals,
)
from modaltouch.record.session import Session

Key = tuple[bool, int]
"""Whether a trial is a practice trial, and its index."""
_MOST = 20
"""Maximum number of faults listed individually."""
_SAME = ("trial", "presentation", "fingers", "planned", "commanded", "response", "correct", "supersedes")
"""Members common to the line of an answer and that of its finished trial."""


class EventSequence:
    """Check of the lines of a session in sequence."""

    def __init__(self, session: Session, given: Expectation, schedule: Schedule) -> None:
        self.problems: list[str] = []
        self._n_finished = self._n_probed = 0
        self._session, self._given, self._expected = session, given, given
        self._schema = session.start.get("schema", 1)
        self._order: dict[Key, Trial] = {(t.practice, t.index): t for t in (*schedule.practice, *schedule.trials)}
        self._keys = [*self._order]
        self._n_practice, self._n_trials = len(schedule.practice), len(schedule.trials)
        recovered = [n for n, e in enumerate(session.events, 1) if e["event"] == "recovered" and e.get("missing")]
        # Lines lost before a recovery leave gaps, so checks that depend on earlier lines begin after it.
        self._whole_from = max(recovered, default=0)
        self._counted: dict[int, Event] = {}
        self._done: Counter[Key] = Counter()
        self._n_fired: Counter[tuple[bool, int, float]] = Counter()
        self._pending: Trial | None = None
        self._begun: list[Event] = []
        self._last_line: dict[tuple[bool, int, float], int] = {}
        self._trial, self._next = next(iter(self._order.values())), 0
        self._unfinished: dict[int, Event] = {}
        self._settled: tuple[Trial, Trial] | None = None
        self._passed, self._filled = False, set[str]()
        self._boot, self._clock, self._before = "", float("-inf"), ""

    def walk(self) -> None:
        """Check all lines, and collect the faults in `problems`."""
        ways = {
            "fired": self._fired,
            "answered": self._answered,
            "trial": self._answered,
            "unconfirmed": self._named,
            "trial_cut": self._named,
            "withdrawn": self._withdrawn,
            "practice_round": self._judged,
            "form": lambda _, event: check_form(event, self._given.protocol, self._filled),
            "probe": self._probed,
            "stop": self._stopped,
        }
        for number, event in enumerate(self._session.events, 1):
            try:
                faults = [*self._stamped(number, event)]
                faults += ways[event["event"]](number, event) if event["event"] in ways else []
            except MALFORMED as error:
                faults = [f"the event `{event['event']}` does not say what it must ({type(error).__name__}: {error})"]
            self._before = event["event"]
            self.problems += [f"{self._session.path}:{number}: {fault}" for fault in faults]
        if (beyond := len(self.problems) - _MOST) > 1:
            self.problems[_MOST:] = [f"{self._session.path}: {beyond} more such faults"]

    @property
    def lines(self) -> list[str]:
        """Sentences on the checks that passed; empty if there is any fault."""
        if self.problems:
            return []
        lines = [f"{self._n_finished} answers, each in its place, with its level and amplitudes"]
        if self._schema > 1:
            lines[0] += ", and with matching bursts and instants"
        if self._n_probed:
            lines.append(f"drives for the fingers of {self._n_probed} placements recomputed: identical codes")
        if self._given.protocol.adaptive is not None:
            lines.append("levels follow from the answers before them")
        return lines

    def _stamped(self, number: int, event: Event) -> Iterator[str]:
        """Yield faults in number, time and clock of a line."""
        if event["n"] != number:
            yield f"is numbered {event['n']}"
        if datetime.fromisoformat(event["time"]).tzinfo is None:
            yield f"its time {event['time']} names no zone"
        kind, clock = event["event"], float(event["clock"])
        # These events may follow a restart of the machine that is not recorded.
        unknown = kind in ("closed", "recovered") or "torn" in event or (self._before == "stop" and kind != "resume")
        boot = str(event.get("boot", "")) if kind in ("start", "resume") else "" if unknown else self._boot
        if boot == self._boot and boot and not clock >= self._clock:
            yield f"its clock says {clock} s, but the line before says {self._clock} s"
        self._boot, self._clock = boot, clock

    def _named(self, number: int, event: Event) -> Iterator[str]:
        """Check that a line refers to a trial of the order at its level, and make it the current trial."""
        trial = self._trial = Trial.from_dict(event["trial"])
        planned = self._order.get((trial.practice, trial.index))
        if planned is None:
            yield (
                f"{_name(trial)} is not one of the {self._n_trials} trials of its order, or of the {self._n_practice} "
                "of practice"
            )
            return
        is_adaptive = self._given.protocol.adaptive is not None
        if is_adaptive and number > self._whole_from:
            planned = self._settle(planned)
        elif is_adaptive and not planned.condition.is_catch:
            # The level followed from answers of which some are lost.
            level = trial.condition.velocity_mm_s
            planned = replace(planned, condition=replace(planned.condition, velocity_mm_s=level))
        if trial == planned:
            return
        there, here = ({**t.as_dict(), **t.as_dict()["condition"]} for t in (planned, trial))
        differing = next((name for name in here if name != "condition" and here[name] != there.get(name)), "interval")
        source = "the answers before it lead to" if is_adaptive and differing == "velocity_mm_s" else "its order has"
        yield f"{_name(trial)} has the {differing} {here[differing]}, but {source} {there.get(differing)}"

    def _settle(self, planned: Trial) -> Trial:
        """Return a trial of an adaptive run at the level that follows from the earlier answers that count."""
        if self._settled is None or self._settled[0] != planned:
            algorithm = self._session.start["adaptive"]["algorithm"]
            self._settled = planned, self._given.levels.settle(planned, self._counted.values(), algorithm)
        return self._settled[1]

    def _fired(self, number: int, event: Event) -> Iterator[str]:
        yield from self._named(number, event)
        trial, due = self._trial, self._due()
        if number > self._whole_from and (trial.practice, trial.index) != due:
            yield f"{_name(trial)} was presented out of order; {_name(self._order[due]) if due else 'none'} was due"
        interval = event.get("interval", 1)
        self._pending, self._begun = trial, [*(self._begun if interval > 1 else ()), event]
        self._n_fired[_key(trial)] += interval == 1
        for fault in check_amplitudes(event, self._given.protocol.presented(trial)[interval - 1], self._given):
            yield f"{_name(trial)}: {fault}"

    def _probed(self, number: int, event: Event) -> Iterator[str]:
        """Check the design for the measured fingers, and expect it in all lines until the next placement."""
        if event["hands"] == "off":
            return
        fitted = preflight.with_measured(self._expected.preflight, Trial.from_dict(event["trial"]), event)
        self._given, self._n_probed = Expectation(fitted), self._n_probed + 1
        for recorded in event["levels"]:
            inputs, stimulus = fitted.designs[recorded["design"]].sound
            level = 1e3 * float(stimulus.velocity_at_focus([inputs.centre_mm * 1e-3], inputs.reference * 1e-3)[0])
            highest = fitted.designs[recorded["design"]].attainable
            if recorded["content_hash"] != stimulus.burst.content_hash:
                yield f"the drive for the fingers that were measured ({recorded['design']}) is not the one recorded"
            if abs(recorded["level_mm_s"] - level) > SPEED or abs(recorded["attainable_mm_s"] - highest) > SPEED:
                yield (
                    f"under the fingers that were measured ({recorded['design']}) the level is {level:.6g} mm/s, at "
                    f"most {highest:.6g} mm/s, but the record says {recorded['level_mm_s']:.6g} and "
                    f"{recorded['attainable_mm_s']:.6g} mm/s"
                )

    def _due(self) -> Key | None:
        """Return the next trial: the first remaining one of practice, then of the main trials."""
        keys = self._keys
        while self._next < len(keys) and (self._done[keys[self._next]] or (keys[self._next][0] and self._passed)):
            self._next += 1
        return keys[self._next] if self._next < len(keys) else None

    def _answered(self, number: int, event: Event) -> Iterator[str]:
        yield from self._named(number, event)
        trial, schema = self._trial, self._schema
        faults = [*check_amplitudes(event, trial, self._given), *check_answered(event, trial, self._given)]
        if schema > 1:
            faults += check_instants(event, trial)
        if number > self._whole_from and (event["event"] == "answered" or schema == 1):
            faults += self._follows(event, trial)
            self._pending = None
        if number > self._whole_from:
            faults += check_intervals(event, trial, self._begun, self._given)
        if event["event"] == "answered":
            self._counted[number] = self._unfinished[number] = event
            faults += ["is confirmed before its end"] if event["confirmed"]["confirmed"] else []
        else:
            self._n_finished += 1
            faults += check_bursts(event, trial, self._given) if schema > 1 else []
            faults += check_delivered(event, trial, self._given)
            faults += self._finishes(event) if schema > 1 and number > self._whole_from else []
            self._counted[number] = event
            self._done[trial.practice, trial.index] += bool(event["confirmed"]["confirmed"])
            self._last_line[_key(trial)] = number
        if event.get("supersedes"):
            self._take_back(event["supersedes"])
        for fault in faults:
            yield f"{_name(trial)}: {fault}"

    def _follows(self, event: Event, trial: Trial) -> Iterator[str]:
        """Check that an answer follows its stimulus and refers to the answer it supersedes."""
        if self._pending != trial:
            yield "was answered but not presented"
        n_fired = self._n_fired[_key(trial)]
        if event["presentation"] != n_fired:
            yield f"is called presentation {event['presentation']}, but its stimulus began {n_fired} times"
        # It may also refer to an answer whose stimulus was not confirmed at its end.
        unfinished = [n for n, each in self._unfinished.items() if each["trial"] == event["trial"]]
        before = self._last_line.get(_key(trial))
        if event["supersedes"] not in (before, *unfinished):
            yield f"replaces the answer on line {event['supersedes']}, but its last answer is on line {before}"

    def _finishes(self, event: Event) -> Iterator[str]:
        """Check that a finished trial repeats its answer, and that the answer was not finished before."""
        answer = self._unfinished.pop(event["answered"], None)
        self._counted.pop(event["answered"], None)
        if answer is None:
            yield f"finishes the answer on line {event['answered']}, which is not waiting for its end"
            return
        first = {name: value for name, value in event["response"].items() if name != "further"}
        differing = [name for name in _SAME if answer.get(name) != {**event, "response": first}.get(name)]
        differing += ["answer"] if answer["instants"]["answer"] != event["instants"]["answer"] else []
        differing += ["interval"] if answer.get("intervals", [])[:-1] != event.get("intervals", [])[:-1] else []
        if differing:
            yield f"differs from line {event['answered']}, where it was answered, in {differing[0]}"

    def _take_back(self, line: int) -> None:
        gone = self._counted.pop(line, None)
        if gone is not None:
            trial = gone["trial"]
            self._done[trial["practice"], trial["index"]] -= bool(gone["confirmed"]["confirmed"])
            self._next = 0

    def _withdrawn(self, number: int, event: Event) -> Iterator[str]:
        for line in event["lines"]:
            if number > self._whole_from and line not in self._counted:
                yield f"withdraws line {line}, which is not an answer that counts"
            self._take_back(line)
        self._settled = None

    def _judged(self, number: int, event: Event) -> Iterator[str]:
        """Check the verdict on a round of practice."""
        self._passed = self._passed or bool(event["passed"])
        given = self._given.protocol
        section = given.schedule
        outcome = protocol.judge_round(self._counted.values(), event["round"], section.practice_trials, given)
        found = outcome.n_judged, outcome.n_agreed, outcome.passes(section.practice_criterion)
        if number > self._whole_from and found != (event["n_judged"], event["n_agreed"], event["passed"]):
            yield (
                f"in practice round {event['round']}, {found[1]} of {found[0]} answers agreed, but the record says "
                "otherwise"
            )

    def _stopped(self, number: int, event: Event) -> Iterator[str]:
        """Check the number of answered trials stated at the end of a sitting."""
        n_done = sum(n > 0 for (practice, _), n in self._done.items() if not practice)
        is_complete = n_done >= self._n_trials and self._filled >= self._given.protocol.form.keys()
        if number > self._whole_from and (event["n_answered"], event["complete"]) != (n_done, is_complete):
            yield (
                f"says that {event['n_answered']} trials are answered, but {n_done} are"
                if event["n_answered"] != n_done
                else f"says complete: {str(event['complete']).lower()}, which does not follow from trials and form"
            )


def _key(trial: Trial) -> tuple[bool, int, float]:
    """Return the key of a trial, including its level for adaptive runs."""
    return trial.practice, trial.index, trial.condition.velocity_mm_s


def _name(trial: Trial) -> str:
    return f"practice trial {trial.index}" if trial.practice else f"trial {trial.index}"
