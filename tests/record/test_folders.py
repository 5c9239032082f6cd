"""Where sessions live: one dataset for each protocol and mode, and no path tricks."""

from pathlib import Path

import pytest

from modaltouch.record.chain import RecordError, RecordInputError
from modaltouch.record.folders import SessionFolder, check_participant, find_log, locate


@pytest.mark.parametrize(
    ("mode", "dataset"), [("real", "demo"), ("pilot", "pilot/demo"), ("simulated", "simulated/demo")]
)
def test_each_mode_has_a_tree_of_its_own(mode, dataset):
    """Architecture: simulated and pilot sessions live in trees of their own."""
    place = SessionFolder(Path("results"), mode, "demo", "p01", 2)
    assert place.dataset == Path("results") / dataset
    assert place.log == Path("results") / dataset / "sub-p01" / "ses-2" / "beh" / "session.jsonl"


def test_the_table_has_a_bids_name():
    """BIDS labels hold letters and digits alone: sub-<id>_ses-<n>_task-<label>_beh.tsv."""
    place = SessionFolder(Path("results"), "real", "differentiated_stimulation", "p01")
    assert place.table.name == "sub-p01_ses-1_task-differentiatedstimulation_beh.tsv"


@pytest.mark.parametrize("name", ["", "../p01", "p 1", "p_1", "Zoë", "p01/..", "a" * 33, "p01\n", "CON."])
def test_a_participant_id_with_anything_but_letters_and_digits_is_refused(name):
    """No path tricks and no names in file names."""
    with pytest.raises(RecordInputError, match="letters and digits"):
        check_participant(name)


def test_sessions_count_from_one():
    """Session 0 does not exist."""
    with pytest.raises(RecordInputError, match="sessions count from 1"):
        SessionFolder(Path("results"), "real", "demo", "p01", 0)


def make_log(results, mode="simulated", participant="p01"):
    """Put an empty log where a session's would be."""
    place = SessionFolder(results, mode, "demo", participant)
    place.folder.mkdir(parents=True)
    place.log.touch()
    return place


def test_a_log_is_found_from_itself_its_folder_and_any_folder_above(tmp_path):
    """People name a session in many ways."""
    place = make_log(tmp_path)
    for named in (place.log, place.folder, place.folder.parent, place.dataset, tmp_path):
        assert find_log(named) == place.log


def test_two_sessions_under_one_folder_are_not_guessed_between(tmp_path):
    """The message lists them."""
    make_log(tmp_path)
    make_log(tmp_path, participant="p02")
    with pytest.raises(RecordInputError, match=r"holds 2 sessions(.|\n)*sub-p01(.|\n)*sub-p02"):
        find_log(tmp_path)


@pytest.mark.parametrize("mode", ["real", "pilot", "simulated"])
def test_a_place_is_known_from_its_log(tmp_path, mode):
    """`locate` undoes `SessionFolder.log`."""
    place = make_log(tmp_path, mode)
    assert locate(place.log, mode, "demo") == place


def test_a_log_that_was_moved_is_not_taken_for_another_session(tmp_path):
    """A simulated session put into the real tree is refused."""
    place = make_log(tmp_path, "real")
    with pytest.raises(RecordError, match="put it back there"):
        locate(place.log, "simulated", "demo")
