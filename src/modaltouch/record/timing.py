"""Checks the bursts and instants of a line of the log against each other and the protocol."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from modaltouch.protocol import Trial
from modaltouch.record.restored import TrialExpectation

Event = dict[str, Any]

INSTANT = 5e-6
"""Tolerance of sums of instants, which are written to the microsecond [s]."""
_LATE = 0.2
"""Tolerance in counts of due bursts [periods]; a burst later than a twentieth of a period is dropped."""
_IN_ORDER = ("trigger", "first_burst", "question", "answer")
_COUNTS = ("asked", "played", "whole", "dropped")


def check_instants(event: Event, trial: Trial) -> Iterator[str]:
    """Yield contradictions between the instants of an answer, and with its reaction time."""
    instants, response, confirmed = event["instants"], event["response"], event["confirmed"]
    between = {name: (span["earliest_s"], span["latest_s"]) for name, span in instants.items() if span is not None}
    for name, (earliest, latest) in between.items():
        if not earliest <= latest:
            yield f"its {name.replace('_', ' ')} came between {earliest} and {latest} s"
    if not between["answer"][0] <= event["clock"] + INSTANT:
        yield f"its answer came at {between['answer'][0]} s, after its line was written at {event['clock']} s"
    known = [name for name in _IN_ORDER if name in between]
    for place, name in enumerate(known):
        late = next((each for each in known[place + 1 :] if between[each][1] < between[name][0] - INSTANT), None)
        if late is not None:
            yield f"its {late.replace('_', ' ')} came before its {name.replace('_', ' ')}"
    if trial.condition.is_catch and "first_burst" in between:
        yield "is a catch trial with a first burst"
    if response["answer"] == "time_out":
        return
    onset, around = confirmed["onset"], confirmed["onset_uncertainty"]
    answered = between["answer"]
    first = between.get("first_burst", (onset - around, onset + around))
    asked = response["onset"] == "question"
    begun = between.get("question", first) if asked else first
    least, most = answered[0] - begun[1], answered[1] - begun[0]
    # Without a screen the instant of the question is unknown, except that it came after the first burst.
    least = 0.0 if asked and "question" not in between else least
    time = response["reaction_time"]
    if not least - INSTANT <= time <= most + INSTANT:
        yield f"has a reaction time of {time:.6g} s, but its instants give {least:.6g} to {most:.6g} s"


def check_bursts(event: Event, trial: Trial, given: TrialExpectation) -> Iterator[str]:
    """Yield contradictions between the counts of a finished stimulus, and with the protocol and its instants."""
    bursts, confirmed = event["bursts"], event["confirmed"]
    asked, played, whole, dropped = counts = [bursts[name] for name in _COUNTS]
    first, around = bursts["first_s"], bursts["uncertainty_s"]
    if any(each is not None and (type(each) is not int or each < 0) for each in counts):
        yield f"its burst counts are not whole numbers from 0: {counts}"
        return
    repeats = given.restored.preflight.experiment.apparatus.generator.repeats
    if confirmed["repetition"] != repeats:
        yield f"its bursts were repeated as {confirmed['repetition']!r}, but its apparatus file says {repeats!r}"
    if confirmed["confirmed"] and confirmed["repetition"] == "single":
        if None in counts or (first is None) is not trial.condition.is_catch:
            yield "is confirmed, although its bursts are not all counted"
            return
        if whole != played or played + dropped != asked:
            yield f"is confirmed with {asked} bursts due, {played} played, {whole} whole and {dropped} dropped"
        yield from _check_number(event, trial, given)
    if not _rises(whole, played, asked) or not _rises(dropped, asked):
        yield f"has {asked} bursts due, {played} played, {whole} whole and {dropped} dropped"
    if first is None:
        return
    said = event["instants"]["first_burst"]
    ends = None if said is None else (said["earliest_s"], said["latest_s"])
    if ends is None or not _near(ends[0], first - around) or not _near(ends[1], first + around):
        yield f"its first burst came at {first} s +- {around} s, but its instants say {listed(ends or ('never',))}"
    if abs(confirmed["onset"] - first) > around + INSTANT:
        yield f"its first burst came at {first} s, but its onset is {confirmed['onset']} s"


def _check_number(event: Event, trial: Trial, given: TrialExpectation) -> Iterator[str]:
    """Yield faults if a confirmed stimulus of single bursts has not the number that follows from protocol and time."""
    asked, rate = event["bursts"]["asked"], given.protocol.stimulus_of(trial.condition.stimulus).repetition_rate_Hz
    if trial.condition.is_catch:
        if asked:
            yield f"is a catch trial with {asked} bursts due"
        return
    most = given.protocol.n_bursts(trial.condition.stimulus)
    if given.protocol.answers.stimulus_until == "question":
        if (asked, event["bursts"]["dropped"]) != (most, 0):
            yield f"is confirmed with {asked} of {most} bursts due and {event['bursts']['dropped']} dropped"
        return
    first, around = event["bursts"]["first_s"], event["bursts"]["uncertainty_s"]
    due = (event["instants"]["answer"]["earliest_s"] - first - around) * rate + 1
    possible = (event["clock"] - first + around) * rate + 1
    if not (min(due - 1 - _LATE, most) <= asked <= most and event["bursts"]["played"] <= possible + _LATE):
        yield (
            f"its record says {asked} bursts due, but at {rate:g} Hz {max(due, 1):.0f} were due by its answer and "
            f"{possible:.0f} by its end, at most {most}"
        )


def _rises(*counts: int | None) -> bool:
    """Return whether counts do not decrease, ignoring unknown ones."""
    known = [count for count in counts if count is not None]
    return known == sorted(known)


def _near(one: float, other: float) -> bool:
    return abs(one - other) <= INSTANT


def listed(values: tuple[Any, ...]) -> str:
    """Return values as a list in words, numbers to six digits."""
    return ", ".join(f"{each:.6g}" if isinstance(each, float) else str(each) for each in values)
