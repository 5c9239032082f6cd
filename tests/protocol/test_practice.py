"""Practice: expected answers, and when a round is passed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modaltouch.protocol import Findings, Trial
from modaltouch.protocol.schedule import Round, judge_round
from modaltouch.protocol.trial import AnswerList, Condition

PAPER = AnswerList.of({})
SHIPPED = Path(__file__).parents[2] / "protocols"
DEMO, COMPARISON = (
    Findings.read(SHIPPED / f"{name}.yaml").experiment().protocol for name in ("demo", "comparison_2ifc")
)


@pytest.mark.parametrize(
    ("left", "right", "answer"),
    [
        (0.123, 0.2, "right"),
        (0.2, 0.123, "left"),
        (0.115, 0.115, "both"),
        (0.1, 0.11, "both"),
        (0.1, 0.12, None),
        (0.0, 0.0, "both"),
        (0.0, 0.1, "right"),
    ],
)
def test_the_clearly_stronger_finger_is_expected(left: float, right: float, answer: str | None) -> None:
    """One side from a ratio of 1.25, both up to 1.1, no verdict between (Craig 1972: 0.1 to 0.2)."""
    assert PAPER.expected(left, right) == answer


@given(st.floats(0, 10), st.floats(0, 10), st.floats(0.1, 1000))
def test_the_expectation_depends_on_the_ratio_and_is_symmetric(left: float, right: float, unit: float) -> None:
    """It is the same in any unit, except at the borders, and mirrored if the fingers change places."""
    mirror = {"left": "right", "right": "left", "both": "both", None: None}
    assert PAPER.expected(right, left) == mirror[PAPER.expected(left, right)]
    low, high = sorted((left, right))
    at_border = low > 0 and min(abs(high / low - border) for border in (1.1, 1.25)) < 1e-9
    if not at_border and min(low, low * unit) > 1e-300:
        assert PAPER.expected(left * unit, right * unit) == PAPER.expected(left, right)


def test_only_offered_answers_are_expected() -> None:
    """No verdict on equal speeds without an answer for both, nor if no answer names a finger."""
    sides, grades = AnswerList.of({"keys": ["left", "right"]}), AnswerList.of({"keys": ["weaker", "stronger"]})
    assert [sides.expected(0.1, speed) for speed in (0.1, 0.2)] == [None, "right"]
    assert [grades.expected(0.1, speed) for speed in (0.1, 0.2)] == [None, None]


@pytest.mark.parametrize("speed", [-1.0, math.nan, math.inf])
def test_invalid_speeds_are_refused(speed: float) -> None:
    """The message has both speeds."""
    with pytest.raises(ValueError, match="allowed: finite speeds, 0 or more"):
        PAPER.expected(0.1, speed)


def event(index: int, answer: str, left: float, right: float, *, practice: bool = True) -> dict[str, Any]:
    """Return a trial as recorded in the session log."""
    return {
        "event": "trial",
        "trial": Trial(index, int(not practice), Condition("one_hand", "A", "C", 200.0), practice=practice).as_dict(),
        "planned": {"speed_left_mm_s": left, "speed_right_mm_s": right},
        "response": {"answer": answer},
    }


def test_a_round_counts_only_its_own_judgeable_trials() -> None:
    """Round 2 of three trials has trials 4 to 6, of which one has no verdict and one is right."""
    events = [
        {"event": "start"},
        event(1, "left", 200, 100),
        event(4, "left", 200, 100),
        event(5, "left", 100, 200),
        event(6, "left", 100, 118),
        event(4, "left", 200, 100, practice=False),
    ]
    assert judge_round(events, 2, 3, DEMO) == Round(n_judged=2, n_agreed=1)


def test_a_trial_answered_again_counts_by_its_last_answer() -> None:
    """A repeated trial supersedes the first."""
    events = [event(1, "left", 100, 200), event(1, "right", 100, 200)]
    assert judge_round(events, 1, 1, DEMO) == Round(1, 1)


@pytest.mark.parametrize(
    ("level", "interval", "right"), [(180.0, 1, "first"), (180.0, 2, "second"), (40.0, 1, "second"), (100.0, 1, None)]
)
def test_a_comparison_of_intervals_is_judged_by_the_stronger_one(
    level: float, interval: int, right: str | None
) -> None:
    """Against a standard of 100 mm/s; no verdict if both are equal."""
    trial = Trial(1, 0, Condition("one_hand", "A", "C", level), practice=True, interval=interval)
    assert COMPARISON.expected(trial, (0.1, 0.2)) == right
    answered = event(1, right or "first", 100, 200) | {"trial": trial.as_dict()}
    assert judge_round([answered], 1, 1, COMPARISON) == Round(int(right is not None), int(right is not None))


@pytest.mark.parametrize(
    ("agreed", "criterion", "passed"),
    [(2, 2 / 3, True), (1, 2 / 3, False), (3, 1.0, True), (2, 1.0, False), (0, None, True)],
)
def test_a_round_is_passed_from_its_criterion_on(agreed: int, criterion: float | None, passed: bool) -> None:
    """At least the criterion's share of three judged trials; always without a criterion."""
    assert Round(3, agreed).passes(criterion) is passed


def test_a_round_without_a_verdict_is_passed() -> None:
    """If no trial can be judged, nobody fails."""
    assert Round(0, 0).passes(1.0)
