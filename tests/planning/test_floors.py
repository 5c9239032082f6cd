"""The fewest participants with whom a test can be significant."""

from __future__ import annotations

from itertools import combinations_with_replacement, product

import numpy as np
import pytest

from modaltouch.analysis.counts import Pair
from modaltouch.analysis.exact import smallest_trend_p, trend_test
from modaltouch.planning.design import Design
from modaltouch.planning.experiments import Job, Study, run_job
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant
from modaltouch.planning.power import find_floor


@pytest.mark.parametrize(("family", "least"), [("a2", 8), ("a2 mean", 8), ("d", 8), ("c", 8), ("a1", 7)])
def test_the_floor_is_the_size_whose_smallest_p_passes_holm(design: Design, family: str, least: int) -> None:
    """2/2^N times 6 tests and 3/3^N times 24 give N = 8 and 7 (statistics plan: N >= 8 with Holm over six)."""
    assert find_floor(design, family, 1).least_participants == least


@pytest.mark.parametrize("n_participants", [1, 2, 3])
def test_the_smallest_trend_p_is_the_minimum_over_all_answers(design: Design, n_participants: int) -> None:
    """Reference: the minimum over all answers of up to three participants at four levels, enumerated here."""
    ways = np.array([[(code >> k) & 1 for k in range(4)] for code in range(16)])
    every = combinations_with_replacement(range(16), n_participants)
    smallest = min(trend_test(ways[list(codes)], design.levels).p for codes in every)
    assert smallest_trend_p(design.levels, n_participants, 1) == pytest.approx(smallest, rel=1e-9)


def test_the_smallest_trend_p_with_repetitions_is_the_minimum_over_all_answers() -> None:
    """Reference: the minimum over all answers of two participants at three levels, twice each, enumerated here."""
    design = Design("x", ("one_hand",), (Pair.of("A", "C", "C"),), (80.0, 100.0, 200.0), np.ones((1, 1, 3, 2)))
    ways = np.array(list(product(range(3), repeat=3)))
    smallest = min(trend_test(ways[[i, j]], design.levels, 2).p for i in range(27) for j in range(i, 27))
    assert smallest_trend_p(design.levels, 2, 2) == pytest.approx(smallest, rel=1e-9)


def test_power_is_zero_below_the_floor_and_one_at_it(design: Design) -> None:
    """With an observer who never errs, power is 0 at N = 7 and 1 at N = 8."""
    sure = Observer(Participant(noise=1e-6, criterion=0.01, lapse_rate=0.0), 0, 0, 0, 0)
    study = Study(design, sure, ("a2",), null=False, seed=1)
    assert run_job(study, Job(7, 1, 0, 20))["a2"].any_test == 0
    assert run_job(study, Job(8, 1, 0, 20))["a2"].any_test == 20


def test_one_level_can_never_show_a_trend(small_design: Design) -> None:
    """The p value is always 1, at any number of participants."""
    assert smallest_trend_p(small_design.levels, 50, 1) == 1.0
    assert find_floor(small_design, "b", 1).least_participants is None
