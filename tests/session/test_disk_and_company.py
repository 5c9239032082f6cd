"""A full disk, an unwritable folder, and a second session in the same place, with real processes."""

import os
import subprocess
import sys
from contextlib import contextmanager

import pytest

from modaltouch.record.session import read_session

RUN = ("--rig", "simulated", "--answers", "simulated", "--yes")
CAN_MOUNT = os.name == "posix" and os.geteuid() == 0


@contextmanager
def small_disk(folder, kilobytes):
    """Mount a disk of a few kilobytes."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", folder], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def remount(folder, options):
    """Change the options of a mounted disk."""
    subprocess.run(["mount", "-o", f"remount,{options}", folder], check=True)


needs_mount = pytest.mark.skipif(not CAN_MOUNT, reason="only root mounts a small disk; the kill points meet a full one")


def modaltouch(*words):
    """Run ``modaltouch`` in a separate process; return its exit status and its error output."""
    command = [sys.executable, "-m", "modaltouch", *map(str, words)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    return ended.returncode, ended.stderr


@needs_mount
@pytest.mark.parametrize("kilobytes", [16, 96, 150])
def test_a_full_disk_ends_the_session_and_a_larger_one_completes_it(
    tmp_path, finish, protocol_path, log_of, answers_of, kilobytes
):
    """Exit status 4 with the file; answers are kept, and with more space the session continues to its end."""
    with small_disk(tmp_path / "disk", kilobytes) as disk:
        log = log_of(disk, "p07")
        status, output = modaltouch("run", protocol_path, "-p", "p07", *RUN, "--results", disk)
        assert (status, "No space left on device" in output or "the disk is full" in output) == (4, True), output
        assert str(disk) in output
        before = answers_of(log) if log.exists() else []
        remount(disk, "size=8m")
        words = ("resume", log.parent) if log.exists() else ("run", protocol_path, "-p", "p07", *RUN, "--results", disk)
        assert finish(*words) == 0
        assert answers_of(log)[: len(before)] == before
        assert read_session(log).complete
        assert finish("verify", log.parent) == 0


@needs_mount
def test_a_read_only_disk_is_reported_and_nothing_is_changed(
    tmp_path, start, finish, kill, protocol_path, log_of, wait_for_trials
):
    """Neither a new nor a resumed session begins; once writable, the session continues."""
    with small_disk(tmp_path / "disk", 8000) as disk:
        log = log_of(disk, "p07")
        session = start("run", protocol_path, "-p", "p07", *RUN, "--results", disk)
        wait_for_trials(log, 5)
        kill(session, 9)
        kept = log.read_bytes()
        remount(disk, "ro")
        for words in (("resume", log.parent), ("run", protocol_path, "-p", "p08", *RUN, "--results", disk)):
            status, output = modaltouch(*words)
            assert (status, "Read-only file system" in output) == (4, True), output
        assert log.read_bytes() == kept
        remount(disk, "rw")
        assert finish("resume", log.parent) == 0


@pytest.mark.parametrize("attempt", range(2))
def test_one_of_two_simultaneous_runs_of_a_session_is_refused(tmp_path, start, protocol_path, log_of, attempt):
    """As from two machines on a shared folder: one session is recorded, the other changes nothing."""
    runs = [start("run", protocol_path, "-p", "p07", *RUN, "--results", tmp_path) for _ in range(2)]
    for process in runs:
        process.join(60)
    assert sorted(process.exitcode for process in runs) == [0, 4]
    session = read_session(log_of(tmp_path, "p07"))
    assert session.problems == ()
    assert session.complete


def test_simultaneous_resumes_give_one_session(
    tmp_path, start, kill, protocol_path, log_of, wait_for_trials, answers_of
):
    """The log's lock admits one; no trial is answered twice."""
    log = log_of(tmp_path, "p07")
    session = start("run", protocol_path, "-p", "p07", *RUN, "--results", tmp_path)
    wait_for_trials(log, 5)
    kill(session, 9)
    runs = [start("resume", log.parent) for _ in range(2)]
    for process in runs:
        process.join(60)
    # The second may also come so late that nothing is left to do.
    assert sorted(process.exitcode for process in runs) in ([0, 4], [0, 0])
    assert read_session(log).problems == ()
    answers = [each[:2] for each in answers_of(log)]
    assert len(answers) == len(set(answers))


def test_simultaneous_participants_are_all_listed(tmp_path, start, protocol_path):
    """Four sessions of one results tree: each is recorded and is in participants.tsv."""
    names = ("p01", "p02", "p03", "p04")
    runs = [start("run", protocol_path, "-p", name, *RUN, "--results", tmp_path) for name in names]
    for process in runs:
        process.join(60)
    assert [process.exitcode for process in runs] == [0, 0, 0, 0]
    (listed,) = tmp_path.rglob("participants.tsv")
    assert sorted(listed.read_text().split()) == ["participant_id", *(f"sub-{name}" for name in names)]


def test_only_the_owner_can_read_the_files_of_a_session(tmp_path, protocol_path):
    """Whatever the umask."""
    before = os.umask(0)
    try:
        status, output = modaltouch("run", protocol_path, "-p", "p07", *RUN, "--results", tmp_path / "results")
    finally:
        os.umask(before)
    assert status == 0, output
    for path in (tmp_path / "results", *(tmp_path / "results").rglob("*")):
        assert path.stat().st_mode & 0o077 == 0, f"{path} has the mode {path.stat().st_mode:o}"
