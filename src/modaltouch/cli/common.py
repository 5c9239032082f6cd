"""What the commands share: options, tables, progress bars, JSON, error messages and exit statuses."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

if TYPE_CHECKING:
    from rich.progress import Progress


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]], *, n_words: int = 1) -> None:
    """Print a table whose columns after the first `n_words` are numbers; cells may contain Rich markup.

    On a narrow screen, headings and words wrap between words; numbers never wrap, and no column is cut off.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    lines, console = [[Text.from_markup(cell, emoji=False) for cell in row] for row in rows], Console(emoji=False)
    columns = [[line[place].plain for line in lines] for place in range(len(headings))]
    widest = [max(map(len, [heading, *cells])) for heading, cells in zip(headings, columns, strict=True)]
    rules = 3 * len(headings) + 1
    is_narrow = sum(widest) + rules > console.width
    table = Table(title=title, title_justify="left")
    for place, (heading, cells) in enumerate(zip(headings, columns, strict=True)):
        is_words = place < n_words
        longest = max(map(len, [*heading.split(), *(" ".join(cells).split() if is_words else cells)]), default=1)
        width = None if is_words or not is_narrow else longest
        table.add_column(heading, justify="left" if is_words else "right", min_width=longest, width=width)
    for line in lines:
        table.add_row(*line)
    least = sum(int(column.min_width or 0) for column in table.columns) + rules
    console.width = max(console.width, least)
    console.print(table, crop=False, soft_wrap=False)


def say(*lines: Any, markup: bool = True) -> None:
    """Print lines, which may contain Rich markup, or Rich tables."""
    from rich.console import Console

    Console(highlight=False, emoji=False).print(*lines, sep="\n", markup=markup)


def make_bars() -> Progress:
    """Return progress bars on standard error, with counts and the estimated remaining time."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar; yield a function to be called with (done, total)."""
    with make_bars() as bars:
        task = bars.add_task(what, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)


DONE = 0
BAD_INPUT = 2
RIG_FAILED = 3
RECORD_AT_RISK = 4
INTERRUPTED = 130


@contextmanager
def reporting(*, json_output: bool = False) -> Iterator[None]:
    """Turn an expected error into its message or JSON object and its exit status."""
    try:
        yield
    except (typer.Exit, typer.Abort, typer.BadParameter):
        raise
    except BaseException as error:
        status = exit_status(error)
        if status is None:
            raise
        problems = [problem.as_dict() for problem in getattr(error, "problems", ())]
        why = "; ".join([_say(error, status), *getattr(error, "__notes__", [])])
        leave(status, why, problems, json_output=json_output)


def exit_status(error: BaseException) -> int | None:
    """Return the exit status for an error; None for a programming error."""
    statuses = {
        ("builtins", "KeyboardInterrupt"): INTERRUPTED,
        ("modaltouch.protocol.source", "InputError"): BAD_INPUT,
        ("modaltouch.rig.interface", "RigError"): RIG_FAILED,
        ("modaltouch.window.interface", "WindowError"): RIG_FAILED,
        ("modaltouch.record.chain", "RecordInputError"): BAD_INPUT,
        ("modaltouch.record.chain", "RecordError"): RECORD_AT_RISK,
        ("modaltouch.window.interface", "SessionStopped"): INTERRUPTED,
        ("modaltouch.system.operating_system", "Interrupted"): INTERRUPTED,
    }
    # Look the classes up in modules already loaded: reporting an error must not import PyVISA or pandas.
    for (module, name), status in statuses.items():
        if isinstance(error, getattr(sys.modules.get(module), name, ())):
            return status
    # Session files are readable by their owner only; other users cannot even test whether a file exists.
    return BAD_INPUT if isinstance(error, PermissionError) and error.filename is not None else None


def _say(error: BaseException, status: int) -> str:
    """Return the message for an error."""
    if isinstance(error, KeyboardInterrupt):
        # The connection module is loaded before any instrument is driven.
        nothing = "" if "modaltouch.rig.connection" in sys.modules else "; nothing was driven"
        return "interrupted" + (": the outputs are off" if hasattr(error, "__notes__") else nothing)
    if status == INTERRUPTED:
        return f"ended by {error}: the outputs are off"
    if isinstance(error, PermissionError):
        yours = "only its owner can read a session's files; log in as that user, or give a folder of your own"
        return f"{error.filename}: not accessible to this user ({error.strerror}); {yours}"
    return str(error) or type(error).__name__


def leave(
    status: int, message: str, problems: list[dict[str, Any]] | None = None, *, json_output: bool = False
) -> NoReturn:
    """Print a message and exit with a status."""
    if json_output:
        print_json({"error": message, "problems": problems or []})
    else:
        # The exit status must be returned even if the terminal has hung up and takes no output.
        with suppress(OSError):
            is_plain = status == INTERRUPTED or os.environ.get("TERM") == "dumb"
            typer.secho(message, err=True, fg=None if is_plain else typer.colors.RED)
    raise typer.Exit(status)


def print_json(values: dict[str, Any]) -> None:
    """Print one JSON object on standard output."""
    print(json.dumps(values, ensure_ascii=False, allow_nan=False))


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
