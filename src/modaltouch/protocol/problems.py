"""What is wrong in a file, where, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from pydantic_core import PydanticCustomError


@dataclass(frozen=True, order=True)
class Problem:
    """One fault of one file.

    Attributes
    ----------
    file : str
        File, as the user named it.
    line, column : int
        Place of the fault, both from 1; 0 for a folder or file as a whole.
    path : str
        Key within the file, as in ``conditions.zone_pairs[1]``; empty for the file as a whole.
    given, allowed, remedy : str
        What is there, what is allowed, and what to do (empty if `allowed` says it).
    written : str
        Path where the user wrote it, below a group, a kind of session or a cell, or the column of a table; empty if
        that is `path`.
    """

    file: str
    line: int
    column: int
    path: str
    given: str
    allowed: str
    remedy: str = ""
    written: str = field(default="", compare=False)

    @property
    def message(self) -> str:
        """The fault without its place."""
        allowed = f"; allowed: {self.allowed}" if self.allowed else ""
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"given {self.given}{allowed}{remedy}"

    def __str__(self) -> str:
        path = f" {self.written or self.path}:" if self.path else ""
        place = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        return f"{place}:{path} {self.message}"

    def as_dict(self) -> dict[str, Any]:
        """Return the problem as plain values for ``--json``."""
        own = {"path": self.written or self.path, "message": self.message}
        return {key: value for key, value in (asdict(self) | own).items() if key != "written"}


class InputError(Exception):
    """Raised if files cannot be used; holds every fault of all of them, sorted by place.

    Parameters
    ----------
    problems : iterable of Problem
        At least one.
    """

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems: tuple[Problem, ...] = tuple(sorted(set(problems)))
        super().__init__("\n".join(str(problem) for problem in self.problems))

    @classmethod
    def of(cls, file: Path | str, given: str, allowed: str, remedy: str = "") -> Self:
        """Return an error with a single problem of a file or folder as a whole.

        Parameters
        ----------
        file : Path or str
            The file or folder.
        given, allowed, remedy : str
            As in `Problem`.
        """
        return cls([Problem(str(file), 0, 0, "", given, allowed, remedy)])


def fault(given: str, allowed: str, remedy: str = "") -> PydanticCustomError:
    """Return an error for a model's validator to raise, with the three parts that `Problem` reports."""
    from pydantic_core import PydanticCustomError

    return PydanticCustomError(
        "modaltouch",
        "given {given}; allowed: {allowed}; {remedy}",
        {"given": given, "allowed": allowed, "remedy": remedy},
    )


def format_path(path: Iterable[str | int]) -> str:
    """Return a path as it is printed.

    >>> format_path(("conditions", "zone_pairs", 1))
    'conditions.zone_pairs[1]'
    """
    text = ""
    for step in path:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text


def suggest(word: str, known: Iterable[str]) -> str:
    """Return the known word that `word` was probably meant to be, or an empty string.

    Words that differ only in their unit, as ``base_cm`` and ``base_mm``, match too.

    >>> suggest("peak_velocities_cm_s", ["zone_pairs", "peak_velocities_mm_s"])
    'peak_velocities_mm_s'
    """
    from difflib import get_close_matches

    folded = {name.casefold().replace("-", "_").replace(" ", "_"): name for name in sorted(known)}
    wanted = word.casefold().replace("-", "_").replace(" ", "_")
    if wanted in folded:
        return folded[wanted]
    close = get_close_matches(wanted, list(folded), n=1, cutoff=0.7)
    return folded[close[0]] if close else ""
