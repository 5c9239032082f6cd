"""Windows' rules for files: that they are imposed, that they find what breaks them, and what is done about them."""

# What os and open do is the very subject.
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
    """Return a file of one line."""
    path = tmp_path / "file.txt"
    path.write_bytes(b"line\n")
    return path


# The rules are imposed


@WINDOWS
@pytest.mark.parametrize(("flag", "content"), [("O_BINARY", b"a\nb\n"), ("O_TEXT", b"a\r\nb\r\n")])
def test_a_descriptor_translates_line_feeds_unless_it_is_binary(tmp_path: Path, flag: str, content: bytes) -> None:
    """As `_write` of the C run-time library, which counts the bytes that it was given; reading turns them back."""
    descriptor = os.open(tmp_path / "file", os.O_RDWR | os.O_CREAT | getattr(os, flag))
    assert os.write(descriptor, b"a\nb\n") == 4
    os.lseek(descriptor, 0, os.SEEK_SET)
    assert os.read(descriptor, 100) == b"a\nb\n"
    os.close(descriptor)
    assert (tmp_path / "file").read_bytes() == content


@WINDOWS
def test_a_reused_number_is_another_descriptor(file: Path) -> None:
    """What is known of a closed one does not hold for a pipe of the same number."""
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
def test_a_file_that_is_open_keeps_its_names(file: Path, way: str) -> None:
    """Neither unlinked nor renamed nor replaced, by whichever name; once it is closed, it is."""
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
    """WinError 183; `Path.replace` is there for that."""
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
def test_what_another_process_has_open_or_locked_is_so_until_it_dies(file: Path) -> None:
    """Of whichever process: the system gives it free when that ends, however it does."""
    here, there = Pipe()
    process = multiprocessing.get_context("fork").Process(target=_keep_open, args=(file, there))
    process.start()
    try:
        assert here.poll(20), "the other process did not begin"
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
def test_what_is_locked_is_for_its_own_handle_alone(file: Path) -> None:
    """Not even this process reads or writes it through another handle; what is beside it is read."""
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
def test_no_folder_is_opened_and_no_reader_synced(file: Path) -> None:
    """`CreateFile` wants a flag for folders that nobody gives; FlushFileBuffers wants a handle that writes."""
    with pytest.raises(PermissionError, match="Permission denied"):
        os.open(file.parent, os.O_RDONLY)
    descriptor = os.open(file, os.O_RDONLY)
    for use in (lambda: os.fsync(descriptor), lambda: os.write(descriptor, b"x")):
        with pytest.raises(OSError, match="Bad file descriptor"):
            use()
    os.close(descriptor)


@WINDOWS
def test_text_is_the_country_s(tmp_path: Path) -> None:
    """CR LF and code page 1252, unless a program says otherwise."""
    (tmp_path / "a").write_text("µ\n")
    assert (tmp_path / "a").read_bytes() == b"\xb5\r\n"
    assert (tmp_path / "a").read_text() == "µ\n"
    with pytest.raises(UnicodeEncodeError):
        (tmp_path / "b").write_text("−\n")
    (tmp_path / "c").write_text("−\n", encoding="utf-8", newline="\n")
    assert (tmp_path / "c").read_bytes() == "−\n".encode()


@WINDOWS
@pytest.mark.parametrize("name", ["CON", "nul.txt", "a:b", "what?", "end.", "end "])
def test_some_names_are_none(tmp_path: Path, file: Path, name: str) -> None:
    """Devices, letters with a meaning, and ends that Windows cuts off."""
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
def test_what_unix_alone_has_is_absent(file: Path) -> None:
    """Modules, functions, and waiting for anything but sockets."""
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
def test_the_rules_end_where_they_should(file: Path) -> None:
    """What comes after them finds Linux as it was."""
    before = os.open, os.write, os.unlink, os.remove, builtins.open, io.open, select.select, sys.platform
    with windows_rules():
        assert os.open != before[0]
    assert before == (os.open, os.write, os.unlink, os.remove, builtins.open, io.open, select.select, sys.platform)
    assert not hasattr(os, "O_BINARY")
    with file.open():
        file.unlink()


# They find the mistakes that they are there for


@WINDOWS
def test_a_log_that_is_not_binary_is_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One byte more for each line than was written: no session could be begun."""
    monkeypatch.setattr(os, "O_BINARY", 0)
    with pytest.raises(RecordError, match="a line was cut while being written"):
        SessionLog.create(tmp_path / "session.jsonl", "start")
    assert list(tmp_path.iterdir()) == []


@WINDOWS
@pytest.mark.parametrize("way", ["link", "rename"])
def test_a_draft_that_gets_its_name_while_it_is_open_is_found_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    """What does on Unix, with hard links or without: no session could be begun."""

    def publish(log: SessionLog, draft: Path) -> None:
        if way == "link":
            os.link(draft, log.path)
            draft.unlink()
        draft.rename(log.path)

    monkeypatch.setattr(SessionLog, "_publish", publish)
    with pytest.raises(RecordError, match=f"cannot be created .*{BUSY}"):
        SessionLog.create(tmp_path / "session.jsonl", "start")


@WINDOWS
def test_a_lock_on_what_is_read_is_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody else could read the record of a session that is being run."""
    monkeypatch.setattr(operating_system, "LOCKED_BYTE", 0)
    with (
        SessionLog.create(tmp_path / "session.jsonl", "start") as log,
        pytest.raises(RecordError, match="locked a port"),
    ):
        read_chain(log.path)


# What is done about them


@WINDOWS
def test_a_session_is_begun_read_meanwhile_and_continued(tmp_path: Path) -> None:
    """Line by line the bytes of Unix; while it is open others read it and know that it is being run."""
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
    """A virus scanner: has a file open, until somebody has waited some times."""

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
def test_a_file_that_somebody_looks_at_is_replaced_once_it_is_closed(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A virus scanner has each new file open for a moment."""
    scanner = Scanner(file, monkeypatch, n_waits=3)
    replace_file(file, b"new\n", "close it")
    assert scanner.waits_left == 0
    assert file.read_bytes() == b"new\n"


@WINDOWS
def test_a_file_that_stays_open_is_told_and_kept(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A spreadsheet has the table open: after a second of patience, the sentence; the old file is whole."""
    monkeypatch.setattr(files, "PATIENCE", 0.05)
    with (
        file.open("rb"),
        pytest.raises(RecordError, match=r"file.txt: cannot be written \(Access is denied\); close it"),
    ):
        replace_file(file, b"new\n", "close it")
    assert [(path.name, path.read_bytes()) for path in file.parent.iterdir()] == [("file.txt", b"line\n")]


@UNIX
def test_on_unix_a_refused_rename_is_refused_at_once(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """There it means a folder of somebody else's."""

    def refuse(target: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("time.sleep", lambda seconds: pytest.fail("waited"))
    with pytest.raises(PermissionError, match="Permission denied"):
        files.move(refuse, file)


@WINDOWS
def test_a_log_that_is_taken_as_it_gets_its_name_is_left_to_whoever_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between its name and its lock there is a moment: a session that is resumed in it is not written to."""
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
def test_a_lock_that_is_kept_for_a_moment_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, of: str
) -> None:
    """Whoever asks whether a session is being run has its lock for an instant."""
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


def test_a_lock_that_is_kept_is_waited_for_no_longer_than_is_said(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock goes a second at each look."""
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


def test_a_log_for_other_programs_has_bare_line_feeds(tmp_path: Path) -> None:
    """`--events`, which may be a pipe."""
    generator = {"last_error": "", "outputs": [False, False]}
    lines = EventLines(tmp_path / "events.jsonl")
    for _ in range(2):
        lines.show({"event": "note", "generator": generator, "warnings": []})
    lines.close()
    content = (tmp_path / "events.jsonl").read_bytes()
    assert content.count(b"\n") == 2
    assert b"\r" not in content


def test_what_is_written_to_a_file_is_what_was_given(tmp_path: Path) -> None:
    """Byte by byte, control characters and ends of lines of all kinds; and its owner's alone."""
    content = bytes(range(256)) + b"\r\n\n\r\x1a"
    descriptor = open_file(tmp_path / "file", os.O_RDWR | os.O_CREAT)
    assert os.write(descriptor, content) == len(content)
    os.lseek(descriptor, 0, os.SEEK_SET)
    assert os.read(descriptor, 999) == content == (tmp_path / "file").read_bytes()
    os.close(descriptor)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o600
