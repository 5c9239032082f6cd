"""A session interrupted at any moment loses no answer and continues in the same order."""

import json
import signal

import pytest

from modaltouch.record.chain import read_chain
from modaltouch.record.session import read_session

RUN = ("--rig", "simulated", "--answers", "simulated", "--yes")
KILL_POINTS = [(n, seed) for seed, n in enumerate((0, 1, 3, 4, 12, 16, 26))]


@pytest.fixture(scope="module")
def whole(tmp_path_factory, context, protocol_path):
    """The answers of an uninterrupted session."""
    from modaltouch.__main__ import main

    results = tmp_path_factory.mktemp("whole")
    process = context.Process(
        target=main, args=(["run", str(protocol_path), "-p", "p07", *RUN, "--results", str(results)],)
    )
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


@pytest.mark.parametrize(("n_trials", "seed"), [(5, 1), (24, 3)])
def test_a_killed_session_keeps_its_catch_trials(
    tmp_path, kill_after, finish, protocol_path, answers_of, n_trials, seed
):
    """SIGKILL and resume: the same trials and answers, catch trials included."""
    protocol = protocol_path.with_name("with_catch_trials.yaml")

    def log_in(results):
        return results / "simulated" / protocol.stem / "sub-p07/ses-1/beh/session.jsonl"

    words = ("run", protocol, "-p", "p07", *RUN)
    assert finish(*words, "--results", tmp_path / "whole") == 0
    log = kill_after(words, log_in, n_trials, seed)
    assert finish("resume", log.parent) == 0
    assert answers_of(log) == answers_of(log_in(tmp_path / "whole"))
    caught = [answer for _, _, condition, answer in answers_of(log) if condition["velocity_mm_s"] == 0]
    assert caught == ["none"] * 6
    assert finish("verify", log.parent) == 0
    if n_trials == 24:
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


def test_an_existing_session_is_refused_and_kept(tmp_path, finish, protocol_path, log_of):
    """Exit status 4, with the first session unchanged to the byte."""
    words = ("run", protocol_path, "-p", "p07", *RUN, "--results", tmp_path)
    assert finish(*words) == 0
    kept = log_of(tmp_path, "p07").read_bytes()
    assert finish(*words) == 4
    assert log_of(tmp_path, "p07").read_bytes() == kept


def test_resuming_a_complete_session_changes_nothing(tmp_path, finish, protocol_path, log_of):
    """It succeeds and leaves the log unchanged to the byte."""
    assert finish("run", protocol_path, "-p", "p07", *RUN, "--results", tmp_path) == 0
    kept = log_of(tmp_path, "p07").read_bytes()
    assert finish("resume", log_of(tmp_path, "p07").parent) == 0
    assert log_of(tmp_path, "p07").read_bytes() == kept


def test_the_order_depends_on_seed_and_participant(tmp_path, finish, protocol_path, log_of, answers_of):
    """It is a pure function of protocol, participant and seed."""
    for name in ("one", "two"):
        assert finish("run", protocol_path, "-p", "p08", *RUN, "--results", tmp_path / name) == 0
    assert finish("run", protocol_path, "-p", "p09", *RUN, "--results", tmp_path / "one") == 0
    first, second = (answers_of(log_of(tmp_path / name, "p08")) for name in ("one", "two"))
    assert first == second
    assert [each[2] for each in first] != [each[2] for each in answers_of(log_of(tmp_path / "one", "p09"))]


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


def test_the_bids_view_is_valid_after_a_kill(tmp_path, start, kill, protocol_path, log_of, wait_for_trials):
    """Every row of the table is an answer of the log."""
    log = log_of(tmp_path, "p07")
    session = start("run", protocol_path, "-p", "p07", *RUN, "--results", tmp_path)
    wait_for_trials(log, 9)
    kill(session, signal.SIGKILL)
    dataset = log.parents[3]
    assert json.loads((dataset / "dataset_description.json").read_text())["BIDSVersion"] == "1.10.0"
    assert (dataset / "participants.tsv").read_text() == "participant_id\nsub-p07\n"
    table = next(log.parent.glob("*_beh.tsv"))
    header, *rows = [line.split("\t") for line in table.read_text().splitlines()]
    assert all(len(row) == len(header) for row in rows)
    described = json.loads(table.with_suffix(".json").read_text())
    assert set(header) <= set(described)
    answered = [event for event in read_chain(log).events if event["event"] == "trial"]
    assert len(answered) - 1 <= len(rows) <= len(answered)
