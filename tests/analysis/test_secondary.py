from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd
import pytest

from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.covariates import (
    order_findings,
    secondary_findings,
    side_findings,
    speed_findings,
    time_findings,
)
from modaltouch.analysis.exact import sign_flip_test
from modaltouch.analysis.intervals import MOST_TIME_STEPS, centre_interval, student_interval, time_steps


def test_the_side_bias_is_the_difference_between_focus_right_and_left(build) -> None:
    """Synthetic: everyone always answers "right", so C wins all of (A, C) and none of (C, E)."""
    answers = count_answers(build["tidy"](build["constant"](10, "right")))
    finding = next(iter(side_findings(answers)))
    assert finding.estimate == 1
    assert finding.p == 2 / 2**10


def test_a_drift_over_the_session_is_found(build) -> None:
    """Synthetic: "both" in the first half of each pair's trials, the dominant zone in the second, for all ten."""
    frame = build["tidy"](build["constant"](10, "both"))
    frame = frame.assign(trial=frame.groupby("participant").cumcount() + 1.0)
    keys = ["participant", "finger_condition", "zone_left"]
    late = frame.groupby(keys)["trial"].rank() > 2
    dominant = frame["zone_left"].map({"A": "right", "B": "left", "C": "left"})
    frame["response"] = frame["response"].where(~late, dominant)
    finding = next(iter(order_findings(count_answers(frame), frame)))
    assert finding.estimate == pytest.approx(1)
    assert finding.p == 2 / 2**10


def test_reaction_times_are_compared_by_participants_medians(build) -> None:
    """Synthetic: (B, D) takes 0.2 s longer for everyone; answers below 0.15 s are left out and counted."""
    frame = build["tidy"](build["paper"]())
    slow = (frame["zone_left"] == "B").to_numpy() * 0.2
    frame = frame.assign(response_time=0.8 + slow + np.tile([0.0, 0.01], 120))
    frame.loc[0, "response_time"] = 0.05
    found = {f.scope: f for f in time_findings(count_answers(frame), frame)}
    finding = found["one_hand A-C - B-D"]
    assert finding.estimate == pytest.approx(-0.2, abs=0.01)
    assert finding.p == 2 / 2**10
    assert "1 of all 240 answers left out as faster than 0.15 s" in finding.note


def test_breaks_of_an_hour_do_not_exhaust_the_memory() -> None:
    """In milliseconds, ten such differences have a distribution of 10^8 values; in longer steps p hardly changes."""
    hours = np.array([3600.0, -7200.0, 5400.0, 3601.0, -1.5, 0.7, 12000.0, -40.0, 9000.0, 2.0])
    steps, per_second = time_steps(hours)
    assert np.abs(steps).sum() <= MOST_TIME_STEPS + len(hours)
    assert steps / per_second == pytest.approx(hours, abs=0.5 / per_second)
    signs = np.array(list(product([-1, 1], repeat=len(hours))))
    every = np.abs(signs @ np.abs(hours))
    assert sign_flip_test(steps).p == pytest.approx(np.mean(every >= abs(hours.sum()) - 1e-9), abs=4 / 2**10)
    assert time_steps(np.array([0.8, -0.25]))[1] == 1000


def test_a_pair_that_everybody_answered_too_early_has_no_time(build) -> None:
    """Synthetic: all answers to (A, C) below 0.15 s; nothing is compared, and nothing breaks."""
    frame = build["tidy"](build["paper"]())
    frame = frame.assign(response_time=np.where(frame["zone_left"] == "A", 0.05, 0.8))
    found = {f.scope: f for f in time_findings(count_answers(frame), frame)}
    assert found["one_hand A-C - B-D"].n == 0
    assert np.isnan(found["one_hand A-C - B-D"].estimate)
    assert found["one_hand B-D - C-E"].n == 10


def test_the_first_finger_condition_is_compared_with_the_second(build) -> None:
    """Synthetic: half of the participants began with each; the note counts them, the score is first minus second."""
    frame = build["tidy"](build["constant"](4, "both"))
    second = frame["finger_condition"] == frame["participant"].map(
        {"p01": "one_hand", "p02": "one_hand", "p03": "two_hands", "p04": "two_hands"}
    )
    frame = frame.assign(trial=np.where(second, 100, 0) + np.arange(len(frame)))
    frame["response"] = frame["response"].where(
        second, frame["zone_left"].map({"A": "right", "B": "left", "C": "left"})
    )
    finding = list(order_findings(count_answers(frame), frame))[1]
    assert finding.p == sign_flip_test([12] * 4).p
    assert finding.estimate == 1
    assert "sessions: 2 began with one hand, 2 with two hands" in finding.note


def test_sessions_with_their_own_trial_numbers_are_kept_separate(build) -> None:
    """Synthetic: one hand first in session 1, two hands first in session 2; the zone wins in whichever is first."""
    frame = build["tidy"](build["constant"](4, "both"))
    one = frame["finger_condition"] == "one_hand"
    sessions = []
    for session, first in (("1", one), ("2", ~one)):
        own = frame.assign(session=session, trial=np.where(first, 0, 100) + np.arange(len(frame)) % 12)
        own["response"] = own["response"].where(~first, own["zone_left"].map({"A": "right", "B": "left", "C": "left"}))
        sessions.append(own)
    both = pd.concat(sessions, ignore_index=True)
    drift, first = order_findings(count_answers(both), both)
    assert (first.estimate, first.note[-49:]) == (1, "sessions: 4 began with one hand, 4 with two hands")
    mixed = both.sample(frac=1, random_state=1)
    assert next(iter(order_findings(count_answers(mixed), mixed))).estimate == drift.estimate


@pytest.mark.parametrize(("trial", "told"), [(1, False), (2, True)])
def test_an_order_common_to_all_is_confounded(build, trial, told) -> None:
    """If all began with one hand, order and fingers are confounded; with equal trial numbers there is no order."""
    frame = build["tidy"](build["random"](4, 1))
    frame = frame.assign(trial=np.where(frame["finger_condition"] == "one_hand", 1, trial))
    found = list(order_findings(count_answers(frame), frame))[1:]
    assert ["cannot be separated from that of the finger condition" in each.note for each in found] == [True] * told


def test_answers_without_a_time_are_counted(build) -> None:
    """One missing time does not prevent the comparison of the others."""
    frame = build["tidy"](build["paper"]())
    frame = frame.assign(response_time=np.linspace(0.5, 1.5, len(frame)))
    frame.loc[3, "response_time"] = np.nan
    found = [each for each in secondary_findings(count_answers(frame), frame) if each.question == "time"]
    assert len(found) == 6
    assert all("1 more answer without a reaction time" in each.note for each in found)


@pytest.mark.parametrize("n", [6, 8])
def test_bounds_of_the_centre_are_means_of_subsets(n) -> None:
    """Hartigan (1969): a bound is a mean of some participants, at the rank that 5 % of sign patterns allow."""
    values = np.random.default_rng(n).integers(-400, 800, n)
    picked = (np.arange(1, 2**n)[:, np.newaxis] >> np.arange(n)) & 1
    means = np.sort(picked @ values / picked.sum(axis=1))
    # p is 2 k / 2^n at a centre with k sums of signs at least as extreme, its own included.
    dropped = int(0.05 * 2**n / 2)
    interval = centre_interval(values / 1000)
    assert interval.low == pytest.approx(np.floor(means[dropped - 1] + 1) / 1000, abs=1.01e-3)
    assert interval.high == pytest.approx(np.ceil(means[-dropped] - 1) / 1000, abs=1.01e-3)
    for bound, outwards in ((interval.low, -1), (interval.high, 1)):
        at = round(bound * 1000)
        assert sign_flip_test(values - at).p > 0.05 >= sign_flip_test(values - at - outwards).p


@pytest.mark.parametrize("draw", ["normal", "exponential", "standard_cauchy"])
def test_a_bound_of_the_centre_is_the_last_that_is_rejected(draw) -> None:
    """The definition, near the bound of the t interval and far from it."""
    values = np.rint(100 * getattr(np.random.default_rng(1), draw)(size=40)).astype(int)
    interval = centre_interval(values / 1000)
    for bound, outwards in ((interval.low, -1), (interval.high, 1)):
        at = round(bound * 1000)
        assert sign_flip_test(values - at).p > 0.05 >= sign_flip_test(values - at - outwards).p


def test_five_participants_give_no_bound_of_the_centre() -> None:
    """No sign flips of five reach 0.05: 2 / 2^5 = 0.0625."""
    interval = centre_interval(np.array([0.2, 0.2, 0.2, 0.2, 0.2]))
    assert (interval.low, interval.high) == (-np.inf, np.inf)


def test_equal_values_have_no_t_interval() -> None:
    """A width of zero would be false certainty."""
    interval = student_interval(np.array([0.2, 0.2, 0.2]))
    assert interval.estimate == pytest.approx(0.2)
    assert np.isnan(interval.low)


def test_the_faster_finger_is_chosen_in_a_share_of_each_participant(build) -> None:
    """Always chosen: 1, p 2/2^6; always both: 0; with weights of one and two octaves, slower chosen for one: 1/3."""
    frame = build["tidy"](build["paper"](6))
    frame = frame[frame["zone_left"] != "B"]
    speeds = {"speed_left_mm_s": frame["zone_left"].map({"A": 50.0, "C": 200.0}),
              "speed_right_mm_s": frame["zone_right"].map({"C": 100.0, "E": 50.0})}  # fmt: skip
    faster = frame.assign(**speeds, response=frame["zone_left"].map({"A": "right", "C": "left"}))
    found = list(speed_findings(count_answers(faster), faster))
    assert [row.scope for row in found] == ["one_hand", "two_hands"]
    assert all(row.estimate == 1 and row.p == 2 * 0.5**6 and row.role == "exploratory" for row in found)
    both = faster.assign(response="both")
    assert {row.estimate for row in speed_findings(count_answers(both), both)} == {0.0}
    mixed = faster.assign(response="left")
    assert [row.estimate for row in speed_findings(count_answers(mixed), mixed)] == pytest.approx([1 / 3] * 2)


def test_answers_without_a_finger_give_no_share_of_the_faster_finger(build) -> None:
    """The answer none is unrelated to speed, and a speed of zero is left out."""
    frame = build["tidy"](build["constant"](3, "none")).assign(speed_left_mm_s=50.0, speed_right_mm_s=100.0)
    assert list(speed_findings(count_answers(frame), frame)) == []
    still = build["tidy"](build["constant"](3, "left")).assign(speed_left_mm_s=0.0, speed_right_mm_s=100.0)
    assert list(speed_findings(count_answers(still), still)) == []
