"""The command ``modaltouch validate``: recordings of both drive laws, their evaluation, and a page of results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.lab.common import rounded, title_of, write_page
from modaltouch.lab.identification.shapes import check_points
from modaltouch.lab.laboratory import SILENT_PROGRESS, SIMULATED, Laboratory, MeasurementProgress, open_laboratory
from modaltouch.lab.recorded_files import RecordedFiles
from modaltouch.lab.scan import DESCRIPTION, Scan, ScanPlan, kept_rows, read_scan, row_name, rows_over, take_scan
from modaltouch.lab.validation.evidence import Evidence
from modaltouch.lab.validation.figures import PAPER_WORST, draw_all
from modaltouch.lab.validation.key_figures import AROUND, figure_tables, findings, key_figures, validation_table
from modaltouch.lab.validation.plausibility import evaluate
from modaltouch.preflight import DesignInputs, Preflight, design, examine
from modaltouch.protocol import Source
from modaltouch.record import RecordInputError
from modaltouch.report import refuse_other
from modaltouch.rig import Acquisition
from modaltouch.stimulus import Law, Stimulus
from modaltouch.system import commit

COMMAND = "validate"
"""The command that owns the folder."""


def write_validation(
    evidences: Sequence[Evidence], pairs: Sequence[tuple[str, str]], context: dict[str, Any], folder: Path
) -> dict[str, Any]:
    """Write page, figures and tables, and return the plain values with the path of each file.

    Parameters
    ----------
    evidences : sequence of Evidence
        The evidence for each law.
    pairs : sequence of (str, str)
        Pairs of zones touched by two fingers.
    context : dict
        Plain values on the validation: ``title`` and ``protocol`` (its file), ``apparatus``, ``mode``, ``generator``,
        ``scope``, ``calibration`` (its file or None) and ``commit``.
    folder : Path
        Folder for the results.

    Raises
    ------
    RecordError
        If the folder holds something else or cannot be written.
    """
    figures, lag = [key_figures(each, pairs) for each in evidences], evidences[0].lag * 1e6
    shown = ("protocol", "apparatus", "mode", "generator", "scope", "calibration")
    # Anything below a millionth of a unit is not significant.
    found = {"measurement_lag_us": lag, "laws": figures, "findings": findings(figures)}
    values = rounded({key: context[key] for key in shown} | found, 6)
    return write_page(
        folder,
        COMMAND,
        "validation",
        draw_all(evidences),
        values,
        figure_tables(evidences),
        title=f"Validation: {context['title']}",
        occasion=context,
        level=format(round(evidences[0].velocity * 1e3, 6), "g"),
        laws=[each.stimulus.law for each in evidences],
        figures=figures,
        lag=lag,
        paper_worst=PAPER_WORST,
        findings=values["findings"],
        rows=validation_table(figures),
    )


def validate(
    protocol: Path,
    *,
    calibration: Path | None = None,
    rig: str = SIMULATED,
    out: Path | None = None,
    scan: Path | None = None,
    points: int = 41,
    averages: int = 10,
    rows: int = 1,
    record: Path | None = None,
    progress: MeasurementProgress = SILENT_PROGRESS,
) -> dict[str, Any]:
    """Play the drive of both laws, scan the beam, and report the measured fields with the target and the prediction.

    Parameters
    ----------
    protocol : Path
        A YAML file, or the name of a shipped protocol.
    calibration : Path, optional
        Calibration file to use instead of the one named in the protocol.
    rig : str
        ``simulated``, or the generator's VISA address.
    out : Path, optional
        Folder for page, figures and tables; ``validation/<protocol>`` if not given.
    scan : Path, optional
        Folder for the recordings; an interrupted scan is resumed from it, a complete one needs no rig.
    points, averages : int
        Points along the beam, and records at each.
    rows : int
        Number of rows of points to measure across the width, odd; torsion requires three or more. A complete scan is
        read with all its rows.
    record : Path, optional
        Folder into which another scope saves its records as files; a PicoScope is used if not given.
    progress : MeasurementProgress, optional
        Reports progress and lets the user interrupt.

    Raises
    ------
    InputError
        If the protocol or its calibration has faults.
    ValueError
        If the points are too few to distinguish the modelled modes.
    RecordError
        If a folder holds something else or cannot be written.
    RigError
        If the rig fails.
    """
    preflight = examine(protocol, calibration, marked=True).of_untouched_beam().of_one_stimulus()
    folder = out or Path("validation") / preflight.experiment.protocol.protocol
    refuse_other(folder, COMMAND)
    model = preflight.stimulus.model
    check_points(np.linspace(-model.length / 2, model.length / 2, points), model.label, model.length)
    beside = [across for across in rows_over(preflight.experiment.apparatus, rows) if across]
    observed = _observe(preflight, rig, scan, points, averages, beside, record, progress)
    context = _context(preflight, protocol, observed[0].field)
    return write_validation(evaluate(observed), preflight.experiment.protocol.conditions.pairs, context, folder)


def _observe(
    preflight: Preflight,
    rig: str,
    folder: Path | None,
    points: int,
    averages: int,
    rows: Sequence[float],
    record: Path | None,
    progress: MeasurementProgress,
) -> list[Evidence]:
    """Take the recordings, or read earlier ones."""
    experiment, (inputs, stimulus) = preflight.experiment, preflight.sound
    if folder is not None and complete(folder, rows):
        return read_laws(inputs, folder)
    with progress.interruptible() as heard:
        scope = RecordedFiles(record, experiment.apparatus, heard) if record else None
        with open_laboratory(experiment.apparatus, rig, heard, scope=scope) as laboratory:
            return record_laws(
                inputs,
                laboratory,
                stimulus.target_field.velocity,
                n_points=points,
                n_records=averages,
                rows=rows,
                folder=folder,
                source=experiment.sources.apparatus,
            )


def _context(preflight: Preflight, protocol: Path, field: Scan) -> dict[str, Any]:
    experiment, calibration = preflight.experiment, preflight.findings.calibration
    return {
        "title": title_of(preflight),
        "protocol": str(protocol),
        "apparatus": experiment.apparatus.apparatus,
        "mode": field.facts["mode"],
        "generator": field.facts["settings"]["generator"],
        "scope": field.facts["settings"]["scope"],
        "calibration": None if calibration is None else str(calibration.source.path),
        "commit": commit(),
    }


LAWS: tuple[Law, ...] = ("exact", "paper")

WHAT = ("field", "course")
"""Scans of each law, in this order; each has a folder ``<law>_<what>``, with a suffix for rows off the mid-line."""

MARGIN = 0.05e-3
"""Additional time recorded at either end to allow for the delay of the measurement [s]."""

FIELD_RATE = 2.5e6
"""Sampling rate of the field around the focus: 28 samples per period of the highest mode of Table I [Hz]."""

COURSE_RATE = 1.25e6
"""Sampling rate of the whole burst at the zones [Hz]."""

HEADROOM = 1.3
"""Range of the measurement relative to the highest predicted speed [1]."""


def plans(
    inputs: DesignInputs, stimulus: Stimulus, velocity: float, n_points: int, n_records: int
) -> tuple[ScanPlan, ScanPlan]:
    """Plan the scans of a stimulus: the field around the focusing instant, and the zones throughout the burst.

    Parameters
    ----------
    inputs, stimulus, velocity
        Inputs from which the stimulus was designed, and the stimulus with its level [m/s].
    n_points, n_records : int
        Points along the beam, evenly spaced from end to end, and records at each.
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
    peak_drive = stimulus.peak_drive(velocity).tolist()
    drive = max(1.0, HEADROOM * max(peak_drive))
    around, throughout = (
        Acquisition(rate, round((last - first) * rate), n_records, outputs, first, expected, drive)
        for rate, first, last in ((FIELD_RATE, start, end), (COURSE_RATE, before, timing.duration - before))
    )
    about = {"law": stimulus.law, "focus": inputs.section.focus}
    return (
        ScanPlan(stimulus.burst, velocity, tuple(places), around, {**about, "what": "field"}, 0.0, peak_drive),
        ScanPlan(stimulus.burst, velocity, tuple(centres), throughout, {**about, "what": "course"}, 0.0, peak_drive),
    )


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
) -> list[Evidence]:
    """Play the drive of each law on a rig, and return the recordings.

    Parameters
    ----------
    inputs, laboratory, velocity
        Inputs from which the stimuli are designed, generator and scope, and the level [m/s].
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
            place = None if folder is None else folder / name
            scans.append(take_scan(laboratory, plan, place, source=source, step=name))
        observed.append(_evidence(inputs, stimulus, velocity, scans))
    return observed


def read_laws(inputs: DesignInputs, folder: Path) -> list[Evidence]:
    """Read the recordings of each law from the scans in a folder, with all rows found there; no rig is needed.

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
            scan = read_scan(place).require_complete()
            played = scan.facts["settings"]["burst"].get("sha256")
            if played != stimulus.burst.content_hash:
                raise RecordInputError(
                    f"{place}: the stimulus played there is not that of this protocol with the law `{law}`; give "
                    "the protocol and the apparatus of the recording"
                )
            scans.append(scan)
        velocity = float(scans[0].facts["settings"]["velocity_mm_s"]) * 1e-3
        check_points(scans[0].positions, stimulus.model.label, stimulus.model.length)
        observed.append(_evidence(inputs, stimulus, velocity, scans))
        centres = [*observed[-1].zones.values()]
        if scans[1].positions.size != len(centres) or not np.allclose(scans[1].positions, centres):
            raise RecordInputError(f"{folder}: the zones recorded there are not those of the apparatus; give its file")
    return observed


def _folders(folder: Path, law: Law, rows: Sequence[str]) -> list[Path]:
    """Return the folders of a law's scans: field and course on the mid-line, then the field on further rows."""
    return [folder / f"{law}_{what}" for what in (*WHAT, *(f"{WHAT[0]}{row}" for row in rows))]


def complete(folder: Path, rows: Sequence[float] = ()) -> bool:
    """Return whether a folder holds all scans in full, so that no rig is needed."""
    beside = [row_name("", across) for across in rows]
    places = [place for law in LAWS for place in _folders(folder, law, beside)]
    return all((place / DESCRIPTION).exists() for place in places) and all(read_scan(each).complete for each in places)


def _evidence(inputs: DesignInputs, stimulus: Stimulus, velocity: float, scans: Sequence[Scan]) -> Evidence:
    zones = {name: zone.centre_mm * 1e-3 for name, zone in inputs.apparatus.ordered_zones.items()}
    return Evidence(stimulus, velocity, zones, inputs.section.focus, scans[0], scans[1], tuple(scans[2:]))
