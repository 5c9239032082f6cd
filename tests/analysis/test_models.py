"""Mixed models: the table and script for R, and the logistic model against lme4."""

from __future__ import annotations

import csv
import math
import warnings

import numpy as np
import pandas as pd
import pytest
from statsmodels.genmod.bayes_mixed_glm import BinomialBayesMixedGLM

from modaltouch.analysis import models
from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.models import model_files, model_findings
from modaltouch.analysis.pipeline import analyse
from modaltouch.analysis.responses import AnswerSource, Responses
from modaltouch.protocol import AnswerList

GLMER = {
    "intercept": (1.22850, 0.25736),
    "two_hands - one_hand": (-0.23895, 0.15099),
    "B-D - A-C": (-2.24026, 0.19964),
    "C-E - A-C": (-0.50188, 0.18094),
    "level, per 100 mm/s": (0.51877, 0.16342),
}
"""Estimates and standard errors of glmer(dominant ~ pair + finger_condition + level + (1 | participant), binomial) on
the table of `spread_answers`, of lme4 1.1-31 in R 4.2.2."""


def spread_answers() -> pd.DataFrame:
    """Return two answers of 20 participants in each cell, from a mixed logistic model with a spread of 1 logit."""
    rng, rows = np.random.default_rng(3), []
    for i in range(20):
        own = rng.normal(0, 1)
        for condition in ("one_hand", "two_hands"):
            for (left, right), effect in ((("A", "C"), 1.5), (("B", "D"), -1.0), (("C", "E"), 1.0)):
                for level, centred in ((80, -0.6), (100, -0.4), (150, 0.1), (200, 0.6)):
                    for _ in range(2):
                        odds = effect + own + 0.5 * centred - 0.3 * (condition == "two_hands")
                        dominant = "right" if right == "C" else "left"
                        response = dominant if rng.random() < 1 / (1 + np.exp(-odds)) else "both"
                        rows.append((f"p{i:02}", condition, left, right, float(level), response, 1))
    names = ["participant", "finger_condition", "zone_left", "zone_right", "velocity_mm_s", "response", "n"]
    return pd.DataFrame(rows, columns=names)


@pytest.fixture(scope="module")
def frame() -> pd.DataFrame:
    """The answers that R was given."""
    return spread_answers()


def test_coefficients_agree_with_lme4(frame) -> None:
    """Within a third of a standard error, due to the priors and the joint mode; standard errors within a tenth."""
    rows = {row.scope: row for row in model_findings(count_answers(frame), frame)}
    assert list(rows) == list(GLMER) and all(math.isnan(row.p) for row in rows.values())
    for scope, (estimate, error) in GLMER.items():
        row = rows[scope]
        assert row.estimate == pytest.approx(estimate, abs=error / 3), scope
        assert "priors normal, 5 and 0.5 logit wide" in row.note
        assert (row.high - row.low) / (2 * 1.959964) == pytest.approx(error, rel=0.1), scope


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda rows: rows["response"].where(rows["zone_left"] != "B", "both"), "the answers are split by B-D - A-C"),
        (lambda rows: "both", "all answers are alike"),
    ],
)
def test_separated_answers_are_refused_with_the_reason(frame, change, reason) -> None:
    """Albert and Anderson (1984): the likelihood has no finite maximum."""
    table = frame.assign(response=change(frame))
    (row,) = model_findings(count_answers(table), table)
    assert math.isnan(row.estimate)
    assert f"not fitted: separation: {reason}" in row.note


def test_one_participant_has_no_random_intercept(frame) -> None:
    """The participant's effect cannot be separated from that of the others."""
    alone = frame[frame["participant"] == "p03"]
    (row,) = model_findings(count_answers(alone), alone)
    assert "only one participant" in row.note


def test_an_interval_holds_95_percent_of_a_normal_posterior(frame, monkeypatch) -> None:
    """1.959964 posterior standard deviations either way of the mode (standard normal table)."""
    monkeypatch.setattr(models, "_fit", lambda *_: ([0.5] * 5, [0.25] * 5, 1.0))
    for row in model_findings(count_answers(frame), frame):
        assert (row.estimate, row.low, row.high) == pytest.approx((0.5, 0.5 - 0.489991, 0.5 + 0.489991), abs=1e-6)


def test_zones_are_those_that_answers_can_name(frame) -> None:
    """Without an answer for both fingers there is no such level of the ordered response."""
    given = Responses(frame, (), (), AnswerSource("", "csv", ""))
    assert 'c("other", "both", "dominant")' in model_files(count_answers(frame), given)["models.R"]
    answers = AnswerList.of({"keys": {"left": ["a"], "right": ["b"]}})
    named = frame[frame["response"] != "both"]
    assert 'c("other", "dominant")' in model_files(count_answers(named, offered=answers), given)["models.R"]


@pytest.mark.parametrize("fault", ["a warning", "no spread"])
def test_a_fit_that_does_not_converge_gives_no_coefficients(frame, monkeypatch, fault) -> None:
    """Neither where statsmodels only warns of it, nor where a posterior has no spread."""
    fit = BinomialBayesMixedGLM.fit_map

    def fail(self, **given):
        fitted = fit(self, **given)
        if fault == "a warning":
            warnings.warn("Optimization failed to converge", stacklevel=1)
        else:
            fitted.fe_sd[0] = np.nan
        return fitted

    monkeypatch.setattr(BinomialBayesMixedGLM, "fit_map", fail)
    (row,) = model_findings(count_answers(frame), frame)
    assert math.isnan(row.estimate)
    assert row.note == "not fitted: the fit did not converge"


def test_groups_are_a_column_and_a_term(frame) -> None:
    """Every answer stands beside the group of who gave it."""
    grouped = frame.assign(group=np.where(frame["participant"] < "p07", "young", "old"))
    given = Responses(grouped, (), (), AnswerSource("", "csv", ""))
    files = model_files(count_answers(grouped), given)
    rows = csv.DictReader(files["answers.csv"].splitlines())
    assert [(row["participant"], row["group"]) for row in rows] == [
        *zip(grouped["participant"], grouped["group"], strict=True)
    ]
    assert "dominant ~ group + finger_condition + pair + level + (1 | participant)" in files["models.R"]


def test_what_no_row_has_is_no_column(frame) -> None:
    """A stimulus without a name; a single answer, of which nothing can be chosen; a row each for equal answers."""
    few = frame[frame["velocity_mm_s"] == 80].assign(stimulus="", n=2, response="left")
    answers = AnswerList.of({"keys": {"left": ["a"]}})
    counts = count_answers(few, offered=answers)
    files = model_files(counts, Responses(few, (), (), AnswerSource("", "csv", ""), answers=answers))
    rows = list(csv.DictReader(files["answers.csv"].splitlines()))
    assert len(rows) == 2 * len(few)
    assert list(rows[0]) == ["participant", "finger_condition", "pair", "velocity_mm_s", "level", "response"]
    named = model_files(
        counts, Responses(few.assign(stimulus="x"), (), (), AnswerSource("", "csv", ""), answers=answers)
    )
    assert next(csv.DictReader(named["answers.csv"].splitlines()))["stimulus"] == "x"


def test_an_analysis_writes_the_table_and_the_script(paper_csv, tmp_path) -> None:
    """Every answer has its zone, the formula has the factors that vary, and the model is fitted on request."""
    found = analyse(paper_csv, tmp_path / "out", model=True)
    rows = list(csv.DictReader(found.files["answers.csv"].read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 240
    assert sum(row["zone"] == "both" for row in rows) == int((found.responses.frame["response"] == "both").sum())
    script = found.files["models.R"].read_text(encoding="utf-8")
    assert "lme4::glmer(\n  dominant ~ finger_condition + pair + level + (1 | participant)" in script
    assert "ordinal::clmm(\n  zone ~ finger_condition" in script and "brms::brm(" in script
    # Else R would take the participants 1 and 01 for one number, hence for one person.
    kinds = '"participant" = "factor", "finger_condition" = "factor", "pair" = "factor", "response" = "factor", "zone"'
    assert f'colClasses = c(\n{kinds} = "factor"\n))' in script
    assert {row.question for row in found.findings} >= {"model"}
    assert "What does a mixed model say?" in found.files["report.html"].read_text(encoding="utf-8")


def test_a_rating_counts_even_if_the_answer_has_no_zone(frame) -> None:
    """One answer in ten is none: its row has no zone in the table, but its rating for the models of ratings."""
    answers = AnswerList.of_words(("none",))
    response = frame["response"].astype(str).where(np.arange(len(frame)) % 10 > 0, "none")
    rated = frame.assign(sure=3, response=pd.Categorical(response, [*answers.names]))
    given = Responses(
        rated, (), (), AnswerSource("", "csv", ""), answers=answers, design={"answers": {"then": {"sure": {}}}}
    )
    counts = count_answers(rated, offered=answers)
    files = model_files(counts, given)
    rows = list(csv.DictReader(files["answers.csv"].splitlines()))
    silent = [row for row in rows if row["response"] == "none"]
    assert (len(rows), len(silent)) == (len(frame), math.ceil(len(frame) / 10))
    assert {(row["zone"], row["dominant"], row["sure"]) for row in silent} == {("", "", "3")}
    assert {row["dominant"] for row in rows} - {""} == {"0", "1"}
    assert "dominant ~" in files["models.R"] and "data = named, family = binomial" in files["models.R"]
    assert "(1 | participant), data = answers\n" in files["models.R"]
    assert [row.name for row in model_findings(counts, rated) if math.isfinite(row.estimate)]


def test_answers_of_intervals_have_a_table_and_a_script() -> None:
    """For two intervals: the choice, its interval and the confidence; group and level vary and have a term."""
    rows = [
        {"participant": who, "group": who, "finger_condition": "one_hand", "zone_left": "A", "zone_right": "C", "n": 1,
         "velocity_mm_s": level, "interval": 1 + level // 100, "response": "first", "sure": "low"}
        for who in ("p1", "p2") for level in (80, 120)
    ]  # fmt: skip
    section = {"keys": {"first": ["a"], "second": ["b"]}, "intervals": {"first": 1, "second": 2}}
    further = {"sure": {"keys": {"low": ["c"], "high": ["d"]}}}
    design = {
        "answers": {**section, "then": further},
        "intervals": {"number": 2, "standard": {"velocity_mm_s": 100}, "asked": "stronger"},
    }
    frame = pd.DataFrame(rows)
    frame["response"] = pd.Categorical(frame["response"], ["first", "second"])
    answers = AnswerList.of(section)
    given = Responses(frame, (), (), AnswerSource("", "csv", ""), answers=answers, design=design)
    files = model_files(given.by_choice().count(), given)
    table = list(csv.DictReader(files["answers.csv"].splitlines()))
    assert [row["response"] for row in table] == ["comparison", "standard"] * 2
    assert [row["sure"] for row in table] == ["low"] * 4
    assert [row["interval"] for row in table] == ["1", "2"] * 2
    assert [row["chosen"] for row in table] == ["1", "0"] * 2, "of the first answer, which the script names"
    assert "glmer(\n  chosen ~ group + level + (1 | participant)" in files["models.R"]
    assert 'glmer(\n  (`sure` == "high") ~ group + level + (1 | participant)' in files["models.R"]
    assert "ordered(`sure`)" not in files["models.R"]  # the answers of a list have no order


def test_a_factor_that_does_not_vary_has_no_term(frame) -> None:
    """The data have one pair under one finger condition."""
    alone = frame[(frame["zone_left"] == "A") & (frame["finger_condition"] == "one_hand")]
    given = Responses(
        alone.assign(sure=3), (), (), AnswerSource("", "csv", ""), design={"answers": {"then": {"sure": {}}}}
    )
    files = model_files(count_answers(alone), given)
    assert "dominant ~ level + (1 | participant)" in files["models.R"]
    assert {row["sure"] for row in csv.DictReader(files["answers.csv"].splitlines())} == {"3"}
    assert "clmm(\n  ordered(`sure`) ~ level + (1 | participant)" in files["models.R"]
