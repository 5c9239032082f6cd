"""Options that several commands take, each defined once."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from modaltouch.cli.exit_status import reporting

SHIPPED_APPARATUS = Path("beam_100x6x2")


class ThemeChoice(StrEnum):
    """Colours of the window."""

    dark = "dark"
    light = "light"


# Eager: known before a protocol is looked for.
JSON = Annotated[bool, typer.Option("--json", help="One JSON object on standard output.", is_eager=True)]


def _find(context: typer.Context, protocol: Path) -> Path:
    """Refuse a protocol that is not there before what designs its stimulus is loaded."""
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
        help="Calibration file to use, as `modaltouch calibrate` wrote it.", show_default="the one the protocol names"
    ),
]
WITH_MARKED = Annotated[
    bool,
    typer.Option("--with-marked-calibration", help="Take a calibration that is marked since it misses its limits."),
]
APPARATUS = Annotated[Path, typer.Option("--apparatus", help="Apparatus: a YAML file, or a shipped one.")]
_OBSERVER = "Who is simulated: a YAML file, or a shipped observer such as `paper` or `near_miss`."
OBSERVER = Annotated[str, typer.Option(help=_OBSERVER)]
USUAL_OBSERVER = Annotated[
    str | None, typer.Option("--observer", help=_OBSERVER, show_default="paper; fingertip where thresholds matter")
]

SESSION = Annotated[Path, typer.Argument(help="A session's folder or its session.jsonl.", show_default=False)]
RECORDS = "A session's folder or its session.jsonl, or a folder of sessions"
RESULTS = Annotated[Path, typer.Option(help="Folder where sessions are recorded.")]
SEED = Annotated[int, typer.Option(min=0, help="Seed of the study; the same for all its participants.")]
MODE = Annotated[str | None, typer.Option(help="Which sessions of a results folder: real, pilot or simulated.")]

FULLSCREEN = Annotated[
    bool | None,
    typer.Option(
        "--fullscreen/--windowed",
        help="Answer window over the whole screen.",
        show_default="windowed; a resumed session keeps its own",
    ),
]
SIZE = Annotated[
    str | None,
    typer.Option(
        help="Size of the answer window in pixels, where it is not full screen.",
        show_default="1280x800; a resumed session keeps its own",
    ),
]
THEME = Annotated[
    ThemeChoice | None,
    typer.Option(help="Colours of the answer window.", show_default="dark; a resumed session keeps its own"),
]
SCREEN = Annotated[
    int | None,
    typer.Option(
        min=0, help="Which screen shows the answer window.", show_default="0; a resumed session keeps its own"
    ),
]
SCREENSHOTS = Annotated[Path | None, typer.Option(help="Folder for a picture of each kind of screen.")]

EVENTS = Annotated[
    Path | None,
    typer.Option(help="File or named pipe for the session's state as JSON lines; a pipe nobody reads delays nothing."),
]
PLAIN = Annotated[bool, typer.Option("--plain", help="Plain lines instead of the live console, and no keys.")]

MEASURED_RIG = Annotated[
    str, typer.Option(help="`simulated`, or the generator's VISA address; a real one is measured with a PicoScope.")
]
RECORD = Annotated[
    Path | None,
    typer.Option(
        help="Folder where another scope leaves its records as CSV or NPZ files, each as it is asked for.",
        show_default="measured with a PicoScope",
    ),
]
SEED_OF_TWIN = Annotated[int | None, typer.Option(min=0, help="Instead of the seed in the apparatus file.")]
