"""d' and criterion, against published tables, R's psyphy and the defining integrals."""

from __future__ import annotations

import math
from itertools import product

import mpmath
import numpy as np
import pytest
from scipy.special import ndtr, ndtri
from scipy.stats import binom, binomtest

from modaltouch.analysis.detection import (
    m_intervals,
    odd_of_three,
    same_different,
    share_correct,
    two_intervals,
    yes_no,
)


def test_yes_no_is_the_difference_of_normal_quantiles() -> None:
    """Macmillan and Creelman (2005), chapter 1: hits 20 of 25, false alarms 10 of 25; rates (k + 0.5) / (n + 1)."""
    found = yes_no((20, 25), (10, 25))
    hit, alarm = (float(mpmath.sqrt(2) * mpmath.erfinv(2 * rate - 1)) for rate in (20.5 / 26, 10.5 / 26))
    assert found.d_prime.estimate == pytest.approx(hit - alarm, abs=1e-9)
    assert found.criterion.estimate == pytest.approx(-(hit + alarm) / 2, abs=1e-9)


@pytest.mark.parametrize(("hits", "alarms"), [((20, 25), (10, 25)), ((9, 12), (0, 30)), ((3, 3), (1, 4))])
def test_bounds_of_d_prime_combine_exact_limits_of_both_rates(hits, alarms) -> None:
    """By definition: the extreme d' over SciPy's `binomtest` limits whose normal quantiles lie on a circle."""
    interval = yes_no(hits, alarms).d_prime

    def limits(count: tuple[int, int], quantile: float) -> tuple[float, float]:
        exact = binomtest(*count).proportion_ci(2 * float(ndtr(quantile)) - 1, "exact")
        return exact.low, exact.high

    angles = np.linspace(0.001, np.pi / 2 - 0.001, 300)
    lows, highs = [], []
    with np.errstate(divide="ignore"):
        for hit, alarm in zip(1.959964 * np.sin(angles), 1.959964 * np.cos(angles), strict=True):
            (low, high), (least, most) = limits(hits, hit), limits(alarms, alarm)
            lows.append(float(ndtri(low) - ndtri(most)))
            highs.append(float(ndtri(high) - ndtri(least)))
    assert (interval.low, interval.high) == pytest.approx((min(lows), max(highs)), abs=2e-3)
    assert math.isinf(interval.high) == (alarms[0] == 0 or hits[0] == hits[1])


@pytest.mark.parametrize(("n_signals", "n_noises"), [(20, 10), (40, 40), (80, 8)])
def test_intervals_of_d_prime_and_criterion_have_their_coverage(n_signals, n_noises) -> None:
    """Exact coverage over all outcomes is at least 95 % for d' from 0 to 3 and a criterion from -1 to 1."""
    told = [[yes_no((k, n_signals), (m, n_noises)) for m in range(n_noises + 1)] for k in range(n_signals + 1)]
    for name in ("d_prime", "criterion"):
        low, high = (np.array([[getattr(getattr(each, name), end) for each in row] for row in told])
                     for end in ("low", "high"))  # fmt: skip
        for d_prime, criterion in product((0.0, 0.5, 1.0, 2.0, 3.0), (-1.0, -0.5, 0.0, 0.5, 1.0)):
            hits, alarms = (binom.pmf(range(n + 1), n, ndtr(sign * d_prime / 2 - criterion))
                            for n, sign in ((n_signals, 1), (n_noises, -1)))  # fmt: skip
            true = d_prime if name == "d_prime" else criterion
            assert np.outer(hits, alarms)[(low <= true) & (true <= high)].sum() >= 0.95


@pytest.mark.parametrize(("share", "d_prime"), [(0.55, 0.18), (0.7, 0.74), (0.75, 0.95), (0.85, 1.47), (0.95, 2.33)])
def test_two_alternatives_agree_with_the_table(share, d_prime) -> None:
    """Macmillan and Creelman (2005), table A5.1: d' of two alternatives, sqrt 2 z(share correct)."""
    n = 10**7
    k = round(share * n)
    assert m_intervals((k, n), 2).d_prime.estimate == pytest.approx(d_prime, abs=0.006)
    unbiased = two_intervals((k, n), (n - k, n))
    assert unbiased.d_prime.estimate == pytest.approx(d_prime, abs=0.006)
    assert unbiased.criterion.estimate == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("d_prime", [-0.5, 0.0, 1.0, 3.0])
def test_three_alternatives_are_the_integral_of_the_largest(d_prime) -> None:
    """Hacker and Ratcliff (1979): the signal is the largest of three; by mpmath quadrature, chance at d' = 0."""
    expected = mpmath.quad(lambda t: mpmath.npdf(t - d_prime) * mpmath.ncdf(t) ** 2, [-10, 0, 3, 12])
    assert float(share_correct(d_prime, 3)) == pytest.approx(float(expected), abs=1e-9)
    n = 10**8
    k = round(float(expected) * n)
    assert m_intervals((k, n), 3).d_prime.estimate == pytest.approx(d_prime, abs=1e-4)


def test_a_bias_to_one_interval_is_in_the_criterion() -> None:
    """An observer of d' = 1 and c = 0.5 answers "first" with Phi(1 / sqrt 2 - 0.5) and Phi(-1 / sqrt 2 - 0.5)."""
    n = 10**7
    rates = [round(n * float(mpmath.ncdf(sign / mpmath.sqrt(2) - 0.5))) for sign in (1, -1)]
    found = two_intervals((rates[0], n), (rates[1], n))
    assert found.d_prime.estimate == pytest.approx(1, abs=1e-4)
    assert found.criterion.estimate == pytest.approx(0.5, abs=1e-4)


def test_an_unbiased_criterion_is_exactly_zero() -> None:
    """With as many hits as correct rejections there is no rounding error and no negative zero."""
    criteria = [yes_no((k, 10), (10 - k, 10)).criterion.estimate for k in range(11)]
    assert [str(criterion) for criterion in criteria] == ["0.0"] * 11


@pytest.mark.parametrize(("d_prime", "k"), [(0.5, 1.0), (1.5, 1.2), (3.0, 2.0)])
def test_same_different_is_the_differencing_model(d_prime, k) -> None:
    """Macmillan and Creelman (2005), chapter 9, as in psyphy::dprime.SD: H and F of a known d' and k recover them."""
    n, root = 10**8, mpmath.sqrt(2)
    hit = mpmath.ncdf((d_prime - k) / root) + mpmath.ncdf((-d_prime - k) / root)
    alarm = 2 * mpmath.ncdf(-k / root)
    found = same_different((round(n * float(hit)), n), (round(n * float(alarm)), n))
    assert found.d_prime.estimate == pytest.approx(d_prime, abs=1e-3)
    assert found.criterion.estimate == pytest.approx(k, abs=1e-4)
    turned = same_different((round(n * float(alarm)), n), (round(n * float(hit)), n))
    assert turned.d_prime.estimate == pytest.approx(-d_prime, abs=1e-3)


def test_d_prime_without_a_bound_is_infinite() -> None:
    """All correct gives no upper bound, none of three correct no lower one, and no answers neither."""
    assert m_intervals((20, 20), 3).d_prime.high == math.inf
    assert m_intervals((0, 20), 3).d_prime.low == -math.inf
    nothing = yes_no((0, 0), (0, 0)).d_prime
    assert (nothing.estimate, nothing.low, nothing.high) == (0.0, -math.inf, math.inf)


def test_answers_at_chance_have_a_d_prime_of_zero() -> None:
    """Half of two alternatives gives exactly 0, without rounding error."""
    assert m_intervals((5, 10), 2).d_prime.estimate == 0


@pytest.mark.parametrize(("d_prime", "share"), [(1.0, 0.4180), (2.0, 0.6048), (3.0, 0.7814)])
def test_the_odd_one_of_three_is_the_triangular_model(d_prime, share) -> None:
    """Frijters (1979), and his integral by mpmath; the same share in a known direction would give a smaller d'."""
    root = mpmath.sqrt(3)

    def density(z):
        shift = d_prime * mpmath.sqrt(2) / root
        return 2 * mpmath.npdf(z) * (mpmath.ncdf(-z * root + shift) + mpmath.ncdf(-z * root - shift))

    expected = float(mpmath.quad(density, [0, 2, 10]))
    assert expected == pytest.approx(share, abs=5e-5)
    n = 10**8
    found = odd_of_three((round(expected * n), n))
    assert found.d_prime.estimate == pytest.approx(d_prime, abs=1e-3)
    assert m_intervals((round(expected * n), n), 3).d_prime.estimate < d_prime - 0.5
    below = odd_of_three((2, 9)).d_prime
    assert (below.estimate, below.low) == (0, 0)
