"""The session log: on disk before anything else happens, never overwritten, continued after a cut."""

import json
import multiprocessing
import os
import re
import signal
import stat
import time
from pathlib import Path

import pytest

from modaltouch.record.chain import RecordError, read_chain
from modaltouch.record.log import SessionLog
from modaltouch.record.session import Session, read_session

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


def test_a_session_that_is_being_run_is_not_to_be_resumed_beside_itself(tmp_path):
    """Two experimenters who were both proposed p01: the second is told to take another participant id."""
    with (
        begin(tmp_path / "session.jsonl"),
        pytest.raises(RecordError, match=r"running this session now.*another participant id"),
    ):
        begin(tmp_path / "session.jsonl")


def test_a_log_appears_only_with_its_first_event(tmp_path):
    """Whatever cuts the beginning short leaves no session that could neither be resumed nor begun anew."""
    with pytest.raises(ValueError, match="Out of range"):
        SessionLog.create(tmp_path / "session.jsonl", "start", seed=float("nan"))
    assert list(tmp_path.iterdir()) == []


def test_two_writers_of_one_log_are_refused(tmp_path):
    """The second process is told that the first is writing."""
    log = begin(tmp_path / "session.jsonl")
    n_open = len(list(Path("/dev/fd").iterdir()))
    with log, pytest.raises(RecordError, match="another process is writing this session"):
        SessionLog.reopen(log.path)
    assert len(list(Path("/dev/fd").iterdir())) == n_open - 1


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
        assert log.ends_cleanly is False
        log.append("resume")
        assert log.ends_cleanly is True
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
    with pytest.raises(RecordError, match="declares a cut line, but the remains .* are missing"):
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
    """SIGKILL at any instant leaves whole lines and at most the beginning of one whose writing never returned.

    Linux copies a line page by page and looks for a fatal signal in between.
    """
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
    assert chain.damage == ()
    assert all("the last line was cut while being written" in problem for problem in chain.problems)
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
        counting = log.session.trials
    session = read_session(log.path)
    assert [event["response"]["answer"] for event in session.trials] == ["both"]
    assert counting == session.trials, "while it is written as when it is read"
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


def test_an_event_is_synced_before_anybody_hears_of_it(tmp_path, monkeypatch, rules):
    """README: the record is written and synced before the window marks the answer; so is a new file's folder."""
    done = []
    real_write, real_sync = os.write, os.fsync

    def sync(descriptor):
        done.append("folder synced" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file synced")
        real_sync(descriptor)

    def write(descriptor, data):
        done.append("written")
        return real_write(descriptor, data)

    monkeypatch.setattr(os, "write", write)
    monkeypatch.setattr(os, "fsync", sync)
    with begin(tmp_path / "session.jsonl") as log:
        assert done == ["written", "file synced", *(["folder synced"] if rules == "unix" else [])]
        done.clear()
        log.listener = lambda line: done.append("heard")
        log.append("note")
    assert done == ["written", "file synced", "heard"]


def test_every_line_says_its_number_and_both_clocks(tmp_path):
    """Lines count from 1; UTC to the millisecond, the monotonic clock to the microsecond."""
    with begin(tmp_path / "session.jsonl") as log:
        before = time.perf_counter()
        lines = [log.append("note") for _ in range(20)]
        after = time.perf_counter()
    assert [line["n"] for line in lines] == list(range(2, 22))
    assert log.head == {"lines": 21, "check": read_chain(log.path).last_check}
    assert all(line["clock"] == round(line["clock"], 6) for line in lines)
    assert before - 1e-6 <= lines[0]["clock"] <= lines[-1]["clock"] <= after + 1e-6
    assert len({line["clock"] for line in lines}) > 1
    for line in lines:
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}\+00:00", line["time"])
    assert [json.loads(line)["event"] for line in log.path.read_bytes().splitlines()] == ["start"] + ["note"] * 20


def test_what_a_cut_view_left_is_tidied_away(tmp_path):
    """Only temporary files beside the log; they hold answers and belong to nobody."""
    path = tmp_path / "session.jsonl"
    begin(path).close()
    (tmp_path / ".table.tsv.123.tmp").touch()
    (tmp_path / "notes.tmp").touch()
    SessionLog.reopen(path).close()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["notes.tmp", "session.jsonl"]


def test_a_log_that_is_missing_or_holds_no_line_is_not_continued(tmp_path):
    """The message names the file; a refused log can be taken again."""
    path = tmp_path / "session.jsonl"
    with pytest.raises(RecordError, match=r"session.jsonl: cannot be opened for writing"):
        SessionLog.reopen(path)
    path.write_bytes(b'{"n":1,"ti')
    for _ in range(2):
        with pytest.raises(RecordError, match="contains no complete line: there is nothing to continue"):
            SessionLog.reopen(path)


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    """A file stands where the folder should be."""
    (tmp_path / "file").touch()
    with pytest.raises(RecordError, match=r"cannot be created .*--results"):
        begin(tmp_path / "file" / "session.jsonl")


def test_a_session_says_whose_it_is():
    """The start record; of a log that was cut before it, nothing is known."""
    start = {"n": 1, "event": "start", "mode": "pilot", "participant": "p03", "protocol": "demo", "session": 4}
    session = Session(Path("session.jsonl"), (start,))
    assert (session.mode, session.participant, session.protocol, session.drawn_as) == ("pilot", "p03", "demo", 4)
    again = Session(Path("session.jsonl"), ({**start, "schedule": {"seeds": {"session": 2}}},))
    assert again.drawn_as == 2
    for events in ((), ({"n": 1, "event": "note", "mode": "real"},)):
        unknown = Session(Path("session.jsonl"), events)
        assert (unknown.start, unknown.mode, unknown.participant, unknown.protocol) == ({}, "unknown", "", "")
        assert unknown.drawn_as == 1
        assert not unknown.complete


def test_a_session_begun_anew_says_as_which():
    """The last closing counts; a session that may go on has none."""
    start = {"n": 1, "event": "start"}
    closed = [{"n": n, "event": "closed", "begun_anew_as": n + 1} for n in (2, 3)]
    assert Session(Path("session.jsonl"), (start,)).started_over_as is None
    assert Session(Path("session.jsonl"), (start, closed[0])).started_over_as == 3
    assert Session(Path("session.jsonl"), (start, *closed)).started_over_as == 4


def test_why_a_session_is_not_analysed_is_said():
    """One that was begun anew cannot be continued; one that lacks answers can; one that lacks none is used."""
    start = {"n": 1, "event": "start", "schedule": {"n_trials": 1}}
    closed = {"n": 2, "event": "closed", "begun_anew_as": 2}
    trial = {"n": 2, "event": "trial", "trial": TRIAL, "confirmed": {"confirmed": True}}
    path = Path("session.jsonl")
    assert Session(path, (start, closed)).unfit == "closed: started over as session 2"
    said = "incomplete: 0 of 1 trials answered (continue with `modaltouch resume`)"
    assert Session(path, (start,)).unfit == said
    assert Session(path, (start, trial)).unfit == ""


def test_a_running_session_is_not_to_be_resumed(tmp_path):
    """It is left out, and said to run, until its program ends."""
    path = tmp_path / "session.jsonl"
    with SessionLog.create(path, "start", schedule={"n_trials": 1}):
        assert read_session(path).unfit == "running: 0 of 1 trials answered"
    assert read_session(path).unfit.endswith("(continue with `modaltouch resume`)")


def test_only_confirmed_answers_to_scheduled_trials_complete_a_session():
    """Practice, withdrawn and unconfirmed answers do not count; the trials they were for are asked again."""

    def trial(n, index, *, practice=False, confirmed=True):
        said = {"index": index, "block": 1, "practice": practice}
        return {"n": n, "event": "trial", "trial": said, "confirmed": {"confirmed": confirmed}}

    start = {"n": 1, "event": "start", "schedule": {"n_trials": 3}}
    events = (start, trial(2, 1, practice=True), trial(3, 1), trial(4, 2, confirmed=False), trial(5, 3))
    session = Session(Path("session.jsonl"), events)
    assert session.answered == {(True, 1), (False, 1), (False, 3)}
    assert session.n_answered == 2
    assert not session.complete
    assert Session(Path("session.jsonl"), (*events, trial(6, 2))).complete
    withdrawn = Session(Path("session.jsonl"), (*events, trial(6, 2), {"n": 7, "event": "withdrawn", "lines": [3, 5]}))
    assert [event["n"] for event in withdrawn.trials] == [2, 4, 6]
    assert withdrawn.n_answered == 1
    assert not withdrawn.complete


def test_levels_in_multiples_of_the_own_threshold_come_in_pairs():
    """What multiple each level is; a record that lacks one is not read as if it were whole."""
    start = {"n": 1, "event": "start", "sensation_levels": {"levels_mm_s": [20.0, 40.0], "multiples": [2.0, 4.0]}}
    assert Session(Path("session.jsonl"), (start,)).multiples == {20.0: 2.0, 40.0: 4.0}
    assert Session(Path("session.jsonl"), ({"n": 1, "event": "start"},)).multiples == {}
    start["sensation_levels"]["multiples"].pop()
    with pytest.raises(ValueError, match="shorter"):
        assert Session(Path("session.jsonl"), (start,)).multiples
