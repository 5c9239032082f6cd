"""The certification script: what it counts, and that an interval with too many errors fails."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from modaltouch.analysis.statistics import STATISTICS
from modaltouch.protocol.conditions import StaircaseSection
from modaltouch.protocol.levels import Quest, follow

PLACE = Path(__file__).with_name("certify.py")


@pytest.fixture(scope="module")
def certify():
    """The script as a module."""
    sys.path.insert(0, str(PLACE.parent))
    spec = importlib.util.spec_from_file_location("certify", PLACE)
    module = importlib.util.module_from_spec(spec)
    sys.modules["certify"] = module  # dataclasses look up their module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def small_crowd(certify, monkeypatch):
    """True values from 2,000 people, for speed."""
    monkeypatch.setattr(certify, "CROWD", 2000)


@pytest.mark.usefixtures("small_crowd")
def test_a_population_yields_a_row_for_each_family_of_tests(certify) -> None:
    """One population with missing answers yields every family, each experiment counted once."""
    number = next(
        n for n in range(50) if certify.Population.draw(n).missing and certify.Population.draw(n).participants < 9
    )
    part = certify.certify(number, 12)
    rows = {row["certificate"]: row for row in part["rows"]}
    assert set(STATISTICS) <= set(rows)
    assert set(rows) >= {"rank", "d'", "group", "friedman", "run of one, forced choice", "mean JND"}
    assert set(rows) >= {"mean JND, as estimated", "b together", "c together", "mean criterion"}
    assert set(rows) >= {"shares compared", "mean d' compared", "mean criterion compared", "mean magnitude"}
    assert set(rows) >= {"mean PSE compared", "mean of runs compared, felt", "mean rating"}
    assert set(rows) >= {"run of one, felt, QUEST+", "mean of runs compared, forced choice, QUEST+"}
    assert all(0 <= row["errors"] <= row["n"] <= 12 for row in rows.values())


@pytest.mark.parametrize(("errors", "fails"), [(100, []), (125, []), (200, [0])])
def test_an_error_rate_significantly_above_five_percent_fails(certify, errors, fails) -> None:
    """100, 125 and 200 errors of 2,000: 125 is significant in a single row, but not among two hundred rows."""
    quiet = [{"rows": [{"certificate": "x", "n": 2000, "errors": 90}]} for _ in range(200)]
    told = certify.judge([{"rows": [{"certificate": "x", "n": 2000, "errors": errors}]}, *quiet])
    assert told["x"]["fails"] == fails
    assert told["x"]["worst_rate"] == errors / 2000


def test_a_new_row_that_fails_is_written_without_a_reason(certify) -> None:
    """The rows of a long run are kept even if no reason for a failure has been written yet."""
    told = {"mean_rate": 0.1, "worst_rate": 0.2, "fails": [3]}
    assert certify.brief_of("a new row", told) == '"a new row": [0.1, 0.2, "the reason is not known yet"]'


def test_the_populations_cover_the_stated_ranges(certify) -> None:
    """Minorities of 5 to 30 %, slopes to 2 logit, lapses to 0.15, gaps to 10 %, 6 to 60 people, 1 to 8 repetitions."""
    drawn = [certify.Population.draw(number) for number in range(210)]
    ends = {
        name: (min(values), max(values))
        for name in ("minority", "slope_sd", "lapses", "missing", "participants", "repetitions")
        for values in [[getattr(each, name) for each in drawn]]
    }
    assert ends == {
        "minority": (0.05, 0.3), "slope_sd": (0.5, 2.0), "lapses": (0.0, 0.15), "missing": (0.0, 0.1),
        "participants": (6, 60), "repetitions": (1, 8),
    }  # fmt: skip
    assert {each.kind for each in drawn} == set(certify.KINDS)


def test_simulated_quest_runs_follow_the_rule_of_a_session(certify) -> None:
    """The levels equal those of `Quest`, the rule that sets the levels of a session, answer by answer."""
    measures = certify.certified_measures
    rng, levels = np.random.default_rng(3), measures.LEVELS_DB
    places, successes = measures.quests(0.5, rng, 12, np.linspace(0.5, 0.98, 21) * np.ones((3, 1)))
    for place, success in zip(places, successes, strict=True):
        rule, history = Quest((-20.0, 20.0), levels[measures.START], 0.5, 0.06), []
        for at, succeeded in zip(place, success, strict=True):
            assert rule.next_level(history) == levels[at]
            history.append((float(levels[at]), bool(succeeded)))


@pytest.mark.parametrize("down_after", [1, 2])
def test_simulated_staircases_follow_the_rule_of_a_session(certify, down_after) -> None:
    """The levels of a run of 40 trials equal those of `follow`, which sets the levels of a session."""
    measures, rule = certify.certified_measures, StaircaseSection(down_after=down_after, steps_dB=(8.0, 4.0, 2.0))
    levels, chances = measures.LEVELS_DB, np.linspace(0.2, 0.9, 21)[None]
    (places,), (successes,) = measures.staircases(rule, np.random.default_rng(3), 40, chances)
    bounds, start = (levels[0], levels[-1]), levels[measures.START]
    assert levels[places].tolist() == [follow(rule, start, bounds, successes[:trial].tolist()) for trial in range(40)]


@pytest.mark.usefixtures("small_crowd")
def test_a_worker_with_another_program_is_refused(certify) -> None:
    """The program is checked with each part of the work, because a worker may join late."""
    mine = certify.program()
    assert certify.certify_alike(mine, 3, 2)["rows"] == certify.certify(3, 2)["rows"]
    with pytest.raises(RuntimeError, match="a worker has another source and numpy: install this very program there"):
        certify.certify_alike(mine | {"source": "0", "numpy": "1.0"}, 3, 2)
