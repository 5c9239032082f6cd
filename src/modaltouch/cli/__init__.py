"""The command line: what the commands share, and the group that imports each of them when it is called.

Commands take arguments and produce lines, JSON and an exit status. The other packages do the work.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, get_args, get_origin

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

if TYPE_CHECKING:
    from rich.progress import Progress

__all__ = ["BAD_INPUT", "INTERRUPTED", "app", "print_json"]


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]], *, n_words: int = 1) -> None:
    """Print a table whose columns after the first `n_words` are numbers.

    On a narrow screen, headings and words wrap between words; numbers never wrap, and no column is cut off.
    """
    lines = [list(row) for row in rows]
    columns = [[heading, *(line[place] for line in lines)] for place, heading in enumerate(headings)]
    widths = [max(1, *map(len, column)) for column in columns]
    most = shutil.get_terminal_size().columns - 3 * len(headings) - 1
    if sum(widths) > most:
        natural, widths = widths, []
        for place, (heading, *cells) in enumerate(columns):
            unbroken = [*heading.split(), *(" ".join(cells).split() if place < n_words else cells)]
            widths.append(max(1, *map(len, unbroken)))
        for place in range(n_words):
            widths[place] = max(widths[place], min(natural[place], widths[place] + most - sum(widths)))

    def draw(cells: Sequence[str], edge: str) -> None:
        wrapped = (textwrap.wrap(cell, width) or [""] for cell, width in zip(cells, widths, strict=True))
        for parts in itertools.zip_longest(*wrapped, fillvalue=""):
            shown = (each.ljust(width) if place < n_words else each.rjust(width)
                     for place, (each, width) in enumerate(zip(parts, widths, strict=True)))  # fmt: skip
            print(edge, f" {edge} ".join(shown), edge)

    def rule(left: str, line: str, cross: str, right: str) -> None:
        print(left + cross.join(line * (width + 2) for width in widths) + right)

    say(*filter(None, [title]))
    rule("┏", "━", "┳", "┓")
    draw(headings, "┃")
    rule("┡", "━", "╇", "┩")
    for line in lines:
        draw(line, "│")
    rule("└", "─", "┴", "┘")


def say(*lines: str, **style: Any) -> None:
    """Print lines, wrapped between words to the width of the terminal, in a style as of `typer.style`."""
    width = shutil.get_terminal_size().columns
    plain = False if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" else None
    for line in lines:
        for part in textwrap.wrap(line, width, break_long_words=False, break_on_hyphens=False) or [""]:
            typer.secho(part, color=plain, **style)


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


def _known(context: typer.Context, protocol: Path) -> Path:
    """Refuse a missing protocol before the stimulus modules are loaded."""
    from modaltouch.protocol import Source

    with reporting(json_output=context.params.get("json_output", False)):
        Source.find("protocol", protocol)
    return protocol


PROTOCOL = Annotated[
    Path,
    typer.Argument(help="A YAML file, or a shipped protocol: `demo`.", show_default=False, callback=_known),
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


MODULES = {
    "demo": "run",
    "new": "new",
    "check": "check",
    "calibrate": "lab",
    "run": "run",
    "resume": "run",
    "simulate": "simulate",
    "analyse": "analyse",
    "power": "planning",
    "prereg": "planning",
    "fit": "planning",
    "identify": "identify",
    "fingers": "lab",
    "validate": "lab",
    "compare": "lab",
    "study": "records",
    "verify": "records",
    "doctor": "records",
    "rig": "rig",
}
"""Module of this package in which each command is defined, in the order in which commands are listed."""


class _Value:
    """Type of a parameter that converts strings and paths itself and leaves the rest to typer.

    Typer would load pydantic even for options that are not given.
    """

    def __init__(self, read_by_typer: Any) -> None:
        self._read_by_typer = read_by_typer

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """Convert the given value, or the default, to the type that the command takes."""
        kind = param.type_descriptor.annotation
        is_list = get_origin(kind) is list
        if value is None or (value is param.default and not is_list):
            return () if is_list else value
        words, kind = (value, get_args(kind)[0]) if is_list else ([value], kind)
        if any(word != word.encode(errors="replace").decode() for word in map(str, words)):
            # Records are UTF-8 and could not hold this name.
            raise typer.BadParameter(f"given {value!a}; allowed: names in UTF-8; rename it", ctx, param)
        # Typer refuses files that exist but cannot be read.
        is_open = kind is Path and all(os.access(word, os.R_OK) or not os.path.lexists(word) for word in words)
        if kind is str or is_open:
            read = [kind(word) for word in words]
            return read if is_list else read[0]
        try:
            return self._read_by_typer().coerce(value, param=param, ctx=ctx)
        except typer.BadParameter as error:
            if kind is not Path:
                allowed = _allowed(kind, param.type_descriptor.parameter_info)
                error.message = f"given {', '.join(words)}; allowed: {allowed}"
            raise


def _allowed(kind: Any, bounds: Any) -> str:
    """Return the phrase for the allowed values of a number or a choice."""
    if get_args(kind):
        return ", ".join(get_args(kind))
    words = "a whole number" if kind is int else "a number"
    if bounds.min is None:
        return words
    return f"{words} from {bounds.min} to {bounds.max}" if bounds.max else f"{words}, {bounds.min} or more"


def _of_each(told_by_typer: Any) -> str:
    """Return the type name shown in the help; for a list, that of its items."""
    return str(told_by_typer()).removeprefix("list[").removesuffix("]").lower()


class _Reading:
    """Mixin for commands whose parameter values are converted by `_Value`."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, including the help option."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for each in params:
            # Versions of typer without this hook convert all values themselves.
            if hasattr(each, "get_runtime_param") and "get_runtime_param" not in vars(each):
                each.get_runtime_param = partial(_Value, each.get_runtime_param)
                each.bare_type = partial(_of_each, each.bare_type)
        return params


class _Command(_Reading, TyperCommand):
    """A command whose values are converted by `_Value`."""


class CommandGroup(_Reading, TyperGroup):
    """Group of commands that imports a module when its command is called, and all modules to list them."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes | {"commands": dict.fromkeys(MODULES)})

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command of a name; None if there is none."""
        if cmd_name in MODULES and self.commands[cmd_name] is None:
            self.commands[cmd_name] = _load(cmd_name)
        return self.commands.get(cmd_name)

    def invoke(self, ctx: Any) -> Any:
        """Run a command; report a Ctrl-C during its import, on which typer is silent."""
        json_output = "--json" in ctx.args
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            leave(INTERRUPTED, "interrupted; nothing was begun", json_output=json_output)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands with their summaries, without building every option as typer would."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, _summary(_find(name))) for name in MODULES])


def _find(name: str) -> Any:
    """Return the function of a command, or its Typer instance if it has sub-commands."""
    return getattr(import_module(f"modaltouch.cli.{MODULES[name]}"), name)


def _summary(command: Any) -> str:
    """Return a Typer's help, or the first line of a function's docstring, which typer would truncate."""
    return str(command.info.help if isinstance(command, typer.Typer) else command.__doc__).partition("\n")[0]


def _load(name: str) -> Any:
    """Import and build a command or a group of commands."""
    found = _find(name)
    if not isinstance(found, typer.Typer):
        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        alone.command(name)(found)
        found = alone
    for each in found.registered_commands:
        each.cls = _Command
        each.short_help = _summary(each.callback)
    return get_command(found)


app = typer.Typer(
    name="modaltouch",
    cls=CommandGroup,
    help=(
        "Run a psychophysics experiment on a vibrating beam, from a YAML protocol to the statistics of the paper.\n\n"
        "To try it: `modaltouch demo`. Then `modaltouch new study`, whose README.md lists the commands in order: "
        "`modaltouch check PROTOCOL`, `modaltouch run PROTOCOL -p p01`, `modaltouch analyse results`.\n\n"
        "Exit status: 0 done; 2 invalid input, with its location; 3 rig or window failed, outputs are off; "
        "4 a record is damaged or would be overwritten; 130 interrupted, outputs are off, data kept."
    ),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    # Plain-text help: Rich takes four times as long to load as everything else.
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(asked: bool) -> None:
    if asked:
        from modaltouch.system import version

        print(version())
        raise typer.Exit


@app.callback()
def version(
    asked: Annotated[
        bool, typer.Option("--version", help="Print the version and end.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Print the version where it is asked for."""
