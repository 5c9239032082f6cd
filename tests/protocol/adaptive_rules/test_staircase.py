from __future__ import annotations

import math

import numpy as np
import pytest

from modaltouch.protocol.conditions import StaircaseSection
from modaltouch.protocol.levels import follow

BOUNDS = (0.0, 60.0)


def rule(down_after: int = 1, steps: tuple[float, ...] = (4.0, 2.0), up: float = 1.0) -> StaircaseSection:
    """Return a rule."""
    return StaircaseSection(down_after=down_after, steps_dB=steps, up_over_down=up)


def course(answers: str, given: StaircaseSection, start: float = 20.0) -> list[float]:
    """Return the level of each trial and the next one, for answers written as + and -."""
    return [follow(given, start, BOUNDS, [a == "+" for a in answers[:n]]) for n in range(len(answers) + 1)]


def test_one_up_one_down_follows_every_answer() -> None:
    """Levitt (1971), simple up-down: down after a success, up after a failure; steps shrink at reversals."""
    assert course("++-+-", rule()) == [20, 16, 12, 14, 12, 14]


def test_two_down_one_up_waits_for_two_successes() -> None:
    """Levitt (1971), table I, entry 2: down after ++, up after - or +-; counting restarts after each step."""
    assert course("+++-+-++", rule(2, (2.0,))) == [20, 20, 18, 18, 20, 20, 22, 22, 20]


def test_weighted_steps_go_further_up() -> None:
    """Kaernbach (1991): steps up are three times as large as steps down."""
    assert course("+-+", rule(1, (2.0,), up=3.0)) == [20, 18, 24, 22]


def test_the_step_shrinks_at_reversals() -> None:
    """Reversals at trials 2 (up) and 3 (down); a bound does not hide a reversal."""
    assert course("++-+", rule(1, (8.0, 4.0, 1.0))) == [20, 12, 4, 8, 7]
    assert course("++-", rule(1, (8.0, 4.0)), 4.0) == [4, 0, 0, 4]
    assert follow(rule(steps=(4.0,)), 2.0, BOUNDS, [True, True, False]) == 4.0


@pytest.mark.parametrize(
    ("down_after", "up", "target"),
    [(1, 1.0, 0.5), (2, 1.0, 0.7071), (3, 1.0, 0.7937), (4, 1.0, 0.8409), (1, 3.0, 0.75)],
)
def test_targets_are_the_published_ones(down_after: int, up: float, target: float) -> None:
    """Levitt (1971), table I: 50.0, 70.7, 79.4 and 84.1 %; Kaernbach (1991): 75 % for a ratio of three."""
    assert rule(down_after, up=up).target == pytest.approx(target, abs=5e-5)


@pytest.mark.parametrize(("down_after", "up"), [(1, 1.0), (2, 1.0), (3, 1.0), (1, 3.0)])
def test_long_runs_settle_at_the_target(down_after: int, up: float) -> None:
    """Logistic observer, 1000 trials: the mean level is that where a success has the target's probability."""
    given, rng = rule(down_after, (1.0,), up), np.random.default_rng(1)
    middle, scale = 30.0, 3.0
    levels, answers = [30.0], list[bool]()
    for _ in range(1000):
        answers.append(bool(rng.random() < 1 / (1 + math.exp(-(levels[-1] - middle) / scale))))
        levels.append(follow(given, levels[0], BOUNDS, answers))
    expected = middle + scale * math.log(given.target / (1 - given.target))
    assert np.mean(levels[100:]) == pytest.approx(expected, abs=1.0)
