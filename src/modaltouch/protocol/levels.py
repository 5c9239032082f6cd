"""Levels that depend on a participant's answers: checks of their keys, and the levels of adaptive runs.

These are computed from the record alone, so that a resumed run continues as if uninterrupted.

References
----------
Levitt, "Transformed up-down methods in psychoacoustics", J. Acoust. Soc. Am. 49 (1971) 467-477.
Kaernbach, "Simple adaptive testing with the weighted up-down method", Perception & Psychophysics 49 (1991) 227-229.
Watson, "QUEST+: a general multidimensional Bayesian adaptive psychometric method", Journal of Vision 17(3) (2017) 10.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol.conditions import StaircaseSection, contacts, is_adaptive, offered_answers
from modaltouch.protocol.reading import Reading
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.source import Problem
from modaltouch.protocol.trial import TIME_OUT, AnswerList, Condition, Trial

_SECTION = ("conditions", "sensation_levels")


def check_own_levels(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield a problem for each inconsistency of ``adaptive`` or ``sensation_levels`` with the other sections."""
    if is_adaptive(reading):
        yield from _check_adaptive(reading)
    if reading.keys(*_SECTION) is not None:
        yield from _check_sensation_levels(reading)


def _check_sensation_levels(reading: Reading[Any]) -> Iterator[Problem]:
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
    faults = list(_check_bounds(reading, "they are calibrated by participant", "anyone may get"))
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


def _check_adaptive(reading: Reading[Any]) -> Iterator[Problem]:
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


def _check_bounds(reading: Reading[Any], when: str, reached: str) -> Iterator[Problem]:
    """Yield a problem if the peak velocities are not the lowest and the highest level, in this order."""
    path = ("conditions", "peak_velocities_mm_s")
    levels = [level for _, level in reading.items(*path)]
    given = reading.length(*path)
    if given is not None and given != 2:
        words = f"{given} level{'s' * (given > 1)}, but {when}"
        yield reading.problem(path, words, f"two: the lowest and the highest that {reached}", "give these two")
    elif len(levels) == 2 and not levels[0] < levels[1]:
        words = f"[{levels[0]:g}, {levels[1]:g}], but {when}"
        yield reading.problem(path, words, "the lowest level first, then a higher one", "write the lowest first")


def _check_levels(reading: Reading[Any]) -> Iterator[Problem]:
    yield from _check_bounds(reading, "runs are adaptive", "a run may reach")
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
    places, named = {*(reading.sound("intervals", "comparison_in") or (1, 2))}, offered.named(success).interval
    if success == "correct":
        yield from _check_correct(reading, offered)
    elif success not in ("focus_named", "felt", *offered.names):
        yield reading.unknown(
            at, "a rule or an answer", dict.fromkeys(["focus_named", "felt", "correct", *offered.names])
        )
    yield from reading.faults(
        (
            several and isinstance(named, int) and places != {named},
            at,
            f"{success}, but the comparison is not always in that interval",
            "correct",
            "count `correct` as success, or give the comparison one place with intervals.comparison_in",
        ),
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


FloatArray = NDArray[np.float64]

Run = tuple[str, ...]
"""A finger condition, the zones under the fingers from left to right, and a stimulus."""


class Levels:
    """Calculator of the levels of adaptive trials; trials of other protocols are unchanged.

    Parameters
    ----------
    protocol : Protocol
        The protocol.
    """

    def __init__(self, protocol: Protocol) -> None:
        self._protocol = protocol
        velocities, adaptive = protocol.conditions.peak_velocities_mm_s, protocol.adaptive
        self._range = min(velocities), max(velocities)
        self._bounds = to_dB(self._range[0]), to_dB(self._range[1])
        self._quests: dict[Run, Quest] = {}
        if adaptive is not None and adaptive.method == "quest_plus":
            # Built in advance, so that the first trial is not delayed.
            self._blank = Quest(self._bounds, to_dB(adaptive.start_mm_s), adaptive.guess_rate, adaptive.lapse_rate)

    def settle(self, trial: Trial, answered: Iterable[Mapping[str, Any]], algorithm: str = "") -> Trial:
        """Return a scheduled trial with its actual level.

        Parameters
        ----------
        trial : Trial
            The scheduled trial; practice and catch trials are returned unchanged.
        answered : iterable of mapping
            Trial events of the record that count (`Session.trials`), in any order; only earlier trials of the same run
            are used.
        algorithm : str
            The recorded algorithm; version 1 of each treated a time-out as "felt".
        """
        adaptive = self._protocol.adaptive
        if adaptive is None or trial.practice or trial.condition.is_catch:
            return trial
        run = run_of(trial.condition)
        timed_out = TIME_OUT if not algorithm.endswith(" 1") else ""
        before = self._history(run, trial.index, adaptive.success, answered, timed_out)
        if adaptive.method == "staircase":
            start, successes = to_dB(adaptive.start_mm_s), [success for _, success in before]
            level = follow(adaptive.staircase, start, self._bounds, successes)
        else:
            level = self._quests.setdefault(run, copy.copy(self._blank)).next_level(before)
        return replace(trial, condition=replace(trial.condition, velocity_mm_s=from_dB(level, self._range)))

    def _history(
        self, run: Run, until: int, rule: str, answered: Iterable[Mapping[str, Any]], timed_out: str
    ) -> list[tuple[float, bool]]:
        """Return level [dB] and success of the confirmed trials of a run before index `until`, in order."""
        found: list[tuple[int, float, bool]] = []
        offered = self._protocol.answers.offered
        for event in answered:
            condition, index = Condition(**event["trial"]["condition"]), event["trial"]["index"]
            counts = event["confirmed"]["confirmed"] and not event["trial"]["practice"] and not condition.is_catch
            if counts and index < until and run_of(condition) == run:
                focus, answer = self._protocol.stimulus_of(condition.stimulus).focus, event["response"]["answer"]
                success = offered.is_success(answer, rule, focus, condition.zone_left)
                success = bool(event.get("correct")) if rule == "correct" else success
                found.append((index, to_dB(condition.velocity_mm_s), success and answer != timed_out))
        return [(level, success) for _, level, success in sorted(found, key=lambda each: each[0])]


def run_of(condition: Condition) -> Run:
    """Return the run of a condition."""
    return (condition.finger_condition, *condition.zones, condition.stimulus)


def to_dB(velocity_mm_s: float) -> float:  # noqa: N802
    """Return a level in decibels re 1 mm/s."""
    return 20 * math.log10(velocity_mm_s)


def from_dB(level: float, bounds: tuple[float, float]) -> float:  # noqa: N802
    """Return a level [mm/s] within its bounds, to four digits, the resolution of the generator's amplitude."""
    return min(max(float(f"{10 ** (level / 20):.4g}"), bounds[0]), bounds[1])


def follow(rule: StaircaseSection, start: float, bounds: tuple[float, float], successes: Sequence[bool]) -> float:
    """Return the next level of a staircase after a series of answers [dB], clipped to its bounds.

    At each reversal the next step size is used for the step that reverses.
    """
    level, in_a_row, heading, n_reversals = start, 0, 0, 0
    for success in successes:
        in_a_row = in_a_row + 1 if success else 0
        if success and in_a_row < rule.down_after:
            continue
        in_a_row, direction = 0, -1 if success else 1
        n_reversals += heading == -direction
        heading = direction
        step = rule.steps_dB[min(n_reversals, len(rule.steps_dB) - 1)]
        level += direction * step * (rule.up_over_down if direction > 0 else 1.0)
        level = min(max(level, bounds[0]), bounds[1])
    return level


STEP = 2.0
"""Spacing of the possible levels [dB]."""

MARGIN = 12.0
"""Range of possible thresholds beyond the lowest and highest level [dB]."""

SPREADS = (1.0, 2.0, 4.0, 8.0, 12.0)
"""Possible standard deviations of the psychometric function [dB]."""

_PARAMETERS = (0, 1, 2, 3)
"""Axes of the likelihoods for the parameters of the psychometric function; those for answers and levels follow."""


class Quest:
    """A QUEST+ run, with likelihoods from the package questplus, a dependency of PsychoPy.

    Parameters
    ----------
    bounds : (float, float)
        Lowest and highest level [dB].
    start : float
        Level of the first trial [dB].
    guess_rate, lapse_rate : float
        Lower asymptote of the psychometric function and upper bound of the lapse rate [1].
    """

    def __init__(self, bounds: tuple[float, float], start: float, guess_rate: float, lapse_rate: float) -> None:
        # Slow to import.
        from questplus import QuestPlus

        low, high = bounds
        self._start = start
        levels = np.linspace(low, high, 1 + max(1, round((high - low) / STEP)))
        quest: Any = QuestPlus(
            stim_domain={"intensity": np.unique(np.append(levels, start))},
            param_domain={
                "mean": np.arange(low - MARGIN, high + MARGIN + STEP / 2, STEP / 2),
                "sd": np.array(SPREADS),
                "lower_asymptote": np.array([guess_rate]),
                "lapse_rate": np.unique([0.0, lapse_rate / 2, lapse_rate]),
            },
            outcome_domain={"response": ["yes", "no"]},
            func="norm_cdf",
            stim_scale="linear",
        )
        self._levels: FloatArray = quest.stim_domain["intensity"]
        self._prior: FloatArray = quest.prior.values
        # Plain arrays, since the labelled ones of questplus take eight times as long at each answer.
        self._likelihood: FloatArray = quest.likelihoods.transpose(*quest.prior.dims, "response", "intensity").values
        self._posterior, self._taken = self._prior, list[tuple[float, bool]]()

    def next_level(self, history: Sequence[tuple[float, bool]]) -> float:
        """Return the level of the next trial [dB]."""
        if list(history[: len(self._taken)]) != self._taken:
            self._posterior, self._taken = self._prior, []
        for level, success in history[len(self._taken) :]:
            # The record rounds the presented level to four digits.
            nearest = np.abs(self._levels - level).argmin()
            posterior = self._posterior * self._likelihood[..., 0 if success else 1, nearest]
            self._posterior = posterior / posterior.sum()
        self._taken = list(history)
        return self._most_informative() if self._taken else self._start

    def _most_informative(self) -> float:
        """Return the level with the least expected posterior entropy: Watson (2017), equations (8) to (10)."""
        joint = self._posterior[..., None, None] * self._likelihood
        chance = joint.sum(axis=_PARAMETERS)
        after = joint / chance
        with np.errstate(divide="ignore", invalid="ignore"):  # impossible outcomes contribute 0
            entropy = -np.nansum(after * np.log(after), axis=_PARAMETERS)
        return float(self._levels[(chance * entropy).sum(axis=0).argmin()])
