"""The BIDS view: every value of the log has its column, every column is described, no file is half written."""

import json
import stat

import pytest

from modaltouch import __version__
from modaltouch.record.chain import RecordError
from modaltouch.record.folders import SessionFolder
from modaltouch.record.session import Session
from modaltouch.record.view import COLUMNS, FURTHER, table_text, write_view

CONDITION = {
    "finger_condition": "one_hand",
    "zone_left": "A",
    "zone_right": "C",
    "velocity_mm_s": 150.0,
    "placement": "normal",
}
TRIAL = {
    "n": 7,
    "event": "trial",
    "trial": {"index": 3, "block": 1, "condition": CONDITION, "repetition": 1, "practice": False},
    "fingers": ["right index", "right middle"],
    "confirmed": {"confirmed": True},
    "response": {
        "answer": "right",
        "reaction_time": 0.71239,
        "onset": "first_burst",
        "answered_by": "participant",
        "way": "lifting",
    },
}


@pytest.fixture
def session(tmp_path):
    """A session with one answer."""
    start = {"n": 1, "event": "start", "mode": "simulated", "schedule": {"n_trials": 1}}
    return Session(tmp_path / "session.jsonl", (start, TRIAL))


@pytest.fixture
def place(tmp_path):
    """The folder of the session."""
    place = SessionFolder(tmp_path, "simulated", "demo", "p01")
    place.folder.mkdir(parents=True)
    return place


def test_a_row_holds_what_was_presented_and_answered(session):
    """Values come from the trial event; times are in seconds, velocities in mm/s."""
    header, row = (line.split("\t") for line in table_text(session).splitlines())
    values = dict(zip(header, row, strict=True))
    assert values == {
        "trial": "3",
        "block": "1",
        "practice": "0",
        "finger_condition": "one_hand",
        "zone_left": "A",
        "zone_right": "C",
        "finger_left": "right index",
        "finger_right": "right middle",
        "placement": "normal",
        "velocity_mm_s": "150",
        "repetition": "1",
        "response": "right",
        "response_time": "0.7124",
        "response_onset": "first_burst",
        "answered_by": "participant",
        "way": "lifting",
        "confirmed": "1",
        "log_line": "7",
    }


def test_every_column_is_described_in_the_sidecar(place, session):
    """BIDS: the JSON sidecar of a table describes its columns, with units and levels."""
    write_view(place, session, {"lines": 7, "check": "0" * 64})
    side = json.loads(place.table.with_suffix(".json").read_text())
    assert set(COLUMNS) <= set(side)
    assert side["response_time"]["Units"] == "s"
    assert set(side["response"]["Levels"]) == {"left", "right", "both"}
    assert side["Mode"] == "simulated"


def test_the_dataset_is_described_and_lists_its_participants(place):
    """BIDS: dataset_description.json with Name and BIDSVersion; participants.tsv with a row for each sub- folder."""
    (place.dataset / "sub-p02").mkdir()
    place.describe_dataset("A title")
    place.list_participants()
    assert json.loads((place.dataset / "dataset_description.json").read_text())["Name"] == "A title"
    assert (place.dataset / "participants.tsv").read_text() == "participant_id\nsub-p01\nsub-p02\n"
    assert "*.jsonl" in (place.dataset / ".bidsignore").read_text()


def test_a_labs_entries_about_participants_are_kept(place):
    """Existing columns and rows are kept; a new participant gets a row of ``n/a``."""
    path = place.dataset / "participants.tsv"
    path.write_text("participant_id\tage\tsex\nsub-p09\t34\tF\n")
    place.list_participants()
    assert path.read_text() == "participant_id\tage\tsex\nsub-p09\t34\tF\nsub-p01\tn/a\tn/a\n"
    before = path.stat().st_mtime_ns
    place.list_participants()
    assert path.stat().st_mtime_ns == before


def test_every_file_of_the_view_is_readable_by_its_owner_only(session, place):
    """The view holds a participant's answers: the mode is 0600."""
    place.describe_dataset("A title")
    place.list_participants()
    write_view(place, session, {"lines": 2, "check": "0" * 16})
    files = [path for path in place.dataset.rglob("*") if path.is_file()]
    assert {place.table, place.table.with_suffix(".json"), place.dataset / "participants.tsv"} <= set(files)
    assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {0o600}


def test_a_failed_view_is_reported_with_the_log_intact(session, place):
    """A folder occupies the path of the table."""
    place.table.mkdir(parents=True)
    with pytest.raises(RecordError, match=r"_beh.tsv: cannot be written .* the session log is intact"):
        write_view(place, session, {"lines": 2, "check": "0" * 16})


def test_catch_trials_and_the_answer_none_are_described_where_used(session, place):
    """A protocol with both gets a column and a level more; the table of one with neither is unchanged."""
    start, trial = session.events
    design = {"schedule": {"catch_trials": 2}, "answers": {"keys": {"left": [], "none": []}}}
    caught = {**trial, "trial": {**trial["trial"], "condition": {**CONDITION, "velocity_mm_s": 0.0}}}
    with_both = Session(session.path, ({**start, "design": design}, caught))
    header, row = (line.split("\t") for line in table_text(with_both).splitlines())
    assert dict(zip(header, row, strict=True))["catch"] == "1"
    write_view(place, with_both, {"lines": 2, "check": "0" * 64})
    side = json.loads(place.table.with_suffix(".json").read_text())
    assert side["catch"]["Levels"] == {"0": "no", "1": "yes"}
    assert set(side["response"]["Levels"]) == {"left", "none"}
    assert "catch" not in table_text(session).splitlines()[0].split("\t")
    write_view(place, session, {"lines": 2, "check": "0" * 64})
    plain = json.loads(place.table.with_suffix(".json").read_text())
    assert plain["response"]["Levels"] == {"left": "left finger", "right": "right finger", "both": "both fingers"}


def test_the_sidecar_identifies_the_table(place, session):
    """TaskName is required by BIDS; the number of log lines and the last checksum reveal a log that lost its end."""
    write_view(place, session, {"lines": 7, "check": "ab" * 32})
    side = json.loads(place.table.with_suffix(".json").read_text())
    assert side["TaskName"] == "demo"
    assert side["SessionLog"] == {"File": "session.jsonl", "lines": 7, "check": "ab" * 32}
    assert place.table.read_text() == table_text(session)
    described = {name: column for name, column in side.items() if name not in ("TaskName", "Mode", "SessionLog")}
    assert list(described) == [*COLUMNS, *FURTHER["line"]]
    for name, column in described.items():
        assert set(column) <= {"Description", "Levels", "Units"}, name
        assert column["Description"].strip(), name


def test_every_optional_column_of_a_session_is_described(session, place):
    """A log of format 2 counts bursts, and a follow-up question has its answer and its response time."""
    start, trial = session.events
    further = {"answer": "yes", "reaction_time": 1.25}
    answered = {
        **trial,
        "bursts": {"first_s": 12.5, "uncertainty_s": 0.001, "whole": 20, "dropped": 0},
        "response": {**trial["response"], "further": {"sure": further}},
    }
    design = {"answers": {"keys": {"left": []}, "then": {"sure": {"question": "Sure?", "keys": {"yes": [], "no": []}}}}}
    of_today = Session(session.path, ({**start, "schema": 2, "design": design}, answered))
    header, row = (line.split("\t") for line in table_text(of_today).splitlines())
    values = dict(zip(header, row, strict=True))
    assert [values[name] for name in ("onset", "n_bursts", "sure", "sure_time")] == ["12.5000", "20", "yes", "1.2500"]
    write_view(place, of_today, {"lines": 2, "check": "0" * 64})
    side = json.loads(place.table.with_suffix(".json").read_text())
    assert set(FURTHER["counted"]) <= set(header) <= set(side)
    for columns in FURTHER.values():
        for name, column in columns.items():
            assert set(column) <= {"Description", "Levels", "Units"}, name
            assert column["Description"].strip(), name


LEVELS = {
    "practice": {"0", "1"},
    "finger_condition": {"one_hand", "two_hands"},
    "placement": {"normal", "mirrored", "swapped", "mirrored_swapped"},
    "response_onset": {"first_burst", "question"},
    "confirmed": {"0", "1"},
}


def test_every_level_of_a_column_is_described():
    """BIDS: categorical columns have Levels, the others Units."""
    assert {name: set(column["Levels"]) for name, column in COLUMNS.items() if "Levels" in column} == LEVELS
    for name in ("practice", "confirmed"):
        assert COLUMNS[name]["Levels"] == {"0": "no", "1": "yes"}
    units = {name: column["Units"] for name, column in COLUMNS.items() if "Units" in column}
    assert units == {"velocity_mm_s": "mm/s", "response_time": "s"}


def test_the_dataset_description_follows_bids(place):
    """BIDS 1.10: Name, BIDSVersion, DatasetType, GeneratedBy; written once and then left to the lab."""
    place.describe_dataset("")
    path = place.dataset / "dataset_description.json"
    assert json.loads(path.read_text()) == {
        "Name": "demo",
        "BIDSVersion": "1.10.0",
        "DatasetType": "raw",
        "GeneratedBy": [{"Name": "modaltouch", "Version": __version__}],
    }
    readme = (place.dataset / "README").read_text()
    assert readme.startswith("demo: sessions recorded by modaltouch")
    assert len(readme) > 150, "the BIDS validator warns of a shorter one"
    assert {"*.jsonl", "*.log"} <= set((place.dataset / ".bidsignore").read_text().split())
    path.write_text("{}")
    place.describe_dataset("Another title")
    assert path.read_text() == "{}"


@pytest.mark.parametrize("at", ["README", ".bidsignore", "dataset_description.json"])
def test_an_interrupted_dataset_description_is_completed_by_the_next_session(place, monkeypatch, at):
    """After a kill at any of the three files, the next session writes the missing ones."""

    def kill(path, text):
        if path.name == at:
            raise KeyboardInterrupt
        path.write_text(text)

    with monkeypatch.context() as patch:
        patch.setattr("modaltouch.record.folders.replace_text", kill)
        with pytest.raises(KeyboardInterrupt):
            place.describe_dataset("")
    place.describe_dataset("")
    assert all((place.dataset / name).read_text() for name in ("README", ".bidsignore", "dataset_description.json"))


def test_masking_and_stimuli_have_columns_where_used(session, place):
    """The values are those of the trial; the table of a protocol with neither is unchanged."""
    start, trial = session.events
    design = {"masking": {"noise": "pink"}, "stimuli": {"narrow": {}}}
    named = {**trial, "masked": True, "trial": {**trial["trial"], "condition": {**CONDITION, "stimulus": "narrow"}}}
    both = Session(session.path, ({**start, "design": design}, named, {**trial, "n": 8}))
    header, *rows = (line.split("\t") for line in table_text(both).splitlines())
    values = [dict(zip(header, row, strict=True)) for row in rows]
    assert [(row["masked"], row["stimulus"], row["log_line"]) for row in values] == [
        ("1", "narrow", "7"),
        ("0", "n/a", "8"),
    ]
    write_view(place, both, {"lines": 8, "check": "0" * 64})
    side = json.loads(place.table.with_suffix(".json").read_text())
    assert side["masked"]["Levels"] == {"0": "no", "1": "yes"}
    assert side["stimulus"]["Description"]
    assert not {"masked", "stimulus"} & set(table_text(session).splitlines()[0].split("\t"))


def test_tabs_and_line_ends_in_values_cannot_break_the_table(session):
    """A tab or line end in a value becomes a space; a way of answering that was not asked is n/a."""
    start, trial = session.events
    odd = {**trial, "fingers": ["left\tindex", "right\nindex"], "response": {**trial["response"], "way": None}}
    header, row = (line.split("\t") for line in table_text(Session(session.path, (start, odd))).splitlines())
    values = dict(zip(header, row, strict=True))
    assert (values["finger_left"], values["finger_right"], values["way"]) == ("left index", "right index", "n/a")


def test_a_participants_file_that_is_not_text_is_refused(place):
    """It may be a spreadsheet; it is not overwritten."""
    path = place.dataset / "participants.tsv"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RecordError, match=r"participants.tsv: cannot be read .*repair it or move it away"):
        place.list_participants()
    assert path.read_bytes() == b"\xff\xfe\x00"


def test_a_dataset_without_participants_gets_a_header(place):
    """A header alone is a valid participants.tsv; a file called sub-* is not a participant."""
    place.folder.rmdir()
    place.folder.parent.rmdir()
    place.folder.parent.parent.rmdir()
    (place.dataset / "sub-notes.txt").touch()
    place.list_participants()
    assert (place.dataset / "participants.tsv").read_text() == "participant_id\n"


def test_the_row_of_an_answer_is_formatted_once(session, monkeypatch):
    """A late trial costs no more than an early one, also after a trial was repeated."""
    start, first = session.events
    second = {**first, "n": first["n"] + 1, "supersedes": first["n"]}
    third = {**first, "n": first["n"] + 2}
    sessions = ((start, first), (start, first, second), (start, first, second), (start, first, second, third))
    grown = [Session(session.path, events) for events in sessions]
    texts = [table_text(each) for each in grown]
    made, before, row = [], ((), ""), Session.row
    monkeypatch.setattr(Session, "row", lambda self, event: made.append(event["n"]) or row(self, event))
    for each, text in zip(grown, texts, strict=True):
        assert table_text(each, before) == text
        before = each.trials, text
    assert made == [first["n"], second["n"], third["n"]]
