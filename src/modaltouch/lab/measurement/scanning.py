"""Takes a scan position by position, each on the disk before the next; goes on with one that was stopped."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.measurement.laboratory import Laboratory
from modaltouch.lab.measurement.plan import ScanPlan
from modaltouch.lab.measurement.scan import (
    DESCRIPTION,
    SCHEMA,
    Scan,
    assemble,
    position_file,
    read_facts,
    read_position,
)
from modaltouch.protocol import Source
from modaltouch.record import RecordError, replace_file
from modaltouch.rig import Recording
from modaltouch.system import commit, versions

Reduction = Callable[[Recording], Mapping[str, NDArray[Any]]]
"""What is kept of a recording: arrays by name."""

_REMEDY = "free the place, or give another"


def keep_records(recording: Recording) -> dict[str, NDArray[Any]]:
    """Keep whole records: ``time`` [s], ``velocity`` [m/s] and ``drive`` [V], in single precision but for the time."""
    return {
        "time": recording.time,
        "velocity": recording.velocity.astype(np.float32),
        "drive": recording.drive.astype(np.float32),
    }


def _nothing(done: int, total: int) -> None:
    """Show no progress."""


def _never() -> None:
    """Stop at no moment."""


def take_scan(
    laboratory: Laboratory,
    plan: ScanPlan,
    folder: Path | None = None,
    *,
    source: Source | None = None,
    reduction: Reduction = keep_records,
    on_progress: Callable[[int, int], None] = _nothing,
    check: Callable[[], None] = _never,
) -> Scan:
    """Return a scan, taken anew or from where it was stopped.

    Parameters
    ----------
    laboratory : Laboratory
        Generator and scope, open.
    plan : ScanPlan
        What is played, where and how it is recorded.
    folder : Path, optional
        Where each position is saved as soon as it is recorded, and where a scan that was stopped is found; without
        one nothing is written.
    source : Source, optional
        The apparatus file, kept in the description.
    reduction : callable
        What is kept of each recording; whole records if not given.
    on_progress : callable
        Called with (recorded, planned) positions, first before anything is recorded.
    check : callable
        Called between positions; may raise to stop the scan, of which everything recorded is kept.

    Raises
    ------
    RigError
        If the rig fails; the outputs are off and what was recorded is kept.
    RecordError
        If the folder holds a scan of other settings, something else, or cannot be written.
    ValueError
        If a position is not on the beam.
    """
    plan.check_on(laboratory.apparatus)
    facts = _describe(laboratory, plan, source, reduction)
    places = np.array(facts["settings"]["positions_mm"]) * 1e-3
    kept = [] if folder is None else _begin(folder, facts, plan)
    on_progress(len(kept), len(places))
    if len(kept) < len(places):
        laboratory.load(plan.burst)
    for index in range(len(kept), len(places)):
        check()
        recording = laboratory.record(float(places[index]), plan.velocity, plan.acquisition)
        arrays: dict[str, NDArray[Any]] = {
            "position": np.array(places[index]),
            "sampling_rate": np.array(recording.sampling_rate),
            "overloaded": np.array(recording.overloaded, dtype="U16"),
            **reduction(recording),
        }
        if folder is not None:
            save_arrays(position_file(folder, index), arrays)
        kept.append(arrays)
        on_progress(len(kept), len(places))
    return assemble(facts, places, kept)


def _describe(laboratory: Laboratory, plan: ScanPlan, source: Source | None, reduction: Reduction) -> dict[str, Any]:
    settings = plan.settings() | {
        "kept": getattr(reduction, "__name__", type(reduction).__name__),
        "apparatus_sha256": "" if source is None else source.sha256,
        "generator": laboratory.rig.identity,
        "scope": laboratory.scope.identity,
        "mode": laboratory.mode,
    }
    return {
        "schema": SCHEMA,
        "mode": laboratory.mode,
        # As it is read back from JSON, so that both can be compared.
        "settings": json.loads(json.dumps(settings)),
        "apparatus": None if source is None else source.as_dict(),
        "begun": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "versions": versions(),
        "commit": commit(),
    }


def _begin(folder: Path, facts: dict[str, Any], plan: ScanPlan) -> list[dict[str, NDArray[Any]]]:
    """Return what is recorded already, or describe a new scan in its folder."""
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
        raise RecordError(f"{folder}: holds {strange}, which is no scan's; give an empty folder, or a new one")
    save_arrays(folder / "burst.npz", {"codes": plan.burst.codes})
    replace_file(folder / DESCRIPTION, (json.dumps(facts, indent=1, ensure_ascii=False) + "\n").encode(), _REMEDY)
    return []


def _recorded(folder: Path, facts: dict[str, Any]) -> list[dict[str, NDArray[Any]]]:
    kept = []
    for index, place in enumerate(facts["settings"]["positions_mm"]):
        path = position_file(folder, index)
        if not path.exists():
            break
        kept.append(read_position(path, place * 1e-3))
    return kept


def _refuse_other(folder: Path, found: dict[str, Any], asked: dict[str, Any]) -> None:
    """Refuse to go on with a scan under other settings, naming what differs."""
    before, now = _flat(found), _flat(asked)
    different = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
    if different:
        shown = "; ".join(f"{name} was {before.get(name)}, now {now.get(name)}" for name in different[:3])
        more = f" and {len(different) - 3} more" if len(different) > 3 else ""
        raise RecordError(
            f"{folder}: holds a scan of other settings ({shown}{more}); go on with the settings it was begun with, "
            "or give another folder"
        )


def _flat(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{before}{key}"
        flat |= _flat(value, f"{name}.") if isinstance(value, dict) else {name: value}
    return flat


def save_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays as an npz file in one step: whole or not at all.

    Raises
    ------
    RecordError
        If the file cannot be written.
    """
    buffer = io.BytesIO()
    np.savez(buffer, **dict(arrays))  # type: ignore[arg-type]
    replace_file(path, buffer.getvalue(), _REMEDY)
