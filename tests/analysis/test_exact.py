from __future__ import annotations

from fractions import Fraction
from itertools import product
from math import factorial, log

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from modaltouch.analysis.exact import (
    _heads,
    multinomial_test,
    sign_flip_test,
    sign_test,
)

DARWIN = [49, -67, 8, 16, 6, 23, 28, 41, 14, 29, 56, 24, 75, 60, -48]
"""Differences of height between crossed and self-fertilised maize [1/8 inch] (Darwin 1876, in Fisher 1935)."""


def enumerate_multinomial(observed: list[int], null: list[Fraction]) -> float:
    """Return the exact p by listing every outcome in rational arithmetic."""
    n, k = sum(observed), len(observed)

    def probability(x: tuple[int, ...]) -> Fraction:
        ways = factorial(n)
        for count in x:
            ways //= factorial(count)
        share = Fraction(ways)
        for count, p in zip(x, null, strict=True):
            share *= p**count
        return share

    def extremeness(x: tuple[int, ...]) -> float:
        return 2 * sum(c * log(c / float(n * p)) for c, p in zip(x, null, strict=True) if c)

    bound = extremeness(tuple(observed)) - 1e-9
    outcomes = (x for x in product(range(n + 1), repeat=k) if sum(x) == n)
    return float(sum(probability(x) for x in outcomes if extremeness(x) >= bound))


def flips(scores: list[int]) -> list[int]:
    """Return the sum under each of the 2^N sign assignments."""
    return [
        sum(s * sign for s, sign in zip(scores, signs, strict=True)) for signs in product((1, -1), repeat=len(scores))
    ]


class TestMultinomial:
    @pytest.mark.parametrize(
        "observed", [[9, 1, 0], [7, 1, 2], [4, 3, 3], [2, 0, 0], [3, 1, 2, 1], [0, 3, 0, 1, 2], [4, 0, 0, 1, 1, 0, 0]]
    )
    def test_p_equals_enumeration_in_rational_arithmetic(self, observed) -> None:
        """Reference: every outcome listed, with probabilities as fractions."""
        null = [Fraction(1, len(observed))] * len(observed)
        assert multinomial_test(observed).p == pytest.approx(enumerate_multinomial(observed, null), rel=1e-12)

    def test_forty_answers_of_seven_kinds_are_enumerated(self) -> None:
        """Closed form: seven outcomes of 7^-40 are the most extreme; of 1.2 million heads, 11,000 are distinct."""
        assert multinomial_test([40, 0, 0, 0, 0, 0, 0]).p == pytest.approx(7.0**-39, rel=1e-12, abs=0)
        assert sum(1 for _ in _heads(40, 5, 40)) < 20_000

    def test_ten_equal_answers_have_the_smallest_p(self) -> None:
        """Closed form: three outcomes of probability 3^-10."""
        test = multinomial_test([0, 0, 10])
        assert test.p == pytest.approx(3.0**-9, rel=1e-12)
        assert test.p_min == test.p

    def test_hundreds_of_answers_are_summed_in_parts(self) -> None:
        """Closed forms for 150 of three kinds: p is 3^-149 at one end, 1 in the middle; a batch equals each alone."""
        alike, even = multinomial_test([150, 0, 0]), multinomial_test([50, 50, 50])
        assert (alike.p, even.p) == (pytest.approx(3.0**-149, rel=1e-9, abs=0), pytest.approx(1.0, rel=1e-9))
        assert alike.p_min == even.p_min == alike.p
        batch = multinomial_test([[150, 0, 0], [60, 50, 40]])
        assert batch.p == pytest.approx([alike.p, multinomial_test([60, 50, 40]).p], rel=1e-12, abs=0)

    def test_summing_in_parts_equals_summing_at_once(self, monkeypatch) -> None:
        """Both methods give the same p and smallest p."""
        kept = multinomial_test([[9, 1, 4], [3, 5, 6]])
        monkeypatch.setattr("modaltouch.analysis.exact._KEPT", 0)
        parts = multinomial_test([[9, 1, 4], [3, 5, 6]])
        assert parts.p == pytest.approx(kept.p, rel=1e-12)
        assert parts.p_min == pytest.approx(kept.p_min, rel=1e-12)

    def test_no_probability_exceeds_one(self) -> None:
        """In floating point the probabilities of all outcomes add up to slightly more than 1."""
        for n in range(1, 15):
            even = multinomial_test([n // 2, n - n // 2])
            assert even.p <= 1

    def test_no_answers_give_p_one(self) -> None:
        """No observation gives no information."""
        assert multinomial_test([0, 0, 0]).p == 1

    @pytest.mark.parametrize(
        ("counts", "words"),
        [
            ([[1, -1]], "must not be negative"),
            ([[1]], "two categories"),
            (np.zeros((0, 3), dtype=int), r"counts have shape \(0, 3\)"),
        ],
    )
    def test_faulty_input_is_refused_with_its_values(self, counts, words) -> None:
        """The message gives the value and what is allowed."""
        with pytest.raises(ValueError, match=words):
            multinomial_test(counts)


class TestSignFlip:
    def test_fishers_analysis_of_darwins_maize_is_reproduced(self) -> None:
        """Fisher, The Design of Experiments (1935), section 21: 1726 of 32768 sums are as extreme as 314."""
        test = sign_flip_test(DARWIN)
        assert test.statistic == 314
        assert test.p == pytest.approx(1726 / 32768, rel=1e-12)

    @given(st.lists(st.integers(-12, 12), min_size=1, max_size=10))
    @settings(max_examples=60, deadline=None)
    def test_p_equals_full_enumeration(self, scores) -> None:
        """Reference: all 2^N sign assignments counted."""
        sums = flips(scores)
        test = sign_flip_test(scores)
        assert test.p == pytest.approx(sum(abs(s) >= abs(sum(scores)) for s in sums) / len(sums), rel=1e-12)

    @given(st.lists(st.integers(-5, 5), min_size=1, max_size=8))
    @settings(max_examples=40, deadline=None)
    def test_p_min_is_the_least_p_over_all_signs(self, scores) -> None:
        """Reference: the test run on every sign assignment of the same magnitudes."""
        sizes = [abs(s) for s in scores]
        least = min(
            sign_flip_test([s * sign for s, sign in zip(sizes, signs, strict=True)]).p
            for signs in product((1, -1), repeat=len(sizes))
        )
        assert sign_flip_test(scores).p_min == pytest.approx(least, rel=1e-12)

    @pytest.mark.parametrize("sizes", [[1, 1, 1, 1, 1, 1], [4, 4, 3, 2, 1, 1, 4], [1, 2, 4, 8, 16]])
    @pytest.mark.parametrize("alpha", [0.01, 0.05, 0.1, 0.5])
    def test_the_significance_level_holds_exactly_under_the_null(self, sizes, alpha) -> None:
        """By enumeration, at most alpha of all sign assignments are rejected."""
        p = [
            sign_flip_test([s * e for s, e in zip(sizes, signs, strict=False)]).p
            for signs in product((1, -1), repeat=len(sizes))
        ]
        assert np.mean(np.array(p) <= alpha + 1e-12) <= alpha

    def test_zero_scores_have_no_information(self) -> None:
        """If all answers are "both", p and the smallest p are 1, without an error."""
        test = sign_flip_test([0, 0, 0])
        assert (test.p, test.p_min, test.n_informative) == (1, 1, 0)

    def test_seven_participants_cannot_pass_holm_over_six_but_eight_can(self) -> None:
        """The floor of the design is 2/2^N x 6."""
        assert sign_flip_test([4] * 7).p * 6 > 0.05 > sign_flip_test([4] * 8).p * 6

    def test_a_thousand_participants_need_no_enumeration(self) -> None:
        """If all lean one way, p is 2^(1-1000), to floating-point precision."""
        assert sign_flip_test([3] * 1000).p == pytest.approx(2.0**-999, rel=1e-9, abs=0)

    @pytest.mark.parametrize("lean", [0, 8, 60])
    def test_different_scores_are_transformed_as_they_are_added_up(self, lean, monkeypatch) -> None:
        """Reference: direct convolution, whose terms are all positive; no two of the 300 scores need be alike."""
        scores = np.random.default_rng(lean).integers(-300, 301, 300) + lean
        expected = sign_flip_test(scores).p
        monkeypatch.setattr("modaltouch.analysis.sums.DIRECT_COST", 0)
        assert sign_flip_test(scores).p == pytest.approx(max(expected, 1e-14), abs=1e-13)

    def test_more_participants_than_a_float_can_express_give_a_positive_p(self) -> None:
        """No outcome is impossible, so p is never zero."""
        assert 0 < sign_flip_test([1] * 3000).p < 1e-300

    def test_fractions_are_refused(self) -> None:
        """Scores must be integers so that ties are exact."""
        with pytest.raises(ValueError, match="whole numbers"):
            sign_flip_test([0.5, 1.0])

    @given(st.integers(0, 12), st.integers(0, 12))
    @settings(max_examples=30, deadline=None)
    def test_the_sign_test_is_the_binomial_test(self, positive, negative) -> None:
        """Reference: scipy.stats.binomtest on the participants with a nonzero score."""
        test = sign_test([3] * positive + [-1] * negative + [0])
        expected = binomtest(positive, positive + negative).pvalue if positive + negative else 1.0
        assert test.p == pytest.approx(expected, rel=1e-9)

    def test_the_statistic_of_the_sign_test_counts_positive_scores(self) -> None:
        """Zero scores have no direction and no information."""
        test = sign_test([5, 1, 0, 0, -2])
        assert (test.statistic, test.n_informative) == (2, 3)


def test_scores_are_whole_numbers_of_any_type() -> None:
    """As a table of numbers has them: 2.0 counts as 2, and 2.5 would leave ties to rounding."""
    assert float(sign_flip_test([2.0, 1.0, -1.0]).p) == float(sign_flip_test([2, 1, -1]).p)
    with pytest.raises(ValueError, match=r"scores must be whole numbers, so that ties are exact; got \[2\.0, 1\.5\]"):
        sign_flip_test([2.0, 1.5])


@pytest.mark.parametrize("n", [1, 2, 39, 40, 41, 60])
def test_the_quick_p_of_unanimous_answers_is_not_below_what_is_attainable(n: int) -> None:
    """2/2^n, where the quick way has an error of 1e-13 of its own: to the bit up to forty participants."""
    quick = float(sign_flip_test([1] * n).quick_p)
    assert quick >= 2.0 ** (1 - n)
    if n <= 40:
        assert quick == 2.0 ** (1 - n)
