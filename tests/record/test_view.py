"""The BIDS view: every value of the log in its column, every column described, never half a file."""

import json
import stat

import pytest

from modaltouch.record.chain import RecordError
from modaltouch.record.folders import SessionFolder
from modaltouch.record.log import Session
from modaltouch.record.view import (
    COLUMNS,
    describe_dataset,
    list_participants,
    replace_file,
    table_text,
    write_view,
)

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
    return Session(tmp_path / "session.jsonl", (start, TRIAL), ())


@pytest.fixture
def place(tmp_path):
    """Where it lives."""
    place = SessionFolder(tmp_path, "simulated", "demo", "p01")
    place.folder.mkdir(parents=True)
    return place


def test_a_row_says_what_was_presented_and_answered(session):
    """Values of the trial event, times in seconds, velocity in mm/s."""
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


def test_every_column_is_described_in_the_side_file(place, session):
    """BIDS: the JSON file beside a table describes its columns, with units and levels."""
    write_view(place, session, {"lines": 7, "check": "0" * 64})
    side = json.loads(place.table.with_suffix(".json").read_text())
    assert set(COLUMNS) <= set(side)
    assert side["response_time"]["Units"] == "s"
    assert set(side["response"]["Levels"]) == {"left", "right", "both"}
    assert side["Mode"] == "simulated"


def test_the_dataset_is_described_and_lists_its_participants(place):
    """BIDS: dataset_description.json with Name and BIDSVersion; participants.tsv with a row for each sub- folder."""
    (place.dataset / "sub-p02").mkdir()
    describe_dataset(place, "A title")
    list_participants(place)
    assert json.loads((place.dataset / "dataset_description.json").read_text())["Name"] == "A title"
    assert (place.dataset / "participants.tsv").read_text() == "participant_id\nsub-p01\nsub-p02\n"
    assert "*.jsonl" in (place.dataset / ".bidsignore").read_text()


def test_what_a_lab_wrote_about_its_participants_stays(place):
    """Columns and rows of others are kept; a new participant gets a row of ``n/a``."""
    path = place.dataset / "participants.tsv"
    path.write_text("participant_id\tage\tsex\nsub-p09\t34\tF\n")
    list_participants(place)
    assert path.read_text() == "participant_id\tage\tsex\nsub-p09\t34\tF\nsub-p01\tn/a\tn/a\n"
    before = path.stat().st_mtime_ns
    list_participants(place)
    assert path.stat().st_mtime_ns == before


def test_a_file_is_replaced_whole_and_for_its_owner_alone(tmp_path):
    """No temporary file is left, and nobody else may read it."""
    path = tmp_path / "table.tsv"
    replace_file(path, "old\n")
    replace_file(path, "new\n")
    assert path.read_text() == "new\n"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_cannot_be_written_is_named_and_the_old_one_stays(tmp_path):
    """A folder stands in the place."""
    (tmp_path / "table.tsv").mkdir()
    with pytest.raises(RecordError, match=r"table.tsv: cannot be written .* the session log is intact"):
        replace_file(tmp_path / "table.tsv", "new\n")
    assert list(tmp_path.iterdir()) == [tmp_path / "table.tsv"]


def test_catch_trials_and_the_answer_none_are_described_where_there_are_any(session, place):
    """A protocol with neither keeps the table it had; one with both gets a column and a level more."""
    start, trial = session.events
    design = {"schedule": {"catch_trials": 2}, "answers": {"keys": {"left": [], "none": []}}}
    caught = {**trial, "trial": {**trial["trial"], "condition": {**CONDITION, "velocity_mm_s": 0.0}}}
    with_both = Session(session.path, ({**start, "design": design}, caught), ())
    header, row = (line.split("\t") for line in table_text(with_both).splitlines())
    assert dict(zip(header, row, strict=True))["catch"] == "1"
    write_view(place, with_both, {"lines": 2, "check": "0" * 64})
    side = json.loads(place.table.with_suffix(".json").read_text())
    assert side["catch"]["Levels"] == {"0": "no", "1": "yes"}
    assert "none" in side["response"]["Levels"]
    assert "catch" not in table_text(session).splitlines()[0].split("\t")
    assert "none" not in COLUMNS["response"]["Levels"]
