"""The session log: on disk before anything else happens, never overwritten, continued after a cut."""

import json
import multiprocessing
import os
import signal
import stat
import time

import pytest

from modaltouch.record.chain import RecordError, read_chain
from modaltouch.record.log import SessionLog, read_session

TRIAL = {"index": 1, "block": 1, "practice": False}


def begin(path, n_trials=1):
    """Return a new log whose start record `Session` understands."""
    schedule = {"n_trials": n_trials}
    return SessionLog.create(path, "start", mode="simulated", participant="p01", protocol="x", schedule=schedule)


def test_an_event_is_in_the_file_when_append_returns(tmp_path):
    """Append writes through: another reader sees the line at once."""
    with begin(tmp_path / "a" / "session.jsonl") as log:
        log.append("note")
        assert [event["event"] for event in read_chain(log.path).events] == ["start", "note"]


def test_a_log_is_readable_by_its_owner_alone(tmp_path):
    """Participants' answers are personal data."""
    with begin(tmp_path / "session.jsonl") as log:
        assert stat.S_IMODE(log.path.stat().st_mode) == 0o600


def test_an_existing_log_is_never_overwritten(tmp_path):
    """A second session with the same id is refused, and told how to go on."""
    begin(tmp_path / "session.jsonl").close()
    with pytest.raises(RecordError, match=r"exists already and is never overwritten.*resume"):
        begin(tmp_path / "session.jsonl")


def test_a_log_appears_only_with_its_first_event(tmp_path):
    """Whatever cuts the beginning short leaves no session that could neither be resumed nor begun anew."""
    with pytest.raises(ValueError, match="Out of range"):
        SessionLog.create(tmp_path / "session.jsonl", "start", seed=float("nan"))
    assert list(tmp_path.iterdir()) == []


def test_two_writers_of_one_log_are_refused(tmp_path):
    """The second process is told that the first is writing."""
    log = begin(tmp_path / "session.jsonl")
    with log, pytest.raises(RecordError, match="another process is writing this session"):
        SessionLog.reopen(log.path)


def test_a_reopened_log_continues_the_chain(tmp_path):
    """Lines written after a reopening are checked against those before."""
    path = tmp_path / "session.jsonl"
    begin(path).close()
    with SessionLog.reopen(path) as log:
        log.append("resume")
    chain = read_chain(path)
    assert [event["event"] for event in chain.events] == ["start", "resume"]
    assert chain.problems == ()


@pytest.mark.parametrize("cut", [1, 2, 30])
def test_a_torn_log_is_continued_with_its_remains_kept(tmp_path, cut):
    """Nothing is mended silently: the remains stay, and the next line vouches for them."""
    path = tmp_path / "session.jsonl"
    with begin(path) as log:
        log.append("trial", trial=TRIAL)
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    with SessionLog.reopen(path) as log:
        log.append("resume")
    assert path.read_bytes().startswith(whole[:-cut])
    chain = read_chain(path)
    assert chain.problems == ()
    assert [event["event"] for event in chain.events] == (
        ["start", "trial", "resume"] if cut == 1 else ["start", "resume"]
    )


def test_a_damaged_log_is_not_continued(tmp_path):
    """A changed line is damage, not a cut."""
    path = tmp_path / "session.jsonl"
    with begin(path) as log:
        log.append("trial", trial=TRIAL)
    path.write_bytes(path.read_bytes().replace(b'"start"', b'"stort"'))
    with pytest.raises(RecordError, match="the chain breaks"):
        SessionLog.reopen(path)


@pytest.mark.parametrize("name", ["what remains", "the chain breaks"])
def test_a_cut_log_is_continued_whatever_its_folder_is_called(tmp_path, name):
    """Damage is told from a cut by the lines, not by words that a path may hold too."""
    path = tmp_path / name / "session.jsonl"
    with begin(path) as log:
        log.append("trial", trial=TRIAL)
    path.write_bytes(path.read_bytes()[:-9])
    with SessionLog.reopen(path) as log:
        log.append("resume")
    assert [event["event"] for event in read_chain(path).events] == ["start", "resume"]


def test_a_log_that_lost_its_remains_is_not_continued(tmp_path):
    """Somebody tidied the cut line away: that is damage."""
    path = tmp_path / "session.jsonl"
    begin(path).close()
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"n":2,"ti')
    with SessionLog.reopen(path) as log:
        log.append("resume")
    path.write_bytes(path.read_bytes().replace(b'{"n":2,"ti\n', b""))
    with pytest.raises(RecordError, match="remains of a cut line .* are missing"):
        SessionLog.reopen(path)


def test_a_full_disk_is_said_and_the_log_takes_nothing_more(tmp_path, monkeypatch):
    """ENOSPC ends the writing with a clear message; earlier lines are sound."""
    log = begin(tmp_path / "session.jsonl")
    real_write = os.write
    monkeypatch.setattr(os, "write", lambda fd, data: real_write(fd, data[:10]))
    with pytest.raises(RecordError, match="the disk is full"):
        log.append("trial", trial=TRIAL)
    monkeypatch.undo()
    with pytest.raises(RecordError, match="the disk is full"):
        log.append("trial", trial=TRIAL)
    log.close()
    assert [event["event"] for event in read_chain(log.path).events] == ["start"]


def _append_for_ever(path):
    log = begin(path)
    number = 0
    while True:
        number += 1
        log.append("trial", trial={**TRIAL, "index": number})


@pytest.mark.parametrize("delay", [0.02, 0.05, 0.09, 0.14])
def test_a_log_killed_while_writing_is_sound(tmp_path, delay):
    """SIGKILL at any instant leaves whole lines (runners.md, section 8: what no runner states)."""
    path = tmp_path / "session.jsonl"
    writer = multiprocessing.get_context("fork").Process(target=_append_for_ever, args=(path,))
    writer.start()
    deadline = time.monotonic() + 10
    while not path.exists() or path.stat().st_size < 200:
        assert time.monotonic() < deadline, "the writer did not begin"
        time.sleep(0.001)
    time.sleep(delay)
    os.kill(writer.pid, signal.SIGKILL)
    writer.join()
    chain = read_chain(path)
    assert chain.problems == ()
    assert [event["n"] for event in chain.events] == list(range(1, len(chain.events) + 1))


@pytest.mark.parametrize(("call", "is_written"), [("fsync", True), ("write", False)])
def test_an_exception_amid_a_write_breaks_no_chain(tmp_path, monkeypatch, call, is_written):
    """An exception may come out of a signal at any instant: what comes after continues what is in the file."""

    def out_of_nowhere(*arguments):
        monkeypatch.undo()
        raise RuntimeError("out of nowhere")

    log = SessionLog.create(tmp_path / "session.jsonl", "start")
    monkeypatch.setattr(os, call, out_of_nowhere)
    with pytest.raises(RuntimeError, match="out of nowhere"):
        log.append("placement")
    log.append("stop", reason="error")
    log.close()
    chain = read_chain(log.path)
    assert chain.problems == ()
    events = ["start", "placement", "stop"] if is_written else ["start", "stop"]
    assert [event["event"] for event in chain.events] == events == [event["event"] for event in log.events]
    assert [event["n"] for event in chain.events] == list(range(1, len(events) + 1))


def test_an_exception_amid_a_cut_write_ends_the_log(tmp_path, monkeypatch):
    """Half a line stays as it is, and is declared by the session that goes on."""

    def cut_and_raise(descriptor, data):
        monkeypatch.undo()
        os.write(descriptor, data[:9])
        raise RuntimeError("out of nowhere")

    log = SessionLog.create(tmp_path / "session.jsonl", "start")
    monkeypatch.setattr(os, "write", cut_and_raise)
    with pytest.raises(RuntimeError, match="out of nowhere"):
        log.append("placement")
    for _ in range(2):
        with pytest.raises(RecordError, match="cut while being written"):
            log.append("stop", reason="error")
    log.close()
    with SessionLog.reopen(log.path) as again:
        again.append("resume")
    assert read_chain(log.path).problems == ()


def test_a_superseded_trial_does_not_count(tmp_path):
    """A replaced trial is a new record that supersedes; the old one stays in the file."""
    with begin(tmp_path / "session.jsonl") as log:
        old = log.append(
            "trial", trial=TRIAL, response={"answer": "left"}, confirmed={"confirmed": False}, supersedes=None
        )
        log.append(
            "trial", trial=TRIAL, response={"answer": "both"}, confirmed={"confirmed": True}, supersedes=old["n"]
        )
    session = read_session(log.path)
    assert [event["response"]["answer"] for event in session.trials] == ["both"]
    assert session.complete
    assert json.loads(log.path.read_bytes().splitlines()[1])["response"] == {"answer": "left"}


def test_an_exception_between_writing_and_noting_it_breaks_no_chain(tmp_path, monkeypatch):
    """As a second Ctrl-C may come: the line is on the disk, and the next one follows it."""

    class OutOfNowhere(BaseException):
        pass

    def interrupted(descriptor):
        raise OutOfNowhere

    log = SessionLog.create(tmp_path / "session.jsonl", "start")
    with monkeypatch.context() as patch:
        patch.setattr("modaltouch.record.log.os.fsync", interrupted)
        with pytest.raises(OutOfNowhere):
            log.append("trial", answer="left")
    log.append("stop")
    log.close()
    chain = read_chain(tmp_path / "session.jsonl")
    assert chain.problems == ()
    assert [event["event"] for event in chain.events] == ["start", "trial", "stop"]
