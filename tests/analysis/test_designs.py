"""Results of each participant, over participants and between groups, for observers with known parameters."""

from __future__ import annotations

import csv
import math
from collections import Counter
from dataclasses import replace
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.special import ndtr, ndtri

from modaltouch.analysis.columns import VELOCITY
from modaltouch.analysis.crossed import Analysis
from modaltouch.analysis.csv_table import TableFormat
from modaltouch.analysis.designs import analyse_design, level_findings, power_law
from modaltouch.analysis.detection import CRITERION, D_PRIME, m_intervals, same_different, yes_no
from modaltouch.analysis.findings import Finding, correct
from modaltouch.analysis.intervals import BoundedMean, Interval
from modaltouch.analysis.measures import (
    IndividualValue,
    Measure,
    contrast_findings,
    group_findings,
    mean_findings,
    over_participants,
)
from modaltouch.analysis.permutation import by_flips, by_ranks, flip_test, friedman, group_test
from modaltouch.analysis.pipeline import analyse, read_responses
from modaltouch.analysis.report import design_limits
from modaltouch.analysis.responses import AnswerSource, Responses
from modaltouch.analysis.words import certificates, certificates_of
from modaltouch.protocol import AnswerList, InputError
from modaltouch.session import simulate_session

ROOT = Path(__file__).parents[2]
TWO = {
    "intervals": {"number": 2, "standard": {"velocity_mm_s": 80}, "asked": "stronger"},
    "answers": {"keys": {"first": ["f1"], "second": ["f2"]}, "intervals": {"first": 1, "second": 2}},
}
PEOPLE = tuple(f"p{number}" for number in range(8))
SILENT = {(who, "one_hand", ""): Counter(nothing=12) for who in PEOPLE}


def presented(levels: tuple[float, ...], times: int, n_intervals: int = 1) -> pd.DataFrame:
    """Return the trials of eight people on A-C with one hand, each interval equally often."""
    rows = list(product(PEOPLE, levels, range(1, times + 1)))
    frame = pd.DataFrame(rows, columns=["participant", "velocity_mm_s", "repetition"])
    frame["interval"] = (frame["repetition"] - 1) % n_intervals + 1
    return frame.assign(finger_condition="one_hand", zone_left="A", zone_right="C", n=1)


def take(frame: pd.DataFrame, design: dict, **others: object) -> Responses:
    """Return answers in the form that the analysis reads."""
    answers = AnswerList.of(design["answers"])
    taken = frame.assign(response=pd.Categorical(frame["response"], list(answers.names)))
    return Responses(taken, (), (), AnswerSource("table", "csv", ""), answers=answers, design=design, **others)


def found(responses: Responses) -> tuple[dict[tuple[str, str], Finding], dict[str, dict[str, float]]]:
    """Return the findings by name and scope, and each participant's values by measure at the last level.

    Each p and interval of each design must have a certificate.
    """
    design = analyse_design(responses)
    for row in design.findings:
        is_printed = not math.isnan(row.p) or not math.isnan(row.low)
        assert not is_printed or (of := certificates_of(row)) and set(of) <= set(certificates()), row
    values: dict[str, dict[str, float]] = {}
    for each in design.values:
        values.setdefault(each.measure.name, {})[each.participant] = each.interval.estimate
    rows = correct(design.findings)
    return {(row.name.split(",")[0], row.scope): row for row in rows}, values


@pytest.fixture(scope="module")
def compared() -> pd.DataFrame:
    """Eight observers comparing with 80 mm/s: PSE about 84 mm/s, a spread of 2 dB, a group of four."""
    frame, rng = presented((60, 70, 80, 90, 105, 120), 24, 2), np.random.default_rng(5)
    shift = frame["participant"].map(dict(zip(PEOPLE, np.linspace(-0.6, 0.6, 8), strict=True)))
    felt = (20 * np.log10(frame["velocity_mm_s"] / 84) + shift) / 2
    chosen = rng.random(len(frame)) < ndtr(felt)
    sure = np.clip(np.rint(2 + felt.abs() / 2 + rng.normal(0, 0.5, len(frame))), 1, 4)
    response = np.where(chosen == (frame["interval"] == 1), "first", "second")
    group = np.where(frame["participant"] < "p4", "low", "high")
    return frame.assign(response=response, sure=sure.astype(int), group=group)


@pytest.mark.parametrize("levels", [(60, 70, 75, 90, 105), (60, 70, 79, 80.5, 105)])
def test_a_perfect_step_of_answers_shows_no_shift_of_the_pse(levels) -> None:
    """All eight are correct at each level: any PSE from 75 to 90 fits; its centre, 82.2 by dB, is not the standard."""
    frame = presented(levels, 8, 2)
    first = (frame["velocity_mm_s"] > 80) == (frame["interval"] == 1)
    findings, values = found(take(frame.assign(response=np.where(first, "first", "second")), TWO))
    equal = findings["PSE over participants", "one_hand A-C"]
    assert (equal.p, equal.p_min, equal.estimate) == (1, 1, pytest.approx(80))
    assert equal.low < 80 < equal.high
    assert set(values["PSE"].values()) == {80.0}
    assert f"any PSE between {levels[2]:g} and {levels[3]:g} mm/s fits: taken as the standard" in equal.note


def test_equal_magnitudes_have_no_interval() -> None:
    """Everyone always answers 5: the spread between people and the deviation from a power law are unknown."""
    frame = presented((5.0, 10.0, 20.0), 2).assign(response="rated", value=5.0)
    findings, _ = found(take(frame, {"answers": {"scale": {"kind": "number"}}}))
    mean, exponent = (findings[f"{name} over participants", scope] for name, scope in (
        ("magnitude", "one_hand A-C 5 mm/s"), ("exponent of magnitude", "one_hand A-C")))  # fmt: skip
    assert (mean.low, mean.high) == (0, math.inf) and mean.estimate == pytest.approx(5)
    assert (exponent.estimate, exponent.low, exponent.high, exponent.p) == (0, -math.inf, math.inf, 1)
    assert "every participant has the same value" in mean.note


def test_pse_and_jnd_are_those_of_the_observers(compared) -> None:
    """Known: PSE 84 mm/s, JND 0.6745 of 2 dB; the mean PSE differs from the standard of 80 mm/s."""
    findings, values = found(take(compared, TWO))
    equal, noticed = (findings[f"{name} over participants", "one_hand A-C"] for name in ("PSE", "JND"))
    assert equal.estimate == pytest.approx(84, rel=0.03)
    assert equal.low < 84 < equal.high
    assert noticed.estimate == pytest.approx(0.6745 * 2, rel=0.2)
    assert noticed.low < 0.6745 * 2 < noticed.high
    assert equal.p < 0.05 and math.isnan(noticed.p) and "described, not tested" in noticed.note
    assert "mean of such estimates, not of the true mean: spreads fitted to few trials are too" in noticed.note
    assert "95 % interval" not in equal.note
    assert "geometric mean" in equal.note and "geometric" not in noticed.note
    assert len(values["PSE"]) == 8


def test_a_just_noticeable_difference_is_never_below_zero(compared) -> None:
    """Synthetic: nobody ever errs, so the steepest function fits as well; its lower bound is 0, not minus infinity."""
    sure = np.where((compared["velocity_mm_s"] > 80) == (compared["interval"] == 1), "first", "second")
    design = analyse_design(take(compared.assign(response=sure), TWO))
    own = [each.interval for each in design.values if each.measure.name == "JND"]
    assert [interval.low for interval in own] == [0.0] * 8


def test_d_prime_of_a_comparison_follows_from_its_distance_to_the_standard(compared) -> None:
    """Known: for 120 against 80 mm/s P(comparison) = Phi(3.1 / 2), so d' = sqrt 2 times 1.55, less the correction."""
    findings, _ = found(take(compared, TWO))
    own = findings["d' over participants", "one_hand A-C 120 mm/s"]
    assert own.estimate == pytest.approx(math.sqrt(2) * 20 * math.log10(120 / 84) / 2, rel=0.2)
    assert own.p == 2 / 2**8 and own.family == "d'"
    assert ("d' over participants", "one_hand A-C 80 mm/s") not in findings


def test_a_standard_of_equal_level_in_another_field_has_no_correct_answer(compared) -> None:
    """At 80 mm/s neither is stronger: the difference belongs to the PSE and is not sensitivity."""
    design = {**TWO, "intervals": {**TWO["intervals"], "standard": {"velocity_mm_s": 80, "stimulus": "sharp"}}}
    findings, _ = found(take(compared.assign(stimulus="blunt"), design))
    told = {scope for name, scope in findings if name == "d' over participants"}
    assert told == {f"one_hand A-C {level} mm/s" for level in (60, 70, 90, 105, 120)}
    assert ("PSE over participants", "one_hand A-C") in findings


@pytest.mark.parametrize("word", ["unsure", "same"])
def test_answers_that_choose_no_interval_are_left_out(compared, word: str) -> None:
    """All measures equal those without these answers, which do not count as wrong."""
    said = {"first": 1, "second": 2, **({"same": "same"} if word == "same" else {})}
    answers = {"keys": dict.fromkeys(("first", "second", word), ["x"]), "intervals": said}
    unsaid = compared["repetition"] > 18
    design = {**TWO, "answers": {**answers, "then": {"sure": {"scale": {"kind": "likert"}}}}}
    frame = compared.astype({"sure": str})
    whole = found(take(frame.assign(response=frame["response"].where(~unsaid, word)), design))[1]
    rest = found(take(frame[~unsaid], {**design, "answers": {**TWO["answers"], "then": design["answers"]["then"]}}))[1]
    for name in ("d'", "criterion", "PSE", "JND"):
        assert whole[name] == rest[name]
    responses = take(compared.assign(response=compared["response"].where(~unsaid, word)), design)
    (limit,) = (each for each in analyse_design(responses).limits if "name no interval" in each)
    assert limit.startswith("Answers that name no interval are left out of d'")


def test_of_three_intervals_none_is_correct_if_two_are_stronger() -> None:
    """An observer who finds the strongest, and guesses between two, has no negative d' below the standard."""
    frame, rng = presented((60.0, 80.0, 100.0), 18, 3), np.random.default_rng(1)
    words = np.array(["one", "two", "three"])
    other = (frame["interval"] - 1 + rng.integers(1, 3, len(frame))) % 3
    chosen = np.where(frame["velocity_mm_s"] > 80, frame["interval"] - 1, other)
    section = {"number": 3, "standard": {"velocity_mm_s": 80}, "asked": "stronger"}
    answers = {"keys": dict.fromkeys(words, ["x"]), "intervals": {"one": 1, "two": 2, "three": 3}}
    findings, _ = found(take(frame.assign(response=words[chosen]), {"intervals": section, "answers": answers}))
    scopes = [scope for name, scope in findings if name == "d' over participants"]
    assert scopes == ["one_hand A-C 100 mm/s"]


@pytest.mark.parametrize(("design", "is_told"), [(TWO, False), ({"answers": {"keys": TWO["answers"]["keys"]}}, True)])
def test_guessing_is_unknown_only_if_the_design_does_not_fix_it(compared, design: dict, is_told: bool) -> None:
    """Of two intervals one is correct by chance in half; one finger condition cannot be shown equivalent to another."""
    responses = take(compared, design).by_choice()
    limits = " ".join(design_limits(Analysis(responses, responses.count(), ())))
    assert ("lapses and guessing stay unknown" in limits) == is_told
    assert "finger conditions can be shown to be alike" not in limits


def test_answers_of_an_interval_are_counted_by_the_stimulus_chosen(compared) -> None:
    """Known: comparisons at 120 mm/s are chosen in about Phi(1.55) = 0.94, whichever interval they are in."""
    counts = take(compared, TWO).by_choice().count()
    assert counts.answers.names == ("comparison", "standard")
    shares = counts.counts[:, 0, 0].sum(axis=0) / 192
    assert shares[-1, 0] == pytest.approx(0.94, abs=0.05)
    assert shares[0, 0] == pytest.approx(1 - ndtr(1.46), abs=0.05)


def test_confidence_changes_with_the_level(compared) -> None:
    """Known: confidence rises with the distance of the comparison; Friedman finds levels."""
    design = {**TWO, "answers": {**TWO["answers"], "then": {"sure": {"scale": {"kind": "likert"}}}}}
    findings, _ = found(take(compared.astype({"sure": str}), design))
    over_levels = findings["sure over levels", "one_hand A-C"]
    assert over_levels.p == pytest.approx(1e-4) and over_levels.family == "rating over levels"


def test_answers_to_a_further_question_are_counted_without_order(compared) -> None:
    """Known: smooth below 100 mm/s, rough above, some unanswered; the order of the list changes no number."""
    felt = np.where(compared["velocity_mm_s"] > 100, "rough", "smooth")
    felt[::7], felt[::11] = "neither", "time_out"
    keys = {"rough": ["a"], "smooth": ["b"], "neither": ["c"]}
    for order in (keys, dict(reversed(keys.items()))):
        answers = {**TWO["answers"], "then": {"texture": {"keys": order}}}
        responses = take(compared.assign(texture=felt), {**TWO, "answers": answers})
        design = analyse_design(responses)
        shares = {(each.measure.name, each.participant, each.level): each.interval.estimate for each in design.values}
        known = responses.frame[responses.frame["texture"].isin(keys)]
        for (who, level), part in known.groupby(["participant", "velocity_mm_s"], observed=True):
            own = [shares[f"P(texture: {answer})", who, level] for answer in keys]
            assert own == [pytest.approx((part["texture"] == answer).mean()) for answer in keys]
        p = {row.name.split(" over levels")[0]: row.p for row in design.findings if "over levels" in row.name}
        assert p["P(texture: rough)"] == p["P(texture: smooth)"] == pytest.approx(1e-4)
        assert p["P(texture: neither)"] > 0.05


def test_two_further_answers_have_one_share(compared) -> None:
    """One test replaces two equivalent ones."""
    answers = {**TWO["answers"], "then": {"sure": {"keys": {"guessed": ["a"], "certain": ["b"]}}}}
    frame = compared.assign(sure=np.where(compared["velocity_mm_s"] > 100, "certain", "guessed"))
    _, values = found(take(frame, {**TWO, "answers": answers}))
    names = {name for name in values if "sure" in name}
    assert names == {"P(sure: certain)"}


def test_groups_are_compared_by_participants_not_by_trials(compared) -> None:
    """Known: the low group feels 0.6 dB less; doubling every trial leaves p of the shares unchanged."""
    few = compared[compared["velocity_mm_s"] > 100]
    once, _ = found(take(few, TWO))
    twice, _ = found(take(pd.concat([few, few], ignore_index=True), TWO))
    name = "P(comparison) between groups", "high - low"
    assert once[name].estimate > 0
    assert (once[name].p, once[name].n) == (twice[name].p, 8)
    assert "high: 4, low: 4 participants" in once[name].note


RATED = {"answers": {"scale": {"kind": "likert", "lowest": 1, "highest": 9}}}


def rated(**levels: tuple[float, ...]) -> Responses:
    """Return ratings of one per 40 mm/s, plus one for participants 4 to 7, in groups with their own levels."""
    frame = presented((40, 80, 160), 2)
    frame["group"] = pd.Categorical(np.where(frame["participant"] < "p4", *levels), list(levels))
    frame = frame[[level in levels[group] for level, group in zip(frame["velocity_mm_s"], frame["group"], strict=True)]]
    value = frame["velocity_mm_s"] / 40 + (frame["participant"] >= "p4")
    return take(frame.assign(value=value, response="rated"), {"answers": RATED["answers"]})


def test_groups_are_compared_over_their_common_cells() -> None:
    """By hand: at 80 mm/s, their only common level, the groups differ by one; over all cells it would be three."""
    findings, _ = found(rated(low=(40, 80), high=(80, 160)))
    between = findings["rating between groups", "low - high"]
    assert (between.estimate, between.p, between.n) == (-1.0, pytest.approx(2 / 70), 8)
    assert between.note.endswith("over the cells that both groups met")
    notes = [findings["rating over participants", f"one_hand A-C {level} mm/s"].note for level in (40, 80, 160)]
    assert ["met by low only" in notes[0], "met by" in notes[1], "met by high only" in notes[2]] == [True, False, True]
    (shared,) = {each.level for each in analyse_design(rated(low=(40, 80), high=(80, 160))).shared}
    assert shared == 80


def test_groups_with_different_levels_are_tested_over_their_own() -> None:
    """Each group rises from level to level in all four members: 2/2^4 by signed ranks, at its own levels."""
    findings, _ = found(rated(low=(40, 80), high=(80, 160)))
    told = {scope: row for (name, scope), row in findings.items() if name.startswith("rating over levels")}
    assert list(told) == ["one_hand A-C low", "one_hand A-C high"]
    assert [(row.p, row.n) for row in told.values()] == [(pytest.approx(2 / 16), 4)] * 2
    together, _ = found(rated(low=(40, 80), high=(40, 80)))
    (scope,) = [scope for name, scope in together if name.startswith("rating over levels")]
    assert scope == "one_hand A-C"


def test_participants_with_a_level_missing_are_counted_in_group_comparisons() -> None:
    """The mean of a participant without the highest level is lower for that reason alone."""
    whole = rated(low=(40, 80), high=(40, 80))
    lacking = whole.frame[~((whole.frame["participant"] == "p0") & (whole.frame["velocity_mm_s"] == 80))]
    findings, _ = found(replace(whole, frame=lacking))
    said = "participants without a value in some cell, averaged over the others: 1"
    assert findings["rating between groups", "low - high"].note.endswith(said)
    assert "some cell" not in found(whole)[0]["rating between groups", "low - high"].note


def test_groups_without_a_common_cell_are_described_and_not_tested() -> None:
    """No number compares them, and no p enters a family."""
    findings, _ = found(rated(low=(40,), high=(80, 160)))
    between = findings["rating between groups", "low - high"]
    assert math.isnan(between.p) and math.isnan(between.estimate) and between.family == ""
    assert "no values from both groups in cells that both met" in between.note


def test_detection_gives_a_threshold_and_d_prime_by_level() -> None:
    """Known: half felt at 12 mm/s, a spread of 4 dB, no false alarm in 12 catch trials each."""
    frame, rng = presented((5, 10, 20, 40), 12), np.random.default_rng(2)
    felt = rng.random(len(frame)) < ndtr(20 * np.log10(frame["velocity_mm_s"] / 12) / 4)
    design = {"answers": {"keys": {"felt": ["f1"], "nothing": ["f2"]}, "fingers": {"nothing": []}}}
    answers = frame.assign(response=np.where(felt, "felt", "nothing"))
    findings, values = found(take(answers, design, catches=SILENT))
    threshold = findings["detection threshold over participants", "one_hand A-C"]
    assert threshold.estimate == pytest.approx(12, rel=0.15)
    # All 12 felt and no false alarm in 12: z(12.5 / 13) - z(0.5 / 13).
    assert max(values["d'"].values()) == pytest.approx(2 * 1.769, abs=0.01)


def test_a_signal_in_one_of_three_intervals_has_its_d_prime() -> None:
    """Known: d' = 1.5 at every level, so 0.75 of the answers are correct; guesses are uneven and not tested."""
    frame, rng = presented((20.0, 30.0, 40.0), 30, 3), np.random.default_rng(3)
    felt = rng.normal(0, 1, (len(frame), 3))
    felt[np.arange(len(frame)), frame["interval"] - 1] += 1.5
    words = np.array(["one", "two", "three"])
    design = {
        "intervals": {"number": 3, "standard": {"velocity_mm_s": 0}},
        "answers": {"keys": dict.fromkeys(words, ["x"]), "intervals": {"one": 1, "two": 2, "three": 3}},
    }
    responses = take(frame.assign(response=words[felt.argmax(axis=1)]), design)
    findings, _ = found(responses)
    assert findings["d' over participants", "one_hand A-C 30 mm/s"].estimate == pytest.approx(1.5, abs=0.3)
    assert not responses.by_choice().count().guesses_evenly
    assert responses.by_choice().answers.names == ("correct", "incorrect")


def test_two_spatial_alternatives_are_the_fingers_at_the_focus() -> None:
    """Known: d' = 1 of two alternatives, with C under either finger; equal shares correct, so the criterion is 0."""
    frame = pd.concat([presented((80.0, 100.0), 16).assign(zone_left=a, zone_right=b) for a, b in ("AC", "CE")])
    frame = frame.drop(columns="interval").reset_index(drop=True)
    n_correct = round(16 * ndtr(1 / math.sqrt(2)))
    on_left = np.where(frame["zone_left"] == "C", "left", "right")
    turned = np.where(on_left == "left", "right", "left")
    answers = frame.assign(response=np.where(frame["repetition"] <= n_correct, on_left, turned))
    responses = take(answers, {"answers": {"keys": {"left": ["a"], "right": ["b"]}}}, focus="C")
    findings, _ = found(responses)
    d_prime = findings["d' over participants", "one_hand 80 mm/s"]
    assert d_prime.estimate == pytest.approx(math.sqrt(2) * ndtri((n_correct + 0.5) / 17))
    assert findings["criterion over participants", "one_hand 80 mm/s"].estimate == pytest.approx(0)


@pytest.mark.parametrize(
    ("own", "low", "high"),
    [
        ([(-math.inf, math.inf)] * 5 + [(-0.5, math.inf)], -math.inf, math.inf),
        ([(0.1, math.inf)] * 6, 0.2, math.inf),
        ([(-math.inf, 1.0)] * 5 + [(-math.inf, math.inf)], -math.inf, math.inf),
        ([(-math.inf, math.inf)] * 5 + [(-0.5, 1.0)], 0.2, 0.7),
    ],
)
def test_a_mean_has_no_bound_where_too_few_values_have_one(own, low, high) -> None:
    """Six values from 0.2 to 0.7, whose sign flips give [0.2, 0.7]; unbounded values widen or remove a bound."""
    values = [
        IndividualValue(CRITERION, f"p{n}", "one_hand", "A-C", math.nan, Interval(0.2 + n / 10, *ends, 8), 8)
        for n, ends in enumerate(own)
    ]
    interval = over_participants(CRITERION, values)[1]
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=1e-3)


def test_the_interval_of_a_mean_d_prime_contains_zero_unless_the_rates_reject_it() -> None:
    """No d' of an oddity task is below zero, so their mean is positive by chance alone: p of the rates is 1."""
    values = [
        IndividualValue(D_PRIME, f"p{n}", "one_hand", "A-C", 80.0, Interval(0.5 + n / 10, 0, 2, 9), 9, tested=gap)
        for n, gap in enumerate([0.1, -0.1] * 4)
    ]
    test, interval = over_participants(D_PRIME, values)
    assert (test.p, interval.low) == (1, 0) and interval.estimate == pytest.approx(0.85)
    test, interval = over_participants(D_PRIME, [replace(each, tested=0.1 + n) for n, each in enumerate(values)])
    assert test.p < 0.01 and interval.low > 0.5


def test_a_comparison_over_all_pairs_has_no_pair_in_its_scope() -> None:
    """Two spatial alternatives have one d' for all pairs: its scope has the finger conditions only."""
    frame = presented((80.0,), 8).drop(columns="interval").assign(response="right")
    both = pd.concat([frame, frame.assign(finger_condition="two_hands")], ignore_index=True)
    findings, _ = found(take(both, {"answers": {"keys": {"left": ["a"], "right": ["b"]}}}, focus="C"))
    assert ("d' compared", "one_hand - two_hands") in findings


def test_same_and_different_are_relative_to_the_standard() -> None:
    """Known: percepts 1 and 3 from the standard's, "different" beyond 1.5; 80 and 80 mm/s are the same."""
    frame, rng = presented((80.0, 90.0, 110.0), 40, 2), np.random.default_rng(4)
    apart = frame["velocity_mm_s"].map({80.0: 0.0, 90.0: 1.0, 110.0: 3.0}) + rng.normal(0, math.sqrt(2), len(frame))
    design = {
        "intervals": {"number": 2, "standard": {"velocity_mm_s": 80}},
        "answers": {
            "keys": {"same": ["x"], "different": ["y"]},
            "intervals": {"same": "same", "different": "different"},
        },
    }
    findings, _ = found(take(frame.assign(response=np.where(apart.abs() > 1.5, "different", "same")), design))
    assert findings["d' over participants", "one_hand A-C 90 mm/s"].estimate == pytest.approx(1, abs=0.5)
    assert findings["d' over participants", "one_hand A-C 110 mm/s"].estimate == pytest.approx(3, abs=0.5)


SAME_OR_NOT = {
    "intervals": {"number": 2, "standard": {"stimulus": "sharp"}},
    "answers": {"keys": {"same": ["x"], "different": ["y"]}, "intervals": {"same": "same", "different": "different"}},
}


def test_other_stimuli_are_compared_with_a_standard_stimulus() -> None:
    """By hand, differencing model: sharp called different in 4 of 20, blunt in 16, wide in 12; level by level."""
    often = {"sharp": 4, "blunt": 16, "wide": 12}
    frame = pd.concat([presented((80.0, 90.0), 20).assign(stimulus=name) for name in often], ignore_index=True)
    is_called = frame["repetition"] <= frame["stimulus"].map(often) + (frame["velocity_mm_s"] == 90)
    responses = take(frame.assign(response=np.where(is_called, "different", "same")), SAME_OR_NOT)
    own = [each for each in analyse_design(responses).values if each.measure.name == "d'"][:4]
    assert [each.interval.estimate for each in own] == [
        same_different((k + extra, 20), (4 + extra, 20)).d_prime.estimate for k in (16, 12) for extra in (0, 1)
    ]
    assert {(each.pair, each.note) for each in own} == {
        ("A-C blunt", "differencing (same or different) model"),
        ("A-C wide", "differencing (same or different) model"),
    }


def test_the_model_of_three_intervals_follows_from_the_protocol() -> None:
    """It is the oddity model, 3AFC for one above silence or for the stronger, or none if no model fits."""
    frame, words = presented((60.0, 100.0), 9, 3), ("one", "two", "three")
    frame = frame.assign(response=np.where(frame["repetition"] % 2, np.array(words)[frame["interval"] - 1], "two"))
    answers = {"keys": dict.fromkeys(words, ["x"]), "intervals": {"one": 1, "two": 2, "three": 3}}

    def notes(standard: dict, **others: object) -> set[str]:
        section = {"number": 3, "standard": standard, **others}
        responses = take(frame, {"intervals": section, "answers": answers})
        return {each.note for each in analyse_design(responses).values if each.measure.name == "d'"}

    assert notes({"velocity_mm_s": 80}) == {"triangular (odd one of three) model"}
    assert notes({"velocity_mm_s": 0}) == {"3AFC model"}
    assert notes({"velocity_mm_s": 80}, asked="stronger") == {"3AFC model"}
    (some,) = notes({"velocity_mm_s": 80}, comparison_in=[2, 3])
    assert "in only some of the three intervals" in some
    three = {**SAME_OR_NOT, "intervals": {"number": 3, "standard": {"velocity_mm_s": 60}}}
    told = analyse_design(take(frame.assign(response="same"), three)).values
    assert {each.note for each in told} == {
        "no d' from whether three intervals are the same: the differencing model is for two"
    }


def test_recorded_trials_of_same_and_different_are_analysed_together(tmp_path: Path) -> None:
    """The two-interval example of sharp and blunt: d' of each participant from all 20 answers, without --stimulus."""
    example = ROOT / "docs" / "examples" / "protocol_same_different.yaml"
    text = example.read_text(encoding="utf-8").replace("../../", f"{ROOT}/")
    protocol = tmp_path / "two.yaml"
    text = text.replace("number: 3", "number: 2").replace("comparison_in: [2, 3]", "comparison_in: [1, 2]")
    protocol.write_text(text, encoding="utf-8")
    for who in ("p1", "p2"):
        simulate_session(protocol, who, tmp_path / "results")
    done = analyse(tmp_path / "results", tmp_path / "out")
    rows = [row for row in done.as_dict()["measures"] if row["measure"] == "d'"]
    assert [(row["participant"], row["n"]) for row in rows] == [("p1", 10), ("p2", 10)]
    assert all(row["estimate"] is not None for row in rows)
    assert "differencing (same or different) model" in done.files["report.html"].read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def magnitudes() -> pd.DataFrame:
    """Eight people whose numbers grow as the 0.6th power of the level, each with an individual modulus."""
    frame, rng = presented((20, 40, 80, 160), 3), np.random.default_rng(6)
    modulus = frame["participant"].map(dict(zip(PEOPLE, np.geomspace(2, 40, 8), strict=True)))
    value = modulus * (frame["velocity_mm_s"] / 80) ** 0.6 * np.exp(rng.normal(0, 0.1, len(frame)))
    return frame.assign(response="rated", value=value.round(4)).drop(columns="interval")


def test_magnitudes_have_the_exponent_of_their_power_law(magnitudes, tmp_path: Path) -> None:
    """Known: 0.6 (Stevens); report and table have each participant's exponent, and there is no bar chart of "rated"."""
    table = tmp_path / "numbers.csv"
    magnitudes.to_csv(table, index=False)
    design = {"answers": {"scale": {"kind": "number"}}}
    done = analyse(table, table_format=TableFormat(AnswerList.of({"keys": ["rated"]}), design=design))
    tests = done.tests.set_index(["family", "scope"])
    exponent = tests.loc[("exponent of magnitude", "one_hand A-C")]
    assert exponent["estimate"] == pytest.approx(0.6, abs=0.05)
    assert exponent["p_holm"] == 2 / 2**8
    with done.files["measures.csv"].open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["measure"] for row in rows} == {"magnitude", "exponent of magnitude"}
    page = done.files["report.html"].read_text(encoding="utf-8")
    assert "What do ratings and further answers say?" in page and "exponent of magnitude differs from zero" in page
    assert not {"fig_10.svg", "fig_10.csv"} & set(done.files)


def test_rounding_error_is_not_a_difference_between_conditions(magnitudes, tmp_path: Path) -> None:
    """Numbers twice as large with two hands have the same exponent, however its sums are rounded."""
    exact = magnitudes.assign(value=magnitudes["velocity_mm_s"].astype(float), finger_condition="one_hand")
    doubled = exact.assign(value=2 * exact["value"], finger_condition="two_hands")
    table = tmp_path / "numbers.csv"
    pd.concat([exact, doubled]).to_csv(table, index=False)
    design = {"answers": {"scale": {"kind": "number"}}}
    done = analyse(table, table_format=TableFormat(AnswerList.of({"keys": ["rated"]}), design=design))
    compared = done.tests.set_index("name").loc["exponent of magnitude compared, sign flips"]
    assert (compared["estimate"], compared["low"], compared["high"], compared["p"]) == (0, -np.inf, np.inf, 1)
    assert float(flip_test(np.full(12, 2.2e-16)).p) == 1


def test_the_power_law_is_least_squares_of_logarithms() -> None:
    """Reference: scipy.stats.linregress of the logarithms, and t with n - 2 degrees of freedom."""
    levels, values = pd.Series([10.0, 20.0, 40.0, 80.0, 160.0]), pd.Series([1.0, 1.8, 2.2, 4.5, 5.0])
    line = stats.linregress(np.log(levels), np.log(values))
    found = power_law(levels, values)
    assert found.estimate == pytest.approx(line.slope)
    assert found.high - found.estimate == pytest.approx(stats.t.ppf(0.975, 3) * line.stderr)


def test_signed_ranks_agree_with_a_textbook_example() -> None:
    """Hollander and Wolfe (1973), table 3.1, depression: p = 0.039, estimate 0.46, bounds 0.010 and 0.786."""
    first = np.array([1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30])
    second = np.array([0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29])
    test, interval = by_ranks(first - second)
    assert test.p == pytest.approx(stats.wilcoxon(first - second, method="exact").pvalue) == 0.0390625
    assert (interval.estimate, interval.low, interval.high) == pytest.approx((0.46, 0.010, 0.786))


def test_random_shuffles_do_not_depend_on_the_order_of_participants() -> None:
    """Twelve participants in two orders have the same p in Friedman's test and between two groups."""
    rows = np.random.default_rng(4).normal(size=(24, 4)) + [0, 0.1, 0.2, 0.3]
    assert friedman(rows)[0].p == friedman(rows[::-1])[0].p
    test, interval = group_test(rows[:10, 0], rows[10:, 1])
    turned, moved = group_test(rows[:10, 0][::-1], rows[10:, 1][::-1])
    assert (test.p, interval.low) == (turned.p, moved.low)


def test_an_interval_ending_at_zero_beside_a_rejection_is_explained() -> None:
    """Zero differences are left out of the signed ranks but not of their interval: p = 2 / 2^6, and [0, 1]."""
    measure = Measure("sure", "sure", "rating", None, is_ranked=True)
    gaps = [1.0] * 6 + [0.0] * 3
    values = [
        IndividualValue(measure, f"p{who}", condition, "A-C", 80.0, Interval.point(value, 1), 1)
        for who, gap in enumerate(gaps)
        for condition, value in (("one_hand", gap), ("two_hands", 0.0))
    ]
    (found,) = contrast_findings(values)
    assert (found.p, found.low, found.high) == (2 / 2**6, 0, 1)
    assert "the interval ends at 0, which the test rejects" in found.note


def test_a_sample_without_differences_does_not_prove_their_absence() -> None:
    """Ten equal: the mean difference may be 1 - 0.025^(1/10), as of any score (`BoundedMean`); of d', any value."""

    def compared(measure: Measure) -> list[Finding]:
        both = product(range(10), ("A-C fast", "A-C slow"))
        return [*contrast_findings(
            IndividualValue(measure, f"p{who}", "one_hand", place, 80.0, Interval.point(1.0, 4), 4)
            for who, place in both
        )]  # fmt: skip

    flips, mean = compared(Measure("P(C)", "P(C)", "shares"))
    assert (flips.p, flips.low, flips.high) == (
        1,
        pytest.approx(math.nan, nan_ok=True),
        pytest.approx(math.nan, nan_ok=True),
    )
    assert (mean.low, mean.high) == pytest.approx((-(1 - 0.025**0.1), 1 - 0.025**0.1))
    assert (mean.p, mean.family) == (1, "shares compared on average")
    (found,) = compared(Measure("d'", "sensitivity d'", "sensitivity", null=0.0))
    assert (found.p, found.low, found.high) == (1, -math.inf, math.inf)
    assert "without a difference, there is no interval" in found.note


def test_an_interval_with_too_many_errors_is_labelled() -> None:
    """By its certificates that of magnitudes errs for any mean, that of d' only for the true mean."""
    magnitude = Measure("magnitude", "magnitude", "rating", None, True)
    for measure, said in (
        (magnitude, "not a 95 % interval: a few participants may use much larger numbers"),
        (D_PRIME, "; 95 % interval of the mean of such estimates, not of the true mean: the correction"),
    ):
        values = [
            IndividualValue(measure, f"p{who}", "one_hand", "A-C", 80.0, Interval(who, who - 1.0, who + 1.0, 4), 4, "x")
            for who in range(1, 9)
        ]
        (row,) = mean_findings(values, VELOCITY, {})
        assert said in row.note


def test_a_mean_at_the_ceiling_is_no_more_certain_than_each_value() -> None:
    """Twelve people with 8 of 8 correct: their equal d' have no spread, yet each may be as low as its own bound."""
    own = m_intervals((8, 8), 2)
    values = [
        IndividualValue(D_PRIME, f"p{who}", "one_hand", "A-C", 80.0, own.d_prime, 8, "", own.contrast)
        for who in range(12)
    ]
    test, interval = over_participants(D_PRIME, values)
    assert test.p == 2 / 2**12
    assert (interval.low, interval.estimate, interval.high) == (own.d_prime.low, own.d_prime.estimate, math.inf)
    assert own.d_prime.low < own.d_prime.estimate - 1
    _, alone = over_participants(D_PRIME, values[:1])
    assert (alone.low, alone.high) == (-math.inf, math.inf)


@pytest.mark.parametrize(("after", "is_said"), [(12, False), (40, True)])
def test_estimates_from_unequal_numbers_of_trials_are_labelled_as_biased_unequally(after, is_said) -> None:
    """All correct, from 12 trials of each kind before and another number after: corrected d' of 24 and more trials."""
    before, later = (yes_no((n, n), (0, n)).d_prime for n in (12, after))
    values = [
        IndividualValue(D_PRIME, f"p{who}", "one_hand", place, 80.0, interval, int(interval.n_effective))
        for who in range(8)
        for place, interval in (("A-C before", before), ("A-C after", later))
    ]
    (row,) = contrast_findings(values)
    said = f"from 24 against {2 * after} trials each, which bias the estimates unequally"
    assert (said in row.note) is is_said
    halves = [each for each in values if (each.participant in ("p0", "p1", "p2", "p3")) is (each.pair == "A-C after")]
    (row,) = group_findings(halves, halves, {f"p{who}": "ba"[who < 4] for who in range(8)}, ("b", "a"))
    assert (said in row.note) is is_said


def test_groups_without_any_difference_have_no_interval() -> None:
    """Two groups of five at the ceiling give no information on a shift."""
    values = [
        IndividualValue(D_PRIME, f"p{who}", "one_hand", "A-C", 80.0, Interval.point(2.0, 9), 9) for who in range(10)
    ]
    (row,) = group_findings(values, values, {f"p{who}": "ab"[who > 4] for who in range(10)}, ("a", "b"))
    assert (row.p, row.estimate, row.low, row.high) == (1, 0, -math.inf, math.inf)


def test_equal_means_share_their_rank() -> None:
    """By hand: 0.1 + 0.2 equals 0.3 except for the last bit, so their difference is not ranked and counts as a tie."""
    none = 0.1 + 0.2 - 0.3
    assert none != 0 and by_ranks(np.array([none, 1.0, 2.0]))[0].p == by_ranks(np.array([0.0, 1.0, 2.0]))[0].p == 0.5
    rows = np.array([[0.1 + 0.2, 0.3, 0.5], [0.3, 0.1 + 0.2, 0.5]])
    assert friedman(rows)[1] == pytest.approx(1)


def test_the_bounds_of_a_group_difference_invert_its_test() -> None:
    """By hand: three far above three have p = 2 / 20; shifts just inside a bound are kept, just outside rejected."""
    low, high = np.array([1.0, 2.0, 4.0, 5.0]), np.array([9.0, 11.0, 12.0, 16.0])
    assert group_test(high[1:], low[1:])[0].p == pytest.approx(2 / 20)
    test, interval = group_test(high, low)
    assert test.p == test.p_min == pytest.approx(2 / 70)
    for bound, inwards in ((interval.low, 0.01), (interval.high, -0.01)):
        assert group_test(high - bound - inwards, low)[0].p > 0.05 >= group_test(high - bound + inwards, low)[0].p


def test_friedman_agrees_with_scipy_and_with_all_orders() -> None:
    """Reference: the statistic of scipy; p over all 6^4 orders, within four standard errors of 9,999 shuffles."""
    rows = np.array([[1.0, 2.0, 3.0], [2.0, 1.0, 3.0], [1.0, 2.5, 2.5], [3.0, 1.0, 2.0]])
    test, _ = friedman(rows)
    assert test.statistic == pytest.approx(stats.friedmanchisquare(*rows.T).statistic)
    ranks = stats.rankdata(rows, axis=1)
    sums = [sum(map(np.array, orders)) for orders in product(*(list(permutations(row)) for row in ranks))]
    reached = np.mean([((total - 8) ** 2).sum() >= ((ranks.sum(axis=0) - 8) ** 2).sum() - 1e-9 for total in sums])
    assert test.p == pytest.approx(reached, abs=4 * math.sqrt(reached * (1 - reached) / 9999))


@pytest.mark.parametrize("factor", ["finger_condition", "session_kind"])
def test_false_alarms_count_in_their_own_condition(factor: str) -> None:
    """By hand: half felt in both; 0 of 4 false alarms in the first, 2 of 4 in the second: d' is -z(0.1), and 0."""
    frame, own = presented((5, 10), 6), (("first", 0), ("second", 2))
    frame = pd.concat([frame.assign(**{factor: name}) for name, _ in own])
    felt = frame.assign(response=np.where(frame["repetition"] <= 3, "felt", "nothing"))
    design = {"answers": {"keys": {"felt": ["f1"], "nothing": ["f2"]}, "fingers": {"nothing": []}}}
    place = {"finger_condition": lambda name: (name, ""), "session_kind": lambda name: ("one_hand", name)}[factor]
    caught = {(who, *place(name)): Counter(felt=n, nothing=4 - n) for who in PEOPLE for name, n in own}
    told = analyse_design(take(felt, design, catches=caught)).values
    by_name = {f"{each.finger_condition} {each.pair}": each for each in told if each.measure.name == "d'"}
    expected = {"first": -ndtri(0.5 / 5), "second": 0.0}
    for name, own_value in by_name.items():
        assert own_value.interval.estimate == pytest.approx(expected["first" if "first" in name else "second"])
    assert len(by_name) == 2


def test_a_finger_condition_without_catch_trials_has_no_d_prime() -> None:
    """False alarms with one hand do not apply to two; a note gives the reason."""
    frame = pd.concat([presented((5, 10), 6).assign(finger_condition=name) for name in ("one_hand", "two_hands")])
    design = {"answers": {"keys": {"felt": ["f1"], "nothing": ["f2"]}, "fingers": {"nothing": []}}}
    told = analyse_design(take(frame.assign(response="felt"), design, catches=SILENT)).values
    notes = {each.finger_condition: each.note for each in told if each.measure.name == "d'"}
    assert notes == {"one_hand": "yes-no model", "two_hands": "no d' from answers without catch trials of their own"}


def test_sign_flips_do_not_depend_on_the_unit() -> None:
    """Scaling changes neither p nor the scaled interval."""
    values = np.array([0.2, 0.9, 1.4, -0.3, 2.2, 1.1, 0.8])
    small, large = by_flips(values), by_flips(values * 1e6)
    assert small[0].p == large[0].p
    assert small[1].low * 1e6 == pytest.approx(large[1].low)


def test_sign_flips_of_shares_preserve_ties() -> None:
    """Reference: all 2^7 signs of multiples of 1/18; rounded to four digits, 1/18 + 1/18 would differ from 1/9."""
    values = np.array([1, 1, -2, 6, 3, -1, 4]) / 18
    sums = np.abs([np.array(signs) @ values for signs in product((-1, 1), repeat=len(values))])
    assert by_flips(values)[0].p == (sums >= abs(values.sum()) - 1e-9).mean()


def test_groups_at_the_ceiling_do_not_differ() -> None:
    """With 3 and 4 equal people any assignment has the same means; of 1, 2, 3 and 5 to 8, one in 35 is as far apart."""
    equal, apart = (
        group_test(np.array(a), np.array(b))[0] for a, b in (([1.0] * 3, [1.0] * 4), ([1.0, 2, 3], [5.0, 6, 7, 8]))
    )
    assert (equal.p, equal.p_min, equal.n_informative) == (1, 1, 0)
    assert apart.p_min == apart.p == pytest.approx(1 / 35)


def test_participants_at_the_ceiling_give_no_upper_bound() -> None:
    """Synthetic: all have 12 of 12 felt and no false alarm in 12: neither their d' nor the mean has an upper bound."""
    frame = presented((5, 10), 12).assign(response="felt")
    design = {"answers": {"keys": {"felt": ["f1"], "nothing": ["f2"]}, "fingers": {"nothing": []}}}
    findings, _ = found(take(frame, design, catches=SILENT))
    d_prime = findings["d' over participants", "one_hand A-C 5 mm/s"]
    assert d_prime.high == math.inf and d_prime.low == pytest.approx(yes_no((12, 12), (0, 12)).d_prime.low)
    assert "on one side: 8" in d_prime.note


@pytest.mark.parametrize(("lowest", "is_magnitude"), [(-5, False), (0, False), (0.5, True)])
def test_a_typed_number_may_be_zero_if_the_protocol_allows_it(lowest, is_magnitude) -> None:
    """Two answers per level, the lowest possible and 5: the mean is arithmetic, or geometric if all are above 0."""
    frame = presented((5.0, 10.0), 2).assign(response="rated")
    frame["value"] = np.where(frame["repetition"] == 1, lowest, 5.0)
    design = {"answers": {"scale": {"kind": "number", "lowest": lowest, "highest": 5}}}
    _, values = found(take(frame, design))
    mean = math.sqrt(lowest * 5) if is_magnitude else (lowest + 5) / 2
    name = "magnitude" if is_magnitude else "rating"
    assert set(values) == {name} | ({"exponent of magnitude"} if is_magnitude else set())
    assert list(values[name].values()) == pytest.approx([mean] * len(PEOPLE))


def test_ratings_that_all_agree_still_have_an_interval() -> None:
    """It is that of the bounded mean of eight equal ratings of 4 on 1 to 7: others could have rated differently."""
    frame = presented((5.0, 10.0), 2).assign(response="rated", value=4.0)
    findings, _ = found(take(frame, {"answers": {"scale": {"kind": "likert"}}}))
    rating = findings["rating over participants", "one_hand A-C 5 mm/s"]
    expected = BoundedMean([4.0] * 8, 1.0, 7.0).interval()
    assert (rating.estimate, rating.low, rating.high) == (4, expected.low, expected.high)
    assert expected.low < 4 < expected.high


def test_recorded_answers_and_ratings_are_analysed_by_participant(edit, tmp_path: Path) -> None:
    """Shipped detection with confidence, two answers per level: d' of 8 trials and 4 catch trials, and ratings."""
    few = ("repetitions: 10", "repetitions: 2"), ("catch_trials: 10", "catch_trials: 4")
    protocol = edit("detection_with_confidence.yaml", *few)
    simulate_session(protocol, "p1", tmp_path / "results")
    responses = read_responses(tmp_path / "results")
    design = analyse_design(responses)
    d_prime = [each for each in design.values if each.measure.name == "d'"]
    assert [(each.participant, each.n) for each in d_prime] == [("p1", 8)]
    assert [row.n_catch for row in design.catches] == [4, 4]
    rated = [each for each in design.values if each.measure.name == "confidence"]
    expected = responses.frame.groupby(["participant", "velocity_mm_s"], observed=True)["confidence"].mean()
    assert [each.interval.estimate for each in rated] == pytest.approx(expected.to_numpy(dtype=float))
    assert rated[0].measure.ends == (0, 100)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda table: table.drop(columns="interval"), "add the column interval"),
        (lambda table: table.assign(interval="late"), r"interval: given 'late' \(in 1152 rows\)"),
        (lambda table: table.assign(interval=3), "interval: given '3'.*allowed: a whole number, 1 to 2"),
    ],
)
def test_a_table_of_intervals_needs_the_interval_of_the_comparison(compared, tmp_path: Path, change, reason) -> None:
    """It is an additional column of whole numbers up to the number of intervals."""
    path = tmp_path / "answers.csv"
    change(compared).to_csv(path, index=False)
    with pytest.raises(InputError, match=reason):
        read_responses(path, table_format=TableFormat(AnswerList.of(TWO["answers"]), design=TWO))


def test_a_measure_without_any_value_is_described() -> None:
    """Synthetic: everything felt at every level gives no threshold; the row has the number left out and no estimate."""
    frame = presented((5, 10, 20), 4).assign(response="felt")
    design = {"answers": {"keys": {"felt": ["f1"], "nothing": ["f2"]}, "fingers": {"nothing": []}}}
    findings, _ = found(take(frame, design))
    threshold = findings["detection threshold over participants", "one_hand A-C"]
    assert np.isnan([threshold.estimate, threshold.low, threshold.high]).all() and threshold.n == 0
    assert threshold.note.endswith("participants without a value, left out: 8; described, not tested")
    both = pd.concat([frame, frame.assign(finger_condition="two_hands")], ignore_index=True)
    findings, _ = found(take(both, design))
    compared = findings["detection threshold compared", "one_hand - two_hands A-C"]
    assert (compared.family, compared.note) == ("", "described, not tested: no participant has a value in both")
    assert math.isnan(compared.p) and math.isnan(compared.low)


def test_friedman_p_is_not_below_the_smallest_possible() -> None:
    """Six who agree on three levels: p is 6 of the 6^6 orders, though none of the 9,999 drawn was as extreme."""
    test, _ = friedman(np.tile([1.0, 2.0, 3.0], (6, 1)))
    assert test.p == test.p_min == pytest.approx(6**-5)


@pytest.mark.parametrize("is_ratio", [False, True])
def test_ratings_of_two_levels_are_compared_by_signed_ranks(is_ratio) -> None:
    """Reference: scipy's Wilcoxon test, of log magnitudes; a participant without the second level is left out."""
    measure = Measure("loud", "loud", "rating", None, is_ratio=is_ratio, is_ranked=True)
    low, high = np.array([1.0, 2, 4, 3, 5, 2, 7]), np.array([2.0, 6, 4.5, 10, 3.5, 7, 30])
    values = [
        IndividualValue(measure, f"p{who}", "one_hand", "A-C", level, Interval.point(value, 1), 1)
        for level, rated in ((50.0, low), (150.0, high))
        for who, value in enumerate(rated)
    ]
    values.append(IndividualValue(measure, "alone", "one_hand", "A-C", 50.0, Interval.point(1.0, 1), 1))
    (row,) = level_findings(values, {})
    gaps = np.log(high / low) if is_ratio else high - low
    assert row.p == pytest.approx(stats.wilcoxon(gaps, method="exact").pvalue)
    averages = [(one + other) / 2 for place, one in enumerate(gaps) for other in gaps[place:]]
    middle = np.median(averages)
    assert row.estimate == pytest.approx(math.exp(middle) if is_ratio else middle, rel=1e-6)
    assert (row.family, row.n) == ("rating over levels", 7)
    assert "signed ranks" in row.name and "participants without a rating at every level, left out: 1" in row.note
