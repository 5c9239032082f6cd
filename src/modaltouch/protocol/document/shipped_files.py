"""Files that come with the program, known by name: a protocol, an apparatus, an observer."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from modaltouch.protocol.document.problems import InputError, Problem, suggest
from modaltouch.protocol.document.source import YAML_FILE

Kind = Literal["protocol", "apparatus", "observer"]

_FOLDERS: dict[Kind, str] = {"protocol": ".", "apparatus": "apparatus", "observer": "observers"}


def shipped(kind: Kind) -> dict[str, Path]:
    """Return the shipped files of a kind by name: in the package once installed, beside the source in a checkout."""
    package = Path(__file__).parents[2]
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
