from __future__ import annotations

import numpy as np
import pytest

from modaltouch.analysis.counts import count_answers, find_focus
from modaltouch.analysis.crossed import figure_names, tabulate, zone_table
from modaltouch.protocol.checks import TAKEN_NAMES


def test_every_cell_is_counted_and_present(paper_frame) -> None:
    """Design: 2 finger conditions, 3 pairs, 4 levels, 10 answers each."""
    counts = tabulate(count_answers(paper_frame))
    assert len(counts) == 24
    assert (counts["n"] == 10).all()
    assert (counts[["left", "both", "right"]].sum(axis=1) == counts["n"]).all()


def test_a_cell_without_one_kind_of_answer_shows_zero(build) -> None:
    """All answers "both": left and right are 0 everywhere, not missing."""
    counts = tabulate(count_answers(build["tidy"](build["constant"]())))
    assert counts[["left", "right"]].to_numpy().sum() == 0
    assert (counts["both"] == 10).all()


def test_no_answer_may_have_the_name_of_a_column(paper_frame) -> None:
    """A table with two columns of one name loses one of them in JSON."""
    counts = tabulate(count_answers(paper_frame))
    assert set(counts) - {"left", "both", "right"} <= TAKEN_NAMES


def test_a_column_of_counts_weighs_the_rows(build) -> None:
    """Column n: every row stands for three answers."""
    frame = build["tidy"](build["paper"]())
    assert (tabulate(count_answers(frame.assign(n=3)))["n"] == 30).all()


def test_rows_stand_in_the_papers_order(paper_frame) -> None:
    """Fig. 10: C, A, C & A; B, D, B & D; C, E, C & E."""
    table = zone_table(count_answers(paper_frame), "one_hand")
    assert [answer for _, answer in table.index] == ["C", "A", "C & A", "B", "D", "B & D", "C", "E", "C & E"]
    assert table.columns.tolist() == [80, 100, 150, 200]


def test_each_pair_adds_up_to_all_participants(paper_frame) -> None:
    """Every participant gives one of three answers."""
    table = zone_table(count_answers(paper_frame), "two_hands")
    assert (table.groupby(level="pair").sum() == 10).to_numpy().all()


def test_other_zones_put_left_first_where_no_focus_is_known(paper_frame) -> None:
    """Without a zone that most pairs share: left, right, both."""
    frame = paper_frame[paper_frame["zone_left"] == "B"].assign(zone_left="P", zone_right="Q")
    table = zone_table(count_answers(frame), "one_hand")
    assert [answer for _, answer in table.index] == ["P", "Q", "P & Q"]


def test_an_unknown_finger_condition_is_refused_with_those_there_are(paper_frame) -> None:
    """House rule: what is allowed."""
    with pytest.raises(ValueError, match="'feet' is not in the counts; there are one_hand, two_hands"):
        zone_table(count_answers(paper_frame), "feet")


def test_an_unknown_word_is_refused(paper_frame) -> None:
    """The Python door keeps the same rule as the CSV's."""
    with pytest.raises(ValueError, match="response 'up' is not an answer: allowed: left, right, both"):
        count_answers(paper_frame.assign(response="up"))


def test_participants_are_sorted_as_people_count(build) -> None:
    """p2 before p10."""
    frame = build["tidy"]([{**r, "participant": f"p{int(r['participant'][1:])}"} for r in build["paper"](12)])
    assert count_answers(frame).participants == tuple(f"p{i}" for i in range(1, 13))


@pytest.mark.parametrize(
    ("zones", "focus"),
    [
        ([("A", "C"), ("B", "D"), ("C", "E")], "C"),
        ([("P", "Q"), ("Q", "R")], "Q"),
        ([("B", "D")], ""),
        ([("A", "C")], "C"),
        ([("P", "Q"), ("R", "S")], ""),
    ],
)
def test_the_focus_is_the_zone_most_pairs_share(zones, focus) -> None:
    """Rule of find_focus; C is the paper's."""
    assert find_focus(zones) == focus


def test_the_most_frequent_answer_is_told_from_a_tie(build) -> None:
    """Two repetitions that differ are a tie, -1; two alike are that answer."""
    rows = build["paper"](1)
    again = [{**row, "response": "both"} for row in rows]
    answers = count_answers(build["tidy"]([*rows, *again]))
    modal = answers.modal()
    assert set(np.unique(modal)) == {-1, 1} or set(np.unique(modal)) == {-1}
    assert (modal[answers.counts.max(axis=-1) == 1] == -1).all()


def test_figure_names_never_collide() -> None:
    """Names that differ only in signs, case or path tricks get files of their own."""
    names = figure_names(["one_hand", "10", "a b", "a-b", "A B", "../../etc"])
    assert len({name.casefold() for name in names.values()}) == 6
    assert all(
        set(name) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_") for name in names.values()
    )


def test_a_turned_beam_keeps_the_zones(build) -> None:
    """Mirrored placement: zone C felt on the left of a turned beam counts as C of (A, C)."""
    frame = build["tidy"](build["paper"]())
    half = frame["participant"] > "p05"
    exchanged = {"left": "right", "right": "left", "both": "both"}
    turned = frame.assign(
        zone_left=frame["zone_left"].where(~half, frame["zone_right"]),
        zone_right=frame["zone_right"].where(~half, frame["zone_left"]),
        response=frame["response"].where(~half, frame["response"].map(exchanged)),
        placement=np.where(half, "mirrored", "normal"),
    )
    from modaltouch.analysis.responses import unmirror
    from modaltouch.protocol import AnswerList

    answers = count_answers(unmirror(turned, AnswerList.of({})))
    assert (answers.counts == count_answers(frame).counts).all()
    assert answers.facing.tolist() == [1] * 5 + [-1] * 5
