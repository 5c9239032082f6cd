"""Simulated experiments: the observer's shares, false positives under the null, and seeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from modaltouch.analysis.intervals import wilson
from modaltouch.analysis.statistics import STATISTICS
from modaltouch.planning.design import Design
from modaltouch.planning.experiments import BATCH, BATCH_CELLS, Job, Study, answer_shares, divide, run_job, simulate
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant
from modaltouch.protocol import AnswerList

ALL = tuple(family for family, statistic in STATISTICS.items() if not statistic.when_alike)
VARIED = Observer(
    Participant(noise=0.4, criterion=0.35, side_bias=0.2, near_miss=0.3),
    side_bias_spread=0.35,
    noise_spread=0.5,
    criterion_spread=0.5,
)


def test_simulated_answers_have_the_observers_shares(design: Design) -> None:
    """Mean counts agree with closed-form probabilities of a large crowd within 4 standard errors."""
    answers = simulate(design, VARIED, Job(50, 2, 0, 200), np.random.default_rng(1))
    crowd = VARIED.draw_participants(np.random.default_rng(2), (40_000,))
    left, right = answer_shares(crowd, design.speeds.reshape(-1, 2), design.cells)
    for place, share in ((0, left), (2, right)):
        means = answers.counts[..., place].mean(axis=(0, 1)).ravel() / 2
        assert means == pytest.approx(share.mean(axis=0), abs=4 * 0.5 / np.sqrt(10_000))
    assert answers.counts.min() >= 0
    assert (answers.counts.sum(axis=-1) == 2).all()


def test_lapses_are_spread_over_all_answers_of_the_protocol(design: Design) -> None:
    """A participant who only guesses gives each of four answers a quarter of the time, in the protocol's order."""
    offered = AnswerList.of({"keys": {"links": [], "beide": [], "nichts": [], "rechts": []}, "fingers": {
        "links": ["left"], "beide": ["left", "right"], "nichts": [], "rechts": ["right"]}})  # fmt: skip
    guessing = replace(design, answers=offered)
    answers = simulate(guessing, Observer(Participant(lapse_rate=1.0)), Job(50, 2, 0, 20), np.random.default_rng(1))
    assert [answers.answers[place].name for place in guessing.places] == ["links", "beide", "rechts", "nichts"]
    assert answers.counts.mean(axis=tuple(range(5))) == pytest.approx([0.5] * 4, abs=4 * np.sqrt(0.375 / 24_000))
    alert = simulate(guessing, Observer(Participant(lapse_rate=0.0)), Job(50, 2, 0, 1), np.random.default_rng(1))
    assert alert.counts[..., guessing.places[3]].sum() == 0
    assert any("P(beide)" in quantity for _, quantity in guessing.tests["d"])


@pytest.mark.parametrize("n_repetitions", [1, 2])
def test_false_positives_stay_within_alpha(design: Design, n_repetitions: int) -> None:
    """At most 5 % of experiments have a significant test in a family (Holm), with participants that differ."""
    study = Study(design, VARIED, ALL, null=True, seed=7)
    tallies = [run_job(study, job) for job in divide(design, [(12, n_repetitions)], 1000)]
    for family in ALL:
        assert wilson(sum(tally[family].any_test for tally in tallies), 1000).low <= 0.05, family


def test_single_tests_use_most_of_alpha_with_many_participants(design: Design) -> None:
    """Uncorrected tests reject slightly less than 5 %: at N = 40 discreteness costs little."""
    study = Study(design, VARIED, ("a2", "b"), null=True, seed=3)
    for family, tally in run_job(study, Job(40, 2, 0, 250)).items():
        found = wilson(int(tally.single.sum()), 250 * len(tally.single))
        assert found.low <= 0.05, family
        assert found.high > 0.035, family


def test_the_null_keeps_differences_between_participants(design: Design) -> None:
    """Only the common side bias is removed, and every cell has equal speeds on both sides."""
    alike, observer = Study(design, VARIED, ("a2",), null=True, seed=1).simulated
    assert observer == replace(VARIED, typical=replace(VARIED.typical, side_bias=0.0))
    assert np.ptp(alike.speeds) == 0


def test_a_turned_beam_cancels_a_shared_side_bias() -> None:
    """With half the participants at the turned beam, a bias to the right no longer looks like dominance in (B,D)."""
    biased = Observer(Participant(side_bias=0.5), side_bias_spread=0.0)
    one = Observer(Participant())
    pair = (("B", "D"),)
    placed = {name: _bd_design(pair, turned) for name, turned in (("same", (False,)), ("turned", (False, True)))}
    power = {
        name: run_job(Study(design, biased, ("a2",), null=False, seed=1), Job(20, 2, 0, 250))["a2"].any_test / 250
        for name, design in placed.items()
    }
    assert power["same"] > 0.95
    assert power["turned"] < 0.15
    assert run_job(Study(placed["same"], one, ("a2",), null=False, seed=1), Job(20, 2, 0, 250))["a2"].any_test < 25


def _bd_design(pairs: tuple[tuple[str, str], ...], placements: tuple[bool, ...]) -> Design:
    from modaltouch.analysis.counts import Pair

    speeds = np.full((1, 1, 4, 2), 0.1)
    oriented = tuple(Pair.of(left, right, "C") for left, right in pairs)
    return Design("bd", ("one_hand",), oriented, (80.0, 100.0, 150.0, 200.0), speeds, placements)


def test_a_job_depends_only_on_its_seed(design: Design) -> None:
    """The same job gives the same tally alone and after others; another batch or seed gives another."""
    study = Study(design, VARIED, ("a2",), null=False, seed=1)
    first = run_job(study, Job(10, 1, 0, 50))["a2"]
    run_job(study, Job(12, 1, 0, 50))
    again = run_job(study, Job(10, 1, 0, 50))["a2"]
    assert first.single.tolist() == again.single.tolist()
    widths = {
        float(run_job(replace(study, seed=s), Job(10, 1, b, 50))["a2"].width.sum()) for s in (1, 2) for b in (0, 1)
    }
    assert len(widths) == 4


def test_jobs_cover_every_experiment_once_and_all_sizes_first(design: Design) -> None:
    """The batches add up to the requested experiments; the first jobs are batch 0 of every size."""
    sizes = [(n, r) for r in (1, 2) for n in (6, 10)]
    jobs = divide(design, sizes, 2 * BATCH + 30)
    assert [job.batch for job in jobs[:4]] == [0] * 4
    for size in sizes:
        own = [job for job in jobs if (job.n_participants, job.n_repetitions) == size]
        assert sum(job.n_experiments for job in own) == 2 * BATCH + 30
        assert [job.batch for job in own] == [0, 1, 2]


def test_large_experiments_are_divided_into_small_jobs(design: Design) -> None:
    """No job has more answers than the memory bound allows."""
    for job in divide(design, [(1000, 1)], 300):
        assert job.n_experiments * 1000 * len(design.cells) <= BATCH_CELLS
