"""Levels of adaptive runs, computed from the record alone, so that a resumed run continues as if uninterrupted.

References
----------
Levitt, "Transformed up-down methods in psychoacoustics", J. Acoust. Soc. Am. 49 (1971) 467-477.
Kaernbach, "Simple adaptive testing with the weighted up-down method", Perception & Psychophysics 49 (1991) 227-229.
Watson, "QUEST+: a general multidimensional Bayesian adaptive psychometric method", Journal of Vision 17(3) (2017) 10.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.protocol.adaptive import StaircaseSection
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.trial import TIME_OUT, Condition, Trial

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
            blank = Quest(self._bounds, to_dB(adaptive.start_mm_s), adaptive.guess_rate, adaptive.lapse_rate)
            fingers, contacts = protocol.conditions.finger_conditions, protocol.conditions.contacts
            self._quests |= {
                (finger_condition, *zones[::order], name): copy.copy(blank)
                for finger_condition, zones, name, order in product(fingers, contacts, protocol.stimulus_names, (1, -1))
            }

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
            level = self._quests[run].next_level(before)
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
