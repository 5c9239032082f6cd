"""``modaltouch identify``: from a bare beam, or files of measured responses, to a table of modes."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modaltouch.cli.exit_status import BAD_INPUT, leave, print_json, reporting
from modaltouch.cli.options import APPARATUS, JSON, MEASURED_RIG, SHIPPED_APPARATUS, progress

if TYPE_CHECKING:
    from modaltouch.lab.identification.responses import FrequencyResponses
import math
from typing import TYPE_CHECKING

from modaltouch.cli.measurement import bars

if TYPE_CHECKING:
    from modaltouch.lab.identification.responses import FrequencyResponses
    from modaltouch.lab.measurement import Scan
    from modaltouch.protocol import Apparatus, Source


class IdentifyOptions:
    """What is to be identified, checked before anything is opened."""

    def __init__(self, path: Path, sets: list[str] | None, modes: str, folder: Path | None) -> None:
        from modaltouch.protocol import Apparatus, Source

        self.source: Source = Source.find("apparatus", path)
        self.apparatus: Apparatus = Apparatus.read(self.source)
        self.sets = tuple(sets or self.apparatus.actuator_sets)
        self.folder = folder
        strange = next((name for name in self.sets if name not in self.apparatus.actuator_sets), None)
        if strange is not None:
            known = ", ".join(self.apparatus.actuator_sets)
            raise ValueError(f"'{strange}' is not an actuator set of {path}: name one of {known}")
        self.modes = modes
        self.labels = self._labels(modes)
        self.length = self.apparatus.beam.length_mm * 1e-3

    def _labels(self, modes: str) -> tuple[int, ...]:
        """Return the labels that must be found; with ``all``, those that the table lists."""
        if modes in ("listed", "all"):
            return tuple(mode.label for mode in self.apparatus.modes)
        try:
            labels = tuple(sorted({int(word) for word in modes.split(",")}))
        except ValueError:
            labels = ()
        if not labels or labels[0] < 1:
            raise ValueError(f"--modes is '{modes}': give `listed`, `all`, or labels from 1 on, as 1,3,5")
        return labels

    def measure(
        self,
        rig: str,
        out: Path,
        points: int,
        averages: int,
        voltage: float,
        excitation: Any,
        highest_kHz: float | None,
        margin: float,
        seed: int | None,
    ) -> dict[str, Scan]:
        """Return the scans of a rig, new or gone on with."""
        import numpy as np

        from modaltouch.lab.identification.excitation import Campaign, evenly, excite, highest_needed
        from modaltouch.lab.identification.report import COMMAND
        from modaltouch.lab.identification.shapes import check_points
        from modaltouch.lab.measurement import open_laboratory
        from modaltouch.report import refuse_other
        from modaltouch.system import Interrupted, Interruption

        refuse_other(out, COMMAND)
        positions = evenly(self.length, points, margin)
        check_points(np.array(positions), self.labels, self.length)
        highest = highest_needed(self.apparatus) if highest_kHz is None else highest_kHz * 1e3
        campaign = Campaign(positions, averages, voltage, highest, self.sets, excitation)
        for name in self.sets:
            excite(self.apparatus, name, voltage, highest, "chirp")
        done = [0, 0]
        with Interruption() as interruption, bars() as showing:

            def show(n: int, total: int) -> None:
                done[:] = n, total
                showing("points measured", n, total)

            try:
                with open_laboratory(
                    self.apparatus, rig, seed=seed, repetition="continuous", aim=showing.aim
                ) as laboratory:
                    scans = campaign.scan(laboratory, self.source, out, on_progress=show, check=interruption.check)
            except Interrupted as error:
                error.add_note(f"{done[0]} of {done[1]} points are kept in {out}; give the same command to go on")
                raise
        return scans

    def read(self) -> dict[str, Scan]:
        """Return the scans of a folder."""
        from modaltouch.lab.measurement import read_scan

        folder = self.folder or Path()
        scans = {}
        for name in self.sets:
            place = folder / f"scan_{name}"
            if not place.is_dir():
                raise ValueError(
                    f"{folder}: holds no scan of the actuator set {name} ({place.name} is missing); measure it, or "
                    "name the sets that were measured with --set"
                )
            scans[name] = read_scan(place)
        return scans

    def reduced(self, scans: dict[str, Scan], place: Path) -> tuple[FrequencyResponses, dict[str, Any]]:
        """Return the responses of scans, and what is to be known of their measurement."""
        from modaltouch.lab.identification.excitation import LOWEST
        from modaltouch.lab.identification.responses import responses_of

        responses = responses_of(scans, self.bandwidth)
        first = next(iter(scans.values())).facts
        facts = {
            "date": first["begun"],
            "mode": first["mode"],
            "source": place.as_posix(),
            "generator": first["settings"]["generator"],
            "scope": first["settings"]["scope"],
            "method": f"{first['settings']['about']['stimulus']}, H1 by the measured drive, joint fit of all responses",
        }
        return responses.between(1.5 * LOWEST, float(responses.frequency[-1])), facts

    def chosen(self, responses: FrequencyResponses) -> FrequencyResponses:
        """Return the responses of the wanted actuator sets, which a file names."""
        import dataclasses

        missing = [name for name in self.sets if name not in responses.sets]
        if missing:
            raise ValueError(
                f"the files hold responses to {', '.join(responses.sets)}, none to the actuator set {missing[0]}: name "
                "the sets in the files as in the apparatus file, or those that were measured with --set"
            )
        rows = [responses.sets.index(name) for name in self.sets]
        coherence = None if responses.coherence is None else responses.coherence[rows]
        return dataclasses.replace(
            responses,
            response=responses.response[rows],
            coherence=coherence,
            sets=self.sets,
            bandwidth=self.bandwidth,
        )

    @property
    def bandwidth(self) -> float | None:
        """Corner of the vibrometer's low-pass [Hz]."""
        kilohertz = self.apparatus.acquisition.vibrometer_bandwidth_kHz
        return None if kilohertz is None else kilohertz * 1e3

    def fit(self, responses: FrequencyResponses, facts: dict[str, Any], out: Path) -> dict[str, Any]:
        """Return the identification as plain values, its files written."""
        from modaltouch.lab.identification.apparatus_file import identified_apparatus
        from modaltouch.lab.identification.excitation import CLOCK_TOLERANCE
        from modaltouch.lab.identification.joint_fit import identify as identify_responses
        from modaltouch.lab.identification.report import COMMAND, as_dict, check_modes, write_identification
        from modaltouch.lab.identification.shapes import check_points
        from modaltouch.report import refuse_other

        refuse_other(out, COMMAND)
        if responses.positions is not None:
            check_points(responses.positions, self.labels, self.length)
        with progress("fitting", counted=False):
            found = identify_responses(responses, self.length, clock_tolerance=CLOCK_TOLERANCE)
        check_modes(found, self.labels)
        labels = self.labels
        if self.modes == "all":
            labels = tuple(mode.label for mode in found.modes if mode.label is not None)
        name, text = identified_apparatus(self.source, found, labels, facts)
        written = write_identification(out, found, (name, text), {"sources": facts["source"]})
        return {
            **as_dict(found),
            "mode": facts["mode"],
            "table_modes": list(labels),
            "apparatus_file": str(written[name]),
            "files": {key: str(path) for key, path in written.items()},
        }


WIDE = 88
"""Columns of a terminal from which the picked peaks are shown too."""


def show(result: dict[str, Any]) -> None:
    """Print what was identified: Table I, what half-power cannot say, what else was seen, where it was written."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    wanted = result.get("table_modes")
    listed = [mode for mode in result["modes"] if wanted is None or mode["label"] in wanted]
    gains = [name for name in result["sets"] if any(name in mode["gain_mm_s2_per_V"] for mode in result["modes"])]
    console.print(_table(Table, listed, gains, wide=console.width >= WIDE))
    if gains:
        console.print("[dim]Gains in mm/s^2 per V at the beam[/]")
    for reason, names in _unresolved(listed).items():
        console.print(f"[yellow]No half-power damping of {', '.join(names)}: {reason}[/]")
    others = [f"{mode['natural_frequency_Hz']['value']:.0f}" for mode in result["modes"] if mode not in listed]
    if others:
        console.print(f"[dim]Also seen, and kept out of the table: {', '.join(others)} Hz[/]")
    beam = result["free_free"]
    if beam is not None:
        verdict = "are" if beam["recognised"] else "are not"
        modes = ", ".join(str(mode) if mode else "-" for mode in beam["bending_modes"])
        console.print(
            f"The natural frequencies {verdict} those of a free-free beam: bending modes {modes}, within "
            f"{beam['deviation']:.2%}"
        )
    if result["apparatus_file"]:
        console.print(f"Written: {result['apparatus_file']}, with table and figures beside it", markup=False)
    else:
        console.print(
            "[dim]No apparatus file: without positions along the beam there are no shapes, without them no gains[/]"
        )


def _table(table_kind: Any, modes: list[dict[str, Any]], gains: list[str], *, wide: bool) -> Any:
    """Return Table I; in a wide terminal with the picked peaks too."""
    table = table_kind(
        title="Table I by joint fit, in brackets the half-width of the 95 % interval in the last digits; half-power "
        "beside it",
        title_justify="left",
        box=None,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    peak = ["f peak"] if wide else []
    for heading in ("mode", "f [Hz]", "xi", *(f"G {name}" for name in gains), "MAC", *peak, "xi half"):
        table.add_column(heading, justify="right", no_wrap=True)
    for mode in modes:
        half = mode["half_power"]
        table.add_row(
            str(mode["label"] or ""),
            _with_interval(mode["natural_frequency_Hz"]),
            _with_interval(mode["damping_ratio"]),
            *(_with_interval(mode["gain_mm_s2_per_V"].get(name)) for name in gains),
            _plain(mode["mac"], ".4f"),
            *([_plain(half["peak_frequency_Hz"], ".6g")] if wide else []),
            _plain(half["damping_ratio"], ".4f") if half["resolved"] else "-",
        )
    return table


def _unresolved(modes: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Return why half-power says no damping, each reason with the names of its modes."""
    reasons: dict[str, list[str]] = {}
    for mode in modes:
        if reason := mode["half_power"]["warning"]:
            name = f"mode {mode['label']}" if mode["label"] else f"{mode['natural_frequency_Hz']['value']:.6g} Hz"
            reasons.setdefault(reason, []).append(name)
    return reasons


def _with_interval(pair: dict[str, float | None] | None) -> str:
    """Return a value with its interval's half-width in the last digits, as 228.855(11)."""
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
                    wanted = IdentifyOptions(apparatus, sets, modes, None)
                    result = wanted.fit(wanted.chosen(responses), _file_facts(files), out)
            else:
                wanted = IdentifyOptions(apparatus, sets, modes, scanned)
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
    from modaltouch.lab.identification.files import ResponseFormat, read_responses

    how = ResponseFormat(None if quantity is None else quantity.value, conjugated, spacing, averages)
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
    from modaltouch.lab.identification.joint_fit import identify_each
    from modaltouch.lab.identification.report import COMMAND, as_dict, write_identification
    from modaltouch.report import refuse_other

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
