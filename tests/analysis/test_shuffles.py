from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from statsmodels.stats.contingency_tables import cochrans_q

from modaltouch.analysis import shuffles
from modaltouch.analysis.shuffles import level_association, pair_association, participant_heterogeneity


def binary(rows: list[tuple[int, ...]]) -> np.ndarray:
    """Return 0/1 answers as counts (participants, places, 2)."""
    return np.eye(2, dtype=int)[np.array(rows)]


COCHRAN = [
    *[(1, 1, 1, 1)] * 4, *[(1, 1, 0, 1)] * 2, *[(0, 1, 1, 1)] * 3, (0, 1, 0, 1), *[(0, 0, 0, 0)] * 59,
]  # fmt: skip
"""Growth of diphtheria bacilli from 69 specimens on four media (Cochran, Biometrika 37 (1950) 256-266, table 1)."""


@pytest.mark.parametrize("statistic", [level_association, pair_association])
def test_cochrans_example_gives_his_q(statistic) -> None:
    """Cochran (1950): Q = 8.05 with 3 degrees of freedom; both statistics become Q for 0/1 answers."""
    assert statistic(binary(COCHRAN)).test.statistic == pytest.approx(8.05, abs=0.005)


@pytest.mark.parametrize("statistic", [level_association, pair_association])
def test_binary_answers_give_cochrans_q_of_statsmodels(statistic) -> None:
    """Reference: statsmodels.stats.contingency_tables.cochrans_q."""
    rows = np.random.default_rng(3).integers(0, 2, (12, 4))
    assert statistic(binary(rows)).test.statistic == pytest.approx(cochrans_q(rows).statistic, rel=1e-9)


def test_the_p_of_levels_is_that_of_all_shuffles() -> None:
    """Expected value: the statistic (a quadratic form, written out here) over all 12 x 12 distinct shuffles."""
    rows = [(0, 1, 2, 2), (0, 0, 1, 2)]
    tables = [np.eye(3)[list(a)] for a in rows]
    spread = sum((np.diag(t.mean(axis=0)) - np.outer(t.mean(axis=0), t.mean(axis=0))) * 4 / 3 for t in tables)
    inverse = np.linalg.pinv(spread)

    def statistic(arranged) -> float:
        gap = sum(np.eye(3)[list(a)] for a in arranged) - sum(t.mean(axis=0) for t in tables)
        return float(sum(row @ inverse @ row for row in gap))

    values = np.array([statistic(a) for a in product(*[list(permutations(row)) for row in rows])])
    shuffled = level_association(np.eye(3, dtype=int)[np.array(rows)])
    assert shuffled.test.statistic == pytest.approx(statistic(rows), rel=1e-9)
    assert shuffled.low <= np.mean(values >= statistic(rows) - 1e-9) <= shuffled.high


@pytest.mark.parametrize("test", [level_association, pair_association])
def test_constant_answers_hold_no_information(test) -> None:
    """All the same: p and the smallest p are 1, no draw is made, nothing fails."""
    shuffled = test(np.tile([0, 1, 0], (10, 4, 1)))
    assert (shuffled.test.p, shuffled.test.p_min, shuffled.n_shuffles) == (1, 1, 0)


def test_two_odd_answers_of_one_participant_cannot_be_rarer_than_one_in_ten() -> None:
    """Closed form: of the ten places of the second odd answer one is the same participant's, so p = p_min = 0.1."""
    scores = np.ones((10, 4), dtype=int)
    scores[6, :2] = 0
    shuffled = participant_heterogeneity(scores)
    assert shuffled.test.p == shuffled.test.p_min
    assert shuffled.low <= 0.1 <= shuffled.high


def test_one_odd_answer_cannot_show_that_participants_differ() -> None:
    """Wherever it falls the statistic is the same."""
    scores = np.ones((10, 4), dtype=int)
    scores[6, 0] = 0
    assert participant_heterogeneity(scores).test.p_min == 1


def test_participants_who_differ_are_found() -> None:
    """Half always 1, half always -1: far beyond any shuffle."""
    scores = np.repeat([[1] * 4, [-1] * 4], 5, axis=0)
    assert participant_heterogeneity(scores).test.p < 0.001


def test_p_is_never_zero_and_the_seed_repeats_it() -> None:
    """Phipson and Smyth (2010): (1 + reached) / (1 + shuffles)."""
    table = np.eye(3, dtype=int)[np.tile([0, 1, 2, 2], (30, 1))]
    one, other = level_association(table), level_association(table)
    assert one.test.p == pytest.approx(1 / (one.n_shuffles + 1))
    assert (one.test.p, one.low, one.high) == (other.test.p, other.low, other.high)


def test_large_data_get_fewer_shuffles_and_say_how_many() -> None:
    """Bound on the work; the note carries interval, number and seed."""
    rng = np.random.default_rng(1)
    table = rng.multinomial(10, [0.3, 0.4, 0.3], (500, 4))
    shuffled = level_association(table)
    assert 199 <= shuffled.n_shuffles < 9999
    assert f"{shuffled.n_shuffles} shuffles, seed" in shuffled.note


def test_the_level_is_kept_under_the_null(monkeypatch) -> None:
    """Type I error on guesses within its Monte Carlo interval (300 experiments, 3 sd)."""
    rng = np.random.default_rng(6)
    tables = np.eye(3, dtype=int)[rng.integers(0, 3, (300, 6, 4))]
    monkeypatch.setattr(shuffles, "SHUFFLES", 299)
    p = np.array([level_association(table).test.p for table in tables])
    assert np.mean(p <= 0.05) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 300)
