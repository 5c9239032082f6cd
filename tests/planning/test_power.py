"""Plans: independence of the division of work, interruption, and the number of participants needed."""

from __future__ import annotations

import json
import math

import pytest

from modaltouch.analysis.intervals import wilson
from modaltouch.analysis.statistics import STATISTICS
from modaltouch.planning.design import Design
from modaltouch.planning.experiments import Study, run_job
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant
from modaltouch.planning.power import Power, plan

UNSURE = Observer(Participant(noise=0.5, criterion=0.4, suppression=0.8, suppression_across_hands=0.2), name="unsure")
SIZES = [(n, r) for r in (1, 2) for n in (6, 10, 14)]


@pytest.fixture
def study(design: Design) -> Study:
    """The paper's design with an unsure observer."""
    return Study(design, UNSURE, tuple(STATISTICS), null=False, seed=1)


def test_the_number_of_processes_changes_nothing(study: Study) -> None:
    """One process and two give the same figures; each job has its own spawned seed."""
    alone = plan(study, SIZES[:2], 300)
    shared = plan(study, SIZES[:2], 300, n_processes=2)
    assert json.dumps(alone.as_dict()) == json.dumps(shared.as_dict())


def test_other_sizes_change_nothing(study: Study) -> None:
    """An experiment of ten participants has the same result in any sweep."""
    alone, swept = plan(study, [(10, 1)], 40), plan(study, SIZES, 40)
    assert alone.families == [row for row in swept.families if (row["n_participants"], row["n_repetitions"]) == (10, 1)]


def test_an_interruption_keeps_finished_jobs(study: Study) -> None:
    """Two of six jobs are finished: two sizes have all their 40 experiments, and the plan is incomplete."""
    done: list[int] = []
    found = plan(study, SIZES, 40, on_progress=lambda n, total: done.append(n), should_stop=lambda: len(done) >= 2)
    assert done == [1, 2]
    assert not found.complete
    assert {size: tallies["a2"].n_experiments for size, tallies in found.tallies.items()} == {(6, 1): 40, (10, 1): 40}
    assert len(found.families) == 2 * len(STATISTICS)


def test_an_interruption_of_processes_keeps_finished_jobs(study: Study) -> None:
    """The results received before the stop equal those of one process."""
    done: list[int] = []
    found = plan(
        study,
        SIZES,
        20,
        n_processes=2,
        on_progress=lambda n, total: done.append(n),
        should_stop=lambda: len(done) >= 1,
    )
    assert found.tallies
    whole = plan(study, list(found.tallies), 20)
    assert found.families == whole.families


def test_intervals_are_those_of_wilson(study: Study) -> None:
    """They are score intervals of the share of significant experiments, by family and by test."""
    found = plan(study, [(10, 1)], 120)
    tally = found.tallies[10, 1]["d"]
    row = next(row for row in found.families if row["family"] == "d")
    expected = wilson(tally.any_test, 120)
    assert (row["power"], row["low"], row["high"]) == (expected.estimate, expected.low, expected.high)
    tests = [row for row in found.tests if row["family"] == "d"]
    assert [row["power"] for row in tests] == pytest.approx((tally.corrected / 120).tolist())
    assert all(row["low"] <= row["power"] <= row["power_uncorrected"] for row in tests)


def test_power_grows_with_participants_and_widths_shrink(study: Study) -> None:
    """For a real effect power rises beyond the Monte Carlo error; widths fall like the root of N or faster."""
    found = plan(study, [(8, 1), (16, 1), (32, 1)], 250)
    rows = [row for row in found.tests if row["family"] == "d mean" and row["scope"] == "one_hand A-C - B-D"]
    assert [row["n_participants"] for row in rows] == [8, 16, 32]
    assert rows[0]["high"] < rows[1]["low"] or rows[0]["power"] < rows[1]["power"] < rows[2]["power"]
    assert rows[2]["half_width"] < rows[1]["half_width"] / math.sqrt(1.8)


def test_the_number_needed_is_the_least_from_which_power_stays_above_the_target() -> None:
    """It is 12: 8 reaches the target, but 10 falls below it; it is None if the largest size is below."""
    powers = {"a2": {8: 0.9, 10: 0.7, 12: 0.85, 14: 0.9}, "d": {8: 0.9, 10: 0.9, 12: 0.9, 14: 0.5}}
    rows = [
        {"question": family, "family": family, "n_repetitions": 1, "n_participants": n, "power": power}
        for family, by_size in powers.items()
        for n, power in by_size.items()
    ]
    found = Power.__new__(Power)
    object.__setattr__(found, "families", rows)
    object.__setattr__(found, "tests", [])
    needed = {row["family"]: row["n_participants"] for row in found.needed(0.8)}
    assert needed == {"a2": 12, "d": None}


def test_json_has_the_settings_and_finite_values(study: Study) -> None:
    """Strict JSON without NaN; every row of tests has a question, a scope and an interval."""
    values = json.loads(json.dumps(plan(study, [(6, 1), (8, 1)], 10).as_dict(), allow_nan=False))
    assert (values["seed"], values["n_experiments"], values["complete"]) == (1, 10, True)
    below = [row for row in values["power"] if row["family"] == "a2" and row["n_participants"] == 6]
    assert below[0]["reachable"] is False
    assert below[0]["power"] == 0
    assert all(row["low"] <= row["power"] <= row["high"] for row in (*values["power"], *values["tests"]))
    assert {"question", "scope", "half_width", "n_participants", "n_repetitions"} <= set(values["tests"][0])


def test_a_plan_is_the_sum_of_its_jobs(study: Study) -> None:
    """The tallies of all batches add up."""
    from modaltouch.planning.experiments import divide

    whole = plan(study, [(8, 1)], 510).tallies[8, 1]["a2"]
    parts = [run_job(study, job)["a2"] for job in divide(study.design, [(8, 1)], 510)]
    assert len(parts) == 3
    assert whole.any_test == sum(part.any_test for part in parts)
    assert whole.n_experiments == 510
