"""Input files: what is wrong with them, their text as read and as kept in the record, and the shipped files."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

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


EMPTY = "an empty text", "at least one word", "write what the participant should read"
"""What is wrong with a text that is shown and has no word, in the three parts of a `Problem`."""


def format_path(path: Iterable[str | int]) -> str:
    """Format a path for messages.

    >>> format_path(("conditions", "zone_pairs", 1))
    'conditions.zone_pairs[1]'
    """
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).removeprefix(".")


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


YAML_FILE = "a YAML file that exists and can be read"
"""Description of a valid file name, for messages."""

SIZE_LIMIT = 256 * 1024
"""Size of the largest file that is read, a hundred times that of the shipped files [byte]."""


Kind = Literal["protocol", "apparatus", "observer", "fingers"]

_FOLDERS: dict[Kind, str] = {"protocol": ".", "apparatus": "apparatus", "observer": "observers", "fingers": "fingers"}


@dataclass(frozen=True)
class Source:
    """Text and origin of a file.

    Attributes
    ----------
    path : Path
        File, as named by the user.
    text : str
        Text, without a byte order mark.
    """

    path: Path
    text: str

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the text in UTF-8."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def as_dict(self) -> dict[str, str]:
        """Return path, hash and text for the record."""
        return {"path": self.path.as_posix(), "sha256": self.sha256, "text": self.text}

    @classmethod
    def load(cls, path: Path) -> Source:
        """Read the text of a file.

        Parameters
        ----------
        path : Path
            File to read.

        Raises
        ------
        InputError
            If there is no such file, or it is not UTF-8 text of at most 256 KiB.
        """

        def refused(
            given: str, allowed: str = YAML_FILE, remedy: str = "", place: tuple[int, int] = (1, 1)
        ) -> InputError:
            return InputError([Problem(str(path), *place, "", given, allowed, remedy)])

        try:
            if not path.exists():
                raise refused("a file that does not exist", remedy="check its name")
            if not path.is_file():
                raise refused("a folder or device")
            with path.open("rb") as file:
                content = file.read(SIZE_LIMIT + 1)
        except (OSError, ValueError) as error:  # ValueError: a null character in the name
            reason = getattr(error, "strerror", None) or str(error)
            raise refused(f"a file that cannot be read ({reason})") from None
        if len(content) > SIZE_LIMIT:
            raise refused(f"more than {SIZE_LIMIT // 1024} KiB", f"at most {SIZE_LIMIT // 1024} KiB")
        try:
            return cls(path, content.decode("utf-8-sig"))
        except UnicodeDecodeError as error:
            before = content[: error.start].decode("utf-8-sig", errors="replace")
            place = before.count("\n") + 1, len(before) - before.rfind("\n")
            given = f"byte 0x{content[error.start]:02x}, which is not UTF-8"
            raise refused(given, "text in UTF-8", "save the file in the encoding UTF-8", place) from None

    @classmethod
    def find(cls, kind: Kind, name: Path | str) -> Source:
        """Read the text of a file given by path, or by the name of a shipped file."""
        path, known = Path(name), cls.shipped(kind)
        try:
            is_given = path.is_file() or (path.exists() and str(name) not in known)
        except OSError:  # reported when it is read
            is_given = True
        if not is_given and str(name) not in known:
            raise InputError([_unknown(path, known)])
        return cls.load(path if is_given else known[str(name)])

    @classmethod
    def shipped_text(cls, kind: Kind, name: str) -> Source:
        """Read the text of a shipped file; the path is its name alone, independent of the installation.

        Raises
        ------
        InputError
            If there is no such file; lists the shipped names.
        """
        known = cls.shipped(kind)
        if name not in known:
            raise InputError([_unknown(Path(name), known)])
        return cls(Path(f"{name}.yaml"), cls.load(known[name]).text)

    @staticmethod
    def shipped(kind: Kind) -> dict[str, Path]:
        """Return the shipped files of a kind by name."""
        package = Path(__file__).parents[1]
        # In the package if installed, beside the source in a checkout.
        installed = package / "protocols"
        folder = installed if installed.is_dir() else package.parents[1] / "protocols"
        return {file.stem: file for file in sorted((folder / _FOLDERS[kind]).glob("*.yaml"))}


@dataclass(frozen=True)
class Sources:
    """The files of an experiment, as read.

    Attributes
    ----------
    protocol, apparatus, texts : Source
        Path, text and hash of each.
    calibration : Source or None
        The calibration, if any.
    field : Source or None
        The points of the target field, if in a file.
    fingers : Source or None
        The fingers for which the stimulus is designed, if any.
    table : Source or None
        The table of cells, if any.
    at_samples : bool
        Whether peak speeds are sought at the starts of samples only, as in records that do not say otherwise.
    """

    protocol: Source
    apparatus: Source
    texts: Source
    calibration: Source | None = None
    field: Source | None = None
    fingers: Source | None = None
    table: Source | None = None
    at_samples: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return path, hash and text of each file for the record."""
        return {name: source.as_dict() for name, source in vars(self).items() if isinstance(source, Source)}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Sources:
        """Restore sources from the output of `as_dict`."""
        files: dict[str, Any] = {name: Source(Path(each["path"]), str(each["text"])) for name, each in values.items()}
        return cls(**files)

    @classmethod
    def recorded(cls, start: dict[str, Any]) -> Sources:
        """Return the copies in a start record, whose peak speeds are found as they were then."""
        return replace(cls.from_dict(start["sources"]), at_samples="peaks" not in start.get("stimulus", {}))


def _unknown(path: Path, known: Iterable[str]) -> Problem:
    return Problem(
        str(path),
        1,
        1,
        "",
        "a file that does not exist",
        f"{YAML_FILE}, or one of {', '.join(known)}",
        f"did you mean '{meant}'?" if (meant := suggest(path.stem, known)) else "check its name",
    )
