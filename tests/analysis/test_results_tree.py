from __future__ import annotations

import gc
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from modaltouch.analysis import analyse
from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.pipeline import read_responses
from modaltouch.preflight import Preflight, examine
from modaltouch.protocol.source import InputError
from modaltouch.protocol.trial import Trial
from modaltouch.record.audit import audit_session
from modaltouch.record.chain import read_chain
from modaltouch.record.session import Session

KINDS = ("fired", "trial")
NAMED = ("protocol: differentiated_stimulation", "protocol: two")
FEWER = ("[80, 100, 150, 200]", "[80, 100, 150]")
MIRRORED = ("  hand: right ", "  placements: [mirrored]\n  hand: right ")
CATCHES = ("  practice_trials: 3", "  practice_trials: 3\n  catch_trials: 1")
NONE = ("    both: [up, down, num_8]", "    both: [up, num_8]\n    none: [down]")
SHIPPED = Path(__file__).parents[2] / "protocols"
Write = Callable[..., Path]


def altered(edit: Callable[..., Path], *changes: tuple[str, str]) -> Preflight:
    """Return the paper's protocol with some of its text changed."""
    return examine(edit("differentiated_stimulation.yaml", *changes)).require()


@pytest.fixture(scope="module")
def paper() -> Preflight:
    """Return the paper's protocol."""
    return examine(SHIPPED / "differentiated_stimulation.yaml").require()


@pytest.fixture
def record(tmp_path: Path, build: dict[str, Any], scribe: Write, paper: Preflight) -> Write:
    """Write a session log, as a session does, with the synthetic answers of one participant."""
    rows = (row for row in build["paper"]() if row["participant"] == "p01")
    cells = ("finger_condition", "zone_left", "zone_right", "velocity_mm_s")
    words = {tuple(row[name] for name in cells): row["response"] for row in rows}

    def answer(trial: Trial) -> str:
        condition = trial.condition
        pair = condition.zones[::-1] if condition.is_mirrored else condition.zones
        word = str(words[condition.finger_condition, *pair, condition.velocity_mm_s])
        return {"left": "right", "right": "left"}.get(word, word) if condition.is_mirrored else word

    def write(participant: str = "p01", preflight: Preflight = paper, **options: Any) -> Path:
        return scribe(preflight, tmp_path / "results", participant, **{"answer": answer, **options})

    return write


def reasons(responses) -> dict[str, str]:
    """Return why each session is left out, by participant folder."""
    return {Path(item.source).parts[-3]: item.reason for item in responses.left_out}


def test_complete_sessions_are_read_without_their_practice(record, tmp_path) -> None:
    """Two synthetic sessions have 24 answers and one practice trial each."""
    record("p01"), record("p02")
    responses = read_responses(tmp_path / "results")
    assert len(responses.frame) == 48
    assert responses.source.mode == "real"
    assert responses.focus == "C"
    assert responses.left_out == ()


@pytest.mark.parametrize("depth", [0, 1, 2, 3, 5])
def test_any_folder_of_the_tree_or_the_log_can_be_given(record, tmp_path, depth) -> None:
    """From the results folder down to the session's log."""
    path = record("p01")
    chain = [path, *path.parents][:7]
    assert len(read_responses(chain[depth]).frame) == 24


def test_a_superseded_answer_does_not_count(record) -> None:
    """A withdrawn and repeated answer replaces the one it refers to; no line is rewritten."""
    first = record("p01")
    events = read_chain(first).events
    fired, old = (next(e for e in events if e["event"] == kind and not e["trial"]["practice"]) for kind in KINDS)
    facts = {key: value for key, value in old.items() if key not in ("n", "time", "clock")}
    response = {**old["response"], "answer": "both" if old["response"]["answer"] != "both" else "left"}
    first.unlink()
    path = record(
        "p01",
        also=(
            {"event": "withdrawn", "lines": [old["n"]]},
            {"event": "fired", "trial": fired["trial"], "confirmed": fired["confirmed"]},
            {**facts, "presentation": 2, "response": response, "supersedes": old["n"]},
        ),
    )
    assert audit_session(Session.find(path)).problems == ()
    frame = read_responses(path).frame
    assert len(frame) == 24
    assert frame[frame["trial"] == 1]["response"].tolist() == [response["answer"]]


def test_excluded_sessions_are_listed_with_their_reason(record, tmp_path) -> None:
    """Incomplete, damaged, pilot and simulated sessions are excluded; the complete real one is read."""
    record("p01")
    record("p02", n_answered=20)
    damaged = record("p03")
    damaged.write_bytes(damaged.read_bytes().replace(b'"answer":"left"', b'"answer":"both"', 1))
    record("p04", mode="pilot"), record("p05", mode="simulated")
    record("p06", n_answered=3, also=({"event": "closed", "begun_anew_as": 2},))
    responses = read_responses(tmp_path / "results")
    told = reasons(responses)
    assert set(responses.frame["participant"]) == {"p01"}
    assert told["sub-p02"] == "incomplete: 20 of 24 trials answered (continue with `modaltouch resume`)"
    assert told["sub-p03"].startswith("damaged: ")
    assert told["sub-p04"].startswith("pilot, not real")
    assert told["sub-p05"].startswith("simulated, not real")
    assert told["sub-p06"] == "closed: started over as session 2"


def test_a_chosen_mode_leaves_the_others_out(record, tmp_path) -> None:
    """With mode simulated, a real session in the same folder is left out."""
    record("p01"), record("p02", mode="simulated")
    responses = read_responses(tmp_path / "results", mode="simulated")
    assert set(responses.frame["participant"]) == {"p02"}
    assert responses.source.mode == "simulated"
    assert reasons(responses) == {"sub-p01": "real, not simulated (choose with --mode real)"}


@pytest.mark.parametrize(
    ("sessions", "mode", "words"),
    [
        ([{"mode": "pilot"}, {"mode": "simulated"}], None, r"several modes \(1 pilot, 1 simulated\).*--mode"),
        ([{}, {"change": NAMED}], None, r"several protocols \(1 of 'differentiated_stimulation', 1 of 'two'\)"),
        ([{}, {"change": FEWER}], None, "answered different conditions"),
        ([{"n_answered": 3}], None, r"no session that can be analysed \(1 session: incomplete: 3 of 24"),
        ([{}], "virtual", r"mode 'virtual'; allowed: real, pilot, simulated"),
        ([], None, "a folder without a recorded session"),
    ],
)
def test_sessions_that_cannot_be_pooled_are_refused_with_a_remedy(
    record, edit, paper, tmp_path, sessions, mode, words
) -> None:
    """Different modes, protocols and designs raise InputError with the option to choose one."""
    (tmp_path / "results").mkdir()
    for i, options in enumerate(sessions):
        change = options.get("change")
        facts = {name: value for name, value in options.items() if name != "change"}
        record(f"p{i:02d}", altered(edit, change) if change else paper, **facts)
    with pytest.raises(InputError, match=words):
        read_responses(tmp_path / "results", mode=mode)


@pytest.mark.parametrize("is_lab", [False, True], ids=["tree", "labs"])
def test_sessions_of_changed_protocols_are_analysed_with_a_note(record, edit, tmp_path, is_lab: bool) -> None:
    """An answer that only some were offered, and another field."""
    record("p01"), record("p02")
    if is_lab:
        (tmp_path / "results").rename(tmp_path / "north")
    record("p03", altered(edit, NONE, ("base_mm: 56", "base_mm: 60")))
    first = tmp_path / ("north" if is_lab else "results")
    responses = read_responses(first, *[tmp_path / "results"] * is_lab)
    said = "Versions of the protocol that differ in answers.keys, stimulus.field are analysed together"
    assert [note for note in responses.notes if note.startswith(said)][0].removeprefix(said) in (
        " (2 and 1 sessions)", " (1 and 2 sessions)",
    )  # fmt: skip


def test_sessions_of_one_name_with_another_focus_are_refused(record, edit, tmp_path) -> None:
    """They would be counted as about the focus of the first: the dominant zone of each pair depends on it."""
    for who, change in (("p01", ("150, 200]", "120, 150]")), ("p02", ("focus: C ", "focus: B "))):
        record(who, altered(edit, change), answer=lambda trial: "both")  # each change is of the file changed before
    with pytest.raises(InputError, match=r"several foci \(1 C, 1 B\).*give the other protocol another name"):
        read_responses(tmp_path / "results")


def test_an_unreadable_file_is_left_out_and_named(record, tmp_path) -> None:
    """A log that is no log."""
    record("p01")
    record("p02").write_bytes(b"\x00\xff not json\n")
    assert "sub-p02" in reasons(read_responses(tmp_path / "results"))


def test_a_second_session_of_some_participants_is_excluded(record, tmp_path) -> None:
    """Everyone counts with as many sessions as the participant with the fewest; the rest are listed."""
    record("p01"), record("p01", session=2), record("p02")
    responses = read_responses(tmp_path / "results")
    assert len(responses.frame) == 48
    assert "session after number 1" in reasons(responses)["sub-p01"]


def test_two_sessions_of_everyone_are_repetitions(record, tmp_path) -> None:
    """Each participant has two answers in each cell."""
    for participant in ("p01", "p02"):
        record(participant), record(participant, session=2)
    assert count_answers(read_responses(tmp_path / "results").frame).n_repetitions == 2


def test_answers_at_a_turned_beam_are_assigned_by_zone(record, edit, tmp_path) -> None:
    """For the mirrored second participant zones and the speeds under them are equal, and the sides exchanged."""
    record("p01"), record("p02", altered(edit, MIRRORED))
    responses = read_responses(tmp_path / "results")
    answers = count_answers(responses.frame, responses.focus)
    assert (answers.counts[0] == answers.counts[1]).all()
    assert answers.facing.tolist() == [1, -1]
    cells = responses.frame.groupby(["finger_condition", "zone_left", "zone_right", "velocity_mm_s"], observed=True)
    assert (cells["speed_left_mm_s"].nunique() == 1).all()


def test_catch_trials_of_a_session_are_counted_separately(record, edit, tmp_path) -> None:
    """One per finger condition: they are not in the table, and a time-out is not a false alarm."""
    preflight = altered(edit, CATCHES, NONE)
    for participant, word in (("p01", "none"), ("p02", "left"), ("p03", "time_out")):
        record(participant, preflight, answer=lambda trial, word=word: word if trial.condition.is_catch else "both")
    responses = read_responses(tmp_path / "results")
    assert len(responses.frame) == 72
    assert responses.frame["velocity_mm_s"].min() == 80
    words = {"p01": "none", "p02": "left"}
    fingers = ("one_hand", "two_hands")
    assert responses.catches == {(who, each, ""): {word: 1} for who, word in words.items() for each in fingers}


def test_participants_and_cells_without_any_answer_are_listed(record, edit, tmp_path) -> None:
    """They are in no table and must be reported; a results folder without any answer is refused."""
    preflight = altered(edit, ("  keys:", "  time_out_s: 5\n  keys:"))
    record("p01", preflight, answer=lambda trial: "time_out")
    with pytest.raises(InputError, match="no answer to any trial"):
        read_responses(tmp_path / "results")
    record("p02", preflight, answer=lambda trial: "time_out" if trial.condition.zones[0] == "B" else "both")
    (note,) = read_responses(tmp_path / "results").notes
    silent = "participant p01, one_hand B-D, two_hands B-D"
    assert note == f"Left out, since there is no answer at all: {silent}"


@pytest.mark.parametrize("was_on", [True, False])
def test_reading_restores_garbage_collection(record, tmp_path, monkeypatch, was_on) -> None:
    """It is off while logs are read and restored afterwards, also if reading fails."""
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


def test_folders_of_several_labs_are_analysed_with_the_lab_as_group(record, tmp_path) -> None:
    """The same participant label in two labs means two people; each lab is a group, and nothing is left out."""
    record("p01"), record("p02")
    (tmp_path / "results").rename(tmp_path / "north")
    record("p01"), record("p02")
    (tmp_path / "results").rename(tmp_path / "south")
    with pytest.raises(InputError, match=r"given the folders of several labs; .*--out"):
        analyse(tmp_path / "north", labs=[tmp_path / "south"])
    analysis = analyse(tmp_path / "north", tmp_path / "out", labs=[tmp_path / "south"])
    responses = analysis.responses
    assert responses.groups == {"north/p01": "north", "north/p02": "north", "south/p01": "south", "south/p02": "south"}
    assert (len(responses.frame), responses.left_out) == (96, ())
    assert {"fig_10.csv", "groups.png"} <= set(analysis.files)
    between = [finding for finding in analysis.findings if finding.question == "group"]
    assert {finding.scope for finding in between} == {"north - south"}
    assert (tmp_path / "out" / "answers.csv").read_text("utf-8").splitlines()[1].startswith("north/p01,north,")
    assert "group + finger_condition + pair + level + (1 | participant)" in (tmp_path / "out" / "models.R").read_text(
        "utf-8"
    )
    # Both labs have the same answers.
    assert {finding.estimate for finding in between} == {0.0}


def test_labs_are_distinguished_by_the_names_of_their_folders(record, tmp_path) -> None:
    """Two folders of the same name, or a file, are refused."""
    path = record("p01")
    with pytest.raises(InputError, match=r"given several folders named 'results'; .*name each folder after its lab"):
        read_responses(tmp_path / "results", tmp_path / "results")
    with pytest.raises(InputError, match=r"given a file among several sources; .*the results folder of each lab"):
        read_responses(tmp_path / "results", path)


def test_the_table_of_one_session_is_refused(record) -> None:
    """It has no column for the participant; the message gives the folder to use."""
    (table,) = record("p01").parent.glob("*_beh.tsv")
    with pytest.raises(InputError, match=rf"given the table of one recorded session; .*give its folder {table.parent}"):
        read_responses(table)


def test_a_session_given_twice_is_refused(record, tmp_path) -> None:
    """It may be in a folder within another one, or copied; the message gives both paths."""
    session = record("p01").parents[1]
    with pytest.raises(InputError, match=rf"given the same session twice, {session}.* and {session}.*share no session"):
        read_responses(tmp_path / "results", session.parent)
    copied = shutil.copytree(session, tmp_path / "results" / "copy" / "sub-p01" / session.name)
    with pytest.raises(InputError, match=rf"twice, {copied}.* and {session}"):
        read_responses(tmp_path / "results")
