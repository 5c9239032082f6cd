"""The simulated participant, without a window."""

from __future__ import annotations

import numpy as np
import pytest

from modaltouch.planning.observer import Observer
from modaltouch.protocol.trial import Condition, Trial
from modaltouch.system.clock import VirtualClock
from modaltouch.window.interface import Presentation
from modaltouch.window.simulated import Answerer, SimulatedParticipant

PROGRESS = (1, 1)


def make_answerer(seed: int = 1) -> Answerer:
    """Return a participant who feels nearly equal speeds, so that the answers are random."""
    participant = Observer().draw(np.random.default_rng(0))
    return Answerer(participant, lambda trial: (0.1, 0.1 * 1.2), np.random.default_rng(seed))


def make_trial(index: int, *, practice: bool = False) -> Trial:
    """Return a trial by its number."""
    return Trial(index, 1, Condition("one_hand", "A", "C", 100.0), practice=practice)


def test_a_resumed_session_gets_the_same_answers() -> None:
    """Answers to trials 11 to 20 do not depend on whether trials 1 to 10 were asked."""
    whole = make_answerer()
    at_once = [whole.answer(make_trial(index)) for index in range(1, 21)]
    resumed = make_answerer()
    assert [resumed.answer(make_trial(index)) for index in range(11, 21)] == at_once[10:]


def test_a_repeated_trial_gets_the_same_answer() -> None:
    """Asking twice advances no shared stream."""
    answerer = make_answerer()
    assert answerer.answer(make_trial(3)) == answerer.answer(make_trial(3))


def test_trials_seeds_and_practice_have_separate_streams() -> None:
    """Their reaction times, which are continuous, all differ."""
    times = {make_answerer(seed).answer(make_trial(index))[1] for seed in (1, 2) for index in range(1, 6)}
    times |= {make_answerer().answer(make_trial(index, practice=True))[1] for index in range(1, 6)}
    assert len(times) == 15


def present(told: list[str], ends: float = 60.0) -> Presentation:
    """Return a stimulus that began at 0 s and notes its stop and end."""
    return Presentation(0.0, ends, lambda: told.append("end"), lambda: told.append("stop"))


def test_the_reaction_time_passes_on_the_clock() -> None:
    """An answer after a second takes a second of virtual time, with ticks, and ends its stimulus."""
    told: list[str] = []
    ticks: list[None] = []
    clock = VirtualClock()
    with SimulatedParticipant(make_answerer(), tick=lambda: ticks.append(None), clock=clock) as window:
        response = window.ask(make_trial(1), PROGRESS, present(told))
        assert clock.now() == pytest.approx(response.reaction_time)
        window.confirm(response)
        window.wait(10.0)
    assert clock.now() == pytest.approx(response.reaction_time + 10.0)
    assert response.reaction_time > 0.3
    assert (response.answered_by, response.device, response.onset) == ("simulated", "model", "first_burst")
    assert told == ["end"]
    assert len(ticks) > 1000 * response.reaction_time


def test_an_unanswered_stimulus_stops_after_its_longest_duration() -> None:
    """The question stays, or the trial times out, as the protocol says."""
    for after_longest, answer in (("ask", "both"), ("time_out", "time_out")):
        told: list[str] = []
        clock = VirtualClock()
        window = SimulatedParticipant(make_answerer(), tick=lambda: None, after_longest=after_longest, clock=clock)
        response = window.ask(make_trial(1), PROGRESS, present(told, ends=0.2))
        assert told == ["stop", "end"]
        assert (response.answer == "time_out") is (answer == "time_out")
        assert clock.now() == pytest.approx(response.reaction_time)
        assert (response.reaction_time == pytest.approx(0.2)) is (answer == "time_out")


def test_the_answer_may_follow_the_end_of_the_stimulus() -> None:
    """The stimulus stops after its last burst, and the reaction time counts from there."""
    told: list[str] = []
    clock = VirtualClock()
    window = SimulatedParticipant(make_answerer(), tick=lambda: None, stimulus_until="question", clock=clock)
    response = window.ask(make_trial(1), PROGRESS, present(told, ends=2.0))
    assert told == ["stop", "end"]
    assert response.onset == "question"
    assert clock.now() == pytest.approx(2.0 + response.reaction_time)


def test_exceptions_of_the_tick_propagate() -> None:
    """A signal ends a simulated session as it ends a real one."""

    def tick() -> None:
        raise KeyboardInterrupt

    window = SimulatedParticipant(make_answerer(), tick=tick, clock=VirtualClock())
    with pytest.raises(KeyboardInterrupt):
        window.ask(make_trial(1), PROGRESS, present([]))
