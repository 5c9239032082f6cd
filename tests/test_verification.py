"""A session is checked against itself: chain, order, drive and BIDS view, all recomputed."""

import json
import shutil
from pathlib import Path

import pytest

from modaltouch.preflight import examine
from modaltouch.record.chain import GENESIS, encode_line, read_chain
from modaltouch.sitting import begin
from modaltouch.verification import verify_session
from modaltouch.wiring import wire_run

PROTOCOL = Path(__file__).parents[1] / "protocols" / "demo.yaml"


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """The folder of a sound session."""
    setup = wire_run(
        examine(PROTOCOL).require(), "p01", answers="simulated", results=tmp_path_factory.mktemp("results")
    )
    return begin(setup).path.parent


@pytest.fixture
def folder(sound, tmp_path):
    """A copy of it that a test may spoil."""
    return Path(shutil.copytree(sound, tmp_path / "beh"))


def forge(folder, change):
    """Write the log anew with its start record changed and every check made to fit."""
    log = folder / "session.jsonl"
    check, lines = GENESIS, []
    for event in read_chain(log).events:
        if event["event"] == "start":
            change(event)
        line, check = encode_line(event, check)
        lines.append(line)
    log.write_bytes(b"".join(lines))


def test_a_sound_session_passes(folder):
    """Nothing is wrong with what the program itself recorded."""
    verdict = verify_session(folder)
    assert verdict.problems == ()
    assert verdict.lines[-1] == "complete"


def test_lines_removed_from_the_end_are_noticed(folder):
    """The chain alone cannot tell; the BIDS side file knows how far the log had come."""
    log = folder / "session.jsonl"
    log.write_bytes(b"".join(log.read_bytes().splitlines(keepends=True)[:-3]))
    assert any("lines were removed from its end" in problem for problem in verify_session(folder).problems)


def test_a_changed_table_is_noticed(folder):
    """An answer changed in the table, where the eye looks first."""
    table = next(folder.glob("*_beh.tsv"))
    table.write_text(table.read_text().replace("\tboth\t", "\tleft\t", 1))
    assert any("differs from what the log says" in problem for problem in verify_session(folder).problems)


def test_an_order_that_the_seed_does_not_draw_is_noticed(folder):
    """Even in a log whose checks were all made to fit."""
    forge(folder, lambda start: start.update(seed=start["seed"] + 1))
    assert any("draws another order" in problem for problem in verify_session(folder).problems)


def test_a_drive_that_the_apparatus_does_not_give_is_noticed(folder):
    """A gain changed in the recorded apparatus gives other codes than those recorded as played."""

    def change(start):
        apparatus = start["sources"]["apparatus"]
        apparatus["text"] = apparatus["text"].replace("{centre: 114}", "{centre: 115}")

    forge(folder, change)
    assert any("the drive computed again" in problem for problem in verify_session(folder).problems)


def test_the_side_file_carries_the_head_of_the_log(folder):
    """It names the number of lines and the check of the last one."""
    head = json.loads(next(folder.glob("*_beh.json")).read_text())["SessionLog"]
    chain = read_chain(folder / "session.jsonl")
    assert head["lines"] == len(chain.events)
    assert head["check"] == chain.last_check


def test_a_table_newer_than_its_side_file_agrees(folder):
    """A kill between the replacement of the table and that of its side file."""
    (side,) = folder.glob("*_beh.json")
    values = json.loads(side.read_text())
    chain = read_chain(folder / "session.jsonl")
    values["SessionLog"] |= {"lines": 5, "check": chain.checks[4]}
    side.write_text(json.dumps(values))
    verdict = verify_session(folder)
    assert verdict.problems == ()
    assert any(line.startswith("BIDS view agrees: ") for line in verdict.lines)


def test_a_view_behind_its_log_is_said_to_be_behind(folder):
    """After a kill between the log and the table: not an error, and not called up to date either."""
    table = next(folder.glob("*_beh.tsv"))
    chain = read_chain(folder / "session.jsonl")
    n_lines = next(event["n"] for event in chain.events if event["event"] == "trial")
    side = table.with_suffix(".json")
    described = json.loads(side.read_text())
    described["SessionLog"] |= {"lines": n_lines, "check": chain.checks[n_lines - 1]}
    side.write_text(json.dumps(described))
    table.write_text("\n".join(table.read_text().splitlines()[:2]) + "\n")
    verdict = verify_session(folder)
    assert verdict.problems == ()
    assert any("lines behind the log" in line for line in verdict.lines)


def test_a_trial_that_was_repeated_later_does_not_unsettle_the_levels(tmp_path):
    """The level after a trial followed from its first answer, though a second one replaced it afterwards."""
    from dataclasses import replace

    from modaltouch.adaptive import Levels
    from modaltouch.record.session import Session
    from modaltouch.schedule import draw_schedule
    from modaltouch.verification import _check_levels

    experiment = examine(PROTOCOL.with_name("threshold.yaml")).experiment
    levels, order = Levels(experiment.protocol), draw_schedule(experiment.protocol, "p01", 1).trials
    driven = [trial for trial in order if not trial.condition.is_catch][:4]
    start = {"event": "start", "n": 1, "sources": experiment.sources.as_dict()}
    session = Session(tmp_path / "session.jsonl", (start,), ())

    def add(**event):
        return replace(session, events=(*session.events, {"n": len(session.events) + 1, **event}))

    def answer(trial, word):
        return add(event="trial", trial=trial.as_dict(), confirmed={"confirmed": True}, response={"answer": word})

    first = levels.settle(driven[0], session.trials)
    session = answer(first, "right")
    session = answer(levels.settle(driven[1], session.trials), "none")
    session = add(event="withdrawn", lines=[2])
    session = answer(first, "none")
    session = answer(levels.settle(driven[2], session.trials), "right")
    assert [event["n"] for event in session.trials] == [3, 5, 6]
    assert _check_levels(session) == (True, "levels of 3 trials follow from the answers before them")
