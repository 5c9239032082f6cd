"""``modaltouch fingers``: measure the fingers that lie on the beam."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from modaltouch.cli.exit_status import BAD_INPUT, leave, reporting
from modaltouch.cli.measurement import ask_for, bars, give
from modaltouch.cli.options import JSON, MEASURED_RIG, PROTOCOL, SEED_OF_TWIN
from modaltouch.cli.tables import print_table

fingers = typer.Typer(
    name="fingers",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="Measure the fingers that lie on the beam.",
)


@fingers.callback()
def group() -> None:
    """Keep the name of its one command."""


@fingers.command("probe")
def probe(
    protocol: PROTOCOL,
    out: Annotated[Path, typer.Option(help="File for the fingers; never overwritten.")] = Path("fingers.yaml"),
    rig: MEASURED_RIG = "simulated",
    pair: Annotated[
        str, typer.Option(help="Zones that the fingers lie on, such as A-C.", show_default="the first pair")
    ] = "",
    hand: Annotated[
        Literal["left", "right"] | None, typer.Option(help="Hand used in one_hand.", show_default="the protocol's")
    ] = None,
    laser_mm: Annotated[
        float | None,
        typer.Option(
            "--laser-mm", help="Where the vibrometer aims, from mid-beam.", show_default="1 mm from the freer end"
        ),
    ] = None,
    speed_mm_s: Annotated[
        float, typer.Option("--speed-mm-s", min=0.1, max=50, help="Highest under fingers and laser; 15 is felt.")
    ] = 15.0,
    seed: SEED_OF_TWIN = None,
    json_output: JSON = False,
) -> None:
    """Probe the beam with hands off and on, and write what each finger adds to it.

    Sines of at most 15 mm/s, unless told otherwise, are played for half a second each time. What comes of it is a file
    that `stimulus.fingers` and `modaltouch check --fingers` take, with the level that a design for these fingers
    reaches under them, and its 95 % interval. The table must have all modes of the beam, even ones too; `modaltouch
    identify --modes all` finds them.
    """
    from modaltouch.lab import probe_fingers

    with reporting(json_output=json_output):
        laser = None if laser_mm is None else laser_mm * 1e-3
        try:
            with bars() as progress:
                report = probe_fingers(
                    protocol,
                    out,
                    rig=rig,
                    pair=pair,
                    hand=hand,
                    laser=laser,
                    speed=speed_mm_s * 1e-3,
                    seed=seed,
                    progress=progress,
                    lay=ask_for,
                )
        except ValueError as error:
            leave(BAD_INPUT, str(error), json_output=json_output)
        give(report, _show, json_output=json_output)


def _show(result: dict[str, Any]) -> None:
    """Print the fingers, the level that a design for them reaches, and where the file is."""
    rows = [
        (
            f"{hand} {name}",
            *(f"{each.get(key, 0.0):.3g}" for key in ("mass_g", "damping_N_s_per_m", "stiffness_N_per_mm")),
            f"{each.get('offset_mm', 0.0):+.2f}",
        )
        for hand, of_hand in result["fingers"].items()
        for name, each in of_hand.items()
    ]
    print_table("Fingers", ("finger", "mass g", "damping N s/m", "stiffness N/mm", "off its zone's centre mm"), rows)
    levels = [
        (
            each["placement"],
            f"{each['misfit']:.1f}",
            f"{each['asked_mm_s']:g}",
            f"{each['level_mm_s']:.1f} ({each['interval_mm_s'][0]:.1f} to {each['interval_mm_s'][1]:.1f})",
            f"{each['attainable_mm_s']:.0f}",
        )
        for each in result["placements"]
    ]
    headings = ("placement", "misfit", "asked", "level (95 %)", "attainable")
    print_table("Designed for these fingers, mm/s at the focus", headings, levels)
    print(f"Written: {result['file']}")
    print(
        f"Next: name it in the protocol, `stimulus: {{fingers: {result['file']}}}`, and run `modaltouch check` on that"
    )
