"""``modaltouch analyse``: tables, bars, statistics and the report."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modaltouch.cli.exit_status import print_json, reporting
from modaltouch.cli.options import JSON, MODE

if TYPE_CHECKING:
    from modaltouch.protocol import AnswerList


def analyse(
    source: Annotated[
        Path,
        typer.Argument(
            help="A results folder, or a CSV with the columns participant, finger_condition, zone_left, zone_right, "
            "velocity_mm_s, response.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for what is written.",
            show_default="derivatives/analysis among the results, or <name>_analysis beside a CSV",
        ),
    ] = None,
    mode: MODE = None,
    stimulus: Annotated[
        str | None, typer.Option(help="Whose trials to take, of sessions with several stimuli.")
    ] = None,
    protocol: Annotated[
        str | None,
        typer.Option(help="Protocol that a CSV's answers were given in, where they are not left, both, right, none."),
    ] = None,
    figures: Annotated[
        str,
        typer.Option(
            help="Figures besides Fig. 10 and 11: fields, order, reaction_times, speed_ratio, or all.",
            show_default="none",
        ),
    ] = "",
    prereg: Annotated[
        Path | None,
        typer.Option(help="Preregistration to hold it against.", show_default="PROTOCOL.prereg.md beside the protocol"),
    ] = None,
    model: Annotated[
        bool, typer.Option("--model", help="Also fit a mixed logistic model, refused where answers are separated.")
    ] = False,
    json_output: JSON = False,
) -> None:
    """Write the tables and bars of Fig. 10 and Fig. 11, exact statistics, and an HTML report."""
    # What loading makes stays: to look for what could go would take a tenth of the time.
    gc.set_threshold(100_000)
    from modaltouch.analysis import analyse as run_analysis

    with reporting(json_output=json_output):
        answers = None if protocol is None else _offered(protocol)
        analysis = run_analysis(
            source,
            out,
            mode=mode,
            stimulus=stimulus,
            answers=answers,
            figures=figures.replace(",", " ").split(),
            prereg=prereg,
            model=model,
        )
        if json_output:
            print_json(analysis.as_dict())
        else:
            tell(analysis)


def _offered(protocol: str) -> AnswerList:
    """Return the answers of a protocol; what reads one is loaded only here."""
    from modaltouch.protocol import Findings

    return Findings.read(protocol).experiment().protocol.answers.offered


def participants(number: int) -> str:
    """Return how many there are in words."""
    return "1 participant" if number == 1 else f"{number} participants"


def tell(analysis: Any) -> None:
    """Print what an analysis found and where it is."""
    values = analysis.as_dict()
    print(f"{values['n_responses']} answers of {participants(values['n_participants'])}")
    for left_out in values["left_out"]:
        typer.secho(f"left out: {left_out['source']}: {left_out['reason']}", err=True, fg=typer.colors.YELLOW)
    for departure in values.get("departures", ()):
        typer.secho(f"departs from the preregistration: {departure}", err=True, fg=typer.colors.YELLOW)
    for name, path in values["files"].items():
        print(f"{name:12} {path}")
