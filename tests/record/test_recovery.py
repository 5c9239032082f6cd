"""Recovery of a damaged log: which lines are still proved, and the new log written from them."""

import hashlib
import json
import random
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from modaltouch.cli import app
from modaltouch.record.audit import audit_session
from modaltouch.record.chain import GENESIS, RecordError, encode_line
from modaltouch.record.log import SessionLog
from modaltouch.record.recovery import survey
from modaltouch.record.session import Session, read_session


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """The bytes of the log of a complete simulated session."""
    results = tmp_path_factory.mktemp("sound")
    words = [
        "run",
        "protocols/demo.yaml",
        "-p",
        "p07",
        "--rig",
        "simulated",
        "--answers",
        "simulated",
        "--yes",
        "--results",
        str(results),
    ]
    ended = CliRunner().invoke(app, words)
    assert ended.exit_code == 0, ended.output
    return next(results.rglob("session.jsonl")).read_bytes()


@pytest.fixture
def damaged(tmp_path, sound):
    """Write a damaged copy of the log and return its path."""

    def spoil(change):
        path = tmp_path / "session.jsonl"
        path.write_bytes(b"".join(change(sound.splitlines(keepends=True))))
        return path

    return spoil


def answers_of(path):
    """Return (index, answer) of every trial that counts."""
    return [(event["trial"]["index"], event["response"]["answer"]) for event in read_session(path).trials]


def trial_lines(sound):
    """Return the line numbers of the answers in the log, from 0."""
    return [number for number, line in enumerate(sound.splitlines()) if b'"event":"trial"' in line]


def test_a_sound_log_is_reported_as_sound(damaged):
    """No line is left out and none is missing."""
    found = survey(damaged(lambda lines: lines))
    assert found.is_sound
    assert found.left_out == ()


@pytest.mark.parametrize(
    ("first", "end", "told"),
    [
        (b"", b"\r\n", "every line ends in CR LF"),
        (b"\xef\xbb\xbf", b"\n", "it begins with a byte order mark"),
        (b"\xef\xbb\xbf", b"\r\n", "every line ends in CR LF"),
    ],
)
def test_a_log_with_converted_line_ends_loses_no_answer(damaged, sound, tmp_path, first, end, told):
    """Version control, mail programs and Windows editors convert line ends or add a byte order mark."""
    path = damaged(lambda lines: [first, *(line.replace(b"\n", end) for line in lines)])
    found = survey(path)
    assert not found.is_sound
    assert told in found.lines[-1]
    recovered = found.write(tmp_path / "again")
    assert len(answers_of(recovered)) == len(trial_lines(sound))
    (said,) = read_session(path).chain.damage
    assert f":1: {told}" in said


def test_a_changed_answer_loses_that_answer_only(damaged, sound, tmp_path):
    """With one byte changed, that line is left out and kept beside the new log; all others are recovered."""
    spoilt = trial_lines(sound)[3]

    def change(lines):
        lines[spoilt] = lines[spoilt].replace(b'"answer":"', b'"answer":"x')
        return lines

    path = damaged(change)
    before = path.read_bytes()
    found = survey(path)
    assert [number for number, _, _ in found.left_out] == [spoilt + 1]
    assert found.missing == (spoilt + 1,)
    log = found.write(tmp_path / "recovered")
    assert path.read_bytes() == before
    assert log.with_name("left_out.txt").read_bytes() == before.splitlines(keepends=True)[spoilt]
    session = read_session(log)
    assert session.problems == ()
    # Its answer was recorded before its stimulus was over, and is kept as unconfirmed.
    assert [event["event"] for event in session.trials if not event["confirmed"]["confirmed"]] == ["answered"]
    assert len(session.trials) == len(trial_lines(sound))
    assert session.events[-1]["event"] == "recovered"
    assert session.events[-1]["missing"] == [spoilt + 1]


def test_moved_and_duplicated_lines_lose_nothing(damaged, sound, tmp_path):
    """Their checksums show where they belong."""
    whole = damaged(lambda lines: lines)
    expected = answers_of(whole)

    def change(lines):
        lines[4], lines[9] = lines[9], lines[4]
        return [*lines[:12], lines[6], *lines[12:]]

    found = survey(damaged(change))
    assert found.missing == ()
    assert [reason for _, reason, _ in found.left_out] == ["a copy of line 7"]
    log = found.write(tmp_path / "recovered")
    assert answers_of(log) == expected
    assert audit_session(Session.find(log)).problems == ()


def test_a_removed_line_loses_the_next_one_only(damaged):
    """The line after a gap cannot be verified; the line after that can."""
    found = survey(damaged(lambda lines: [*lines[:6], *lines[7:]]))
    assert found.missing == (7, 8)
    assert [number for number, _, _ in found.left_out] == [7]
    assert "cannot be verified" in found.left_out[0][1]


def test_a_log_without_its_start_record_is_not_recovered(damaged, tmp_path):
    """Without the start record the answers belong to no known experiment."""
    found = survey(damaged(lambda lines: lines[1:]))
    with pytest.raises(RecordError, match="start record is not intact"):
        found.write(tmp_path / "recovered")
    assert not (tmp_path / "recovered").exists()


def test_recovery_does_not_overwrite_a_session(damaged, tmp_path):
    """The new folder may hold other sessions, but not the same one."""
    found = survey(damaged(lambda lines: lines[:-3]))
    found.write(tmp_path / "recovered")
    with pytest.raises(RecordError, match="exists already and is never overwritten"):
        found.write(tmp_path / "recovered")


def test_losses_are_reported_as_text_and_values(damaged, sound):
    """Line numbers count from 1; runs of missing numbers are written as ranges."""
    n_lines, answers = len(sound.splitlines()), len(trial_lines(sound))
    first, *_, last = trial_lines(sound)
    whole = survey(damaged(lambda lines: lines))
    assert whole.lines == [f"{n_lines} lines are intact, including {answers} answers"]
    assert whole.as_dict()["sound"] is True

    def spoil(lines):
        lines[last] = lines[last].replace(b'"answer":"', b'"answer":"x')
        return [*lines[: first - 2], *lines[first:]]  # line `first` has lost its predecessor

    path = damaged(spoil)
    found = survey(path)
    gone = [first - 1, first, first + 1, last + 1]
    assert found.missing == tuple(gone)
    assert found.lines == [
        f"{n_lines - 4} lines are intact, including {answers - 2} answers",
        f"line {first - 1} is left out: it was changed, or the line before it is missing, so it cannot be verified",
        f"line {last - 1} is left out: it was changed, or the line before it is missing, so it cannot be verified",
        f"missing: lines {first - 1} to {first + 1}, {last + 1}",
    ]
    plain = found.as_dict()
    assert plain["session"] == str(path)
    assert (plain["sound"], plain["n_lines"], plain["n_answers"]) == (False, n_lines - 4, answers - 2)
    assert plain["missing"] == gone
    assert [line["line"] for line in plain["left_out"]] == [first - 1, last - 1]
    assert plain["lines"] == found.lines


def test_moved_lines_are_reported(damaged):
    """No line is lost, but the file is not as it was written."""

    def swap(lines):
        lines[4], lines[9] = lines[9], lines[4]
        return lines

    found = survey(damaged(swap))
    assert not found.is_sound
    assert found.lines[1:] == ["lines were moved; their original order is known"]
    assert sorted(found.numbers) == list(range(1, len(found.numbers) + 1))


def test_a_cut_last_line_is_reported_as_cut(damaged, sound):
    """A line without its checksum is left out."""
    found = survey(damaged(lambda lines: [*lines[:-1], lines[-1][:-9]]))
    assert [(number, reason) for number, reason, _ in found.left_out] == [
        (len(sound.splitlines()), "it was cut or its end was changed")
    ]


def test_declared_remains_are_not_a_loss(tmp_path):
    """A cut that the resumed session declared is part of a sound record."""
    path = tmp_path / "session.jsonl"
    with SessionLog.create(path, "start", mode="simulated") as log:
        log.append("note", text="first")
    path.write_bytes(path.read_bytes() + b'{"n":3,"ti')
    with SessionLog.reopen(path) as log:
        log.append("resume")
    found = survey(path)
    assert found.left_out == ()
    assert found.missing == ()
    assert [event["event"] for event in found.events] == ["start", "note", "resume"]


def test_a_replaced_answer_stays_replaced_under_its_new_number(tmp_path, damaged, sound):
    """Line numbers shift when a line is lost, and `supersedes` shifts with them."""
    events = [json.loads(line) for line in sound.splitlines()]
    path = tmp_path / "session.jsonl"
    data, check = b"", GENESIS
    old, new = trial_lines(sound)[0], trial_lines(sound)[1]
    events[new]["trial"], events[new]["supersedes"] = events[old]["trial"], old + 1
    for event in events:
        del event["check"]
        line, check = encode_line(event, check)
        data += line
    lines = data.splitlines(keepends=True)
    path.write_bytes(b"".join([lines[0], *lines[2:]]))  # two lines lost: one removed, the next unproved
    log = survey(path).write(tmp_path / "recovered")
    session = read_session(log)
    assert session.problems == ()
    assert [event["supersedes"] for event in session.events if event.get("supersedes")] == [old - 1]
    assert session.events[old - 2]["trial"] == events[old]["trial"]
    last = session.events[-1]
    assert last["lines"] == [1, *range(4, len(events) + 1)]
    assert last["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    unproved = "it was changed, or the line before it is missing, so it cannot be verified"
    assert last["left_out"] == [{"line": 2, "reason": unproved}]
    assert last["missing"] == [2, 3]
    assert log.with_name("left_out.txt").stat().st_mode & 0o777 == 0o600


def test_a_recovered_adaptive_session_is_valid(tmp_path):
    """The levels after a lost answer do not follow from those that are left, which is no fault of theirs."""
    place = "simulated/threshold/sub-sim01/ses-1/beh"
    folder = shutil.copytree(Path(__file__).parent / "format_1" / place, tmp_path / "damaged" / place)
    log = folder / "session.jsonl"
    lines = log.read_bytes().splitlines(keepends=True)
    lost = next(n for n, line in enumerate(lines) if b'"event":"trial"' in line and b'"practice":false' in line)
    log.write_bytes(b"".join(lines[:lost] + lines[lost + 1 :]))
    recovered = Session.find(survey(log).write(tmp_path / "recovered"))
    assert recovered.n_answered > 0
    assert audit_session(recovered).problems == ()


def test_a_withdrawn_answer_stays_withdrawn_under_its_new_number(tmp_path):
    """Line numbers shift when a line is lost; `withdrawn` still refers to the same answers."""
    path = tmp_path / "session.jsonl"
    start = {"mode": "simulated", "protocol": "demo", "participant": "p07", "session": 1}
    condition = {"finger_condition": "one_hand", "zone_left": "A", "zone_right": "B", "velocity_mm_s": 150}
    response = {"answer": "left", "reaction_time": 0.5}
    with SessionLog.create(path, "start", **start) as log:
        log.append("note", text="lost")
        log.append("note", text="unproved")
        for index in (1, 2):
            trial = {"index": index, "block": 1, "practice": False, "repetition": 1, "condition": condition}
            log.append("trial", trial=trial, response=response, confirmed={"confirmed": True})
        log.append("withdrawn", lines=[3, 4])
        kept = [event["trial"]["index"] for event in log.session.trials]
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([lines[0], *lines[2:]]))
    session = read_session(survey(path).write(tmp_path / "recovered"))
    assert [event["trial"]["index"] for event in session.trials] == kept == [2]
    assert [event["lines"] for event in session.events if event["event"] == "withdrawn"] == [[2]]


def test_a_cut_last_line_is_left_to_resume_even_with_a_full_view(damaged, sound, tmp_path):
    """The view was made from all lines and only the last is cut: no recovery into a new log is needed."""
    log = survey(damaged(lambda lines: lines)).write(tmp_path / "whole")
    log.write_bytes(log.read_bytes()[:-9])
    assert survey(log).is_cut


def test_an_empty_file_proves_nothing(tmp_path):
    """No line is proved, and none is known to be missing."""
    (tmp_path / "session.jsonl").touch()
    found = survey(tmp_path / "session.jsonl")
    assert (found.events, found.left_out, found.missing) == ((), (), ())
    with pytest.raises(RecordError, match="start record is not intact"):
        found.write(tmp_path / "recovered")


@pytest.mark.parametrize("seed", range(40))
def test_every_recovered_answer_was_recorded(damaged, sound, tmp_path, seed):
    """After random damage, recovered answers are a subset of the original's in its order, and the new log is sound."""
    rng = random.Random(seed)

    def change(lines):
        data = bytearray(b"".join(lines))
        for _ in range(rng.randint(1, 5)):
            kind, place = rng.choice(["flip", "cut", "double"]), rng.randrange(len(data) // 4, len(data))
            length = rng.randint(1, 4000)
            if kind == "flip":
                data[place] ^= 1 << rng.randrange(8)
            elif kind == "cut":
                del data[place : place + length]
            else:
                data[place:place] = data[place : place + length]
        return [bytes(data)]

    original = [json.loads(line) for line in sound.splitlines()]
    found = survey(damaged(change))
    assert all(
        {**event, "check": original[event["n"] - 1]["check"]} == original[event["n"] - 1] for event in found.events
    )
    if found.events and found.events[0]["event"] == "start":
        session = read_session(found.write(tmp_path / "recovered"))
        assert session.problems == ()


def test_doctor_reports_and_recovers_a_damaged_log(damaged, tmp_path):
    """Exit status 4 while the log is damaged and not recovered, 0 once it is recovered."""
    path = damaged(lambda lines: [*lines[:6], *lines[7:]])
    looked = CliRunner().invoke(app, ["doctor", str(path)])
    assert looked.exit_code == 4
    assert "line 7 is left out" in looked.output
    assert "--into" in looked.output
    saved = CliRunner().invoke(app, ["doctor", str(path), "--into", str(tmp_path / "new"), "--json"])
    assert saved.exit_code == 0
    assert json.loads(saved.output)["missing"] == [7, 8]
    assert next((tmp_path / "new").rglob("*_beh.tsv")).read_text().count("\n") > 1


def test_lines_lost_from_the_end_are_detected_through_the_view(damaged, sound, tmp_path):
    """A log that ends early is valid by its checksums; its view was made from more lines and gives the missing ones."""
    n_lines = len(sound.splitlines())
    log = survey(damaged(lambda lines: lines)).write(tmp_path / "whole")  # one more line: the note of the recovery
    log.write_bytes(b"".join(sound.splitlines(keepends=True)[:-9]))
    found = survey(log)
    assert found.missing == tuple(range(n_lines - 8, n_lines + 2))
    assert not found.is_sound
    assert not found.is_cut
    assert found.lines[1] == f"missing: lines {n_lines - 8} to {n_lines + 1}"
