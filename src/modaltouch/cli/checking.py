"""``modaltouch check``: everything that can fail before a participant sits down."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modaltouch.cli.faults import BAD_INPUT, print_json, reporting

if TYPE_CHECKING:
    from modaltouch.preflight import Preflight

PROTOCOL = Annotated[Path, typer.Argument(help="Protocol, a YAML file.", show_default=False)]


def check(
    protocol: PROTOCOL,
    json_output: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
    compare: Annotated[
        bool,
        typer.Option(
            "--compare", help="Also show the other drive law on the same rig, and the generator without burst mode."
        ),
    ] = False,
) -> None:
    """Validate a protocol, synthesise its stimuli and predict the speeds at the zones.

    Nothing is opened and nothing is written. All faults are reported at once, each with file, line and column.
    """
    from modaltouch.preflight import examine

    with reporting():
        preflight = examine(protocol)
        if json_output:
            print_json(preflight.as_dict(compare=compare))
        elif preflight.problems:
            for problem in preflight.problems:
                typer.secho(str(problem), err=True, fg=typer.colors.RED)
        else:
            show(preflight, compare=compare)
        if preflight.problems:
            raise typer.Exit(BAD_INPUT)


def show(preflight: Preflight, *, compare: bool = False) -> None:
    """Print what a session of this protocol will be."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    values = preflight.as_dict(compare=compare)
    catches = f" ({values['n_catch_trials']} of them catch trials)" if values["n_catch_trials"] else ""
    console.print(
        f"[bold]{values['title'] or values['protocol']}[/]: {values['n_trials']} trials{catches} and "
        f"{values['n_practice_trials']} for practice, about {values['estimated_duration_min']:.0f} min"
    )
    stimuli = values["stimuli"]
    first = stimuli[0]
    console.print(
        f"Focus {first['focus']}, law {first['law']}, modes {', '.join(map(str, first['selected_modes']))}, "
        f"{first['n_samples']} samples at {first['sampling_rate_Hz'] / 1e6:g} MHz, spot {first['fwhm_mm']:.1f} mm wide"
    )
    console.print(_level_table(Table, stimuli))
    for stimulus in values.get("comparison", []):
        console.print(
            f"[dim]Law {stimulus['law']} at {stimulus['velocity_mm_s']:g} mm/s on the same rig: worst modal error "
            f"{stimulus['worst_modal_error_mm_s']:.3g} mm/s[/]"
        )
    if fallback := values.get("continuous_fallback"):
        console.print(f"[dim]{fallback['warning']}[/]")
    for warning in values["warnings"]:
        console.print(f"[yellow]{warning}[/]")


def _level_table(table_kind: Any, stimuli: list[dict[str, Any]]) -> Any:
    zones = list(stimuli[0]["zone_peak_mm_s"])
    table = table_kind(title="Largest speed at the centre of each zone, mm/s", title_justify="left")
    for heading in ("level mm/s", *zones, "modal error mm/s", "peak drive V"):
        table.add_column(heading, justify="right")
    for stimulus in stimuli:
        table.add_row(
            f"{stimulus['velocity_mm_s']:g}",
            *(f"{stimulus['zone_peak_mm_s'][zone]:.0f}" for zone in zones),
            f"{stimulus['worst_modal_error_mm_s']:.1e}",
            " ".join(f"{value:.0f}" for value in stimulus["peak_drive_V"].values()),
        )
    return table
