from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from modaltouch.analysis.counts import count_answers, find_focus
from modaltouch.analysis.crossed import figure_names, tabulate, zone_table
from modaltouch.protocol import AnswerList
from modaltouch.protocol.checks import TAKEN_NAMES


def test_every_cell_is_counted_and_present(paper_frame) -> None:
    """Design: 2 finger conditions, 3 pairs, 4 levels, 10 answers each."""
    counts = tabulate(count_answers(paper_frame))
    assert len(counts) == 24
    assert (counts["n"] == 10).all()
    assert (counts[["left", "both", "right"]].sum(axis=1) == counts["n"]).all()


def test_a_cell_without_one_kind_of_answer_shows_zero(build) -> None:
    """With all answers "both", left and right are 0 everywhere, not missing."""
    counts = tabulate(count_answers(build["tidy"](build["constant"]())))
    assert counts[["left", "right"]].to_numpy().sum() == 0
    assert (counts["both"] == 10).all()


def test_column_names_are_reserved(paper_frame) -> None:
    """A table with two columns of the same name loses one of them in JSON."""
    counts = tabulate(count_answers(paper_frame))
    assert set(counts) - {"left", "both", "right"} <= TAKEN_NAMES


def test_a_column_of_counts_weighs_the_rows(build) -> None:
    """With column n of 3, every row counts as three answers."""
    frame = build["tidy"](build["paper"]())
    assert (tabulate(count_answers(frame.assign(n=3)))["n"] == 30).all()


def test_rows_are_in_the_papers_order(paper_frame) -> None:
    """Fig. 10: C, A, C & A; B, D, B & D; C, E, C & E."""
    table = zone_table(count_answers(paper_frame), "one_hand")
    assert [answer for _, answer in table.index] == ["C", "A", "C & A", "B", "D", "B & D", "C", "E", "C & E"]
    assert table.columns.tolist() == [80, 100, 150, 200]


def test_each_pair_adds_up_to_all_participants(paper_frame) -> None:
    """Every participant gives one of three answers."""
    table = zone_table(count_answers(paper_frame), "two_hands")
    assert (table.groupby(level="pair").sum() == 10).to_numpy().all()


def test_without_a_focus_the_left_zone_comes_first(paper_frame) -> None:
    """Without a zone common to most pairs, the order is left, right, both."""
    frame = paper_frame[paper_frame["zone_left"] == "B"].assign(zone_left="P", zone_right="Q")
    table = zone_table(count_answers(frame), "one_hand")
    assert [answer for _, answer in table.index] == ["P", "Q", "P & Q"]


def test_an_unknown_finger_condition_is_refused(paper_frame) -> None:
    """The message lists the conditions."""
    with pytest.raises(ValueError, match="'feet' is not in the counts; there are one_hand, two_hands"):
        zone_table(count_answers(paper_frame), "feet")


def test_an_unknown_answer_is_refused(paper_frame) -> None:
    """The Python interface has the same rule as the CSV reader."""
    with pytest.raises(ValueError, match="response 'up' is not an answer: allowed: left, right, both"):
        count_answers(paper_frame.assign(response="up"))


def test_participants_are_sorted_by_number(build) -> None:
    """Participant p2 comes before p10."""
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
        ([("P", "Q"), ("Q", "R"), ("P", "R")], ""),
        ([("P",)], ""),
    ],
)
def test_the_focus_is_the_zone_common_to_most_pairs(zones, focus) -> None:
    """Rule of find_focus; C is the paper's focus."""
    assert find_focus(zones) == focus


def test_a_tie_is_distinguished_from_the_most_frequent_answer(build) -> None:
    """Two different repetitions are a tie, -1; two equal ones are that answer."""
    rows = build["paper"](1)
    again = [{**row, "response": "both"} for row in rows]
    answers = count_answers(build["tidy"]([*rows, *again]))
    modal = answers.modal()
    assert set(np.unique(modal)) == {-1, 1} or set(np.unique(modal)) == {-1}
    assert (modal[answers.counts.max(axis=-1) == 1] == -1).all()


def test_figure_names_are_unique() -> None:
    """Names that differ only in punctuation or case, or contain path separators, get separate files."""
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

    answers = count_answers(unmirror(turned, AnswerList.of({})))
    assert (answers.counts == count_answers(frame).counts).all()
    assert answers.facing.tolist() == [1] * 5 + [-1] * 5


def test_counts_of_a_small_table_are_those_counted_by_hand() -> None:
    """Two participants, a pair and a triple of zones; rows count once where no column says how often."""
    names = ["participant", "finger_condition", "zone_left", "zone_between", "zone_right", "velocity_mm_s", "response"]
    rows = [("p10", "two_hands", "A", "", "C", 80.0, "left"), ("p10", "two_hands", "A", "", "C", 80.0, "both"),
            ("p2", "one_hand", "A", "B", "E", 200.0, "right")]  # fmt: skip
    found = count_answers(pd.DataFrame(rows, columns=names))
    assert found.participants == ("p2", "p10")
    assert found.finger_conditions == ("one_hand", "two_hands")
    assert [pair.zones for pair in found.pairs] == [("A", "C"), ("A", "B", "E")]
    assert [pair.in_words for pair in found.pairs] == ["A and C", "A, B and E"]
    assert found.counts.shape == (2, 2, 2, 2, 3)
    assert found.counts[1, 1, 0, 0].tolist() == [1, 1, 0]
    assert found.counts[0, 0, 1, 1].tolist() == [0, 0, 1]
    assert found.counts.sum() == 3
    assert (found.n_repetitions, found.n_answers) == (2, 4)
    assert not found.compares, "three zones have no dominant one of two"


def test_effects_are_the_answers_whose_share_says_something(paper_frame) -> None:
    """The dominant zone and both; of two answers without fingers the first, whose share gives the other's; else all."""
    compared = count_answers(paper_frame)
    assert [compared.effects(pair) for pair in compared.pairs][0] == (("C", 2), ("both", 1))
    assert not compared.is_nominal
    for words, places in ((("yes", "no"), [0]), (("low", "middle", "high"), [0, 1, 2])):
        offered = AnswerList.of({"keys": {word: [word[0]] for word in words}})
        named = paper_frame.assign(response=pd.Categorical([words[0]] * len(paper_frame), words))
        found = count_answers(named, offered=offered)
        assert [place for _, place in found.effects(found.pairs[0])] == places
        assert found.is_nominal is (len(words) > 2)
        with pytest.raises(ValueError, match="no answer names both fingers: the answers are " + ", ".join(words)):
            found.compared()
        with pytest.raises(ValueError, match="no answer names the left finger alone"):
            found.sided()
