"""Levels by the speed predicted under the fingers instead of the level at the focus."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from modaltouch import analyse, simulate_session
from modaltouch.analysis.pipeline import read_responses
from modaltouch.analysis.responses import AnswerSource, Responses
from modaltouch.protocol import InputError

pytestmark = pytest.mark.usefixtures("undrawn")


def test_a_fixed_level_has_the_mean_of_its_trials(tmp_path: Path) -> None:
    """It is that of the faster finger over the three pairs, as in the record; the cells of the design stay."""
    log = simulate_session("demo", "p01", tmp_path).path
    told = read_responses(log)
    frame = told.frame
    faster = frame[["speed_left_mm_s", "speed_right_mm_s"]].max(axis=1)
    expected = [faster[frame["velocity_mm_s"] == level].mean() for level in (80, 200)]
    analysis = analyse(log, tmp_path / "analysis", speed="predicted")
    assert analysis.answers.levels == pytest.approx(expected, abs=1e-3)
    assert analysis.answers.scale.quantity == "predicted peak speed under the faster finger [mm/s]"
    assert np.array_equal(analysis.answers.counts, told.count().counts)


def test_a_run_is_fitted_to_the_speed_of_each_trial(tmp_path: Path) -> None:
    """On the untouched beam speed and threshold are proportional to the level; catch trials stay catch trials."""
    log = simulate_session("threshold", "p01", tmp_path).path
    nominal, predicted = (analyse(log, tmp_path / speed, speed=speed).runs for speed in ("nominal", "predicted"))
    for one, other in zip(nominal, predicted, strict=True):
        share = other.levels / one.levels
        assert share == pytest.approx(share[0], rel=1e-3)
        assert other.fitted.n_catch == one.fitted.n_catch
        assert other.fitted.threshold.estimate == pytest.approx(share[0] * one.fitted.threshold.estimate, rel=1e-3)


def test_a_table_without_speeds_is_refused(tmp_path: Path) -> None:
    """It has no predicted speeds."""
    rows = ["participant,finger_condition,zone_left,zone_right,velocity_mm_s,response"]
    (tmp_path / "answers.csv").write_text("\n".join([*rows, "p1,one_hand,A,C,80,right"]) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"without the speeds predicted.*recorded sessions.*take --speed nominal"):
        analyse(tmp_path / "answers.csv", speed="predicted")


def test_a_standard_level_is_not_compared_with_predicted_speeds() -> None:
    """100 mm/s at the focus may be any speed under the fingers, so above and below would be confused."""
    design = {"intervals": {"number": 2, "standard": {"velocity_mm_s": 100}}}
    frame = pd.DataFrame(columns=["velocity_mm_s"])
    responses = Responses(frame, (), (), AnswerSource("answers", "results", ""), design=design)
    with pytest.raises(InputError, match=r"given a standard of 100 mm/s.*take --speed nominal"):
        responses.by_speed("predicted")
