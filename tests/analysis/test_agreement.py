from __future__ import annotations

import math

import numpy as np
import pytest

from modaltouch.analysis.agreement import ac1_interval, gwet_ac1, pairwise_agreement, prevalence

NA = 0
RAW4RATERS = [
    (1, 1, NA, 1), (2, 2, 3, 2), (3, 3, 3, 3), (3, 3, 3, 3), (2, 2, 2, 2), (1, 2, 3, 4), (4, 4, 4, 4), (1, 1, 2, 1),
    (2, 2, 2, 2), (NA, 5, 5, 5), (NA, NA, 1, 1), (NA, 3, NA, NA),
]  # fmt: skip
"""Twelve units by four raters (Gwet, Handbook of Inter-Rater Reliability, 4th ed., 2014, page 120)."""


def table(ratings: list[tuple[int, ...]], n_categories: int) -> list[list[int]]:
    """Return how many raters chose each category, per unit; 0 is a missing rating."""
    return [[row.count(k + 1) for k in range(n_categories)] for row in ratings]


def test_gwets_worked_example_with_missing_ratings_is_reproduced() -> None:
    """Gwet (2014) and the R package irrCAC: agreement 0.81818, AC1 0.77544."""
    ratings = table(RAW4RATERS, 5)
    assert pairwise_agreement(ratings) == pytest.approx(0.81818, abs=5e-6)
    assert gwet_ac1(ratings) == pytest.approx(0.77544, abs=5e-6)


def test_two_raters_and_three_categories_give_the_published_value() -> None:
    """Package irrCAC, dataset cont3x3abstractors: AC1 0.8493305."""
    confusion = [[13, 0, 0], [0, 20, 7], [0, 4, 56]]
    ratings = [
        [int(k == a) + int(k == b) for k in range(3)]
        for a in range(3)
        for b in range(3)
        for _ in range(confusion[a][b])
    ]
    assert gwet_ac1(ratings) == pytest.approx(0.8493305, abs=5e-8)


def test_full_agreement_is_one() -> None:
    """AC1 is defined where kappa is not."""
    assert gwet_ac1([[10, 0, 0]] * 4) == 1


def test_an_item_with_one_answer_says_nothing() -> None:
    """Agreement needs two."""
    assert math.isnan(pairwise_agreement([[1, 0, 0]]))


class TestInterval:
    def test_full_agreement_keeps_a_width(self) -> None:
        """Ten alike: up to 0.31 of people could differ (1 - 0.025^(1/10)), so AC1 may be as low as 0.38."""
        interval = ac1_interval(np.tile([1, 0, 0], (10, 4, 1)))
        u = 1 - 0.025**0.1
        agreement, chance = (1 - u) ** 2 + u**2 / 2, u - 0.75 * u**2
        assert interval.estimate == 1
        assert interval.low == pytest.approx((agreement - chance) / (1 - chance), rel=1e-12)

    def test_the_jackknife_leaves_out_one_participant_at_a_time(self) -> None:
        """Reference: t interval from the ten leave-one-out values, computed here from the definition."""
        from scipy.stats import t

        rng = np.random.default_rng(2)
        answers = np.eye(3, dtype=int)[rng.choice(3, (10, 4), p=[0.7, 0.25, 0.05])]
        values = np.array([gwet_ac1(np.delete(answers, i, axis=0).sum(axis=0)) for i in range(10)])
        half = t.ppf(0.975, 9) * math.sqrt(0.9 * ((values - values.mean()) ** 2).sum())
        interval = ac1_interval(answers)
        assert interval.low == pytest.approx(interval.estimate - half, rel=1e-9)

    def test_two_participants_have_no_interval(self) -> None:
        """A jackknife over two says nothing."""
        interval = ac1_interval(np.tile([1, 0, 0], (2, 4, 1)))
        assert (interval.low, interval.high) == (-1, 1)

    def test_three_participants_have_an_interval(self) -> None:
        """The fewest a jackknife can do with; all alike, up to 0.71 of people could differ (1 - 0.025^(1/3))."""
        interval = ac1_interval(np.tile([1, 0, 0], (3, 4, 1)))
        u = 1 - 0.025 ** (1 / 3)
        spread, chance = (1 - u) ** 2 + u**2 / 2, u - 0.75 * u**2
        alike, alike_chance = (1 - u) ** 2 + u**2, u * (1 - u)
        least = min((spread - chance) / (1 - chance), (alike - alike_chance) / (1 - alike_chance))
        assert (interval.estimate, interval.high, interval.n_effective) == (1, 1, 3)
        assert interval.low == pytest.approx(least, rel=1e-12)

    def test_hundreds_of_participants_are_left_out_one_by_one(self) -> None:
        """The jackknife over 400 participants, computed without the function."""
        rng = np.random.default_rng(4)
        answers = np.eye(3, dtype=int)[rng.choice(3, (400, 4), p=[0.7, 0.25, 0.05])]
        values = np.array([gwet_ac1(np.delete(answers, i, axis=0).sum(axis=0)) for i in range(400)])
        error = math.sqrt(399 / 400 * ((values - values.mean()) ** 2).sum())
        interval = ac1_interval(answers)
        assert (interval.high - interval.low) / 2 == pytest.approx(1.966 * error, rel=1e-3)


@pytest.mark.parametrize(("k", "n", "share"), [(14, 20, 0.6842), (0, 10, 0.0), (10, 10, 1.0)])
def test_prevalence_is_the_published_mode(k, n, share) -> None:
    """Ince et al. (2021), MAP = (k/n - alpha) / (1 - alpha) at alpha 0.05, not below 0."""
    assert prevalence(k, n) == pytest.approx(share, abs=5e-5)
