"""Statistics against scipy, statsmodels and plain enumeration, on random data: p, estimates and bounds to 1e-8."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pandas as pd
import pytest
from scipy import optimize, stats
from statsmodels.stats.multitest import multipletests

from modaltouch.analysis.consistency import ac1_interval, agreement_between, consistency_findings
from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.covariates import side_findings
from modaltouch.analysis.designs import power_law
from modaltouch.analysis.exact import multinomial_test, sign_flip_test, trend_test
from modaltouch.analysis.findings import holm
from modaltouch.analysis.intervals import BoundedMean
from modaltouch.analysis.permutation import rank_test, shuffle_test


@pytest.fixture(params=range(5))
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Return a generator with its own seed for each test."""
    return np.random.default_rng(request.param)


def close(value: float, other: float) -> bool:
    """Whether two values agree to 1e-8."""
    return value == pytest.approx(other, rel=1e-8, abs=1e-8)


def test_holm_agrees_with_statsmodels_with_ties(rng) -> None:
    """Families of 1 to 11 tests, with ties."""
    p = rng.integers(1, 40, rng.integers(1, 12)) / 40
    assert holm(p) == pytest.approx(multipletests(p, method="holm")[1])


def test_ac1_is_gwets_formula_with_missing_ratings(rng) -> None:
    """Gwet (2008): agreement over items with at least two answers, chance from the mean shares of the categories."""
    n, items, kinds = rng.integers(4, 9), rng.integers(2, 6), rng.integers(2, 5)
    given = rng.integers(0, kinds, (n, items))
    told = rng.random((n, items)) > 0.15
    table = np.stack([(given == kind) & told for kind in range(kinds)], axis=-1).astype(int)
    counts = table.sum(axis=0)
    several, some = counts[counts.sum(axis=1) > 1], counts[counts.sum(axis=1) > 0]
    m = several.sum(axis=1)
    agreement = np.mean((several * (several - 1)).sum(axis=1) / (m * (m - 1)))
    share = (some / some.sum(axis=1, keepdims=True)).mean(axis=0)
    chance = (share * (1 - share)).sum() / (kinds - 1)
    assert close(agreement_between(table, np.ones((1, n)))[0][0], agreement)
    assert close(ac1_interval(table).estimate, (agreement - chance) / (1 - chance))


def test_a_bounded_mean_agrees_with_divided_differences(rng) -> None:
    """With distinct scores, Dirichlet weights give a divided difference; bounds, both p and equivalence follow."""
    scores = np.sort(rng.uniform(-0.9, 0.9, rng.integers(3, 8)))

    def p(values: np.ndarray, mean: float) -> float:
        knots = np.append(values, -1.0)
        tops = [(knot - mean) ** len(values) / np.prod(knot - np.delete(knots, at))
                for at, knot in enumerate(knots) if knot > mean]  # fmt: skip
        return 1 - sum(tops)

    mean, above, below = BoundedMean(scores), p(scores, 0.0), p(-scores, 0.0)
    assert close(mean.test(0.0).p, min(1, 2 * min(above, below)))
    assert close(mean.equivalence(0.3).p, max(p(scores, -0.3), p(-scores, -0.3)))
    low = optimize.brentq(lambda at: p(scores, at) - 0.025, -1 + 1e-12, scores.mean(), xtol=1e-14)
    high = -optimize.brentq(lambda at: p(-scores, at) - 0.025, -1 + 1e-12, -scores.mean(), xtol=1e-14)
    assert (mean.interval().low, mean.interval().high) == pytest.approx((low, high), abs=1e-8)


def test_a_trend_agrees_with_all_orders(rng) -> None:
    """Three participants, four unevenly spaced levels: every assignment of their answers to the levels."""
    levels = np.array([5.0, 12.0, 30.0, 80.0])
    counts = rng.integers(0, 2, (3, 4))
    own = [[levels[list(which)].sum() for which in combinations(range(4), int(row.sum()))] for row in counts]
    sums = np.array([sum(each) for each in product(*own)]) - sum(map(np.mean, own))
    observed = (counts @ levels).sum() - sum(map(np.mean, own))
    assert close(trend_test(counts, levels.tolist()).p, np.mean(np.abs(sums) >= abs(observed) - 1e-9))


def test_flips_ranks_and_shuffles_agree_with_scipy(rng) -> None:
    """Integers with ties and zeros, and two groups: scipy counts every order."""
    values = rng.integers(-6, 7, 9)
    known = stats.permutation_test((values,), np.sum, permutation_type="samples", n_resamples=np.inf)
    assert close(sign_flip_test(values).p, min(1.0, known.pvalue))
    moved = values[values != 0].astype(float)
    ranked = stats.wilcoxon(moved, method=stats.PermutationMethod(n_resamples=np.inf))
    assert close(rank_test(values.astype(float)).p, ranked.pvalue)
    first, second = rng.normal(size=5), rng.normal(0.8, 1, 4)
    joined = np.concatenate([first, second])
    gaps = [joined[list(chosen)].mean() - np.delete(joined, chosen).mean() for chosen in combinations(range(9), 5)]
    assert close(shuffle_test(first, second).p, np.mean(np.abs(gaps) >= abs(first.mean() - second.mean()) - 1e-12))


def test_the_multinomial_test_and_the_exponent_agree_with_scipy(rng) -> None:
    """Every outcome of seven answers with scipy's probabilities; a line through logarithms with its t interval."""
    counts = rng.multinomial(7, np.ones(3) / 3)

    def ratio(given: np.ndarray) -> float:
        return float(2 * (given[given > 0] * np.log(given[given > 0] * 3 / 7)).sum())

    outcomes = [np.array(each) for each in product(range(8), repeat=3) if sum(each) == 7]
    law = stats.multinomial(7, np.ones(3) / 3)
    p = sum(law.pmf(each) for each in outcomes if ratio(each) >= ratio(counts) - 1e-9)
    assert close(multinomial_test(counts).p, p)
    levels = np.repeat([10.0, 20.0, 40.0, 80.0], 3)
    rated = np.exp(rng.normal(0.6 * np.log(levels), 0.3))
    line, found = stats.linregress(np.log(levels), np.log(rated)), power_law(levels, rated)
    half = stats.t.ppf(0.975, 10) * line.stderr
    assert (found.estimate, found.low, found.high) == pytest.approx((line.slope, line.slope - half, line.slope + half))


def test_agreement_side_bias_and_prevalence_agree_with_single_answers(rng) -> None:
    """Six people, five answers per cell: pairs of people for AC1, shares for the side, scipy's sign test for each."""
    kinds, pairs = ("left", "both", "right"), (("A", "C"), ("C", "E"))
    cells = [*product(range(6), pairs, (80.0, 150.0), range(5))]
    words = [str(rng.choice(kinds, p=(0.2, 0.2, 0.6) if pair[1] == "C" else (0.5, 0.3, 0.2))) for _, pair, *_ in cells]
    rows = [
        {"participant": f"p{who}", "finger_condition": "one_hand", "zone_left": left, "zone_right": right,
         "velocity_mm_s": level, "response": word, "n": 1}
        for (who, (left, right), level, _), word in zip(cells, words, strict=True)
    ]  # fmt: skip
    answers = count_answers(pd.DataFrame(rows), "C")
    found = {
        row.name.split(",")[0]: row for row in (*side_findings(answers), *reversed([*consistency_findings(answers)]))
    }
    given = np.zeros((6, 2, 2, 3))
    for (who, pair, level, _), word in zip(cells, words, strict=True):
        given[who, pairs.index(pair), int(level > 100), kinds.index(word)] += 1 / 5
    own = given[:, 0]
    alike = np.mean([(own[a] * own[b]).sum(axis=-1) for a, b in combinations(range(6), 2)])
    popular = own.mean(axis=(0, 1))
    chance = (popular * (1 - popular)).sum() / 2
    assert close(found["agreement between participants"].estimate, (alike - chance) / (1 - chance))
    side = given[:, 0, :, 2].mean() - given[:, 1, :, 0].mean()
    assert close(found["side bias"].estimate, side)
    ahead = [(round(5 * each[:, 2].sum()), round(5 * each[:, 0].sum())) for each in own]
    n_shown = sum(a > b and stats.binomtest(a, a + b).pvalue <= 0.05 for a, b in ahead)
    exact = stats.binomtest(n_shown, 6).proportion_ci(method="exact")
    shown = found["prevalence of dominance"]
    assert (shown.estimate, shown.low, shown.high) == pytest.approx((n_shown / 6, exact.low, exact.high))
