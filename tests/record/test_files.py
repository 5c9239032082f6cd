"""A file is written whole or not at all."""

import errno
import fcntl
import os
import stat
import sys
from pathlib import Path

import pytest

from modaltouch.record.chain import RecordError
from modaltouch.record.files import OWNER_ALONE, is_locked, prepare_file, replace_file
from modaltouch.system import sync_file

SOURCE = Path(__file__).parents[2] / "src" / "modaltouch"


def test_a_replaced_file_is_complete_and_readable_by_its_owner_only(tmp_path):
    """The mode is 0600 and no temporary file is left."""
    path = tmp_path / "table.tsv"
    replace_file(path, b"old\n", "free the place", OWNER_ALONE)
    replace_file(path, b"new\n", "free the place", OWNER_ALONE)
    assert path.read_text() == "new\n"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_a_failed_write_is_reported_and_leaves_the_old_entry(tmp_path):
    """A folder occupies the path of the file."""
    (tmp_path / "table.tsv").mkdir()
    with pytest.raises(RecordError, match=r"table.tsv: cannot be written .* free the place"):
        replace_file(tmp_path / "table.tsv", b"new\n", "free the place")
    assert list(tmp_path.iterdir()) == [tmp_path / "table.tsv"]


def test_a_disk_that_becomes_read_only_is_reported(tmp_path, monkeypatch):
    """Linux remounts a failing disk read-only (ext4: errors=remount-ro): nothing is written, and nothing removed."""

    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(os, "open", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(RecordError, match=r"table.tsv: cannot be written \(Read-only file system\); free the place"):
        replace_file(tmp_path / "table.tsv", b"new\n", "free the place")


def test_content_is_synced_before_the_rename(tmp_path, monkeypatch, rules):
    """Content, rename, then the folder (not on Windows): after a crash the old or the new file is whole."""
    done = []
    real_sync, real_replace = os.fsync, Path.replace

    def sync(descriptor):
        done.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else os.fstat(descriptor).st_size)
        real_sync(descriptor)

    def replace(self, target):
        done.append("name")
        return real_replace(self, target)

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(Path, "replace", replace)
    n_open = len(list(Path("/dev/fd").iterdir()))
    replace_file(tmp_path / "table.tsv", b"12345\n", "free the place")
    assert done == [6, "name", *(["folder"] if rules == "unix" else [])]
    assert len(list(Path("/dev/fd").iterdir())) == n_open


def test_an_existing_output_file_is_refused_before_the_work(tmp_path):
    """An existing file may be in use; the folders of a new one are created."""
    path = tmp_path / "new" / "folder" / "file.yaml"
    prepare_file(path)
    prepare_file(path)
    assert path.parent.is_dir()
    path.write_text("old\n")
    with pytest.raises(RecordError, match=r"file.yaml: exists already and is not overwritten; give another file"):
        prepare_file(path)
    with pytest.raises(RecordError, match=r"deeper.yaml: cannot be written .*; give another file with --out"):
        prepare_file(path / "deeper.yaml")
    assert [each.name for each in path.parent.iterdir()] == ["file.yaml"]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that exists and takes no file")
def test_an_unwritable_output_file_is_refused_before_the_work():
    """No file can be created in /proc, whatever its permissions."""
    with pytest.raises(RecordError, match=r"/proc/file.yaml: cannot be written .*; give another file with --out"):
        prepare_file(Path("/proc/file.yaml"))


@pytest.mark.parametrize("rules", ["unix"], indirect=True)
@pytest.mark.parametrize(
    ("platform", "refused", "done"),
    [
        ("linux", False, ["fsync 7"]),
        ("darwin", False, ["F_FULLFSYNC 7"]),
        ("darwin", True, ["F_FULLFSYNC 7", "fsync 7"]),
    ],
)
def test_a_sync_reaches_past_the_drive_cache(monkeypatch, platform, refused, done):
    """On macOS fsync stops at the drive cache (fsync(2)); F_FULLFSYNC (fcntl(2)) flushes it, where supported."""
    called = []

    def control(descriptor, command):
        called.append(f"{command} {descriptor}")
        if refused:
            raise OSError(errno.ENOTSUP, "Operation not supported")

    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(fcntl, "F_FULLFSYNC", "F_FULLFSYNC", raising=False)
    monkeypatch.setattr(fcntl, "fcntl", control)
    monkeypatch.setattr(os, "fsync", lambda descriptor: called.append(f"fsync {descriptor}"))
    sync_file(7)
    assert called == done


def test_only_one_module_calls_fsync():
    """Every sync goes through operating_system.py."""
    calls = [path.name for path in SOURCE.rglob("*.py") if "fsync(" in path.read_text(encoding="utf-8")]
    assert calls == ["operating_system.py"]


def test_a_missing_log_is_not_locked(tmp_path):
    """A log that does not exist is not being recorded."""
    assert is_locked(tmp_path / "session.jsonl") is False
