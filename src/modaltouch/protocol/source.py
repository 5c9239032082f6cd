"""The text of a file, as it is read and as the record keeps it; the files that come with the program."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

from modaltouch.protocol.problems import InputError, Problem, suggest

YAML_FILE = "a YAML file that exists and can be read"
"""What may be named where a file is wanted."""

SIZE_LIMIT = 256 * 1024
"""Longest file that is read [byte]: a hundred times the shipped ones."""


@dataclass(frozen=True)
class Source:
    """A file's text and where it came from.

    Attributes
    ----------
    path : Path
        File as it was named.
    text : str
        Its text, without a byte order mark.
    """

    path: Path
    text: str

    @cached_property
    def sha256(self) -> str:
        """Hash of the text in UTF-8."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def as_dict(self) -> dict[str, str]:
        """Return path, hash and text for the record."""
        return {"path": self.path.as_posix(), "sha256": self.sha256, "text": self.text}


def load_source(path: Path) -> Source:
    """Return the text of a file.

    Parameters
    ----------
    path : Path
        File to read.

    Raises
    ------
    InputError
        If there is no such file, or it is no UTF-8 text of at most 256 KiB.
    """
    try:
        if not path.exists():
            raise InputError([Problem(str(path), 1, 1, "", "a file that does not exist", YAML_FILE, "check its name")])
        if not path.is_file():
            raise InputError([Problem(str(path), 1, 1, "", "a folder or device", YAML_FILE, "")])
        with path.open("rb") as file:
            content = file.read(SIZE_LIMIT + 1)
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            [Problem(str(path), 1, 1, "", f"a file that cannot be read ({reason})", YAML_FILE, "")]
        ) from None
    if len(content) > SIZE_LIMIT:
        allowed = f"at most {SIZE_LIMIT // 1024} KiB of YAML"
        raise InputError([Problem(str(path), 1, 1, "", f"more than {SIZE_LIMIT // 1024} KiB", allowed, "")])
    try:
        return Source(path, content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        before = content[: error.start].decode("utf-8-sig", errors="replace")
        line, column = before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1
        given = f"byte 0x{content[error.start]:02x}, which is not UTF-8"
        remedy = "save the file in the encoding UTF-8"
        raise InputError([Problem(str(path), line, column, "", given, "text in UTF-8", remedy)]) from None


Kind = Literal["protocol", "apparatus", "observer"]

_FOLDERS: dict[Kind, str] = {"protocol": ".", "apparatus": "apparatus", "observer": "observers"}


def shipped(kind: Kind) -> dict[str, Path]:
    """Return the shipped files of a kind by name: in the package once installed, beside the source in a checkout."""
    package = Path(__file__).parents[1]
    installed = package / "protocols"
    folder = installed if installed.is_dir() else package.parents[1] / "protocols"
    return {file.stem: file for file in sorted((folder / _FOLDERS[kind]).glob("*.yaml"))}


def find(kind: Kind, name: Path | str) -> Path:
    """Return the file that a path, or the name of a shipped file, stands for; a file that exists wins.

    Raises
    ------
    InputError
        If there is neither, with the names that there are.
    """
    path, known = Path(name), shipped(kind)
    try:
        if path.is_file() or (path.exists() and str(name) not in known):
            return path
    except OSError:  # told by what reads it
        return path
    if str(name) not in known:
        remedy = f"did you mean '{meant}'?" if (meant := suggest(path.stem, known)) else "check its name"
        allowed = f"{YAML_FILE}, or one of {', '.join(known)}"
        raise InputError([Problem(str(name), 1, 1, "", "a file that does not exist", allowed, remedy)])
    return known[str(name)]
