"""Joint tests of several unordered answers: exact enumeration, sign flips, and effects that no single answer shows."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest

from modaltouch.analysis.consistency import effect_findings
from modaltouch.analysis.counts import AnswerCounts, Pair
from modaltouch.analysis.exact import sign_flip_test
from modaltouch.analysis.permutation import association_test
from modaltouch.analysis.statistics import cell_share_findings, joint_findings
from modaltouch.protocol import AnswerList

WORDS = AnswerList.of({"keys": ["rough", "smooth", "sharp"]})
PAIRS = (Pair.of("A", "C", "C"), Pair.of("C", "E", "C"))


def every_arrangement(counts: np.ndarray) -> float:
    """Return p from all arrangements of conditions within participants."""
    totals = counts.sum(axis=(0, 1))
    expected = counts.sum(axis=2, keepdims=True) * counts.sum(axis=1, keepdims=True) / counts.sum(axis=(1, 2))[
        :, np.newaxis, np.newaxis]  # fmt: skip
    residual = counts - expected

    def statistic(orders) -> float:
        sums = sum(residual[who, list(order)] for who, order in enumerate(orders))
        return float((sums**2 / np.maximum(totals, 1)).sum())

    n, k = counts.shape[:2]
    reached = [statistic(orders) for orders in product(permutations(range(k)), repeat=n)]
    return float(np.mean(np.array(reached) >= statistic([range(k)] * n) - 1e-9))


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a generator with a fixed seed."""
    return np.random.default_rng(18)


@pytest.mark.parametrize("missing", [False, True])
def test_p_agrees_with_all_arrangements(rng, missing) -> None:
    """Four participants, three conditions and answers, with and without gaps: within the error of 9,999 shuffles."""
    counts = rng.multinomial(4, [0.5, 0.3, 0.2], size=(6, 4, 3))
    counts -= missing * (rng.random(counts.shape) < 0.2) * (counts > 0)
    exact = np.array([every_arrangement(each) for each in counts])
    assert association_test(counts).p == pytest.approx(exact, abs=5 * np.sqrt(0.25 / 9999))


def test_two_answers_in_two_conditions_give_the_sign_flip_test(rng) -> None:
    """The sum of squares is monotone in the absolute sum of differences; exact p by convolution."""
    counts = rng.multinomial(6, [0.6, 0.4], size=(5, 9, 2))
    exact = sign_flip_test(counts[..., 0, 0] - counts[..., 1, 0]).p
    assert association_test(counts).p == pytest.approx(exact, abs=5 * np.sqrt(0.25 / 9999))


def test_a_gain_from_several_answers_is_found_in_any_order() -> None:
    """Eight people each gain one "sharp", half of them from "rough" and half from "smooth"."""
    counts = np.tile(np.array([[3, 3, 0], [3, 3, 0]]), (8, 1, 1))
    counts[:4, 1] = [2, 3, 1]
    counts[4:, 1] = [3, 2, 1]
    test = association_test(counts)
    assert test.p < 0.02
    assert association_test(counts[::-1, :, ::-1]).p == pytest.approx(test.p, abs=0.005)
    for answer in (0, 1):
        assert sign_flip_test(counts[:, 0, answer] - counts[:, 1, answer]).p_min > 0.05


def test_missing_answers_alone_are_not_a_difference() -> None:
    """All answers are the same, but most are missing in the second condition."""
    counts = np.tile(np.array([[4, 0, 0], [1, 0, 0]]), (10, 1, 1))
    assert (association_test(counts).p, association_test(counts).p_min) == (1, 1)


def test_the_smallest_p_is_that_of_the_most_extreme_data() -> None:
    """Six people, two conditions: 2/2^6; three conditions, two of them equal in three people: 3/3^3."""
    two = np.tile(np.array([[4, 0, 0], [0, 2, 2]]), (6, 1, 1))
    assert association_test(two).p_min == pytest.approx(2 / 64)
    three = np.tile(np.array([[4, 0, 0], [2, 1, 1], [2, 1, 1]]), (3, 1, 1))
    assert association_test(three).p_min == pytest.approx(1 / 9)
    assert association_test(three).p == pytest.approx(every_arrangement(three), abs=0.02)


def test_thirty_conditions_have_a_smallest_p() -> None:
    """30! overflows an integer: all equal gives p 1; one odd condition in each of four people, 30/30^4 or 1/10,000."""
    alike = np.tile(np.array([2, 1, 1]), (4, 30, 1))
    assert (association_test(alike).p, association_test(alike).p_min) == (1, 1)
    odd = alike.copy()
    odd[:, 7] = [0, 2, 2]
    assert association_test(odd).p == association_test(odd).p_min == pytest.approx(1e-4)


def test_each_question_has_its_joint_test_of_all_answers(rng) -> None:
    """Two hands, two pairs, three levels: four tests over levels, two between hands, two between pairs."""
    counts = rng.multinomial(2, [0.5, 0.3, 0.2], size=(6, 2, 2, 3))
    people = tuple(f"p{n}" for n in range(6))
    answers = AnswerCounts(people, ("one_hand", "two_hands"), PAIRS, (80.0, 100.0, 150.0), counts, 2, answers=WORDS)
    found = list(joint_findings(answers))
    assert [(row.family, row.scope) for row in found] == [
        ("b together", "one_hand A-C"), ("b together", "one_hand C-E"), ("b together", "two_hands A-C"),
        ("b together", "two_hands C-E"), ("c together", "A-C"), ("c together", "C-E"), ("d together", "one_hand"),
        ("d together", "two_hands")]  # fmt: skip
    expected = [association_test(counts[:, f, q]).p for f in (0, 1) for q in (0, 1)]
    expected += [association_test(counts[:, :, q].sum(axis=2)).p for q in (0, 1)]
    expected += [association_test(counts[:, f].sum(axis=2)).p for f in (0, 1)]
    assert [row.p for row in found] == expected
    one = AnswerCounts(people, ("one_hand", "two_hands"), PAIRS[:1], (80.0,), counts[:, :, :1, :1], 2, answers=WORDS)
    assert [row.family for row in joint_findings(one)] == ["c together"], (
        "one level and one pair leave nothing to compare"
    )
    assert [word for word, _ in answers.effects(PAIRS[0])] == ["rough", "smooth", "sharp"]
    cells = [row.quantity for row in cell_share_findings(answers)]
    assert cells == ["P(rough)", "P(smooth)", "P(sharp)"] * 12
    assert {row.quantity for row in effect_findings(answers)} == {"P(rough)", "P(smooth)", "P(sharp)"}
    two = AnswerCounts(people, ("one_hand",), PAIRS, (80.0,), counts[:, :1, :, :1], 2)
    assert answers.is_nominal and not two.is_nominal
