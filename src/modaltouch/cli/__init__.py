"""The command line: options, printed output and exit statuses, and the commands, each imported when it is called.

Commands take arguments and produce lines, JSON and an exit status. The other packages do the work.
"""

from __future__ import annotations

import os
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from modaltouch.cli.common import BAD_INPUT, INTERRUPTED, leave, print_json

__all__ = ["BAD_INPUT", "INTERRUPTED", "app", "print_json"]

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
