"""Keys of adaptive runs and of sensation levels, both of which depend on a participant's answers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field

from modaltouch.protocol.answers import AnswerList
from modaltouch.protocol.reading import Reading
from modaltouch.protocol.section import Count, FileName, Positive, Section, Word, described
from modaltouch.protocol.source import Problem

Decibels = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=40)]
GuessRate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=0.6)]
LapseRate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=0.2)]


class StaircaseSection(Section):
    """Weighted, transformed up-down staircase: down after a number of consecutive successes, up after each failure."""

    down_after: Annotated[Count, Field(le=6)] = described(
        "Number of successes in a row that lowers the level; each failure raises it.", default=1
    )
    steps_dB: tuple[Decibels, ...] = described(  # noqa: N815
        "Sizes of the steps down: the next size after each reversal, the last one for the rest of the run [dB, 20 per "
        "decade].",
        default=(8.0, 4.0, 2.0),
        min_length=1,
        max_length=20,
    )
    up_over_down: Annotated[float, Field(strict=True, gt=0, le=10)] = described(
        "Size of a step up relative to a step down.", default=1.0
    )

    @property
    def target(self) -> float:
        """Probability of success to which the staircase converges [1].

        At this p the expected steps down and up balance: p^n / (1 - p^n) = up / down (Kaernbach, Perception &
        Psychophysics 49 (1991) 227-229, for n = 1; Levitt, J. Acoust. Soc. Am. 49 (1971) 467-477, for equal steps).
        """
        return float((self.up_over_down / (1 + self.up_over_down)) ** (1 / self.down_after))


class AdaptiveSection(Section):
    """An adaptive run of the level for each finger condition, pair of zones and stimulus, instead of fixed levels."""

    method: Literal["staircase", "quest_plus"] = described(
        "staircase: up and down according to the latest answers; quest_plus: the level expected to be most "
        "informative.",
        default="quest_plus",
    )
    trials: Annotated[int, Field(strict=True, ge=8, le=1000)] = described(
        "Trials in each run; there is one run for each finger condition, pair and stimulus.", default=40
    )
    start_mm_s: Positive = described("Level of the first trial of each run [mm/s].")
    success: Literal["focus_named", "felt", "correct"] | Word = described(
        "Which answers count as success: focus_named, only the finger on the focus; felt, any but none; correct, the "
        "right one if a trial has several intervals; or the name of one answer, such as stronger.",
        default="focus_named",
    )
    guess_rate: GuessRate = described(
        "Share of successes where nothing is felt [1]; fitted instead if there are catch trials.", default=0.0
    )
    lapse_rate: LapseRate = described(
        "Share of failures where everything is felt: the value that quest_plus assumes, and the largest that a fit may "
        "find [1].",
        default=0.06,
    )
    staircase: StaircaseSection = described("Rule of the staircase.", default=StaircaseSection())

    @property
    def algorithm(self) -> dict[str, Any]:
        """Algorithm that sets the levels, as written to the record."""
        if self.method == "staircase":
            return {"algorithm": "modaltouch staircase 2", "target": round(self.staircase.target, 4)}
        from importlib.metadata import version

        return {"algorithm": "modaltouch quest_plus 2", "questplus": version("questplus")}


Multiple = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1000)]


class SensationLevelsSection(Section):
    """Levels as multiples of the participant's threshold: sensation levels, as ratios rather than in dB."""

    thresholds_from: FileName = described(
        "Name of the adaptive protocol whose latest complete session gives the participant's threshold: the geometric "
        "mean over its runs."
    )
    multiples: tuple[Multiple, ...] = described(
        "Levels as multiples of that threshold [1].",
        min_length=1,
        max_length=100,
        json_schema_extra={"uniqueItems": True},
    )

    def levels(self, threshold_mm_s: float) -> tuple[float, ...]:
        """Return the levels of a participant [mm/s], to four digits, the resolution of the generator's amplitude."""
        return tuple(float(f"{multiple * threshold_mm_s:.4g}") for multiple in self.multiples)

    def thresholds(self, lowest_mm_s: float, highest_mm_s: float) -> tuple[float, float]:
        """Return the lowest and highest thresholds for which all levels lie within bounds [mm/s]."""
        return lowest_mm_s / min(self.multiples), highest_mm_s / max(self.multiples)


_SECTION = ("conditions", "sensation_levels")


def check_sensation_levels(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield a problem for each inconsistency between ``sensation_levels`` and the other sections."""
    if reading.keys(*_SECTION) is None:
        return
    if is_adaptive(reading):
        yield reading.problem(
            _SECTION,
            "levels calibrated by participant, but runs are adaptive and find their own",
            "one of the two",
            "remove this section or the section adaptive",
        )
        return
    if reading.sound(*_SECTION, "thresholds_from") == (name := reading.sound("protocol")) and name is not None:
        path, given = (*_SECTION, "thresholds_from"), f"'{name}', this protocol itself"
        yield reading.problem(path, given, "the name of an adaptive protocol", "give the one that finds thresholds")
    multiples = dict(reading.items(*_SECTION, "multiples"))
    yield from _check_doubles(reading, multiples)
    faults = list(check_bounds(reading, "they are calibrated by participant", "anyone may get"))
    yield from faults
    levels = [level for _, level in reading.items("conditions", "peak_velocities_mm_s")]
    if faults or len(levels) != 2 or not multiples:
        return
    if max(multiples.values()) / min(multiples.values()) > levels[1] / levels[0]:
        yield reading.problem(
            (*_SECTION, "multiples"),
            f"{min(multiples.values()):g} to {max(multiples.values()):g}, a wider range than that of the levels",
            f"a ratio of at most {levels[1] / levels[0]:.4g}, that of conditions.peak_velocities_mm_s",
            "bring them closer together, or allow lower or higher levels",
        )


def _check_doubles(reading: Reading[Any], multiples: dict[int, float]) -> Iterator[Problem]:
    """Yield multiples too close for the four-digit resolution of the generator's amplitude."""
    seen: dict[int, float] = {}
    for index, value in multiples.items():
        like = next((at for at, other in seen.items() if math.isclose(value, other, rel_tol=2e-3)), None)
        if like is not None:
            yield reading.problem(
                (*_SECTION, "multiples", index),
                f"{value:g}, almost the same as multiples[{like}]",
                "multiples at least 0.2 % apart",
                "remove one of them",
            )
        seen[index] = value


def check_adaptive(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield a problem for each inconsistency between ``adaptive`` and the other sections, as far as they are valid."""
    if not is_adaptive(reading):
        return
    yield from _check_levels(reading)
    repetitions, order = reading.sound("schedule", "repetitions"), reading.sound("schedule", "order")
    yield from reading.faults(
        (
            repetitions not in (None, 1),
            ("schedule", "repetitions"),
            f"{repetitions}, but runs are adaptive",
            "1",
            "remove it; adaptive.trials sets the length of a run",
        ),
        (
            order in ("by_velocity", "latin_square"),
            ("schedule", "order"),
            f"{order}, but the levels are not known beforehand",
            "shuffled or by_pair",
            "shuffle the runs together, or present one after the other",
        ),
    )
    yield from _check_success(reading)


def is_adaptive(reading: Reading[Any]) -> bool:
    """Test whether a protocol has a section ``adaptive``, valid or not."""
    return reading.keys("adaptive") is not None


def check_bounds(reading: Reading[Any], when: str, reached: str) -> Iterator[Problem]:
    """Yield a problem if the peak velocities are not the lowest and the highest level, in this order."""
    path = ("conditions", "peak_velocities_mm_s")
    levels = [level for _, level in reading.items(*path)]
    given = reading.length(*path)
    if given is not None and given != 2:
        words = f"{given} levels, but {when}"
        yield reading.problem(path, words, f"two: the lowest and the highest that {reached}", "give these two")
    elif len(levels) == 2 and not levels[0] < levels[1]:
        words = f"[{levels[0]:g}, {levels[1]:g}], but {when}"
        yield reading.problem(path, words, "the lowest level first, then a higher one", "write the lowest first")


def _check_levels(reading: Reading[Any]) -> Iterator[Problem]:
    yield from check_bounds(reading, "runs are adaptive", "a run may reach")
    levels = [level for _, level in reading.items("conditions", "peak_velocities_mm_s")]
    start = reading.sound("adaptive", "start_mm_s")
    if start is not None and len(levels) == 2 and levels[0] < levels[1] and not levels[0] <= start <= levels[1]:
        yield reading.problem(
            ("adaptive", "start_mm_s"),
            f"{start:g} mm/s",
            f"{levels[0]:g} to {levels[1]:g} mm/s, the levels of conditions.peak_velocities_mm_s",
            "start within this range",
        )


def _check_success(reading: Reading[Any]) -> Iterator[Problem]:
    success = reading.sound("adaptive", "success") or "focus_named"
    focus = reading.sound("stimulus", "focus")
    # Several stimuli are checked one by one; their shared section need not be a stimulus itself.
    if success == "focus_named" and focus is not None and not reading.sound("stimuli"):
        for path, zones in contacts(reading):
            if focus not in zones:
                yield reading.problem(
                    path,
                    f"[{', '.join(zones)}] without the focus, but success is naming the focus",
                    f"a pair with {focus}",
                    "remove it, or count `felt` as success",
                )
    offered, at = offered_answers(reading), ("adaptive", "success")
    several = reading.keys("intervals") is not None
    if success == "correct":
        yield from _check_correct(reading, offered)
    elif success not in ("focus_named", "felt", *offered.names):
        yield reading.unknown(
            at, "a rule or an answer", dict.fromkeys(["focus_named", "felt", "correct", *offered.names])
        )
    yield from reading.faults(
        (
            success == "felt" and "felt" not in offered.names and offered.naming() is None,
            at,
            "felt, but no answer says that nothing was felt",
            "correct" if several else "focus_named, or keys for `none`",
            "count `correct` as success" if several else "give the keys",
        ),
        (
            success == "focus_named" and not offered.compares,
            at,
            "focus_named, but the answers do not name each finger alone",
            "keys for `left` and `right`, or other answers for these fingers under answers.fingers",
            "add them, or count `felt` or one of the answers as success",
        ),
    )


def _check_correct(reading: Reading[Any], offered: AnswerList) -> Iterator[Problem]:
    """Yield a problem if success cannot be `correct`: no answer names an interval, or the guess rate does not fit."""
    intervals = [answer.interval for answer in offered if answer.interval is not None]
    if reading.keys("intervals") is None or not intervals:
        yield reading.problem(
            ("adaptive", "success"),
            "correct, but no answer refers to intervals",
            "a section intervals, and answers.intervals",
            "add them, or choose another success",
        )
        return
    guess_rate, rule = (reading.sound("adaptive", name) for name in ("guess_rate", "staircase"))
    chance = 1 / len(intervals)
    if guess_rate is not None and isinstance(intervals[0], int) and abs(guess_rate - chance) > 0.01:
        yield reading.problem(
            ("adaptive", "guess_rate"),
            f"{guess_rate:g}, but one of {len(intervals)} intervals is named",
            f"{chance:.4g}",
            f"write `guess_rate: {chance:.4g}`",
        )
    elif rule is not None and reading.sound("adaptive", "method") == "staircase" and rule.target <= (guess_rate or 0):
        yield reading.problem(
            ("adaptive", "staircase"),
            f"a staircase that converges to {rule.target:.4g}, the rate of guessing",
            f"a target above {guess_rate:g}",
            "write `down_after: 2` or more",
        )


def contacts(reading: Reading[Any]) -> list[tuple[tuple[str, str, int], tuple[str, ...]]]:
    """Return the zones under the fingers with their paths, from the key that lists them."""
    keys = ("zones", "zone_pairs")
    return [(("conditions", key, index), zones) for key in keys for index, zones in reading.items("conditions", key)]


def offered_answers(reading: Reading[Any]) -> AnswerList:
    """Return the answers that a protocol offers, from its valid parts."""
    fingers, below = dict(reading.items("answers", "fingers")), [name for _, name in reading.items("answers", "below")]
    keys, scale = reading.keys("answers", "keys") or (), bool(reading.keys("answers", "scale"))
    section = {"keys": keys, "fingers": fingers, "below": below, "scale": scale}
    return AnswerList.of(section | {"intervals": dict(reading.items("answers", "intervals"))})
