"""Designs that are not crossed: each crossed part has the tests it would have alone, and its own denominators."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO
from itertools import product

import numpy as np
import pandas as pd
import pytest

from modaltouch.analysis.findings import holm
from modaltouch.analysis.parts import PartsAnalysis, analyse_parts, render_parts
from modaltouch.analysis.responses import AnswerSource, Responses
from modaltouch.analysis.statistics import uncorrected
from modaltouch.protocol import AnswerList, InputError

pytestmark = pytest.mark.usefixtures("svg_alone")

PEOPLE = [f"p{number:02}" for number in range(1, 11)]
PAPER = AnswerList.of_words(())
CELLS = [("A", "C", 80.0, 1), ("A", "C", 150.0, 1), ("B", "D", 120.0, 2), ("C", "E", 80.0, 1), ("C", "E", 150.0, 1)]


def responses(rows: list[dict[str, object]], answers: AnswerList = PAPER) -> Responses:
    """Return answers of a design that is not crossed; an unknown response is a trial without an answer."""
    usual = {"group": "", "session_kind": "", "stimulus": "", "focus": "C", "finger_condition": "one_hand", "n": 1}
    scheduled = pd.DataFrame([usual | row for row in rows])
    frame = scheduled[scheduled["response"].isin(answers.names)].reset_index(drop=True)
    return Responses(
        frame, (), (), AnswerSource("somewhere", "results", "", "real"), answers=answers, scheduled=scheduled
    )


def rows(people: list[str] = PEOPLE, **more: str) -> list[dict[str, object]]:
    """Return a random answer to every trial of a design with individual levels for each pair."""
    rng = np.random.default_rng(1)
    return [
        {"participant": who, "zone_left": left, "zone_right": right, "velocity_mm_s": level,
         "response": str(rng.choice(PAPER.names, p=[0.2, 0.2, 0.6])), **more}
        for who, (left, right, level, weight) in product(people, CELLS)
        for _ in range(weight)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def analysis() -> PartsAnalysis:
    """Ten participants, three pairs of which two share their levels."""
    return analyse_parts(responses(rows()))


def test_pairs_that_share_levels_and_numbers_are_one_part(analysis: PartsAnalysis) -> None:
    """A-C and C-E at 80 and 150 once each; B-D at 120 twice."""
    assert [part.name for part in analysis.parts] == [
        "one_hand A-C, C-E at 80, 150 mm/s",
        "one_hand B-D at 120 mm/s",
    ]
    assert [part.counts.n_repetitions for part in analysis.parts] == [1, 2]


def test_pairs_with_different_numbers_of_answers_are_compared_by_shares() -> None:
    """C-E twice as often as A-C: all 2^10 signs of the differences of mean shares; pairs of one part have "d"."""
    rng = np.random.default_rng(4)
    met = [("A", "C", 1), ("B", "D", 1), ("C", "E", 2)]
    found = analyse_parts(responses([
        {"participant": who, "zone_left": left, "zone_right": right, "velocity_mm_s": level,
         "response": str(rng.choice(PAPER.names, p=[0.2, 0.3, 0.5]))}
        for who, (left, right, times), level in product(PEOPLE, met, (80.0, 150.0)) for _ in range(times)
    ]))  # fmt: skip
    flips = {row.scope: row for row in found.whole if row.name == "P(both) compared, sign flips"}
    assert list(flips) == ["one_hand A-C - C-E", "one_hand B-D - C-E"]
    frame = found.responses.frame
    both = (frame["response"] == "both").groupby([frame["participant"], frame["zone_left"]]).mean().unstack()
    gaps = (both["A"] - both["C"]).to_numpy()
    sums = np.abs([np.array(signs) @ gaps for signs in product((-1, 1), repeat=10)])
    row = flips["one_hand A-C - C-E"]
    assert row.p == (sums >= abs(gaps.sum()) - 1e-9).mean()
    assert row.estimate == pytest.approx(gaps.mean())
    assert [row.scope for _, row in found.findings if row.family == "d"] == ["one_hand A-C - B-D"]


def test_parts_are_always_in_the_order_of_their_pairs() -> None:
    """One hand has five pairs, two hands one of them: the parts do not depend on the order of hashes."""
    pairs = [("A", "C"), ("A", "D"), ("B", "D"), ("B", "E"), ("C", "E")]
    met = [("one_hand", *pair) for pair in pairs] + [("two_hands", "A", "C")]
    found = analyse_parts(
        responses([
            {"participant": who, "finger_condition": hand, "zone_left": left, "zone_right": right,
             "velocity_mm_s": 80.0, "response": "right"}
            for who, (hand, left, right) in product(PEOPLE, met)
        ])
    )  # fmt: skip
    assert [part.counts.pairs[0].zones for part in found.parts] == pairs


def test_each_part_has_the_tests_it_would_have_alone(analysis: PartsAnalysis) -> None:
    """Estimates and p equal those of a crossed table with these answers only."""
    for part in analysis.parts:
        pairs = {(pair.left, pair.right) for pair in part.counts.pairs}
        alone = [row for row in rows() if (row["zone_left"], row["zone_right"]) in pairs]
        frame = responses(alone).frame
        expected = uncorrected(
            Responses(frame, (), (), AnswerSource("", "csv", ""), focus="C", answers=PAPER).count(), frame
        )
        found = [finding for own, finding in analysis.findings if own is part]
        assert [(one.name, one.scope) for one in found] == [(one.name, one.scope) for one in expected]
        np.testing.assert_array_equal([one.p for one in found], [one.p for one in expected])
        np.testing.assert_array_equal([one.estimate for one in found], [one.estimate for one in expected])


def test_holm_corrects_over_all_parts(analysis: PartsAnalysis) -> None:
    """A family comprises its tests in all parts: Holm (1979)."""
    family = [finding for _, finding in analysis.findings if finding.family == "a2"]
    assert len(family) == 3
    np.testing.assert_allclose([one.p_holm for one in family], holm([one.p for one in family]))


def test_denominators_are_the_presented_trials(analysis: PartsAnalysis) -> None:
    """Ten participants count once, and twice in a cell of weight two; no answer is missing."""
    asked = dict(zip(analysis.counts["pair"], analysis.counts["asked"], strict=True))
    assert asked == {"A-C": 10, "C-E": 10, "B-D": 20}
    assert analysis.as_dict()["missing"] == []


def test_a_missing_answer_keeps_its_participant() -> None:
    """A participant who timed out in both trials of B-D still counts in the denominator."""
    every = rows()
    for row in every:
        if row["participant"] == "p03" and row["zone_left"] == "B":
            row["response"] = "time_out"
    found = analyse_parts(responses(every))
    assert found.parts[1].counts.n_participants == 10
    assert found.as_dict()["missing"] == [{"participant": "p03", "cell": "one_hand B-D 120 mm/s", "n": 2}]
    assert found.as_dict()["n_responses"] == 58


def test_a_part_without_answers_has_no_test_and_no_figure() -> None:
    """All time out in B-D, whose trials are missing; the other part does not change."""
    every = [row | {"response": "time_out"} if row["zone_left"] == "B" else row for row in rows()]
    found = analyse_parts(responses(every))
    assert {part.name for part, _ in found.findings} == {"one_hand A-C, C-E at 80, 150 mm/s"}
    assert found.as_dict()["n_missing"] == 20
    pictures = [name for name in render_parts(found) if name.endswith(".png")]
    assert pictures == ["part_1_one_hand.png"]


def test_a_figure_has_its_part_in_its_title(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a slide, a figure has no page heading."""
    titles: list[str] = []
    monkeypatch.setattr("matplotlib.figure.Figure.suptitle", lambda figure, title, **_: titles.append(title))
    every = [row | {"stimulus": name} for row in rows() for name in ("sharp", "blunt") if row["zone_left"] != "B"]
    render_parts(analyse_parts(responses(every)))
    assert [title.split(":")[0] for title in titles] == ["blunt, one hand", "sharp, one hand"]


def test_the_caption_of_a_figure_names_its_own_finger_condition() -> None:
    """A part of two finger conditions has a figure of each."""
    every = [row | {"finger_condition": name} for row in rows() for name in ("one_hand", "two_hands")]
    page = render_parts(analyse_parts(responses(every)))["report.html"]
    for hands in ("one hand", "two hands"):
        caption = f"<figcaption>Answers: {hands} B-D at 120 mm/s, 10 participants, 2 answers each. Error bars: "
        assert caption in page.replace("\n", "")


def test_pairs_with_other_levels_are_compared_over_those_of_both_and_say_so() -> None:
    """A-C at 80 and 150, B-D at 80 alone: the difference is of the answers at 80 mm/s."""
    own = [row for row in rows() if row["zone_left"] == "A"]
    other = [
        row | {"zone_left": "B", "zone_right": "D", "response": "both"} for row in own if row["velocity_mm_s"] == 80
    ]
    found = analyse_parts(responses([*own, *other]))
    (row,) = (each for each in found.whole if each.family == "shares compared")
    at_80 = [row["response"] == "both" for row in own if row["velocity_mm_s"] == 80]
    assert row.estimate == pytest.approx(np.mean(at_80) - 1)
    assert "over the levels that both have" in row.note


def test_answers_of_three_intervals_are_not_held_against_an_even_split() -> None:
    """Who guesses names a standard twice as often, since two of three intervals hold one: no choice of the standard."""
    places = np.random.default_rng(1).integers(1, 4, (2, 400))
    given = [
        row | {"interval": int(interval), "response": ("first", "second", "third")[named - 1]}
        for row, interval, named in zip([row for row in rows() for _ in range(6)], *places, strict=False)
    ]
    meant = {"first": 1, "second": 2, "third": 3}
    design = {"intervals": {"number": 3, "standard": {"velocity_mm_s": 60}}, "answers": {"intervals": meant}}
    found = analyse_parts(replace(responses(given, AnswerList.of({"keys": [*meant]})), design=design))
    assert not [finding.scope for _, finding in found.findings if finding.question == "a1"]


def test_a_design_of_one_part_is_reported_as_crossed() -> None:
    """One pair twice at one level is crossed, whichever key of the protocol listed its cell."""
    found = analyse_parts(responses([row for row in rows() if row["zone_left"] == "B"]))
    page = render_parts(found)["report.html"]
    assert "Every pair has every level equally often." in page
    assert found.as_dict()["notes"] == []


def test_each_question_of_a_part_has_its_sentence() -> None:
    """As in the report of a crossed design, it has the result, its main number, and text instead of file names."""
    page = render_parts(analyse_parts(responses(rows())))["report.html"]
    assert page.count("Is one zone of each pair chosen more than the other?") == 2
    assert "<strong>Not shown: " in page or "<strong>The data cannot tell whether " in page


def test_parts_of_ratings_have_no_empty_tables() -> None:
    """Ratings are compared over all parts, so that no part has tests of its own."""
    scale = {"scale": {"kind": "vas", "lowest": 0, "highest": 100}}
    given = [row | {"response": "rated", "value": 50.0} for row in rows()]
    found = analyse_parts(replace(responses(given, AnswerList.of(scale)), design={"answers": scale}))
    page = render_parts(found)["report.html"]
    assert "Over all parts" in page and "0 tests" not in page


def test_groups_are_separate_parts() -> None:
    """Participants of one group have no missing answers in cells of the other group."""
    high = [row | {"velocity_mm_s": 200.0} for row in rows(PEOPLE[5:], group="high") if row["zone_left"] == "B"]
    found = analyse_parts(responses([*rows(PEOPLE[:5], group="low"), *high]))
    assert [part.name for part in found.parts] == [
        "high one_hand B-D at 200 mm/s",
        "low one_hand A-C, C-E at 80, 150 mm/s",
        "low one_hand B-D at 120 mm/s",
    ]
    assert {part.counts.n_participants for part in found.parts} == {5}
    assert found.as_dict()["n_missing"] == 0


def test_groups_are_compared_by_one_number_per_participant() -> None:
    """By hand: all of one group answer right, all of the other left: p = 2 / 70, in the table and in the text."""
    both = [
        row | {"response": word}
        for people, group, word in ((PEOPLE[:4], "low", "left"), (PEOPLE[4:8], "high", "right"))
        for row in rows(people, group=group)
        if row["zone_left"] == "A"
    ]
    found = analyse_parts(responses(both))
    tests = found.tests[found.tests["part"] == "all"].set_index("quantity")
    dominant = tests.loc["difference of P(C)"]
    assert (dominant["scope"], dominant["estimate"], dominant["n"]) == ("high - low", 1.0, 8)
    assert dominant["p"] == pytest.approx(2 / 70)
    assert dominant["p_holm"] == pytest.approx(holm([2 / 70, 1.0])[0])
    page = render_parts(found)["report.html"]
    assert "Over all parts" in page and "groups are compared by one number per participant" in page
    assert "The participants are from the groups high, low." in page and "Not every participant met" not in page


def test_stimuli_are_parts_compared_within_participants() -> None:
    """By hand: all answer right to one stimulus and left to the other, so 2 of 2^10 sign flips are as extreme."""
    both = [
        row | {"response": word}
        for stimulus, word in (("slow", "left"), ("usual", "right"))
        for row in rows(stimulus=stimulus)
        if row["zone_left"] == "A"
    ]
    found = analyse_parts(responses(both))
    assert [part.name for part in found.parts] == [f"{name} one_hand A-C at 80, 150 mm/s" for name in ("slow", "usual")]
    dominant = found.tests[found.tests["quantity"] == "difference of P(C)"].set_index("scope")
    row, mean = dominant.loc[dominant["part"] == "all"].to_dict("records")
    assert list(dominant.index[dominant["part"] == "all"]) == ["one_hand A-C slow - A-C usual"] * 2
    assert (row["estimate"], row["p"], row["family"], row["n"]) == (-1.0, 2 / 2**10, "shares compared", 10)
    assert (mean["p"], mean["low"], mean["family"]) == (pytest.approx(2 / 2**10), -1, "shares compared on average")
    files = render_parts(replace(found, responses=replace(found.responses, notes=("Two sessions each",))))
    assert "<p>Two sessions each.</p>" in files["report.html"]
    said = "the share of an answer differs between conditions"
    assert f"{said} for at least one participant. " in files["report.html"]
    assert f"{said} on average. " in files["report.html"]
    answers = pd.read_csv(StringIO(files["answers.csv"]))
    assert answers["stimulus"].value_counts().to_dict() == {"slow": 20, "usual": 20}
    assert "stimulus" in files["models.R"] and "The answers are to the stimuli slow, usual." in files["report.html"]


def test_participants_who_missed_a_session_are_listed() -> None:
    """p10 has no session after training; a kind of session that the other group does not have is not missing."""
    both = [*rows(session_kind="pre"), *rows(PEOPLE[:-1], session_kind="post")]
    found = analyse_parts(responses(both))
    said = f"without trials of the kind of session post, and left out of its results: {PEOPLE[-1]}"
    assert found.responses.notes == (said,) and found.as_dict()["notes"][0] == said
    others = [{**row, "group": "b", "participant": f"q{row['participant']}"} for row in rows(session_kind="pre")]
    assert analyse_parts(responses([{**row, "group": "a"} for row in both] + others)).responses.notes == (said,)


def test_kinds_of_session_are_compared_within_participants() -> None:
    """By hand, as for stimuli: all answer left before and right after, so 2 of 2^10 sign flips are as extreme."""
    before_after = [
        row | {"response": word}
        for kind, word in (("post", "right"), ("pre", "left"))
        for row in rows(session_kind=kind)
        if row["zone_left"] == "A"
    ]
    found = analyse_parts(responses(before_after))
    row, _ = found.tests.query("part == 'all' and quantity == 'difference of P(C)'").to_dict("records")
    assert (row["scope"], row["family"]) == ("one_hand A-C post - A-C pre", "shares compared")
    assert (row["estimate"], row["p"], row["n"]) == (1.0, 2 / 2**10, 10)
    assert "; kinds of session are compared by each participant" in render_parts(found)["report.html"]


def test_participants_of_a_group_with_different_cells_are_refused() -> None:
    """Two versions of a protocol have no common denominators."""
    with pytest.raises(InputError, match=r"met one_hand B D 120.0 unequally often \(p01 2, p04 3\)"):
        analyse_parts(responses([*rows(), next(row for row in rows(["p04"]) if row["zone_left"] == "B")]))
