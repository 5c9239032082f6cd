"""Output folders: write all files or none, and never over files of another origin."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modaltouch.record import RecordError, move, replace_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MANIFEST = "manifest.json"

_MAKER = "modaltouch "
"""Prefix of ``generated_by`` in each manifest."""
_REMEDY = "give a folder you may write to with --out"


def write_files(
    folder: Path, contents: Mapping[str, Any], about: dict[str, Any], command: str = "analyse", **figures: Figure
) -> dict[str, Path]:
    """Write files into a folder, with a manifest of their names and hashes.

    Files are first written to a temporary folder beside it, so that a full disk or a kill leaves earlier files intact.

    Parameters
    ----------
    folder : Path
        Output folder; created if needed. Other files in it are left alone.
    contents : mapping
        Contents by file name: bytes or text, table rows for ``.csv``, plain values for other names, written as JSON.
    about : dict
        Provenance recorded in the manifest; plain values.
    command : str
        Command that made them; a folder belongs to one command.
    **figures : Figure
        Figures by name, each written as SVG and PNG.

    Returns
    -------
    dict of str to Path
        Path of each file.

    Raises
    ------
    RecordError
        If the folder belongs to another command, or an existing file is not from modaltouch, was changed since, or
        cannot be replaced.
    """
    refuse_other(folder, command)
    files = {name: _encode(name, content) for name, content in contents.items()} | _drawn(figures)
    about = {"generated_by": _MAKER + command, **about}
    _, known = _read_manifest(folder)
    for name in files:
        _refuse_foreign_file(folder / name, known.get(name, []))
    if not known:
        _refuse_foreign_file(folder / MANIFEST, [])
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    temporary = _new_folder(folder, folder.parent)
    try:
        for name, data in files.items():
            (temporary / name).write_bytes(data)
        # While files are replaced one by one, the manifest lists the hashes of both old and new ones.
        either = {name: sorted({*known.get(name, []), new}) for name, new in hashes.items()}
        folder.mkdir(exist_ok=True)
        replace_file(folder / MANIFEST, _manifest(about, {**known, **either}), _REMEDY)
        for name in files:
            move((temporary / name).replace, folder / name)
        for name in known.keys() - hashes.keys():
            (folder / name).unlink(missing_ok=True)
        replace_file(folder / MANIFEST, _manifest(about, {name: [value] for name, value in hashes.items()}), _REMEDY)
    except OSError as error:
        raise _cannot(folder, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return {name: folder / name for name in files}


def _drawn(figures: Mapping[str, Figure]) -> dict[str, bytes]:
    if not figures:
        return {}
    from modaltouch.report.page import figure_files

    return figure_files(figures)


def _encode(name: str, content: Any) -> bytes:
    if isinstance(content, bytes):
        return content
    if isinstance(content, str):
        return content.encode()
    if not name.endswith(".csv"):
        return (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(content[0]) if content else [], lineterminator="\n")
    writer.writeheader()
    for row in content:
        # None and NaN become empty fields.
        writer.writerow({key: value if value == value else None for key, value in row.items()})
    return buffer.getvalue().encode()


def refuse_other(folder: Path, command: str) -> None:
    """Refuse an output folder that cannot be written or belongs to another command, before long computations.

    Parameters
    ----------
    folder : Path
        Output folder.
    command : str
        Command that will write to it.

    Raises
    ------
    RecordError
        If the folder contains another command's output, is a file, or cannot be written.
    """
    standing = next(path for path in (folder, *folder.parents) if path.exists())
    if not standing.is_dir():
        raise RecordError(f"{standing}: is a file, but a folder is needed; give another one with --out")
    maker, _ = _read_manifest(folder)
    if maker not in ("", _MAKER + command):
        raise RecordError(
            f"{folder}: contains output of `{maker}`, which would be replaced; give another folder with --out"
        )
    for place in {standing, folder.parent}:
        if place.exists():
            # Permissions are not conclusive: root may write to /proc but cannot create a folder there.
            _new_folder(folder, place).rmdir()


def _new_folder(folder: Path, place: Path) -> Path:
    try:
        place.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".tmp", dir=place))
    except OSError as error:
        raise _cannot(folder, error) from error


def _manifest(about: dict[str, Any], hashes: dict[str, list[str]]) -> bytes:
    values = {**about, "files": dict(sorted(hashes.items()))}
    return (json.dumps(values, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _read_manifest(folder: Path) -> tuple[str, dict[str, list[str]]]:
    """Return the command that made a folder and the hashes of its files; empty without a manifest of this program."""
    try:
        values = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        maker, files = str(values["generated_by"]), values["files"].items()
        hashes = {name: [str(each) for each in known] for name, known in files if Path(name).name == name}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return "", {}
    return (maker, hashes) if maker.startswith(_MAKER) else ("", {})


def _refuse_foreign_file(path: Path, own: list[str]) -> None:
    if not path.exists():
        return
    try:
        found = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise _cannot(path, error) from error
    if found not in own:
        kind = "was changed since it was written" if own else "exists already and is not from modaltouch"
        raise RecordError(f"{path}: {kind} and is not overwritten; move it away, or give another folder with --out")


def _cannot(path: Path, error: OSError) -> RecordError:
    return RecordError(f"{path}: cannot be written ({error.strerror}); {_REMEDY}")
