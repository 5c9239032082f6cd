"""Problems of input files: what is wrong, where, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from pydantic_core import PydanticCustomError


@dataclass(frozen=True, order=True)
class Problem:
    """A problem of an input file.

    Attributes
    ----------
    file : str
        File, as named by the user.
    line, column : int
        Position of the problem, both from 1; 0 for a folder or file as a whole.
    path : str
        Key within the file, as in ``conditions.zone_pairs[1]``; empty for the file as a whole.
    given, allowed, remedy : str
        The given value, what is allowed, and what to do (empty if obvious from `allowed`).
    written : str
        Path at which the user wrote the value, below a group, a kind of session or a cell, or the column of a table;
        empty if equal to `path`.
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
        """The problem without its position."""
        allowed = f"; allowed: {self.allowed}" if self.allowed else ""
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"given {self.given}{allowed}{remedy}"

    def __str__(self) -> str:
        path = f" {self.written or self.path}:" if self.path else ""
        place = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        return f"{place}:{path} {self.message}"

    def as_dict(self) -> dict[str, Any]:
        """Return the problem as a JSON-serialisable dict for ``--json``."""
        own = {"path": self.written or self.path, "message": self.message}
        return {key: value for key, value in (asdict(self) | own).items() if key != "written"}


class InputError(Exception):
    """Raised if files cannot be used; lists all their problems, sorted by position.

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
    """Return an error to be raised by a model's validator, with the three parts of a `Problem`."""
    from pydantic_core import PydanticCustomError

    return PydanticCustomError(
        "modaltouch",
        "given {given}; allowed: {allowed}; {remedy}",
        {"given": given, "allowed": allowed, "remedy": remedy},
    )


def format_path(path: Iterable[str | int]) -> str:
    """Format a path for messages.

    >>> format_path(("conditions", "zone_pairs", 1))
    'conditions.zone_pairs[1]'
    """
    text = ""
    for step in path:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text


def suggest(word: str, known: Iterable[str]) -> str:
    """Return the known word most similar to `word`, or an empty string.

    Words that differ only in their unit, such as ``base_cm`` and ``base_mm``, match too.

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
