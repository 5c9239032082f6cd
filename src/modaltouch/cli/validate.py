"""``modaltouch validate``: what a drive does to the beam, measured, beside what was wished."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modaltouch.cli.exit_status import print_json, reporting
from modaltouch.cli.measurement import bars
from modaltouch.cli.options import CALIBRATION, JSON, MEASURED_RIG, PROTOCOL

if TYPE_CHECKING:
    from modaltouch.lab.validation.page import ValidationContext
    from modaltouch.lab.validation.recording import Observation
    from modaltouch.preflight import Preflight


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
            help="Folder that keeps the recordings: a scan that was stopped goes on there, a complete one is read "
            "and no rig is opened.",
            show_default="recordings are not kept",
        ),
    ] = None,
    points: Annotated[int, typer.Option(min=3, max=1001, help="Points along the beam, from end to end.")] = 41,
    averages: Annotated[int, typer.Option(min=1, max=1000, help="Records at each point.")] = 10,
    json_output: JSON = False,
) -> None:
    """Play the drive by both laws, scan the beam, and show the paper's Fig. 2 and 5 to 8 on one page.

    The highest level of the protocol is played. Measured is set beside wished, with the errors in mm/s.
    """
    from modaltouch.lab.validation.evidence import evaluate
    from modaltouch.lab.validation.key_figures import key_figures
    from modaltouch.lab.validation.page import COMMAND, as_dict, write_evidence
    from modaltouch.preflight import examine
    from modaltouch.report import refuse_other

    with reporting(json_output=json_output):
        preflight = examine(protocol, calibration).of_one_stimulus()
        experiment = preflight.experiment
        folder = out or Path("validation") / experiment.protocol.protocol
        refuse_other(folder, COMMAND)
        refuse_few_points(points, preflight.stimulus.model.label)
        observed, occasion = _observe(preflight, protocol, rig, scan, points, averages)
        evidences = evaluate(observed)
        figures = [key_figures(each, experiment.protocol.conditions.zone_pairs) for each in evidences]
        files = write_evidence(folder, evidences, figures, occasion)
        if json_output:
            names = {name: str(path) for name, path in files.items()}
            print_json({**as_dict(evidences, figures, occasion), "files": names})
        else:
            tell(figures)
            print(files["validation.html"])


def refuse_few_points(points: int, labels: tuple[int, ...]) -> None:
    """Refuse fewer points along the beam than tell the modelled modes apart.

    Parameters
    ----------
    points : int
        Points from end to end.
    labels : tuple of int
        Labels of the modelled modes.

    Raises
    ------
    typer.BadParameter
        If there are no two points to each half wave of the highest.
    """
    # Mode k has k - 1 nodes; as many points as modes up to it, and half as many again against noise.
    least = -(-3 * max(labels) // 2)
    if points < least:
        raise typer.BadParameter(
            f"given --points {points}; allowed: at least {least}, since fewer cannot tell mode {max(labels)} from the "
            "others; 41 suit the shipped beam"
        )


def _observe(
    preflight: Preflight, protocol: Path, address: str, folder: Path | None, points: int, averages: int
) -> tuple[list[Observation], ValidationContext]:
    """Return what was recorded, now or before, and the occasion."""
    from modaltouch.lab.laboratory import open_laboratory
    from modaltouch.lab.validation.page import ValidationContext
    from modaltouch.lab.validation.recording import complete, read_laws, record_laws
    from modaltouch.system import Interruption, commit

    experiment, (ground, stimulus) = preflight.experiment, preflight.sound
    if folder is not None and complete(folder):
        observed = read_laws(ground, folder)
    else:
        with (
            Interruption() as interruption,
            bars() as showing,
            open_laboratory(experiment.apparatus, address, aim=showing.aim) as laboratory,
        ):
            observed = record_laws(
                ground,
                laboratory,
                stimulus.wish.velocity,
                n_points=points,
                n_records=averages,
                folder=folder,
                source=experiment.sources.apparatus,
                on_progress=showing,
                check=interruption.check,
            )
    settings = observed[0].field.facts["settings"]
    return observed, ValidationContext(
        title=experiment.protocol.title or experiment.protocol.protocol,
        protocol=str(protocol),
        apparatus=experiment.apparatus.apparatus,
        mode=observed[0].field.mode,
        generator=settings["generator"],
        scope=settings["scope"],
        limit=experiment.apparatus.amplifier.limit_V,
        calibration=_calibration(preflight),
        commit=commit(),
    )


def _calibration(preflight: Preflight) -> str:
    """Return the name of the calibration that is used; empty without one."""
    reading = preflight.findings.calibration
    return "" if reading is None else str(reading.source.path)


def tell(figures: list[dict[str, Any]]) -> None:
    """Print the laws side by side.

    Parameters
    ----------
    figures : list of dict
        As `key_figures` returns them, one to each law.
    """
    from rich.console import Console
    from rich.table import Table

    from modaltouch.lab.validation.key_figures import summary

    table = Table(title=f"Measured at {figures[0]['velocity_mm_s']:g} mm/s", title_justify="left")
    table.add_column("quantity [unit]")
    for each in figures:
        table.add_column(f"law {each['law']}", justify="right", no_wrap=True)
    for row in summary(figures):
        name = row["quantity"] if row["unit"] == "1" else f"{row['quantity']} \\[{row['unit']}]"
        table.add_row(name, *row["cells"])
    Console().print(table)
