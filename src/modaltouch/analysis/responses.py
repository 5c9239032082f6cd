"""Answers from a CSV file or a results tree -> one tidy table, every cell of the design filled.

The tidy table has one row for an answer (or, with a column ``n``, for a count of equal answers)::

    participant, finger_condition, zone_left, zone_right, velocity_mm_s, response
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modaltouch.document import InputError, Problem

if TYPE_CHECKING:
    import pandas as pd

    from modaltouch.record.log import Session

REQUIRED = ("participant", "finger_condition", "zone_left", "zone_right", "velocity_mm_s", "response")
CELL = ("finger_condition", "zone_left", "zone_right", "velocity_mm_s")


@dataclass(frozen=True)
class LeftOut:
    """Something that was found but not analysed.

    Attributes
    ----------
    source : str
        File, folder or rows.
    reason : str
        Why it stays out.
    """

    source: str
    reason: str


@dataclass(frozen=True)
class Source:
    """Where the answers come from.

    Attributes
    ----------
    path : str
        File or folder as it was named.
    kind : str
        ``csv`` or ``results``.
    sha256 : str
        Hash of the file, or of the hashes of the logs.
    mode : str
        ``real``, ``pilot`` or ``simulated``; empty for a CSV, which does not say.
    """

    path: str
    kind: str
    sha256: str
    mode: str = ""


@dataclass(frozen=True, eq=False)
class Responses:
    """Answers ready to be analysed.

    Attributes
    ----------
    frame : DataFrame
        Tidy table; ``response`` is categorical over all three answers, ``n`` counts equal answers.
    sessions : tuple of Session
        Recorded sessions the answers come from; empty for a CSV.
    left_out : tuple of LeftOut
        What was found but not used, and why.
    source : Source
        Where the answers come from.
    focus : str
        Zone at which the vibration was focused, if known.
    """

    frame: pd.DataFrame
    sessions: tuple[Session, ...]
    left_out: tuple[LeftOut, ...]
    source: Source
    focus: str = ""

    @property
    def start(self) -> dict[str, Any]:
        """Start record of the first session; empty for a CSV."""
        return self.sessions[0].start if self.sessions else {}


def read_responses(path: Path | str, *, mode: str | None = None) -> Responses:
    """Return the answers in a CSV file, a session log, or a tree of sessions.

    Parameters
    ----------
    path : Path or str
        A CSV file; or a results folder, or any folder or session log in it.
    mode : {"real", "pilot", "simulated"}, optional
        Which sessions of a tree to take. By default the real ones; where there are none, whichever single kind
        there is.

    Raises
    ------
    InputError
        With every fault found, its place and what to do: unknown words, missing columns or cells, doubled rows,
        a tree that mixes modes or protocols.
    """
    place = Path(path)
    if not place.exists():
        remedy = "check the name; results lie under results/<protocol> unless --results said otherwise"
        raise InputError(
            [Problem(str(place), 1, 1, "", "no such file or folder", "a CSV file or a results folder", remedy)]
        )
    if place.is_dir() or place.suffix == ".jsonl":
        from modaltouch.analysis.results_tree import read_tree

        return read_tree(place, mode)
    if mode:
        given, remedy = f"mode {mode!r} with a CSV file", "leave the mode out, or give a results folder"
        raise InputError([Problem(str(place), 1, 1, "", given, "a mode only with recorded sessions", remedy)])
    from modaltouch.analysis.tidy import read_csv

    return read_csv(place)
