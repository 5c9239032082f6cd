"""``modaltouch identify``: from a bare beam, or files of measured responses, to a table of modes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modaltouch.cli.faults import BAD_INPUT, leave, print_json, reporting

if TYPE_CHECKING:
    from modaltouch.apparatus import Apparatus
    from modaltouch.document import Source
    from modaltouch.identification.responses import FrequencyResponses
    from modaltouch.measurement import Scan

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


def identify(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Measured responses (.uff, .unv, .csv, .npz, .lvm, .txt), or the folder of an earlier scan, instead "
            "of a rig.",
            show_default=False,
        ),
    ] = None,
    apparatus: Annotated[Path, typer.Option(help="Apparatus, a YAML file: beam, actuator sets, wanted modes.")] = Path(
        "protocols/apparatus/beam_100x6x2.yaml"
    ),
    rig: Annotated[str, typer.Option(help="`simulated`, or the generator's VISA address.")] = "simulated",
    out: Annotated[Path, typer.Option(help="Folder for scans, apparatus file, table and figures.")] = Path(
        "identification"
    ),
    points: Annotated[int, typer.Option(min=2, help="Evenly spaced points of the scan.")] = 41,
    averages: Annotated[
        int, typer.Option(min=1, help="Records averaged at each point; of a file, how many were.")
    ] = 10,
    drive_V: Annotated[float, typer.Option("--drive-V", help="Peak of the excitation at the beam [V].")] = 50.0,
    excitation: Annotated[
        Excitation, typer.Option(help="multisine: all modes at once; chirp: one after the other, as in the paper.")
    ] = Excitation.multisine,
    highest_kHz: Annotated[
        float | None,
        typer.Option(
            "--highest-kHz", help="Highest frequency.", show_default="1.25 times the highest mode, at most 120"
        ),
    ] = None,
    margin_mm: Annotated[float, typer.Option("--margin-mm", help="From the beam's ends to the outer points.")] = 0.5,
    sets: Annotated[
        list[str] | None, typer.Option("--set", help="Actuator set, repeatable.", show_default="all sets")
    ] = None,
    modes: Annotated[
        str, typer.Option(help="Modes of the new table: `listed` in the apparatus file, `all`, or labels as 1,3,5.")
    ] = "listed",
    quantity: Annotated[Quantity | None, typer.Option(help="Of a file that does not say it.")] = None,
    conjugated: Annotated[bool, typer.Option("--conjugated", help="The files follow exp(-i w t).")] = False,
    lowest_Hz: Annotated[
        float | None, typer.Option("--lowest-Hz", help="Of a file's band.", show_default="the whole band")
    ] = None,
    spacing_Hz: Annotated[
        float | None, typer.Option("--spacing-Hz", help="Distance of the bins of a file of bare numbers.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the simulated rig, instead of its own.")] = None,
    json_output: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
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
                    wanted = _Wanted(apparatus, sets, modes, None)
                    result = wanted.fit(wanted.chosen(responses), _file_facts(files), out)
            else:
                wanted = _Wanted(apparatus, sets, modes, scanned)
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
            _show(result)


class _Wanted:
    """What is to be identified, checked before anything is opened."""

    def __init__(self, path: Path, sets: list[str] | None, modes: str, folder: Path | None) -> None:
        from modaltouch.apparatus import read_apparatus
        from modaltouch.document import load_source

        self.source: Source = load_source(path)
        self.apparatus: Apparatus = read_apparatus(path)
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

        from modaltouch.identification.excitation import Campaign, evenly, excite, highest_needed
        from modaltouch.identification.report import refuse_other
        from modaltouch.identification.shapes import check_points
        from modaltouch.interruption import Interrupted, Interruption
        from modaltouch.measurement import open_laboratory

        refuse_other(out)
        positions = evenly(self.length, points, margin)
        check_points(np.array(positions), self.labels, self.length)
        highest = highest_needed(self.apparatus) if highest_kHz is None else highest_kHz * 1e3
        campaign = Campaign(positions, averages, voltage, highest, self.sets, excitation)
        for name in self.sets:
            excite(self.apparatus, name, voltage, highest, "chirp")
        done = [0, 0]
        with Interruption() as interruption, _progress("points measured") as on_progress:

            def show(n: int, total: int) -> None:
                done[:] = n, total
                on_progress(n, total)

            try:
                with open_laboratory(
                    self.apparatus, rig, seed=seed, repetition="continuous", aim=_ask_to_aim
                ) as laboratory:
                    scans = campaign.scan(laboratory, self.source, out, on_progress=show, check=interruption.check)
            except Interrupted as error:
                error.add_note(f"{done[0]} of {done[1]} points are kept in {out}; give the same command to go on")
                raise
        return scans

    def read(self) -> dict[str, Scan]:
        """Return the scans of a folder."""
        from modaltouch.measurement import read_scan

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
        from modaltouch.identification.excitation import LOWEST
        from modaltouch.identification.responses import responses_of

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
        from modaltouch.identification.apparatus_file import identified_apparatus
        from modaltouch.identification.excitation import CLOCK_TOLERANCE
        from modaltouch.identification.identified import identify as identify_responses
        from modaltouch.identification.report import as_dict, check_modes, refuse_other, write_identification
        from modaltouch.identification.shapes import check_points

        refuse_other(out)
        if responses.positions is not None:
            check_points(responses.positions, self.labels, self.length)
        with _progress("fitting", counted=False):
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
    from modaltouch.identification.identified import identify_each
    from modaltouch.identification.report import as_dict, refuse_other, write_identification

    refuse_other(out)
    with _progress("fitting", counted=False):
        found = identify_each(responses)
    written = write_identification(out, found, None, {"sources": [path.name for path in files]})
    return {
        **as_dict(found),
        "mode": "file",
        "apparatus_file": None,
        "files": {key: str(path) for key, path in written.items()},
    }


def _ask_to_aim(position: float) -> None:
    """Ask whoever stands at the beam to move the vibrometer's spot; the outputs are off."""
    if sys.stdin.isatty():
        typer.echo(f"\nAim the vibrometer at {position * 1e3:+.2f} mm, then press Enter. ", err=True, nl=False)
        sys.stdin.readline()


@contextmanager
def _progress(what: str, *, counted: bool = True) -> Iterator[Callable[[int, int], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

    description = TextColumn("{task.description}")
    columns = (
        (description, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        if counted
        else (SpinnerColumn(), description)
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task(what, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def _show(result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    table = Table(
        title="Table I by joint fit, in brackets the half-width of the 95 % interval in the last digits; half-power "
        "beside it",
        title_justify="left",
        box=None,
        pad_edge=False,
    )
    gains = [name for name in result["sets"] if any(name in mode["gain_mm_s2_per_V"] for mode in result["modes"])]
    wanted = result.get("table_modes")
    headings = ["mode", "f [Hz]", "xi", *(f"G {name}" for name in gains), "MAC", "f peak", "xi half"]
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for mode in result["modes"]:
        if wanted is not None and mode["label"] not in wanted:
            continue
        half = mode["half_power"]
        table.add_row(
            str(mode["label"] or ""),
            _with_interval(mode["natural_frequency_Hz"]),
            _with_interval(mode["damping_ratio"]),
            *(_with_interval(mode["gain_mm_s2_per_V"].get(name)) for name in gains),
            _plain(mode["mac"], ".4f"),
            _plain(half["peak_frequency_Hz"], ".6g"),
            _plain(half["damping_ratio"], ".4f") if half["resolved"] else "-",
        )
    console.print(table)
    if gains:
        console.print("[dim]Gains in mm/s^2 per V at the beam[/]")
    for mode in result["modes"]:
        warning = mode["half_power"]["warning"]
        if warning and (wanted is None or mode["label"] in wanted):
            name = f"mode {mode['label']}" if mode["label"] else f"{mode['natural_frequency_Hz']['value']:.6g} Hz"
            console.print(f"[yellow]No half-power damping of {name}: {warning}[/]")
    others = [mode for mode in result["modes"] if wanted is not None and mode["label"] not in wanted]
    if others:
        listed = ", ".join(f"{mode['natural_frequency_Hz']['value']:.0f}" for mode in others)
        console.print(f"[dim]Also seen, and kept out of the table: {listed} Hz[/]")
    beam = result["free_free"]
    if beam is not None:
        verdict = "are" if beam["recognised"] else "are not"
        modes = ", ".join(str(mode) if mode else "-" for mode in beam["bending_modes"])
        console.print(
            f"The natural frequencies {verdict} those of a free-free beam: bending modes {modes}, within "
            f"{beam['deviation']:.2%}"
        )
    if result["apparatus_file"]:
        console.print(f"Written: {result['apparatus_file']}, with table and figures beside it")
    else:
        console.print(
            "[dim]No apparatus file: without positions along the beam there are no shapes, without them no gains[/]"
        )


def _with_interval(pair: dict[str, float | None] | None) -> str:
    """Return a value with its interval's half-width in the last digits, as 228.855(11)."""
    import math

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
