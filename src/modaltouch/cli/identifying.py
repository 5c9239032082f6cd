"""``modaltouch identify``: from a bare beam, or files of measured responses, to a table of modes."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modaltouch.cli.faults import BAD_INPUT, leave, print_json, reporting
from modaltouch.cli.identified import show
from modaltouch.cli.options import JSON, MEASURED_RIG, SHIPPED_APPARATUS
from modaltouch.cli.progress import progress
from modaltouch.cli.wanted import Wanted

if TYPE_CHECKING:
    from modaltouch.identification.responses import FrequencyResponses

FEWEST_SHAPE_POINTS = 6
"""Points of a file from which its modes are told apart by their shapes."""


class Quantity(StrEnum):
    """What a file's responses are of."""

    velocity = "velocity"
    displacement = "displacement"
    acceleration = "acceleration"


class Excitation(StrEnum):
    """What the generator plays."""

    multisine = "multisine"
    chirp = "chirp"


FILES = Annotated[
    list[Path] | None,
    typer.Argument(
        help="Measured responses (.uff, .unv, .csv, .npz, .lvm, .txt), or the folder of an earlier scan, instead "
        "of a rig.",
        show_default=False,
    ),
]
APPARATUS = Annotated[Path, typer.Option(help="Apparatus, a YAML file: beam, actuator sets, wanted modes.")]
OUT = Annotated[Path, typer.Option(help="Folder for scans, apparatus file, table and figures.")]
POINTS = Annotated[int, typer.Option(min=2, help="Evenly spaced points of the scan.")]
AVERAGES = Annotated[int, typer.Option(min=1, help="Records averaged at each point; of a file, how many were.")]
DRIVE = Annotated[float, typer.Option("--drive-V", help="Peak of the excitation at the beam [V].")]
EXCITATION = Annotated[
    Excitation, typer.Option(help="multisine: all modes at once; chirp: one after the other, as in the paper.")
]
HIGHEST = Annotated[
    float | None,
    typer.Option("--highest-kHz", help="Highest frequency.", show_default="1.25 times the highest mode, at most 120"),
]
MARGIN = Annotated[float, typer.Option("--margin-mm", help="From the beam's ends to the outer points.")]
SETS = Annotated[list[str] | None, typer.Option("--set", help="Actuator set, repeatable.", show_default="all sets")]
MODES = Annotated[
    str, typer.Option(help="Modes of the new table: `listed` in the apparatus file, `all`, or labels as 1,3,5.")
]
QUANTITY = Annotated[Quantity | None, typer.Option(help="Of a file that does not say it.")]
CONJUGATED = Annotated[bool, typer.Option("--conjugated", help="The files follow exp(-i w t).")]
LOWEST = Annotated[float | None, typer.Option("--lowest-Hz", help="Of a file's band.", show_default="the whole band")]
SPACING = Annotated[float | None, typer.Option("--spacing-Hz", help="Distance of the bins of a file of bare numbers.")]
SEED = Annotated[int | None, typer.Option(min=0, help="Of the simulated rig, instead of its own.")]


def identify(
    files: FILES = None,
    apparatus: APPARATUS = SHIPPED_APPARATUS,
    rig: MEASURED_RIG = "simulated",
    out: OUT = Path("identification"),
    points: POINTS = 41,
    averages: AVERAGES = 10,
    drive_V: DRIVE = 50.0,
    excitation: EXCITATION = Excitation.multisine,
    highest_kHz: HIGHEST = None,
    margin_mm: MARGIN = 0.5,
    sets: SETS = None,
    modes: MODES = "listed",
    quantity: QUANTITY = None,
    conjugated: CONJUGATED = False,
    lowest_Hz: LOWEST = None,
    spacing_Hz: SPACING = None,
    seed: SEED = None,
    json_output: JSON = False,
) -> None:
    """Identify natural frequencies, damping ratios, gains and shapes of a beam, each with its 95 % interval.

    Each point is on the disk as soon as it is measured. A scan that was stopped goes on when the same command is given
    again. The result is an apparatus file that `modaltouch check` reads, with a table and figures beside it.
    """
    with reporting(json_output=json_output):
        try:
            scanned = files[0] if files and len(files) == 1 and files[0].is_dir() else None
            if files and scanned is None:
                responses = _read_files(files, quantity, conjugated, spacing_Hz, averages, (lowest_Hz, highest_kHz))
                if responses.positions is None or responses.n_points < FEWEST_SHAPE_POINTS:
                    result = _without_shapes(files, responses, out)
                else:
                    wanted = Wanted(apparatus, sets, modes, None)
                    result = wanted.fit(wanted.chosen(responses), _file_facts(files), out)
            else:
                wanted = Wanted(apparatus, sets, modes, scanned)
                scans = (
                    wanted.measure(
                        rig, out, points, averages, drive_V, excitation.value, highest_kHz, margin_mm * 1e-3, seed
                    )
                    if scanned is None
                    else wanted.read()
                )
                result = wanted.fit(*wanted.reduced(scans, scanned or out), out)
        except ValueError as error:
            leave(BAD_INPUT, str(error), json_output=json_output)
        if json_output:
            print_json(result)
        else:
            show(result)


def _read_files(
    files: list[Path],
    quantity: Quantity | None,
    conjugated: bool,
    spacing: float | None,
    averages: int,
    band: tuple[float | None, float | None],
) -> FrequencyResponses:
    from modaltouch.identification.files import Reading, read_responses

    how = Reading(None if quantity is None else quantity.value, conjugated, spacing, averages)
    responses = read_responses(files, how)
    lowest, highest = band
    if lowest is None and highest is None:
        return responses
    end = float(responses.frequency[-1])
    return responses.between(lowest or 0.0, end if highest is None else highest * 1e3)


def _file_facts(files: list[Path]) -> dict[str, Any]:
    import time

    return {
        "date": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "mode": "file",
        "source": ", ".join(path.name for path in files),
        "method": "responses of a file, joint fit of all of them",
    }


def _without_shapes(files: list[Path], responses: FrequencyResponses, out: Path) -> dict[str, Any]:
    """Return the modes of responses at unknown places, or at too few: no shapes, no gains, no apparatus file."""
    from modaltouch.analysis.output import refuse_other
    from modaltouch.identification.identified import identify_each
    from modaltouch.identification.report import COMMAND, as_dict, write_identification

    refuse_other(out, COMMAND)
    with progress("fitting", counted=False):
        found = identify_each(responses)
    written = write_identification(out, found, None, {"sources": [path.name for path in files]})
    return {
        **as_dict(found),
        "mode": "file",
        "apparatus_file": None,
        "files": {key: str(path) for key, path in written.items()},
    }
