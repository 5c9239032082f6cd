"""The session log: an event is on disk before the session continues, is never overwritten, and survives a cut."""

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
from modaltouch.record.recovery import survey
from modaltouch.record.session import Session, read_session

TRIAL = {"index": 1, "block": 1, "practice": False}


def begin(path, n_trials=1):
    """Return a new log with a start record that `Session` accepts."""
    schedule = {"n_trials": n_trials}
    return SessionLog.create(path, "start", mode="simulated", participant="p01", protocol="x", schedule=schedule)


def test_an_event_is_in_the_file_when_append_returns(tmp_path):
    """A second reader sees the line as soon as append returns."""
    with begin(tmp_path / "a" / "session.jsonl") as log:
        log.append("note")
        assert [event["event"] for event in read_chain(log.path).events] == ["start", "note"]


def test_a_log_is_readable_by_its_owner_only(tmp_path):
    """Participants' answers are personal data: the mode is 0600."""
    with begin(tmp_path / "session.jsonl") as log:
        assert stat.S_IMODE(log.path.stat().st_mode) == 0o600


def test_an_existing_log_is_never_overwritten(tmp_path):
    """A second session with the same id is refused; the message points to resume."""
    begin(tmp_path / "session.jsonl").close()
    with pytest.raises(RecordError, match=r"exists already and is never overwritten.*resume"):
        begin(tmp_path / "session.jsonl")


def test_the_id_of_a_running_session_is_refused(tmp_path):
    """Where two experimenters were both offered p01, the second must choose another participant id."""
    with (
        begin(tmp_path / "session.jsonl"),
        pytest.raises(RecordError, match=r"running this session now.*another participant id"),
    ):
        begin(tmp_path / "session.jsonl")


def test_a_log_appears_only_with_its_first_event(tmp_path):
    """A failure before the first event leaves no file, which could be neither resumed nor started over."""
    with pytest.raises(ValueError, match="Out of range"):
        SessionLog.create(tmp_path / "session.jsonl", "start", seed=float("nan"))
    assert list(tmp_path.iterdir()) == []


def test_two_writers_of_one_log_are_refused(tmp_path):
    """The second process is refused, and its file descriptor is closed."""
    log = begin(tmp_path / "session.jsonl")
    n_open = len(list(Path("/dev/fd").iterdir()))
    with log, pytest.raises(RecordError, match="another process is writing this session"):
        SessionLog.reopen(log.path)
    assert len(list(Path("/dev/fd").iterdir())) == n_open - 1


def test_a_reopened_log_continues_the_chain(tmp_path):
    """Lines written after reopening continue the checksums of those before."""
    path = tmp_path / "session.jsonl"
    begin(path).close()
    with SessionLog.reopen(path) as log:
        log.append("resume")
    chain = read_chain(path)
    assert [event["event"] for event in chain.events] == ["start", "resume"]
    assert chain.problems == ()


@pytest.mark.parametrize("cut", [1, 2, 30])
def test_a_torn_log_is_continued_and_keeps_its_remains(tmp_path, cut):
    """The remains of the cut line stay in the file, and the next line declares them."""
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


@pytest.mark.parametrize("written", [1, 2, 40, 150, 200, -3, -2])
def test_a_line_cut_after_a_cut_line_is_continued(tmp_path, written):
    """A kill may cut the very line that declares the remains of the one before; the next declares both."""
    path = tmp_path / "session.jsonl"
    with begin(path) as log:
        log.append("trial", trial=TRIAL)
    path.write_bytes(path.read_bytes()[:-30])
    for _ in range(2):
        before = len(path.read_bytes())
        with SessionLog.reopen(path) as log:
            log.append("resume")
        data = path.read_bytes()
        path.write_bytes(data[: before + written] if written > 0 else data[:written])
    with SessionLog.reopen(path) as log:
        log.append("resume")
    chain = read_chain(path)
    assert (chain.problems, [event["event"] for event in chain.events]) == ((), ["start", "resume"])
    assert survey(path).is_sound


def test_a_damaged_log_is_not_continued(tmp_path):
    """A changed line is damage and not a cut."""
    path = tmp_path / "session.jsonl"
    with begin(path) as log:
        log.append("trial", trial=TRIAL)
    path.write_bytes(path.read_bytes().replace(b'"start"', b'"stort"'))
    with pytest.raises(RecordError, match="the chain breaks"):
        SessionLog.reopen(path)


@pytest.mark.parametrize("name", ["what remains", "the chain breaks"])
def test_a_cut_log_is_continued_in_a_folder_of_any_name(tmp_path, name):
    """A cut is distinguished from damage by the lines, not by text that the path may contain too."""
    path = tmp_path / name / "session.jsonl"
    with begin(path) as log:
        log.append("trial", trial=TRIAL)
    path.write_bytes(path.read_bytes()[:-9])
    with SessionLog.reopen(path) as log:
        log.append("resume")
    assert [event["event"] for event in read_chain(path).events] == ["start", "resume"]


@pytest.mark.parametrize("rules", ["unix"], indirect=True)
def test_a_deleted_log_is_noticed_at_the_next_event(tmp_path: Path) -> None:
    """An open file outlives its name, except on Windows: everything answered would be gone when the session ends."""
    with SessionLog.create(tmp_path / "session.jsonl", "start") as log:
        log.path.unlink()
        with pytest.raises(RecordError, match=r"session.jsonl: was deleted while the session ran; restore it"):
            log.append("trial")


def test_a_log_without_its_declared_remains_is_not_continued(tmp_path):
    """Removing the remains of a cut line is damage."""
    path = tmp_path / "session.jsonl"
    begin(path).close()
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"n":2,"ti')
    with SessionLog.reopen(path) as log:
        log.append("resume")
    path.write_bytes(path.read_bytes().replace(b'{"n":2,"ti\n', b""))
    with pytest.raises(RecordError, match="declares a cut line, but the remains .* are missing"):
        SessionLog.reopen(path)


def test_a_full_disk_is_reported_and_stops_the_log(tmp_path, monkeypatch):
    """ENOSPC raises a clear error, again at every later append; earlier lines stay valid."""
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
    """SIGKILL at any instant leaves whole lines, and at most part of the line being written.

    Linux copies a line page by page and checks for a fatal signal in between.
    """
    path = tmp_path / "session.jsonl"
    writer = multiprocessing.get_context("fork").Process(target=_append_for_ever, args=(path,))
    writer.start()
    deadline = time.monotonic() + 10
    while not path.exists() or path.stat().st_size < 200:
        assert time.monotonic() < deadline, "the writer did not start"
        time.sleep(0.001)
    time.sleep(delay)
    os.kill(writer.pid, signal.SIGKILL)
    writer.join()
    chain = read_chain(path)
    assert chain.damage == ()
    assert all("the last line was cut while being written" in problem for problem in chain.problems)
    assert [event["n"] for event in chain.events] == list(range(1, len(chain.events) + 1))


@pytest.mark.parametrize(("call", "is_written"), [("fsync", True), ("write", False)])
def test_an_exception_during_a_write_breaks_no_chain(tmp_path, monkeypatch, call, is_written):
    """A signal handler may raise at any instant; the next line continues what is in the file."""

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


def test_an_exception_during_a_partial_write_ends_the_log(tmp_path, monkeypatch):
    """The partial line stays as it is, and the resumed session declares it."""

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
    """The record of a repeated trial supersedes the earlier one, which stays in the file."""
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
    assert counting == session.trials, "the open log and the file read back count the same trials"
    assert session.complete
    assert json.loads(log.path.read_bytes().splitlines()[1])["response"] == {"answer": "left"}


def test_an_exception_between_write_and_bookkeeping_breaks_no_chain(tmp_path, monkeypatch):
    """A second Ctrl-C may interrupt there: the line is on disk, and the next one continues it."""

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


def test_an_event_is_synced_before_append_returns(tmp_path, monkeypatch, rules):
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


def test_every_line_has_its_number_and_both_clocks(tmp_path):
    """Lines count from 1; UTC is in milliseconds, the monotonic clock in microseconds."""
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


def test_temporary_files_of_an_interrupted_view_are_removed(tmp_path):
    """Only the view's temporary files beside the log are removed; they hold answers."""
    path = tmp_path / "session.jsonl"
    begin(path).close()
    (tmp_path / ".table.tsv.123.tmp").touch()
    (tmp_path / "notes.tmp").touch()
    SessionLog.reopen(path).close()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["notes.tmp", "session.jsonl"]


def test_a_missing_log_or_one_without_a_line_is_not_continued(tmp_path):
    """The error gives the file; a refused log is unlocked again."""
    path = tmp_path / "session.jsonl"
    with pytest.raises(RecordError, match=r"session.jsonl: cannot be opened for writing"):
        SessionLog.reopen(path)
    path.write_bytes(b'{"n":1,"ti')
    for _ in range(2):
        with pytest.raises(RecordError, match="contains no complete line: there is nothing to continue"):
            SessionLog.reopen(path)


def test_a_folder_that_cannot_be_created_is_reported(tmp_path):
    """A file occupies the path of the folder; the error points to --results."""
    (tmp_path / "file").touch()
    with pytest.raises(RecordError, match=r"cannot be created .*--results"):
        begin(tmp_path / "file" / "session.jsonl")


def test_a_session_is_identified_by_its_start_record():
    """Without a start record the mode is unknown and the names are empty."""
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


def test_a_session_started_over_gives_its_new_number():
    """The last `closed` event counts; a session without one was not started over."""
    start = {"n": 1, "event": "start"}
    closed = [{"n": n, "event": "closed", "begun_anew_as": n + 1} for n in (2, 3)]
    assert Session(Path("session.jsonl"), (start,)).started_over_as is None
    assert Session(Path("session.jsonl"), (start, closed[0])).started_over_as == 3
    assert Session(Path("session.jsonl"), (start, *closed)).started_over_as == 4


def test_the_reason_for_leaving_out_a_session_is_given():
    """It was started over, or answers are missing and it can be resumed; a complete session has no reason."""
    start = {"n": 1, "event": "start", "schedule": {"n_trials": 1}}
    closed = {"n": 2, "event": "closed", "begun_anew_as": 2}
    trial = {"n": 2, "event": "trial", "trial": TRIAL, "confirmed": {"confirmed": True}}
    path = Path("session.jsonl")
    assert Session(path, (start, closed)).unfit == "closed: started over as session 2"
    said = "incomplete: 0 of 1 trials answered (continue with `modaltouch resume`)"
    assert Session(path, (start,)).unfit == said
    assert Session(path, (start, trial)).unfit == ""


def test_a_running_session_is_reported_as_running(tmp_path):
    """While the log is locked the session is called running; afterwards the message points to resume."""
    path = tmp_path / "session.jsonl"
    with SessionLog.create(path, "start", schedule={"n_trials": 1}):
        assert read_session(path).unfit == "running: 0 of 1 trials answered"
    assert read_session(path).unfit.endswith("(continue with `modaltouch resume`)")


def test_only_confirmed_answers_to_scheduled_trials_complete_a_session():
    """Practice, withdrawn and unconfirmed answers do not count; their trials are asked again."""

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


def test_levels_and_multiples_of_the_threshold_are_paired():
    """Each level has its multiple of the participant's threshold; a record with one missing is refused."""
    start = {"n": 1, "event": "start", "sensation_levels": {"levels_mm_s": [20.0, 40.0], "multiples": [2.0, 4.0]}}
    assert Session(Path("session.jsonl"), (start,)).multiples == {20.0: 2.0, 40.0: 4.0}
    assert Session(Path("session.jsonl"), ({"n": 1, "event": "start"},)).multiples == {}
    start["sensation_levels"]["multiples"].pop()
    with pytest.raises(ValueError, match="shorter"):
        assert Session(Path("session.jsonl"), (start,)).multiples
