"""A session interrupted at any moment loses no answer and continues in the same order."""

import json
import signal

import pytest
from quickly import run

from modaltouch.record.session import read_session

RUN = ("--rig", "simulated", "--answers", "simulated", "--yes")
KILL_POINTS = [(n, seed) for seed, n in enumerate((0, 3, 16))]


@pytest.fixture(scope="module")
def whole(tmp_path_factory, context, protocol_path):
    """The log of an uninterrupted session, under its results folder."""
    results = tmp_path_factory.mktemp("whole")
    words = ["run", str(protocol_path), "-p", "p07", *RUN, "--results", str(results)]
    process = context.Process(target=run, args=(words,))
    process.start()
    process.join(60)
    assert process.exitcode == 0
    return next(results.rglob("session.jsonl"))


@pytest.mark.parametrize(("n_trials", "seed"), KILL_POINTS)
def test_a_killed_session_continues_where_it_stopped(
    whole, kill_after, finish, protocol_path, log_of, answers_of, n_trials, seed
):
    """SIGKILL between or within trials: no answer is lost, and the order is that of an uninterrupted session."""
    words = ("run", protocol_path, "-p", "p07", *RUN)
    log = kill_after(words, lambda results: log_of(results, "p07"), n_trials, seed)
    before = answers_of(log)
    assert len(before) >= n_trials
    assert finish("resume", log.parent) == 0
    assert answers_of(log)[: len(before)] == before
    assert answers_of(log) == answers_of(whole)
    assert finish("verify", log.parent) == 0


def test_a_killed_session_keeps_its_catch_trials(tmp_path, kill_after, finish, protocol_path, answers_of):
    """SIGKILL and resume: the same trials and answers, catch trials included."""
    protocol = protocol_path.with_name("with_catch_trials.yaml")

    def log_in(results):
        return results / "simulated" / protocol.stem / "sub-p07/ses-1/beh/session.jsonl"

    words = ("run", protocol, "-p", "p07", *RUN)
    assert finish(*words, "--results", tmp_path / "whole") == 0
    log = kill_after(words, log_in, 24, seed=3)
    assert finish("resume", log.parent) == 0
    assert answers_of(log) == answers_of(log_in(tmp_path / "whole"))
    caught = [answer for _, _, condition, answer in answers_of(log) if condition["velocity_mm_s"] == 0]
    assert caught == ["none"] * 6
    assert finish("verify", log.parent) == 0
    assert finish("analyse", log.parents[5], "--out", tmp_path / "analysis") == 0
    rates = [
        row for row in json.loads((tmp_path / "analysis" / "tests.json").read_text()) if row["question"] == "catch"
    ]
    assert [row["estimate"] for row in rates[:2]] == [0, 0]
    assert "0 left, 0 right, 0 both, 6 none" in rates[0]["note"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_session_normally(tmp_path, start, kill, protocol_path, log_of, wait_for_trials, number):
    """Exit status 130, the reason in the record, and a BIDS table with every answer."""
    log = log_of(tmp_path, "p07")
    session = start("run", protocol_path, "-p", "p07", *RUN, "--results", tmp_path)
    wait_for_trials(log, 5)
    assert kill(session, number) == 130
    recorded = read_session(log)
    assert recorded.events[-1]["event"] == "stop"
    assert recorded.events[-1]["reason"] == signal.Signals(number).name
    assert recorded.problems == ()
    table = next(log.parent.glob("*_beh.tsv")).read_text().splitlines()
    assert len(table) == 1 + len(recorded.trials)


def test_a_complete_session_is_neither_repeated_nor_changed(whole, finish, protocol_path):
    """Running it again has exit status 4, resuming it succeeds; both leave the log unchanged to the byte."""
    kept = whole.read_bytes()
    assert finish("run", protocol_path, "-p", "p07", *RUN, "--results", whole.parents[5]) == 4
    assert finish("resume", whole.parent) == 0
    assert whole.read_bytes() == kept


def test_a_resumed_session_needs_none_of_its_files(
    tmp_path, start, finish, kill, protocol_path, log_of, wait_for_trials
):
    """The record has protocol, apparatus and texts."""
    import shutil

    copy = tmp_path / "protocols"
    shutil.copytree(protocol_path.parent, copy)
    log = log_of(tmp_path, "p07")
    session = start("run", copy / protocol_path.name, "-p", "p07", *RUN, "--results", tmp_path)
    wait_for_trials(log, 4)
    kill(session, signal.SIGKILL)
    shutil.rmtree(copy)
    assert finish("resume", log.parent) == 0
    assert read_session(log).complete
