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
    """Return the rows of a question whose name and scope contain the given words."""
    found = tests[tests["question"] == question]
    return found[found["name"].str.contains(name, regex=False) & found["scope"].str.contains(scope, regex=False)]


@pytest.fixture(scope="module")
def tests():
    """Statistics of the synthetic set modelled on the paper's text."""
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
        """Ten of ten lean to C: p = 2/2^10, with Holm over six 0.0117."""
        row = rows(tests, "a2", "sign-flip", "one_hand A-C").iloc[0]
        assert (row["p"], row["p_min"]) == (2 / 1024, 2 / 1024)
        assert row["p_holm"] == pytest.approx(6 * 2 / 1024)
        assert row["estimate"] == pytest.approx(39 / 40)

    def test_the_sign_test_counts_leaning_participants(self, tests) -> None:
        """Ten of ten lean to C in the exact sign test, two of two to B."""
        for scope, n in (("one_hand A-C", 10), ("two_hands B-D", 2)):
            row = rows(tests, "a2", "sign test of leaning participants", scope).iloc[0]
            assert (row["estimate"], row["n"], row["p"]) == (1, n, 2 / 2**n)

    def test_few_leaning_participants_give_no_information(self, tests) -> None:
        """(B, D), two hands: two participants lean, so p cannot fall below 0.5."""
        row = rows(tests, "a2", "sign-flip", "two_hands B-D").iloc[0]
        assert row["p_min"] == 0.5
        assert "no information" in row["note"]

    def test_every_p_is_at_least_its_smallest(self, tests) -> None:
        """Definition of p_min."""
        tested = tests.dropna(subset=["p"])
        assert (tested["p"] >= tested["p_min"] - 1e-12).all()
        assert tested["p"].between(0, 1).all()
        assert (tested["p"] > 0).all()

    def test_every_interval_contains_its_estimate(self, tests) -> None:
        """Low, estimate and high are in order wherever all three exist."""
        bounded = tests.dropna(subset=["estimate", "low", "high"])
        assert (bounded["low"] <= bounded["estimate"] + 1e-12).all()
        assert (bounded["estimate"] <= bounded["high"] + 1e-12).all()

    def test_a_constant_answer_has_an_interval(self, tests) -> None:
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

    def test_cells_without_discordance_have_a_width(self, tests) -> None:
        """Closed form: 1 - 0.025^(1/10) = 0.3085, the share of people who may differ and be missing by chance."""
        row = rows(tests, "f", "paired difference", "A-C 100 mm/s").iloc[0]
        assert (row["low"], row["high"]) == pytest.approx((-0.3085, 0.3085), abs=5e-5)

    def test_a_paired_cell_counts_participants_with_both_answers(self, tests) -> None:
        """(C, E), 80 mm/s: all ten answered; the seventh chose C with two hands only."""
        row = rows(tests, "f", "paired difference", "C-E 80 mm/s").iloc[0]
        assert (row["estimate"], row["n"]) == (pytest.approx(-0.1), 10)
        assert row["note"] == "0 chose C only in the first, 1 only in the second"

    def test_intervals_agree_with_the_p_beside_them(self, tests) -> None:
        """Wherever both are printed for a mean, p is above 0.05 if and only if the interval contains zero."""
        both = tests[tests["name"].str.contains("bounded mean") & tests["p"].notna() & tests["low"].notna()]
        assert set(both["family"]) >= {"a2 mean", "b mean", "c mean", "d mean"}
        assert ((both["low"] <= 0) & (both["high"] >= 0)).equals(both["p"] > 0.05)


@pytest.mark.parametrize("response", ["left", "both", "right"])
@pytest.mark.parametrize("n", [1, 2, 10])
def test_constant_answers_are_analysed(build, response, n) -> None:
    """Every p is a probability, no warning is raised (an error here), and no interval has zero width."""
    tests = run_tests(build["tidy"](build["constant"](n, response)))
    tested = tests.dropna(subset=["p"])
    assert tested["p"].between(0, 1, inclusive="right").all()
    assert rows(tests, "b")["p"].eq(1).all()
    assert rows(tests, "c")["p"].eq(1).all()
    intervals = rows(tests, "f", "share of answers")
    assert (intervals["high"] - intervals["low"]).min() > 0.2


@pytest.mark.parametrize("keep", ["participant", "velocity_mm_s", "finger_condition", "zone_left"])
def test_a_design_with_one_level_of_a_factor_is_analysed(build, keep) -> None:
    """With one participant, level, finger condition or pair, every remaining question is answered."""
    frame = build["tidy"](build["paper"]())
    tests = run_tests(frame[frame[keep] == frame[keep].iloc[0]])
    assert {"a1", "a2", "e", "f"} <= set(tests["question"])
    assert ("b" in set(tests["question"])) is (keep != "velocity_mm_s")  # a trend needs two levels


def test_two_levels_are_enough_for_a_trend(build) -> None:
    """If all ten participants change their answer from one level to the other, p is 2/2^10."""
    frame = build["tidy"](build["paper"]())
    frame = frame[frame["velocity_mm_s"].isin([80, 200])]
    frame = frame.assign(response=np.where(frame["velocity_mm_s"] == 200, "right", "left"))
    found = rows(run_tests(frame), "b", "trend test")
    assert found["p"].tolist() == pytest.approx([2 / 2**10] * 6)


def test_the_steepest_slope_is_that_of_a_complete_change(build) -> None:
    """Never the dominant zone below the mean level and always above it: the slope is at the bound of its scale."""
    frame = build["tidy"](build["paper"]())
    answers = count_answers(frame.assign(response=np.where(frame["velocity_mm_s"] > 132.5, "right", "left")))
    found = slopes(answers)
    at_c = [place for place, scope in enumerate(found.scopes) if "A-C" in scope]
    assert found.scores[at_c] == pytest.approx(found.scale)
    assert found.lowest == pytest.approx(found.scores)
    assert found.highest == pytest.approx(found.scores)


def test_two_answers_are_tested_against_guessing(build) -> None:
    """Ten of ten gave one of two answers: 2/2^10; with a third answer none, only felt trials count."""
    frame = build["tidy"](build["constant"](10, "right"))
    for keys in (["left", "right"], ["left", "right", "none"]):
        answers = count_answers(frame, offered=AnswerList.of({"keys": keys}))
        assert chance_tests(answers).test.p == pytest.approx(np.full(24, 2 / 2**10))


def test_a_side_without_an_answer_is_refused(build) -> None:
    """The message lists the answers; whether none is among them is known."""
    frame = build["tidy"](build["constant"](3, "right"))
    offered = [AnswerList.of({"keys": keys}) for keys in (["left", "both", "right"], ["right", "none"])]
    whole, one = (count_answers(frame, offered=each) for each in offered)
    assert whole.sided().sum(axis=(0, 1, 2, 3)).tolist() == [0, len(frame)]
    with pytest.raises(ValueError, match="no answer names the left finger alone: the answers are right, none"):
        one.sided()
    assert (whole.has_none_answer, one.has_none_answer) == (False, True)


def test_the_design_of_the_paper_is_recognised(build) -> None:
    """Three pairs at 80, 100, 150 and 200 mm/s; without one of the levels or pairs it is another design."""
    frame = build["tidy"](build["paper"]())
    parts = frame, frame[frame["velocity_mm_s"] < 200], frame[frame["zone_left"] != "B"]
    assert [count_answers(part).is_paper_design for part in parts] == [True, False, False]


def test_a_mean_leaves_out_missing_values() -> None:
    """One of two values is missing, or both."""
    assert mean_of_known(np.array([[0.5, np.nan], [0.2, 0.4]])) == pytest.approx([0.5, 0.3])
    assert np.isnan(mean_of_known(np.array([[np.nan, np.nan]]))).all()


def test_the_smallest_p_against_guessing_is_that_of_a_single_answer() -> None:
    """Ten who all give one of three answers: 3 / 3^10."""
    assert STATISTICS["a1"].smallest_p([150.0], 10, 1, None) == pytest.approx(3.0**-9)


def test_repetitions_count_as_one_participant(build) -> None:
    """Twenty-four answers of two people are not those of 48: the floor of the sign flips stays 2/2^2."""
    tests = run_tests(build["tidy"](build["random"](2, 3, repetitions=2)))
    assert rows(tests, "a2", "sign-flip")["p_min"].min() >= 0.5
    assert (rows(tests, "a1")["n"] <= 2).all()
    shares = rows(tests, "a1", "share in a cell")
    said = "of each participant's most frequent answer; tied or without an answer, and left out: "
    assert (shares["note"] == said + (2 - shares["n"]).astype(str)).all()


def test_the_estimate_of_a_test_against_guessing_is_of_the_deviating_answer(build) -> None:
    """If all answer "both", the estimate of that test is P(both) = 1, not P(C) = 0."""
    found = rows(run_tests(build["tidy"](build["constant"](10, "both"))), "a1", "multinomial")
    assert set(zip(found["quantity"], found["estimate"], strict=True)) == {
        ("P(C & A)", 1.0), ("P(B & D)", 1.0), ("P(C & E)", 1.0),
    }  # fmt: skip


def test_a_participant_without_an_answer_is_not_called_tied(build) -> None:
    """Of three people, one always timed out in the first cell."""
    frame = build["tidy"](build["random"](3, 3, repetitions=2)).assign(response="right")
    keys = ["participant", "finger_condition", "zone_left", "velocity_mm_s"]
    is_first = (frame[keys] == frame[keys].iloc[0]).all(axis=1)
    said = rows(run_tests(frame[~is_first]), "a1")["note"].str.extract(r"most frequent.*, (\d .*) and left out")[0]
    assert (said == "1 tied or without an answer").sum() == 1


def test_order_times_and_speeds_are_used_if_present(build) -> None:
    """The columns trial, response_time, speed_left_mm_s and speed_right_mm_s add their questions."""
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


def test_guesses_are_rarely_called_dominance(build) -> None:
    """Type I error: of 40 synthetic experiments of guesses, at most 6 have a Holm p <= 0.05 in a2 (3 sd)."""
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

    def test_missing_answers_are_counted_and_bounded(self, gaps, paper_frame) -> None:
        """The bounds contain the estimate of the complete table, as they hold for any missing answers."""
        tests, whole = run_tests(gaps), run_tests(paper_frame)
        row = rows(tests, "a2", "net dominance, mean", "one_hand C-E").iloc[0]
        known = rows(whole, "a2", "net dominance, mean", "one_hand C-E").iloc[0]["estimate"]
        told = re.search(r"2 of 40 answers missing; with them the estimate could be (\S+) to (\S+),", row["note"])
        assert float(told[1]) <= known <= float(told[2])
        assert "missing" not in rows(tests, "a2", "net dominance, mean", "two_hands A-C").iloc[0]["note"]

    def test_the_bounds_are_the_extreme_missing_answers(self, gaps) -> None:
        """By hand: two of 40 answers unknown, both to C or both to E, among p01's four answers."""
        row = rows(run_tests(gaps), "f", "share of answers", "one_hand C-E")
        note = row[row["quantity"] == "P(C)"]["note"].iloc[0]
        given = int(
            ((gaps["zone_left"] == "C") & (gaps["response"] == "left") & (gaps["finger_condition"] == "one_hand")).sum()
        )
        assert f"the share could be {given / 40:.3g} to {(given + 2) / 40:.3g}" in note

    def test_shares_are_bounded_by_the_presented_trials(self) -> None:
        """By hand: one of three answers to four trials gives a quarter to a half."""
        shares = Shares(np.array([[1]]), np.array([[3]]), 4)
        assert (shares.least.item(), shares.most.item()) == (1 / 4, 2 / 4)

    def test_flips_and_bounds_count_answered_trials(self) -> None:
        """By hand: of four trials, one of three against none of four, and one of three against four of four."""
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
        """The rows are the same as without gaps, and every p is a probability."""
        tests, whole = run_tests(gaps), run_tests(paper_frame)
        assert tests[["question", "name", "scope"]].equals(whole[["question", "name", "scope"]])
        assert tests["p"].dropna().between(0, 1, inclusive="right").all()


def test_the_normal_approximation_is_noted_where_used(paper_frame) -> None:
    """It depends on the answers given: 4 per participant of 800 trials are shuffled exactly, 404 are not."""
    few, many = count_answers(paper_frame, asked=200), count_answers(pd.concat([paper_frame] * 101))
    assert not any("normal approximation" in note for note in level_tests(few).notes(0))
    assert any("normal approximation" in note for note in level_tests(many).notes(0))


def test_equivalence_is_reported_as_shown_or_not_shown(paper_frame) -> None:
    """Ten participants: shown within 0.5 for (A, C), where two differ by a quarter; within 0.1 for none."""
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
def test_flips_keep_their_level_with_unequal_numbers_of_answers(uneven, correlation) -> None:
    """Eight answers against one, at some or all levels, independent or correlated: 2,000 experiments without effect.

    If all pairings were flipped, a fifth of tests of rare, independent answers, eight against one, would be
    significant; if answers were shuffled within levels, a third of those of correlated ones.
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


def test_answers_drawn_do_not_depend_on_the_order_of_participants() -> None:
    """Reordered participants have the same draws; a strong effect is found with half the answers in one condition."""
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


def test_the_range_of_p_over_draws_is_reported() -> None:
    """Two participants, one answer of two drawn from the first condition: p is 0.5 or 1, depending on the draw."""
    first = Shares(np.array([[[1], [1]]]), np.array([[[2], [2]]]), 2)
    second = Shares(np.array([[[0], [0]]]), np.array([[[1], [1]]]), 2)
    (said,) = signs_of(Contrast(["all"], ["P"], first, second)).notes(0)
    assert said.endswith("p from 0.5 to 1")
