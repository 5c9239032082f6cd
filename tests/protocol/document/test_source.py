"""Files to texts."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pytest

from modaltouch.protocol.source import InputError, Source


def test_the_hash_is_that_of_the_file(tmp_path: Path) -> None:
    """`sha256sum` of the same bytes."""
    file = tmp_path / "a.yaml"
    file.write_bytes("é: 1\n".encode())
    assert Source.load(file).sha256 == hashlib.sha256(b"\xc3\xa9: 1\n").hexdigest()


def test_a_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    """Windows editors write one; YAML allows it."""
    file = tmp_path / "a.yaml"
    file.write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert Source.load(file).text == "a: 1\n"


def test_the_record_keeps_path_hash_and_text() -> None:
    """These suffice to read the file again."""
    source = Source(Path("p") / "a.yaml", "a: 1\n")
    assert source.as_dict() == {"path": "p/a.yaml", "sha256": source.sha256, "text": "a: 1\n"}


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"a: 1\nb: \xff\n", r"a.yaml:2:4: given byte 0xff, which is not UTF-8; .*; save the file in .* UTF-8"),
        ("a: 1\n".encode("utf-16"), r"a.yaml:1:1: given byte 0xff, which is not UTF-8"),
        (b"a" * 300_000, r"a.yaml:1:1: given more than 256 KiB"),
    ],
)
def test_long_files_and_other_encodings_are_refused(tmp_path: Path, content: bytes, fault: str) -> None:
    """Byte positions counted by hand."""
    file = tmp_path / "a.yaml"
    file.write_bytes(content)
    with pytest.raises(InputError, match=fault):
        Source.load(file)


def test_anything_but_a_regular_file_is_refused(tmp_path: Path) -> None:
    """A missing file, a folder, a pipe that would never end, and an impossible name."""
    os.mkfifo(tmp_path / "pipe")
    for name, fault in (
        ("nothing.yaml", "a file that does not exist"),
        (".", "a folder or device"),
        ("pipe", "a folder or device"),
        ("a\0b", "cannot be read|does not exist"),
        ("a" * 5000, "cannot be read|does not exist"),
    ):
        with pytest.raises(InputError, match=fault):
            Source.load(tmp_path / name)
