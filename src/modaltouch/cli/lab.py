"""Lab commands ``calibrate``, ``compare``, ``validate`` and ``fingers``, with progress bars and prompts."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from modaltouch import lab
from modaltouch.cli import (
    BAD_INPUT,
    CALIBRATION,
    JSON,
    PROTOCOL,
    SEED_OF_TWIN,
    leave,
    make_bars,
    print_json,
    print_table,
    reporting,
    say,
)

if TYPE_CHECKING:
    from rich.progress import TaskID


MEASURED_RIG = Annotated[
    str, typer.Option(help="`simulated`, or the generator's VISA address; a real one is measured with a PicoScope.")
]
RECORD = Annotated[
    Path | None,
    typer.Option(
        help="Folder where another scope leaves its records as CSV or NPZ files, one by one as the program asks for "
        "them.",
        show_default="measured with a PicoScope",
    ),
]


@contextmanager
def bars(*, json_output: bool = False) -> Iterator[lab.MeasurementProgress]:
    """Show progress bars on standard error, and prompt there for the vibrometer to be aimed.

    A ValueError, raised for a request that cannot be measured or designed, ends the command as bad input.
    """
    shown = make_bars()
    tasks: dict[str, TaskID] = {}
    aimed: list[tuple[float, float]] = []

    def show(what: str, done: int, total: int) -> None:
        shown.start()
        if what not in tasks:
            tasks[what] = shown.add_task(what, total=total)
        shown.update(tasks[what], completed=done, total=total)

    def aim(position: float, across: float) -> None:
        """Prompt once per position, however many consecutive records are taken there."""
        if aimed != [(position, across)]:
            row = f", {across * 1e3:+.2f} mm across from the mid-line" if across else ""
            shown.stop()
            # Let Ctrl-C end the prompt at once.
            noting = signal.signal(signal.SIGINT, signal.default_int_handler)
            try:
                ask_for(f"Aim the vibrometer at {position * 1e3:+.2f} mm from mid-beam{row}")
            finally:
                signal.signal(signal.SIGINT, noting)
                shown.start()
            aimed[:] = [(position, across)]

    try:
        yield lab.MeasurementProgress(show=show, say=shown.print, aim=aim)
    except ValueError as error:
        leave(BAD_INPUT, str(error), json_output=json_output)
    finally:
        # The display is started by the first measurement.
        if shown.live.is_started:
            shown.stop()


def ask_for(words: str) -> None:
    """Ask for an action at the beam, and wait for Enter."""
    typer.echo(f"{words}, then press Enter.", err=True)
    try:
        input()
    except EOFError:
        raise typer.BadParameter(
            "standard input is closed, but someone must aim the vibrometer and place fingers; start the command in a "
            "terminal"
        ) from None


def carry_out(
    show: Callable[[dict[str, Any]], None],
    json_output: bool,
    measure: Callable[..., dict[str, Any]],
    *given: Any,
    **options: Any,
) -> None:
    """Measure with progress bars, and print the result as JSON or with `show`."""
    with reporting(json_output=json_output):
        with bars(json_output=json_output) as progress:
            values = measure(*given, progress=progress, **options)
        print_json(values) if json_output else show(values)


def calibrate(
    protocol: PROTOCOL,
    out: Annotated[Path, typer.Option(help="File for the calibration; never overwritten.", show_default=False)],
    rig: MEASURED_RIG = "simulated",
    person: Annotated[
        str, typer.Option(help="Name of the person who calibrates, for the file.", show_default="none")
    ] = "",
    accept: Annotated[
        bool, typer.Option("--accept", help="Write the calibration even if it misses its limits, and mark it.")
    ] = False,
    record: RECORD = None,
    json_output: JSON = False,
) -> None:
    """Measure each stimulus at the focusing instant, and correct its targets until the beam moves as intended.

    Amplifier, clock, modes and vibrometer are identified first. Then velocity and displacement of every modelled mode
    are measured in the free decay after the focus, and the targets of the exact law are corrected until the remaining
    errors are within the noise. Last, every velocity level is verified at the focus. If levels depend on adaptive runs
    or participants, the bounds and three levels between them at equal ratios are verified instead (2, 6.325, 20, 63.25
    and 200 for 2 to 200 mm/s). One file covers all stimuli of a protocol. Nothing is written before the end.
    A calibration that misses the protocol's `calibration.limits` needs --accept to be written, and `run` needs
    --with-marked-calibration to use it.
    """
    show = partial(_show_calibration, out, protocol)
    carry_out(show, json_output, lab.calibrate, protocol, out, rig=rig, person=person, accept=accept, record=record)


def _show_calibration(out: Path, protocol: Path, values: dict[str, Any]) -> None:
    """Print the remaining errors and the verified levels."""
    from modaltouch.protocol import Calibration

    calibration = Calibration.of({key: value for key, value in values.items() if key != "file"})
    for name, own in calibration.by_stimulus.items():
        _show_stimulus(name, own)
    noise = max(mode.uncertainty_mm_s for own in calibration.by_stimulus.values() for mode in own.modes)
    amplifier = calibration.amplifier
    corner = "not known" if amplifier.bandwidth_kHz is None else f"{amplifier.bandwidth_kHz:.0f} kHz"
    say(
        f"Amplifier: delay {amplifier.delay_us:.2f} us, corner {corner}; errors are known to {noise:.2f} mm/s (95 %), "
        "including the vibrometer's sensitivity"
    )
    if calibration.mark:
        say(f"Marked: {calibration.mark}", fg="yellow")
    say(f"Written: {out}")
    marked = " --with-marked-calibration" if calibration.mark else ""
    say(f"Next: modaltouch run {protocol} --calibration {out}{marked}")


def _show_stimulus(name: str, own: Any) -> None:
    """Print the errors and verified levels of one stimulus."""
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
    print_table(
        f"{whose}Errors at the focusing instant, as measured",
        ("iteration", "worst velocity error mm/s", "worst w eta error mm/s", "peak voltage V"),
        turns,
    )
    levels = [
        (
            f"{level.velocity_mm_s:g}",
            f"{level.at_focus_mm_s:.1f} ± {level.uncertainty_mm_s:.1f}",
            f"{level.highest_mm_s:.1f}",
            " ".join(f"{volts:.4g}" for volts in level.amplitude_Vpp),
        )
        for level in own.levels
    ]
    print_table(
        f"{whose}Levels at the centre of the focus zone, mm/s",
        ("level", "at the focusing instant", "highest over the burst", "amplitude Vpp"),
        levels,
    )


def compare(
    protocol: PROTOCOL,
    out: Annotated[
        Path | None, typer.Option(help="Folder for page, figures and tables.", show_default="comparison/<protocol>")
    ] = None,
    points: Annotated[int, typer.Option(min=3, max=1001, help="Control points along the beam.")] = 41,
    averages: Annotated[int, typer.Option(min=2, max=1000, help="Records at each point.")] = 2,
    beams: Annotated[
        int,
        typer.Option(
            min=1,
            max=10_000,
            help="Other beams, drawn at random around the learned one, on which the drives are played.",
        ),
    ] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first other beam.")] = 1,
    json_output: JSON = False,
) -> None:
    """Compare the drive laws with time reversal and inverse filtering: one beam, one voltage limit, one page.

    Everything runs on the twin, whose true beam is the reference. All methods learn from the same recordings.
    """
    carry_out(
        _show_comparison,
        json_output,
        lab.compare,
        protocol,
        out=out,
        points=points,
        averages=averages,
        beams=beams,
        seed=seed,
    )


def _show_comparison(values: dict[str, Any]) -> None:
    """Print the methods side by side, and the path of the page."""
    title, columns = f"Target: {values['velocity_mm_s']:g} mm/s at the focus", [m["name"] for m in values["methods"]]
    _show_quantities(title, columns, lab.comparison_table(values["methods"]))
    print("\n".join(f"Identification: {text}" for text in values["identification"]))
    print(values["files"]["comparison.html"])


def _show_quantities(title: str, columns: list[str], lines: list[dict[str, Any]]) -> None:
    """Print a table with a row for each quantity, as on the page."""
    names = [f"{line['quantity']} [{line['unit']}]" if line["unit"] != "1" else line["quantity"] for line in lines]
    rows = [(name, *line["cells"]) for name, line in zip(names, lines, strict=True)]
    print_table(title, ("quantity [unit]", *columns), rows)


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
    rows: Annotated[
        int,
        typer.Option(min=1, help="Rows of points across the width, an odd number; with 3 or more, Fig. 7 is a map."),
    ] = 1,
    record: RECORD = None,
    json_output: JSON = False,
) -> None:
    """Play the drive by both laws, scan the beam, and show the paper's Fig. 2 and 5 to 8 on one page.

    The highest level of the protocol is played. The measured field is compared with the target; errors are in mm/s.
    """
    carry_out(
        _show_validation,
        json_output,
        lab.validate,
        protocol,
        calibration=calibration,
        rig=rig,
        out=out,
        scan=scan,
        points=points,
        averages=averages,
        rows=rows,
        record=record,
    )


def _show_validation(values: dict[str, Any]) -> None:
    """Print the drive laws side by side, what they reached in words, and the path of the page."""
    title = f"Measured at {values['laws'][0]['velocity_mm_s']:g} mm/s"
    columns = [f"law {law['law']}" for law in values["laws"]]
    _show_quantities(title, columns, lab.validation_table(values["laws"]))
    print(*values["findings"], values["files"]["validation.html"], sep="\n")


fingers = typer.Typer(
    name="fingers",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="Measure the fingers on the beam.",
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
        str, typer.Option(help="Zones that the fingers rest on, such as A-C.", show_default="the first pair")
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
        float,
        typer.Option(
            "--speed-mm-s", min=0.1, max=50, help="Highest speed under the fingers and the laser; 15 can be felt."
        ),
    ] = 15.0,
    seed: SEED_OF_TWIN = None,
    record: RECORD = None,
    json_output: JSON = False,
) -> None:
    """Probe the beam with hands off and on, and write what each finger adds to it.

    By default, sines of at most 15 mm/s are played, each for half a second. The result is a file for
    `stimulus.fingers` and `modaltouch check --fingers`, which gives the level that a design for these fingers reaches
    under them, with its 95 % interval. The table must contain all modes of the beam, including even ones; `modaltouch
    identify --modes all` finds them.
    """
    carry_out(
        _show_fingers,
        json_output,
        lab.probe_fingers,
        protocol,
        out,
        rig=rig,
        pair=pair,
        hand=hand,
        laser=None if laser_mm is None else laser_mm * 1e-3,
        speed=speed_mm_s * 1e-3,
        seed=seed,
        record=record,
        lay=ask_for,
    )


def _show_fingers(result: dict[str, Any]) -> None:
    """Print the fingers, the levels that a design for them reaches, and the path of the file."""
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
    print_table(
        "Designed for these fingers, mm/s at the focus",
        ("placement", "misfit", "asked", "level (95 %)", "attainable"),
        levels,
    )
    print(
        "Not in the intervals: the vibrometer's sensitivity, known to "
        f"{result['sensitivity_uncertainty_percent']:g} %, an error all levels share."
    )
    print(f"Written: {result['file']}")
    print(
        f"Next: name it in the protocol, `stimulus: {{fingers: {result['file']}}}`, and run `modaltouch check` on that"
    )
