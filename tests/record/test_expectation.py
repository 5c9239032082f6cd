"""Lines of a record against each other, at the edges: what one more microsecond or one more burst changes."""

from __future__ import annotations

import copy
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from modaltouch.protocol import AnswersSection, Sources, Trial
from modaltouch.protocol.questions import QuestionSection
from modaltouch.protocol.trial import Condition
from modaltouch.record import Session
from modaltouch.record.expectation import (
    Expectation,
    check_answers,
    check_bursts,
    check_form,
    check_instants,
    listed,
    restore,
)
from modaltouch.session import simulate_session

TRIAL = Trial(1, 1, Condition("one_hand", "A", "C", 80.0))
SILENT = replace(TRIAL, condition=Condition("one_hand", "A", "C", 0.0))
US = 1e-6


def line(**changes: float | str | None) -> dict[str, Any]:
    """Return an answer at 11 s to a stimulus that began at 10 s, with a question at 10.3 s, otherwise changed."""
    said: dict[str, Any] = {
        "first": (9.999, 10.001), "question": (10.29, 10.3), "answer": (11.0, 11.002), "clock": 11.01,
        "reaction_time": 1.0, "word": "left", "from": "first_burst", **changes,
    }  # fmt: skip
    names = {"first_burst": said["first"], "question": said["question"], "answer": said["answer"]}
    return {
        "event": "answered",
        "clock": said["clock"],
        "instants": {
            name: None if span is None else {"earliest_s": span[0], "latest_s": span[1]} for name, span in names.items()
        },
        "response": {"answer": said["word"], "onset": said["from"], "reaction_time": said["reaction_time"]},
        "confirmed": {"onset": 10.0, "onset_uncertainty": 0.001, "confirmed": False},
    }


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"reaction_time": 0.999 - 4 * US},
        {"reaction_time": 1.003 + 4 * US},
        {"clock": 11.0 - 4 * US},
        {"question": (9.98, 9.999 - 4 * US)},
        {"question": None},
        {"first": None},
        {"from": "question", "reaction_time": 0.7},
        {"from": "question", "reaction_time": 0.712 + 4 * US},
        {"from": "question", "question": None, "reaction_time": 0.0},
        {"word": "time_out", "reaction_time": 77.0},
    ],
)
def test_instants_that_fit_are_no_fault(changes: dict[str, Any]) -> None:
    """Within how exactly each is known, and the 5 us that rounding to 1 us may add up to."""
    assert [*check_instants(line(**changes), TRIAL)] == []


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (
            {"reaction_time": 0.999 - 6 * US},
            "has a reaction time of 0.998994 s, but its instants give 0.999 to 1.003 s",
        ),
        ({"reaction_time": 1.003 + 6 * US}, "has a reaction time of 1.00301 s, but its instants give 0.999 to 1.003 s"),
        ({"clock": 11.0 - 6 * US}, "its answer came at 11.0 s, after its line was written at 10.999994 s"),
        ({"question": (9.98, 9.999 - 6 * US)}, "its question came before its first burst"),
        ({"answer": (10.2, 10.2), "reaction_time": 0.2}, "its answer came before its question"),
        ({"question": (10.3, 10.29)}, "its question came between 10.3 and 10.29 s"),
        ({"from": "question", "reaction_time": 0.7 - 6 * US}, "its instants give 0.7 to 0.712 s"),
        ({"from": "question", "reaction_time": 0.712 + 6 * US}, "its instants give 0.7 to 0.712 s"),
        ({"from": "question", "question": None, "reaction_time": -6 * US}, "its instants give 0 to 1.003 s"),
        ({"first": None, "reaction_time": 1.003 + 6 * US}, "its instants give 0.999 to 1.003 s"),
    ],
)
def test_instants_that_do_not_fit_are_named(changes: dict[str, Any], fault: str) -> None:
    """By what came when, and what the reaction time could have been."""
    (found,) = check_instants(line(**changes), TRIAL)
    assert fault in found


def test_a_catch_trial_has_no_first_burst() -> None:
    """Its answer counts from the instant at which the burst would have come."""
    assert [*check_instants(line(first=None), SILENT)] == []
    assert [*check_instants(line(), SILENT)] == ["is a catch trial with a first burst"]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A session of the demonstration."""
    return simulate_session("demo", "sim01", tmp_path_factory.mktemp("results"))


@pytest.fixture(scope="module")
def given(session: Session) -> Expectation:
    """What its start record leads to."""
    return restore(Sources.from_dict(session.start["sources"]), session.occasion)


def test_the_start_record_names_the_stimulus_and_its_level(session: Session, given: Expectation) -> None:
    """By the hash of its codes, with its amplitudes at the highest level of the protocol."""
    burst, said = given.preflight.stimulus.burst, session.start["stimulus"]
    assert said["velocity_mm_s"] == pytest.approx(200.0, rel=1e-12)
    assert (said["content_hash"], said["amplitude_Vpp"]) == (burst.content_hash, list(burst.amplitude))
    assert [row["velocity_mm_s"] for row in said["stimuli"]] == [80.0, 200.0]


def faults_of(event: dict[str, Any], given: Expectation, **bursts: int | None) -> list[str]:
    """Return the faults of a finished trial whose counts of bursts are changed."""
    told = copy.deepcopy(event)
    told["bursts"].update(bursts)
    return [*check_bursts(told, Trial.from_dict(told["trial"]), given)]


@pytest.mark.parametrize(
    ("written", "answered", "is_sound"),
    [(-0.19, 0.19, True), (-0.21, 0.0, False), (0.0, 0.21, False), (5.0, -5.0, True)],
)
def test_bursts_are_as_many_as_were_due(
    session: Session, given: Expectation, written: float, answered: float, is_sound: bool
) -> None:
    """Seven a second: the last is not due after its line was written, the one after it not before the answer.

    A burst is late, and not dropped, within a fifth of a period; the first is known to within its uncertainty.
    """
    event = copy.deepcopy(session.trials[0])
    first, around = event["bursts"]["first_s"], event["bursts"]["uncertainty_s"]
    for n in (1, 2, 12):
        event["clock"] = first + (n - 1 + written) / 7 - around
        event["instants"]["answer"]["earliest_s"] = first + (n + answered) / 7 + around
        found = faults_of(event, given, asked=n, played=n, whole=n)
        assert [f"its record says {n} bursts due, but at 7 Hz" in fault for fault in found] == [True] * (not is_sound)


@pytest.mark.parametrize(
    ("bursts", "fault"),
    [
        ({"whole": 0}, "is confirmed with"),
        ({"played": 0, "whole": 0}, "is confirmed with"),
        ({"dropped": 1}, "is confirmed with"),
        ({"asked": True}, "is confirmed, although its bursts are not all counted"),
        ({"asked": None}, "is confirmed, although its bursts are not all counted"),
    ],
)
def test_a_confirmed_stimulus_has_whole_bursts_and_all_of_them(
    session: Session, given: Expectation, bursts: dict[str, Any], fault: str
) -> None:
    """None cut, and what was due was played or dropped."""
    assert any(fault in found for found in faults_of(session.trials[0], given, **bursts))


def test_an_unconfirmed_stimulus_may_lack_counts(session: Session, given: Expectation) -> None:
    """Nobody counts on it, so its bursts need not add up."""
    event = copy.deepcopy(session.trials[0])
    event["confirmed"]["confirmed"] = False
    assert faults_of(event, given, asked=9, played=None, whole=None) == []


def further(word: str = "low") -> dict[str, Any]:
    """Return the answer to a further question."""
    return {"answer": word, "reaction_time": 0.5, "question_after": 1.0}


def test_further_questions_are_those_of_the_protocol(given: Expectation) -> None:
    """Each in its place with one of its answers, and none before the end or after a time-out."""
    question = QuestionSection.model_validate({"keys": {"low": ["f1"], "high": ["f2"]}})
    asked = given.protocol.answers.model_copy(update={"then": {"sure": question, "near": question}})
    event = line() | {"event": "trial"}
    event["confirmed"]["confirmed"] = True
    for answers, faults in (
        ({"sure": further(), "near": further("high")}, []),
        (
            {"sure": further("upwards"), "near": further()},
            ["sure: was answered 'upwards'; allowed: low, high, time_out"],
        ),
        (
            {"near": further(), "sure": further()},
            ["answers the further questions near, sure, but sure, near were asked"],
        ),
        ({"sure": further()}, ["answers the further questions sure, but sure, near were asked"]),
    ):
        event["response"]["further"] = answers
        assert [*check_answers(event, asked)] == faults
    assert [*check_answers({**event, "event": "answered"}, asked)] == [
        "answers the further questions sure, but - were asked"
    ]
    event["response"]["answer"] = "time_out"
    assert len([*check_answers(event, asked)]) == 1


@pytest.mark.parametrize("seconds", [0.0, 1e9])
def test_a_reaction_takes_a_finite_time(given: Expectation, seconds: float) -> None:
    """From nothing on; infinity and what is no number are none."""
    event = line(reaction_time=seconds)
    assert [*check_answers(event, given.protocol.answers)] == []
    for impossible in (-1e-9, float("inf"), float("nan")):
        event["response"]["reaction_time"] = impossible
        (found,) = check_answers(event, given.protocol.answers)
        assert found == f"has a reaction time of {impossible} s"


def test_a_form_is_answered_once() -> None:
    """What it asks, each question once, with one of its answers."""
    asked = AnswersSection.model_validate({"keys": {"yes": ["a"], "no": ["b"]}})
    protocol: Any = SimpleNamespace(closing={"dizzy": asked})
    event = {"name": "dizzy", "response": {"answer": "yes", "reaction_time": 1.0}}
    done: set[str] = set()
    assert [*check_form(event, protocol, done)] == []
    assert [*check_form(event, protocol, done)] == ["the form already has an answer to 'dizzy'"]
    assert [*check_form({**event, "name": "hungry"}, protocol, set())] == ["the form has no question 'hungry'"]


def test_numbers_are_listed_to_six_digits() -> None:
    """And words as they are."""
    assert listed((1.23456789, "never", 2)) == "1.23457, never, 2"
