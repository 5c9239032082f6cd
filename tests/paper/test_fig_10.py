"""Fig. 10 (test 1, one hand), as far as the text of section V gives its numbers."""

from __future__ import annotations

from collections.abc import Callable

import pandas as pd
import pytest

from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.crossed import zone_table
from modaltouch.analysis.exact import multinomial_test, sign_flip_test
from modaltouch.analysis.findings import to_frame
from modaltouch.analysis.intervals import BoundedMean, clopper_pearson, wilson
from modaltouch.analysis.statistics import find


def run_tests(frame):
    """Return the statistics of tidy answers as one table."""
    return to_frame(find(count_answers(frame), frame))


@pytest.fixture
def section_v() -> Callable[[str], pd.DataFrame]:
    """Answers to (A, C) and (C, E) as described in section V-C, which does not identify the deviating participants.

    "Only one participant" at 80 and at 100 mm/s is assumed to be the same one.
    """

    def build(finger_condition: str) -> pd.DataFrame:
        rows = []
        for i in range(1, 11):
            for level in (80.0, 100.0, 150.0, 200.0):
                ac = "both" if (i, level) == (1, 150.0) else "right"
                ce = "both" if i == 2 and level <= 100 else "left"
                rows += [
                    (f"p{i}", finger_condition, "A", "C", level, ac),
                    (f"p{i}", finger_condition, "C", "E", level, ce),
                ]
        names = ["participant", "finger_condition", "zone_left", "zone_right", "velocity_mm_s", "response"]
        return pd.DataFrame(rows, columns=names)

    return build


def test_the_text_gives_39_and_38_of_40_answers_for_c(section_v) -> None:
    """Section V-C: all C but one at 150 mm/s in (A, C); all C but one each at 80 and 100 mm/s in (C, E)."""
    table = zone_table(count_answers(section_v("one_hand")), "one_hand")
    assert table.loc[("A-C", "C")].tolist() == [10, 10, 9, 10]
    assert table.loc[("A-C", "C & A")].tolist() == [0, 0, 1, 0]
    assert table.loc[("C-E", "C")].tolist() == [9, 9, 10, 10]
    assert table.loc["A-C"].to_numpy().sum() == table.loc["C-E"].to_numpy().sum() == 40


@pytest.mark.parametrize(
    ("k", "exact", "score"), [(39, (0.8684, 0.9994), (0.8712, 0.9956)), (38, (0.8308, 0.9939), (0.8350, 0.9862))]
)
def test_39_and_38_of_40_have_these_intervals(k, exact, score) -> None:
    """Clopper-Pearson and Wilson intervals as R's binom.confint prints them, as if the 40 answers were independent."""
    one, other = clopper_pearson(k, 40), wilson(k, 40)
    assert (one.low, one.high) == pytest.approx(exact, abs=5e-4)
    assert (other.low, other.high) == pytest.approx(score, abs=5e-4)


def test_two_odd_answers_widen_the_interval_more_if_of_one_person() -> None:
    """Of forty answers, two odd ones of one person among ten leave more uncertainty than one each of two people."""
    same, apart = (BoundedMean(shares, 0.0, 1.0).interval() for shares in ([1] * 9 + [0.5], [1] * 8 + [0.75] * 2))
    assert same.estimate == apart.estimate == 0.95
    assert same.low < apart.low < 0.95 < apart.high < same.high + 1e-3


def test_the_dominance_of_c_is_as_strong_as_ten_people_can_show(section_v) -> None:
    """Sign-flip test: all ten lean to C in both pairs, p = 2/2^10 each."""
    tests = run_tests(section_v("one_hand"))
    dominance = tests[(tests["question"] == "a2") & (tests["family"] == "a2")]
    assert dominance["p"].tolist() == [2 / 1024, 2 / 1024]
    assert sign_flip_test([4] * 9 + [3]).p == 2 / 1024


@pytest.mark.parametrize(("cell", "p"), [([0, 0, 10], 3.0**-9), ([0, 1, 9], 63 * 3.0**-10)])
def test_single_cells_differ_from_guessing(cell, p) -> None:
    """Closed forms: 3 outcomes like 10/0/0; for 9/1/0 those and 6 x 10 more orders of 3^10."""
    assert multinomial_test(cell).p == pytest.approx(p, rel=1e-12)


def test_one_odd_answer_gives_no_information_on_the_level(section_v) -> None:
    """(A, C): one participant answered "both" once, at 150 mm/s; the smallest p that any position could give is 1/4."""
    tests = run_tests(section_v("one_hand"))
    level = tests[(tests["question"] == "b") & (tests["family"] == "b")].set_index("scope")
    assert level.loc["one_hand A-C", "p_min"] == 0.25
    assert "no information" in level.loc["one_hand A-C", "note"]


def test_pairs_without_numbers_in_the_text_are_left_out(section_v) -> None:
    """The text describes (B, D) only qualitatively ("some B", "only one D")."""
    answers = count_answers(section_v("one_hand"))
    assert [pair.label for pair in answers.pairs] == ["A-C", "C-E"]
