"""The statistics against published worked examples and tables."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from scipy.stats import page_trend_test

from modaltouch.analysis.exact import sign_flip_test, trend_test
from modaltouch.analysis.intervals import clopper_pearson
from modaltouch.analysis.sums import tail_probability


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [(81, 263, 0.2527, 0.3676), (15, 148, 0.0578, 0.1617), (0, 20, 0.0, 0.1684), (1, 29, 0.0009, 0.1776)],
)
def test_clopper_pearson_is_newcombes_method_5(successes: int, n: int, low: float, high: float) -> None:
    """Newcombe, Statistics in Medicine 17 (1998) 857-872, table I, method 5: four decimals."""
    interval = clopper_pearson(successes, n)
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=5.01e-5)


def test_sign_flips_of_single_pairs_are_the_exact_mcnemar_test() -> None:
    """Fagerland, Lydersen, Laake, BMC Med. Res. Methodol. 13 (2013) 91: of 21 pairs 1 and 7 discordant, p = 0.070."""
    test = sign_flip_test([1] * 1 + [-1] * 7 + [0] * 13)
    assert test.p == pytest.approx(2 * (1 + 8) / 2**8, rel=1e-12)
    assert test.p == pytest.approx(0.070, abs=5e-4)


PAGE = [
    (3, 2, 28, None), (3, 3, 41, 42), (3, 4, 54, 55), (3, 10, 128, 131), (4, 2, 58, 60), (4, 3, 84, 87),
    (4, 4, 111, 114), (5, 2, 103, 106), (5, 3, 150, 155),
]  # fmt: skip
"""Treatments, judges, and the least L at the 5 % and the 1 % level (Page, J. Am. Stat. Assoc. 58 (1963), table 2)."""


@pytest.mark.parametrize(("n_levels", "n_judges", "five", "one"), PAGE)
def test_convolution_gives_pages_table(n_levels: int, n_judges: int, five: int, one: int | None) -> None:
    """Page (1963): one-sided critical values of L, the sum over judges of level times rank."""
    steps, ways = np.unique(
        [np.dot(order, range(1, n_levels + 1)) for order in permutations(range(1, n_levels + 1))], return_counts=True
    )
    judges = [(steps.astype(np.int64), ways / ways.sum(), n_judges)]
    for level, critical in ((0.05, five), (0.01, one)):
        if critical is not None:
            below_all = -1
            assert tail_probability(judges, below_all, critical) <= level
            assert tail_probability(judges, below_all, critical - 1) > level


def test_the_trend_over_equal_steps_is_pages_test_of_binary_answers() -> None:
    """Identity: with equal ranks for equal answers, L is the trend up to scale and shift; p by every rearrangement.

    Reference for L: scipy.stats.page_trend_test, whose own p ignores ties.
    """
    rng = np.random.default_rng(5)
    levels = [1.0, 2.0, 3.0, 4.0]
    for answers in rng.integers(0, 2, (5, 3, 4)):
        observed = _page(answers)
        test = trend_test(answers, levels)
        middle = 25.0 * len(answers)
        assert observed - middle == pytest.approx(test.statistic * 2, abs=1e-9)
        every = [_page(np.array(rows)) for rows in product(*(set(permutations(row)) for row in answers.tolist()))]
        p = np.mean(np.abs(np.array(every) - middle) >= abs(observed - middle) - 1e-9)
        assert test.p == pytest.approx(float(p), rel=1e-12)


def _page(answers: np.ndarray) -> float:
    return float(page_trend_test(answers, ranked=False, method="asymptotic").statistic)
