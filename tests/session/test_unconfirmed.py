"""No wrong stimulus is ever recorded as right."""

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
    """Answers twenty times sooner than the model has it."""

    def answer(self, trial):
        given, reaction_time = super().answer(trial)
        return given, reaction_time / 20


@pytest.fixture
def setup(tmp_path, edit):
    """A session on a simulator at which somebody turns knobs while trials run: ``setup(times)``."""
    at_once = ("\nanswers:\n", "\nanswers:\n  pause_s: 0.0\n  settling_s: 0.0\n")
    preflight = examine(edit("demo.yaml", at_once)).require()
    simulator = Simulator(preflight.experiment.apparatus)

    def make(times, trial_index=3):
        left = [times]

        def felt(trial):
            if not trial.practice and trial.index == trial_index and left[0]:
                left[0] -= 1
                simulator.front_panel("SOUR1:VOLT 1.0VPP")
            return 0.2, 0.1

        answerer = Hurried(Observer().draw(np.random.default_rng(1)), felt, np.random.default_rng(2))
        return replace(
            wire_run(preflight, "p01", answers="simulated", results=tmp_path),
            open_rig=lambda log: Generator(simulator.address, preflight.experiment.apparatus, log=log),
            open_window=lambda tick, log: SimulatedParticipant(answerer, tick=tick),
        )

    yield make
    simulator.close()


def test_a_trial_whose_setting_changed_is_marked_and_offered_again(setup):
    """A knob turned at the front panel during trial 3: its answer is kept as unconfirmed and superseded."""
    session = begin(setup(1))
    assert session.complete
    third = [
        e for e in session.events if e["event"] == "trial" and e["trial"]["index"] == 3 and not e["trial"]["practice"]
    ]
    assert [event["confirmed"]["confirmed"] for event in third] == [False, True]
    assert third[1]["supersedes"] == third[0]["n"]
    assert third[1] in session.trials
    assert third[0] not in session.trials


def test_a_setting_that_changes_every_time_ends_the_session_and_resume_offers_the_trial_again(setup):
    """After three presentations the session ends; the resumed one takes the trial up and supersedes the last try."""
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
