"""``modaltouch compare``: this program's drive laws beside their rivals, on the twin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from modaltouch.cli.exit_status import reporting
from modaltouch.cli.measurement import bars, give
from modaltouch.cli.options import JSON, PROTOCOL
from modaltouch.cli.tables import print_table

COLUMNS = {
    "at_focus_mm_s": "at focus mm/s",
    "rms_error_mm_s": "field error mm/s",
    "highest_mm_s": "highest mm/s",
    "peak_voltage_V": "peak V",
    "energy_V2_s": "energy V² s",
    "changed_drift_mm_s": "other beams mm/s",
}
"""What the terminal shows, with its heading; the page shows everything."""


def compare(
    protocol: PROTOCOL,
    out: Annotated[
        Path | None, typer.Option(help="Folder for page, figures and tables.", show_default="comparison/<protocol>")
    ] = None,
    scan: Annotated[
        Path | None,
        typer.Option(
            help="Folder that keeps the recordings, so that an interrupted comparison continues there.",
            show_default="recordings are not kept",
        ),
    ] = None,
    points: Annotated[int, typer.Option(min=3, max=1001, help="Control points along the beam.")] = 41,
    averages: Annotated[int, typer.Option(min=2, max=1000, help="Records at each point.")] = 2,
    beams: Annotated[
        int,
        typer.Option(
            min=0, max=10_000, help="Other beams, drawn around the learned one, on which the drives are played."
        ),
    ] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first other beam.")] = 1,
    json_output: JSON = False,
) -> None:
    """Compare the drive laws with time reversal and inverse filtering: one beam, one voltage limit, one page.

    Everything runs on the twin, whose true beam is the reference. All methods learn from the same recordings.
    """
    from modaltouch.lab import compare as measure

    with reporting(json_output=json_output):
        with bars() as progress:
            report = measure(
                protocol,
                out=out,
                scan=scan,
                points=points,
                averages=averages,
                beams=beams,
                seed=seed,
                progress=progress,
            )
        give(report, lambda values: _show(report.table, report.paragraphs, values), json_output=json_output)


def _show(lines: list[dict[str, Any]], paragraphs: list[str], values: dict[str, Any]) -> None:
    """Print the methods side by side, what the numbers say, and where the page is."""
    from rich.console import Console

    methods = values["methods"]
    title = f"Target: {values['velocity_mm_s']:g} mm/s at the focus; the best of each column bold"
    shown = [line for line in lines if line["key"] in COLUMNS and methods[0].get(line["key"]) is not None]
    rows = []
    for number, method in enumerate(methods):
        cells = [line["cells"][number] for line in shown]
        rows.append((method["name"], *(f"[bold]{cell['text']}[/]" if cell["best"] else cell["text"] for cell in cells)))
    print_table(title, ("method", *(COLUMNS[line["key"]] for line in shown)), rows)
    for words in paragraphs:
        Console().print(words, highlight=False)
    print(values["files"]["comparison.html"])
