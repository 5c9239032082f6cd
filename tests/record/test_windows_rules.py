"""Windows' rules for files: they are imposed, they reveal code that breaks them, and the record complies with them."""

# os and open are themselves under test.
# ruff: noqa: PTH107, PTH123

from __future__ import annotations

import builtins
import importlib
import io
import multiprocessing
import os
import select
import stat
import sys
from multiprocessing.connection import Pipe
from pathlib import Path
from typing import Any

import pytest
from windows_rules import UNIX_ONLY, windows_rules

from modaltouch.record import files
from modaltouch.record.chain import RecordError, read_chain
from modaltouch.record.files import hold, is_locked, open_file, replace_file
from modaltouch.record.folders import refuse_existing
from modaltouch.record.log import SessionLog
from modaltouch.session.console.consoles import EventLines
from modaltouch.system import operating_system
from modaltouch.system.operating_system import lock

WINDOWS = pytest.mark.parametrize("rules", ["windows"], indirect=True)
UNIX = pytest.mark.parametrize("rules", ["unix"], indirect=True)

BUSY = "being used by another process"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Return a file with one line."""
    path = tmp_path / "file.txt"
    path.write_bytes(b"line\n")
    return path


# The rules are imposed


@WINDOWS
@pytest.mark.parametrize(("flag", "content"), [("O_BINARY", b"a\nb\n"), ("O_TEXT", b"a\r\nb\r\n")])
def test_a_descriptor_translates_line_feeds_unless_it_is_binary(tmp_path: Path, flag: str, content: bytes) -> None:
    """As `_write` of the C run-time library: it counts the bytes it was given, and reading translates back."""
    descriptor = os.open(tmp_path / "file", os.O_RDWR | os.O_CREAT | getattr(os, flag))
    assert os.write(descriptor, b"a\nb\n") == 4
    os.lseek(descriptor, 0, os.SEEK_SET)
    assert os.read(descriptor, 100) == b"a\nb\n"
    os.close(descriptor)
    assert (tmp_path / "file").read_bytes() == content


@WINDOWS
def test_a_reused_descriptor_number_is_a_new_descriptor(file: Path) -> None:
    """The mode of a closed file does not carry over to a pipe with the same descriptor number."""
    number = os.open(file, os.O_WRONLY)
    os.close(number)
    reading, writing = os.pipe()
    assert number in (reading, writing)
    os.write(writing, b"a\nb\n")
    assert os.read(reading, 9) == b"a\nb\n"
    os.close(reading)
    os.close(writing)


@WINDOWS
@pytest.mark.parametrize("way", ["descriptor", "reading", "writing", "path"])
def test_an_open_file_cannot_be_unlinked_or_renamed(file: Path, way: str) -> None:
    """No hard link of an open file can be unlinked, renamed or replaced; after closing it can."""
    other, second = file.with_name("other"), file.with_name("second")
    other.touch()
    os.link(file, second)
    opened: Any = {
        "descriptor": lambda: os.fdopen(os.open(file, os.O_RDONLY)),
        "reading": lambda: open(file, encoding="utf-8"),  # noqa: SIM115
        "writing": lambda: open(file, "ab", buffering=0),  # noqa: SIM115
        "path": lambda: file.open("r+b"),
    }[way]()
    for name in (file, second):
        for change in (
            name.unlink,
            lambda name=name: os.remove(name),
            lambda name=name: name.rename(name.parent / "x"),
        ):
            with pytest.raises(PermissionError, match=BUSY) as refused:
                change()
            assert refused.value.winerror == 32  # type: ignore[attr-defined,unused-ignore]
        with pytest.raises(PermissionError, match=BUSY):
            name.replace(other)
        with pytest.raises(PermissionError, match="Access is denied"):
            other.replace(name)
    assert {path.name for path in file.parent.iterdir()} == {"file.txt", "other", "second"}
    opened.close()
    other.replace(file)
    second.unlink()
    assert [path.name for path in file.parent.iterdir()] == ["file.txt"]


@WINDOWS
def test_a_rename_never_replaces(file: Path) -> None:
    """It raises WinError 183; only `Path.replace` replaces."""
    other = file.with_name("other")
    other.write_bytes(b"other")
    with pytest.raises(FileExistsError, match="already exists"):
        file.rename(other)
    assert other.read_bytes() == b"other"
    assert file.replace(other).read_bytes() == b"line\n"


def _keep_open(path: Path, ready: Any) -> None:
    descriptor = os.open(path, os.O_RDWR | os.O_BINARY)  # type: ignore[attr-defined,unused-ignore]
    lock(descriptor)
    ready.send(is_locked(path))
    ready.recv()


@WINDOWS
def test_open_files_and_locks_of_another_process_end_with_it(file: Path) -> None:
    """The system releases both when the process ends, even by a kill."""
    here, there = Pipe()
    process = multiprocessing.get_context("fork").Process(target=_keep_open, args=(file, there))
    process.start()
    try:
        assert here.poll(20), "the other process did not start"
        assert here.recv() is True
        assert is_locked(file)
        with pytest.raises(PermissionError, match=BUSY):
            file.unlink()
    finally:
        process.kill()
        process.join()
    assert not is_locked(file)
    file.unlink()


@WINDOWS
def test_a_locked_range_is_accessible_to_its_handle_only(file: Path) -> None:
    """Even the same process cannot read or write it through another handle; bytes outside the range can be read."""
    msvcrt = importlib.import_module("msvcrt")
    descriptor = os.open(file, os.O_RDWR)
    msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 2)
    with open(file, "r+b", buffering=0) as other:
        for use in (other.read, lambda: other.read(1), lambda: other.readinto(bytearray(1)), lambda: other.write(b"x")):
            with pytest.raises(PermissionError, match="locked a portion"):
                use()
        other.seek(2)
        assert other.read() == b"ne\n"
        other.seek(0)
        with pytest.raises(PermissionError, match="Permission denied"):
            msvcrt.locking(other.fileno(), msvcrt.LK_NBLCK, 1)
    with pytest.raises(PermissionError, match="locked a portion"):
        file.read_text(encoding="utf-8")
    assert os.read(descriptor, 5) == b"line\n"
    os.lseek(descriptor, 0, os.SEEK_SET)
    msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 2)
    assert file.read_bytes() == b"line\n"
    os.close(descriptor)


@WINDOWS
def test_folders_cannot_be_opened_nor_read_only_files_synced(file: Path) -> None:
    """`CreateFile` requires a flag for folders that CPython does not set; FlushFileBuffers requires write access."""
    with pytest.raises(PermissionError, match="Permission denied"):
        os.open(file.parent, os.O_RDONLY)
    descriptor = os.open(file, os.O_RDONLY)
    for use in (lambda: os.fsync(descriptor), lambda: os.write(descriptor, b"x")):
        with pytest.raises(OSError, match="Bad file descriptor"):
            use()
    os.close(descriptor)


@WINDOWS
def test_text_defaults_to_the_local_code_page(tmp_path: Path) -> None:
    """Without an explicit encoding, text is written in code page 1252 with CR LF."""
    (tmp_path / "a").write_text("µ\n")
    assert (tmp_path / "a").read_bytes() == b"\xb5\r\n"
    assert (tmp_path / "a").read_text() == "µ\n"
    with pytest.raises(UnicodeEncodeError):
        (tmp_path / "b").write_text("−\n")
    (tmp_path / "c").write_text("−\n", encoding="utf-8", newline="\n")
    assert (tmp_path / "c").read_bytes() == "−\n".encode()


@WINDOWS
@pytest.mark.parametrize("name", ["CON", "nul.txt", "a:b", "what?", "end.", "end "])
def test_reserved_file_names_are_refused(tmp_path: Path, file: Path, name: str) -> None:
    """Device names, reserved characters, and a trailing dot or space, which Windows strips."""
    for make in (
        (tmp_path / name).touch,
        (tmp_path / name).mkdir,
        lambda: file.rename(tmp_path / name),
        lambda: file.replace(tmp_path / name),
        lambda: os.link(file, tmp_path / name),
    ):
        with pytest.raises(OSError, match="syntax is incorrect"):
            make()


@WINDOWS
def test_unix_only_features_are_absent(file: Path) -> None:
    """Modules and functions of Unix are missing, and select takes sockets only."""
    for module in ("fcntl", "termios", "resource"):
        with pytest.raises(ImportError):
            importlib.import_module(module)
    assert not [name for name in UNIX_ONLY if hasattr(os, name)]
    reading, writing = os.pipe()
    with pytest.raises(OSError, match="not a socket"):
        select.select([reading], [], [], 0)
    os.close(reading)
    os.close(writing)


@UNIX
def test_the_rules_end_with_their_context(file: Path) -> None:
    """After the context Linux's functions are restored."""
    before = os.open, os.write, os.unlink, os.remove, builtins.open, io.open, select.select, sys.platform
    with windows_rules():
        assert os.open != before[0]
    assert before == (os.open, os.write, os.unlink, os.remove, builtins.open, io.open, select.select, sys.platform)
    assert not hasattr(os, "O_BINARY")
    with file.open():
        file.unlink()


# The rules reveal the mistakes they are meant to reveal.


@WINDOWS
def test_a_log_opened_in_text_mode_is_detected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each line is one byte longer than written, so that no session could start."""
    monkeypatch.setattr(os, "O_BINARY", 0)
    with pytest.raises(RecordError, match="a line was cut while being written"):
        SessionLog.create(tmp_path / "session.jsonl", "start")
    assert list(tmp_path.iterdir()) == []


@WINDOWS
@pytest.mark.parametrize("way", ["link", "rename"])
def test_publishing_a_draft_while_it_is_open_is_detected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    """It works on Unix, by hard link or by rename, but on Windows no session could start."""

    def publish(log: SessionLog, draft: Path) -> None:
        if way == "link":
            os.link(draft, log.path)
            draft.unlink()
        draft.rename(log.path)

    monkeypatch.setattr(SessionLog, "_publish", publish)
    with pytest.raises(RecordError, match=f"cannot be created .*{BUSY}"):
        SessionLog.create(tmp_path / "session.jsonl", "start")


@WINDOWS
def test_a_lock_on_bytes_that_are_read_is_detected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other programs could not read the record of a running session."""
    monkeypatch.setattr(operating_system, "LOCKED_BYTE", 0)
    with (
        SessionLog.create(tmp_path / "session.jsonl", "start") as log,
        pytest.raises(RecordError, match="locked a port"),
    ):
        read_chain(log.path)


# The record complies with the rules.


@WINDOWS
def test_a_session_is_started_read_while_running_and_continued(tmp_path: Path) -> None:
    """Other programs can read the log while it is open and see that it is locked."""
    path = tmp_path / "session.jsonl"
    with SessionLog.create(path, "start") as log:
        log.append("note", text="µ")
        assert [event["event"] for event in read_chain(path).events] == ["start", "note"]
        assert is_locked(path)
        with pytest.raises(RecordError, match="running this session now"):
            refuse_existing(path)
        with pytest.raises(RecordError, match="another process is writing"):
            SessionLog.reopen(path)
    assert not is_locked(path)
    path.write_bytes(path.read_bytes()[:-9])
    with SessionLog.reopen(path) as log:
        log.append("resume")
    assert read_chain(path).problems == ()
    assert b"\r" not in path.read_bytes()
    assert list(tmp_path.iterdir()) == [path]


class Scanner:
    """A virus scanner, which holds a file open until it has been waited for a number of times."""

    def __init__(self, path: Path, monkeypatch: pytest.MonkeyPatch, n_waits: int) -> None:
        self.waits_left = n_waits
        self._file = path.open("rb") if path.exists() else None
        self._path = path
        monkeypatch.setattr("time.sleep", self.wait)

    def wait(self, seconds: float) -> None:
        self.waits_left -= 1
        if self.waits_left == 0 and self._file is not None:
            self._file.close()


@WINDOWS
def test_a_file_open_elsewhere_is_replaced_once_it_is_closed(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A virus scanner opens each new file for a moment."""
    scanner = Scanner(file, monkeypatch, n_waits=3)
    replace_file(file, b"new\n", "close it")
    assert scanner.waits_left == 0
    assert file.read_bytes() == b"new\n"


@WINDOWS
def test_a_file_that_stays_open_is_reported_and_kept(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A spreadsheet holds the table open: after the waiting time an error is raised, and the old file is whole."""
    monkeypatch.setattr(files, "PATIENCE", 0.05)
    with (
        file.open("rb"),
        pytest.raises(RecordError, match=r"file.txt: cannot be written \(Access is denied\); close it"),
    ):
        replace_file(file, b"new\n", "close it")
    assert [(path.name, path.read_bytes()) for path in file.parent.iterdir()] == [("file.txt", b"line\n")]


@UNIX
def test_on_unix_a_refused_rename_is_not_retried(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On Unix it means that the folder belongs to another user."""

    def refuse(target: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("time.sleep", lambda seconds: pytest.fail("waited"))
    with pytest.raises(PermissionError, match="Permission denied"):
        files.move(refuse, file)


@WINDOWS
def test_a_log_locked_by_another_process_when_published_is_left_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the rename and the lock another process may resume the session; it is then not written to."""
    path, real = tmp_path / "session.jsonl", files.move
    taken: list[SessionLog] = []

    def move(rename: Any, target: Path) -> None:
        real(rename, target)
        taken.append(SessionLog.reopen(path))

    monkeypatch.setattr("modaltouch.record.log.move", move)
    with pytest.raises(RecordError, match="another process is writing this session"):
        SessionLog.create(path, "start")
    taken[0].append("resume")
    taken[0].close()
    chain = read_chain(path)
    assert ([event["event"] for event in chain.events], chain.problems) == (["start", "resume"], ())
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("of", ["log", "folder"])
def test_a_briefly_held_lock_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, of: str) -> None:
    """Checking whether a session is running holds its lock for an instant."""
    path = tmp_path / ("session.jsonl" if of == "log" else ".lock")
    if of == "log":
        SessionLog.create(path, "start").close()
    asker = os.open(path, os.O_RDWR | os.O_CREAT)
    lock(asker)
    monkeypatch.setattr("time.sleep", lambda seconds: os.close(asker))
    if of == "log":
        SessionLog.reopen(path).close()
    else:
        with hold(tmp_path):
            assert is_locked(path)
    assert not is_locked(path)


def test_waiting_for_a_lock_ends_at_the_timeout(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulated clock advances one second per reading."""
    seconds = iter(range(100))
    monkeypatch.setattr("time.monotonic", lambda: next(seconds))
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    first, second = (os.open(file, os.O_RDWR) for _ in range(2))
    lock(first)
    with pytest.raises(OSError, match="unavailable|denied"):
        lock(second, files.LOCK_PATIENCE)
    assert next(seconds) == files.LOCK_PATIENCE + 2
    os.close(first)
    os.close(second)


def test_the_event_log_has_bare_line_feeds(tmp_path: Path) -> None:
    """The target of `--events` may be a pipe."""
    generator = {"last_error": "", "outputs": [False, False]}
    lines = EventLines(tmp_path / "events.jsonl")
    for _ in range(2):
        lines.show({"event": "note", "generator": generator, "warnings": []})
    lines.close()
    content = (tmp_path / "events.jsonl").read_bytes()
    assert content.count(b"\n") == 2
    assert b"\r" not in content


def test_a_file_holds_exactly_the_bytes_written(tmp_path: Path) -> None:
    """All byte values and all kinds of line ends are kept, and the mode is 0600."""
    content = bytes(range(256)) + b"\r\n\n\r\x1a"
    descriptor = open_file(tmp_path / "file", os.O_RDWR | os.O_CREAT)
    assert os.write(descriptor, content) == len(content)
    os.lseek(descriptor, 0, os.SEEK_SET)
    assert os.read(descriptor, 999) == content == (tmp_path / "file").read_bytes()
    os.close(descriptor)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o600
