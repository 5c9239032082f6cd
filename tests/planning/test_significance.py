"""Exact tests by the thousand, against the same tests one by one and against enumeration."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from modaltouch.analysis.exact import multinomial_test, sign_flip_test
from modaltouch.analysis.findings import holm
from modaltouch.analysis.trend import trend_test
from modaltouch.planning.significance import holm_p, multinomial_p, sign_flip_p, trend_p


@settings(max_examples=60, deadline=None)
@given(arrays(np.int64, st.tuples(st.integers(1, 5), st.integers(1, 14)), elements=st.integers(-9, 9)))
def test_sign_flips_equal_the_analysis_bit_by_bit(scores: np.ndarray) -> None:
    """Expected: `sign_flip_test`, whose p is a whole number of 2^-N; no error at all up to forty participants."""
    assert sign_flip_p(scores).tolist() == [sign_flip_test(row).p for row in scores]


def test_sign_flips_equal_enumeration() -> None:
    """Expected: the share of all 2^7 sign patterns whose sum is as far from zero, counted here."""
    scores = np.array([3, -1, 4, 1, -5, 9, 2])
    sums = np.array([np.dot(signs, scores) for signs in product((-1, 1), repeat=7)])
    assert sign_flip_p(scores) == pytest.approx(np.mean(np.abs(sums) >= abs(scores.sum())), abs=0)


@pytest.mark.parametrize(("n_participants", "largest"), [(41, 4), (60, 16), (200, 4)])
def test_many_participants_keep_their_p(n_participants: int, largest: int) -> None:
    """Expected: `sign_flip_test` within 1e-13, where p no longer lies on a grid that rounding can tell."""
    rng = np.random.default_rng(n_participants)
    scores = rng.integers(-largest, largest + 1, (20, n_participants))
    assert sign_flip_p(scores) == pytest.approx([sign_flip_test(row).p for row in scores], abs=1e-13)


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_trends_equal_the_analysis(data: st.DataObject) -> None:
    """Expected: `trend_test`, any number of participants, levels and repetitions."""
    levels = data.draw(st.lists(st.sampled_from([5.0, 20.0, 80.0, 92.5, 100.0, 150.0, 200.0]), min_size=1, max_size=5))
    n_repetitions = data.draw(st.integers(1, 4))
    shape = (3, data.draw(st.integers(1, 12)), len(levels))
    chosen = data.draw(arrays(np.int64, shape, elements=st.integers(0, n_repetitions)))
    expected = [trend_test(rows, levels, n_repetitions).p for rows in chosen]
    assert trend_p(chosen, levels, n_repetitions) == pytest.approx(expected, abs=1e-13)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(*[st.integers(0, 12)] * 3), min_size=1, max_size=6))
def test_multinomial_tests_equal_the_analysis(counts: list[tuple[int, int, int]]) -> None:
    """Expected: `multinomial_test`, with totals that differ from test to test, zero among them."""
    assert multinomial_p(counts) == pytest.approx([multinomial_test(row).p for row in counts], rel=1e-12)


@given(arrays(float, (3, 6), elements=st.floats(0, 1)))
def test_holm_equals_the_analysis(p: np.ndarray) -> None:
    """Expected: `findings.holm`, ties and all."""
    assert holm_p(p) == pytest.approx(np.array([holm(row.tolist()) for row in p]), abs=0)


def test_no_answer_leaves_no_information() -> None:
    """Expected: p 1 where all scores are zero, all answers the same, or there is one level."""
    assert sign_flip_p(np.zeros((2, 5), dtype=int)).tolist() == [1.0, 1.0]
    assert trend_p(np.full((2, 5, 4), 3), [80, 100, 150, 200], 3).tolist() == [1.0, 1.0]
    assert trend_p(np.ones((2, 5, 1), dtype=int), [80], 2).tolist() == [1.0, 1.0]


def test_levels_far_from_a_common_grid_stay_affordable() -> None:
    """Expected: `trend_test`, where levels take a thousand steps."""
    levels = [80.001, 99.997, 150.003, 199.999]
    chosen = np.random.default_rng(2).integers(0, 2, (4, 15, 4))
    assert trend_p(chosen, levels) == pytest.approx([trend_test(rows, levels).p for rows in chosen], abs=1e-12)
