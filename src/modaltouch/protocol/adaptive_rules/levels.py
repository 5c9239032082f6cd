"""The level of a trial in an adaptive run, from the record alone: killed and resumed, it is the very same."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import product
from typing import Any

from modaltouch.protocol.adaptive import AdaptiveSection
from modaltouch.protocol.adaptive_rules.quest import Quest
from modaltouch.protocol.adaptive_rules.staircase import follow, is_success
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.trial import Condition, Trial

Run = tuple[str, str, str, str]
"""A finger condition, the zones under the left and the right finger, and a stimulus."""


@dataclass(frozen=True)
class AnsweredLevel:
    """One answered trial of a run.

    Attributes
    ----------
    index : int
        Place of the trial in the session.
    velocity_mm_s : float
        Its level [mm/s].
    success : bool
        Whether the answer counts as success.
    """

    index: int
    velocity_mm_s: float
    success: bool


class Levels:
    """Tells the level of each trial of an adaptive protocol; trials of other protocols stay as they are.

    Parameters
    ----------
    protocol : Protocol
        The protocol.
    """

    def __init__(self, protocol: Protocol) -> None:
        self._protocol = protocol
        self._quests: dict[Run, Quest] = {}
        if protocol.adaptive is not None and protocol.adaptive.method == "quest_plus":
            # Built now rather than at the first trial, which it would keep waiting.
            blank = self._new_quest(protocol.adaptive)
            fingers, pairs = protocol.conditions.finger_conditions, protocol.conditions.zone_pairs
            for finger_condition, (left, right), name in product(fingers, pairs, protocol.stimulus_names):
                for run in ((finger_condition, left, right, name), (finger_condition, right, left, name)):
                    self._quests[run] = blank.another()

    def settle(self, trial: Trial, answered: Iterable[Mapping[str, Any]]) -> Trial:
        """Return a scheduled trial with the level that it is presented at.

        Parameters
        ----------
        trial : Trial
            As scheduled; practice and catch trials are left as they are.
        answered : iterable of mapping
            The record's trial events that count (`Session.trials`), in any order; only those before this trial in
            the session and of its run are looked at.
        """
        adaptive = self._protocol.adaptive
        if adaptive is None or trial.practice or trial.condition.is_catch:
            return trial
        before = [each for each in self.history(run_of(trial.condition), answered) if each.index < trial.index]
        level = self._next_dB(adaptive, run_of(trial.condition), before)
        velocity = from_dB(level, self._range)
        return replace(trial, condition=replace(trial.condition, velocity_mm_s=velocity))

    def history(self, run: Run, answered: Iterable[Mapping[str, Any]]) -> list[AnsweredLevel]:
        """Return the trials of a run that the instrument confirmed, in the order of the session.

        Parameters
        ----------
        run : tuple of str
            Which run.
        answered : iterable of mapping
            The record's trial events that count.
        """
        found = []
        for event in answered:
            condition = Condition(**event["trial"]["condition"])
            counts = event["confirmed"]["confirmed"] and not event["trial"]["practice"] and not condition.is_catch
            if counts and run_of(condition) == run:
                focus, answer = self._protocol.stimulus_of(condition.stimulus).focus, event["response"]["answer"]
                success = is_success(self._rule, focus, condition.zone_left, answer)
                found.append(AnsweredLevel(event["trial"]["index"], condition.velocity_mm_s, success))
        return sorted(found, key=lambda each: each.index)

    @property
    def _rule(self) -> str:
        return self._protocol.adaptive.success if self._protocol.adaptive is not None else ""

    @property
    def _range(self) -> tuple[float, float]:
        levels = self._protocol.conditions.peak_velocities_mm_s
        return min(levels), max(levels)

    @property
    def _bounds_dB(self) -> tuple[float, float]:  # noqa: N802
        low, high = self._range
        return to_dB(low), to_dB(high)

    def _next_dB(self, adaptive: AdaptiveSection, run: Run, before: Sequence[AnsweredLevel]) -> float:  # noqa: N802
        if adaptive.method == "staircase":
            start = to_dB(adaptive.start_mm_s)
            return follow(adaptive.staircase, start, self._bounds_dB, [each.success for each in before]).next_dB
        return self._quests[run].next_level([(to_dB(each.velocity_mm_s), each.success) for each in before])

    def _new_quest(self, adaptive: AdaptiveSection) -> Quest:
        return Quest(self._bounds_dB, to_dB(adaptive.start_mm_s), adaptive.guess_rate, adaptive.lapse_rate)


def run_of(condition: Condition) -> Run:
    """Return which run a condition belongs to."""
    return (condition.finger_condition, *condition.pair, condition.stimulus)


def to_dB(velocity_mm_s: float) -> float:  # noqa: N802
    """Return a level in decibels re 1 mm/s."""
    return 20 * math.log10(velocity_mm_s)


def from_dB(level: float, bounds: tuple[float, float]) -> float:  # noqa: N802
    """Return a level [mm/s] within its bounds, to four digits, as many as the generator's amplitude has."""
    velocity = 10 ** (level / 20)
    return min(max(float(f"{velocity:.4g}"), bounds[0]), bounds[1])


def describe_rule(protocol: Protocol) -> dict[str, Any] | None:
    """Return what decides the levels, for the record; None for a protocol of fixed levels."""
    adaptive = protocol.adaptive
    if adaptive is None:
        return None
    if adaptive.method == "staircase":
        return {"algorithm": "modaltouch staircase 1", "target": round(adaptive.staircase.target, 4)}
    return {"algorithm": "modaltouch quest_plus 1", "questplus": version("questplus")}
