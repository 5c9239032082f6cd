from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import norm

from modaltouch.analysis.covariates import fit_ordered_probit


def simulate(slope: float, n: int = 400, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return predictor, answers and participants of a synthetic ordered probit with cuts -0.7 and 0.7."""
    rng = np.random.default_rng(seed)
    x = rng.choice([-1.0, 0.0, 1.0], n)
    return x, np.digitize(slope * x + rng.standard_normal(n), [-0.7, 0.7]), np.arange(n) % 20


def test_the_slope_is_the_likeliest_one() -> None:
    """Reference: the ordered probit likelihood written out and maximised by scipy."""
    x, y, who = simulate(1.2)

    def loss(values) -> float:
        cuts = np.array([-np.inf, values[1], values[1] + np.exp(values[2]), np.inf])
        return -np.log(norm.cdf(cuts[y + 1] - values[0] * x) - norm.cdf(cuts[y] - values[0] * x)).sum()

    best = minimize(loss, [0.5, -0.5, 0.0]).x
    slope, note = fit_ordered_probit(x, y, who)
    assert slope.estimate == pytest.approx(best[0], abs=2e-3)
    assert "not estimable" not in note


def test_the_true_slope_lies_in_the_interval() -> None:
    """Recovery on a synthetic set of 400 answers."""
    slope, note = fit_ordered_probit(*simulate(1.2, seed=3))
    assert slope.low < 1.2 < slope.high


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        ([-1, -1, 0, 0, 1, 1], [0, 0, 1, 1, 2, 2], "separates"),
        ([-1, -1, 0, 1, 1, 1], [0, 0, 0, 2, 2, 2], "separates"),
        ([-1, 0, 1, -1, 0, 1], [1, 1, 1, 1, 1, 1], "all answers are the same"),
        ([1, 1, 1, 1, 1, 1], [0, 1, 2, 0, 1, 2], "all ratios are the same"),
        ([0, math.inf, 1, 1, 0, 0], [0, 1, 2, 0, 1, 2], "not a number"),
    ],
)
def test_what_cannot_be_fitted_is_called_not_estimable(x, y, words) -> None:
    """Separation and lack of variation give no number at all."""
    slope, note = fit_ordered_probit(x, y, [1, 1, 2, 2, 3, 3])
    assert math.isnan(slope.estimate)
    assert words in note


def test_nearly_all_alike_gives_a_flag_or_a_bounded_slope() -> None:
    """One odd answer of 80: never a huge coefficient with a tiny error."""
    x = np.tile([-1.0, 1.0], 40)
    y = np.where(x > 0, 2, 0)
    y[0] = 1
    slope, note = fit_ordered_probit(x, y, np.arange(80) % 10)
    assert "not estimable" in note or abs(slope.estimate) <= 10
