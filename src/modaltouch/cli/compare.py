"""``modaltouch compare``: this program's drive laws beside their rivals, on the twin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from modaltouch.cli.exit_status import print_json, reporting
from modaltouch.cli.measurement import bars
from modaltouch.cli.options import JSON, PROTOCOL
from modaltouch.cli.validate import refuse_few_points

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
            help="Folder that keeps the recordings, so that a comparison that was stopped goes on there.",
            show_default="recordings are not kept",
        ),
    ] = None,
    points: Annotated[int, typer.Option(min=3, max=1001, help="Control points along the beam.")] = 41,
    averages: Annotated[int, typer.Option(min=2, max=1000, help="Records at each point.")] = 2,
    beams: Annotated[
        int,
        typer.Option(min=0, max=10_000, help="Other beams that the drives are played on, drawn around the learned."),
    ] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first other beam.")] = 1,
    json_output: JSON = False,
) -> None:
    """Put the drive laws beside time reversal and inverse filtering: one beam, one voltage limit, one page.

    Everything happens on the twin, whose true beam judges. All methods learn from the same recordings.
    """
    from modaltouch.lab.comparison.contest import Settings, contest, learn
    from modaltouch.lab.comparison.page import COMMAND, as_dict, write_comparison
    from modaltouch.lab.comparison.results import rows_of
    from modaltouch.preflight import examine
    from modaltouch.report import refuse_other
    from modaltouch.system import Interruption, commit

    with reporting(json_output=json_output):
        preflight = examine(protocol).require()
        experiment = preflight.experiment
        folder = out or Path("comparison") / experiment.protocol.protocol
        refuse_other(folder, COMMAND)
        refuse_few_points(points, preflight.stimulus.model.label)
        settings = Settings(points, averages, beams, seed)
        with Interruption() as interruption, bars() as on_progress:
            tools: dict[str, Any] = {"on_progress": on_progress, "check": interruption.check}
            responses = learn(preflight, settings, scan, **tools)
            found = contest(preflight, responses, settings, **tools)
        rows = rows_of(found, experiment.protocol.stimulus.focus)
        about = {
            "title": experiment.protocol.title or experiment.protocol.protocol,
            "protocol": str(protocol),
            "apparatus": experiment.apparatus.apparatus,
            "seed": seed,
            "n_records": averages,
            "commit": commit(),
        }
        files = write_comparison(folder, found, rows, about)
        if json_output:
            print_json({**as_dict(found, rows, about), "files": {name: str(path) for name, path in files.items()}})
        else:
            tell(rows, preflight.stimulus.wish.velocity * 1e3, beams)
            print(files["comparison.html"])


def tell(rows: list[dict[str, Any]], level: float, n_beams: int) -> None:
    """Print the methods side by side.

    Parameters
    ----------
    rows : list of dict
        As `rows_of` returns them.
    level : float
        Velocity wished at the focus [mm/s].
    n_beams : int
        Other beams that the drives were played on.
    """
    from rich.console import Console
    from rich.table import Table

    from modaltouch.lab.comparison.results import criteria, paragraphs

    console = Console()
    shown = {key: heading for key, heading in COLUMNS.items() if rows[0].get(key) is not None}
    found = [each for each in criteria(rows) if each.key in shown]
    table = Table(title=f"Wished: {level:g} mm/s at the focus; the best of each column bold", title_justify="left")
    table.add_column("method", no_wrap=True)
    for each in found:
        table.add_column(shown[each.key], justify="right")
    for row in rows:
        cells = [(each.printed(row), row in each.winners(rows, level)) for each in found]
        table.add_row(row["name"], *(f"[bold]{text}[/]" if best else text for text, best in cells))
    console.print(table)
    for words in paragraphs(rows, level, n_beams):
        console.print(words, highlight=False)
