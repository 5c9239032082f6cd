"""Faults of levels relative to the participant's threshold, with positions and allowed values."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modaltouch.preflight import examine
from modaltouch.protocol.conditions import SensationLevelsSection

NAME = "sensation_levels.yaml"


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("[2, 200]", "[2, 80, 200]", "conditions.peak_velocities_mm_s", "3 levels, but they are calibrated by"),
        ("[2, 200]", "[200, 2]", "conditions.peak_velocities_mm_s", "the lowest level first"),
        ("[2, 200]", "[2, 280]", "conditions.peak_velocities_mm_s[1]", "at most"),
        ("from: threshold ", "from: sensation_levels ", "conditions.sensation_levels.thresholds_from", "itself"),
        ("[1, 1.5, 2, 3]", "[1, 150]", "conditions.sensation_levels.multiples", "a ratio of at most 100"),
        ("[1, 1.5, 2, 3]", "[1, 1.0, 2]", "conditions.sensation_levels.multiples[1]", "the same multiple as"),
        ("[1, 1.5, 2, 3]", "[0, 1]", "conditions.sensation_levels.multiples[0]", "above 0"),
        ("[1, 1.5, 2, 3]", "[]", "conditions.sensation_levels.multiples", "at least 1"),
        ("schedule:", "adaptive: {start_mm_s: 60}\n\nschedule:", "conditions.sensation_levels", "find their own"),
    ],
)
def test_each_fault_has_its_position(edit, old: str, new: str, place: str, words: str) -> None:
    """With the given and the allowed values."""
    changes = [(old, new)]
    if place == "conditions.sensation_levels":
        changes += [("  repetitions: 5\n", ""), ("  max_same_pair_running: 3\n", "")]
    problems = [str(problem) for problem in examine(edit(NAME, *changes)).problems]
    assert len(problems) == 1, problems
    assert f" {place}: " in problems[0]
    assert words in problems[0]


def test_the_check_shows_trials_and_allowed_thresholds(shipped: Path) -> None:
    """Two pairs at four levels, five times, and five catch trials; thresholds from 2 / 1 to 200 / 3 mm/s."""
    values = examine(shipped / NAME).as_dict()
    assert values["n_trials"] == 45
    assert values["sensation_levels"] == {
        "thresholds_from": "threshold",
        "multiples": [1.0, 1.5, 2.0, 3.0],
        "thresholds_mm_s": [2.0, 66.6667],
    }


@given(
    multiples=st.lists(st.floats(0.01, 100), min_size=1, max_size=9, unique=True),
    bounds=st.tuples(st.floats(0.1, 50), st.floats(60, 900)),
    share=st.floats(0.01, 0.99),
)
def test_allowed_thresholds_give_allowed_levels(
    multiples: list[float], bounds: tuple[float, float], share: float
) -> None:
    """For thresholds within their bounds, every level is its multiple and within the bounds for levels."""
    section = SensationLevelsSection(thresholds_from="threshold", multiples=tuple(multiples))
    low, high = section.thresholds(*bounds)
    if low > high:
        return
    threshold = low + share * (high - low)
    levels = section.levels(threshold)
    # Four digits are kept, so that a level may pass its bound by half of the last one.
    assert bounds[0] * (1 - 5e-4) <= min(levels)
    assert max(levels) <= bounds[1] * (1 + 5e-4)
    assert levels == pytest.approx([multiple * threshold for multiple in multiples], rel=5e-4)
