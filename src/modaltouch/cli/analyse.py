"""``modaltouch analyse``: tables, bar charts, statistics and the report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from modaltouch import analysis, protocol
from modaltouch.cli import JSON, MODE, print_json, reporting

_SOURCE = Annotated[
    list[Path],
    typer.Argument(
        help="A results folder, one results folder per lab, or a CSV with the columns participant, "
        "finger_condition, zone_left, zone_right, velocity_mm_s, response.",
        show_default=False,
    ),
]
_OUT = Annotated[
    Path | None,
    typer.Option(
        help="Folder for the output.",
        show_default="derivatives/analysis in a protocol's results, analysis in one above it, <name>_analysis by a CSV",
    ),
]
ANSWERS = Annotated[
    str | None, typer.Option("--answers", help="What the words in a CSV stand for, such as L=left,B=both,R=right.")
]
MISSING = Annotated[
    str | None,
    typer.Option(help="Words in a CSV that stand for no answer, such as NA,-; an empty field and n/a always do."),
]
_SPEED = Annotated[
    Literal["nominal", "predicted", "delivered"],
    typer.Option(
        help="Speed used as the level: nominal at the focus, or predicted or delivered under the faster finger."
    ),
]

_PREREG = Annotated[
    Path | None,
    typer.Option(
        help="Preregistration to compare the analysis with.", show_default="PROTOCOL.prereg.md next to the protocol"
    ),
]


def analyse(
    source: _SOURCE,
    out: _OUT = None,
    mode: MODE = None,
    stimulus: Annotated[
        str | None,
        typer.Option(
            help="The stimulus whose trials to analyse, for sessions with several stimuli.", show_default="all"
        ),
    ] = None,
    protocol: Annotated[
        str | None,
        typer.Option(
            help="Protocol that the answers of a CSV belong to: defines the possible answers and the equivalence "
            "margin."
        ),
    ] = None,
    answers: ANSWERS = None,
    missing: MISSING = None,
    fields: Annotated[
        bool, typer.Option("--fields", help="Also draw the velocity fields of the stimulus, from a recorded session.")
    ] = False,
    prereg: _PREREG = None,
    model: Annotated[
        bool, typer.Option("--model", help="Also fit a mixed logistic model; refused if the answers are separated.")
    ] = False,
    speed: _SPEED = "nominal",
    json_output: JSON = False,
) -> None:
    """Write the tables and bars of Fig. 10 and Fig. 11, exact statistics, and an HTML report."""
    with reporting(json_output=json_output):
        is_table = any(option is not None for option in (protocol, answers, missing))
        found = analysis.analyse(
            source[0],
            out,
            labs=source[1:],
            mode=mode,
            stimulus=stimulus,
            table_format=_table_format(protocol, answers, missing) if is_table else None,
            fields=fields,
            prereg=prereg,
            model=model,
            speed=speed,
        )
        if json_output:
            print_json(found.as_dict())
        else:
            tell(found)


def _table_format(file: str | None, answers: str | None, missing: str | None) -> analysis.TableFormat:
    """Return the format of a CSV of answers, from the command's options."""
    words, codes = parse_words(answers, missing)
    if file is None:
        return analysis.TableFormat(words=words, missing=codes)
    return analysis.TableFormat.of(protocol.Findings.read(file), words, codes)


def parse_words(answers: str | None, missing: str | None) -> tuple[dict[str, str], tuple[str, ...]]:
    """Parse ``--answers`` into the answer for each word of a CSV, and ``--missing`` into words for no answer."""
    codes = tuple(filter(None, map(str.strip, (missing or "").split(","))))
    if answers is None:
        return {}, codes
    pairs = [part.strip().partition("=") for part in answers.split(",")]
    if not all(word.strip() and sign and answer.strip() for word, sign, answer in pairs):
        raise typer.BadParameter(f"given --answers {answers!r}; allowed: words and answers, such as L=left,R=right")
    return {word.strip(): answer.strip() for word, _, answer in pairs}, codes


def participants(number: int) -> str:
    """Return the phrase for a number of participants."""
    return "1 participant" if number == 1 else f"{number} participants"


def tell(found: Any) -> None:
    """Print a summary of an analysis and the paths of its files."""
    values = found.as_dict()
    print(f"{values['n_responses']} answers of {participants(values['n_participants'])}")
    for note in values.get("notes", ()):
        print(note)
    if values.get("missing"):
        cells = "; ".join(f"{each['participant']} {each['cell']}" for each in values["missing"][:5])
        more = f" and {len(values['missing']) - 5} more cells" if len(values["missing"]) > 5 else ""
        typer.secho(f"missing answers, {values['n_missing']}: {cells}{more}", err=True, fg=typer.colors.YELLOW)
    for reason in dict.fromkeys(each["reason"] for each in values["left_out"]):
        first, *others = (each["source"] for each in values["left_out"] if each["reason"] == reason)
        more = f" and {len(others)} more" if others else ""
        typer.secho(f"left out: {first}{more}: {reason}", err=True, fg=typer.colors.YELLOW)
    for departure in values.get("departures", ()):
        typer.secho(f"departs from the preregistration: {departure}", err=True, fg=typer.colors.YELLOW)
    width = max(map(len, values["files"]))
    for name, path in values["files"].items():
        print(f"{name:{width}} {path}")
