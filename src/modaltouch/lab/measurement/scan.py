"""A scan as it was recorded: ``scan.json`` says what was played, one ``position_<n>.npz`` holds each position."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.record import RecordError, RecordInputError

FloatArray = NDArray[np.float64]

SCHEMA = "modaltouch scan 1"
DESCRIPTION = "scan.json"


@dataclass(frozen=True, eq=False)
class Scan:
    """Velocity and drive at the positions of a scan, in SI units.

    Attributes
    ----------
    facts : dict
        What ``scan.json`` says: what was played, apparatus, instruments, acquisition, mode.
    positions : (n_positions,) array
        Where it was recorded, origin at mid-beam [m]; a scan that was stopped has fewer than were planned.
    arrays : tuple of dict
        What was kept at each position; with whole records ``time``, ``velocity`` and ``drive``.
    overloaded : tuple of tuple of str
        What reached the end of its range, at each position.
    sampling_rate : float
        By the scope's clock [Hz].
    """

    facts: Mapping[str, Any]
    positions: FloatArray
    arrays: tuple[Mapping[str, NDArray[Any]], ...]
    overloaded: tuple[tuple[str, ...], ...]
    sampling_rate: float

    @property
    def complete(self) -> bool:
        """Whether every planned position was recorded."""
        return len(self.arrays) == len(self.facts["settings"]["positions_mm"])

    @property
    def mode(self) -> str:
        """``simulated`` or ``real``."""
        return str(self.facts["mode"])

    @property
    def time(self) -> FloatArray:
        """From the trigger, by the scope's clock, (n_samples,) array [s]."""
        return np.asarray(self._one("time"), dtype=float)

    @cached_property
    def velocity(self) -> FloatArray:
        """Of each position, (n_positions, n_records, n_samples) array [m/s]."""
        return self.stacked("velocity")

    @cached_property
    def drive(self) -> FloatArray:
        """Voltage at the beam, (n_positions, n_records, n_drives, n_samples) array [V]."""
        return self.stacked("drive")

    def stacked(self, name: str) -> FloatArray:
        """Return what was kept under a name, position after position.

        Raises
        ------
        KeyError
            If this scan keeps nothing under that name.
        """
        self._one(name)
        return np.stack([np.asarray(each[name], dtype=float) for each in self.arrays])

    def require_complete(self) -> Scan:
        """Return the scan itself if every position was recorded.

        Raises
        ------
        RecordInputError
            If it was stopped half way.
        """
        planned = len(self.facts["settings"]["positions_mm"])
        if not self.complete:
            raise RecordInputError(
                f"the scan was stopped half way, with {len(self.arrays)} of {planned} positions recorded: give the "
                "command that began it again, with the same folder, to go on with it"
            )
        return self

    def refuse_overloaded(self) -> Scan:
        """Return the scan itself if nothing reached the end of its range.

        Raises
        ------
        RecordInputError
            If something did, with where.
        """
        for position, names in zip(self.positions, self.overloaded, strict=True):
            if names:
                raise RecordInputError(
                    f"{' and '.join(names)} reached the end of the range at {position * 1e3:g} mm, so the record is "
                    "cut: scan again into another folder, with a wider range or a lower drive"
                )
        return self

    def _one(self, name: str) -> NDArray[Any]:
        first = self.arrays[0] if self.arrays else {}
        if name not in first:
            raise KeyError(f"this scan keeps {', '.join(first) or 'nothing'} at each position, no {name}")
        return first[name]


def position_file(folder: Path, index: int) -> Path:
    """Return where a position's arrays lie."""
    return folder / f"position_{index:03}.npz"


def read_facts(folder: Path) -> dict[str, Any]:
    """Return what ``scan.json`` says.

    Raises
    ------
    RecordError
        If the folder holds no scan, or its description is damaged.
    """
    path = folder / DESCRIPTION
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RecordInputError(f"{folder}: holds no scan ({DESCRIPTION} is missing); name a scan's folder") from None
    except (OSError, ValueError) as error:
        raise RecordError(f"{path}: cannot be read ({error}); restore it, or scan again into another folder") from None
    if not isinstance(facts, dict) or facts.get("schema") != SCHEMA:
        raise RecordError(f"{path}: is no description of a scan ('{SCHEMA}'); name a scan's folder")
    return facts


def read_position(path: Path, position: float) -> dict[str, NDArray[Any]]:
    """Return the arrays of a position's file.

    Raises
    ------
    RecordError
        If the file is damaged or another position's.
    """
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays = dict(file)
        where = float(arrays["position"])
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise RecordError(
            f"{path}: is damaged ({error}); delete it, and give the command that began the scan again to take that "
            "position anew"
        ) from None
    if abs(where - position) > 1e-9:
        raise RecordError(f"{path}: was recorded at {where * 1e3:g} mm, not at {position * 1e3:g} mm; put it back")
    return arrays


def read_scan(folder: Path) -> Scan:
    """Return a scan, complete or not, as far as its first positions are recorded.

    Parameters
    ----------
    folder : Path
        Where it lies.

    Raises
    ------
    RecordError
        If it is no scan, or damaged.
    """
    facts = read_facts(folder)
    places = np.array(facts["settings"]["positions_mm"], dtype=float) * 1e-3
    kept: list[dict[str, NDArray[Any]]] = []
    for index, place in enumerate(places):
        path = position_file(folder, index)
        if not path.exists():
            break
        kept.append(read_position(path, float(place)))
    return assemble(facts, places, kept)


def assemble(facts: Mapping[str, Any], places: FloatArray, kept: list[dict[str, NDArray[Any]]]) -> Scan:
    """Return the scan of what was kept at the first positions."""
    return Scan(
        facts=facts,
        positions=places[: len(kept)],
        arrays=tuple(kept),
        overloaded=tuple(tuple(str(name) for name in each["overloaded"]) for each in kept),
        sampling_rate=float(kept[0]["sampling_rate"]) if kept else float("nan"),
    )
