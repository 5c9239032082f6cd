"""Recordings of each law as in the paper: the field around the focusing instant, and the zones throughout a burst."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.laboratory import Laboratory
from modaltouch.lab.scan import Scan, ScanPlan, kept_rows, read_scan, row_name, take_scan
from modaltouch.preflight import DesignInputs, design
from modaltouch.protocol import Source
from modaltouch.record import RecordError, RecordInputError
from modaltouch.rig import Acquisition, Recording
from modaltouch.stimulus import Law, Stimulus

LAWS: tuple[Law, ...] = ("exact", "paper")

WHAT = ("field", "course")
"""Scans of each law, in this order; each has a folder ``<law>_<what>``, with a suffix for rows off the mid-line."""

AROUND = 1.0e-3
"""Time shown before and after the focusing instant: 24 to 26 ms in Fig. 5 [s]."""

MARGIN = 0.05e-3
"""Additional time recorded at either end to allow for the delay of the measurement [s]."""

FIELD_RATE = 2.5e6
"""Sampling rate of the field around the focus: 28 samples per period of the highest mode of Table I [Hz]."""

COURSE_RATE = 1.25e6
"""Sampling rate of the whole burst at the zones [Hz]."""

HEADROOM = 1.3
"""Range of the measurement relative to the highest predicted speed [1]."""


@dataclass(frozen=True, eq=False)
class Observation:
    """The recordings of one drive law.

    Attributes
    ----------
    stimulus : Stimulus
        The stimulus that was played.
    velocity : float
        The level at which it was played [m/s].
    zones : dict of str to float
        Zones and their centres, from left to right [m].
    focus : str
        Zone of the focus.
    field : Scan
        Velocity along the beam around the focusing instant.
    course : Scan
        Velocity at the centres of the zones throughout the burst.
    rows : tuple of Scan
        The field on further rows across the width.
    """

    stimulus: Stimulus
    velocity: float
    zones: dict[str, float]
    focus: str
    field: Scan
    course: Scan
    rows: tuple[Scan, ...] = ()


def plans(
    inputs: DesignInputs, stimulus: Stimulus, velocity: float, n_points: int, n_records: int
) -> tuple[ScanPlan, ScanPlan]:
    """Plan the scans of a stimulus: the field around the focusing instant, and the zones throughout the burst.

    Parameters
    ----------
    inputs : DesignInputs
        Inputs from which the stimulus was designed.
    stimulus : Stimulus
        The stimulus to be played.
    velocity : float
        Level [m/s].
    n_points : int
        Points along the beam, evenly spaced from end to end.
    n_records : int
        Records at each point.
    """
    half, timing = stimulus.model.length / 2, stimulus.timing
    places = np.round(np.linspace(-half, half, n_points), 9)
    centres = [zone.centre_mm * 1e-3 for zone in inputs.apparatus.ordered_zones.values()]
    highest = float(stimulus.peak_velocity([*places[:: max(1, n_points // 20)], *centres], velocity).max())
    expected = min(highest * HEADROOM, inputs.apparatus.acquisition.range_mm_s * 1e-3)
    outputs = tuple(range(1, stimulus.model.n_channels + 1))
    start = max(0.0, timing.focusing_instant - AROUND - MARGIN)
    end = min(timing.focusing_instant + AROUND + MARGIN, 1 / timing.repetition_rate)
    before = -min(1e-3, (1 / timing.repetition_rate - timing.duration) / 2)
    drive = max(1.0, HEADROOM * float(stimulus.peak_drive(velocity).max()))
    around, throughout = (
        Acquisition(rate, round((last - first) * rate), n_records, outputs, first, expected, drive)
        for rate, first, last in ((FIELD_RATE, start, end), (COURSE_RATE, before, timing.duration - before))
    )
    about = {"law": stimulus.law, "focus": inputs.section.focus}
    return (
        ScanPlan(stimulus.burst, velocity, tuple(places), around, {**about, "what": "field"}),
        ScanPlan(stimulus.burst, velocity, tuple(centres), throughout, {**about, "what": "course"}),
    )


def keep_velocities(recording: Recording) -> dict[str, NDArray[Any]]:
    """Keep all records of the velocity [m/s], but only the mean of the drive over the records [V]."""
    return {
        "time": recording.time,
        "velocity": recording.velocity.astype(np.float32),
        "drive": recording.drive.mean(axis=0, keepdims=True).astype(np.float32),
    }


def record_laws(
    inputs: DesignInputs,
    laboratory: Laboratory,
    velocity: float,
    *,
    n_points: int,
    n_records: int,
    rows: Sequence[float] = (),
    folder: Path | None = None,
    source: Source | None = None,
) -> list[Observation]:
    """Play the drive of each law on a rig, and return the recordings.

    Parameters
    ----------
    inputs : DesignInputs
        Inputs from which the stimuli are designed.
    laboratory : Laboratory
        Generator and scope, open.
    velocity : float
        Level [m/s].
    n_points, n_records : int
        Points along the beam, and records at each.
    rows : sequence of float
        Distances from the mid-line of further rows on which the field is scanned [m].
    folder : Path, optional
        Parent folder with one folder per scan; an interrupted scan is resumed.
    source : Source, optional
        The apparatus file.
    """
    observed = []
    for law in LAWS:
        stimulus = design(inputs, law=law)
        scans = []
        field, course = plans(inputs, stimulus, velocity, n_points, n_records)
        for plan in (field, course, *(replace(field, across=across) for across in rows)):
            name = row_name(f"{law}_{plan.about['what']}", plan.across)
            scan = take_scan(
                laboratory,
                plan,
                None if folder is None else folder / name,
                source=source,
                reduction=keep_velocities,
                step=name,
            )
            scans.append(scan.refuse_overloaded())
        observed.append(_observation(inputs, stimulus, velocity, scans))
    return observed


def read_laws(inputs: DesignInputs, folder: Path) -> list[Observation]:
    """Read the recordings of each law from the scans in a folder, with all rows found there; no rig is needed.

    Parameters
    ----------
    inputs : DesignInputs
        Inputs from which the stimuli were designed.
    folder : Path
        Folder of the scans written by `record_laws`.

    Raises
    ------
    RecordInputError
        If a scan is missing or incomplete, or another stimulus was played.
    """
    observed = []
    beside = kept_rows(folder, "_".join((LAWS[0], WHAT[0])))[1:]
    for law in LAWS:
        stimulus = design(inputs, law=law)
        scans = []
        for place in _folders(folder, law, beside):
            scan = read_scan(place).require_complete().refuse_overloaded()
            played = scan.facts["settings"]["burst"]["sha256"]
            if played != stimulus.burst.content_hash:
                raise RecordInputError(
                    f"{place}: the stimulus played there is not that of this protocol with the law `{law}`; give "
                    "the protocol and the apparatus of the recording"
                )
            scans.append(scan)
        velocity = float(scans[0].facts["settings"]["velocity_mm_s"]) * 1e-3
        observed.append(_observation(inputs, stimulus, velocity, scans))
    return observed


def _folders(folder: Path, law: Law, rows: Sequence[str]) -> list[Path]:
    """Return the folders of a law's scans: field and course on the mid-line, then the field on further rows."""
    return [folder / f"{law}_{what}" for what in (*WHAT, *(f"{WHAT[0]}{row}" for row in rows))]


def complete(folder: Path, rows: Sequence[float] = ()) -> bool:
    """Return whether a folder holds all scans in full, so that no rig is needed."""
    try:
        beside = [row_name("", across) for across in rows]
        return all(read_scan(place).complete for law in LAWS for place in _folders(folder, law, beside))
    except RecordError:
        return False


def _observation(inputs: DesignInputs, stimulus: Stimulus, velocity: float, scans: Sequence[Scan]) -> Observation:
    zones = {name: zone.centre_mm * 1e-3 for name, zone in inputs.apparatus.ordered_zones.items()}
    return Observation(stimulus, velocity, zones, inputs.section.focus, scans[0], scans[1], tuple(scans[2:]))
