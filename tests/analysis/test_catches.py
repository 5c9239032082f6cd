"""Catch trials and the answer none: excluded from the cells, counted, and used in the statistics."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path
from statistics import NormalDist

import numpy as np
import pytest

from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.crossed import tabulate, zone_table
from modaltouch.analysis.designs import analyse_design
from modaltouch.analysis.detection import catch_findings, catch_rows
from modaltouch.analysis.exact import multinomial_test
from modaltouch.analysis.pipeline import analyse, read_responses
from modaltouch.analysis.statistics import family_findings
from modaltouch.protocol.source import InputError

HEADER = "participant,finger_condition,zone_left,zone_right,velocity_mm_s,response,catch"


def write(path: Path, answers: dict[str, str], caught: dict[str, str]) -> Path:
    """Write each participant's answers to A-C at 80, 100, ... mm/s and to catch trials, by first letter."""
    words = {"l": "left", "b": "both", "r": "right", "n": "none"}
    lines = [HEADER]
    for name, letters in answers.items():
        lines += [f"{name},one_hand,A,C,{80 + 20 * i},{words[x]},0" for i, x in enumerate(letters)]
        lines += [f"{name},one_hand,A,C,0,{words[x]},1" for x in caught.get(name, "")]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """Four participants at three levels, with three catch trials each: 2 false alarms of 12, 3 misses of 12."""
    answers = {"p1": "rrr", "p2": "nrr", "p3": "nnb", "p4": "lrr"}
    return write(tmp_path / "answers.csv", answers, {"p1": "nnn", "p2": "nlb", "p3": "nnn", "p4": "nnn"})


def test_catch_trials_are_in_no_cell(table: Path) -> None:
    """The cells have the three levels with four answers each; catch trials are counted by participant."""
    responses = read_responses(table)
    answers = count_answers(responses.frame)
    assert answers.levels == (80.0, 100.0, 120.0)
    assert answers.counts.sum() == 12
    assert responses.caught("p2") == Counter(none=1, left=1, both=1)
    assert [item.reason for item in responses.left_out] == ["catch trials, counted apart"]


def test_none_has_its_own_column_and_row(table: Path) -> None:
    """Counted by hand: none twice at 80 mm/s, once at 100 mm/s, never at 120 mm/s."""
    answers = count_answers(read_responses(table).frame, "C")
    counts = tabulate(answers)
    assert counts["none"].tolist() == [2, 1, 0]
    zones = zone_table(answers, "one_hand")
    assert zones.loc[("A-C", "none")].tolist() == [2, 1, 0]
    assert zones.sum().tolist() == [4, 4, 4]


def test_a_table_without_none_keeps_its_three_answers(tmp_path: Path) -> None:
    """There is no column or row of none, and no result of catch trials."""
    path = write(tmp_path / "answers.csv", {"p1": "rrb", "p2": "lrr"}, {})
    answers = count_answers(read_responses(path).frame)
    assert answers.counts.shape[-1] == 3
    assert "none" not in tabulate(count_answers(read_responses(path).frame)).columns
    assert catch_rows(read_responses(path)) == ()
    assert list(catch_findings(read_responses(path))) == []


def test_false_alarms_misses_and_d_prime_agree_with_a_hand_count(table: Path) -> None:
    """2 of 12 and 3 of 12; for each participant d' = z((k + .5) / 4) minus the same of the false alarms."""
    responses = read_responses(table)
    *rows, total = catch_rows(responses)
    assert [(row.participant, row.false_alarms, row.n_missed) for row in rows] == [
        ("p1", "0 of 3", 0),
        ("p2", "2 of 3", 1),
        ("p3", "0 of 3", 2),
        ("p4", "0 of 3", 0),
    ]
    assert (total.n_false_alarms, total.n_catch, total.n_missed, total.n_driven) == (2, 12, 3, 12)
    alarms, misses = catch_findings(responses)
    assert alarms.estimate == pytest.approx(2 / 12)
    assert misses.estimate == pytest.approx(3 / 12)
    assert alarms.low < 2 / 12 < alarms.high
    z, own = NormalDist().inv_cdf, analyse_design(responses).values
    d_prime = {each.participant: each.interval.estimate for each in own if each.measure.name == "d'"}
    assert d_prime["p1"] == pytest.approx(z(3.5 / 4) - z(0.5 / 4))
    assert d_prime["p2"] == pytest.approx(z(2.5 / 4) - z(2.5 / 4))


def test_the_test_against_chance_leaves_out_the_answer_none(table: Path) -> None:
    """At 80 mm/s with one right, one left, two none, the test has two answers, but the share of C is one of four."""
    answers = count_answers(read_responses(table).frame, "C")
    first = next(iter(family_findings("a1", answers)))
    assert first.p == pytest.approx(multinomial_test([1, 0, 1]).p)
    assert first.estimate == pytest.approx(1 / 4)
    assert "none 2, left out of the test" in first.note


def test_dominance_counts_the_answer_none_for_neither_zone(table: Path) -> None:
    """Counted by hand: 7 right minus 1 left of all twelve answers."""
    answers = count_answers(read_responses(table).frame, "C")
    first = next(iter(family_findings("a2", answers)))
    assert first.estimate == pytest.approx((7 - 1) / 12)
    assert "7 C, 1 A, 1 both and 3 none of 12 answers" in first.note


def test_without_the_answer_none_catch_trials_give_no_false_alarms(tmp_path: Path) -> None:
    """No answer would have been correct, so only the answers are reported."""
    path = write(tmp_path / "answers.csv", {"p1": "rrb", "p2": "lrr"}, {"p1": "lb", "p2": "br"})
    responses = read_responses(path)
    assert catch_rows(responses)[-1].answers == {"left": 1, "right": 1, "both": 2, "none": 0}
    assert list(catch_findings(responses)) == []


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (",80,right,0", ",0,right,0", "velocity_mm_s: given '0'; allowed: a peak velocity in mm/s, 0.001 to 1"),
        (",80,right,0", ",80,right,maybe", "catch: given 'maybe'; allowed: 0 or 1"),
        (",80,right,0", ",80,nowhere,0", "response: given 'nowhere'; allowed: left, right, both, none"),
    ],
)
def test_faults_of_catch_trials_have_their_place(table: Path, old: str, new: str, fault: str) -> None:
    """A velocity of zero outside a catch trial, an invalid flag, an unknown answer."""
    table.write_text(table.read_text().replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_responses(table)
    assert fault in str(caught.value)


def test_the_report_and_the_json_give_the_results(table: Path, tmp_path: Path) -> None:
    """One table has a row for each participant, and the text states where else catch trials count."""
    analysis = analyse(table, tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Catch trials and the answer “none”" in page
    assert "<td>2 of 12</td><td>3 of 12</td>" in page
    assert page.count("Beside d&#39;, criteria and detection thresholds, catch trials are in no other table") == 2
    assert analysis.as_dict()["catch_trials"][-1]["n_missed"] == 3
    with (tmp_path / "out" / "counts.csv").open() as file:
        assert sum(int(row["none"]) for row in csv.DictReader(file)) == 3
    rows = [row for row in analysis.as_dict()["tests"] if row["question"] == "catch"]
    assert np.isclose(rows[0]["estimate"], 2 / 12)


def test_a_design_without_catch_trials_does_not_mention_them(tmp_path: Path) -> None:
    """With the answer none alone there are misses, but no text, column or false alarm of catch trials."""
    table = write(tmp_path / "answers.csv", {"p1": "nrr", "p2": "rrr"}, {})
    page = analyse(table, tmp_path / "out").files["report.html"].read_text()
    assert "<h2>The answer “none”</h2>" in page and "<td>1 of 3</td>" in page
    assert "In a catch trial" not in page and "false alarms</th>" not in page
