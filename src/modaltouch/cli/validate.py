"""``modaltouch validate``: what a drive does to the beam, measured, beside what was desired."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from modaltouch.cli.exit_status import reporting
from modaltouch.cli.measurement import bars, give
from modaltouch.cli.options import CALIBRATION, JSON, MEASURED_RIG, PROTOCOL, RECORD
from modaltouch.cli.tables import print_table


def validate(
    protocol: PROTOCOL,
    calibration: CALIBRATION = None,
    rig: MEASURED_RIG = "simulated",
    out: Annotated[
        Path | None, typer.Option(help="Folder for page, figures and tables.", show_default="validation/<protocol>")
    ] = None,
    scan: Annotated[
        Path | None,
        typer.Option(
            help="Folder that keeps the recordings: an interrupted scan continues there, a complete one is read "
            "without a rig.",
            show_default="recordings are not kept",
        ),
    ] = None,
    points: Annotated[int, typer.Option(min=3, max=1001, help="Points along the beam, from end to end.")] = 41,
    averages: Annotated[int, typer.Option(min=1, max=1000, help="Records at each point.")] = 10,
    record: RECORD = None,
    json_output: JSON = False,
) -> None:
    """Play the drive by both laws, scan the beam, and show the paper's Fig. 2 and 5 to 8 on one page.

    The highest level of the protocol is played. The measured field is compared with the desired one, errors in mm/s.
    """
    from modaltouch.lab import validate as measure

    with reporting(json_output=json_output):
        with bars() as progress:
            report = measure(
                protocol,
                calibration=calibration,
                rig=rig,
                out=out,
                scan=scan,
                points=points,
                averages=averages,
                record=record,
                progress=progress,
            )
        give(report, lambda values: _show(report.table, values), json_output=json_output)


def _show(lines: list[dict[str, Any]], values: dict[str, Any]) -> None:
    """Print the laws side by side, and where the page is."""
    headings = ("quantity [unit]", *(f"law {law['law']}" for law in values["laws"]))
    names = [f"{line['quantity']} \\[{line['unit']}]" if line["unit"] != "1" else line["quantity"] for line in lines]
    rows = [(name, *line["cells"]) for name, line in zip(names, lines, strict=True)]
    print_table(f"Measured at {values['laws'][0]['velocity_mm_s']:g} mm/s", headings, rows)
    print(values["files"]["validation.html"])
