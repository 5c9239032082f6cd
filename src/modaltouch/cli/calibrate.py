"""``modaltouch calibrate``: make the stimulus true on the very rig it is played on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modaltouch.cli.exit_status import reporting
from modaltouch.cli.measurement import bars, give
from modaltouch.cli.options import JSON, MEASURED_RIG, PROTOCOL, RECORD
from modaltouch.cli.tables import print_table

if TYPE_CHECKING:
    from modaltouch.protocol import Calibration


def calibrate(
    protocol: PROTOCOL,
    out: Annotated[Path, typer.Option(help="File for the calibration; never overwritten.", show_default=False)],
    rig: MEASURED_RIG = "simulated",
    person: Annotated[str, typer.Option(help="Who calibrates, for the file.", show_default="nobody named")] = "",
    accept: Annotated[
        bool, typer.Option("--accept", help="Write a calibration that misses its limits too, with a mark.")
    ] = False,
    record: RECORD = None,
    json_output: JSON = False,
) -> None:
    """Measure what each stimulus really does at the focusing instant, and correct its targets until both agree.

    Amplifier, clock, modes and vibrometer are identified first. Then velocity and displacement of every modelled mode
    are read off the free decay after the focus, and the targets of the exact law corrected, until nothing is left that
    noise does not explain. Last, every velocity level is verified at the focus; where adaptive runs
    or participants have levels of their own, the bounds and three levels between them at equal ratios (2, 6.325, 20,
    63.25 and 200 of 2 to 200 mm/s). Of a protocol with
    several stimuli all are calibrated, into one file. Nothing is written before the end, and nothing that misses the
    protocol's `calibration.limits`, unless --accept is given: `run` then takes it with --with-marked-calibration alone.
    """
    from modaltouch.lab import calibrate as measure

    with reporting(json_output=json_output):
        with bars() as progress:
            report = measure(protocol, out, rig=rig, person=person, accept=accept, record=record, progress=progress)
        give(report, lambda _: _show(report.calibration, out, protocol), json_output=json_output)


def _show(calibration: Calibration, out: Path, protocol: Path) -> None:
    """Print what was reached."""
    from rich.console import Console
    from rich.markup import escape

    console = Console()
    for name, own in calibration.by_stimulus.items():
        _show_stimulus(name, own)
    noise = max(mode.uncertainty_mm_s for own in calibration.by_stimulus.values() for mode in own.modes)
    amplifier = calibration.amplifier
    corner = "not known" if amplifier.bandwidth_kHz is None else f"{amplifier.bandwidth_kHz:.0f} kHz"
    console.print(
        f"Amplifier: delay {amplifier.delay_us:.2f} us, corner {corner}; errors are known to {noise:.2f} mm/s (95 %)"
    )
    if calibration.mark:
        console.print(f"[yellow]Marked: {escape(calibration.mark)}[/]")
    console.print(f"Written: {out}", markup=False)
    marked = " --with-marked-calibration" if calibration.mark else ""
    console.print(f"Next: modaltouch run {protocol} --calibration {out}{marked}", markup=False)


def _show_stimulus(name: str, own: Any) -> None:
    """Print what was reached with one stimulus."""
    whose = f"Stimulus {name}: " if name else ""
    turns = [
        (
            str(each.iteration) if each.iteration else "before",
            f"{each.worst_velocity_error_mm_s:.3f}",
            f"{each.worst_displacement_error_mm_s:.3f}",
            f"{each.peak_voltage_V:.0f}",
        )
        for each in own.iterations
    ]
    headings = ("iteration", "worst velocity error mm/s", "worst w eta error mm/s", "peak voltage V")
    print_table(f"{whose}Errors at the focusing instant, as measured", headings, turns)
    levels = [
        (
            f"{level.velocity_mm_s:g}",
            f"{level.at_focus_mm_s:.1f} ± {level.uncertainty_mm_s:.1f}",
            f"{level.highest_mm_s:.1f}",
            " ".join(f"{volts:.4g}" for volts in level.amplitude_Vpp),
        )
        for level in own.levels
    ]
    headings = ("level", "at the focusing instant", "highest over the burst", "amplitude Vpp")
    print_table(f"{whose}Levels at the centre of the focus zone, mm/s", headings, levels)
