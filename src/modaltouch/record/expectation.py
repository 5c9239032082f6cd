"""Expected values of a session, restored from the texts in its start record, and checks of single lines."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property, lru_cache
from typing import Any

from modaltouch import preflight, protocol
from modaltouch.protocol import TIME_OUT, AnswersSection, Findings, Protocol, Sources, Trial
from modaltouch.rig import RigError, instrument_of

Event = dict[str, Any]

INSTANT = 5e-6
"""Tolerance of sums of instants, which are recorded to 1 us [s]."""
_LATE = 0.2
"""Tolerance in counts of due bursts [periods]; a burst more than 1/20 of a period late is dropped."""
SPEED = 2e-3
"""Tolerance of speeds, which are recorded to 0.001 mm/s [mm/s]."""

MALFORMED = (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError, RigError)
"""Errors raised by evaluating a line with missing or wrong members."""


class Expectation:
    """An experiment, as its start record describes it, from which the values of each line follow.

    Parameters
    ----------
    checked : Preflight
        Preflight without problems, at the participant's own levels if any.
    """

    def __init__(self, checked: preflight.Preflight) -> None:
        self.preflight = checked
        self.protocol, self.apparatus = checked.experiment.protocol, checked.experiment.apparatus
        self.instrument = instrument_of(self.apparatus)
        self.limits = self.instrument.limits(self.apparatus)
        self.agreed: set[tuple[str, float, tuple[float, ...], tuple[float, ...]]] = set()
        """Combinations of stimulus, level, commanded and read-back amplitudes that are known to agree."""

    @cached_property
    def levels(self) -> protocol.Levels:
        """Levels of adaptive runs."""
        return protocol.Levels(self.protocol)

    @cached_property
    def fields(self) -> list[dict[str, Any]]:
        """The predicted field of each stimulus at its highest level."""
        return self.preflight.fields


@lru_cache(maxsize=4)
def restore(sources: Sources, occasion: tuple[str, str]) -> Expectation:
    """Return the experiment of a start record; the latest few are cached, since a study shares one.

    Raises
    ------
    InputError
        With all faults in the texts.
    """
    return Expectation(preflight.examine_findings(Findings.restored(sources, occasion)).require())


def check_answers(event: Event, asked: AnswersSection) -> Iterator[str]:
    """Yield faults in the answers of a line; further questions require a confirmed stimulus."""
    response = event["response"]
    yield from _check_response(response, asked)
    is_asked = event["confirmed"]["confirmed"] and response["answer"] != TIME_OUT
    wanted = asked.further if event["event"] == "trial" and is_asked else {}
    further = response.get("further", {})
    if list(further) != list(wanted):
        yield f"answers the further questions {', '.join(further) or '-'}, but {', '.join(wanted) or '-'} were asked"
        return
    for name, how in wanted.items():
        yield from (f"{name}: {fault}" for fault in _check_response(further[name], how))


def check_form(event: Event, protocol: Protocol, done: set[str]) -> Iterator[str]:
    """Yield faults in an answer to the closing form."""
    name, asked = event["name"], protocol.closing
    if name not in asked or name in done:
        yield f"the form {'has no question' if name not in asked else 'already has an answer to'} {name!r}"
        return
    done.add(name)
    yield from (f"{name} of the form: {fault}" for fault in _check_response(event["response"], asked[name]))


def _check_response(response: Event, asked: AnswersSection) -> Iterator[str]:
    if not asked.takes(response["answer"], response.get("value")):
        value = f" {response['value']}" if "value" in response else ""
        yield f"was answered {response['answer']!r}{value}; allowed: {asked.allowed}, {TIME_OUT}"
    if not 0 <= response["reaction_time"] < math.inf:
        yield f"has a reaction time of {response['reaction_time']} s"


def check_amplitudes(event: Event, trial: Trial, given: Expectation) -> Iterator[str]:
    """Yield faults in the commanded and read-back amplitudes, given the trial's level."""
    silent, confirmed = trial.condition.is_catch, event["confirmed"]
    # A catch trial takes the same steps as a trial at the lowest level.
    level = min(given.protocol.conditions.peak_velocities_mm_s) if silent else trial.condition.velocity_mm_s
    level = given.preflight.played(trial.condition, level)
    sent, back = tuple(confirmed["commanded_amplitude"]), tuple(confirmed["confirmed_amplitude"])
    stated = (sent, tuple(event["commanded"]["amplitude_Vpp"])) if "commanded" in event else (sent,)
    found = given.preflight.design_of(trial.condition), level, sent, back
    if found in given.agreed and stated[-1] == sent:
        return
    needed = given.limits.amplitudes(given.preflight.designs[found[0]].stimulus.burst, level * 1e-3)
    for amplitude in stated:
        if amplitude != needed:
            yield f"{level:g} mm/s needs {listed(needed)} Vpp, but {listed(amplitude)} Vpp were commanded"
            return
    instrument, pairs = given.instrument, zip(needed, back, strict=False)
    agree = len(back) == len(needed) and all(instrument.level(1, a).confirmed_by(str(b)) for a, b in pairs)
    if (confirmed["confirmed"] or event["event"] == "fired") and not agree:
        yield f"{level:g} mm/s needs {listed(needed)} Vpp, but {listed(back)} Vpp were read back"
    if agree:
        given.agreed.add(found)


def check_answered(event: Event, trial: Trial, given: Expectation) -> Iterator[str]:
    """Yield inconsistencies between an answer and its trial: level, predicted speeds, fingers, answers."""
    condition, response = trial.condition, event["response"]
    yield from _check_planned(event["planned"], trial, given)
    fingers = given.protocol.conditions.fingers_of(condition)
    if tuple(event["fingers"]) != fingers:
        yield f"was felt with {listed(fingers)}, but the record says {listed(tuple(event['fingers']))}"
    if event.get("catch", False) is not condition.is_catch:
        yield f"at {condition.velocity_mm_s:g} mm/s it is {'' if condition.is_catch else 'not '}a catch trial"
    yield from check_answers(event, given.protocol.answers)
    if event.get("correct") is not (correct := given.protocol.is_correct(trial, response["answer"])):
        words = {True: "right", False: "wrong", None: "neither"}
        stated, found = words[event.get("correct")], words[correct]
        yield f"was answered {response['answer']!r}, which is {found}; the record says {stated}"


def _check_planned(planned: dict[str, Any], trial: Trial, given: Expectation) -> Iterator[str]:
    """Yield faults in the level and predicted speeds of a stimulus, given its condition."""
    condition = trial.condition
    level, recorded = condition.velocity_mm_s, tuple(planned[f"speed_{side}_mm_s"] for side in condition.sides)
    if planned["velocity_mm_s"] != level:
        yield f"was planned at {planned['velocity_mm_s']:g} mm/s and presented at {level:g} mm/s"
    found = tuple(speed * 1e3 for speed in given.preflight.speeds(trial))
    if not all(abs(a - b) <= SPEED for a, b in zip(recorded, found, strict=True)):
        yield f"{level:g} mm/s gives {listed(found)} mm/s at the fingers, not {listed(recorded)}"


def check_delivered(event: Event, trial: Trial, given: Expectation) -> Iterator[str]:
    """Yield faults in the delivered speeds, given the fingers measured in the trial."""
    recorded = event.get("delivered", {"refused": ""})
    if "refused" in recorded:
        return
    speeds = preflight.delivered_figures(given.preflight, trial, recorded)
    found = {**speeds, "drifted": preflight.has_drifted(given.preflight, trial, recorded)}
    for name, value in found.items():
        if abs(recorded[name] - value) > SPEED:
            yield f"the fingers found in its burst give a delivered {name} of {value}, not {recorded[name]}"


def check_intervals(event: Event, trial: Trial, begun: list[Event], given: Expectation) -> Iterator[str]:
    """Yield faults in the intervals of an answer, given its trial and the intervals that began."""
    parts, recorded, section = given.protocol.presented(trial), event.get("intervals", []), given.protocol.intervals
    if section is None:
        return
    if len(recorded) != len(parts) or [each["interval"] for each in begun] != list(range(1, len(parts) + 1)):
        yield f"has {len(parts)} intervals; {len(begun)} began, but its line lists {len(recorded)}"
        return
    over, sound = -math.inf, True
    for number, (part, interval, first) in enumerate(zip(parts, recorded, begun, strict=True), 1):
        confirmed = interval["confirmed"]
        line = {**event, **interval, "instants": {**event["instants"], "first_burst": interval["first_burst"]}}
        faults = [*check_amplitudes(line, part, given), *_check_planned(interval["planned"], part, given)]
        if event["event"] == "trial" or number < len(parts):
            sound = sound and confirmed["confirmed"]
            faults += check_bursts(line, part, given)
        if any(confirmed[name] != first["confirmed"][name] for name in ("onset", "commanded_amplitude")):
            faults += ["is not the one that began"]
        own = (event, interval) if number == trial.interval else (interval, interval)
        if any(own[0][name] != own[1][name] for name in ("commanded", "bursts")):
            faults += ["is not that of its trial"]
        gap, unsure = confirmed["onset"] - over, (each["onset_uncertainty"] for each in (confirmed, first["confirmed"]))
        if gap + sum(unsure) + INSTANT < section.gap_s:
            faults += [f"began {gap:.6g} s after the one before, but its protocol has a gap of {section.gap_s:g} s"]
        over = confirmed["onset"] + given.protocol.longest_s(part.condition.stimulus)
        yield from (f"interval {number}: {fault}" for fault in faults)
    if not sound and (event["event"] == "answered" or event["confirmed"]["confirmed"]):
        yield "counts, although one of its intervals is not confirmed"


def check_instants(event: Event, trial: Trial) -> Iterator[str]:
    """Yield inconsistencies between the instants of an answer, and with its reaction time."""
    instants, response, confirmed = event["instants"], event["response"], event["confirmed"]
    known = (name for name in ("trigger", "first_burst", "question", "answer") if instants.get(name))
    between = {name: (instants[name]["earliest_s"], instants[name]["latest_s"]) for name in known}
    onset, around, answered = confirmed["onset"], confirmed["onset_uncertainty"], between["answer"]
    if not answered[0] <= event["clock"] + INSTANT:
        yield f"its answer came at {answered[0]} s, after its line was written at {event['clock']} s"
    for place, (name, (earliest, latest)) in enumerate(between.items()):
        if not earliest <= latest:
            yield f"its {name.replace('_', ' ')} came between {earliest} and {latest} s"
        for late in [*between][place + 1 :]:
            if between[late][1] < earliest - INSTANT:
                yield f"its {late.replace('_', ' ')} came before its {name.replace('_', ' ')}"
    if trial.condition.is_catch and "first_burst" in between:
        yield "is a catch trial with a first burst"
    if response["answer"] == TIME_OUT:
        return
    first = between.get("first_burst", (onset - around, onset + around))
    asked = response["onset"] == "question"
    begun = between.get("question", first) if asked else first
    # Without a screen, the question is only known to follow the first burst.
    least = 0.0 if asked and "question" not in between else answered[0] - begun[1]
    time, most = response["reaction_time"], answered[1] - begun[0]
    if not least - INSTANT <= time <= most + INSTANT:
        yield f"has a reaction time of {time:.6g} s, but its instants give {least:.6g} to {most:.6g} s"


def check_bursts(event: Event, trial: Trial, given: Expectation) -> Iterator[str]:
    """Yield inconsistencies between the burst counts of a finished stimulus, its protocol and its instants."""
    bursts, confirmed = event["bursts"], event["confirmed"]
    asked, played, whole, dropped = counts = [bursts[name] for name in ("asked", "played", "whole", "dropped")]
    first, around = bursts["first_s"], bursts["uncertainty_s"]
    repeats = given.apparatus.generator.repeats
    if confirmed["repetition"] != repeats:
        yield f"its bursts were repeated as {confirmed['repetition']!r}, but its apparatus file says {repeats!r}"
    if confirmed["confirmed"] and confirmed["repetition"] == "single":
        if not all(type(n) is int and n >= 0 for n in counts) or (first is None) is not trial.condition.is_catch:
            yield "is confirmed, although its bursts are not all counted"
            return
        if whole != played or played + dropped != asked:
            yield f"is confirmed with {asked} bursts due, {played} played, {whole} whole and {dropped} dropped"
        yield from _check_number(event, trial, given)
    if first is None:
        return
    span = event["instants"]["first_burst"] or {"earliest_s": math.nan, "latest_s": math.nan}
    ends = span["earliest_s"], span["latest_s"]
    agree = abs(ends[0] - first + around) <= INSTANT and abs(ends[1] - first - around) <= INSTANT
    if not agree or abs(confirmed["onset"] - first) > around + INSTANT:
        others = f"but its instants say {listed(ends)}, and its onset {confirmed['onset']} s"
        yield f"its first burst came at {first} s +- {around} s, {others}"


def _check_number(event: Event, trial: Trial, given: Expectation) -> Iterator[str]:
    """Yield faults in the number of bursts of a confirmed stimulus, given the protocol and its timing."""
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


def listed(values: tuple[Any, ...]) -> str:
    """Format values as a comma-separated list, numbers to six digits."""
    return ", ".join(f"{each:.6g}" if isinstance(each, float) else str(each) for each in values)
