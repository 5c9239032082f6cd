from __future__ import annotations

import math
import re

import numpy as np
import pandas as pd
import pytest

from modaltouch.analysis.contrasts import Contrast, MeanScores, Shares, mean_of_known, signs_of
from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.exact import sign_flip_test
from modaltouch.analysis.findings import holm, to_frame
from modaltouch.analysis.intervals import BoundedMean
from modaltouch.analysis.statistics import STATISTICS, chance_tests, find, level_tests, slopes
from modaltouch.protocol import AnswerList


def run_tests(frame):
    """Return the statistics of tidy answers as one table."""
    return to_frame(find(count_answers(frame), frame))


def rows(tests, question: str, name: str = "", scope: str = ""):
    """Return the rows of a question whose name and scope hold the given words."""
    found = tests[tests["question"] == question]
    return found[found["name"].str.contains(name, regex=False) & found["scope"].str.contains(scope, regex=False)]


@pytest.fixture(scope="module")
def tests():
    """Statistics of the synthetic set shaped on the paper's text."""
    from importlib import util
    from pathlib import Path

    spec = util.spec_from_file_location("synthetic", Path(__file__).with_name("conftest.py"))
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return run_tests(module.tidy(module.answers_like_the_paper()))


class TestPaperLikeAnswers:
    def test_families_have_the_planned_sizes(self, tests) -> None:
        """24 cells; 6 tests of dominance, level and pair; 6 of hands, dominant zone and both, in one family."""
        sizes = tests[tests["family"] != ""].groupby("family").size()
        expected = dict.fromkeys(("a2", "a2 mean", "b", "b mean", "c", "c mean", "d", "d mean"), 6)
        assert sizes.to_dict() == {"a1": 24, **expected}

    def test_holm_is_applied_within_families(self, tests) -> None:
        """Recomputed from the p column."""
        for _, family in tests[tests["family"] != ""].groupby("family"):
            assert family["p_holm"].tolist() == pytest.approx(holm(family["p"]).tolist())

    def test_unanimous_dominance_reaches_the_floor(self, tests) -> None:
        """Ten of ten lean to C: p = 2/2^10, Holm over six 0.0117."""
        row = rows(tests, "a2", "sign-flip", "one_hand A-C").iloc[0]
        assert (row["p"], row["p_min"]) == (2 / 1024, 2 / 1024)
        assert row["p_holm"] == pytest.approx(6 * 2 / 1024)
        assert row["estimate"] == pytest.approx(39 / 40)

    def test_those_who_lean_are_counted_by_whom_they_lean_to(self, tests) -> None:
        """Ten of ten lean to C, by the exact sign test; two of two to B."""
        for scope, n in (("one_hand A-C", 10), ("two_hands B-D", 2)):
            row = rows(tests, "a2", "sign test of leaning participants", scope).iloc[0]
            assert (row["estimate"], row["n"], row["p"]) == (1, n, 2 / 2**n)

    def test_few_who_lean_are_called_no_information(self, tests) -> None:
        """(B, D), two hands: two participants lean, so p cannot fall below 0.5."""
        row = rows(tests, "a2", "sign-flip", "two_hands B-D").iloc[0]
        assert row["p_min"] == 0.5
        assert "no information" in row["note"]

    def test_every_p_stands_at_or_above_its_smallest(self, tests) -> None:
        """Definition of p_min."""
        tested = tests.dropna(subset=["p"])
        assert (tested["p"] >= tested["p_min"] - 1e-12).all()
        assert tested["p"].between(0, 1).all()
        assert (tested["p"] > 0).all()

    def test_every_interval_holds_its_estimate(self, tests) -> None:
        """Low, estimate, high in order wherever all three are."""
        bounded = tests.dropna(subset=["estimate", "low", "high"])
        assert (bounded["low"] <= bounded["estimate"] + 1e-12).all()
        assert (bounded["estimate"] <= bounded["high"] + 1e-12).all()

    def test_an_unchanged_answer_keeps_an_interval(self, tests) -> None:
        """(C, E) with two hands, 40 of 40: ten participants, Clopper-Pearson from 0.6915."""
        row = rows(tests, "f", "share of answers", "two_hands C-E").iloc[0]
        assert (row["estimate"], row["high"]) == (1, 1)
        assert row["low"] == pytest.approx(0.025**0.1)

    def test_the_cells_agree_with_the_counts(self, tests) -> None:
        """One hand, (A, C), 150 mm/s: 9 of 10 chose C."""
        row = rows(tests, "a1", "multinomial", "one_hand A-C 150 mm/s").iloc[0]
        assert row["estimate"] == 0.9 and math.isnan(row["low"])
        assert "left 0, both 1, right 9" in row["note"]
        assert "most frequent answer" not in row["note"], "each participant answered once"
        share = rows(tests, "a1", "share in a cell", "one_hand A-C 150 mm/s").iloc[0]
        assert (share["estimate"], share["role"]) == (0.9, "estimate")
        assert (share["low"], share["high"]) == pytest.approx((0.555, 0.9975), abs=5e-5)  # R: binom.test(9, 10)

    def test_single_cells_without_discordance_have_the_width_of_who_may_be_missing(self, tests) -> None:
        """Closed form: 1 - 0.025^(1/10) = 0.3085."""
        row = rows(tests, "f", "paired difference", "A-C 100 mm/s").iloc[0]
        assert (row["low"], row["high"]) == pytest.approx((-0.3085, 0.3085), abs=5e-5)

    def test_a_paired_cell_counts_whoever_answered_in_both(self, tests) -> None:
        """(C, E), 80 mm/s: all ten answered; the seventh chose C with two hands only."""
        row = rows(tests, "f", "paired difference", "C-E 80 mm/s").iloc[0]
        assert (row["estimate"], row["n"]) == (pytest.approx(-0.1), 10)
        assert row["note"] == "0 chose C only in the first, 1 only in the second"

    def test_no_interval_disagrees_with_the_p_beside_it(self, tests) -> None:
        """P above 0.05 and the interval holding zero are one, wherever both are printed for a mean."""
        both = tests[tests["name"].str.contains("bounded mean") & tests["p"].notna() & tests["low"].notna()]
        assert set(both["family"]) >= {"a2 mean", "b mean", "c mean", "d mean"}
        assert ((both["low"] <= 0) & (both["high"] >= 0)).equals(both["p"] > 0.05)


@pytest.mark.parametrize("response", ["left", "both", "right"])
@pytest.mark.parametrize("n", [1, 2, 10])
def test_nothing_breaks_when_every_answer_is_the_same(build, response, n) -> None:
    """Question by question p stays a probability; no warning (an error here), no false certainty."""
    tests = run_tests(build["tidy"](build["constant"](n, response)))
    tested = tests.dropna(subset=["p"])
    assert tested["p"].between(0, 1, inclusive="right").all()
    assert rows(tests, "b")["p"].eq(1).all()
    assert rows(tests, "c")["p"].eq(1).all()
    intervals = rows(tests, "f", "share of answers")
    assert (intervals["high"] - intervals["low"]).min() > 0.2


@pytest.mark.parametrize("keep", ["participant", "velocity_mm_s", "finger_condition", "zone_left"])
def test_a_design_of_one_of_anything_can_be_analysed(build, keep) -> None:
    """One participant, level, finger condition or pair: every question that is left is answered."""
    frame = build["tidy"](build["paper"]())
    tests = run_tests(frame[frame[keep] == frame[keep].iloc[0]])
    assert {"a1", "a2", "e", "f"} <= set(tests["question"])
    assert ("b" in set(tests["question"])) is (keep != "velocity_mm_s")  # a trend takes two levels


def test_two_levels_are_enough_for_a_change_with_the_level(build) -> None:
    """Each participant who changes the answer from one level to the other counts as half of two shuffles."""
    frame = build["tidy"](build["paper"]())
    frame = frame[frame["velocity_mm_s"].isin([80, 200])]
    frame = frame.assign(response=np.where(frame["velocity_mm_s"] == 200, "right", "left"))
    found = rows(run_tests(frame), "b", "trend test")
    assert found["p"].tolist() == pytest.approx([2 / 2**10] * 6)


def test_the_steepest_slope_is_that_of_who_always_changes_the_answer(build) -> None:
    """Never the dominant zone below the mean level and always above it: the mean of a bounded score is at its bound."""
    frame = build["tidy"](build["paper"]())
    answers = count_answers(frame.assign(response=np.where(frame["velocity_mm_s"] > 132.5, "right", "left")))
    found = slopes(answers)
    at_c = [place for place, scope in enumerate(found.scopes) if "A-C" in scope]
    assert found.scores[at_c] == pytest.approx(found.scale)
    assert found.lowest == pytest.approx(found.scores)
    assert found.highest == pytest.approx(found.scores)


def test_two_answers_are_tested_against_guessing(build) -> None:
    """Ten of ten gave one of two: 2/2^10; where a third was that nothing was felt, those who felt something count."""
    frame = build["tidy"](build["constant"](10, "right"))
    for keys in (["left", "right"], ["left", "right", "none"]):
        answers = count_answers(frame, offered=AnswerList.of({"keys": keys}))
        assert chance_tests(answers).test.p == pytest.approx(np.full(24, 2 / 2**10))


def test_a_side_that_could_not_be_named_is_refused(build) -> None:
    """With the answers that there were; whether nothing felt was one of them is known."""
    frame = build["tidy"](build["constant"](3, "right"))
    offered = [AnswerList.of({"keys": keys}) for keys in (["left", "both", "right"], ["right", "none"])]
    whole, one = (count_answers(frame, offered=each) for each in offered)
    assert whole.sided().sum(axis=(0, 1, 2, 3)).tolist() == [0, len(frame)]
    with pytest.raises(ValueError, match="no answer names the left finger alone: the answers are right, none"):
        one.sided()
    assert (whole.has_none_answer, one.has_none_answer) == (False, True)


def test_the_design_of_the_paper_is_known_by_its_pairs_and_levels(build) -> None:
    """Three pairs at 80, 100, 150 and 200 mm/s; with a level or a pair less it is another."""
    frame = build["tidy"](build["paper"]())
    parts = frame, frame[frame["velocity_mm_s"] < 200], frame[frame["zone_left"] != "B"]
    assert [count_answers(part).is_paper_design for part in parts] == [True, False, False]


def test_a_mean_is_of_the_values_that_there_are() -> None:
    """One of two is missing, one of none."""
    assert mean_of_known(np.array([[0.5, np.nan], [0.2, 0.4]])) == pytest.approx([0.5, 0.3])
    assert np.isnan(mean_of_known(np.array([[np.nan, np.nan]]))).all()


def test_the_smallest_p_against_guessing_is_that_of_one_answer_alone() -> None:
    """Ten who all give one of three answers: 3 / 3^10."""
    assert STATISTICS["a1"].smallest_p([150.0], 10, 1, None) == pytest.approx(3.0**-9)


def test_repetitions_enter_as_one_participant(build) -> None:
    """Twenty-four answers of two people are not forty-eight people: the floor of the sign flips stays 2/2^2."""
    tests = run_tests(build["tidy"](build["random"](2, 3, repetitions=2)))
    assert rows(tests, "a2", "sign-flip")["p_min"].min() >= 0.5
    assert (rows(tests, "a1")["n"] <= 2).all()
    shares = rows(tests, "a1", "share in a cell")
    said = "of each participant's most frequent answer; tied or without an answer, and left out: "
    assert (shares["note"] == said + (2 - shares["n"]).astype(str)).all()


def test_the_estimate_beside_a_test_against_guessing_is_of_the_answer_that_moves_it(build) -> None:
    """Everybody says "both": P(both) = 1 stands beside that p, not P(C) = 0."""
    found = rows(run_tests(build["tidy"](build["constant"](10, "both"))), "a1", "multinomial")
    assert set(zip(found["quantity"], found["estimate"], strict=True)) == {
        ("P(C & A)", 1.0), ("P(B & D)", 1.0), ("P(C & E)", 1.0),
    }  # fmt: skip


def test_who_gave_no_answer_is_not_said_to_be_tied(build) -> None:
    """Of three people, one was never in time in the first cell."""
    frame = build["tidy"](build["random"](3, 3, repetitions=2)).assign(response="right")
    keys = ["participant", "finger_condition", "zone_left", "velocity_mm_s"]
    is_first = (frame[keys] == frame[keys].iloc[0]).all(axis=1)
    said = rows(run_tests(frame[~is_first]), "a1")["note"].str.extract(r"most frequent.*, (\d .*) and left out")[0]
    assert (said == "1 tied or without an answer").sum() == 1


def test_order_times_and_speeds_are_used_where_they_are_there(build) -> None:
    """Columns trial, response_time, speed_left_mm_s and speed_right_mm_s bring their questions."""
    frame = build["tidy"](build["random"](8, 5)).drop(columns="repetition")
    rng = np.random.default_rng(0)
    frame = frame.assign(
        trial=frame.groupby("participant").cumcount() + 1.0,
        response_time=rng.gamma(5, 0.2, len(frame)),
        speed_left_mm_s=frame["zone_left"].map({"A": 50.0, "B": 60.0, "C": 100.0}),
        speed_right_mm_s=frame["zone_right"].map({"C": 100.0, "D": 60.0, "E": 50.0}),
    )
    tests = run_tests(frame)
    assert {"order", "time", "speed", "side"} <= set(tests["question"])
    assert (rows(tests, "speed")["role"] == "exploratory").all()


def test_guesses_are_seldom_called_dominance(build) -> None:
    """Type I error: 40 synthetic experiments of guesses, at least one Holm p <= 0.05 in a2 at most in 6 (3 sd)."""
    rejected = 0
    for seed in range(40):
        frame = build["tidy"](build["random"](10, seed)).drop(columns="repetition")
        from modaltouch.analysis.counts import count_answers
        from modaltouch.analysis.findings import correct
        from modaltouch.analysis.statistics import family_findings

        found = correct(family_findings("a2", count_answers(frame)))
        rejected += any(row.p_holm <= 0.05 for row in found if not math.isnan(row.p_holm))
    assert rejected <= 6


class TestMissingAnswers:
    @pytest.fixture
    def gaps(self, paper_frame):
        """The synthetic set without two answers of p01 to (C, E), one hand, and one of p02 to (B, D)."""
        own = (paper_frame["participant"] == "p01") & (paper_frame["finger_condition"] == "one_hand")
        first = paper_frame.index[own & (paper_frame["zone_left"] == "C")][:2]
        other = paper_frame.index[(paper_frame["participant"] == "p02") & (paper_frame["zone_left"] == "B")][:1]
        return paper_frame.drop(index=[*first, *other])

    def test_they_are_counted_and_bounded_where_they_matter(self, gaps, paper_frame) -> None:
        """The bounds hold the estimate of the whole table, as they hold whatever was answered."""
        tests, whole = run_tests(gaps), run_tests(paper_frame)
        row = rows(tests, "a2", "net dominance, mean", "one_hand C-E").iloc[0]
        known = rows(whole, "a2", "net dominance, mean", "one_hand C-E").iloc[0]["estimate"]
        told = re.search(r"2 of 40 answers missing; with them the estimate could be (\S+) to (\S+),", row["note"])
        assert float(told[1]) <= known <= float(told[2])
        assert "missing" not in rows(tests, "a2", "net dominance, mean", "two_hands A-C").iloc[0]["note"]

    def test_the_worst_is_what_the_answers_would_have_done(self, gaps) -> None:
        """By hand: 36 or fewer of 40 to C, two unknown; all C, or both to E, on p01's four answers."""
        row = rows(run_tests(gaps), "f", "share of answers", "one_hand C-E")
        note = row[row["quantity"] == "P(C)"]["note"].iloc[0]
        given = int(
            ((gaps["zone_left"] == "C") & (gaps["response"] == "left") & (gaps["finger_condition"] == "one_hand")).sum()
        )
        assert f"the share could be {given / 40:.3g} to {(given + 2) / 40:.3g}" in note

    def test_shares_are_bounded_by_what_was_asked_for(self) -> None:
        """By hand: one of three answers of four, so a quarter to a half."""
        shares = Shares(np.array([[1]]), np.array([[3]]), 4)
        assert (shares.least.item(), shares.most.item()) == (1 / 4, 2 / 4)

    def test_flips_and_bounds_count_what_was_answered(self) -> None:
        """By hand: of four asked, one of three against none of four, and one of three against four of four."""
        first = Shares(np.array([[[1], [1]]]), np.array([[[3], [3]]]), 4)
        second = Shares(np.array([[[0], [4]]]), np.array([[[4], [4]]]), 4)
        contrast = Contrast(["one"], ["difference"], first, second)
        found = signs_of(contrast)
        assert found is not None
        assert found.test.statistic.tolist() == [(1 - 0) + (1 - 3)]
        assert found.notes(0)[0].startswith("2 answers left out of the test")
        assert contrast.scores.highest.tolist() == [[2 / 4, -2 / 4]]
        assert contrast.scores.lowest.tolist() == [[1 / 4, -3 / 4]]

    @pytest.mark.parametrize(("least", "p"), [(0.4, None), (0.0, 1.0), (-0.2, 1.0)])
    def test_p_is_at_most_that_of_the_worst_answers(self, least: float, p: float | None) -> None:
        """1 where they could make the mean nothing, else that of the mean that is nearer to it."""
        shares = Shares(np.full((1, 6, 1), 3), np.full((1, 6, 1), 3), 4)
        lowest, highest = np.full((1, 6), least), np.full((1, 6), 0.9)
        compared = MeanScores(["one"], ["mean"], np.full((1, 6), 0.8), 1.0, shares, lowest, highest)
        (note,) = compared.say(0)
        expected = float(BoundedMean(lowest[0], -1.0, 1.0).test().p) if p is None else p
        assert note.startswith(f"6 of 24 answers missing; with them the estimate could be {least:.3g} to 0.9, ")
        assert note.endswith(f"and p at most {expected:.2g}")

    def test_every_question_is_still_answered(self, gaps, paper_frame) -> None:
        """The same rows as without a gap, every p a probability."""
        tests, whole = run_tests(gaps), run_tests(paper_frame)
        assert tests[["question", "name", "scope"]].equals(whole[["question", "name", "scope"]])
        assert tests["p"].dropna().between(0, 1, inclusive="right").all()


def test_the_normal_law_is_named_where_it_is_used(paper_frame) -> None:
    """By the answers given, as the test goes: 4 a participant of 800 asked for are shuffled exactly, 404 are not."""
    few, many = count_answers(paper_frame, asked=200), count_answers(pd.concat([paper_frame] * 101))
    assert not any("normal approximation" in note for note in level_tests(few).notes(0))
    assert any("normal approximation" in note for note in level_tests(many).notes(0))


def test_equivalence_is_said_where_it_is_shown_and_where_it_is_not(paper_frame) -> None:
    """Ten participants: within 0.5 it is shown for (A, C), where two differ by a quarter; within 0.1 for nothing."""
    for margin, shown in ((0.5, True), (0.1, False)):
        tests = to_frame(find(count_answers(paper_frame, margin=margin), paper_frame))
        alike = tests[tests["family"] == "c alike"]
        assert len(alike) == 6
        row = alike[alike["scope"].str.contains("A-C")].iloc[0]
        assert row["note"].startswith("shown to be alike" if shown else "not shown to be alike") or not shown
        assert ("not shown to be alike" in row["note"]) is not shown
        inside = (-margin < alike["low"]) & (alike["high"] < margin)
        assert inside.equals(alike["p"] <= 0.05)
    assert "c alike" not in set(run_tests(paper_frame)["family"])


@pytest.mark.parametrize("uneven", [(8, 1, 8, 1), (8, 8, 8, 8)])
@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_flips_hold_their_level_with_any_number_of_answers(uneven, correlation) -> None:
    """Eight answers against one, at some levels or at all; independent or correlated: 2,000 experiments of no effect.

    Where all pairings were flipped, a fifth of tests of rare, independent answers, eight against one, were significant;
    where answers were shuffled within levels, a third of those of correlated ones.
    """
    rng, shape = np.random.default_rng(8), (2000, 1, 20, 1)
    chance = rng.beta(0.1, 0.9, (2, *shape)) if correlation else np.full((2, *shape), 0.01)
    asked = np.broadcast_to(uneven, (2000, 1, 20, 4)), np.broadcast_to(9 - np.array(uneven), (2000, 1, 20, 4))
    first, second = (Shares(rng.binomial(n, p), n, 8) for n, p in zip(asked, chance, strict=True))
    found = signs_of(Contrast(["all"], ["P"], first, second))
    assert (found.test.p <= 0.05).mean() < 0.05 + 3 * math.sqrt(0.05 / 2000)
    if uneven[1] == 8 and not correlation:
        naive = (first.given * second.answered - second.given * first.answered).sum(axis=-1)
        assert (sign_flip_test(naive).p <= 0.05).mean() > 0.15


def test_answers_are_drawn_alike_whatever_the_names_of_participants() -> None:
    """Another order of the participants draws the same answers; a strong effect is found with half as many of one."""
    rng, asked = np.random.default_rng(9), np.full((1, 20, 4), 8)
    first = Shares(rng.binomial(asked, 0.6), asked, 8)
    second = Shares(rng.binomial(asked // 2, 0.3), asked // 2, 8)
    found, turned = (
        signs_of(Contrast(["all"], ["P"], *(Shares(each.given[:, way], each.answered, 8) for each in (first, second))))
        for way in (slice(None), slice(None, None, -1))
    )
    assert found.test.statistic.tolist() == turned.test.statistic.tolist()
    assert found.test.p < 0.001
    (said,) = found.notes(0)
    told = re.fullmatch(
        "320 answers left out of the test, drawn at random to have equal numbers at each level; "
        "nine in ten other draws give p from ([^ ]+) to ([^ ]+)",
        said,
    )
    assert told is not None
    assert 0 < float(told[1]) < float(told[2]) < 0.001


def test_how_much_p_hangs_on_the_draw_is_that_of_draws_of_its_own() -> None:
    """Two participants, one answer of two drawn from the first condition: p is 0.5 or 1, as the draws fall."""
    first = Shares(np.array([[[1], [1]]]), np.array([[[2], [2]]]), 2)
    second = Shares(np.array([[[0], [0]]]), np.array([[[1], [1]]]), 2)
    (said,) = signs_of(Contrast(["all"], ["P"], first, second)).notes(0)
    assert said.endswith("p from 0.5 to 1")
