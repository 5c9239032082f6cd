"""The window's rules without a window: every screen and every way to end it, in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modaltouch.planning.participant import Participant
from modaltouch.protocol.trial import Condition, Response, Trial
from modaltouch.window.display_loop import DisplayLoop, Robot
from modaltouch.window.interface import Event, EventKind, SessionStopped, TrialInterrupted, WindowError
from modaltouch.window.layout import Picture
from modaltouch.window.simulated import Answerer

PROGRESS = (5, 12)


def send(room: Any, kind: str, key: str = "", x: float = 0.0, y: float = 0.0) -> Callable[[], None]:
    """Return a step that sends an event now."""

    def act() -> None:
        room.display.events.append(Event(room.clock.now(), kind, key, x, y))

    return act


def ask(room: Any, trial: Trial, onset: float | None = None, seconds: float = 60.0) -> Response:
    """Ask one trial whose stimulus begins now and lasts at most some seconds."""
    return room.window.ask(trial, PROGRESS, room.present(onset, seconds))


def test_the_question_comes_after_its_delay(paper_room: Callable[..., Any], trial: Trial) -> None:
    """`answers.question_delay_s`, counted from the onset of the stimulus."""
    room = paper_room(answers={"question_delay_s": 0.2})
    room.script = [("question", 0.05, send(room, "key", "left"))]
    onset = room.clock.now()
    response = ask(room, trial, onset)
    assert room.names[:2] == ["feel_one_hand_AC", "question_one_hand_AC"]
    assert response.question_after == pytest.approx(0.2, abs=0.002)
    assert 0 < response.time_uncertainty < 0.05


def test_whoever_listens_is_told_of_the_question(paper_room: Callable[..., Any], trial: Trial) -> None:
    """Expected: since when it is on the screen."""
    room, told = paper_room(), []
    room.window.on_question = told.append
    room.script = [("question", 0.05, send(room, "key", "left"))]
    ask(room, trial)
    assert told == [room.shown[1][1]]


def test_a_stimulus_that_stops_first_is_stopped_before_the_question(
    paper_room: Callable[..., Any], trial: Trial
) -> None:
    """It stops after `presentation_s`; the reaction time counts from the question."""
    room = paper_room(answers={"stimulus_until": "question", "presentation_s": 0.3, "question_delay_s": 0.1})
    room.script = [("question", 0.1, send(room, "key", "up"))]
    onset = room.clock.now()
    response = ask(room, trial, onset, 0.3)
    asked = room.shown[1][1]
    assert onset + 0.3 <= room.stopped[0] <= asked
    assert room.stopped[0] < onset + 0.302
    assert response.onset == "question"
    assert 0.1 <= response.reaction_time < 0.102


def test_a_question_may_come_later_than_the_stop(paper_room: Callable[..., Any], trial: Trial) -> None:
    """At the later of `presentation_s` and `question_delay_s`."""
    room = paper_room(answers={"stimulus_until": "question", "presentation_s": 0.1, "question_delay_s": 0.3})
    room.script = [("question", 0.02, send(room, "key", "up"))]
    onset = room.clock.now()
    ask(room, trial, onset, 0.1)
    assert room.stopped[0] == pytest.approx(onset + 0.1, abs=0.002)
    assert room.shown[1][1] == pytest.approx(onset + 0.3, abs=0.002)


def test_an_interval_shows_its_number_and_the_gap_the_beam_alone(paper_room: Callable[..., Any], trial: Trial) -> None:
    """Each interval is stopped at its end; the last one leads to the question."""
    room = paper_room(answers={"stimulus_until": "question", "question_delay_s": 0.1})
    room.script = [("question", 0.1, send(room, "key", "up"))]
    onset = room.clock.now()
    room.window.feel(trial, PROGRESS, replace(room.present(onset, 0.3), interval=1), onset + 0.8)
    assert room.names == ["feel_one_hand_AC_1", "ready_one_hand_AC"]
    assert room.stopped == pytest.approx([onset + 0.3], abs=0.002)
    assert room.clock.now() == pytest.approx(onset + 0.8, abs=0.002)
    response = room.window.ask(trial, PROGRESS, replace(room.present(seconds=0.3), interval=2))
    assert room.names[2:] == ["feel_one_hand_AC_2", "question_one_hand_AC"]
    assert response.onset == "question"


@pytest.mark.parametrize("picture", ["feel_one_hand_AC_1", "ready_one_hand_AC"])
def test_a_pause_in_an_interval_or_a_gap_cuts_the_trial(
    paper_room: Callable[..., Any], trial: Trial, picture: str
) -> None:
    """All intervals are repeated; an answer before the question is discarded."""
    room = paper_room(answers={"stimulus_until": "question"})
    steps = [(picture, 0.1, "up"), (picture, 0.15, "escape"), ("pause", 0.3, "space")]
    room.script = [(name, after, send(room, "key", key)) for name, after, key in steps]
    with pytest.raises(TrialInterrupted, match="escape"):
        room.window.feel(trial, PROGRESS, replace(room.present(seconds=0.3), interval=1), room.clock.now() + 0.8)
    assert len(room.stopped) > 0
    assert [facts["when"] for facts in room.events("discarded")] == ["before the question"]


def test_the_longest_stimulus_stops_and_the_question_stays(paper_room: Callable[..., Any], trial: Trial) -> None:
    """Without an answer the stimulus stops once after a second; a later answer still counts."""
    room = paper_room()
    room.script = [("question", 2.0, send(room, "key", "left"))]
    onset = room.clock.now()
    response = ask(room, trial, onset, 1.0)
    assert room.stopped == pytest.approx([onset + 1.0], abs=0.002)
    assert response.answer == "left"
    assert response.reaction_time > 2.0


def test_a_trial_may_end_with_the_longest_stimulus(paper_room: Callable[..., Any], trial: Trial) -> None:
    """`after_longest: time_out`: the outcome is a time-out without a device, and no button is marked."""
    room = paper_room(answers={"after_longest": "time_out"})
    onset = room.clock.now()
    response = ask(room, trial, onset, 1.0)
    assert (response.answer, response.device, response.key) == ("time_out", "none", "")
    assert response.reaction_time == pytest.approx(1.0, abs=0.002)
    room.window.confirm(response)
    assert not any("chosen" in name for name in room.names)
    room.window.wait(1.0)
    assert room.clock.now() == pytest.approx(onset + 2.0, abs=0.01)


@pytest.mark.parametrize("until", ["answer", "question"])
def test_an_answer_may_come_too_late(paper_room: Callable[..., Any], trial: Trial, until: str) -> None:
    """`time_out_s`: the trial ends half a second after the question, whether or not the stimulus still plays."""
    room = paper_room(answers={"stimulus_until": until, "time_out_s": 0.5, "question_delay_s": 0.3})
    room.script = [("question", 0.6, send(room, "key", "left"))]
    onset = room.clock.now()
    response = ask(room, trial, onset, 0.2 if until == "question" else 5.0)
    assert (response.answer, response.device) == ("time_out", "none")
    assert room.clock.now() == pytest.approx(onset + 0.8, abs=0.003)
    assert response.reaction_time == pytest.approx(0.5 if until == "question" else 0.8, abs=0.003)
    assert len(room.stopped) == (until == "question")


def test_no_burst_is_triggered_after_an_answer(paper_room: Callable[..., Any], trial: Trial) -> None:
    """The stimulus ends within a millisecond of the key; the current burst is completed."""
    room = paper_room()
    room.script = [("question", 0.1, send(room, "key", "left"))]
    onset = room.clock.now()
    response = ask(room, trial, onset)
    assert room.ended == pytest.approx([onset + response.reaction_time], abs=0.002)
    assert room.stopped == []


def test_the_second_of_two_answers_in_one_poll_is_the_double(paper_room: Callable[..., Any], trial: Trial) -> None:
    """The first one counts even if both arrive in the same millisecond."""
    room = paper_room()

    def both() -> None:
        send(room, "key", "right")()
        send(room, "key", "up")()

    room.script = [("question", 0.05, both)]
    response = ask(room, trial)
    assert (response.answer, response.double) == ("right", True)
    assert room.events("double") == []
    room.window.confirm(response)
    assert room.events("double")[0]["second"] == "both"


@pytest.mark.parametrize("key", ["left", "num_4"])
def test_the_same_answer_twice_does_not_flag_the_trial(paper_room: Callable[..., Any], trial: Trial, key: str) -> None:
    """A bouncing key and a second key for the same answer are unambiguous."""
    room = paper_room()

    def twice() -> None:
        send(room, "key", "left")()
        send(room, "key", key)()

    room.script = [("question", 0.05, twice)]
    assert not ask(room, trial).double


def test_an_answer_is_returned_despite_a_signal_or_a_closed_window(
    paper_room: Callable[..., Any], trial: Trial
) -> None:
    """A signal and a closed window at that moment take effect afterwards."""
    room = paper_room()

    def answer_and_close() -> None:
        send(room, "key", "left")()
        send(room, "close")()
        room.deadline = 0.0

    room.script = [("question", 0.05, answer_and_close)]
    assert ask(room, trial).answer == "left"
    room.deadline = room.clock.now() + 5
    with pytest.raises(SessionStopped, match="window closed"):
        room.window.wait(1.0)


def test_exceptions_of_the_tick_end_the_question(paper_room: Callable[..., Any], trial: Trial) -> None:
    """A signal during the question ends it with its own exception."""
    room = paper_room()
    room.script = [("question", 0.05, lambda: setattr(room, "deadline", 0.0))]
    with pytest.raises(TimeoutError, match="the window waits"):
        ask(room, trial)


def test_other_keys_are_ignored_and_logged(paper_room: Callable[..., Any], trial: Trial) -> None:
    """X is not an answer key of the demonstration; the position of a click outside the buttons is logged."""
    room = paper_room()
    room.script = [
        ("question", 0.05, send(room, "key", "x")),
        ("question", 0.06, send(room, "click", x=0.1, y=0.3)),
        ("question", 0.1, send(room, "key", "left")),
    ]
    ask(room, trial)
    assert room.events("ignored") == [{"trial": 5, "key": "x"}, {"trial": 5, "click": [0.1, 0.3]}]


@pytest.mark.parametrize(("kind", "reason"), [("key", "escape"), ("blur", "focus lost")])
@pytest.mark.parametrize("screen", ["feel", "question"])
def test_an_interrupted_trial_is_repeated_after_a_pause(
    paper_room: Callable[..., Any], trial: Trial, kind: str, reason: str, screen: str
) -> None:
    """Stop, pause screen, then `pause_s` from the key before the stimulus is repeated."""
    room = paper_room(answers={"pause_s": 0.2})
    room.script = [
        (screen, 0.05, send(room, kind, "escape" if kind == "key" else "")),
        ("pause", 0.3, send(room, "key", "space")),
    ]
    with pytest.raises(TrialInterrupted, match=reason):
        ask(room, trial)
    pressed = room.clock.now()
    room.window.settle(trial, PROGRESS)
    assert len(room.stopped) == 1
    assert room.names[-2:] == ["pause", "ready_one_hand_AC"]
    assert room.clock.now() - pressed == pytest.approx(0.2, abs=0.002)


def intervention(room: Any, what: EventKind | Event) -> Callable[[], None]:
    """Return a step in which the experimenter requests something."""
    return lambda: room.requests.append(what if isinstance(what, Event) else Event(0.0, what))


@pytest.mark.parametrize("screen", ["feel", "question"])
def test_the_experimenter_pauses_and_continues_a_trial(
    paper_room: Callable[..., Any], trial: Trial, screen: str
) -> None:
    """The trial is stopped and repeated, even if continuing is requested immediately."""
    room = paper_room(answers={"pause_s": 0.2})
    room.script = [(screen, 0.05, intervention(room, "pause")), ("pause", 0.0, intervention(room, "continue"))]
    with pytest.raises(TrialInterrupted, match="experimenter"):
        ask(room, trial)
    assert len(room.stopped) == 1
    assert room.log[0] == ("pause", {"trial": trial.index, "by": "experimenter"})
    assert room.log[1][0] == "continued"
    assert room.names[-1] == "pause"


def test_continuing_returns_to_the_paused_screen(paper_room: Callable[..., Any]) -> None:
    """The experimenter's pause on a waiting screen leads back to it."""
    room = paper_room()
    room.script = [
        ("rest", 0.1, intervention(room, "pause")),
        ("pause", 0.1, intervention(room, "continue")),
        ("rest", 0.3, send(room, "key", "space")),
    ]
    room.window.announce("rest", PROGRESS)
    assert room.names == ["rest", "pause_between_trials", "rest"]


@pytest.mark.parametrize("screen", ["feel", "question", "pause", "answered"])
def test_the_emergency_key_ends_the_session_on_every_screen(
    paper_room: Callable[..., Any], trial: Trial, screen: str
) -> None:
    """SessionStopped at the next poll, even while an answer is being processed."""
    room = paper_room(answers={"question_delay_s": 0.05})
    press = send(room, "key", "f12")
    room.script = [("feel", 0.01, press)] if screen == "feel" else [("question", 0.05, press)]
    if screen == "pause":
        room.script = [("question", 0.05, send(room, "key", "escape")), ("pause", 0.05, press)]
    if screen == "answered":
        room.script = [("question", 0.05, lambda: (send(room, "key", "left")(), press())[0])]

    def present() -> None:
        response = ask(room, trial)
        assert screen == "answered", "an answer that came first counts"
        room.window.confirm(response)
        room.window.wait(0.1)

    with pytest.raises(SessionStopped, match="emergency stop"):
        present()


def test_an_early_end_is_shown_briefly(paper_room: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """One screen of text, without ticks, and without an error if the display is gone."""
    room = paper_room(seconds=0.0)
    room.window.dismiss()
    assert room.names == ["session_ended"]
    monkeypatch.setattr(room.display, "flip", lambda screenshot: 1 / 0)
    room.window.dismiss()


def test_a_focus_lost_while_the_fingers_return_pauses_again(paper_room: Callable[..., Any], trial: Trial) -> None:
    """No stimulus starts while the window lacks the keyboard focus."""
    room = paper_room(answers={"pause_s": 0.2})
    room.script = [
        ("question", 0.05, send(room, "key", "escape")),
        ("pause", 0.3, send(room, "key", "space")),
        ("ready", 0.05, send(room, "blur")),
        ("pause", 0.3, send(room, "key", "space")),
    ]
    with pytest.raises(TrialInterrupted, match="escape"):
        ask(room, trial)
    room.window.settle(trial, PROGRESS)
    assert room.names[-3:] == ["ready_one_hand_AC", "pause_between_trials", "ready_one_hand_AC"]
    assert [event for event, _ in room.log] == ["pause", "continued", "focus_lost", "continued"]


def test_a_click_does_not_end_a_pause(paper_room: Callable[..., Any], trial: Trial) -> None:
    """A click only restores the focus; a key continues, once the fingers are in place."""
    room = paper_room(answers={"pause_s": 0.0})
    room.script = [
        ("question", 0.05, send(room, "blur")),
        ("pause", 0.3, send(room, "click")),
        ("pause", 0.4, send(room, "key", "left")),
        ("pause", 0.5, send(room, "key", "enter")),
    ]
    with pytest.raises(TrialInterrupted, match="focus lost"):
        ask(room, trial)
    assert room.clock.now() - room.shown[2][1] >= 0.5


@pytest.mark.parametrize("screen", ["feel", "question", "pause"])
def test_the_close_button_ends_the_session_everywhere(
    paper_room: Callable[..., Any], trial: Trial, screen: str
) -> None:
    """The stimulus is stopped exactly once, then SessionStopped is raised."""
    room = paper_room()
    if screen == "pause":
        room.script = [("question", 0.05, send(room, "key", "escape"))]
    room.script.append((screen, 0.05, send(room, "close")))
    with pytest.raises(SessionStopped, match="window closed"):
        ask(room, trial)
    assert len(room.stopped) == 1
    assert room.events("stopped") == [{"reason": "window closed"}]


def test_instruction_screens_follow_in_order(paper_room: Callable[..., Any], trial: Trial) -> None:
    """Welcome, how to answer, announcement, placement, break; each ended by a key or click."""
    room = paper_room()
    room.script = [
        ("welcome", 0.3, send(room, "key", "space")),
        ("answers", 0.3, send(room, "click", x=0.3, y=0.2)),
        ("practice", 0.3, send(room, "key", "enter")),
        ("place_fingers", 0.3, send(room, "key", "num_enter")),
        ("rest", 0.3, send(room, "key", "space")),
    ]
    room.window.welcome(trial)
    room.window.announce("practice")
    room.window.place_fingers(trial)
    room.window.announce("rest", PROGRESS)
    assert room.names == ["welcome", "answers", "practice", "place_fingers_one_hand_AC", "rest"]


def test_a_press_meant_for_the_last_screen_does_not_skip_the_next(paper_room: Callable[..., Any]) -> None:
    """A second press within a quarter of a second is discarded and logged."""
    room = paper_room()
    room.script = [
        ("rest", 0.02, send(room, "key", "space")),
        ("rest", 0.3, send(room, "key", "w")),
        ("rest", 0.35, send(room, "key", "space")),
    ]
    room.window.announce("rest", PROGRESS)
    assert room.clock.now() - room.shown[0][1] >= 0.35
    assert [event for event, _ in room.log] == ["discarded", "ignored"]


def test_escape_on_a_waiting_screen_opens_the_pause_screen(paper_room: Callable[..., Any]) -> None:
    """Space returns to the previous screen; Q ends the session."""
    room = paper_room()
    room.script = [
        ("rest", 0.3, send(room, "key", "escape")),
        ("pause", 0.3, send(room, "key", "space")),
        ("rest", 0.3, send(room, "key", "escape")),
        ("pause", 0.3, send(room, "key", "q")),
    ]
    with pytest.raises(SessionStopped, match="escape"):
        room.window.announce("rest", PROGRESS)
    assert room.names == ["rest", "pause_between_trials", "rest", "pause_between_trials"]


def test_the_chosen_answer_is_marked_briefly(paper_room: Callable[..., Any], trial: Trial) -> None:
    """Marked immediately; the beam alone 0.4 s after the answer; the pause also counts from the answer."""
    room = paper_room()
    room.script = [
        ("question", 0.05, send(room, "key", "left")),
        ("answered_left", 0.1, send(room, "key", "right")),
    ]
    onset = room.clock.now()
    response = ask(room, trial, onset)
    room.window.confirm(response)
    answered = onset + response.reaction_time
    room.window.wait(0.6)
    assert room.clock.now() - answered == pytest.approx(0.6, abs=0.002)
    assert room.names[-2:] == ["answered_left", "ready_one_hand_AC"]
    assert room.shown[-1][1] - answered == pytest.approx(0.4, abs=0.002)
    assert room.events("discarded")[0]["when"] == "between trials"


def test_goodbye_ends_by_itself_or_by_a_key(paper_room: Callable[..., Any]) -> None:
    """After eight seconds without a key."""
    room = paper_room()
    room.window.goodbye()
    assert room.clock.now() - room.shown[0][1] == pytest.approx(8.0, abs=0.002)
    room = paper_room()
    room.script = [("goodbye", 0.3, send(room, "key", "x"))]
    room.window.goodbye()
    assert room.clock.now() - room.shown[0][1] < 1


def test_an_experimenters_answer_is_recorded_as_such(paper_room: Callable[..., Any], trial: Trial) -> None:
    """In `answered_by`."""
    room = paper_room(answers={"given_by": "experimenter"})
    room.script = [("question", 0.05, send(room, "key", "right"))]
    assert ask(room, trial).answered_by == "experimenter"


def test_an_answer_typed_at_the_console_keeps_its_time(paper_room: Callable[..., Any], trial: Trial) -> None:
    """It has the time of typing, and the window's missing focus causes no pause."""
    room = paper_room(answers={"given_by": "experimenter", "question_delay_s": 0.5})

    def answer() -> None:
        room.requests.append(Event(room.clock.now() - 0.02, "answer", "3", answer="right"))

    room.script = [
        ("feel", 0.1, send(room, "blur")),
        ("feel", 0.2, intervention(room, Event(room.clock.now() + 0.2, "answer", "1", answer="left"))),
        ("question", 0.01, intervention(room, Event(room.clock.now() + 0.4, "answer", "1", answer="left"))),
        ("question", 0.3, answer),
    ]
    response = ask(room, trial)
    assert (response.answer, response.device, response.key) == ("right", "console", "3")
    assert (response.way, response.answered_by) == ("experimenter", "experimenter")
    assert response.reaction_time == pytest.approx(0.5 + 0.3 - 0.02, abs=0.003)
    early = room.events("discarded")
    assert [(each["when"], each["key"], each["device"]) for each in early] == [
        ("before the question", "1", "console")
    ] * 2


def test_keys_are_those_of_the_protocol(paper_room: Callable[..., Any], trial: Trial) -> None:
    """A foot switch that types F1 to F3 answers; the arrow keys then do not."""
    room = paper_room(answers={"keys": {"left": ("f1",), "both": ("f2",), "right": ("F3",)}})
    room.script = [("question", 0.05, send(room, "key", "left")), ("question", 0.1, send(room, "key", "f3"))]
    assert ask(room, trial).answer == "right"


def test_an_answer_may_be_changed_until_it_is_confirmed(paper_room: Callable[..., Any], trial: Trial) -> None:
    """The confirmed answer has the time of its first choice; changes are logged; the stimulus continues."""
    room = paper_room(answers={"change_until_confirmed": True})
    room.script = [
        ("question", 0.1, send(room, "key", "left")),
        ("chosen_left", 0.1, send(room, "key", "right")),
        ("chosen_right", 0.3, send(room, "key", "right")),
    ]
    onset = room.clock.now()
    response = ask(room, trial, onset)
    assert response.answer == "right"
    chosen = next(when for name, when in room.shown if name == "chosen_right")
    assert response.reaction_time == pytest.approx(chosen - onset, abs=0.002)
    assert room.stopped == []
    assert room.ended[0] >= chosen + 0.3
    assert [(facts["first"], facts["to"]) for facts in room.events("changed")] == [("left", "right")]


@pytest.mark.parametrize("after_longest", ["ask", "time_out"])
def test_the_longest_stimulus_stops_while_a_chosen_answer_waits(
    paper_room: Callable[..., Any], trial: Trial, after_longest: str
) -> None:
    """An answer is chosen before the end of the stimulus and confirmed after it; the stimulus stops in time.

    A generator that repeats by its own timer would otherwise play until the confirmation.
    """
    room = paper_room(answers={"change_until_confirmed": True, "after_longest": after_longest})
    room.script = [
        ("question", 0.1, send(room, "key", "left")),
        ("chosen_left", 2.0, send(room, "key", "left")),
    ]
    onset = room.clock.now()
    assert ask(room, trial, onset, 1.0).answer == "left"
    assert room.stopped == pytest.approx([onset + 1.0], abs=0.002)


def test_a_double_click_or_a_bouncing_foot_switch_does_not_confirm(
    paper_room: Callable[..., Any], trial: Trial
) -> None:
    """A second press of the same answer within a quarter of a second is discarded; a later one confirms."""
    room = paper_room(answers={"change_until_confirmed": True})
    room.script = [
        ("question", 0.1, send(room, "key", "left")),
        ("chosen_left", 0.02, send(room, "release", "left")),
        ("chosen_left", 0.03, send(room, "key", "left")),
        ("chosen_left", 0.5, send(room, "key", "right")),
        ("chosen_right", 0.3, send(room, "key", "right")),
    ]
    assert ask(room, trial).answer == "right"
    assert [facts["when"] for facts in room.events("discarded")] == ["as it was chosen"]


def test_by_default_the_first_answer_counts(paper_room: Callable[..., Any], trial: Trial) -> None:
    """No screen asks for a confirmation."""
    room = paper_room()
    room.script = [("question", 0.1, send(room, "key", "left"))]
    ask(room, trial)
    assert not any(name.startswith("chosen") for name in room.names)


@pytest.mark.parametrize(
    ("changes", "finger_condition", "way", "who"),
    [
        ({}, "one_hand", "free_hand", "participant"),
        ({}, "two_hands", "lifting", "participant"),
        ({"ways": {"two_hands": "foot_switch"}}, "two_hands", "foot_switch", "participant"),
        ({"ways": {"two_hands": "experimenter"}}, "two_hands", "experimenter", "experimenter"),
        ({"given_by": "experimenter"}, "one_hand", "experimenter", "experimenter"),
    ],
)
def test_the_way_of_answering_is_recorded(
    paper_room: Callable[..., Any], changes: dict[str, Any], finger_condition: str, way: str, who: str
) -> None:
    """The protocol's way for the finger condition; with both index fingers on the beam, lifting by default."""
    room = paper_room(answers=changes)
    room.script = [("question", 0.05, send(room, "key", "left"))]
    response = ask(room, Trial(1, 1, Condition(finger_condition, "A", "C", 100.0)))
    assert (response.way, response.answered_by) == (way, who)


TWO_HANDS = Trial(1, 1, Condition("two_hands", "A", "C", 100.0))
COUNTDOWN = ["ready_two_hands_AC_3", "ready_two_hands_AC_2", "ready_two_hands_AC_1"]


@pytest.mark.parametrize("screen", ["place_fingers", "start", "rest"])
def test_a_countdown_follows_a_key_pressed_by_a_hand_on_the_beam(paper_room: Callable[..., Any], screen: str) -> None:
    """`settling_s` from the key, after any screen, in three equal steps."""
    room = paper_room(answers={"pause_s": 0.2, "settling_s": 1.5})
    room.script = [(screen, 0.3, send(room, "key", "space"))]
    if screen == "place_fingers":
        room.window.place_fingers(TWO_HANDS)
    elif screen == "start":
        room.window.announce("start")
    else:
        room.window.announce("rest", PROGRESS)
    pressed = room.clock.now()
    room.window.settle(TWO_HANDS, PROGRESS)
    assert room.names[1:] == COUNTDOWN
    assert room.clock.now() - pressed == pytest.approx(1.5, abs=0.003)
    steps = np.diff([when for _, when in room.shown[1:]] + [room.clock.now()])
    assert steps == pytest.approx([0.5] * 3, abs=0.003)
    room.window.settle(TWO_HANDS, PROGRESS)
    assert room.names[1:] == COUNTDOWN, "a hand that is back is not counted again"


def test_a_countdown_follows_an_answer_by_a_hand_on_the_beam(paper_room: Callable[..., Any]) -> None:
    """The mark for 0.4 s, then the countdown; the stimulus 1.5 s after the key."""
    room = paper_room(answers={"pause_s": 1.0, "settling_s": 1.5})
    room.script = [("question", 0.05, send(room, "key", "left"))]
    onset = room.clock.now()
    response = ask(room, TWO_HANDS, onset)
    room.window.confirm(response)
    room.window.wait(1.0)
    assert room.names[-1] == "answered_left"
    room.window.settle(TWO_HANDS, PROGRESS)
    assert room.names[-3:] == COUNTDOWN
    assert room.clock.now() - onset - response.reaction_time == pytest.approx(1.5, abs=0.003)
    assert room.shown[-3][1] - onset - response.reaction_time == pytest.approx(0.4, abs=0.003)


def test_a_paused_countdown_restarts(paper_room: Callable[..., Any]) -> None:
    """From three, counted from the key that ended the pause."""
    room = paper_room(answers={"settling_s": 1.5})
    room.script = [
        ("place_fingers", 0.3, send(room, "key", "space")),
        ("ready_two_hands_AC_2", 0.1, send(room, "blur")),
        ("pause", 0.3, send(room, "key", "space")),
    ]
    room.window.place_fingers(TWO_HANDS)
    room.window.settle(TWO_HANDS, PROGRESS)
    assert room.names[1:] == [*COUNTDOWN[:2], "pause_between_trials", *COUNTDOWN]
    assert room.clock.now() - room.shown[-3][1] == pytest.approx(1.5, abs=0.003)


@pytest.mark.parametrize("way", ["foot_switch", "experimenter"])
def test_hands_that_never_leave_the_beam_need_no_countdown(paper_room: Callable[..., Any], way: str) -> None:
    """Only `pause_s` follows the placement."""
    room = paper_room(answers={"pause_s": 0.2, "ways": {"two_hands": way}})
    room.script = [("place_fingers", 0.3, send(room, "key", "space"))]
    room.window.place_fingers(TWO_HANDS)
    pressed = room.clock.now()
    room.window.settle(TWO_HANDS, PROGRESS)
    assert room.names[1:] == ["ready_two_hands_AC"]
    assert room.clock.now() - pressed == pytest.approx(0.2, abs=0.002)


def test_a_placement_confirmed_by_the_experimenter_needs_no_countdown(paper_room: Callable[..., Any]) -> None:
    """The experimenter at the console has no hand on the beam."""
    room = paper_room(answers={"pause_s": 0.2})
    room.script = [("place_fingers", 0.3, intervention(room, "continue"))]
    room.window.place_fingers(TWO_HANDS)
    room.window.settle(TWO_HANDS, PROGRESS)
    assert room.names[1:] == ["ready_two_hands_AC"]


def test_feedback_is_followed_by_the_countdown(paper_room: Callable[..., Any]) -> None:
    """A lifted finger has the whole settling time after the feedback."""
    room = paper_room(answers={"settling_s": 1.5})
    room.script = [("question", 0.05, send(room, "key", "left"))]
    room.window.give_feedback(ask(room, TWO_HANDS), "right")
    read = room.clock.now()
    room.window.settle(TWO_HANDS, PROGRESS)
    assert room.clock.now() - read == pytest.approx(1.5, abs=0.003)


def test_a_stall_is_shown_before_the_stimulus_is_repeated(paper_room: Callable[..., Any], trial: Trial) -> None:
    """Two seconds of text, then the pause before a stimulus."""
    room = paper_room(answers={"pause_s": 0.2})
    began = room.clock.now()
    room.window.show_stall()
    room.window.settle(trial, PROGRESS)
    assert room.names == ["stalled", "ready_one_hand_AC"]
    assert room.clock.now() - began == pytest.approx(2.2, abs=0.003)


def test_the_window_shows_the_measurement_of_the_beam(paper_room: Callable[..., Any]) -> None:
    """The text "hands off" is confirmed by a key; that about the measurement stays for the given time."""
    room = paper_room()
    room.script = [("hands_off", 0.3, send(room, "key", "space"))]
    room.window.announce("hands_off")
    began = room.clock.now()
    room.window.show_measuring(1.0)
    assert room.names == ["hands_off", "measuring"]
    assert room.clock.now() - began == pytest.approx(1.0, abs=0.003)


def test_feedback_is_shown_for_one_and_a_half_seconds(paper_room: Callable[..., Any], trial: Trial) -> None:
    """Agreement or the expected side; then the session continues by itself."""
    room = paper_room()
    room.script = [("question", 0.05, send(room, "key", "left"))]
    response = ask(room, trial)
    room.window.give_feedback(response, "left")
    room.window.give_feedback(response, "right")
    assert room.names[-2:] == ["feedback_agreed", "feedback_right"]
    assert room.shown[-1][1] - room.shown[-2][1] == pytest.approx(1.5, abs=0.002)


def test_practice_rounds_count_from_one_again(paper_room: Callable[..., Any], experiment: Any) -> None:
    """The second round of one practice trial is again 1 of 1."""
    room = paper_room()
    room.script = [("question", 0.05, send(room, "key", "left"))]
    room.window.ask(
        Trial(2, 0, Condition("one_hand", "A", "C", 100.0), practice=True),
        (2, 12),
        room.present(),
    )
    assert room.window._current[1] == (1, experiment.protocol.schedule.practice_trials)


def test_a_covered_window_is_redrawn_at_most_four_times_a_second(paper_room: Callable[..., Any]) -> None:
    """Expose events a millisecond apart for 0.6 s cause two redraws."""
    room = paper_room()
    display, shown = room.display, []

    def flip(screenshot: Path | None = None) -> float:
        shown.append(room.clock.now())
        return shown[-1]

    display.flip = flip
    uncover = lambda: display.events.append(Event(room.clock.now(), "expose"))  # noqa: E731
    stage = DisplayLoop(
        display,
        tick=uncover,
        log=lambda event, **facts: None,
        screenshots=None,
        clock=room.clock,
    )
    began = stage.show(Picture("any", ()))
    while room.clock.now() < began + 0.6:
        assert stage.poll() == []
    assert len(shown) == 3
    assert stage.show(Picture("any", ())) == began


def test_one_screenshot_is_kept_per_kind_of_picture(
    paper_room: Callable[..., Any], trial: Trial, tmp_path: Path
) -> None:
    """One file each, although each is shown twice."""
    room = paper_room(screenshots=tmp_path / "new")
    for _ in range(2):
        room.script = [("question", 0.05, send(room, "key", "left"))]
        room.window.confirm(ask(room, trial))
    names = {path.name for path in (tmp_path / "new").iterdir()}
    assert names == {"feel_one_hand_AC.png", "question_one_hand_AC.png", "answered_left.png"}


def test_an_impossible_screenshot_folder_is_a_window_error(paper_room: Callable[..., Any], tmp_path: Path) -> None:
    """The message has the folder."""
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(WindowError, match="file/shots for screenshots cannot be made"):
        paper_room(screenshots=tmp_path / "file" / "shots")


def test_a_trials_pictures_are_ready_before_it_begins(paper_room: Callable[..., Any], trial: Trial) -> None:
    """All parts of a trial's pictures, except its progress, are prepared at the placement."""
    room = paper_room()
    room.script = [("place_fingers", 0.3, send(room, "key", "space")), ("question", 0.05, send(room, "key", "up"))]
    room.window.place_fingers(trial)
    prepared = {mark for picture in room.display.prepared for mark in picture.marks}
    question = room.window._pictures.question(trial, PROGRESS)
    assert len([mark for mark in question.marks if mark not in prepared]) <= 2


def test_a_robot_completes_a_session(paper_room: Callable[..., Any], experiment: Any) -> None:
    """It types its observer's answers, as press and release, at the observer's reaction times."""
    person = Participant(noise=0.0, lapse_rate=0.0, quickest=0.0, decision_time=0.1)
    speeds = {"A": 0.1, "B": 0.15, "C": 0.2, "D": 0.15, "E": 0.1}
    answerer = Answerer(
        person,
        lambda trial: (speeds[trial.condition.zone_left], speeds[trial.condition.zone_right]),
        np.random.default_rng(1),
    )
    room = paper_room(robot=Robot(answerer, experiment.protocol, patience=0.3), seconds=20)
    trials = [Trial(index, 1, Condition("one_hand", *pair, 100.0)) for index, pair in enumerate(["AC", "BD", "CE"], 1)]
    room.window.welcome(trials[0])
    given = []
    for trial in trials:
        room.window.place_fingers(trial)
        response = ask(room, trial)
        room.window.confirm(response)
        given.append(response.answer)
    room.window.goodbye()
    assert given == ["right", "both", "left"]
    presses = [key for key, down in room.display.typed if down]
    assert presses == ["space"] * 2 + ["space", "right", "space", "up", "space", "left"] + ["space"]
    assert room.log == []
    assert response.answered_by == "simulated"


def test_closing_closes_the_display(paper_room: Callable[..., Any]) -> None:
    """Leaving the context manager closes it."""
    room = paper_room()
    with room.window as window:
        assert window.describe()["language"] == "English"
    assert not room.display.is_open
