"""Turns from the records on disk: two simultaneous sessions, and a session interrupted and resumed much later."""

import re
import signal

import pytest

from modaltouch.record.session import read_session

RUN = ("--rig", "simulated", "--answers", "simulated", "--yes")


@pytest.fixture
def balanced(tmp_path, protocol_path):
    """The paper's protocol with turns from the records, and two sessions per participant."""
    import shutil

    shutil.copytree(protocol_path.parent, tmp_path / "protocols")
    file = tmp_path / "protocols" / protocol_path.name
    text = file.read_text()
    file.write_text(re.sub("(?m)^  repetitions: 1$", "  repetitions: 1\n  balance: least_filled\n  sessions: 2", text))
    return file


def test_simultaneous_sessions_get_different_turns(tmp_path, start, balanced, log_of):
    """The first to create its record has the first turn; the other has the second."""
    both = [start("run", balanced, "-p", name, *RUN, "--results", tmp_path) for name in ("anna", "bert")]
    for process in both:
        process.join(60)
        assert process.exitcode == 0
    starts = [read_session(log_of(tmp_path, name)).start for name in ("anna", "bert")]
    assert sorted(each["balance"]["turn"] for each in starts) == [0, 1]
    assert {each["schedule"]["finger_conditions"][0] for each in starts} == {"one_hand", "two_hands"}
    assert starts[0]["schedule"]["finger_conditions_by"] == "least filled in the records"


def test_an_interrupted_session_keeps_its_turn(tmp_path, start, finish, kill, balanced, log_of, wait_for_trials):
    """Killed, its turn given to another, then resumed: the order comes from its own record."""
    cut = start("run", balanced, "-p", "anna", *RUN, "--results", tmp_path)
    log = log_of(tmp_path, "anna")
    wait_for_trials(log, 7)
    kill(cut, signal.SIGKILL)
    for name in ("bert", "carl"):
        assert finish("run", balanced, "-p", name, *RUN, "--results", tmp_path) == 0
    turns = {name: read_session(log_of(tmp_path, name)).start["balance"]["turn"] for name in ("anna", "bert", "carl")}
    assert turns == {"anna": 0, "bert": 1, "carl": 0}
    # Until the first session is complete there is no second.
    assert finish("run", balanced, "-p", "anna", *RUN, "--results", tmp_path) == 4
    assert finish("resume", log.parent) == 0
    assert finish("verify", log.parent) == 0
    assert finish("run", balanced, "-p", "anna", *RUN, "--results", tmp_path) == 0
    second = read_session(log_of(tmp_path, "anna", 2))
    assert second.complete
    assert second.start["balance"]["reason"] == "the participant's earlier sessions"
    assert second.start["schedule"]["turn"] == 1
    assert finish("run", balanced, "-p", "anna", *RUN, "--results", tmp_path) == 4
