from __future__ import annotations

import math

import numpy as np
import pytest

from modaltouch.analysis.consistency import ac1_interval, agreement_between, prevalence

NA = 0
RAW4RATERS = [
    (1, 1, NA, 1), (2, 2, 3, 2), (3, 3, 3, 3), (3, 3, 3, 3), (2, 2, 2, 2), (1, 2, 3, 4), (4, 4, 4, 4), (1, 1, 2, 1),
    (2, 2, 2, 2), (NA, 5, 5, 5), (NA, NA, 1, 1), (NA, 3, NA, NA),
]  # fmt: skip
"""Twelve units by four raters (Gwet, Handbook of Inter-Rater Reliability, 4th ed., 2014, page 120)."""


def by_rater(ratings: list[tuple[int, ...]], n_categories: int) -> np.ndarray:
    """Return one-hot ratings of each rater and unit; 0 is a missing rating."""
    return (np.array(ratings).T[:, :, np.newaxis] == np.arange(1, n_categories + 1)).astype(int)


def alike(answers: np.ndarray) -> tuple[float, float]:
    """Return agreement and AC1 with equal weights for all raters."""
    agreement, ac1 = agreement_between(answers, np.ones((1, len(answers))))
    return float(agreement[0]), float(ac1[0])


def test_gwets_worked_example_with_missing_ratings_is_reproduced() -> None:
    """Agreement 0.81818 and AC1 0.77544 as in Gwet (2014) and the R package irrCAC."""
    assert alike(by_rater(RAW4RATERS, 5)) == pytest.approx((0.81818, 0.77544), abs=5e-6)


def test_two_raters_and_three_categories_give_the_published_value() -> None:
    """R package irrCAC, dataset cont3x3abstractors: AC1 0.8493305."""
    confusion = [[13, 0, 0], [0, 20, 7], [0, 4, 56]]
    ratings = [(a + 1, b + 1) for a in range(3) for b in range(3) for _ in range(confusion[a][b])]
    assert alike(by_rater(ratings, 3))[1] == pytest.approx(0.8493305, abs=5e-8)


def test_full_agreement_is_one() -> None:
    """AC1 is defined there, unlike kappa."""
    assert alike(np.tile([1, 0, 0], (10, 4, 1))) == (1, 1)


def test_an_item_without_answers_changes_nothing() -> None:
    """Neither the agreement nor the prevalence of each answer depends on it."""
    nobody = (NA,) * 4
    assert alike(by_rater([*RAW4RATERS, nobody], 5)) == pytest.approx(alike(by_rater(RAW4RATERS, 5)), rel=1e-12)


def test_an_item_with_one_answer_has_no_agreement() -> None:
    """Agreement needs at least two answers."""
    assert math.isnan(alike(np.array([[[1, 0, 0]]]))[0])


class TestInterval:
    @pytest.mark.parametrize(("n", "is_bounded"), [(2, False), (3, True)])
    def test_a_bounded_interval_needs_three_participants(self, n, is_bounded) -> None:
        """Two participants form one pair, whose agreement gives no information on other pairs: -1 to 1."""
        assert (ac1_interval(np.tile([1, 0, 0], (n, 4, 1))).low > -1) == is_bounded

    def test_full_agreement_keeps_a_width(self) -> None:
        """Ten agree: the weight of one who disagrees is above 1 - 0.025^(1/10) = 0.31 in 2.5 % of draws."""
        interval = ac1_interval(np.tile([1, 0, 0], (10, 4, 1)))
        assert (interval.estimate, interval.high) == (1, 1)
        assert 0.3 < interval.low < 0.45

    def test_bounds_agree_with_an_independent_computation(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Gwet (2008) from the agreement of each pair, with a participant added who disagrees, or agrees with most.

        400,000 exponential weightings of another seed, against as many: a bound has a standard error of 0.001.
        """
        n_draws, rng = 400_000, np.random.default_rng(12)
        answers = np.eye(3)[np.random.default_rng(11).multinomial(1, [0.7, 0.2, 0.1], (8, 4)).argmax(axis=-1)]
        monkeypatch.setattr("modaltouch.analysis.consistency._DRAWS", n_draws)
        expected = []
        for end, quantile in ((np.min, 0.025), (np.max, 0.975)):
            votes = answers.sum(axis=0)
            chosen = votes == end(votes, axis=1, keepdims=True)
            people = np.concatenate([answers, [chosen / chosen.sum(axis=1, keepdims=True)]])
            of_pairs = np.array([[(a * b).sum(axis=1).mean() for b in people] for a in people])
            np.fill_diagonal(of_pairs, 0.0)
            weights = rng.exponential(size=(n_draws, 9))
            weights /= weights.sum(axis=1, keepdims=True)
            alike = ((weights @ of_pairs) * weights).sum(axis=1) / (1 - (weights**2).sum(axis=1))
            popular = weights @ people.mean(axis=1)
            chance = (popular * (1 - popular)).sum(axis=1) / 2
            expected.append(float(np.quantile((alike - chance) / (1 - chance), quantile)))
        interval = ac1_interval(answers.astype(int))
        assert (interval.low, interval.high) == pytest.approx(expected, abs=0.004)

    def test_weights_drawn_in_parts_are_the_same(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Drawn in blocks that fit in memory, the bounds of thirty agree to rounding."""
        given = np.random.default_rng(7).multinomial(1, [0.7, 0.2, 0.1], (2, 30, 4))
        whole = ac1_interval(given)
        monkeypatch.setattr("modaltouch.analysis.consistency._AT_ONCE", 2000)
        parts = ac1_interval(given)
        np.testing.assert_allclose([parts.low, parts.high], [whole.low, whole.high], rtol=1e-12)

    def test_two_participants_have_no_interval(self) -> None:
        """The agreement of two gives no information on others."""
        interval = ac1_interval(np.tile([1, 0, 0], (2, 4, 1)))
        assert (interval.low, interval.high) == (-1, 1)

    def test_participants_who_all_answer_evenly_have_no_interval(self) -> None:
        """Each gives every item both answers once: AC1 is 0, but the spread between participants is unknown."""
        interval = ac1_interval(np.ones((10, 4, 2), dtype=int))
        assert (interval.estimate, interval.low, interval.high) == (0, -1, 1)

    def test_the_order_of_participants_and_answers_does_not_matter(self) -> None:
        """Reordered participants have the same interval; reordered answers have it within 0.02."""
        answers = np.random.default_rng(1).multinomial(1, [0.45, 0.45, 0.1], (8, 4))
        interval, renamed, relabelled = map(ac1_interval, (answers, answers[::-1], answers[..., ::-1]))
        assert (renamed.low, renamed.high) == (interval.low, interval.high)
        assert (relabelled.low, relabelled.high) == pytest.approx((interval.low, interval.high), abs=0.02)

    @pytest.mark.parametrize(("share", "n"), [(0.1, 10), (0.3, 20)])
    def test_a_minority_that_disagrees_is_covered(self, share, n) -> None:
        """Population: some answer 2, the others 1, each with 5 % slips; 300 experiments, 95 % minus 3 sd."""
        rng = np.random.default_rng(n)

        def sample(shape: tuple[int, ...]) -> np.ndarray:
            usual = (rng.random((*shape, 1)) < share).astype(int)
            slips = rng.random((*shape, 4)) < 0.05
            return np.eye(3, dtype=int)[np.where(slips, 2, usual)]

        _, true = agreement_between(sample((20_000,)), np.ones((1, 20_000)))
        interval = ac1_interval(sample((300, n)))
        held = (interval.low <= true[0]) & (true[0] <= interval.high)
        assert held.mean() >= 0.95 - 3 * math.sqrt(0.05 * 0.95 / 300)


@pytest.mark.parametrize(("k", "n", "share"), [(14, 20, 0.6842), (0, 10, 0.0), (10, 10, 1.0)])
def test_prevalence_is_the_published_mode(k, n, share) -> None:
    """Ince et al. (2021): MAP = (k/n - alpha) / (1 - alpha) at alpha 0.05, not below 0."""
    assert prevalence(k, n) == pytest.approx(share, abs=5e-5)
