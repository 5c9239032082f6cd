"""The command ``modaltouch compare``: the drive laws and other methods on one page."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from modaltouch.lab.common import DARK, MIDDLE, rounded, title_of, write_page
from modaltouch.lab.contest import Contest, DriveAssessment, contest, learn, training_data
from modaltouch.lab.identification.shapes import check_points
from modaltouch.lab.laboratory import SILENT_PROGRESS, MeasurementProgress
from modaltouch.lab.validation.evidence import root_mean_square
from modaltouch.preflight import examine
from modaltouch.protocol import InputError
from modaltouch.report import INK, format_number, house_style, quiet_grid, refuse_other
from modaltouch.system import commit

Row = dict[str, Any]


def rows_of(contest: Contest) -> list[Row]:
    """Return the key figures of every method."""
    limit = contest.known.amplifier.limit
    n_channels, n_points = contest.known.responses.response.shape[:2]
    parts = zip(contest.designed, contest.verdicts, contest.changed, strict=True)
    return [
        {
            "method": designed.method.key,
            "name": designed.method.name,
            "idea": designed.method.idea,
            "focus": contest.preflight.experiment.protocol.stimulus.focus,
            **verdict.row,
            "peak_voltage_V": designed.peak_voltage,
            "energy_V2_s": designed.energy,
            "reach_mm_s": verdict.row["at_focus_mm_s"] * limit / designed.peak_voltage,
            "recordings": n_channels * (1 if designed.method.needs == "focus" else n_points),
            "further_recordings": n_channels if designed.method.needs == "focus" else 0,
            **_changed(verdict, changed),
        }
        for designed, verdict, changed in parts
    ]


def _changed(verdict: DriveAssessment, changed: Sequence[DriveAssessment]) -> Row:
    at_focus = [each.row["at_focus_mm_s"] for each in changed]
    drift = [root_mean_square(each.field - verdict.field) * 1e3 for each in changed]
    return {
        "changed_at_focus_spread_mm_s": float(np.ptp(np.percentile(at_focus, [5, 95]))),
        "changed_rms_error_mm_s": float(np.median([each.row["rms_error_mm_s"] for each in changed])),
        "changed_drift_mm_s": float(np.median(drift)),
    }


COMMAND = "compare"
"""The command that owns the folder."""


def draw_fields(contest: Contest) -> Figure:
    """Draw the true field of every method at the focusing instant, and the target field."""
    target = contest.known.target_field
    with house_style(7.6, 5.1, 2, 2, sharex=True, sharey=True) as (figure, panels):
        for axes, designed, verdict in zip(panels.ravel(), contest.designed, contest.verdicts, strict=True):
            place = verdict.position * 1e3
            axes.plot(place, target.velocity * 1e3 * target.profile(verdict.position), color=INK, linestyle="--",
                      linewidth=1, label="target")  # fmt: skip
            axes.plot(place, verdict.field * 1e3, color=DARK, linewidth=1.2, label="made")
            axes.set_title(designed.method.name, loc="left")
            axes.set_xlim(place[0], place[-1])
            quiet_grid(axes)
        for axes in panels[-1]:
            axes.set_xlabel("position [mm]")
        for axes in panels[:, 0]:
            axes.set_ylabel("velocity [mm/s]")
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
    return figure


def draw_robustness(contest: Contest) -> Figure:
    """Draw the effects of every drive on other beams, a dot for each beam and a line for the measured one."""
    names = [each.method.name for each in contest.designed]
    with house_style(7.6, 0.42 * len(names) + 1.1, 1, 3, sharey=True) as (figure, [panels]):
        pair = contest.preflight.experiment.protocol.conditions.pairs[0]
        columns = (
            ("velocity at the focus [mm/s]", "at_focus_mm_s"),
            ("distance from the target, rms [mm/s]", "rms_error_mm_s"),
            (f"contrast of ({pair[0]}, {pair[1]})", f"contrast_{pair[0]}_{pair[1]}"),
        )
        for axes, (label, key) in zip(panels, columns, strict=True):
            for place, (verdict, changed) in enumerate(zip(contest.verdicts, contest.changed, strict=True)):
                shaken = place + 0.22 * np.cos(np.arange(len(changed)) * 2.4)
                others = np.array([each.row[key] for each in changed], dtype=float)
                axes.scatter(others, shaken, s=9, color=MIDDLE, edgecolor=INK, linewidth=0.3)
                axes.plot([verdict.row[key]] * 2, [place - 0.36, place + 0.36], color=DARK, linewidth=2)
            axes.set_xlabel(label)
            axes.grid(axis="x", color="#e3e7ec", linewidth=0.7)
            axes.set_axisbelow(True)
        panels[0].set_yticks(range(len(names)), names)
        panels[0].set_ylim(len(names) - 0.5, -0.5)
        panels[1].set_xscale("log")
    return figure


def comparison_table(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the table of the methods' key figures; each row has a quantity, its unit, and one cell per method."""
    contrasts = [
        (f"contrast of ({', '.join(pair)})", "1", key, 2)
        for pair in itertools.permutations(rows[0]["zone_peak_mm_s"], 2)
        if (key := "contrast_{}_{}".format(*pair)) in rows[0]
    ]
    lines = [
        ("velocity at the focus, at the focusing instant", "mm/s", "at_focus_mm_s", 1),
        ("distance from the target field, rms", "mm/s", "rms_error_mm_s", 2),
        ("distance from the target field, largest", "mm/s", "max_error_mm_s", 2),
        ("distance from the field of the selected modes, rms", "mm/s", "rms_from_selected_mm_s", 2),
        ("spot width at 50 %", "mm", "width_50_mm", 1),
        ("spot width at 80 %", "mm", "width_80_mm", 1),
        ("highest speed at the focus, throughout", "mm/s", "highest_at_focus_mm_s", 1),
        ("highest speed anywhere, throughout", "mm/s", "highest_mm_s", 1),
        *contrasts,
        ("peak voltage", "V", "peak_voltage_V", 1),
        ("energy", "V² s", "energy_V2_s", 2),
        ("velocity at the focus at the voltage limit", "mm/s", "reach_mm_s", 0),
        ("recordings before the first focus", "1", "recordings", 0),
        ("recordings for each further focus", "1", "further_recordings", 0),
        ("other beams: spread of the velocity at the focus", "mm/s", "changed_at_focus_spread_mm_s", 2),
        ("other beams: distance from the target field, rms, median", "mm/s", "changed_rms_error_mm_s", 2),
        ("other beams: change of the field, rms, median", "mm/s", "changed_drift_mm_s", 2),
    ]
    return [
        {"quantity": name, "unit": unit, "cells": [format_number(row[key], decimals=digits) for row in rows]}
        for name, unit, key, digits in lines
    ]


def write_comparison(found: Contest, about: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Write page, figures and tables, and return the plain values with the path of each file.

    Parameters
    ----------
    found : Contest
        The comparison.
    about : dict
        Title, protocol, apparatus, seed, records at each point (``n_records``) and commit, as plain values.
    folder : Path
        Folder for the results.

    Raises
    ------
    RecordError
        If the folder holds something else, or cannot be written.
    """
    rows, level, limit = rows_of(found), found.known.target_field.velocity * 1e3, found.known.amplifier.limit
    values = {
        **about,
        "mode": "simulated",
        "velocity_mm_s": level,
        "voltage_limit_V": limit,
        "n_points": int(found.known.responses.position.size),
        "n_other_beams": len(found.changed[0]),
        "identification": list(found.known.quality),
        "methods": rows,
    }
    figures = {
        "fields": (draw_fields(found), "The true velocity field at the focusing instant, and the target."),
        "robustness": (
            draw_robustness(found),
            "The same drives on other beams, drawn around the learned beam: a dot for each beam, a line for the "
            "learned one.",
        ),
    }
    flat = [
        {key: value for key, value in row.items() if key != "zone_peak_mm_s"}
        | {f"zone_peak_{zone}_mm_s": peak for zone, peak in row["zone_peak_mm_s"].items()}
        for row in rows
    ]
    return write_page(
        folder,
        COMMAND,
        "comparison",
        figures,
        values,
        {"comparison.csv": rounded(flat, 4)},
        title=f"Comparison: {about['title']}",
        level=format(round(level, 6), "g"),
        table=comparison_table(rows),
        delay=found.known.delay * 1e6,
    )


def compare(
    protocol: Path,
    *,
    out: Path | None = None,
    points: int = 41,
    averages: int = 2,
    beams: int = 20,
    seed: int = 1,
    progress: MeasurementProgress = SILENT_PROGRESS,
) -> dict[str, Any]:
    """Design a drive with every method from the same recordings, evaluate all on the twin's true beam, and report.

    Parameters
    ----------
    protocol : Path
        A YAML file, or the name of a shipped protocol.
    out : Path, optional
        Folder for page, figures and tables; ``comparison/<protocol>`` if not given.
    points, averages : int
        Control points along the beam, and records at each.
    beams, seed : int
        Number of other beams on which the drives are played, and the seed of the first; the others have the next seeds.
    progress : MeasurementProgress, optional
        Reports progress and lets the user interrupt.

    Raises
    ------
    InputError
        If the protocol has faults or no pairs of zones.
    RecordError
        If a folder holds something else, or cannot be written.
    RigError
        If the twin's generator does not confirm a drive.
    ValueError
        If the points are too few to distinguish the modelled modes, or a mode of the table was not found or fits badly.
    """
    preflight = examine(protocol).of_untouched_beam()
    experiment = preflight.experiment
    if not experiment.protocol.conditions.pairs:
        fault = "zones that are not a pair", "pairs of zones", "compare with a protocol that has pairs of zones"
        raise InputError([preflight.findings.problem(("conditions", "zones"), *fault)])
    folder = out or Path("comparison") / experiment.protocol.protocol
    refuse_other(folder, COMMAND)
    model = preflight.stimulus.model
    check_points(np.linspace(-model.length / 2, model.length / 2, points), model.label, model.length)
    with progress.interruptible() as heard:
        responses = learn(preflight, n_points=points, n_records=averages, progress=heard)
        heard.show("modes identified", 0, 1)
        known = training_data(preflight, responses)
        heard.show("modes identified", 1, 1)
        found = contest(preflight, known, n_beams=beams, seed=seed, progress=heard)
    about = {
        "title": title_of(preflight),
        "protocol": str(protocol),
        "apparatus": experiment.apparatus.apparatus,
        "seed": seed,
        "n_records": averages,
        "commit": commit(),
    }
    return write_comparison(found, about, folder)
