"""The families of tests, against the analysis of the very same answers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.findings import Finding, correct
from modaltouch.analysis.statistics import (
    chance_findings,
    condition_findings,
    dominance_findings,
    level_findings,
    pair_findings,
)
from modaltouch.planning.design import Design
from modaltouch.planning.experiments import Job, simulate
from modaltouch.planning.observer import Observer, Participant
from modaltouch.planning.questions import FAMILIES, SimulatedAnswers, half_widths, p_values
from modaltouch.planning.significance import holm_p

UNSURE = Observer(Participant(noise=0.5, criterion=0.4, lapse_rate=0.1))


def analysed(answers: SimulatedAnswers, experiment: int) -> list[Finding]:
    """Return what the analysis finds in one simulated experiment."""
    left, right = answers.left[experiment], answers.right[experiment]
    counts = np.stack([left, answers.n_repetitions - left - right, right], axis=-1)
    design, n = answers.design, len(left)
    whole = AnswerCounts(
        tuple(f"p{i}" for i in range(n)),
        design.finger_conditions,
        design.pairs,
        design.levels,
        counts,
        answers.n_repetitions,
        "C",
    )
    questions = (chance_findings, dominance_findings, level_findings, condition_findings, pair_findings)
    return correct(finding for question in questions for finding in question(whole))


@pytest.mark.parametrize(("n_participants", "n_repetitions"), [(9, 1), (7, 3)])
def test_every_test_is_that_of_the_analysis(design: Design, n_participants: int, n_repetitions: int) -> None:
    """Expected: p, Holm's p, scope and width of `analysis.questions`, row by row, for the same answers."""
    answers = simulate(design, UNSURE, Job(n_participants, n_repetitions, 0, 4), np.random.default_rng(1))
    ours = {family: p_values(answers, family) for family in FAMILIES}
    widths = {family: half_widths(answers, family) for family in FAMILIES}
    for experiment in range(4):
        rows = [row for row in analysed(answers, experiment) if row.family]
        assert [row.family for row in rows if row.family == "b"] == ["b"] * 6
        for family in FAMILIES:
            theirs = [row for row in rows if row.family == family]
            assert list(design.scopes(family)) == [row.scope for row in theirs]
            assert ours[family][experiment] == pytest.approx([row.p for row in theirs], abs=1e-13)
            assert holm_p(ours[family])[experiment] == pytest.approx([row.p_holm for row in theirs], abs=1e-12)
            expected = [(row.high - row.low) / 2 for row in theirs]
            assert widths[family][experiment] == pytest.approx(expected, abs=1e-6)


def test_the_papers_design_has_twenty_one_exact_tests(design: Design) -> None:
    """Tests: 6 of dominance, 6 of level, 3 of hand, 6 of pair; and 24 cells, 3 of both by hand."""
    assert {family: len(design.scopes(family)) for family in FAMILIES} == {
        "a1": 24, "a2": 6, "b": 6, "c": 3, "c both": 3, "d": 6,
    }  # fmt: skip


def test_a_design_of_one_cell_has_two_tests(small_design: Design) -> None:
    """Expected: chance and dominance; a trend of one level says nothing and has no interval."""
    answers = simulate(small_design, UNSURE, Job(9, 1, 0, 5), np.random.default_rng(1))
    assert [family for family in FAMILIES if small_design.scopes(family)] == ["a1", "a2", "b"]
    assert (p_values(answers, "b") == 1).all()
    assert all(math.isnan(width) for width in half_widths(answers, "b")[:, 0])
