"""The real window on a virtual display, with keys and clicks injected at the display server."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from modaltouch.planning.participant import Participant
from modaltouch.protocol.trial import Trial
from modaltouch.window.display_loop import Robot
from modaltouch.window.interface import SessionStopped, TrialInterrupted
from modaltouch.window.simulated import Answerer

pytestmark = pytest.mark.window
PROGRESS = (5, 12)
TITLE = "modaltouch under test"


def ask(room: Any, trial: Trial) -> Any:
    """Ask one trial whose stimulus begins now, with its pictures prepared at the placement as in a session."""
    room.window._make_ready(trial)
    return room.window.ask(trial, PROGRESS, room.present())


@pytest.mark.parametrize(
    ("key", "answer"),
    [("Left", "left"), ("Right", "right"), ("Up", "both"), ("Down", "both"), ("KP_4", "left"), ("KP_8", "both")],
)
def test_a_key_of_the_protocol_gives_its_answer(
    room: Callable[..., Any], hands: Any, trial: Trial, key: str, answer: str
) -> None:
    """By `answers.keys` of protocols/demo.yaml."""
    made = room()
    made.script = [("question", 0.1, lambda: hands.key(key))]
    response = ask(made, trial)
    assert (response.answer, response.device, response.answered_by) == (answer, "key", "participant")
    assert len(made.ended) == 1


def test_the_answer_none_is_given_by_key_and_by_click(room: Callable[..., Any], hands: Any, trial: Trial) -> None:
    """By the key of `none` and by a click in the middle of its button."""
    made = room(answers={"keys": {"left": ("left",), "both": ("up",), "right": ("right",), "none": ("down",)}})
    made.script = [("question", 0.1, lambda: hands.key("Down"))]
    response = ask(made, trial)
    assert (response.answer, response.key) == ("none", "down")
    button = made.window._pictures.layout.buttons["none"]
    left, top = hands.origin(TITLE)
    place = left + round(640 + button.x * 800), top + round(400 - button.y * 800)
    made.script = [("question", 0.1, lambda: hands.click(*place))]
    response = ask(made, trial)
    assert (response.answer, response.device) == ("none", "mouse")


def test_reaction_time_runs_from_the_first_burst_to_the_key(room: Callable[..., Any], hands: Any, trial: Trial) -> None:
    """Reference: the time at which the key was injected."""
    made = room()
    made.script = [("question", 0.2, lambda: hands.key("Right"))]
    onset = time.perf_counter()
    response = made.window.ask(trial, PROGRESS, made.present(onset))
    error = response.reaction_time - (hands.pressed[0] - onset)
    assert -0.002 < error < 0.05
    assert response.onset == "first_burst"
    assert response.question_after == pytest.approx(made.shown[1][1] - onset)
    assert made.ended[0] >= onset + response.reaction_time


def test_a_click_on_a_button_answers_and_one_beside_it_does_not(
    room: Callable[..., Any], hands: Any, trial: Trial
) -> None:
    """At the middle button's centre in the layout, 1280 x 800 pixels, y downwards on the display."""
    made = room()
    button = made.window._pictures.layout.buttons["both"]
    left, top = hands.origin(TITLE)
    x, y = left + round(640 + button.x * 800), top + round(400 - button.y * 800)
    made.script = [
        ("question", 0.1, lambda: hands.click(x, top + 400)),
        ("question", 0.15, lambda: hands.click(x, y, button=3)),
        ("question", 0.2, lambda: hands.click(x, y)),
    ]
    response = ask(made, trial)
    assert (response.answer, response.device, response.key) == ("both", "mouse", "both")
    assert [facts["click"] for facts in made.events("ignored")] == [[0.0, 0.0]]


def test_presses_before_the_question_are_discarded_and_logged(
    room: Callable[..., Any], hands: Any, trial: Trial
) -> None:
    """A press before the question never counts."""
    made = room()
    made.script = [
        ("feel", 0.05, lambda: hands.key("Left")),
        ("question", 0.15, lambda: hands.key("Right")),
    ]
    assert ask(made, trial).answer == "right"
    assert [(facts["key"], facts["when"]) for facts in made.events("discarded")] == [("left", "before the question")]


def test_a_key_held_since_before_the_question_does_not_count(
    room: Callable[..., Any], hands: Any, trial: Trial
) -> None:
    """It is discarded once, although X repeats it 25 times a second; the next press counts."""
    made = room()
    made.script = [
        ("feel", 0.02, lambda: hands.key("Left", up=False)),
        ("question", 1.2, lambda: hands.key("Left", down=False)),
        ("question", 1.3, lambda: hands.key("Right")),
    ]
    response = ask(made, trial)
    assert response.answer == "right"
    assert len(made.events("discarded")) == 1
    assert made.events("ignored") == []


def test_a_held_key_released_and_pressed_between_two_polls_counts(
    room: Callable[..., Any], hands: Any, trial: Trial
) -> None:
    """X distinguishes its own repeats from a key that was really released and pressed."""
    made = room()

    def type_at_once() -> None:
        hands.key("Left", down=False)
        hands.key("Left")

    made.script = [("feel", 0.02, lambda: hands.key("Left", up=False)), ("question", 0.8, type_at_once)]
    response = ask(made, trial)
    assert response.answer == "left"
    assert len(made.events("discarded")) == 1


def test_two_keys_at_once_give_the_first_and_flag_the_trial(room: Callable[..., Any], hands: Any, trial: Trial) -> None:
    """The first answer counts; a different one within 50 ms flags the trial."""
    made = room()

    def press_both() -> None:
        hands.key("Left")
        hands.key("Right")

    made.script = [("question", 0.1, press_both)]
    response = ask(made, trial)
    assert (response.answer, response.double) == ("left", True)
    made.window.confirm(response)
    assert [(facts["first"], facts["second"]) for facts in made.events("double")] == [("left", "right")]


def test_escape_stops_the_stimulus_and_space_repeats_the_trial(
    room: Callable[..., Any], hands: Any, trial: Trial
) -> None:
    """The stimulus stops before the pause screen appears."""
    made = room()
    made.script = [("question", 0.1, lambda: hands.key("Escape")), ("pause", 0.4, lambda: hands.key("space"))]
    with pytest.raises(TrialInterrupted, match="escape"):
        ask(made, trial)
    paused = next(when for name, when in made.shown if name == "pause")
    assert made.stopped[0] < paused
    assert [event for event, _ in made.log] == ["pause", "continued"]


def test_q_in_the_pause_ends_the_session(room: Callable[..., Any], hands: Any, trial: Trial) -> None:
    """Escape alone does not."""
    made = room()
    made.script = [("feel", 0.05, lambda: hands.key("Escape")), ("pause", 0.4, lambda: hands.key("q"))]
    with pytest.raises(SessionStopped, match="escape"):
        ask(made, trial)
    assert len(made.stopped) == 1


def test_the_close_button_ends_the_session(room: Callable[..., Any], hands: Any, trial: Trial) -> None:
    """WM_DELETE_WINDOW ends the session immediately; PsychoPy alone only sets a flag."""
    made = room()
    made.script = [("question", 0.1, lambda: hands.press_close_button(TITLE))]
    with pytest.raises(SessionStopped, match="window closed"):
        ask(made, trial)
    assert len(made.stopped) == 1


def test_a_lost_focus_stops_the_stimulus_and_pauses(room: Callable[..., Any], hands: Any, trial: Trial) -> None:
    """Keys typed into another window are ignored; the trial is repeated when the focus returns."""
    made = room()
    hands.take_focus()
    hands.give_focus_back(TITLE)
    time.sleep(0.1)
    made.window._loop.poll_quietly()

    def come_back() -> None:
        hands.give_focus_back(TITLE)
        time.sleep(0.05)
        hands.key("space")

    made.script = [
        ("question", 0.1, hands.take_focus),
        ("pause", 0.3, lambda: hands.key("Left")),
        ("pause", 0.4, come_back),
    ]
    with pytest.raises(TrialInterrupted, match="focus lost"):
        ask(made, trial)
    assert [event for event, _ in made.log] == ["focus_lost", "continued"]
    assert len(made.stopped) == 1


def test_a_robot_answers_by_the_windows_own_event_queue(
    room: Callable[..., Any], experiment: Any, trial: Trial, tmp_path: Path
) -> None:
    """A noiseless observer with twice the speed under the right finger answers right."""
    answerer = Answerer(Participant(noise=0.0, lapse_rate=0.0), lambda _: (0.1, 0.2), np.random.default_rng(1))
    robot = Robot(answerer, experiment.protocol, patience=0.3)
    made = room(robot=robot, screenshots=tmp_path)
    made.window.welcome(trial)
    made.window.place_fingers(trial)
    response = ask(made, trial)
    made.window.confirm(response)
    assert (response.answer, response.answered_by, response.device) == ("right", "simulated", "key")
    assert response.reaction_time > answerer.answer(trial)[1] - 0.001  # a busy machine may only be late
    kept = {path.stem for path in tmp_path.glob("*.png")}
    assert kept == set(made.names)
    with Image.open(tmp_path / "question_one_hand_AC.png") as image:
        assert image.size == (1280, 800)
        button = made.window._pictures.layout.buttons["both"]
        edge = image.getpixel((round(640 + button.left * 800) + 2, round(400 - button.y * 800)))
        assert edge == (0x8B, 0x97, 0xA3)


def test_nothing_is_drawn_while_nothing_changes(room: Callable[..., Any], hands: Any, trial: Trial) -> None:
    """A trial of more than a second needs two pictures, feel and question."""
    made = room()
    made.script = [("question", 1.0, lambda: hands.key("Left"))]
    ask(made, trial)
    assert made.names == ["feel_one_hand_AC", "question_one_hand_AC"]
