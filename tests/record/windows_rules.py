"""The rules of Windows for files, imposed on this process under Linux.

Where Windows differs, as implemented by CPython and the C run-time library:

- A descriptor of `os.open` without ``O_BINARY`` turns every line feed into CR LF, and back.
- A file that any program has open cannot be unlinked, renamed or replaced, by any of its hard links (Python opens
  none with ``FILE_SHARE_DELETE``); a rename never replaces.
- A lock (`msvcrt.locking`) belongs to a handle and is mandatory: no other handle reads or writes locked bytes.
- A folder cannot be opened, a read-only descriptor cannot be synced, pipes cannot be selected.
- Text without an explicit encoding is in the local code page, with CR LF.
- Some names are devices, some characters are not allowed. Unix-only features are absent.

Other processes under these rules are respected: open files and locked bytes are marked by kernel locks that
belong to an open file description (``F_OFD_SETLK``) and end with it, at offsets far beyond any content.
"""

# os and open are themselves what is replaced.
# ruff: noqa: PTH112, PTH113, PTH119

from __future__ import annotations

import builtins
import contextlib
import errno
import fcntl
import io
import itertools
import os
import re
import select
import shutil
import stat
import struct
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest

O_BINARY, O_TEXT, O_NOINHERIT = 0x8000, 0x4000, 0x80
SHARING_VIOLATION, ACCESS_DENIED, ALREADY_EXISTS, INVALID_NAME = 32, 5, 183, 123
CODE_PAGE = "cp1252"
MARKS = 1 << 61
"""From this byte on each open file has one that is locked."""

UNIX_ONLY = (
    *("killpg", "setsid", "getpgrp", "getpgid", "tcgetpgrp", "getuid", "geteuid", "mkfifo", "pread", "pwrite"),
    *("sched_setscheduler", "sched_param", "setpriority", "O_NONBLOCK", "O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW"),
)
_numbers = itertools.count()
_DEVICES = re.compile(r"(?i:con|prn|aux|nul|(com|lpt)[0-9])(\..*)?")
_FORBIDDEN = re.compile(r'[<>:"|?*\x00-\x1f]|[. ]\Z')


def refusal(winerror: int, words: str, path: object, kind: type[OSError] = PermissionError) -> OSError:
    """Return the error that Windows raises."""
    number = {FileExistsError: errno.EEXIST, PermissionError: errno.EACCES}.get(kind, errno.EINVAL)
    error = kind(number, words, str(path))
    error.winerror = winerror  # type: ignore[attr-defined,unused-ignore]
    return error


def in_use(path: object) -> OSError:
    """Return the error for a file that another program has open."""
    words = "The process cannot access the file because it is being used by another process"
    return refusal(SHARING_VIOLATION, words, path)


def locking(descriptor: int, kind: int, start: int, length: int, *, ask: bool = False) -> bool:
    """Lock bytes of an open file, or test whether they can be locked; return whether another open file prevents it."""
    command = fcntl.F_OFD_GETLK if ask else fcntl.F_OFD_SETLK
    wanted = struct.pack("hhqqi4x", kind, os.SEEK_SET, start, length, 0)
    try:
        told = fcntl.fcntl(descriptor, command, wanted)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EAGAIN):
            return True
        raise
    return ask and struct.unpack("hhqqi4x", told)[0] != fcntl.F_UNLCK


class Rules:
    """The replacements for functions of `os`, `io` and `msvcrt`."""

    def __init__(self) -> None:
        self._real = {name: getattr(os, name) for name in ("open", "read", "write", "unlink", "rename", "replace")}
        self._real |= {name: getattr(os, name) for name in ("fsync", "link", "mkdir")} | {"select": select.select}
        self._opened: dict[int, tuple[tuple[int, int], bool, bool]] = {}

    # Files

    def open(self, path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        """`os.open`."""
        refuse_name(path)
        if os.path.isdir(path):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        access = flags & (os.O_RDONLY | os.O_WRONLY | os.O_RDWR)
        real_flags = flags & ~(O_BINARY | O_TEXT | O_NOINHERIT)
        descriptor = self._open_for_locks(path, real_flags, mode)
        about = os.fstat(descriptor)
        if stat.S_ISREG(about.st_mode):
            # An exclusive lock requires a writable descriptor.
            kind = fcntl.F_WRLCK if writes(descriptor) else fcntl.F_RDLCK
            assert not locking(descriptor, kind, MARKS + (os.getpid() << 20) + next(_numbers), 1), (
                "the mark of another file"
            )
            self._opened[descriptor] = (about.st_dev, about.st_ino), not flags & O_BINARY, access != os.O_RDONLY
        return descriptor

    def _open_for_locks(self, path: Any, flags: int, mode: int) -> int:
        access = flags & (os.O_RDONLY | os.O_WRONLY | os.O_RDWR)
        if access != os.O_RDWR and os.path.isfile(path) and not flags & os.O_EXCL:
            with contextlib.suppress(OSError):
                return int(self._real["open"](path, flags & ~access | os.O_RDWR, mode))
        return int(self._real["open"](path, flags, mode))

    def _known(self, descriptor: int) -> tuple[bool, bool] | None:
        """Return whether a descriptor is in text mode and whether it is writable; None if it was not opened here."""
        known = self._opened.get(descriptor)
        if known is None:
            return None
        about = os.fstat(descriptor)
        return known[1:] if known[0] == (about.st_dev, about.st_ino) else None

    def read(self, descriptor: int, n: int) -> bytes:
        """`os.read`."""
        known = self._known(descriptor)
        if known is None:
            return bytes(self._real["read"](descriptor, n))
        refuse_locked(descriptor, n)
        data: bytes = self._real["read"](descriptor, n)
        return data.replace(b"\r\n", b"\n") if known[0] else data

    def write(self, descriptor: int, data: Any) -> int:
        """`os.write`; returns the number of bytes requested, without those added."""
        known = self._known(descriptor)
        if known is None:
            return int(self._real["write"](descriptor, data))
        is_text, may_write = known
        if not may_write:
            raise OSError(errno.EBADF, "Bad file descriptor")
        refuse_locked(descriptor, len(data))
        if not is_text:
            return int(self._real["write"](descriptor, data))
        translated = bytes(data).replace(b"\n", b"\r\n")
        written: int = self._real["write"](descriptor, translated)
        return len(data) if written == len(translated) else len(translated[:written].replace(b"\r\n", b"\n"))

    def fsync(self, descriptor: int) -> None:
        """`os.fsync`."""
        known = self._known(descriptor)
        if known is not None and not known[1]:
            raise OSError(errno.EBADF, "Bad file descriptor")
        self._real["fsync"](descriptor)

    # Names

    def unlink(self, path: Any, *, dir_fd: int | None = None) -> None:
        """`os.unlink` and `os.remove`."""
        if self._is_open(path):
            raise in_use(path)
        self._real["unlink"](path)

    def rename(self, source: Any, target: Any) -> None:
        """`os.rename`."""
        refuse_name(target)
        if self._is_open(source):
            raise in_use(source)
        if os.path.lexists(target):
            raise refusal(ALREADY_EXISTS, "Cannot create a file when that file already exists", target, FileExistsError)
        self._real["rename"](source, target)

    def replace(self, source: Any, target: Any) -> None:
        """`os.replace`."""
        refuse_name(target)
        if self._is_open(source):
            raise in_use(source)
        if os.path.isdir(target) or self._is_open(target):
            raise refusal(ACCESS_DENIED, "Access is denied", target)
        self._real["replace"](source, target)

    def link(self, source: Any, target: Any) -> None:
        """`os.link`; allowed for an open file too."""
        refuse_name(target)
        self._real["link"](source, target)

    def mkdir(self, path: Any, mode: int = 0o777, *, dir_fd: int | None = None) -> None:
        """`os.mkdir`."""
        refuse_name(path)
        self._real["mkdir"](path, mode)

    def _is_open(self, path: Any) -> bool:
        if not os.path.isfile(path):
            return False
        descriptor = self._real["open"](path, os.O_RDONLY)
        try:
            return locking(descriptor, fcntl.F_WRLCK, MARKS, 0, ask=True)
        finally:
            os.close(descriptor)

    # Streams

    def open_stream(
        self,
        file: Any,
        mode: str = "r",
        buffering: int = -1,
        encoding: str | None = None,
        errors: str | None = None,
        newline: str | None = None,
        closefd: bool = True,
        opener: Any = None,
    ) -> Any:
        """`open`."""
        open_file = opener or (lambda path, flags: self.open(path, flags, 0o666))
        raw = _File(
            file,
            mode.translate({ord("b"): None, ord("t"): None}),
            closefd,
            None if isinstance(file, int) else lambda path, flags: open_file(path, flags | O_BINARY),
        )
        if buffering == 0:
            return raw
        kind: Any = io.BufferedWriter if set(mode) & set("wax") else io.BufferedReader
        buffer = (io.BufferedRandom if "+" in mode else kind)(raw)
        if "b" in mode:
            return buffer
        if encoding in (None, "locale"):
            encoding = CODE_PAGE
        text = io.TextIOWrapper(
            buffer, encoding, errors, "\r\n" if newline is None and kind is io.BufferedWriter else newline
        )
        text.mode = mode  # type: ignore[misc]
        return text

    def select(self, reading: Any, writing: Any, odd: Any, timeout: float | None = None) -> Any:
        """`select.select`."""
        for each in (*reading, *writing, *odd):
            number = each if isinstance(each, int) else each.fileno()
            if not stat.S_ISSOCK(os.fstat(number).st_mode):
                raise OSError(10038, "An operation was attempted on something that is not a socket")
        return self._real["select"](reading, writing, odd, timeout)

    def msvcrt(self) -> ModuleType:
        """Return the replacement of the module."""
        module = ModuleType("msvcrt")
        module.LK_UNLCK, module.LK_LOCK, module.LK_NBLCK = 0, 1, 2  # type: ignore[attr-defined]

        def lock(descriptor: int, mode: int, n: int) -> None:
            start = os.lseek(descriptor, 0, os.SEEK_CUR)
            if locking(descriptor, fcntl.F_UNLCK if mode == 0 else fcntl.F_WRLCK, start, n):
                raise PermissionError(errno.EACCES, "Permission denied")

        module.locking = lock  # type: ignore[attr-defined]
        return module


class _File(io.FileIO):
    """A binary file that respects the locks of other handles."""

    def readinto(self, buffer: Any) -> Any:
        refuse_locked(self.fileno(), len(memoryview(buffer).cast("B")))
        return super().readinto(buffer)

    def read(self, size: int | None = -1) -> Any:
        if size is None or size < 0:
            return self.readall()
        refuse_locked(self.fileno(), size)
        return super().read(size)

    def readall(self) -> Any:
        refuse_locked(self.fileno(), max(os.fstat(self.fileno()).st_size, 1))
        return super().readall()

    def write(self, data: Any) -> Any:
        refuse_locked(self.fileno(), len(memoryview(data).cast("B")))
        return super().write(data)


def writes(descriptor: int) -> bool:
    """Return whether a descriptor is writable."""
    return fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE != os.O_RDONLY


def refuse_locked(descriptor: int, n: int) -> None:
    """Raise if any of the next bytes is locked by another handle."""
    about = os.fstat(descriptor)
    if not stat.S_ISREG(about.st_mode):
        return
    appends = fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_APPEND
    start = about.st_size if appends else os.lseek(descriptor, 0, os.SEEK_CUR)
    if n and locking(descriptor, fcntl.F_RDLCK, start, n, ask=True):
        words = "The process cannot access the file because another process has locked a portion of the file"
        raise refusal(33, words, descriptor)


def refuse_name(path: Any) -> None:
    """Raise if Windows does not allow the file name."""
    if isinstance(path, int):
        return
    name = os.path.basename(os.fsdecode(path))
    if _DEVICES.fullmatch(name) or _FORBIDDEN.search(name):
        words = "The filename, directory name, or volume label syntax is incorrect"
        raise refusal(INVALID_NAME, words, path, OSError)


@contextlib.contextmanager
def windows_rules() -> Iterator[None]:
    """Impose the rules on this process; files opened earlier keep the old ones."""
    rules = Rules()
    with pytest.MonkeyPatch.context() as patch:
        for name in ("open", "read", "write", "fsync", "unlink", "rename", "replace", "link", "mkdir"):
            patch.setattr(os, name, getattr(rules, name))
        patch.setattr(os, "remove", rules.unlink)
        for name, value in (("O_BINARY", O_BINARY), ("O_TEXT", O_TEXT), ("O_NOINHERIT", O_NOINHERIT)):
            patch.setattr(os, name, value, raising=False)
        for name in UNIX_ONLY:
            patch.delattr(os, name)
        patch.setattr(io, "open", rules.open_stream)
        patch.setattr(builtins, "open", rules.open_stream)
        patch.setattr(select, "select", rules.select)
        for name in ("fcntl", "termios", "resource", "pwd", "grp"):
            patch.setitem(sys.modules, name, None)
        patch.setitem(sys.modules, "msvcrt", rules.msvcrt())
        patch.setattr(shutil, "_use_fd_functions", False)
        patch.setattr(sys, "platform", "win32")
        yield
