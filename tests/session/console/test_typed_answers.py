"""Answers that the experimenter types at the console, and answers recorded in two lines."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from modaltouch.session.console import OWN_KEYS, Experimenter, Request
from modaltouch.session.console import Console as SilentConsole
from modaltouch.session.console.__main__ import Dialogue, draw_session
from modaltouch.session.console.consoles import EventLines, PlainLines
from modaltouch.session.console.status import Status, typed_keys
from modaltouch.window.interface import Event

TRIAL = {
    "number": 7, "practice": False, "block": 1, "velocity_mm_s": 100.0, "predicted_left_mm_s": 100.0,
    "predicted_right_mm_s": 100.0, "finger_condition": "one_hand", "placement": "normal", "zone_left": "A",
    "zone_right": "C", "finger_left": "right index", "finger_right": "right middle",
}  # fmt: skip

SHOWN = ("left", "both", "right", "none")


def start() -> dict[str, Any]:
    """Return a start record with the members that the console reads."""
    named = {"participant": "p01", "session": 1, "mode": "real", "protocol": "demo", "rig": {"identity": "x"}}
    return {"n": 1, "event": "start", **named, "schedule": {"n_trials": 24}, "clock": 0.0}


def trial(index: int, *, clock: float = 0.0) -> dict[str, Any]:
    """Return a trial event with the members that the console reads."""
    return {
        "n": 10 + index,
        "event": "trial",
        "clock": clock,
        "trial": {"index": index, "practice": False, "block": 1, "condition": {"velocity_mm_s": 100.0}},
        "confirmed": {"confirmed": True},
        "response": {"answer": "both", "reaction_time": 0.9, "onset": "first_burst", "question_after": 0.5},
    }


class Asked(SilentConsole):
    """A console with given requests."""

    def __init__(self, *asked: Request) -> None:
        self.asked = list(asked)

    def requests(self) -> list[Request]:
        asked, self.asked = self.asked, []
        return asked


def draw(facts: dict[str, Any], width: int, height: int) -> str:
    """Return the console's picture as one line of text."""
    file = StringIO()
    console = Console(file=file, width=width, height=height, force_terminal=False)
    console.print(draw_session(facts, "", width=width, height=height))
    return " ".join(file.getvalue().split())


def experimenters(**answers: Any) -> dict[str, Any]:
    """Return a start record of a session whose answers the experimenter types."""
    keys = {"left": ["left", "num_4"], "both": ["up"], "right": ["n", "right"]}
    return {**start(), "design": {"answers": {"given_by": "experimenter", "keys": keys, **answers}}}


def asked(way: str = "experimenter") -> list[dict[str, Any]]:
    """Return the events up to a playing stimulus."""
    firing = {"commanded_amplitude": [1.0, 1.0], "confirmed": False, "reason": ""}
    return [{"event": "trial_next", "trial": {**TRIAL, "way": way}}, {"n": 5, "event": "fired", "confirmed": firing}]


def test_a_letter_is_used_if_all_digits_are_taken() -> None:
    """The first letter that is not a key of the console."""
    assert typed_keys({"aa": ["p"], "bb": list("123456789")}, ("aa", "bb"))["aa"] == ["a"]


def test_answer_keys_do_not_collide_with_the_consoles_keys() -> None:
    """P, R, N, B, Q and X keep their meaning; digits follow the order on the screen."""
    keys = typed_keys({"left": ["p"], "both": ["q"], "right": ["1"], "none": ["x", "num_enter"]}, SHOWN)
    assert keys == {"left": ["5"], "both": ["2"], "right": ["1", "3"], "none": ["4"]}
    own = typed_keys({answer: ["n", "b", "r"] for answer in SHOWN[:3]}, SHOWN[:3])
    assert own == {"left": ["1"], "both": ["2"], "right": ["3"]}


@given(st.permutations(["p", "q", "1", "2", "3", "4", "left", "num_4", "f5", "space"]))
def test_every_answer_has_its_own_keys(names: list[str]) -> None:
    """For any keys of a protocol."""
    given = {answer: names[place : place + 2] for place, answer in enumerate(SHOWN)}
    keys = typed_keys(given, SHOWN)
    typed = [key for named in keys.values() for key in named]
    assert len(typed) == len(set(typed)) and all(keys.values())
    assert not OWN_KEYS.intersection(typed)


def test_the_console_answers_only_during_a_trial() -> None:
    """At other times it says that the key is not accepted; its own keys always work."""
    status, dialogue = Status(), Dialogue()
    for event in (experimenters(), *asked()[:1]):
        status.take(event)
    dialogue.hear(status.facts())
    assert dialogue.press("left") is None
    assert dialogue.prompt == "left is not accepted: no trial is running"
    status.take(asked()[1])
    dialogue.hear(status.facts())
    assert dialogue.press("1") == Request("answer", "1")
    assert dialogue.prompt == "typed: left"
    assert dialogue.press("x") == Request("emergency_stop")
    assert dialogue.press("n") is None
    assert dialogue.prompt.startswith("note")
    assert dialogue.press("1") is None
    assert dialogue.press("escape") is None
    status.take(trial(1))
    dialogue.hear(status.facts())
    assert dialogue.press("1") is None


@pytest.mark.parametrize("way", ["free_hand", "lifting", "foot_switch"])
def test_a_participants_answer_is_not_typed_at_the_console(way: str) -> None:
    """If only one finger condition is answered by the experimenter."""
    status = Status()
    for event in (experimenters(given_by="participant", ways={"two_hands": "experimenter"}), *asked(way)):
        status.take(event)
    assert status.answer_by("1") is None
    for event in asked():
        status.take(event)
    assert status.answer_by("1") == "left"


def test_a_typed_answer_reaches_the_window_with_its_key_and_its_time() -> None:
    """The answer's line records it; a key without a meaning is not forwarded."""
    console, recorded = Asked(Request("answer", "up", 12.5), Request("answer", "8", 12.6)), []
    experimenter = Experimenter(console, lambda event, **facts: recorded.append(event))
    for event in (experimenters(), *asked()):
        experimenter.tell(event)
    assert experimenter.attend() == Event(12.5, "answer", "up", answer="both")
    console.asked = [Request("go_on")]
    assert experimenter.attend() == Event(0.0, "continue")
    assert recorded == ["experimenter"]


def test_keys_typed_together_reach_the_window_one_by_one() -> None:
    """While a screen is being drawn, several keys may arrive; their order is kept."""
    experimenter = Experimenter(Asked(Request("answer", "1", 7.0), Request("answer", "3", 7.1), Request("pause")))
    for event in (experimenters(), *asked()):
        experimenter.tell(event)
    events = [experimenter.attend() for _ in range(4)]
    assert [event and (event.kind, event.key) for event in events] == [
        ("answer", "1"),
        ("answer", "3"),
        ("pause", ""),
        None,
    ]


def test_the_picture_shows_the_answer_keys_during_a_trial() -> None:
    """A key that came too early is reported."""
    status = Status()
    for event in (experimenters(), asked()[0]):
        status.take(event)
    assert "left arrow" not in draw(status.facts(), 100, 30)
    status.take(asked()[1])
    assert "left: left arrow or 4 or 1; both: up arrow or 2; right: right arrow or 3" in draw(status.facts(), 100, 30)
    assert status.take({"n": 6, "event": "discarded", "when": "before the question", "key": "up", "device": "console"})
    assert "up came before the question and does not count" in draw(status.facts(), 100, 30)


def answered_then_confirmed(index: int, *, confirmed: bool = True, **firing: Any) -> list[dict[str, Any]]:
    """Return the two lines of an answer in format 2 of the record."""
    line = {**trial(index, clock=10.0 * index), "n": 10 * index, "event": "answered"}
    after = {**line, "n": 10 * index + 1, "event": "trial", "answered": 10 * index}
    return [
        {**line, "confirmed": {"confirmed": False, "reason": ""}},
        {**after, "confirmed": {"confirmed": confirmed, "reason": "", **firing}},
    ]


def test_an_answer_in_two_lines_is_shown_once() -> None:
    """At its first line; the second adds the confirmation and counts nothing again."""
    status, file = Status(), StringIO()
    lines = PlainLines(file)
    status.take(start())
    for index in (1, 2):
        for event in answered_then_confirmed(index):
            assert status.take(event)
            lines.show(status.facts())
            facts = status.facts()
            n_counted = index - (event["event"] == "answered")  # a further question is still to be answered
            assert (facts["n_answered"], facts["last"]["line"], facts["line"]) == (n_counted, 10 * index, event["n"])
    assert [line[:7] for line in file.getvalue().splitlines()] == ["1 of 24", "2 of 24"]
    assert status._durations == [10.0]
    status.take({"event": "withdrawn", "lines": [21], "reason": "x"})
    assert status.facts()["n_answered"] == 1


def test_an_unconfirmed_answer_does_not_count() -> None:
    """Whether the instrument changed or the session was killed between the two lines."""
    status = Status()
    status.take(start())
    for event in answered_then_confirmed(1, confirmed=False, stalled=True):
        status.take(event)
    assert status.facts()["n_answered"] == 0
    assert "the computer was held up" in status.facts()["generator"]["last_error"]
    status.take(answered_then_confirmed(2)[0])
    assert status.facts()["n_answered"] == 0
    status.take({"event": "resume", "rig": {"identity": "x"}})
    assert status.facts()["n_answered"] == 0


def test_event_lines_have_numbers_and_mark_replays(tmp_path: Path) -> None:
    """The number is that of the log's line; other events have none."""
    path, status = tmp_path / "events.jsonl", Status()
    experimenter = Experimenter(EventLines(path), status=status)
    experimenter.tell(start(), replayed=True)
    experimenter.tell(trial(1), replayed=True)
    experimenter.tell({"n": 12, "event": "resume", "rig": {"identity": "x"}})
    experimenter.tell({"event": "trial_next", "trial": {**TRIAL, "practice": True}})
    told = [json.loads(line) for line in path.read_text().splitlines()]
    assert [(each["event"], each["line"], each["replayed"]) for each in told] == [
        ("start", 1, True),
        ("trial", 11, True),
        ("resume", 12, False),
        ("trial_next", None, False),
    ]


@pytest.mark.parametrize(("reason", "confirmed"), [("", None), ("amplitude off", False)])
def test_a_stimulus_is_not_shown_as_unconfirmed_before_its_end(reason: str, confirmed: bool | None) -> None:
    """Unless there is a reason against it."""
    status = Status()
    status.take({"n": 5, "event": "fired", "confirmed": {**asked()[1]["confirmed"], "reason": reason}})
    assert status.facts()["generator"]["confirmed"] is confirmed
