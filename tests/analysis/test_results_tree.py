from __future__ import annotations

import gc
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.reading import read_responses
from modaltouch.document import InputError
from modaltouch.record.log import SessionLog

Write = Callable[..., Path]


@pytest.fixture
def record(tmp_path: Path, build: dict[str, Any]) -> Write:
    """Write a session log as a sitting does, from the synthetic answers of one participant."""

    def write(
        participant: str = "p01",
        *,
        mode: str = "real",
        protocol: str = "touch",
        session: int = 1,
        n_answered: int | None = None,
        placement: str = "normal",
        keep: Callable[[dict[str, Any]], bool] = lambda row: True,
    ) -> Path:
        rows = [row for row in build["paper"]() if row["participant"] == "p01" and keep(row)]
        root = tmp_path / "results" if mode == "real" else tmp_path / "results" / mode
        path = root / protocol / f"sub-{participant}" / f"ses-{session}" / "beh" / "session.jsonl"
        start = {
            "mode": mode, "participant": participant, "session": session, "protocol": protocol,
            "schedule": {"n_trials": len(rows)}, "design": {"stimulus": {"focus": "C", "repetition_rate_Hz": 7.0}},
            "rig": {"identity": "TEKTRONIX,AFG3022B"}, "seed": 1,
        }  # fmt: skip
        with SessionLog.create(path, "start", **start) as log:
            log.append("trial", **trial(0, {**rows[0], "response": "left"}, practice=True))
            for index, row in enumerate(rows[:n_answered], 1):
                log.append("trial", **trial(index, row, placement=placement))
        return path

    return write


def trial(index: int, row: dict[str, Any], *, practice: bool = False, placement: str = "normal") -> dict[str, Any]:
    """Return the facts of one answered trial, as `session.write_down` records them."""
    zones, response, speeds = (row["zone_left"], row["zone_right"]), row["response"], [40.0, 80.0]
    if placement.startswith("mirrored"):
        zones, speeds = zones[::-1], speeds[::-1]
        response = {"left": "right", "right": "left"}.get(response, response)
    condition = {
        "finger_condition": row["finger_condition"], "zone_left": zones[0], "zone_right": zones[1],
        "velocity_mm_s": float(row["velocity_mm_s"]), "placement": placement,
    }  # fmt: skip
    return {
        "trial": {"index": index, "block": 1, "condition": condition, "repetition": 1, "practice": practice},
        "planned": {"speed_left_mm_s": speeds[0], "speed_right_mm_s": speeds[1]},
        "commanded": {"amplitude_Vpp": [1.0, 2.0]},
        "confirmed": {"confirmed": True, "confirmed_amplitude": [1.0, 2.0]},
        "response": {"answer": response, "reaction_time": 0.8, "onset": "first_burst", "answered_by": "participant"},
        "supersedes": None,
    }


def reasons(responses) -> dict[str, str]:
    """Return why each session stays out, by participant folder."""
    return {Path(item.source).parts[-3]: item.reason for item in responses.left_out}


def test_complete_sessions_are_read_without_their_practice(record, tmp_path) -> None:
    """Two synthetic sessions of 24 answers and one practice trial each."""
    record("p01"), record("p02")
    responses = read_responses(tmp_path / "results")
    assert len(responses.frame) == 48
    assert responses.source.mode == "real"
    assert responses.focus == "C"
    assert responses.left_out == ()


@pytest.mark.parametrize("depth", [0, 1, 2, 3, 5])
def test_any_folder_of_the_tree_or_the_log_itself_can_be_given(record, tmp_path, depth) -> None:
    """From the results down to the session's log."""
    path = record("p01")
    chain = [path, *path.parents][:7]
    assert len(read_responses(chain[depth]).frame) == 24


def test_a_superseded_answer_does_not_count(record, tmp_path, build) -> None:
    """A repeated trial replaces the record it names, nothing is rewritten."""
    path = record("p01")
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    old = lines[2]
    with SessionLog.reopen(path) as log:
        facts = {key: old[key] for key in ("trial", "planned", "commanded", "confirmed", "response")}
        log.append("trial", **{**facts, "response": {**old["response"], "answer": "both"}}, supersedes=old["n"])
    frame = read_responses(path).frame
    assert len(frame) == 24
    assert frame[frame["trial"] == 1]["response"].tolist() == ["both"]


def test_what_stays_out_is_named_with_its_reason(record, tmp_path) -> None:
    """Incomplete, damaged, pilot and simulated sessions beside a sound one."""
    record("p01")
    record("p02", n_answered=20)
    damaged = record("p03")
    damaged.write_bytes(damaged.read_bytes().replace(b'"left"', b'"both"', 1))
    record("p04", mode="pilot"), record("p05", mode="simulated")
    with SessionLog.reopen(record("p06", n_answered=3)) as log:
        log.append("closed", begun_anew_as=2)
    responses = read_responses(tmp_path / "results")
    told = reasons(responses)
    assert set(responses.frame["participant"]) == {"p01"}
    assert told["sub-p02"] == "incomplete: 20 of 24 trials answered (go on with `modaltouch resume`)"
    assert told["sub-p03"].startswith("damaged: ")
    assert told["sub-p04"].startswith("pilot, not real")
    assert told["sub-p05"].startswith("simulated, not real")
    assert told["sub-p06"] == "closed: begun anew as session 2"


def test_a_chosen_mode_leaves_the_others_out(record, tmp_path) -> None:
    """Mode simulated with a real session beside."""
    record("p01"), record("p02", mode="simulated")
    responses = read_responses(tmp_path / "results", mode="simulated")
    assert set(responses.frame["participant"]) == {"p02"}
    assert responses.source.mode == "simulated"
    assert reasons(responses) == {"sub-p01": "real, not simulated (choose with --mode real)"}


@pytest.mark.parametrize(
    ("sessions", "mode", "words"),
    [
        ([{"mode": "pilot"}, {"mode": "simulated"}], None, r"several modes \(1 pilot, 1 simulated\).*--mode"),
        ([{"protocol": "one"}, {"protocol": "two"}], None, r"several protocols \(1 of 'one', 1 of 'two'\)"),
        ([{}, {"keep": lambda row: row["velocity_mm_s"] < 200}], None, "answered different conditions"),
        ([{"n_answered": 3}], None, r"no session that can be analysed \(1 incomplete: 3 of 24"),
        ([{}], "virtual", r"mode 'virtual'; allowed: real, pilot, simulated"),
        ([], None, "a folder without a recorded session"),
    ],
)
def test_what_cannot_be_pooled_is_refused_with_a_way_out(record, tmp_path, sessions, mode, words) -> None:
    """Modes, protocols and designs are never mixed; InputError, not a traceback."""
    (tmp_path / "results").mkdir()
    for i, options in enumerate(sessions):
        record(f"p{i:02d}", **options)
    with pytest.raises(InputError, match=words):
        read_responses(tmp_path / "results", mode=mode)


def test_an_unreadable_file_is_left_out_and_named(record, tmp_path) -> None:
    """A log that is no log."""
    record("p01")
    record("p02").write_bytes(b"\x00\xff not json\n")
    assert "sub-p02" in reasons(read_responses(tmp_path / "results"))


def test_a_second_session_of_some_participants_stays_out(record, tmp_path) -> None:
    """Everyone enters with as many sessions as the one with fewest; the rest is named."""
    record("p01"), record("p01", session=2), record("p02")
    responses = read_responses(tmp_path / "results")
    assert len(responses.frame) == 48
    assert "session beyond the first 1" in reasons(responses)["sub-p01"]


def test_two_sessions_of_everyone_are_repetitions(record, tmp_path) -> None:
    """Two answers of each participant in each cell."""
    for participant in ("p01", "p02"):
        record(participant), record(participant, session=2)
    assert count_answers(read_responses(tmp_path / "results").frame).n_repetitions == 2


def test_a_turned_beam_is_told_by_zone(record, tmp_path) -> None:
    """Mirrored placement of the second participant: same zones chosen, same speeds under them, other side."""
    record("p01"), record("p02", placement="mirrored")
    responses = read_responses(tmp_path / "results")
    answers = count_answers(responses.frame, responses.focus)
    assert (answers.counts[0] == answers.counts[1]).all()
    assert answers.facing.tolist() == [1, -1]
    assert set(responses.frame["speed_left_mm_s"]) == {40.0}


def test_catch_trials_of_a_session_are_counted_apart(record, tmp_path) -> None:
    """Two catch trials more, answered none and left: no row of the table, and counted with their participant."""
    for participant in ("p01", "p02"):
        with SessionLog.reopen(record(participant)) as log:
            for index, answer in enumerate(("none", "left"), 25):
                row = {"finger_condition": "one_hand", "zone_left": "A", "zone_right": "C", "velocity_mm_s": 0}
                log.append("trial", **trial(index, {**row, "response": answer}), catch=True)
    responses = read_responses(tmp_path / "results")
    assert len(responses.frame) == 48
    assert responses.frame["velocity_mm_s"].min() == 80
    assert responses.catches == {"p01": {"none": 1, "left": 1}, "p02": {"none": 1, "left": 1}}


@pytest.mark.parametrize("was_on", [True, False])
def test_reading_leaves_garbage_collection_as_it_was(record, tmp_path, monkeypatch, was_on) -> None:
    """It is off while logs are read, and afterwards what it was, also where reading fails."""
    record("p01")
    seen: list[bool] = []

    def opened(path: Path) -> None:
        seen.append(gc.isenabled())
        raise KeyboardInterrupt

    if not was_on:
        gc.disable()
    try:
        read_responses(tmp_path / "results")
        assert gc.isenabled() is was_on
        monkeypatch.setattr("modaltouch.analysis.results_tree.open_log", opened)
        with pytest.raises(KeyboardInterrupt):
            read_responses(tmp_path / "results")
        assert seen == [False]
        assert gc.isenabled() is was_on
    finally:
        gc.enable()
