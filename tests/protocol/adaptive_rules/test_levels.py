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
    """Return an answer as recorded."""
    return {"trial": trial.as_dict(), "confirmed": {"confirmed": confirmed}, "response": {"answer": answer}}


def run_through(protocol: Protocol, threshold: float, seed: int) -> list[dict[str, Any]]:
    """Return the record of a session whose observer is a cumulative normal over decibels."""
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
def test_the_next_level_follows_from_the_record_alone(protocol: Protocol, method: str) -> None:
    """Restarted after any answer, the next level is identical."""
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
def test_levels_converge_to_the_threshold(protocol: Protocol, method: str, threshold: float) -> None:
    """Known observer: the second half of each run averages within 6 dB of its threshold, within the bounds."""
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


def test_an_unconfirmed_answer_does_not_change_the_level(protocol: Protocol) -> None:
    """The trial is repeated at the same level."""
    first, second = Schedule.draw(with_rule(protocol, method="staircase"), "p01", 1).trials[:2]
    levels = Levels(with_rule(protocol, method="staircase"))
    unsure = event(levels.settle(first, []), "right", confirmed=False)
    assert levels.settle(second, [unsure]).condition.velocity_mm_s == 60
    assert levels.settle(second, [event(levels.settle(first, []), "right")]).condition.velocity_mm_s != 60


def test_a_time_out_is_a_failure_except_in_old_records(protocol: Protocol) -> None:
    """Records of the first version of the rule, which counted it as a success, keep their levels."""
    rule = with_rule(protocol, method="staircase", success="felt")
    first, second = Schedule.draw(rule, "p01", 1).trials[:2]
    levels = Levels(rule)
    late = [event(levels.settle(first, []), "time_out")]
    assert levels.settle(second, late).condition.velocity_mm_s > 60
    assert levels.settle(second, late, "modaltouch staircase 2").condition.velocity_mm_s > 60
    assert levels.settle(second, late, "modaltouch staircase 1").condition.velocity_mm_s < 60


def test_other_trials_keep_their_levels(protocol: Protocol) -> None:
    """Practice, catch trials and protocols with fixed levels are unchanged."""
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
def test_success_follows_the_rule_of_the_protocol(
    rule: str, zones: tuple[str, str], answer: str, success: bool
) -> None:
    """Also with the beam turned end to end (C left of A)."""
    answers = AnswerList.of({"keys": ["left", "both", "right", "none"]})
    assert answers.is_success(answer, rule, "C", zones[0]) is success


def test_levels_have_four_digits_and_keep_their_bounds() -> None:
    """Four digits, as in the generator's amplitude."""
    assert from_dB(20.0, (2.0, 200.0)) == 10
    assert from_dB(to_dB(12.34567), (2.0, 200.0)) == 12.35
    assert from_dB(-40.0, (2.0, 200.0)) == 2


def test_the_schedule_is_marked_as_adaptive(protocol: Protocol) -> None:
    """The record does not present the first level as that of every trial."""
    values = Schedule.draw(protocol, "p01", 1).as_dict()
    assert values["levels"] == "adaptive"
    assert values["n_trials"] == protocol.n_trials == 90
    assert (
        "levels"
        not in Schedule.draw(Findings.read(SHIPPED.with_name("demo.yaml")).experiment().protocol, "p01", 1).as_dict()
    )


def test_the_record_has_the_rule_of_the_levels(protocol: Protocol) -> None:
    """Rule with version, and the target 0.5 ** (1 / 3) of three down, one up (Levitt 1971)."""
    staircase = with_rule(protocol, method="staircase", staircase=StaircaseSection(down_after=3))
    assert staircase.adaptive.algorithm == {"algorithm": "modaltouch staircase 2", "target": 0.7937}
    quest = {"algorithm": "modaltouch quest_plus 2", "questplus": version("questplus")}
    assert with_rule(protocol, method="quest_plus").adaptive.algorithm == quest
