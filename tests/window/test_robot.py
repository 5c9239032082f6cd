"""The robot without a display: it repeats missed keys, and only those, for a limited time."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from modaltouch.planning.participant import Participant
from modaltouch.protocol.trial import Condition, Trial
from modaltouch.system.clock import VirtualClock
from modaltouch.window.display_loop import Robot
from modaltouch.window.interface import WindowError
from modaltouch.window.simulated import Answerer

TRIALS = [Trial(index, 1, Condition("one_hand", *pair, 100.0)) for index, pair in enumerate(["AC", "BD", "CE"], 1)]
PRESSES = ["space"] * 2 + ["space", "right", "space", "up", "space", "left"] + ["space"]
"""Two screens of instructions; for each trial a placement and an answer; thanks."""


@pytest.fixture
def robot(experiment: Any) -> Robot:
    """Provide a robot that answers right, both and left, in this order."""
    speeds = {"A": 0.1, "B": 0.15, "C": 0.2, "D": 0.15, "E": 0.1}
    answerer = Answerer(
        Participant(noise=0.0, lapse_rate=0.0, quickest=0.0, decision_time=0.1),
        lambda trial: (speeds[trial.condition.zone_left], speeds[trial.condition.zone_right]),
        np.random.default_rng(1),
    )
    return Robot(answerer, experiment.protocol, patience=0.3)


def deafen(room: Any, misses: Callable[[int], bool]) -> None:
    """Make a window miss some of the presses, by their number from 0."""
    type_key, n_presses = room.display.type_key, 0

    def type_or_miss(key: str, *, down: bool) -> None:
        nonlocal n_presses
        type_key(key, down=down)
        if down:
            if misses(n_presses):
                room.display.events.pop()
            n_presses += 1

    room.display.type_key = type_or_miss


def sit(room: Any, trials: list[Trial] = TRIALS) -> list[str]:
    """Go through a session and return the answers."""
    room.window.welcome(trials[0])
    given = []
    for trial in trials:
        room.window.place_fingers(trial)
        room.window.settle(trial, (trial.index, len(trials)))
        response = room.window.ask(trial, (trial.index, len(trials)), room.present())
        room.window.confirm(response)
        room.window.wait(0.5)
        given.append(response.answer)
    room.window.goodbye()
    return given


def presses(room: Any) -> list[str]:
    """Return the pressed keys in order."""
    return [key for key, down in room.display.typed if down]


def test_only_missed_keys_are_typed_again(paper_room: Callable[..., Any], robot: Robot) -> None:
    """Every other press is lost: each key is typed twice, and no screen gets a key too many."""
    room = paper_room(robot=robot, seconds=60)
    deafen(room, lambda number: number % 2 == 0)
    assert sit(room) == ["right", "both", "left"]
    assert presses(room) == [key for key in PRESSES for _ in range(2)]
    assert room.log == []
    downs = [down for _, down in room.display.typed]
    assert downs == ([True, False] * len(downs))[: len(downs)], "no key goes down twice without coming up"


@pytest.mark.parametrize("seed", range(20))
def test_a_process_that_is_stopped_types_each_key_once(paper_room: Callable[..., Any], robot: Robot, seed: int) -> None:
    """Stalls of 0.8 s between any two steps of the window cause neither repeated nor early presses."""
    rng, clock = random.Random(seed), VirtualClock(100.0)
    room = paper_room(robot=robot, clock=clock, seconds=200)
    stops_at, now = 100.0, clock.now

    def late_now() -> float:
        nonlocal stops_at
        if now() > stops_at:
            stops_at = now() + 0.8 + rng.uniform(0.2, 2.0)
            clock._now += 0.8
        return now()

    clock.now = late_now  # type: ignore[method-assign]
    sit(room)
    assert presses(room) == PRESSES
    assert room.log == []


def test_an_answer_that_is_to_be_confirmed_is_typed_twice(paper_room: Callable[..., Any], robot: Robot) -> None:
    """The second press follows the displayed choice, so that it does not count as a bounce."""
    room = paper_room(robot=robot, answers={"change_until_confirmed": True}, seconds=30)
    assert sit(room, TRIALS[:1]) == ["right"]
    assert presses(room) == ["space", "space", "space", "right", "right", "space"]
    assert room.log == []


@pytest.mark.parametrize(("n_taken", "screen", "key"), [(0, "welcome", "space"), (3, "question_one_hand_AC", "right")])
def test_a_minute_without_progress_ends_the_session(
    paper_room: Callable[..., Any], robot: Robot, n_taken: int, screen: str, key: str
) -> None:
    """The message has the screen that stays and the key that was typed for 60 s."""
    room = paper_room(robot=robot, seconds=200)
    deafen(room, lambda number: number >= n_taken)
    with pytest.raises(
        WindowError, match=f"nothing has moved for 60 s: the screen '{screen}' stays, .* typed '{key}' 60 "
    ):
        sit(room)
    assert presses(room) == PRESSES[:n_taken] + [key] * 60
    assert room.clock.now() - room.shown[-1][1] == pytest.approx(60, abs=1.5)


def test_a_suspended_session_keeps_its_minute(paper_room: Callable[..., Any], robot: Robot) -> None:
    """After Ctrl-Z and `fg` the next press counts, since tries are counted, not time."""
    room = paper_room(robot=robot, seconds=4000)
    deafen(room, lambda number: number == 0)
    room.script = [("welcome", 0.5, lambda: room.clock.sleep(3600))]
    assert sit(room) == ["right", "both", "left"]
    assert presses(room) == ["space", *PRESSES]
