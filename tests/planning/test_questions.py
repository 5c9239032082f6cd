"""The test families of simulated experiments, against the analysis of the same answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.findings import Finding, correct, holm
from modaltouch.analysis.statistics import STATISTICS, family_findings
from modaltouch.planning.design import Design
from modaltouch.planning.experiments import Job, count_significant, simulate
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant

UNSURE = Observer(Participant(noise=0.5, criterion=0.4, lapse_rate=0.1))


def analysed(answers: AnswerCounts, experiment: int) -> list[Finding]:
    """Return the findings of the analysis of one simulated experiment."""
    alone = replace(answers, counts=answers.counts[experiment])
    return correct(finding for family in STATISTICS for finding in family_findings(family, alone))


@pytest.mark.parametrize(("n_participants", "n_repetitions"), [(9, 1), (7, 3)])
def test_every_test_agrees_with_the_analysis(design: Design, n_participants: int, n_repetitions: int) -> None:
    """The p value, Holm's p, scope and interval width equal those of the analysis, row by row, for the same answers."""
    answers = simulate(design, UNSURE, Job(n_participants, n_repetitions, 0, 4), np.random.default_rng(1))
    for family, statistic in STATISTICS.items():
        found = statistic.compute(answers)
        assert found is not None
        for experiment in range(4):
            theirs = [row for row in analysed(answers, experiment) if row.family == family]
            assert [scope for scope, _ in design.tests[family]] == [row.scope for row in theirs]
            assert found.test.quick_p[experiment] == pytest.approx([row.p for row in theirs], abs=1e-13)
            assert holm(found.test.quick_p)[experiment] == pytest.approx([row.p_holm for row in theirs], abs=1e-12)
            expected = [(row.high - row.low) / 2 for row in theirs]
            assert found.interval.half_width[experiment] == pytest.approx(expected, abs=1e-12, nan_ok=True)


def test_the_papers_design_has_these_tests(design: Design) -> None:
    """6 tests of dominance, 6 of level, 6 of hand (dominant zone and both), 6 of pair, and 24 cells."""
    assert {family: len(design.tests[family]) for family in STATISTICS} == {
        "a1": 24, "a2": 6, "a2 mean": 6, "b": 6, "b mean": 6, "c": 6, "c mean": 6, "c alike": 6, "d": 6, "d mean": 6,
    }  # fmt: skip


def test_scopes_of_a_family_are_unique(design: Design) -> None:
    """Plans are added up by scope, such as one hand against two on (A, C): the dominant zone, or both."""
    for family in STATISTICS:
        assert len({scope for scope, _ in design.tests[family]}) == len(design.tests[family])
    assert "one_hand - two_hands A-C both" in dict(design.tests["c"])


def test_a_design_of_one_cell_tests_chance_and_dominance_only(small_design: Design) -> None:
    """These are a1, a2 and its mean; one level has no trend."""
    assert [family for family in STATISTICS if small_design.tests[family]] == ["a1", "a2", "a2 mean"]


def test_tests_that_a_design_does_not_have_are_refused(small_design: Design) -> None:
    """With one finger condition there are no tests between conditions to count."""
    answers = simulate(small_design, UNSURE, Job(9, 1, 0, 5), np.random.default_rng(1))
    with pytest.raises(ValueError, match="no tests of c for 1 finger conditions"):
        count_significant(answers, "c")
