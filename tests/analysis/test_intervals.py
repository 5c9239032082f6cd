from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from scipy.stats import t

from modaltouch.analysis.intervals import clopper_pearson, student_interval, wilson

Z = 1.959963984540054


class TestClopperPearson:
    @pytest.mark.parametrize(("k", "n"), [(10, 10), (0, 10), (9, 10), (39, 40), (38, 40), (1, 3)])
    def test_bounds_leave_the_stated_tail_in_the_binomial(self, k, n) -> None:
        """Definition of Clopper and Pearson (1934), with binomial tails summed by mpmath."""
        interval = clopper_pearson(k, n)

        def tail(first: int, last: int, p: float) -> float:
            q = mpmath.mpf(p)
            return float(sum(mpmath.binomial(n, x) * q**x * (1 - q) ** (n - x) for x in range(first, last + 1)))

        if k > 0:
            assert tail(k, n, interval.low) == pytest.approx(0.025, abs=1e-9)
        if k < n:
            assert tail(0, k, interval.high) == pytest.approx(0.025, abs=1e-9)

    @pytest.mark.parametrize(("k", "n"), [(0.5, 7.25), (6.75, 7.25)])
    def test_counts_scaled_by_a_design_effect_may_be_fractional(self, k, n) -> None:
        """The binomial tails are regularised incomplete beta functions, computed by mpmath."""
        interval = clopper_pearson(k, n)
        assert mpmath.betainc(k, n - k + 1, 0, interval.low, regularized=True) == pytest.approx(0.025, abs=1e-9)
        assert mpmath.betainc(k + 1, n - k, interval.high, 1, regularized=True) == pytest.approx(0.025, abs=1e-9)

    def test_one_answer_has_its_share(self) -> None:
        """Closed form: one of one is 1, and at least 0.025."""
        interval = clopper_pearson(1, 1)
        assert (interval.estimate, interval.low) == (1, pytest.approx(0.025))

    def test_ten_of_ten_is_at_least_two_thirds(self) -> None:
        """Closed form 0.025^(1/10) = 0.6915."""
        assert clopper_pearson(10, 10).low == pytest.approx(0.025**0.1, rel=1e-12)

    def test_no_answers_give_the_whole_range(self) -> None:
        """Zero of zero has the interval 0 to 1."""
        interval = clopper_pearson(0, 0)
        assert (interval.low, interval.high) == (0, 1)
        assert math.isnan(interval.estimate)

    def test_more_successes_than_answers_are_refused(self) -> None:
        """The message gives the value and what is allowed."""
        with pytest.raises(ValueError, match="11 successes out of 10: allowed: 0 to n"):
            clopper_pearson(11, 10)


def test_wilson_gives_the_published_interval() -> None:
    """Newcombe, Statistics in Medicine 17 (1998) 857-872, table I: 81 of 263 -> 0.2553 to 0.3662."""
    interval = wilson(81, 263)
    assert (interval.low, interval.high) == pytest.approx((0.2553, 0.3662), abs=5e-5)


@pytest.mark.parametrize(("k", "n"), [(0, 10), (10, 10), (0, 1), (3, 7)])
def test_wilson_bounds_are_where_the_score_statistic_is_z(k, n) -> None:
    """(p - q)^2 = z^2 q (1 - q) / n at both bounds (Wilson 1927)."""
    interval = wilson(k, n)
    for bound in (interval.low, interval.high):
        assert (k / n - bound) ** 2 == pytest.approx(Z**2 * bound * (1 - bound) / n, abs=1e-12)
    assert 0 <= interval.low <= interval.estimate <= interval.high <= 1
    assert interval.high - interval.low > 0.1


def test_a_mean_has_the_bounds_of_students_t() -> None:
    """Reference: scipy.stats.t."""
    values = np.array([0.31, 0.42, 0.35, 0.58])
    interval = student_interval(values)
    expected = t.interval(0.95, 3, loc=values.mean(), scale=values.std(ddof=1) / 2)
    assert (interval.low, interval.high) == pytest.approx(expected)
    assert interval.estimate == pytest.approx(values.mean())


@pytest.mark.parametrize("values", [[0.5, 0.5, 0.5], [0.5]])
def test_values_without_variation_give_a_mean_without_bounds(values) -> None:
    """A width of zero would claim a certainty that equal values cannot give."""
    interval = student_interval(np.array(values))
    assert interval.estimate == 0.5
    assert math.isnan(interval.low) and math.isnan(interval.high)
