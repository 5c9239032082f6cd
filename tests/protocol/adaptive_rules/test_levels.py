from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from modaltouch.protocol import Findings, Protocol
from modaltouch.protocol.conditions import StaircaseSection
from modaltouch.protocol.levels import Levels, from_dB, to_dB
from modaltouch.protocol.schedule import Schedule
from modaltouch.protocol.trial import AnswerList, Trial

SHIPPED = Path(__file__).parents[3] / "protocols" / "threshold.yaml"


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    """The shipped adaptive protocol."""
    return Findings.read(SHIPPED).experiment().protocol


def with_rule(protocol: Protocol, **changes: Any) -> Protocol:
    """Return the protocol with another section ``adaptive``."""
    assert protocol.adaptive is not None
    return protocol.model_copy(update={"adaptive": protocol.adaptive.model_copy(update=changes)})


def event(trial: Trial, answer: str, *, confirmed: bool = True) -> dict[str, Any]:
    """Return what the record says of an answer."""
    return {"trial": trial.as_dict(), "confirmed": {"confirmed": confirmed}, "response": {"answer": answer}}


def run_through(protocol: Protocol, threshold: float, seed: int) -> list[dict[str, Any]]:
    """Return the record of a session in which the focus is named by a cumulative normal over decibels."""
    levels, rng, events = Levels(protocol), np.random.default_rng(seed), list[dict[str, Any]]()
    for scheduled in Schedule.draw(protocol, "p01", seed).trials:
        trial = levels.settle(scheduled, events)
        named = "left" if trial.condition.zone_left == "C" else "right"
        is_felt = not trial.condition.is_catch and rng.random() < norm.cdf(
            (to_dB(trial.condition.velocity_mm_s) - to_dB(threshold)) / 4
        )
        events.append(event(trial, named if is_felt else "none"))
    return events


@pytest.mark.parametrize("method", ["staircase", "quest_plus"])
def test_the_record_alone_decides_every_level(protocol: Protocol, method: str) -> None:
    """Begun anew after any answer, the next level is the very same."""
    given = with_rule(protocol, method=method, trials=12)
    events, order = run_through(given, 20.0, 3), Schedule.draw(given, "p01", 3).trials
    fresh = Levels(given)
    for cut in (0, 1, 5, 11, 17, 25, len(events) - 1):
        resumed = Levels(given) if cut % 2 else fresh
        assert resumed.settle(order[cut], events[:cut]).as_dict() == events[cut]["trial"]
        # Later answers, as of a trial that is repeated, change nothing.
        assert resumed.settle(order[cut], events).as_dict() == events[cut]["trial"]


@pytest.mark.parametrize("method", ["staircase", "quest_plus"])
@pytest.mark.parametrize("threshold", [6.0, 25.0, 90.0])
def test_levels_gather_around_the_threshold(protocol: Protocol, method: str, threshold: float) -> None:
    """A known observer: the later half of each run lies within 6 dB of its threshold on average, and within bounds."""
    events = run_through(with_rule(protocol, method=method), threshold, 1)
    for pair in (("A", "C"), ("C", "E")):
        run = [
            each["trial"]["condition"]["velocity_mm_s"]
            for each in events
            if (each["trial"]["condition"]["zone_left"], each["trial"]["condition"]["zone_right"]) == pair
            and each["trial"]["condition"]["velocity_mm_s"]
        ]
        assert len(run) == 40
        assert run[0] == 60
        assert 2 <= min(run) <= max(run) <= 200
        assert np.mean([to_dB(level) for level in run[20:]]) == pytest.approx(to_dB(threshold), abs=6)


def test_an_answer_that_was_not_confirmed_moves_nothing(protocol: Protocol) -> None:
    """A trial whose stimulus the instrument did not confirm is offered again at the same level."""
    first, second = Schedule.draw(with_rule(protocol, method="staircase"), "p01", 1).trials[:2]
    levels = Levels(with_rule(protocol, method="staircase"))
    unsure = event(levels.settle(first, []), "right", confirmed=False)
    assert levels.settle(second, [unsure]).condition.velocity_mm_s == 60
    assert levels.settle(second, [event(levels.settle(first, []), "right")]).condition.velocity_mm_s != 60


def test_a_time_out_is_no_success_but_in_a_record_of_its_day(protocol: Protocol) -> None:
    """Who says nothing has not said that anything was felt; levels of former records follow as they did."""
    rule = with_rule(protocol, method="staircase", success="felt")
    first, second = Schedule.draw(rule, "p01", 1).trials[:2]
    levels = Levels(rule)
    late = [event(levels.settle(first, []), "time_out")]
    assert levels.settle(second, late).condition.velocity_mm_s > 60
    assert levels.settle(second, late, "modaltouch staircase 2").condition.velocity_mm_s > 60
    assert levels.settle(second, late, "modaltouch staircase 1").condition.velocity_mm_s < 60


def test_practice_and_catch_trials_and_fixed_levels_stay_as_they_are(protocol: Protocol) -> None:
    """Only what counts in a run has a level of its own."""
    drawn, levels = Schedule.draw(protocol, "p01", 1), Levels(protocol)
    catch = next(trial for trial in drawn.trials if trial.condition.is_catch)
    assert levels.settle(catch, []) == catch
    assert levels.settle(drawn.practice[0], []) == drawn.practice[0]
    fixed = Findings.read(SHIPPED.with_name("demo.yaml")).experiment().protocol
    trial = Schedule.draw(fixed, "p01", 1).trials[0]
    assert Levels(fixed).settle(trial, []) == trial


@pytest.mark.parametrize(
    ("rule", "zones", "answer", "success"),
    [
        ("focus_named", ("A", "C"), "right", True),
        ("focus_named", ("A", "C"), "left", False),
        ("focus_named", ("A", "C"), "both", False),
        ("focus_named", ("C", "E"), "left", True),
        ("focus_named", ("C", "A"), "left", True),
        ("felt", ("A", "C"), "left", True),
        ("felt", ("A", "C"), "none", False),
    ],
)
def test_success_is_what_the_protocol_says(rule: str, zones: tuple[str, str], answer: str, success: bool) -> None:
    """Definition, also on a beam that is turned end to end (C left of A)."""
    answers = AnswerList.of({"keys": ["left", "both", "right", "none"]})
    assert answers.is_success(answer, rule, "C", zones[0]) is success


def test_levels_have_four_digits_and_keep_their_bounds() -> None:
    """Four digits, as many as the generator's amplitude."""
    assert from_dB(20.0, (2.0, 200.0)) == 10
    assert from_dB(to_dB(12.34567), (2.0, 200.0)) == 12.35
    assert from_dB(-40.0, (2.0, 200.0)) == 2


def test_the_schedule_says_adaptive(protocol: Protocol) -> None:
    """The record's schedule does not pass the first level for that of every trial."""
    values = Schedule.draw(protocol, "p01", 1).as_dict()
    assert values["levels"] == "adaptive"
    assert values["n_trials"] == protocol.n_trials == 90
    assert (
        "levels"
        not in Schedule.draw(Findings.read(SHIPPED.with_name("demo.yaml")).experiment().protocol, "p01", 1).as_dict()
    )


def test_the_record_says_which_rule_decided_the_levels(protocol: Protocol) -> None:
    """A record must be read by what made it; the target is 0.5 ** (1 / 3) of three down, one up (Levitt 1971)."""
    staircase = with_rule(protocol, method="staircase", staircase=StaircaseSection(down_after=3))
    assert staircase.adaptive.algorithm == {"algorithm": "modaltouch staircase 2", "target": 0.7937}
    quest = {"algorithm": "modaltouch quest_plus 2", "questplus": version("questplus")}
    assert with_rule(protocol, method="quest_plus").adaptive.algorithm == quest
