from __future__ import annotations

import json
from pathlib import Path

import pytest

from modaltouch.record.chain import RecordError
from modaltouch.report.page import MANIFEST, refuse_other, write_files


def test_files_are_written_with_a_manifest_of_their_hashes(tmp_path) -> None:
    """SHA-256 of "abc" as in FIPS 180-2, appendix B.1."""
    write_files(tmp_path / "out", {"a.txt": b"abc"}, {"version": "1"})
    manifest = json.loads((tmp_path / "out" / MANIFEST).read_text(encoding="utf-8"))
    assert manifest["files"]["a.txt"] == ["ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"]


def test_rows_and_values_are_written_in_the_format_of_the_extension(tmp_path) -> None:
    """CSV leaves non-numbers empty and quotes where needed (RFC 4180); JSON keeps the values."""
    rows = [{"a": 1, "b": float("nan"), "c": 'x, "y"'}, {"a": 80.0, "b": float("inf"), "c": None}]
    files = write_files(tmp_path / "out", {"t.csv": rows, "v.json": {"p": 0.5}, "page.html": "µ"}, {})
    assert files["t.csv"].read_bytes() == b'a,b,c\n1,,"x, ""y"""\n80.0,inf,\n'
    assert files["v.json"].read_bytes() == b'{\n "p": 0.5\n}\n'
    assert files["page.html"].read_bytes() == "µ".encode()


def test_own_files_are_replaced_and_stale_ones_removed(tmp_path) -> None:
    """A second analysis removes the files of the first that it does not write."""
    write_files(tmp_path / "out", {"a.txt": b"1", "b.txt": b"1"}, {})
    write_files(tmp_path / "out", {"a.txt": b"2"}, {})
    assert (tmp_path / "out" / "a.txt").read_bytes() == b"2"
    assert not (tmp_path / "out" / "b.txt").exists()


def test_a_file_not_in_the_manifest_is_never_overwritten(tmp_path) -> None:
    """A file of the same name that no manifest lists is left unchanged."""
    (tmp_path / "report.html").write_text("mine")
    with pytest.raises(RecordError, match="report.html: exists already and is not from modaltouch"):
        write_files(tmp_path, {"other.txt": b"", "report.html": b"new"}, {})
    assert (tmp_path / "report.html").read_text() == "mine"
    assert not (tmp_path / "other.txt").exists()


def test_a_file_changed_by_hand_is_not_overwritten(tmp_path) -> None:
    """Notes that someone added to the table are kept."""
    write_files(tmp_path / "out", {"tests.csv": b"1"}, {})
    (tmp_path / "out" / "tests.csv").write_text("1, my note")
    with pytest.raises(RecordError, match="was changed since it was written"):
        write_files(tmp_path / "out", {"tests.csv": b"2"}, {})


def test_other_files_in_the_folder_are_left_alone(tmp_path) -> None:
    """Files of other names, such as notes, stay unchanged."""
    (tmp_path / "notes.txt").write_text("mine")
    write_files(tmp_path, {"a.txt": b"1"}, {})
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_manifest_of_another_program_is_not_overwritten(tmp_path) -> None:
    """manifest.json is a common name."""
    (tmp_path / MANIFEST).write_text('{"name": "web app"}')
    with pytest.raises(RecordError, match=r"manifest\.json: exists already"):
        write_files(tmp_path, {"a.txt": b"1"}, {})


def test_a_manifest_cannot_list_files_outside_its_folder(tmp_path) -> None:
    """A manifest with `..` in a path deletes nothing."""
    (tmp_path / "precious.txt").write_text("mine")
    folder = tmp_path / "out"
    write_files(folder, {"a.txt": b"1"}, {})
    manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    manifest["files"]["../precious.txt"] = ["0"]
    (folder / MANIFEST).write_text(json.dumps(manifest))
    write_files(folder, {"a.txt": b"2"}, {})
    assert (tmp_path / "precious.txt").exists()


def test_an_interrupted_folder_can_be_written_again(tmp_path, monkeypatch) -> None:
    """After a kill between two files, the manifest covers both the old and the new ones."""
    from pathlib import Path

    folder = tmp_path / "out"
    write_files(folder, {"a.txt": b"1", "b.txt": b"1"}, {})
    replace = Path.replace

    def die(self, target):
        if Path(target).name == "b.txt":
            raise KeyboardInterrupt
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", die)
    with pytest.raises(KeyboardInterrupt):
        write_files(folder, {"a.txt": b"2", "b.txt": b"2"}, {})
    monkeypatch.setattr(Path, "replace", replace)
    write_files(folder, {"a.txt": b"3", "b.txt": b"3"}, {})
    assert ((folder / "a.txt").read_bytes(), (folder / "b.txt").read_bytes()) == (b"3", b"3")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


def test_a_file_where_the_folder_should_be_is_refused(tmp_path) -> None:
    """The message gives the file and says that a folder is needed."""
    (tmp_path / "out").write_text("mine")
    for place in (tmp_path / "out", tmp_path / "out" / "below"):
        with pytest.raises(RecordError, match="out: is a file, but a folder is needed"):
            refuse_other(place, "validate")
    with pytest.raises(RecordError, match="is a file, but a folder is needed"):
        write_files(tmp_path / "out", {"a.txt": b"1"}, {})


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that exists and takes none")
@pytest.mark.parametrize("folder", ["/proc/out", "/proc/out/below", "/proc"])
def test_an_unwritable_folder_is_refused_before_the_work(folder) -> None:
    """No folder can be created in /proc, whatever its permissions."""
    with pytest.raises(RecordError, match=f"{folder}: cannot be written .*; give a folder you may write to with --out"):
        refuse_other(Path(folder), "validate")


def test_checking_whether_a_folder_is_writable_leaves_nothing(tmp_path) -> None:
    """Neither the folder nor its parents are created."""
    refuse_other(tmp_path / "new" / "out", "validate")
    refuse_other(tmp_path, "validate")
    assert list(tmp_path.iterdir()) == []
