"""Options shared by several commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modaltouch.cli.output import reporting

SHIPPED_APPARATUS = Path("beam_100x6x2")

# Eager: parsed before the callback of PROTOCOL needs it.
JSON = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.", is_eager=True)]


def _find(context: typer.Context, protocol: Path) -> Path:
    """Refuse a missing protocol before the stimulus modules are loaded."""
    from modaltouch.protocol import Source

    with reporting(json_output=context.params.get("json_output", False)):
        Source.find("protocol", protocol)
    return protocol


PROTOCOL = Annotated[
    Path, typer.Argument(help="A YAML file, or a shipped protocol: `demo`.", show_default=False, callback=_find)
]
CALIBRATION = Annotated[
    Path | None,
    typer.Option(
        help="Calibration file to use, written by `modaltouch calibrate`.", show_default="the one the protocol names"
    ),
]
WITH_MARKED = Annotated[
    bool, typer.Option("--with-marked-calibration", help="Accept a calibration marked as missing its limits.")
]
APPARATUS = Annotated[Path, typer.Option("--apparatus", help="Apparatus: a YAML file, or a shipped one.")]
_OBSERVER = "Observer, a model of how participants answer: a YAML file, or a shipped one such as `paper`."
OBSERVER = Annotated[str, typer.Option(help=_OBSERVER)]
USUAL_OBSERVER = Annotated[
    str | None, typer.Option("--observer", help=_OBSERVER, show_default="paper; fingertip where thresholds matter")
]

RESULTS = Annotated[Path, typer.Option(help="Folder where sessions are recorded.")]
SEED = Annotated[int, typer.Option(min=0, help="Seed of the study; the same for all its participants.")]
MODE = Annotated[str | None, typer.Option(help="Which sessions of a results folder: real, pilot or simulated.")]

SEED_OF_TWIN = Annotated[
    int | None, typer.Option(min=0, help="Seed of the simulated rig, instead of the one in the apparatus file.")
]
