from __future__ import annotations

from itertools import combinations, permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modaltouch.analysis.exact import level_scores, smallest_trend_p, trend_test


class TestTrend:
    @given(st.lists(st.tuples(*[st.integers(0, 1)] * 4), min_size=1, max_size=3))
    @settings(max_examples=40, deadline=None)
    def test_p_equals_all_shuffles_of_the_levels(self, rows) -> None:
        """Reference: every rearrangement of every participant's answers, one answer per level."""
        scores = [0, 2, 7, 12]
        test = trend_test(rows, [80, 100, 150, 200])
        centre = sum(sum(row) * sum(scores) / 4 for row in rows)

        def total(arranged) -> float:
            return sum(s * x for row in arranged for s, x in zip(scores, row, strict=True)) - centre

        space = list(product(*[list(permutations(row)) for row in rows]))
        reached = abs(total(rows)) - 1e-9
        assert test.p == pytest.approx(np.mean([abs(total(a)) >= reached for a in space]), rel=1e-12)

    def test_repetitions_are_shuffled_individually(self) -> None:
        """Reference: every choice of k of the presentations, for two participants."""
        scores, repetitions = [0, 1, 3], 2
        counts = [[0, 1, 2], [1, 0, 2]]
        slots = [s for s in scores for _ in range(repetitions)]
        sums = [[sum(c) for c in combinations(slots, sum(row))] for row in counts]
        centre = sum(sum(row) for row in counts) * sum(scores) / 3
        reached = abs(sum(s * k for row in counts for s, k in zip(scores, row, strict=False)) - centre) - 1e-9
        expected = np.mean([abs(a + b - centre) >= reached for a in sums[0] for b in sums[1]])
        assert trend_test(counts, [10, 20, 40], repetitions).p == pytest.approx(expected, rel=1e-12)

    def test_with_missing_answers_the_others_are_shuffled(self) -> None:
        """Reference: every order of the existing answers over the levels at which they were given."""
        answered = np.array([[1, 1, 0, 1], [1, 1, 1, 1], [2, 1, 1, 0]])
        chosen = np.array([[0, 1, 0, 1], [0, 0, 1, 1], [1, 1, 1, 0]])
        scores, sums = np.array([0, 2, 7, 12]), [np.zeros(1)]
        for own, presented in zip(chosen, answered, strict=True):
            cards, places = np.repeat([1, 0], [own.sum(), presented.sum() - own.sum()]), np.repeat(scores, presented)
            sums.append(np.array([np.dot(order, places) for order in permutations(cards)]) - own.sum() * places.mean())
        every = np.add.outer(np.add.outer(sums[1], sums[2]), sums[3])
        test = trend_test(chosen, [80, 100, 150, 200], answered)
        expected = sum(
            own @ scores - own.sum() * (presented @ scores) / presented.sum()
            for own, presented in zip(chosen, answered, strict=True)
        )
        assert test.statistic == pytest.approx(expected)
        assert test.p == pytest.approx(np.mean(np.abs(every) >= abs(expected) - 1e-9))
        assert test.quick_p == pytest.approx(test.p, abs=1e-12)

    def test_participants_without_variation_do_not_matter(self) -> None:
        """They have the same total under every shuffle."""
        moving = [[0, 0, 1, 1], [0, 1, 1, 1]]
        assert trend_test(moving, [1, 2, 3, 4]).p == trend_test([*moving, [1] * 4, [0] * 4], [1, 2, 3, 4]).p

    @pytest.mark.parametrize("rows", [[[1, 1, 1, 1]] * 10, [[0, 0, 0, 0]] * 3])
    def test_constant_answers_have_no_information(self, rows) -> None:
        """Both p and the smallest p are 1, without an error."""
        test = trend_test(rows, [80, 100, 150, 200])
        assert (test.p, test.p_min, test.n_informative) == (1, 1, 0)

    def test_one_level_has_no_information(self) -> None:
        """A trend needs two levels."""
        assert trend_test([[1], [0]], [80]).p_min == 1

    def test_p_min_is_the_least_p_over_all_shuffles(self) -> None:
        """Reference: the test run on every rearrangement."""
        rows = [(1, 0, 0, 1), (1, 1, 1, 0)]
        arranged = product(*[set(permutations(row)) for row in rows])
        least = min(trend_test(list(a), [80, 100, 150, 200]).p for a in arranged)
        assert trend_test(rows, [80, 100, 150, 200]).p_min == pytest.approx(least, rel=1e-12)

    @pytest.mark.parametrize("rates", [[0.5, 0.5, 0.5, 0.5], [0.2, 0.4, 0.6, 0.9], [0.05, 0.2, 0.8, 0.95]])
    def test_the_transform_agrees_with_convolution(self, rates, monkeypatch) -> None:
        """Two independent algorithms agree; the last p is far below 1e-14, the limit of the transform."""
        rows = np.random.default_rng(5).binomial(1, rates, (60, 4))
        direct, transformed = (trend_test(rows, [80, 100, 150, 200]) for _ in range(2))
        p, p_min = direct.p, direct.p_min  # computed here, at first use
        monkeypatch.setattr("modaltouch.analysis.sums.DIRECT_COST", 0)
        assert transformed.p == pytest.approx(max(p, 1e-14), abs=1e-13)
        assert transformed.p_min == pytest.approx(max(p_min, 1e-14), abs=1e-13)

    def test_the_trend_test_keeps_its_level_under_the_null(self) -> None:
        """Type I error on guesses of 10 participants is within its Monte Carlo interval (2000 experiments, 3 sd)."""
        rng = np.random.default_rng(8)
        p = [trend_test(rng.integers(0, 2, (10, 4)), [80, 100, 150, 200]).p for _ in range(2000)]
        assert np.mean(np.array(p) <= 0.05) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 2000)

    @pytest.mark.parametrize("n_participants", [1, 3, 10])
    @pytest.mark.parametrize("slope", [0.0, 0.01, 0.03])
    def test_many_answers_use_the_normal_approximation(self, n_participants, slope, monkeypatch) -> None:
        """240 answers each, exactly and by approximation: the same statistic, p within 4 %, and a tiny p_min."""
        rates = 0.5 + slope * np.arange(-1.5, 2)
        rows = np.random.default_rng(3).binomial(60, rates, (n_participants, 4))
        exact = trend_test(rows, [80, 100, 150, 200], 60)
        monkeypatch.setattr("modaltouch.analysis.exact.MOST_EXACT", 239)
        normal = trend_test(rows, [80, 100, 150, 200], 60)
        assert normal.statistic == pytest.approx(exact.statistic, abs=1e-9)
        assert normal.p == pytest.approx(exact.p, rel=0.04)
        assert normal.p_min < 1e-6 > exact.p_min
        assert normal.n_informative == exact.n_informative == n_participants

    def test_a_participant_without_answers_does_not_count_in_the_approximation(self) -> None:
        """The smallest p is that of the farther end, which with uneven levels may be the lower one."""
        alone = trend_test([[120, 140]], [80, 200], [[210, 210]])
        both = trend_test([[120, 140], [0, 0]], [80, 200], [[210, 210], [0, 0]])
        assert (both.p, both.n_informative) == (pytest.approx(alone.p), 1)
        extreme = trend_test([[170, 170, 0]], [0, 1, 10], 170)
        assert extreme.p == extreme.p_min

    def test_a_thousand_answers_per_level_do_not_overflow(self) -> None:
        """The numbers of arrangements would overflow a float; participants without a preference give no small p."""
        rows = np.random.default_rng(3).binomial(1000, 0.5, (42, 4))
        assert trend_test(rows, [80, 100, 150, 200], 1000).p > 0.01
        assert trend_test(rows + [[0, 0, 0, 90]], [80, 100, 150, 200], 1000).p < 1e-6
        assert smallest_trend_p([80, 100, 150, 200], 42, 1000) < 1e-300
        assert smallest_trend_p([80], 42, 1000) == 1.0

    def test_the_smallest_p_is_exact_up_to_the_limit_of_enumeration(self, monkeypatch) -> None:
        """Closed form: four of eight answers are chosen in 70 ways, by each of two, and both ends are as extreme."""
        monkeypatch.setattr("modaltouch.analysis.exact.MOST_EXACT", 8)
        levels = [80, 100, 150, 200]
        assert smallest_trend_p(levels, 2, 2) == pytest.approx(2 / 70**2, rel=1e-12)
        assert smallest_trend_p(levels, 2, 3) < 1e-300

    def test_counts_beyond_the_repetitions_are_refused(self) -> None:
        """The message gives the range and what is allowed."""
        with pytest.raises(ValueError, match="runs from 0 to 3, allowed: 0 to 2"):
            trend_test([[0, 3]], [1, 2], 2)

    def test_counts_that_do_not_fit_the_levels_are_refused(self) -> None:
        """The message gives both shapes."""
        with pytest.raises(ValueError, match=r"shape \(1, 2\), but there are 3 levels"):
            trend_test([[0, 1]], [1, 2, 3])


@pytest.mark.parametrize(
    ("levels", "scores"),
    [
        ([80, 100, 150, 200], [0, 2, 7, 12]),
        ([92.5, 80, 117.5], [1, 0, 3]),
        ([5], [0]),
        ([1, 2.001, 4000], [0, 0, 1000]),
        ([0, 999, 1000], [0, 999, 1000]),
    ],
)
def test_levels_become_the_smallest_integer_scores(levels, scores) -> None:
    """Closed form: distances over their greatest common divisor, with at most a thousand steps."""
    assert level_scores(levels).tolist() == scores
