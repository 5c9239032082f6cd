"""Multi-interval trials: checks of their keys, and assignment of the comparison; loaded only if a design has them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from modaltouch.protocol.reading import Reading
from modaltouch.protocol.source import Problem
from modaltouch.protocol.stimulus_sections import STANDARD_LEVEL, IntervalsSection, Meaning
from modaltouch.protocol.streams import Stream
from modaltouch.protocol.trial import Condition


def draw_intervals(section: IntervalsSection, conditions: Sequence[Condition], stream: Stream) -> list[int]:
    """Draw the interval of the comparison in each trial, balanced within each condition and over all trials."""
    of_condition: dict[Condition, list[int]] = {}
    for place, condition in enumerate(conditions):
        of_condition.setdefault(condition, []).append(place)
    drawn, turns, n_dealt = [0] * len(conditions), stream.shuffled(section.places), 0
    # Intervals are dealt in turn, so that their counts differ by at most one within each condition and over all trials.
    for places in stream.shuffled(of_condition.values()):
        dealt = [turns[(n_dealt + number) % len(turns)] for number in range(len(places))]
        n_dealt += len(places)
        for place, interval in zip(places, stream.shuffled(dealt), strict=True):
            drawn[place] = interval
    return drawn


def check_intervals(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield a problem for each inconsistency between ``intervals`` and the other sections, as far as they are valid."""
    path, meanings = ("intervals",), reading.items("answers", "intervals")
    if meanings and reading.keys(*path) is None and not reading.has_unknown_key():
        yield reading.problem(
            ("answers", "intervals"),
            "meanings of answers, but a trial has a single stimulus",
            "a section intervals",
            "write it, or remove this",
        )
    if reading.keys(*path) is None or (reading.value is not None and reading.value.intervals is None):
        return  # one of several stimuli, but not that of the standard
    standard = reading.sound(*path, "standard")
    names = reading.keys("stimuli") or []
    if standard is not None and standard.stimulus is not None and standard.stimulus not in names:
        at, given = (*path, "standard", "stimulus"), f"{standard.stimulus!r}, but there is no section stimuli"
        problem = reading.unknown(at, "one of the stimuli", names)
        yield problem if names else reading.problem(at, given, "null", "remove it, or write the section")
    until, n_catch = reading.sound("answers", "stimulus_until"), reading.sound("schedule", "catch_trials")
    level = reading.sound(*STANDARD_LEVEL) or 0.0
    yield from reading.faults(
        (
            level and reading.keys("conditions", "sensation_levels") is not None,
            STANDARD_LEVEL,
            f"{level:g} mm/s, where levels are multiples of each participant's own threshold",
            "null or 0",
            "make the standard another stimulus or silence, or remove conditions.sensation_levels",
        ),
        (
            standard is not None and standard.velocity_mm_s is None and standard.stimulus is None,
            (*path, "standard"),
            "neither a level nor a stimulus",
            "velocity_mm_s, stimulus or both",
            "write `velocity_mm_s: 100`, or 0 for silence",
        ),
        (
            until not in (None, "question"),
            ("answers", "stimulus_until"),
            f"{until}, but a trial has several intervals",
            "question",
            "write `stimulus_until: question`, and give its length as presentation_s or presentation_bursts",
        ),
        (
            n_catch,
            ("schedule", "catch_trials"),
            f"{n_catch}, but a trial has several intervals",
            "0",
            "remove it; for silent intervals, write `intervals.standard.velocity_mm_s: 0`",
        ),
    )
    yield from _check_numbers(reading)
    yield from _check_asked(reading)


def _check_numbers(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield intervals that do not exist or are listed twice."""
    number = reading.sound("intervals", "number")
    for path in (("intervals", "comparison_in"), ("answers", "intervals")):
        seen: list[Meaning] = []
        for step, meaning in reading.items(*path):
            if isinstance(meaning, int) and number is not None and meaning > number:
                yield reading.problem(
                    (*path, step),
                    f"{meaning}, but a trial has {number} intervals",
                    f"1 to {number}",
                    "correct it, or raise intervals.number",
                )
            elif meaning in seen:
                yield reading.problem((*path, step), f"{meaning} again", "each once", "remove one of them")
            seen.append(meaning)


def _check_asked(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield a problem for answers to two questions, intervals without an answer, or an ambiguous question on levels."""
    levels = [level for _, level in reading.items("conditions", "peak_velocities_mm_s")]
    standard, number = reading.sound(*STANDARD_LEVEL), reading.sound("intervals", "number")
    meanings = reading.items("answers", "intervals")
    named = any(isinstance(meaning, int) for _, meaning in meanings)
    for step, meaning in meanings:
        if meaning == "different" and named:
            yield reading.problem(
                ("answers", "intervals", step),
                "different together with the number of an interval",
                "only numbers, or same and different",
                "ask one of these questions",
            )
    alone = {meaning for _, meaning in meanings} & {"same", "different"}
    if len(alone) == 1 and not named:
        yield reading.problem(
            ("answers", "intervals"),
            f"{alone.pop()} alone, so that the other answer is never right",
            "same and different",
            "give both answers a meaning",
        )
    places = reading.sound("intervals", "comparison_in") or range(1, 1 + (number or 0))
    is_sound = all(meaning in ("same", "different") or meaning <= (number or meaning) for _, meaning in meanings)
    if named and is_sound and (unnamed := [place for place in places if place not in dict(meanings).values()]):
        yield reading.problem(
            ("answers", "intervals"),
            f"no answer for interval {unnamed[0]}, which may hold the comparison",
            "an answer for each such interval",
            "add it, or leave the interval out of intervals.comparison_in",
        )
    written = reading.find(("intervals", "asked")) is not None
    if number == 2 and named and not written and standard and levels and min(levels) < standard < max(levels):
        yield reading.problem(
            ("intervals", "asked"),
            f"nothing, but levels lie both below and above the standard of {standard:g} mm/s",
            "comparison, stronger",
            "write `asked: stronger` if the question is which one was stronger, otherwise `asked: comparison`",
        )
