"""Session folders: one dataset for each protocol and mode, and no path injection through a participant id."""

import errno
import os
import stat
from pathlib import Path

import pytest

from modaltouch.protocol import InputError
from modaltouch.record.chain import RecordError, RecordInputError
from modaltouch.record.files import make_folder
from modaltouch.record.folders import SessionFolder, find_log


@pytest.mark.parametrize(
    ("mode", "dataset"), [("real", "demo"), ("pilot", "pilot/demo"), ("simulated", "simulated/demo")]
)
def test_each_mode_has_a_separate_tree(mode, dataset):
    """Real, pilot and simulated sessions are stored in separate trees."""
    place = SessionFolder(Path("results"), mode, "demo", "p01", 2)
    assert place.dataset == Path("results") / dataset
    assert place.log == Path("results") / dataset / "sub-p01" / "ses-2" / "beh" / "session.jsonl"


def test_the_table_has_a_bids_name():
    """BIDS labels hold letters and digits only: sub-<id>_ses-<n>_task-<label>_beh.tsv."""
    place = SessionFolder(Path("results"), "real", "differentiated_stimulation", "p01")
    assert place.table.name == "sub-p01_ses-1_task-differentiatedstimulation_beh.tsv"


@pytest.mark.parametrize("name", ["", "../p01", "p 1", "p_1", "Zoë", "p01/..", "a" * 33, "p01\n", "CON."])
def test_a_participant_id_takes_letters_and_digits_only(name):
    """The id is part of folder and file names, so it must not alter a path."""
    with pytest.raises(RecordInputError, match="letters and digits"):
        SessionFolder.check_participant(name)


def test_sessions_count_from_one():
    """Session 0 does not exist."""
    with pytest.raises(RecordInputError, match="sessions count from 1"):
        SessionFolder(Path("results"), "real", "demo", "p01", 0)


def make_log(results, mode="simulated", participant="p01"):
    """Create an empty log in the folder of a session."""
    place = SessionFolder(results, mode, "demo", participant)
    place.folder.mkdir(parents=True)
    place.log.touch()
    return place


def test_a_log_is_found_from_its_path_or_any_folder_above(tmp_path):
    """A session may be given by its log or by any folder above it."""
    place = make_log(tmp_path)
    for named in (place.log, place.folder, place.folder.parent, place.dataset, tmp_path):
        assert find_log(named) == place.log


def test_a_participant_id_that_differs_in_case_only_is_refused(tmp_path):
    """Windows and macOS would store both in one folder; elsewhere a typing error would split one participant in two."""
    make_log(tmp_path, participant="p02")
    with pytest.raises(RecordInputError, match="given participant P02, but there is p02, who differs in capitals"):
        SessionFolder(tmp_path, "simulated", "demo", "P02").refuse_existing()
    SessionFolder(tmp_path, "simulated", "demo", "p02", 2).refuse_existing()
    SessionFolder(tmp_path, "simulated", "demo", "p03").refuse_existing()


def test_a_folder_with_two_sessions_is_ambiguous(tmp_path):
    """The error lists both sessions."""
    make_log(tmp_path)
    make_log(tmp_path, participant="p02")
    with pytest.raises(RecordInputError, match=r"holds 2 sessions(.|\n)*sub-p01(.|\n)*sub-p02"):
        find_log(tmp_path)


def test_sessions_are_sorted_by_number(tmp_path):
    """Session 10 comes after session 9, and a folder without a number comes first."""
    folders = [tmp_path / f"ses-{number}" / "beh" for number in ("10", "9", "old")]
    for folder in folders:
        make_folder(folder)
        (folder / "session.jsonl").touch()
    assert [log.parent for log in SessionFolder.logs_of(tmp_path)] == folders[::-1]


@pytest.mark.parametrize("mode", ["real", "pilot", "simulated"])
def test_a_session_folder_is_found_from_its_log(tmp_path, mode):
    """`SessionFolder.of` inverts `SessionFolder.log`."""
    place = make_log(tmp_path, mode)
    assert SessionFolder.of(place.log, mode, "demo") == place


def test_a_log_moved_to_another_tree_is_refused(tmp_path):
    """A simulated session in the tree of real sessions is refused."""
    place = make_log(tmp_path, "real")
    with pytest.raises(RecordError, match="move it back there"):
        SessionFolder.of(place.log, "simulated", "demo")


def test_a_valid_participant_id_is_returned():
    """Up to 32 letters and digits are valid."""
    assert SessionFolder.check_participant("p01") == "p01"
    assert SessionFolder.check_participant("Z" * 32) == "Z" * 32


def test_created_folders_are_readable_by_their_owner_only(tmp_path):
    """README: files and folders are readable by their owner only, parent folders included."""
    make_folder(tmp_path / "a" / "b" / "c")
    made = [tmp_path / "a", tmp_path / "a" / "b", tmp_path / "a" / "b" / "c"]
    assert [stat.S_IMODE(folder.stat().st_mode) for folder in made] == [0o700] * 3
    make_folder(tmp_path / "a" / "b" / "c")


@pytest.mark.parametrize("path", ["sub-p01/ses-0/beh", "sub-p01/ses-1x/beh", "p01/ses-1/beh", "sub-p01/1/beh"])
def test_a_log_outside_the_folder_layout_is_refused(tmp_path, path):
    """Participant and session come from the folder names; they are not guessed from others."""
    log = tmp_path / "demo" / path / "session.jsonl"
    make_folder(log.parent)
    log.touch()
    with pytest.raises(RecordError, match=r"is not in a folder sub-<id>/ses-<n>/beh"):
        SessionFolder.of(log, "real", "demo")


def test_an_unknown_mode_is_refused(tmp_path):
    """The modes are real, pilot and simulated."""
    place = make_log(tmp_path, "real")
    with pytest.raises(RecordError, match="is not in a folder"):
        SessionFolder.of(place.log, "unknown", "demo")


def test_a_path_without_a_session_is_refused(tmp_path):
    """A table, a missing folder and an empty folder each have their own message."""
    (tmp_path / "beh.tsv").touch()
    with pytest.raises(RecordInputError, match="is not a session log; give a session's folder or its session.jsonl"):
        find_log(tmp_path / "beh.tsv")
    with pytest.raises(InputError, match="gone: given no such file or folder; allowed: a results folder"):
        find_log(tmp_path / "gone")
    with pytest.raises(InputError, match="given a folder without a recorded session; allowed: a results folder"):
        find_log(tmp_path)


@pytest.mark.parametrize("number", [errno.EACCES, errno.EINVAL], ids=["of another user", "of the system"])
def test_an_unreadable_folder_is_an_error(monkeypatch, tmp_path, number):
    """Skipping it would silently drop a session; only EINVAL, as for entries in `/proc`, is passed over."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "session.jsonl").touch()
    look = os.scandir

    def refuse(path):
        if str(path).endswith("b"):
            raise OSError(number, os.strerror(number), str(path))
        return look(path)

    monkeypatch.setattr(os, "scandir", refuse)
    if number == errno.EINVAL:
        assert SessionFolder.logs_under(tmp_path) == [tmp_path / "a" / "session.jsonl"]
        return
    with pytest.raises(PermissionError, match="b'$"):
        SessionFolder.logs_under(tmp_path)
