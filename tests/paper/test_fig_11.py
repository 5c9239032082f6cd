"""Fig. 11 (test 2, both hands): the text gives its form and claim, but no number."""

from __future__ import annotations

import pandas as pd
import pytest

from modaltouch.analysis.counts import AnswerCounts, count_answers
from modaltouch.analysis.crossed import figure_names, zone_table
from modaltouch.analysis.figures import draw_counts
from modaltouch.analysis.intervals import BoundedMean
from modaltouch.report.page import PAIR_COLOURS


@pytest.fixture
def empty_counts() -> AnswerCounts:
    """Counts of the paper's design, ten answers per cell; the text gives no bar heights, so all are "both" here."""
    pairs, levels = (("A", "C"), ("B", "D"), ("C", "E")), (80.0, 100.0, 150.0, 200.0)
    rows = [(f"p{i}", "two_hands", a, b, level, "both") for i in range(10) for a, b in pairs for level in levels]
    names = ["participant", "finger_condition", "zone_left", "zone_right", "velocity_mm_s", "response"]
    return count_answers(pd.DataFrame(rows, columns=names))


def test_fig_11_has_the_form_of_fig_10(empty_counts) -> None:
    """Caption: dark blue (A, C), light blue (B, D), yellow (C, E), three answers each, four velocities."""
    table = zone_table(empty_counts, "two_hands")
    assert list(table.index) == [
        ("A-C", "C"), ("A-C", "A"), ("A-C", "C & A"), ("B-D", "B"), ("B-D", "D"), ("B-D", "B & D"),
        ("C-E", "C"), ("C-E", "E"), ("C-E", "C & E"),
    ]  # fmt: skip
    assert table.columns.tolist() == [80, 100, 150, 200]
    assert len(draw_counts(table, "two_hands").axes[0].patches) == 36
    assert PAIR_COLOURS[:3] == ("#0b3c8c", "#5bb8e8", "#f4c518")


def test_fig_11_is_of_both_hands() -> None:
    """Section V-B: test 2 uses the index fingers of both hands."""
    assert figure_names(["one_hand", "two_hands"])["two_hands"] == "fig_11"


@pytest.mark.parametrize(("n", "margin"), [(10, 0.2589), (29, 0.0981)])
def test_the_equivalence_ten_people_can_show_is_coarse(n, margin) -> None:
    """With no difference in any of N people, equivalence ("the results are repeated") holds within 1 - 0.05^(1/N)."""
    nobody = BoundedMean([0.0] * n)
    assert nobody.interval(0.9).high == pytest.approx(margin, abs=5e-4)
    assert nobody.equivalence(margin + 1e-3).p < 0.05 < nobody.equivalence(margin - 1e-3).p
