from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pandas as pd
import pytest

from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.findings import Finding
from modaltouch.analysis.intervals import clopper_pearson
from modaltouch.analysis.report import delivered_rows, list_questions, speed_rows
from modaltouch.analysis.statistics import find
from modaltouch.analysis.words import (
    certificates,
    certificates_in_words,
    certificates_of,
    format_p,
    scope_in_words,
    state_families,
)
from modaltouch.report import format_number


def paragraphs(frame) -> dict[str, str]:
    """Return the text of each question."""
    answers = count_answers(frame)
    return {
        asked["question"]: f"{asked['answer']} {asked['caution']}"
        for asked in list_questions(find(answers, frame), answers)
    }


def test_each_question_has_its_paragraph(paper_frame) -> None:
    """Questions a to f of the plan, and the side bias that the design allows."""
    assert list(paragraphs(paper_frame)) == ["a1", "a2", "b", "c", "d", "e", "f", "side"]


def test_each_answer_begins_with_its_number(paper_frame) -> None:
    """Each question is answered on average and for some participant; if all lean alike, p is 2/2^10."""
    told = paragraphs(paper_frame)
    assert told["a2"].startswith(
        "Yes, in 4 of 6 tests: one zone is chosen more than the other on average. Clearest: P(C) − P("
    )
    assert re.search(r"= 1 \[.*\] \(two hands, C and E\), p = 0.002, Holm p = 0.012", told["a2"])
    assert "Yes, in 4 of 6 tests: one zone is chosen more than the other for at least one participant." in told["a2"]
    assert "changes with the level for at least one participant: none of 6 tests could reach p ≤ 0.05." in told["b"]
    assert told["e"].startswith("Gwet AC1 from 0.")
    assert re.match(r"P\(C\) from 0.* to 1 .*; P\(B\) from 0.[12].* to 0.[12]\S* \[[^;]*\.", told["f"])
    rows = find(count_answers(paper_frame), paper_frame)
    (row,) = [row for row in rows if (row.family, row.scope) == ("a2 mean", "one_hand C-E")]
    assert row.note == "38 C, 0 E, 2 both of 40 answers; 10 of 10 participants lean to C"


@pytest.mark.parametrize(
    ("scope", "words"),
    [
        ("one_hand A-C 80 mm/s", "one hand, A and C, 80 mm/s"),
        ("one_hand - two_hands C-E", "one hand against two hands, C and E"),
        ("two_hands A-C - B-D", "two hands, A and C against B and D"),
        ("one_hand A-C, B-D - C-E", "one hand, A and C, B and D against C and E"),
        ("one_hand A-C 1.5 x threshold", "one hand, A and C, 1.5 x threshold"),
        ("two_hands A-C sharp - A-C blunt", "two hands, A and C, sharp against A and C, blunt"),
        ("one_hand A-C slow - A-C usual", "one hand, A and C, slow against A and C, usual"),
        ("high - low", "high against low"),
        ("all", "all"),
    ],
)
def test_conditions_and_zones_are_written_out(paper_frame, scope, words) -> None:
    """Sentences contain no file or key names."""
    answers = count_answers(paper_frame)
    assert scope_in_words(scope, answers.finger_conditions, answers.pairs) == words


def test_differences_have_minus_signs_in_sentences_and_tables(paper_frame) -> None:
    """A hyphen joins zones, as in A-C; in JSON the quantity keeps it, as programs read it."""
    answers = count_answers(paper_frame)
    rows = [row for row in find(answers, paper_frame) if row.question == "a2"]
    (table,) = list_questions(rows, answers)
    assert rows[0].quantity == "P(C) - P(A)"
    assert "P(C) − P(E) = " in table["answer"] and " - " not in table["answer"]
    assert table["parts"][0]["lines"][0]["quantity"] == "P(C) − P(A)"


def test_families_and_their_error_rates_are_stated_once(paper_frame) -> None:
    """Nine families at 5 % each give 45 % over all of them by Bonferroni's inequality."""
    stated = state_families(find(count_answers(paper_frame), paper_frame))
    assert "a1 (24), a2 (6), a2 mean (6), b (6), b mean (6), c (6), c mean (6), d (6), d mean (6)" in stated
    assert "over all 9, that probability is 45 % at most" in stated


def test_every_p_is_corrected_or_exploratory(paper_frame) -> None:
    """The role of a row follows from its p values."""
    rows = find(count_answers(paper_frame), paper_frame)
    roles = {row.role: [each for each in rows if each.role == row.role] for row in rows}
    assert all(row.p_holm >= row.p for row in roles["confirmatory"])
    assert all(row.p == row.p and row.p_holm != row.p_holm for row in roles["exploratory"])
    assert all(row.p != row.p for row in roles["estimate"])


def test_absence_of_evidence_is_not_evidence_of_absence(paper_frame) -> None:
    """Levels and finger conditions: no information is stated as such, equivalence only within its margin."""
    told = paragraphs(paper_frame)
    assert "not evidence that the level does not matter" in told["b"]
    assert "does not show that the conditions are alike" in told["c"]


def test_too_few_participants_for_the_cells_are_noted(build) -> None:
    """With three participants even unanimous cells have p = 3^-2, which cannot pass Holm over 24."""
    rows = find(count_answers(build["tidy"](build["paper"](3))), build["tidy"](build["paper"](3)))
    assert all("cannot pass Holm's correction" in row.note or row.p_min > 0.05 for row in rows if row.family == "a1")


def test_tests_that_cannot_pass_the_correction_are_not_called_not_shown(build) -> None:
    """Six participants who all lean alike: 2/2^6 = 0.031 is below 0.05, but not below a sixth of it."""
    told = paragraphs(build["tidy"](build["paper"](6)))
    said = (
        "The data cannot tell whether one zone is chosen more than the other for at least one participant: none of 6 "
    )
    assert said + "tests could reach p ≤ 0.05 after Holm's correction." in told["a2"]
    assert "Not shown" not in told["a2"]


def test_one_level_and_one_participant_are_stated(build) -> None:
    """One level has no trend test, which would count in the correction; one participant has no agreement."""
    frame = build["tidy"](build["paper"](1))
    told = paragraphs(frame[frame["velocity_mm_s"] == 80])
    assert "b" not in told
    assert "Only one participant" in told["e"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.1234, "0.123"), (-0.5, "−0.5"), (0.0, "0"), (float("inf"), "∞"), (float("nan"), "–"), (3e-308, "< 1e-300")],
)
def test_numbers_have_three_digits(value, text) -> None:
    """Rule of the tables in the report."""
    assert format_number(value) == text


@pytest.mark.parametrize(("p", "text"), [(0.0499, "= 0.05"), (0.0000001, "< 0.001"), (1.0, "= 1")])
def test_p_values_are_formatted_as_in_a_paper(p, text) -> None:
    """Two digits; below 0.001 a bound."""
    assert format_p(p) == text


def test_speeds_under_the_fingers_are_listed_by_level() -> None:
    """One number if all sessions agree, otherwise the range; no row without predicted speeds."""
    rows = [("two_hands", "A", "C", 80.0, 49.2, 80.4), ("two_hands", "A", "C", 80.0, 51.0, 80.1),
            ("two_hands", "C", "E", 200.0, 200.0, 123.0)]  # fmt: skip
    columns = ["finger_condition", "zone_left", "zone_right", "velocity_mm_s", "speed_left_mm_s", "speed_right_mm_s"]
    frame = pd.DataFrame(rows, columns=columns)
    assert speed_rows(frame) == [
        {"finger_condition": "two hands", "pair": "A and C", "cells": ["49\u201351 | 80", ""]},
        {"finger_condition": "two hands", "pair": "C and E", "cells": ["", "200 | 123"]},
    ]
    assert speed_rows(frame.drop(columns="speed_left_mm_s")) == []


def test_a_level_without_a_delivered_speed_has_an_empty_cell() -> None:
    """Of two levels the lower one's speed is unknown; if none is known, there is no table."""
    frame = pd.DataFrame({
        "finger_condition": "two_hands", "zone_left": "A", "zone_right": "C", "velocity_mm_s": [80.0, 200.0],
        "delivered_mm_s": [math.nan, 190.0],
    })  # fmt: skip
    assert [row["cells"] for row in delivered_rows(frame)] == [["", "190"]]
    assert delivered_rows(frame.assign(delivered_mm_s=math.nan)) == []


def test_every_test_and_interval_has_its_certificate(paper_frame) -> None:
    """Each row with a p or bounds has certificates of 200 populations; a failing one has a reason."""
    table = json.loads((Path(__file__).parents[2] / "results/benchmarks/certify.json").read_text(encoding="utf-8"))
    rows = find(count_answers(paper_frame, margin=0.2), paper_frame)
    named = {name for row in rows if row.p == row.p or row.low == row.low for name in certificates_of(row) or [row]}
    assert {"a1", "a1 share"} <= named <= set(table["certificates"])
    assert named >= {"a1", "a2", "a2 mean", "c alike", "agreement", "share", "paired difference"}
    assert len(table["populations"]) >= 200
    # The template of the certificates says that up to 7.4 % may be chance: 148 of 2,000, with a bound for all rows.
    level = 1 - 2 * 0.05 / sum(len(each["errors"]) for each in table["certificates"].values())
    assert (clopper_pearson([148, 149], 2000, level).low > 0.05).tolist() == [False, True]
    for name, each in table["certificates"].items():
        assert len(each["errors"]) == len(table["populations"])
        mean, worst, why = certificates()[name]
        assert (mean, worst) == pytest.approx((each["mean_rate"], each["worst_rate"]), abs=1e-5)
        assert bool(why) == bool(each["fails"])
        assert certificates_in_words([name]).endswith(f" %, so not a 95 % interval: {why}" if why else " %")
    assert "at worst 99.9 %, so not a 95 % interval: spreads fitted to few trials" in certificates_in_words(
        ["mean JND"]
    )


def estimated(name: str) -> tuple[str, str]:
    """Return the certificates of a mean: as estimated, and of the true mean."""
    return f"{name}, as estimated", name


@pytest.mark.parametrize(
    ("question", "name", "note", "certified"),
    [
        ("group", "exponent of magnitude between groups, permutation test of participants", "", ("group",)),
        ("group", "JND between groups, permutation test of participants", "", ("group",)),
        ("rating", "exponent of magnitude compared, sign flips", "", estimated("mean exponent compared")),
        ("rating", "exponent of size over participants, sign flips", "", estimated("mean exponent")),
        ("rating", "size over participants, sign flips", "geometric mean", estimated("mean magnitude")),
        ("rating", "threshold over participants, sign flips", "", ("mean rating without ends",)),
        ("rating", "certain over participants, bounded mean", "", ("mean rating",)),
        ("rating", "P(kind: rough) over participants, bounded mean", "", ("share",)),
        ("rating", "misses compared, signed ranks", "", ("rank", "rank interval")),
        ("rating", "leaning over participants, bounded mean", "", ("mean rating",)),
        ("function", "PSE compared, sign flips", "", estimated("mean PSE compared")),
        ("function", "PSE over participants, sign flips", "geometric mean", estimated("mean PSE")),
        ("function", "detection threshold compared, sign flips", "", estimated("mean detection threshold compared")),
        ("threshold", "threshold compared, sign flips", "", ()),
        ("shares", "P(both) compared, sign flips", "", ("shares compared",)),
        ("shares", "P(both) compared, mean over participants, test and interval of a bounded mean", "", ("c mean",)),
        ("sensitivity", "d' compared, sign flips", "yes-no model", estimated("mean d' compared")),
        ("sensitivity", "d' compared, sign flips", "3AFC model", estimated("mean d' compared, of three")),
        (
            "sensitivity", "d' over participants, sign flips, p by those of the rates", "2AFC model",
            ("d'", *estimated("mean d'")),
        ),
        (
            "sensitivity", "d' over participants, sign flips, p by those of the rates", "triangular (odd one of three)",
            ("d', of three", *estimated("mean d', odd of three")),
        ),
        ("sensitivity", "criterion compared, sign flips", "", estimated("mean criterion compared")),
        ("sensitivity", "differencing criterion compared, sign flips", "",
         estimated("mean differencing criterion compared")),
        ("b", "all answers together over levels, shuffles within participants", "", ("b together",)),
        ("c", "all answers together, shuffles within participants", "", ("c together",)),
        ("a1", "share in a cell, exact interval", "", ("a1 share",)),
        ("catch", "false alarms, interval of a bounded mean over participants", "", ("share",)),
        ("time", "exact sign-flip test of median reaction times", "", ("time",)),
    ],
)  # fmt: skip
def test_each_test_has_the_certificate_of_its_kind(question, name, note, certified) -> None:
    """The name of the test or interval decides, even if a measure or question contains the name of another."""
    assert certificates_of(Finding(question, name, "", "", 0.0, 0.0, 0.0, 8, note=note)) == certified
    assert set(certified) <= set(certificates())


def test_a_table_lists_the_certificates_of_its_numbers(paper_frame) -> None:
    """A row without a number has none, so the first row with one decides."""
    answers = count_answers(paper_frame)
    name = "d' over participants, sign flips, p by those of the rates"
    rows = [
        Finding("sensitivity", name, "", "d'", math.nan, math.nan, math.nan, 0, note="no d' from answers"),
        Finding("sensitivity", name, "", "d'", 1.0, 0.0, 2.0, 8, note="3AFC model"),
    ]
    tables = list_questions(rows, answers)
    assert tables[0]["parts"][0]["certificate"] == certificates_in_words(certificates_of(rows[1]))
    assert list_questions(rows[:1], answers)[0]["parts"][0]["certificate"] == ""
