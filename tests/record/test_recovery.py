"""What a damaged log still proves, and the new log of it (issue: ``doctor SESSION`` recovers into a new file only)."""

import json
import random

import pytest
from typer.testing import CliRunner

from modaltouch.cli.app import app
from modaltouch.record.chain import RecordError
from modaltouch.record.log import read_session
from modaltouch.record.recovery import recover, survey
from modaltouch.verification import verify_session


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """The bytes of a whole simulated session's log."""
    results = tmp_path_factory.mktemp("sound")
    words = ["run", "protocols/demo.yaml", "-p", "p07", "--answers", "simulated", "--yes", "--results", str(results)]
    ended = CliRunner().invoke(app, words)
    assert ended.exit_code == 0, ended.output
    return next(results.rglob("session.jsonl")).read_bytes()


@pytest.fixture
def damaged(tmp_path, sound):
    """Write a spoilt copy of the log and return its path."""

    def spoil(change):
        path = tmp_path / "session.jsonl"
        path.write_bytes(b"".join(change(sound.splitlines(keepends=True))))
        return path

    return spoil


def answers_of(path):
    """Return (index, answer) of every trial that counts."""
    return [(event["trial"]["index"], event["response"]["answer"]) for event in read_session(path).trials]


def trial_lines(sound):
    """Return where the answers stand in the log, from 0."""
    return [number for number, line in enumerate(sound.splitlines()) if b'"event":"trial"' in line]


def test_a_sound_log_is_said_to_be_sound(damaged):
    """Nothing is left out, nothing is missing."""
    found = survey(damaged(lambda lines: lines))
    assert found.is_sound
    assert found.left_out == ()


def test_a_changed_answer_costs_that_answer_and_no_other(damaged, sound, tmp_path):
    """One byte of one line: the line is left out, kept beside the new log, and all others are recovered."""
    spoilt = trial_lines(sound)[3]

    def change(lines):
        lines[spoilt] = lines[spoilt].replace(b'"answer":"', b'"answer":"x')
        return lines

    path = damaged(change)
    before = path.read_bytes()
    found = survey(path)
    assert [line.number for line in found.left_out] == [spoilt + 1]
    assert found.missing == (spoilt + 1,)
    log = recover(found, tmp_path / "recovered")
    assert path.read_bytes() == before
    assert log.with_name("left_out.txt").read_bytes() == before.splitlines(keepends=True)[spoilt]
    session = read_session(log)
    assert session.problems == ()
    assert len(session.trials) == len(trial_lines(sound)) - 1
    assert session.events[-1]["event"] == "recovered"
    assert session.events[-1]["missing"] == [spoilt + 1]


def test_moved_and_doubled_lines_cost_nothing(damaged, sound, tmp_path):
    """Their own checks tell where they belong."""
    whole = damaged(lambda lines: lines)
    expected = answers_of(whole)

    def change(lines):
        lines[4], lines[9] = lines[9], lines[4]
        return [*lines[:12], lines[6], *lines[12:]]

    found = survey(damaged(change))
    assert found.missing == ()
    assert [line.reason for line in found.left_out] == ["a copy of line 7"]
    log = recover(found, tmp_path / "recovered")
    assert answers_of(log) == expected
    assert verify_session(log).problems == ()


def test_a_removed_line_takes_the_next_along_and_no_more(damaged):
    """Nothing vouches for the line after a gap; the line after that one is vouched for."""
    found = survey(damaged(lambda lines: [*lines[:6], *lines[7:]]))
    assert found.missing == (7, 8)
    assert [line.number for line in found.left_out] == [7]
    assert "cannot be proved" in found.left_out[0].reason


def test_a_log_without_its_start_is_left_as_it_is(damaged, tmp_path):
    """Answers that belong to no known experiment are no data."""
    found = survey(damaged(lambda lines: lines[1:]))
    with pytest.raises(RecordError, match="start record does not prove itself"):
        recover(found, tmp_path / "recovered")
    assert not (tmp_path / "recovered").exists()


def test_nothing_is_recovered_over_another_session(damaged, tmp_path):
    """The new folder may hold sessions already, never the same one."""
    found = survey(damaged(lambda lines: lines[:-3]))
    recover(found, tmp_path / "recovered")
    with pytest.raises(RecordError, match="exists already and is never overwritten"):
        recover(found, tmp_path / "recovered")


@pytest.mark.parametrize("seed", range(40))
def test_whatever_is_recovered_was_written(damaged, sound, tmp_path, seed):
    """Random damage: every recovered answer is one of the original's, in its order, and the new log is sound."""
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
        session = read_session(recover(found, tmp_path / "recovered"))
        assert session.problems == ()


def test_the_command_says_what_can_be_saved_and_saves_it(damaged, tmp_path):
    """Exit status 4 while it is damaged and not recovered; 0 once it is recovered."""
    path = damaged(lambda lines: [*lines[:6], *lines[7:]])
    looked = CliRunner().invoke(app, ["doctor", str(path)])
    assert looked.exit_code == 4
    assert "line 7 is left out" in looked.output
    assert "--into" in looked.output
    saved = CliRunner().invoke(app, ["doctor", str(path), "--into", str(tmp_path / "new"), "--json"])
    assert saved.exit_code == 0
    assert json.loads(saved.output)["missing"] == [7, 8]
    assert next((tmp_path / "new").rglob("*_beh.tsv")).read_text().count("\n") > 1
