"""``modaltouch identify``: identify the modes of a bare beam, from a rig or from files of measured responses."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from modaltouch import lab
from modaltouch.cli import APPARATUS, JSON, SEED_OF_TWIN, SHIPPED_APPARATUS, print_table, say
from modaltouch.cli.lab import MEASURED_RIG, carry_out

FILES = Annotated[
    list[Path] | None,
    typer.Argument(
        help="Measured responses or time records (.uff, .unv, .csv, .npz, .lvm), or folders of earlier scans, "
        "instead of a rig; anything measured again counts as a repeat.",
        show_default=False,
    ),
]
OUT = Annotated[Path, typer.Option(help="Folder for scans, apparatus file, table and figures.")]
POINTS = Annotated[int, typer.Option(min=2, help="Evenly spaced points of the scan.")]
AVERAGES = Annotated[
    int, typer.Option(min=1, help="Records averaged at each point; for a file, how many were averaged.")
]
DRIVE = Annotated[float, typer.Option("--drive-V", help="Peak of the excitation at the beam [V].")]
EXCITATION = Annotated[
    Literal["multisine", "chirp"],
    typer.Option(help="multisine: all modes at once; chirp: one after the other, as in the paper."),
]
HIGHEST = Annotated[
    float | None,
    typer.Option("--highest-kHz", help="Highest frequency.", show_default="1.25 times the highest mode, at most 120"),
]
MARGIN = Annotated[float, typer.Option("--margin-mm", help="Distance from the beam's ends to the outer points.")]
ROWS = Annotated[
    int,
    typer.Option(
        min=1,
        help="Rows of points across the width, an odd number; with 3 or more, shapes are maps with torsion.",
    ),
]
SETS = Annotated[list[str] | None, typer.Option("--set", help="Actuator set, repeatable.", show_default="all sets")]
MODES = Annotated[
    str, typer.Option(help="Modes of the new table: `listed` in the apparatus file, `all`, or labels such as 1,3,5.")
]
QUANTITY = Annotated[
    Literal["velocity", "displacement", "acceleration"] | None,
    typer.Option(help="What a file contains, if it does not say so."),
]
CONJUGATED = Annotated[bool, typer.Option("--conjugated", help="The files follow exp(-i w t).")]
LOWEST = Annotated[
    float | None, typer.Option("--lowest-Hz", help="Lowest frequency used from a file.", show_default="the whole band")
]
LEAVE_OUT = Annotated[
    list[float] | None,
    typer.Option("--leave-out", help="Position whose responses are not used [mm], repeatable.", show_default="none"),
]
USE_CLIPPED = Annotated[
    bool, typer.Option("--use-clipped", help="Use the free decay after the last saturated sample of a record.")
]
EXPORT = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Write responses and shapes for other programs: FILE.uff or FILE.csv.", show_default=False
    ),
]


def identify(
    files: FILES = None,
    apparatus: APPARATUS = SHIPPED_APPARATUS,
    rig: MEASURED_RIG = "simulated",
    out: OUT = Path("identification"),
    points: POINTS = 41,
    averages: AVERAGES = 4,
    rows: ROWS = 1,
    drive_V: DRIVE = 50.0,
    excitation: EXCITATION = "multisine",
    highest_kHz: HIGHEST = None,
    margin_mm: MARGIN = 0.5,
    sets: SETS = None,
    modes: MODES = "listed",
    quantity: QUANTITY = None,
    conjugated: CONJUGATED = False,
    lowest_Hz: LOWEST = None,
    seed: SEED_OF_TWIN = None,
    export: EXPORT = None,
    leave_out: LEAVE_OUT = None,
    use_clipped: USE_CLIPPED = False,
    json_output: JSON = False,
) -> None:
    """Identify natural frequencies, damping ratios, gains and shapes of a beam, each with its 95 % interval.

    Each point is on disk as soon as it is measured. To continue an interrupted scan, run the same command again. The
    result is an apparatus file that `modaltouch check` reads, with a table and figures next to it.
    """
    highest = None if highest_kHz is None else highest_kHz * 1e3
    band = (lowest_Hz or 0.0, math.inf if highest is None else highest)
    form = lab.ResponseFormat(quantity, conjugated, averages, use_clipped, band)
    options = lab.IdentifyOptions(
        apparatus, tuple(files or ()), rig, out, points=points, averages=averages, rows=rows, voltage=drive_V,
        excitation=excitation, highest=highest, margin=margin_mm * 1e-3, sets=tuple(sets or ()), modes=modes,
        form=form, seed=seed, export=export, leave_out=tuple(place * 1e-3 for place in leave_out or ()),
    )  # fmt: skip
    carry_out(_show, json_output, lab.identify, options)


def _show(result: dict[str, Any]) -> None:
    """Print Table I, failures of the half-power method, further modes, warnings, and the files written."""
    wanted = result.get("table_modes")
    listed = [mode for mode in result["modes"] if wanted is None or mode["label"] in wanted]
    gains = [name for name in result["sets"] if any(name in mode["gain_mm_s2_per_V"] for mode in result["modes"])]
    print_table(
        "Table I by joint fit, in brackets the half-width of the 95 % interval in the last digits; half-power damping "
        "beside it",
        ("mode", "f [Hz]", "xi", *(f"G {name}" for name in gains), "MAC", "xi half"),
        [_row(mode, gains) for mode in listed],
        n_words=0,
    )
    if gains:
        say("Gains in mm/s^2 per V at the beam", dim=True)
    for mode in listed:
        if reason := mode["half_power"]["warning"]:
            name = f"mode {mode['label']}" if mode["label"] else f"{mode['natural_frequency_Hz']['value']:.6g} Hz"
            say(f"No half-power damping of {name}: {reason}", fg="yellow")
    others = [
        f"{mode['natural_frequency_Hz']['value']:.0f}" + (f" (torsion {mode['torsion']})" if mode["torsion"] else "")
        for mode in result["modes"]
        if mode not in listed
    ]
    if others:
        say(f"Also found, but not in the table: {', '.join(others)} Hz", dim=True)
    say(*(text[:1].upper() + text[1:] for text in (result["misfit_verdict"], result["repeatability"])), dim=True)
    say(*(warning[:1].upper() + warning[1:] for warning in result["warnings"]), fg="yellow")
    if result["apparatus_file"]:
        say(f"Written: {result['apparatus_file']}, with a table and figures next to it")
    else:
        say("No apparatus file: gains need positions along the beam, and responses to a voltage", dim=True)


def _row(mode: dict[str, Any], gains: list[str]) -> list[str]:
    """Return a row of Table I."""
    half = mode["half_power"]
    return [
        str(mode["label"] or ""),
        _with_interval(mode["natural_frequency_Hz"]),
        _with_interval(mode["damping_ratio"]),
        *(_with_interval(mode["gain_mm_s2_per_V"].get(name)) for name in gains),
        _plain(mode["mac"], ".4f"),
        _plain(half["damping_ratio"], ".4f") if half["resolved"] else "-",
    ]


def _with_interval(pair: dict[str, float | None] | None) -> str:
    """Format a value with the half-width of its interval in the last digits, such as 228.855(11)."""
    if pair is None or pair["value"] is None or pair["low"] is None or pair["high"] is None:
        return "-"
    half = (pair["high"] - pair["low"]) / 2
    if not half > 0:
        return f"{pair['value']:.6g}"
    digits = max(0, 1 - math.floor(math.log10(half)))
    shown = f"{half:.0f}" if digits == 0 else f"{half * 10**digits:.0f}"
    return f"{pair['value']:.{digits}f}({shown})"


def _plain(value: float | None, form: str) -> str:
    return "-" if value is None else f"{value:{form}}"
