"""Scans: a burst recorded at one position after another, each record saved before the next is taken.

``scan.json`` describes the scan, ``position_<n>.npz`` holds a position's arrays; an interrupted scan can be resumed::

    plan = ScanPlan(burst, velocity=0.2, positions=np.linspace(-0.05, 0.05, 41), acquisition=Acquisition(...))
    with open_laboratory(apparatus) as laboratory:
        scan = take_scan(laboratory, plan, folder, source=Source.find("apparatus", path))

Without a folder nothing is written.
"""

from __future__ import annotations

import io
import json
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.common import FloatArray
from modaltouch.lab.laboratory import Laboratory
from modaltouch.protocol import Apparatus, Source
from modaltouch.record import RecordError, RecordInputError, replace_file
from modaltouch.rig import Acquisition, Recording
from modaltouch.stimulus import Burst
from modaltouch.system import Interrupted, commit, versions

SCHEMA = "modaltouch scan 1"
DESCRIPTION = "scan.json"
NEEDED = (
    {"mode", "begun", "settings"},
    {"about", "burst", "velocity_mm_s", "positions_mm", "acquisition", "generator", "scope"},
)
"""Keys of the description, and of its settings, that every scan has."""

LARGEST_SHIFT = 20e-9
"""Largest difference between sampling instants that count as equal [s]."""

WRONG_DRIVE = 2.5
"""Factor between measured and predicted peak of a drive above which it is that of another output, or none [1]."""


@dataclass(frozen=True, eq=False)
class ScanPlan:
    """The burst, positions and scope settings of a scan."""

    burst: Burst  # the burst that the generator repeats
    velocity: float  # level at which it is played [m/s]
    positions: Sequence[float]  # measurement positions, in the order of recording, origin at mid-beam [m]
    acquisition: Acquisition  # settings of the scope at each position
    # further metadata as plain values: name of the stimulus, actuator set, ...
    about: Mapping[str, Any] = field(default_factory=dict)
    across: float = 0.0  # distance of the row of positions from the beam's mid-line [m]
    peak_drive: Sequence[float] = ()  # predicted peak of each drive [V]; a record far from it is refused


@dataclass(frozen=True, eq=False)
class Scan:
    """Velocity and drive at the positions of a scan, in SI units."""

    facts: Mapping[str, Any]  # contents of ``scan.json``: what was played, apparatus, instruments, acquisition, mode
    # arrays kept for each position; ``time``, ``velocity`` and ``drive`` if whole records are kept
    arrays: tuple[Mapping[str, NDArray[Any]], ...]

    @property
    def positions(self) -> FloatArray:
        """Recorded positions, origin at mid-beam [m]; fewer than planned if the scan was interrupted."""
        return np.array(self.facts["settings"]["positions_mm"][: len(self.arrays)], dtype=float) * 1e-3

    @property
    def complete(self) -> bool:
        """Whether every planned position was recorded."""
        return len(self.arrays) == len(self.facts["settings"]["positions_mm"])

    @property
    def across(self) -> float:
        """Distance of the row of positions from the beam's mid-line [m]."""
        return float(self.facts["settings"].get("across_mm", 0.0)) * 1e-3

    @property
    def time(self) -> FloatArray:
        """Time since the trigger by the scope's clock, (n_samples,) array [s]."""
        return np.asarray(self.arrays[0]["time"], dtype=float)

    @cached_property
    def velocity(self) -> FloatArray:
        """Velocity at each position, (n_positions, n_records, n_samples) array [m/s]."""
        return self.stacked("velocity", 3)

    @cached_property
    def drive(self) -> FloatArray:
        """Voltage at the beam, (n_positions, n_records, n_drives, n_samples) array [V]."""
        return self.stacked("drive", 4)

    def stacked(self, name: str, n_dimensions: int = 2) -> FloatArray:
        """Return the arrays kept under a name, stacked over the positions."""
        try:
            values = np.stack([np.asarray(each[name], dtype=float) for each in self.arrays])
            if values.ndim != n_dimensions:
                raise ValueError(f"it has {values.ndim - 1} dimensions instead of {n_dimensions - 1}")
            return values
        except (KeyError, ValueError) as error:
            raise RecordInputError(f"the positions do not all hold {name} in one form ({error}); scan again") from None

    def require_complete(self) -> Scan:
        """Return the scan itself; refuse one that was interrupted."""
        planned = len(self.facts["settings"]["positions_mm"])
        if not self.complete:
            raise RecordInputError(
                f"the scan was interrupted after {len(self.arrays)} of {planned} positions: to continue it, run the "
                "same command with the same folder"
            )
        return self


def _refuse_unusable(position: float, own: Mapping[str, NDArray[Any]], first: Mapping[str, NDArray[Any]]) -> None:
    """Refuse arrays of a position that are clipped, or whose sampling instants differ from those of the first one."""
    if own["overloaded"].size:
        raise RecordInputError(
            f"{' and '.join(own['overloaded'])} reached the end of the range at {position * 1e3:g} mm, so the record "
            "is clipped: widen the range and continue, or scan again into another folder with a lower drive"
        )
    instants, before = (np.asarray(each.get("time", 0.0)) for each in (own, first))
    if instants.shape != before.shape or np.abs(instants - before).max() > LARGEST_SHIFT:
        raise RecordInputError(
            f"the sampling instants at {position * 1e3:g} mm differ from those of the positions before: set the scope "
            "as it was and continue, or scan again into another folder"
        )


def refuse_unexpected_drive(drive: FloatArray, predicted: Sequence[float], position: float) -> None:
    """Refuse the record of a position whose drives, an (n_records, n_drives, n_samples) array [V], are not expected."""
    for output, (volts, peak) in enumerate(zip(np.abs(drive).max(axis=(0, 2)), predicted, strict=False), start=1):
        if not 1 / WRONG_DRIVE < max(volts, 1.0) / max(peak, 1.0) < WRONG_DRIVE:
            raise RecordInputError(
                f"the drive of output {output} measures {volts:.2g} V at {position * 1e3:g} mm, and {peak:.0f} V are "
                "predicted: check which probe is at which output, and its attenuation, and measure again"
            )


def position_file(folder: Path, index: int) -> Path:
    """Return the file of a position's arrays."""
    return folder / f"position_{index:03}.npz"


def read_facts(folder: Path) -> dict[str, Any]:
    """Return the contents of ``scan.json``.

    Raises
    ------
    RecordError
        If the folder holds no scan, or its description is damaged.
    """
    path = folder / DESCRIPTION
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RecordInputError(
            f"{folder}: there is no scan here ({DESCRIPTION} is missing); give a scan's folder"
        ) from None
    except (OSError, ValueError) as error:
        raise RecordError(f"{path}: cannot be read ({error}); restore it, or scan again into another folder") from None
    if not isinstance(facts, dict) or facts.get("schema") != SCHEMA:
        raise RecordError(f"{path}: it does not describe a scan ('{SCHEMA}'); give a scan's folder")
    for kept, needed in zip((facts, facts.get("settings")), NEEDED, strict=True):
        missing = sorted(needed - kept.keys()) if isinstance(kept, dict) else ["settings"]
        if missing:
            raise RecordError(f"{path}: {missing[0]} is missing; restore it, or scan again into another folder")
    settings = facts["settings"]
    numbers = [settings["velocity_mm_s"], settings.get("across_mm", 0.0)]
    places = settings["positions_mm"]
    if not (
        isinstance(places, list)
        and places
        and isinstance(settings["burst"], dict)
        and all(isinstance(each, (int, float)) for each in (*numbers, *places))
    ):
        raise RecordError(f"{path}: positions_mm, across_mm, velocity_mm_s or burst has another form; restore it")
    return facts


def read_position(path: Path, position: float) -> dict[str, NDArray[Any]]:
    """Return the arrays of a position's file."""
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays = dict(file)
        where = float(arrays["position"])
        faulty = next(
            (name for name, each in arrays.items() if each.dtype.kind in "fc" and not np.isfinite(each).all()), ""
        )
        if faulty or arrays.get("overloaded", np.zeros(())).ndim != 1:
            raise ValueError(f"{faulty} is not finite throughout" if faulty else "overloaded is missing or no list")
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise RecordError(
            f"{path}: it is damaged ({error}); delete it and repeat the command of the scan, which then measures that "
            "position again"
        ) from None
    if abs(where - position) > 1e-9:
        raise RecordError(f"{path}: it was recorded at {where * 1e3:g} mm, not at {position * 1e3:g} mm; put it back")
    return arrays


def read_scan(folder: Path) -> Scan:
    """Read a scan, complete or not, up to the first missing position.

    Raises
    ------
    RecordError
        If the folder holds no scan, a damaged one, or one with a clipped record or other sampling instants.
    """
    facts = read_facts(folder)
    return Scan(facts, tuple(_recorded(folder, facts)))


Reduction = Callable[[Recording], Mapping[str, NDArray[Any]]]
"""Function that reduces a recording to the arrays to keep, by name."""

_REMEDY = "move it away, or give another"


def keep_velocities(recording: Recording) -> dict[str, NDArray[Any]]:
    """Keep all records of the velocity [m/s], but only the mean of the drive over the records [V]."""
    return {
        "time": recording.time,
        "velocity": recording.velocity.astype(np.float32),
        "drive": recording.drive.mean(axis=0, keepdims=True).astype(np.float32),
    }


def take_scan(
    laboratory: Laboratory,
    plan: ScanPlan,
    folder: Path | None = None,
    *,
    source: Source | None = None,
    reduction: Reduction = keep_velocities,
    step: str = "points",
) -> Scan:
    """Take a scan, or resume an interrupted one, and return it.

    Parameters
    ----------
    laboratory : Laboratory
        Generator and scope, open; its progress may stop the scan between two positions.
    plan : ScanPlan
        Burst, positions and scope settings.
    folder : Path, optional
        Folder in which each position is saved at once, and from which an interrupted scan is resumed.
    source, reduction, step
        The apparatus file, kept in the description; what to keep of each recording; name under which progress is shown.

    Raises
    ------
    RigError
        If the rig fails; the outputs are off, and the positions recorded so far are kept.
    RecordInputError
        If a record is clipped, its drive is not the expected one, or its sampling instants differ from those of the
        first; it is not kept.
    RecordError
        If the folder holds a scan with other settings or something else, or cannot be written.
    """
    facts = _describe(laboratory, plan, source, reduction)
    places = np.array(facts["settings"]["positions_mm"]) * 1e-3
    kept = [] if folder is None else _begin(folder, facts, plan)
    laboratory.progress.show(step, len(kept), len(places))
    if len(kept) < len(places):
        laboratory.load(plan.burst)
    try:
        for index in range(len(kept), len(places)):
            laboratory.progress.check()
            recording = laboratory.record(float(places[index]), plan.velocity, plan.acquisition, plan.across)
            saved = {
                "position": np.array(recording.position),
                "sampling_rate": np.array(recording.sampling_rate),
                "overloaded": np.array(recording.overloaded, dtype="U16"),
            }
            kept.append({**saved, **reduction(recording)})
            _refuse_unusable(float(places[index]), kept[-1], kept[0])
            # At an output that is not driven, single records show the converter's steps.
            refuse_unexpected_drive(recording.drive.mean(axis=0, keepdims=True), plan.peak_drive, recording.position)
            if folder is not None:
                save_arrays(position_file(folder, index), kept[-1])
            laboratory.progress.show(step, len(kept), len(places))
    except (Interrupted, KeyboardInterrupt) as error:
        where = f"{len(kept)} of {len(places)} points are kept in {folder}; run the same command again to continue"
        error.add_note("nothing measured is kept" if folder is None else where)
        raise
    return Scan(facts, tuple(kept))


def _describe(laboratory: Laboratory, plan: ScanPlan, source: Source | None, reduction: Reduction) -> dict[str, Any]:
    burst, acquisition = plan.burst, plan.acquisition
    # These must be the same when a scan is resumed.
    settings = {
        "about": dict(plan.about),
        "burst": {
            "sha256": burst.content_hash,
            "n_samples": int(burst.codes.shape[1]),
            "duration_s": burst.duration,
            "repetition_rate_Hz": burst.repetition_rate,
            "velocity_mm_s": burst.velocity * 1e3,
            "amplitude_V": list(burst.amplitude),
        },
        "velocity_mm_s": plan.velocity * 1e3,
        "positions_mm": [place * 1e3 for place in plan.positions],
        **({"across_mm": plan.across * 1e3} if plan.across else {}),
        "acquisition": {**asdict(acquisition), "drives": list(acquisition.drives)},
        "kept": getattr(reduction, "__name__", type(reduction).__name__),
        "apparatus_sha256": "" if source is None else source.sha256,
        "generator": laboratory.rig.identity,
        "scope": laboratory.scope.identity,
        "mode": laboratory.mode,
    }
    return {
        "schema": SCHEMA,
        "mode": laboratory.mode,
        # Pass the settings through JSON, so that they compare equal to those read from a file.
        "settings": json.loads(json.dumps(settings)),
        "apparatus": None if source is None else source.as_dict(),
        "begun": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "versions": versions(),
        "commit": commit(),
    }


def _begin(folder: Path, facts: dict[str, Any], plan: ScanPlan) -> list[dict[str, NDArray[Any]]]:
    """Return the arrays of the positions already recorded, or write the description of a new scan."""
    if (folder / DESCRIPTION).exists():
        found = read_facts(folder)
        _refuse_other(folder, found["settings"], facts["settings"])
        facts |= {key: found[key] for key in ("begun", "apparatus", "versions", "commit") if key in found}
        return _recorded(folder, facts)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        strange = next((each.name for each in sorted(folder.iterdir()) if not each.name.startswith(".")), None)
    except OSError as error:
        raise RecordError(f"{folder}: cannot be used ({error.strerror}); give another folder") from error
    if strange is not None:
        raise RecordError(f"{folder}: it contains {strange}, which is not part of a scan; give an empty or new folder")
    save_arrays(folder / "burst.npz", {"codes": plan.burst.codes})
    replace_file(folder / DESCRIPTION, (json.dumps(facts, indent=1, ensure_ascii=False) + "\n").encode(), _REMEDY)
    return []


def _recorded(folder: Path, facts: Mapping[str, Any]) -> list[dict[str, NDArray[Any]]]:
    """Return the arrays kept at the first positions of a scan; refuse one that cannot be used."""
    kept: list[dict[str, NDArray[Any]]] = []
    for index, place in enumerate(facts["settings"]["positions_mm"]):
        path = position_file(folder, index)
        if not path.exists():
            break
        kept.append(read_position(path, place * 1e-3))
        _refuse_unusable(place * 1e-3, kept[-1], kept[0])
    return kept


def _refuse_other(folder: Path, found: dict[str, Any], asked: dict[str, Any]) -> None:
    """Refuse to continue a scan with other settings, naming the differences."""
    if found == asked:
        return
    from pandas import json_normalize

    before, now = (json_normalize(each).iloc[0].to_dict() for each in (found, asked))
    different = [name for name in sorted(map(str, {*before, *now})) if before.get(name) != now.get(name)]
    shown = "; ".join(f"{name} was {before.get(name)}, now {now.get(name)}" for name in different[:3])
    more = f" and {len(different) - 3} more" if len(different) > 3 else ""
    raise RecordError(
        f"{folder}: it contains a scan with other settings ({shown}{more}); continue with its original settings, "
        "or give another folder"
    )


def save_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays as an npz file atomically."""
    buffer = io.BytesIO()
    np.savez(buffer, **dict(arrays))  # type: ignore[arg-type]
    replace_file(path, buffer.getvalue(), _REMEDY)


def rows_over(apparatus: Apparatus, n_rows: int) -> tuple[float, ...]:
    """Return evenly spaced distances of rows from the mid-line, from edge to edge and including 0 [m].

    Raises
    ------
    ValueError
        If the number of rows is not odd and positive, so that none would lie on the mid-line.
    """
    if n_rows < 1 or n_rows % 2 == 0:
        raise ValueError(
            f"given --rows {n_rows}; allowed: odd numbers; 1 scans only the mid-line, 3 or more show torsion"
        )
    # The outer rows lie half a millimetre inside the long edges.
    half = apparatus.beam.width_mm * 0.5e-3 - 0.5e-3
    return tuple(float(each) for each in np.round(np.linspace(-half, half, n_rows), 9)) if n_rows > 1 else (0.0,)


def row_name(name: str, across: float) -> str:
    """Return the folder name of a row; for the mid-line, the name as given."""
    return f"{name}_{across * 1e3:+g}_mm" if across else name


def kept_rows(folder: Path, name: str) -> list[str]:
    """Return the name suffixes of the rows kept in a folder, first the empty suffix of the mid-line."""
    # The sign tells a row of this name from a name that continues with an underscore.
    return ["", *sorted(path.name.removeprefix(name) for path in folder.glob(f"{name}_[+-]*_mm"))]
