"""Tests and intervals of many experiments together, against each alone and against enumeration."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from modaltouch.analysis.exact import multinomial_test, sign_flip_test, sign_test, trend_test
from modaltouch.analysis.intervals import BoundedMean, Interval, clopper_pearson


@settings(max_examples=60, deadline=None)
@given(arrays(np.int64, st.tuples(st.integers(1, 5), st.integers(1, 14)), elements=st.integers(-9, 9)))
def test_quick_sign_flips_equal_convolution_bit_by_bit(scores: np.ndarray) -> None:
    """Each row equals the row alone, whose p is a multiple of 2^-N; up to forty participants without any error."""
    test = sign_flip_test(scores)
    assert test.quick_p.tolist() == test.p.tolist() == [sign_flip_test(row).p for row in scores]
    assert sign_test(scores).quick_p.tolist() == [sign_test(row).p for row in scores]


def test_quick_sign_flips_equal_enumeration() -> None:
    """The p value is the share of all 2^7 sign patterns whose sum is as far from zero, counted here."""
    scores = np.array([3, -1, 4, 1, -5, 9, 2])
    sums = np.array([np.dot(signs, scores) for signs in product((-1, 1), repeat=7)])
    assert sign_flip_test(scores).quick_p == pytest.approx(np.mean(np.abs(sums) >= abs(scores.sum())), abs=0)


def test_forty_participants_have_exactly_the_p_of_convolution() -> None:
    """The p value is a multiple of 2^-40, which a transform alone misses by rounding."""
    test = sign_flip_test(np.random.default_rng(40).choice([-3, -2, -1, 1, 2, 3], (20, 40)))
    assert test.quick_p.tolist() == test.p.tolist()


@pytest.mark.parametrize(("n_participants", "largest"), [(41, 4), (60, 16), (200, 4)])
def test_quick_p_of_many_participants_is_accurate(n_participants: int, largest: int) -> None:
    """It agrees with `p` within 1e-13, where p is no longer on a grid that rounding resolves."""
    rng = np.random.default_rng(n_participants)
    test = sign_flip_test(rng.integers(-largest, largest + 1, (20, n_participants)))
    assert test.quick_p == pytest.approx(test.p, abs=1e-13)


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_quick_trends_equal_convolution(data: st.DataObject) -> None:
    """Each experiment equals that alone, for any number of participants, levels and repetitions."""
    levels = data.draw(st.lists(st.sampled_from([5.0, 20.0, 80.0, 92.5, 100.0, 150.0, 200.0]), min_size=1, max_size=5))
    n_repetitions = data.draw(st.integers(1, 4))
    shape = (3, data.draw(st.integers(1, 12)), len(levels))
    chosen = data.draw(arrays(np.int64, shape, elements=st.integers(0, n_repetitions)))
    alone = [trend_test(rows, levels, n_repetitions) for rows in chosen]
    test = trend_test(chosen, levels, n_repetitions)
    assert test.quick_p == pytest.approx([each.p for each in alone], abs=1e-13)
    assert test.p.tolist() == [each.p for each in alone]
    assert test.p_min.tolist() == [each.p_min for each in alone]
    assert test.statistic.tolist() == [each.statistic for each in alone]
    assert test.n_informative.tolist() == [each.n_informative for each in alone]


def test_a_batch_of_many_participants_is_tested_as_each_alone() -> None:
    """The agreement is exact, since no participant has many answers, however many there are in total."""
    chosen = np.random.default_rng(4).integers(0, 3, (2, 210, 2))
    test, alone = trend_test(chosen, [80, 200], 2), [trend_test(rows, [80, 200], 2) for rows in chosen]
    assert test.p.tolist() == [each.p for each in alone]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(*[st.integers(0, 12)] * 3), min_size=1, max_size=6))
def test_multinomial_tests_with_different_totals_equal_each_alone(counts: list[tuple[int, int, int]]) -> None:
    """The numbers are the same, also with zero answers."""
    test = multinomial_test(counts)
    for name in ("statistic", "p", "p_min", "n_informative"):
        assert getattr(test, name).tolist() == [getattr(multinomial_test(row), name) for row in counts]


def test_uninformative_answers_give_p_one() -> None:
    """The p value is 1 if all scores are zero, all answers are the same, or there is one level."""
    assert sign_flip_test(np.zeros((2, 5), dtype=int)).quick_p.tolist() == [1.0, 1.0]
    assert trend_test(np.full((2, 5, 4), 3), [80, 100, 150, 200], 3).quick_p.tolist() == [1.0, 1.0]
    assert trend_test(np.ones((2, 5, 1), dtype=int), [80], 2).quick_p.tolist() == [1.0, 1.0]


def test_levels_without_a_coarse_common_grid_are_computed() -> None:
    """Convolution agrees where the levels need a grid of a thousand steps."""
    levels = [80.001, 99.997, 150.003, 199.999]
    test = trend_test(np.random.default_rng(2).integers(0, 2, (4, 15, 4)), levels)
    assert test.quick_p == pytest.approx(test.p, abs=1e-12)


def assert_each_alone(batch: Interval, alone: list[Interval]) -> None:
    """Check that a batch has exactly the intervals of each experiment."""
    for name in ("estimate", "low", "high", "n_effective", "half_width"):
        expected = [getattr(each, name) for each in alone]
        np.testing.assert_allclose(getattr(batch, name), expected, rtol=1e-10, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(
    arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(1, 9)), elements=st.sampled_from([-1, 0, 0.5, np.nan]))
)
def test_means_of_a_batch_are_those_of_each_experiment(scores: np.ndarray) -> None:
    """Estimates, bounds and p agree, with missing participants, constant answers and a single participant."""
    batch, alone = BoundedMean(scores), [BoundedMean(row) for row in scores]
    assert_each_alone(batch.interval(), [each.interval() for each in alone])
    np.testing.assert_allclose(batch.test().p, [each.test().p for each in alone], rtol=1e-12)
    np.testing.assert_allclose(batch.equivalence(0.2).p, [each.equivalence(0.2).p for each in alone], rtol=1e-12)


@pytest.mark.parametrize("n", [0, 1, 10])
def test_shares_of_a_batch_are_those_of_each_experiment(n: int) -> None:
    """They are Clopper-Pearson intervals for every count, including none of none."""
    assert_each_alone(clopper_pearson(np.arange(n + 1), n), [clopper_pearson(k, n) for k in range(n + 1)])
