"""Joint tests of several unordered answers: exact enumeration, sign flips, and effects that no single answer shows."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, permutations, product

import numpy as np
import pytest

from modaltouch.analysis.consistency import effect_findings
from modaltouch.analysis.counts import AnswerCounts, Pair
from modaltouch.analysis.exact import sign_flip_test
from modaltouch.analysis.findings import Finding
from modaltouch.analysis.intervals import Interval
from modaltouch.analysis.measures import IndividualValue, Measure, contrast_findings, group_findings
from modaltouch.analysis.permutation import association_test
from modaltouch.analysis.ratings import level_findings
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


SHARES = [Measure(f"P({word})", f"P({word})", "shares", share_of="all answers") for word in WORDS.names]
RATED = [replace(each, question="rating", is_ranked=True, share_of="all answers to feel") for each in SHARES]


def values_of(measures, shares, places, levels=(80.0,)) -> list[IndividualValue]:
    """Return (people, places, levels, answers) shares as values of each participant."""
    return [
        IndividualValue(measure, f"p{who}", "one_hand", place, level, Interval.point(share[who, p, k, w], 4), 4)
        for w, measure in enumerate(measures)
        for share in [np.asarray(shares)]
        for who in range(len(share))
        for p, place in enumerate(places)
        for k, level in enumerate(levels)
    ]


def test_stimuli_are_compared_by_all_answers_together(rng) -> None:
    """With equal numbers of answers, the test of shares is that of counts; reference: all 2^7 arrangements."""
    counts = rng.multinomial(4, [0.5, 0.3, 0.2], size=(7, 2))
    values = values_of(SHARES, counts[:, :, np.newaxis] / 4, ("A-C fast", "A-C slow"))
    *each, both = contrast_findings(values)
    assert [row.family for row in each] == ["shares compared", "shares compared on average"] * 3
    assert (both.family, both.scope, both.n) == ("shares together", "one_hand A-C fast - A-C slow", 7)
    assert both.p == association_test(counts).p == pytest.approx(every_arrangement(counts), abs=0.03)
    two = [replace(measure, share_of="") for measure in SHARES[:1]]
    assert len(list(contrast_findings(values_of(two, counts[:, :, np.newaxis] / 4, ("A-C fast", "A-C slow"))))) == 2


def test_three_stimuli_are_compared_jointly_at_their_common_levels(rng) -> None:
    """One test of shares covers both levels; a participant with a level missing counts with the other."""
    counts = rng.multinomial(4, [0.5, 0.3, 0.2], size=(6, 3, 2))
    places = ("A-C fast", "A-C mid", "A-C slow")
    values = values_of(SHARES, counts / 4, places, (80.0, 100.0))
    *_, both = contrast_findings(values)
    assert (both.family, both.scope, both.n) == ("shares together", f"one_hand {' - '.join(places)}", 6)
    assert both.p == pytest.approx(every_arrangement(counts.sum(axis=2)), abs=0.03)
    gone = [each for each in values if (each.participant, each.pair, each.level) != ("p0", "A-C mid", 80.0)]
    *_, both = contrast_findings(gone)
    shares = counts.mean(axis=2)
    shares[0] = counts[0, :, 1]
    assert both.p == pytest.approx(every_arrangement(shares), abs=0.03)
    assert sum("together" in row.name for row in contrast_findings(gone)) == 1


def test_stimuli_without_complete_participants_are_compared_pairwise(rng) -> None:
    """A stimulus at other levels is left out, incomplete blocks are tested in pairs, a gap is noted."""
    counts = rng.multinomial(4, [0.5, 0.3, 0.2], size=(6, 3, 2))
    places = ("A-C fast", "A-C mid", "A-C slow")
    values = values_of(SHARES, counts / 4, places, (80.0, 100.0))
    moved = [replace(each, level=each.level + 1) if each.pair == places[2] else each for each in values]
    assert [row.scope for row in joint(moved)] == ["one_hand A-C fast - A-C mid"]
    blocks = [each for each in values if each.pair != places[int(each.participant[1:]) % 3]]
    assert [(row.scope, row.n) for row in joint(blocks)] == [
        (f"one_hand {one} - {other}", 2) for one, other in combinations(("A-C mid", "A-C slow", "A-C fast"), 2)
    ]
    (row,) = joint([each for each in values if (each.participant, each.pair) != ("p0", places[2])])
    assert row.n == 5
    assert "participants without all of these conditions, left out: 1" in row.note


def joint(values) -> list[Finding]:
    """Return the joint tests of shares."""
    return [row for row in contrast_findings(values) if row.family == "shares together"]


def test_groups_are_compared_by_all_answers_together() -> None:
    """Two groups of four with partly exchanged shares of three answers; reference: all 70 assignments to groups."""
    shares = np.array([[5, 1, 4], [4, 2, 4], [5, 2, 3], [4, 1, 5], [2, 5, 3], [4, 3, 3], [3, 4, 3], [1, 5, 4]]) / 10

    def statistic(first: tuple[int, ...]) -> float:
        inside = np.isin(np.arange(8), first)
        return float(((shares[inside].mean(axis=0) - shares[~inside].mean(axis=0)) ** 2 / shares.mean(axis=0)).sum())

    values = values_of(SHARES, shares[:, np.newaxis, np.newaxis], ("A-C",))
    groups = {f"p{who}": "ab"[who > 3] for who in range(8)}
    *each, both = group_findings(values, values, groups, ("a", "b"))
    reached = [statistic(first) >= statistic((0, 1, 2, 3)) - 1e-9 for first in combinations(range(8), 4)]
    assert (both.p, both.statistic) == (pytest.approx(np.mean(reached)), pytest.approx(statistic((0, 1, 2, 3))))
    assert [row.family for row in (*each, both)] == ["groups"] * 4 and both.p_min == pytest.approx(2 / 70)
    turned = [*group_findings(values[::-1], values[::-1], groups, ("b", "a"))][-1]
    assert turned.p == pytest.approx(both.p)


def test_answers_to_a_further_question_are_tested_together_over_levels(rng) -> None:
    """Three levels, three answers: the same test over levels as of the first question, on the same counts."""
    counts = rng.multinomial(4, [0.5, 0.3, 0.2], size=(6, 3))
    *_, both = level_findings(values_of(RATED, counts[:, np.newaxis] / 4, ("A-C",), (80.0, 100.0, 150.0)), {})
    assert both.p == association_test(counts).p
    assert (both.question, both.family, both.scope) == ("rating", "rating together", "one_hand A-C")
    assert both.name == "all answers to feel together over levels, shuffles within participants"
