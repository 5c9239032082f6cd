"""The mean of a bounded score: closed forms, published bounds, and the coverage of its interval."""

from __future__ import annotations

from itertools import product

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import beta

from modaltouch.analysis import intervals
from modaltouch.analysis.intervals import BoundedMean, clopper_pearson

SCORES = st.lists(st.sampled_from([-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0]), min_size=2, max_size=12)


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"), [(0, 20, 0.0, 0.1684), (1, 29, 0.0009, 0.1776), (9, 10, 0.5550, 0.9975)]
)
def test_scores_at_the_two_ends_give_clopper_and_pearsons_bounds(successes, n, low, high) -> None:
    """Newcombe, Stat. Med. 17 (1998), table I, method 5; R: binom.test(9, 10)$conf.int gives 0.5549839 0.9974714."""
    interval = BoundedMean([1.0] * successes + [0.0] * (n - successes), 0.0, 1.0).interval()
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=5.01e-5)


@pytest.mark.parametrize("n", [1, 6, 10, 40])
def test_without_differences_the_bounds_are_the_rule_of_three(n) -> None:
    """Closed form: a share 1 - 0.025^(1/n) of people may differ fully and be missing by chance."""
    interval = BoundedMean(np.zeros(n)).interval()
    assert (interval.low, interval.high) == pytest.approx((0.025 ** (1 / n) - 1, 1 - 0.025 ** (1 / n)), abs=1e-12)


@pytest.mark.parametrize("scores", [(0.1, 0.3, 0.45, 0.9), (-0.8, -0.2, 0.1, 0.35, 0.6), (0.25,)])
def test_p_is_the_divided_difference_of_a_truncated_power(scores) -> None:
    """Curry and Schoenberg (1966): sum of (x - t)_+^n over the product of differences, in forty digits."""
    knots = [mpmath.mpf(x) for x in (-1.0, *scores)]
    with mpmath.workdps(40):
        for value in (-0.5, 0.0, 0.2):
            above = sum(
                max(x - mpmath.mpf(value), 0) ** len(scores) / mpmath.fprod(x - y for y in knots if y != x)
                for x in knots
            )
            assert BoundedMean(scores).p_above(value) == pytest.approx(float(1 - above), abs=1e-14)


def test_p_is_the_probability_of_gaffkes_weighted_mean() -> None:
    """Gaffke (2005): spacings of uniform numbers as weights, with the low end added; 200,000 draws, 4 sd."""
    rng = np.random.default_rng(1)
    scores = np.array([-0.5, -0.25, 0.0, 0.0, 0.25, 0.25, 0.5, 1.0])
    spacings = np.diff(np.sort(rng.random((200_000, 8)), axis=1), prepend=0.0, append=1.0)
    drawn = np.mean(spacings @ np.array([-1.0, *scores]) <= 0)
    p = BoundedMean(scores).p_above(0.0)
    assert drawn == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / 200_000))


@pytest.mark.parametrize(("mean", "nearer"), [(0.2, 0.2), (0.5, 0.5), (0.8, 0.2)])
def test_the_smallest_p_is_that_of_all_at_the_nearer_end(mean, nearer) -> None:
    """Closed form for five on a scale from 0 to 1: twice the distance to the nearer end, to the fifth power."""
    assert BoundedMean([0.5] * 5, 0.0, 1.0).test(mean).p_min == pytest.approx(2 * nearer**5)


@settings(max_examples=40, deadline=None)
@given(SCORES)
def test_the_interval_inverts_the_test(scores) -> None:
    """The p value is 0.05 at each bound inside the scale, larger within the interval and smaller outside."""
    mean = BoundedMean(scores)
    interval = mean.interval()
    assert -1 <= interval.low <= interval.estimate <= interval.high <= 1
    for bound, inwards in ((float(interval.low), 1e-4), (float(interval.high), -1e-4)):
        if abs(bound) < 1 - 1e-3:
            assert mean.test(bound).p == pytest.approx(0.05, abs=1e-9)
            assert mean.test(bound - inwards).p < 0.05 <= mean.test(bound + inwards).p
    assert (mean.test().p > 0.05) == (interval.low <= 0 <= interval.high)


@pytest.mark.parametrize("n", [6, 10, 20])
def test_more_discordance_never_narrows_an_interval(n) -> None:
    """Agreeing pairs are replaced by opposite answers one by one, from none to all."""
    for size in (0.25, 0.5, 1.0):
        widths = [
            BoundedMean([size] * k + [-size] * k + [0.0] * (n - 2 * k)).interval().half_width for k in range(n // 2 + 1)
        ]
        assert np.diff(widths).min() > 0


def test_a_symmetric_spread_never_narrows_an_interval() -> None:
    """Two participants move apart by equal steps, in every sample of four on a grid of quarters."""
    grid = np.arange(-1, 1.01, 0.25)
    samples = np.array([row for row in product(grid, repeat=4) if list(row) == sorted(row)])
    inner = samples[(samples[:, 1] > -1) & (samples[:, 2] < 1)]
    apart = inner + np.array([0.0, -0.25, 0.25, 0.0])
    before, after = BoundedMean(inner).interval(), BoundedMean(apart).interval()
    assert (after.half_width - before.half_width).min() > -1e-12


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("n", [6, 10, 20])
def test_a_minority_that_differs_is_covered(n, share) -> None:
    """A share of people differs fully and the others not at all: exact binomial coverage, summed."""
    interval = BoundedMean(np.tri(n + 1, n, -1)).interval()
    held = (interval.low <= share) & (share <= interval.high)
    chances = [float(mpmath.binomial(n, k) * share**k * (1 - share) ** (n - k)) for k in range(n + 1)]
    assert np.sum(chances, where=held) >= 0.95


@pytest.mark.parametrize(("scores", "margin", "p"), [([0.0] * 29, 0.1, 0.9**29), ([0.0] * 10, 0.25, 0.75**10)])
def test_equivalence_without_differences_has_its_closed_form(scores, margin, p) -> None:
    """If none of n differs, p = (1 - margin)^n; a margin of a tenth needs 29, as 0.9^29 = 0.047."""
    test = BoundedMean(scores).equivalence(margin)
    assert test.p == pytest.approx(p, rel=1e-12)
    assert test.p == test.p_min


@settings(max_examples=30, deadline=None)
@given(SCORES, st.sampled_from([0.1, 0.3, 0.5]))
def test_equivalence_holds_if_the_90_percent_interval_is_within_the_margin(scores, margin) -> None:
    """Schuirmann (1987): two one-sided tests at 0.05."""
    mean = BoundedMean(scores)
    interval = mean.interval(0.9)
    assert (mean.equivalence(margin).p < 0.05) == (-margin < interval.low and interval.high < margin)


def test_participants_without_a_score_are_left_out() -> None:
    """Missing scores change nothing; without any score the interval is the whole scale."""
    some, all_there = BoundedMean([0.5, np.nan, 0.0, 1.0]), BoundedMean([0.5, 0.0, 1.0])
    assert (some.n, some.test().p) == (3, all_there.test().p)
    nobody = BoundedMean([np.nan]).interval()
    assert (np.isnan(nobody.estimate), nobody.low, nobody.high) == (True, -1, 1)


def test_scores_at_both_ends_have_the_bounds_of_a_proportion() -> None:
    """Identity for any n and k: scores of -1 and 1 are a proportion, rescaled."""
    for n, k in ((12, 5), (60, 1)):
        moved = BoundedMean([1.0] * k + [-1.0] * (n - k)).interval()
        share = clopper_pearson(k, n)
        assert ((moved.low + 1) / 2, (moved.high + 1) / 2) == pytest.approx((share.low, share.high), abs=1e-10)


@pytest.mark.parametrize("spread", ["quarters", "any"])
def test_the_transform_agrees_with_the_recursion(spread) -> None:
    """Two independent algorithms: recursion over scores, and inversion of the characteristic function."""
    rng = np.random.default_rng(2)
    rows = rng.integers(-4, 5, (5, 260)) / 4 if spread == "quarters" else rng.uniform(-1, 1, (5, 260))
    rows = np.sort(rows, axis=1)
    for value in (-0.05, 0.0, 0.03, 0.3):
        values = np.full(5, value)
        chance, is_small = intervals._inverted(rows, -1.0, values)
        assert not is_small.any()
        assert chance == pytest.approx(intervals._dropped(rows, -1.0, values), abs=1e-13)


@pytest.mark.parametrize("n", [300, 800, 1000])
def test_p_of_a_thousand_equal_scores_is_exact(n) -> None:
    """With all at one end, p is 2^-n against the middle, and 1 the other way; the transform would alias."""
    alike = BoundedMean(np.ones(n))
    assert float(alike.p_above(0.0)) == pytest.approx(2.0**-n, rel=1e-9)
    assert float(alike.p_below(0.0)) == 1.0
    assert float(BoundedMean(np.full(n, -0.9)).p_above(0.0)) == pytest.approx(1.0)


def test_the_recursion_replaces_the_transform_where_it_is_inaccurate() -> None:
    """Hundreds of zeros and a few ones: interval and small p are those of the recursion."""
    rows = np.zeros((2, 300))
    rows[1, :6] = 1.0
    alike = BoundedMean(rows[0]).interval()
    assert float(alike.high) == pytest.approx(1 - 0.025 ** (1 / 300), rel=1e-9)  # Clopper and Pearson, none of 300
    few = BoundedMean(rows[1], low=0.0)
    assert float(few.interval().low) == pytest.approx(beta.ppf(0.025, 6, 295), rel=1e-9)  # 6 of 300
    assert float(few.test(0.2).p) < 1e-12
