from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modaltouch.analysis.intervals import (
    clopper_pearson,
    clustered_difference,
    korn_graubard,
    matched_odds_ratio,
    paired_mean,
    tango,
    wilson,
)

Z = 1.959963984540054


def tango_roots(b: int, c: int, n: int) -> tuple[float, float]:
    """Return Tango's bounds as roots of a quartic.

    Yang, Sun and Hardin, Statistics in Medicine 32 (2013) 1336-1342: the interval without iteration.
    """
    g, d, s = Z**2, b - c, b + c
    m0 = n**2 * (n / g + 1) ** 2
    m1 = -n * d * (n / g + 1) * (4 * n / g + 1)
    m2 = 2 * n * d**2 * (3 * n / g + 2) / g - n**2 * (s / g + 1)
    m3 = n * d * (2 * s / g + 1) - d**3 * (4 * n / g + 1) / g
    m4 = d**2 * (d**2 / g - s) / g
    roots = [r.real for r in np.roots([m0, m1, m2, m3, m4]) if abs(r.imag) < 1e-9]
    low = [r for r in roots if r <= d / n + 1e-9]
    high = [r for r in roots if r >= d / n - 1e-9]
    return float(min(low)), float(max(high))


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

    def test_ten_of_ten_is_at_least_two_thirds(self) -> None:
        """Closed form 0.025^(1/10) = 0.6915."""
        assert clopper_pearson(10, 10).low == pytest.approx(0.025**0.1, rel=1e-12)

    def test_no_answers_say_nothing(self) -> None:
        """Zero of zero: anything from 0 to 1."""
        interval = clopper_pearson(0, 0)
        assert (interval.low, interval.high) == (0, 1)
        assert math.isnan(interval.estimate)

    def test_more_successes_than_answers_are_refused(self) -> None:
        """House rule: what was given, what is allowed."""
        with pytest.raises(ValueError, match="11 successes out of 10: allowed are 0 to n"):
            clopper_pearson(11, 10)


def test_wilson_gives_the_published_interval() -> None:
    """Newcombe, Statistics in Medicine 17 (1998) 857-872, table I: 81 of 263 -> 0.2553 to 0.3662."""
    interval = wilson(81, 263)
    assert (interval.low, interval.high) == pytest.approx((0.2553, 0.3662), abs=5e-5)


class TestTango:
    def test_the_published_example_is_reproduced(self) -> None:
        """Fagerland, Lydersen, Laake, Stat. Med. 33 (2014) 2850: 1 and 7 discordant of 21 (Bentur et al. 2009)."""
        interval = tango(1, 7, 21)
        assert (interval.low, interval.high) == pytest.approx((-0.517, -0.026), abs=5e-4)

    @pytest.mark.parametrize(("b", "c", "n"), [(1, 7, 21), (40, 20, 160), (1, 0, 10), (3, 1, 10), (9, 0, 10)])
    def test_bounds_are_the_roots_of_the_closed_form(self, b, c, n) -> None:
        """Yang, Sun and Hardin (2013), the quartic's roots."""
        interval = tango(b, c, n)
        assert (interval.low, interval.high) == pytest.approx(tango_roots(b, c, n), abs=1e-9)

    @pytest.mark.parametrize(("n", "half"), [(10, 0.278), (20, 0.161), (35, 0.099), (50, 0.071)])
    def test_without_discordance_the_half_width_is_known(self, n, half) -> None:
        """Closed form z^2 / (N + z^2); figures of the analysis plan, section 3."""
        interval = tango(0, 0, n)
        assert interval.high == pytest.approx(Z**2 / (n + Z**2), abs=1e-9)
        assert interval.high == pytest.approx(half, abs=5e-4)

    @given(st.integers(0, 15), st.integers(0, 15), st.integers(0, 15))
    @settings(max_examples=60, deadline=None)
    def test_exchanging_the_two_ways_mirrors_the_interval(self, b, c, rest) -> None:
        """Symmetry of the score statistic."""
        if b + c + rest == 0:
            rest = 1
        one, other = tango(b, c, b + c + rest), tango(c, b, b + c + rest)
        assert (one.low, one.high) == pytest.approx((-other.high, -other.low), abs=1e-9)
        assert -1 <= one.low <= one.estimate <= one.high <= 1

    def test_more_discordant_pairs_than_pairs_are_refused(self) -> None:
        """House rule: what was given, what is allowed."""
        with pytest.raises(ValueError, match="cannot be more than all"):
            tango(6, 5, 10)


class TestKornGraubard:
    def test_participants_who_agree_count_once_each(self) -> None:
        """Rule of the plan: design effect = answers per participant, so the interval is that of N answers."""
        interval, alone = korn_graubard([4] * 10, 4), clopper_pearson(10, 10)
        assert (interval.low, interval.high, interval.n_effective) == (alone.low, alone.high, 10)

    def test_one_answer_a_participant_is_clopper_pearson(self) -> None:
        """Identity: without clusters the design effect is 1."""
        interval, alone = korn_graubard([1] * 7 + [0] * 3, 1), clopper_pearson(7, 10)
        assert (interval.low, interval.high) == pytest.approx((alone.low, alone.high), rel=1e-12)

    def test_the_effective_number_is_the_variance_ratio(self) -> None:
        """Definition of Korn and Graubard (1998): p (1 - p) over the variance between participants."""
        counts = np.array([4, 4, 3, 2, 4, 1, 4, 3, 4, 4])
        p = counts.sum() / 40
        expected = p * (1 - p) / (np.var(counts / 4, ddof=1) / 10)
        assert korn_graubard(counts, 4).n_effective == pytest.approx(expected, rel=1e-12)

    @given(st.lists(st.integers(0, 4), min_size=2, max_size=12))
    @settings(max_examples=60, deadline=None)
    def test_the_design_effect_stays_between_one_and_the_cluster(self, counts) -> None:
        """Rule of the plan."""
        interval = korn_graubard(counts, 4)
        assert len(counts) <= interval.n_effective <= 4 * len(counts)
        assert interval.low <= interval.estimate <= interval.high

    def test_two_participants_who_differ_are_worth_what_their_variance_says(self) -> None:
        """3 and 1 of 4: variance between them 1/8, over two 1/16, so 1/4 over that is 4 answers."""
        assert korn_graubard([3, 1], 4).n_effective == pytest.approx(4)

    def test_one_participant_is_worth_one_answer(self) -> None:
        """Nothing tells how much participants differ."""
        assert korn_graubard([3], 4).n_effective == 1


class TestClusteredDifference:
    def test_the_effective_number_is_the_variance_ratio(self) -> None:
        """Binomial variance of the differences, b + c - (b - c)^2 in shares, over the variance between participants."""
        b, c = np.array([3, 2, 4, 1, 3]), np.array([0, 1, 0, 2, 1])
        d = (b.sum() - c.sum()) / 20
        expected = ((b.sum() + c.sum()) / 20 - d**2) / (np.var((b - c) / 4, ddof=1) / 5)
        interval = clustered_difference(b, c, 4)
        assert 5 < expected < 20
        assert interval.n_effective == pytest.approx(expected, rel=1e-12)
        alone = tango(b.sum() * expected / 20, c.sum() * expected / 20, expected)
        assert (interval.estimate, interval.low, interval.high) == pytest.approx((d, alone.low, alone.high), rel=1e-9)

    def test_participants_who_agree_count_once_each(self) -> None:
        """Rule of the plan, for differences: ten alike are worth ten."""
        interval, alone = clustered_difference([4] * 10, [0] * 10, 4), tango(10, 0, 10)
        assert interval.n_effective == 10
        assert (interval.low, interval.high) == pytest.approx((alone.low, alone.high), abs=1e-12)

    def test_one_or_two_participants(self) -> None:
        """One is worth one answer; two who differ are worth what their variance says, here 1 / (1/16) of at most 8."""
        assert clustered_difference([3], [1], 4).n_effective == 1
        assert clustered_difference([3, 2], [1, 2], 4).n_effective == pytest.approx(8)
        assert clustered_difference([4, 2], [0, 2], 4).n_effective == pytest.approx((1 - 0.25) / 0.25)

    @given(st.lists(st.sampled_from([(1, 0), (0, 1), (0, 0)]), min_size=2, max_size=15))
    @settings(max_examples=40, deadline=None)
    def test_one_pair_a_participant_is_tango(self, pairs) -> None:
        """Identity: without clusters nothing is adjusted."""
        b, c = (np.array([pair[i] for pair in pairs]) for i in (0, 1))
        interval, alone = clustered_difference(b, c, 1), tango(int(b.sum()), int(c.sum()), len(pairs))
        assert (interval.low, interval.high) == pytest.approx((alone.low, alone.high), abs=1e-9)

    @pytest.mark.parametrize("spread", [None, 2.0])
    def test_coverage_is_near_its_nominal_rate(self, spread) -> None:
        """95 % on 600 synthetic experiments of 10 participants who differ, less 3 Monte Carlo sd and 1.5 %."""
        rng = np.random.default_rng(11)
        shares, hits = np.array([0.6, 0.15, 0.25]), 0
        for _ in range(600):
            own = rng.dirichlet(shares * spread, 10) if spread else np.tile(shares, (10, 1))
            counts = np.array([rng.multinomial(4, p) for p in own])
            interval = clustered_difference(counts[:, 0], counts[:, 1], 4)
            hits += interval.low <= 0.45 <= interval.high
        assert hits / 600 > 0.95 - 0.015 - 3 * math.sqrt(0.95 * 0.05 / 600)


def test_scores_that_are_all_zero_still_have_a_width() -> None:
    """Nothing lies when all agree: Tango's interval without discordance."""
    interval = paired_mean([0] * 10, 3)
    assert interval.high == pytest.approx(Z**2 / (10 + Z**2), abs=1e-9)


def test_scores_count_as_shares_of_a_pair() -> None:
    """3 of 3 is a whole discordant pair, -1 of 3 a third of one the other way."""
    interval, alone = paired_mean([3, 2, 0, -1, 3], 3), tango(8 / 3, 1 / 3, 5)
    assert interval.estimate == pytest.approx(7 / 15)
    assert (interval.low, interval.high) == pytest.approx((alone.low, alone.high), rel=1e-12)


@pytest.mark.parametrize(("k", "n"), [(0, 10), (10, 10), (0, 1), (3, 7)])
def test_wilson_is_where_the_score_statistic_reaches_z(k, n) -> None:
    """(p - q)^2 = z^2 q (1 - q) / n at both bounds (Wilson 1927)."""
    interval = wilson(k, n)
    for bound in (interval.low, interval.high):
        assert (k / n - bound) ** 2 == pytest.approx(Z**2 * bound * (1 - bound) / n, abs=1e-12)
    assert 0 <= interval.low <= interval.estimate <= interval.high <= 1
    assert interval.high - interval.low > 0.1


@pytest.mark.parametrize(
    ("b", "c", "low", "high"), [(1, 0, 0.025 / 0.975, math.inf), (0, 1, 0.0, 0.975 / 0.025), (0, 0, 0.0, math.inf)]
)
def test_the_matched_odds_ratio_is_the_transformed_binomial_interval(b, c, low, high) -> None:
    """Closed form for one discordant pair: bounds 0.025 and 0.975 of the binomial share."""
    interval = matched_odds_ratio(b, c)
    assert (interval.low, interval.high) == pytest.approx((low, high))
