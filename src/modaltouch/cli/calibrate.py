"""``modaltouch calibrate``: make the stimulus true on the very rig it is played on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modaltouch.cli.exit_status import print_json, reporting
from modaltouch.cli.measurement import aside, ask_to_aim
from modaltouch.cli.options import JSON, MEASURED_RIG, PROTOCOL

if TYPE_CHECKING:
    from rich.console import Console

    from modaltouch.lab.calibration.outcome import CalibrationProgress, Iteration
    from modaltouch.protocol import Calibration


def calibrate(
    protocol: PROTOCOL,
    out: Annotated[Path, typer.Option(help="File for the calibration; never overwritten.", show_default=False)],
    rig: MEASURED_RIG = "simulated",
    person: Annotated[str, typer.Option(help="Who calibrates, for the file.", show_default="nobody named")] = "",
    json_output: JSON = False,
) -> None:
    """Measure what each stimulus really does at the focusing instant, and correct its targets until it is as wished.

    Amplifier, clock, modes and vibrometer are identified first. Then velocity and displacement of every modelled mode
    are read off the free decay after the focus, and the targets of the exact law corrected, until nothing is left that
    noise does not explain. Last, every velocity level is verified at the focus; where adaptive runs
    or participants have levels of their own, the bounds and three levels between them at equal ratios (2, 6.325, 20,
    63.25 and 200 of 2 to 200 mm/s). Of a protocol with
    several stimuli all are calibrated, into one file. Nothing is written before the end.
    """
    from modaltouch.lab.calibration.corrections import grounds_of, levels_between
    from modaltouch.lab.calibration.file import CalibrationContext, calibration_of, write_calibration
    from modaltouch.lab.calibration.loop import calibrate_each
    from modaltouch.lab.measurement import open_laboratory
    from modaltouch.preflight import examine
    from modaltouch.record import prepare_file
    from modaltouch.system import Interruption

    with reporting(json_output=json_output):
        preflight = examine(protocol, uncalibrated=True).require()
        experiment, grounds = preflight.experiment, grounds_of(preflight)
        between = levels_between(experiment.protocol)
        prepare_file(out)
        with (
            Interruption() as interruption,
            _showing(interruption.check, by_hand=rig != "simulated") as (progress, aim),
            open_laboratory(experiment.apparatus, rig, aim=aim) as laboratory,
        ):
            outcomes = calibrate_each(laboratory, experiment.apparatus, grounds, progress, between)
            circumstances = CalibrationContext(
                protocol=experiment.protocol.protocol,
                apparatus=experiment.apparatus,
                generator=laboratory.rig.identity,
                scope=laboratory.scope.identity,
                mode=laboratory.mode,
                person=person,
                made=datetime.now().astimezone(),
            )
        calibration = calibration_of(outcomes, circumstances)
        write_calibration(out, calibration)
        if json_output:
            print_json({**calibration.model_dump(mode="json"), "file": str(out)})
        else:
            _show(calibration, out, protocol)


@contextmanager
def _showing(
    check: Callable[[], None], *, by_hand: bool
) -> Iterator[tuple[CalibrationProgress, Callable[[float], None]]]:
    """Show on standard error what is measured, and each turn's errors; yield that, and what aims the vibrometer."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    from modaltouch.lab.calibration.outcome import CalibrationProgress

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    aimed: list[float] = []
    with Bars(*columns, console=console) as bars:
        task = bars.add_task("records", total=None)

        of_several: list[str] = []

        def stimulus(name: str) -> None:
            of_several[:] = [name]
            bars.print(f"stimulus {name}")

        def step(words: str, n_records: int) -> None:
            bars.reset(task, description=": ".join([*of_several, words]), total=n_records)

        def turn(measured: Iteration) -> None:
            velocity, displacement = (error * 1e3 for error in measured.errors)
            name = "before     " if measured.number == 0 else f"iteration {measured.number}"
            bars.print(
                f"{name}  worst velocity error {velocity:7.3f} mm/s, worst w eta error {displacement:7.3f} mm/s, "
                f"peak {measured.peak_voltage:.0f} V"
            )

        def aim(position: float) -> None:
            if not by_hand or aimed[-1:] == [position]:
                return
            with aside(bars):
                ask_to_aim(position)
            aimed.append(position)

        yield (
            CalibrationProgress(
                check=check, stimulus=stimulus, step=step, advance=lambda: bars.advance(task), turn=turn
            ),
            aim,
        )


def _show(calibration: Calibration, out: Path, protocol: Path) -> None:
    """Print what was reached."""
    from rich.console import Console

    console = Console()
    for name in calibration.by_stimulus:
        _show_stimulus(console, name, calibration)
    noise = max(mode.uncertainty_mm_s for own in calibration.by_stimulus.values() for mode in own.modes)
    amplifier = calibration.amplifier
    corner = "none told" if amplifier.bandwidth_kHz is None else f"{amplifier.bandwidth_kHz:.0f} kHz"
    console.print(
        f"Amplifier: delay {amplifier.delay_us:.2f} us, corner {corner}; errors are known to {noise:.2f} mm/s "
        "(95 %, noise alone)"
    )
    console.print(f"Written: {out}", markup=False)
    console.print(f"Next: modaltouch run {protocol} --calibration {out}", markup=False)


def _show_stimulus(console: Console, name: str, calibration: Calibration) -> None:
    """Print what was reached with one stimulus."""
    from rich.table import Table

    whose, own = f"Stimulus {name}: " if name else "", calibration.by_stimulus[name]
    title = "errors at the focusing instant, as measured"
    turns = Table(title=f"{whose}{title}" if whose else title.capitalize(), title_justify="left")
    for heading in ("iteration", "worst velocity error mm/s", "worst w eta error mm/s", "peak voltage V"):
        turns.add_column(heading, justify="right")
    for each in own.iterations:
        turns.add_row(
            str(each.iteration) if each.iteration else "before",
            f"{each.worst_velocity_error_mm_s:.3f}",
            f"{each.worst_displacement_error_mm_s:.3f}",
            f"{each.peak_voltage_V:.0f}",
        )
    console.print(turns)
    title = "levels at the centre of the focus zone, mm/s"
    levels = Table(title=f"{whose}{title}" if whose else title.capitalize(), title_justify="left")
    for heading in ("level", "at the focusing instant", "highest over the burst", "amplitude Vpp"):
        levels.add_column(heading, justify="right")
    for level in own.levels:
        levels.add_row(
            f"{level.velocity_mm_s:g}",
            f"{level.at_focus_mm_s:.1f} ± {level.uncertainty_mm_s:.1f}",
            f"{level.highest_mm_s:.1f}",
            " ".join(f"{volts:.4g}" for volts in level.amplitude_Vpp),
        )
    console.print(levels)
