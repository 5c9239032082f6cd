"""A wrong stimulus is never recorded as confirmed."""

import json
from dataclasses import replace

import numpy as np
import pytest

from modaltouch.planning.observer import Observer
from modaltouch.preflight import examine
from modaltouch.record.chain import read_chain
from modaltouch.record.session import read_session
from modaltouch.rig import Generator
from modaltouch.rig.interface import RigError
from modaltouch.rig.simulator import Simulator
from modaltouch.session.resumption import resume
from modaltouch.session.setup import begin
from modaltouch.session.wiring import wire_run
from modaltouch.window.simulated import Answerer, SimulatedParticipant


class Hurried(Answerer):
    """Answers twenty times as fast as the model."""

    def answer(self, trial):
        given, reaction_time = super().answer(trial)
        return given, reaction_time / 20


def answers_to(run, index):
    """Events of the answers to a main trial."""
    lines = run.place.log.read_text("utf-8").splitlines()
    events = [event for event in map(json.loads, lines) if event["event"] == "trial"]
    return [event for event in events if event["trial"]["index"] == index and not event["trial"]["practice"]]


def n_marked(answers):
    """Number of answers that are unconfirmed because of the knob."""
    return sum("SOUR1:VOLT reads" in event["confirmed"].get("reason", "") for event in answers)


@pytest.fixture
def setup(tmp_path, edit):
    """A session on a simulator at which a knob is turned in trial 3, until `times` answers are marked for it."""
    at_once = ("\nanswers:\n", "\nanswers:\n  pause_s: 0.0\n  settling_s: 0.0\n")
    preflight = examine(edit("demo.yaml", at_once)).require()
    simulator = Simulator(preflight.experiment.apparatus)

    def make(times, trial_index=3):
        def felt(trial):
            # A stalled machine may spoil a presentation, so those marked for the knob are counted.
            if not trial.practice and trial.index == trial_index and n_marked(answers_to(run, trial_index)) < times:
                simulator.front_panel("SOUR1:VOLT 1.0VPP")
            return 0.2, 0.1

        answerer = Hurried(Observer().draw(np.random.default_rng(1)), felt, np.random.default_rng(2))
        run = replace(
            wire_run(preflight, "p01", answers="simulated", results=tmp_path),
            open_rig=lambda log: Generator(simulator.address, preflight.experiment.apparatus, log=log),
            open_window=lambda tick, log: SimulatedParticipant(answerer, tick=tick),
        )
        return run

    yield make
    simulator.close()


def test_a_trial_with_a_changed_setting_is_repeated(setup):
    """A knob turned at the front panel during trial 3: its answer is kept as unconfirmed and superseded."""
    run = setup(1)
    session = begin(run)
    assert session.complete
    *before, last = answers_to(run, 3)
    assert n_marked(before) == 1
    assert [event["confirmed"]["confirmed"] for event in (*before, last)] == [False] * len(before) + [True]
    assert last["supersedes"] == before[-1]["n"]
    counted = {event["n"] for event in session.trials}
    assert last["n"] in counted
    assert not counted & {event["n"] for event in before}


def test_a_setting_that_always_changes_ends_the_session(setup):
    """After three presentations; the resumed session repeats the trial and supersedes the last attempt."""
    # As often as it takes: a stall of the machine uses up none of the three.
    made = setup(1000)
    with pytest.raises(RigError, match=r"trial 3: 3 presentations could not be confirmed .SOUR1:VOLT reads"):
        begin(made)
    log = made.place.log
    cut = read_session(log)
    assert (False, 3) not in cut.answered
    assert cut.events[-1]["reason"] == "rig fault"
    session = resume(setup(0))
    assert session.complete
    assert read_chain(log).problems == ()
    third = [e for e in session.trials if e["trial"]["index"] == 3 and not e["trial"]["practice"]]
    assert [event["confirmed"]["confirmed"] for event in third] == [True]
