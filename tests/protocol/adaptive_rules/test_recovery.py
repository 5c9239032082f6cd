"""Recovery of thresholds: runs of the shipped adaptive protocol, answered by the observer that simulates it.

Measured over 200 participants for the staircase and 80 for QUEST+, with 40 trials and 5 catch trials each, all drawn
from `fingertip`: 85 % and 97 % of the runs give a threshold. It is 0.7 and 1.1 dB too high on average (median: 0.3 and
0.8 dB), since the observer's function is not a cumulative normal; the standard deviation is 2.1 and 2.9 dB; 92 % of the
95 % intervals contain the true value with either method.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr

from modaltouch.analysis.psychometric import fit_psychometric
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant
from modaltouch.preflight import examine
from modaltouch.protocol.conditions import AdaptiveSection
from modaltouch.protocol.levels import Quest, follow, from_dB, to_dB
from modaltouch.protocol.trial import AnswerList, Condition, Trial

PROTOCOL = Path(__file__).parents[3] / "protocols" / "threshold.yaml"
BOUNDS = (2.0, 200.0)


@dataclass(frozen=True)
class Recovery:
    """Results of the runs of many participants; levels and errors in dB."""

    share_told: float
    bias: float
    coverage: float
    share_ended_inside: float


@pytest.fixture(scope="module")
def speeds() -> tuple[float, float]:
    """Speeds at A and C at a level of 1, as predicted by the check of the shipped protocol."""
    left, right = examine(PROTOCOL).require().speeds(Trial(1, 1, Condition("one_hand", "A", "C", 100.0)))
    return left / 0.1, right / 0.1


@pytest.fixture(scope="module")
def section() -> AdaptiveSection:
    """The rule of the shipped protocol."""
    found = examine(PROTOCOL).require().experiment.protocol.adaptive
    assert found is not None
    return found


def chance_of_c(person: Participant, speeds: tuple[float, float], level: float) -> float:
    """Return the probability of naming C on (A, C) at a level [m/s], by integration over both fingers' noise."""
    deviates = np.linspace(-5, 5, 61)
    weights = np.exp(-(deviates**2) / 2) / np.exp(-(deviates**2) / 2).sum()
    felt = [np.maximum(speed * level + person.internal_noise * deviates, 0.0) for speed in speeds]
    left, right = felt[0][:, None], felt[1][None, :]
    v_0 = person.detection_speed
    difference = (1 + person.suppression) * np.log((right + v_0) / (left + v_0)) + person.side_bias
    with np.errstate(divide="ignore"):
        is_felt = ndtr(np.log(np.maximum(left, right) / v_0) / person.noise)
    named = is_felt * ndtr((difference - person.criterion) / person.noise)
    return person.lapse_rate / 4 + (1 - person.lapse_rate) * float(weights @ named @ weights)


def true_threshold(person: Participant, speeds: tuple[float, float], most_lapse: float) -> float:
    """Return the level halfway between guessing and the highest share that the fit allows [dB re 1 mm/s]."""
    lapse = min(1 - chance_of_c(person, speeds, 1.0), most_lapse)
    half = (chance_of_c(person, speeds, 0.0) + 1 - lapse) / 2
    low, high = math.log(5e-4), math.log(0.5)
    for _ in range(25):
        middle = (low + high) / 2
        below = chance_of_c(person, speeds, math.exp(middle)) < half
        low, high = (middle, high) if below else (low, middle)
    return to_dB(math.exp(low) * 1e3)


def recover(
    next_of: Callable[[], Callable[[list[float], list[bool]], float]],
    section: AdaptiveSection,
    speeds: tuple[float, float],
    n_participants: int,
) -> Recovery:
    """Return the results of one run on (A, C) for each of many `fingertip` participants."""
    observer = Observer.read("fingertip")
    errors, covered, inside = [], 0, 0
    for seed in range(n_participants):
        person, rng = observer.draw(np.random.default_rng(seed)), np.random.default_rng([seed, 1])
        next_level, levels, successes = next_of(), list[float](), list[bool]()

        def is_c(level: float, person: Participant = person, rng: np.random.Generator = rng) -> bool:
            left, right = (speed * level * 1e-3 for speed in speeds)
            return (
                person.answer(left, right, "one_hand", rng, AnswerList.of({"keys": ["left", "both", "right", "none"]}))[
                    0
                ]
                == "right"
            )

        for _ in range(section.trials):
            level = from_dB(next_level(levels, successes), BOUNDS)
            levels.append(to_dB(level))
            successes.append(is_c(level))
        inside += BOUNDS[0] < level < BOUNDS[1]
        catches = [is_c(0.0) for _ in range(5)]
        rates = {"guess_rate": section.guess_rate, "most_lapse": section.lapse_rate}
        found = fit_psychometric(levels, successes, catches=catches, **rates).threshold
        if found is not None:
            true = true_threshold(person, speeds, section.lapse_rate)
            errors.append(found.estimate - true)
            covered += int(found.low <= true <= found.high)
    n_told = len(errors)
    return Recovery(n_told / n_participants, float(np.mean(errors)), covered / n_told, inside / n_participants)


def test_staircases_recover_the_thresholds(section: AdaptiveSection, speeds: tuple[float, float]) -> None:
    """50 participants: bias at most 1.4 dB; coverage 95 % minus 3 Monte Carlo sd and the error of the shape."""

    def next_of() -> Callable[[list[float], list[bool]], float]:
        bounds, start = (to_dB(BOUNDS[0]), to_dB(BOUNDS[1])), to_dB(section.start_mm_s)
        return lambda levels, successes: follow(section.staircase, start, bounds, successes)

    found = recover(next_of, section, speeds, 50)
    assert found.share_told >= 0.7
    assert abs(found.bias) <= 1.4
    assert found.coverage >= 0.82
    assert found.share_ended_inside >= 0.98


def test_quest_plus_recovers_the_thresholds(section: AdaptiveSection, speeds: tuple[float, float]) -> None:
    """20 participants: bias at most 2 dB (its standard error is 0.65 dB); 90 % of the runs give a threshold."""
    bounds, start = (to_dB(BOUNDS[0]), to_dB(BOUNDS[1])), to_dB(section.start_mm_s)
    blank = Quest(bounds, start, section.guess_rate, section.lapse_rate)

    def next_of() -> Callable[[list[float], list[bool]], float]:
        run = copy.copy(blank)
        return lambda levels, successes: run.next_level(list(zip(levels, successes, strict=True)))

    found = recover(next_of, section, speeds, 20)
    assert found.share_told >= 0.9
    assert abs(found.bias) <= 2.0
    assert found.coverage >= 0.8
    assert found.share_ended_inside >= 0.96


def test_the_papers_observer_has_no_threshold_within_the_levels(speeds: tuple[float, float]) -> None:
    """At 2 mm/s it names C in over half of the trials, so adaptive runs are simulated with `fingertip`."""
    paper = Observer.read("paper").typical
    assert chance_of_c(paper, speeds, 2e-3) > 0.5
    fingertip = Observer.read("fingertip").typical
    assert chance_of_c(fingertip, speeds, 2e-3) < 0.05
    assert chance_of_c(fingertip, speeds, 0.08) > 0.9
