"""The ``modaltouch`` command and its sub-commands, each loaded when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from modaltouch.cli.exit_status import INTERRUPTED, leave

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
"""In which module of this room each command is, under its own name, in the order of the list of commands."""


class CommandGroup(TyperGroup):
    """Commands by name; a module is imported when its command is asked for, and all of them for the list."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes | {"commands": dict.fromkeys(MODULES)})

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; None where there is none of that name."""
        if cmd_name in MODULES and self.commands[cmd_name] is None:
            self.commands[cmd_name] = _load(cmd_name)
        return self.commands.get(cmd_name)


def _load(name: str) -> Any:
    """Return a command, or a group of such, made of the function or the Typer that bears its name."""
    try:
        found = getattr(import_module(f"modaltouch.cli.{MODULES[name]}"), name)
    except KeyboardInterrupt:
        leave(INTERRUPTED, "interrupted; nothing was begun")
    if not isinstance(found, typer.Typer):
        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        alone.command(name)(found)
        found = alone
    for each in found.registered_commands:
        # The whole first line in lists of commands, where the library would cut it.
        each.short_help = (getattr(each.callback, "__doc__", None) or "").partition("\n")[0]
    return get_command(found)


app = typer.Typer(
    name="modaltouch",
    cls=CommandGroup,
    help=(
        "Run a psychophysics experiment on a vibrating beam, from a YAML protocol to the statistics of the paper.\n\n"
        "First time: `modaltouch demo`. Then `modaltouch new study`, whose README.md lists the commands in order: "
        "`modaltouch check PROTOCOL`, `modaltouch run PROTOCOL -p p01`, `modaltouch analyse results`.\n\n"
        "Exit status: 0 done; 2 bad input, with its place; 3 rig or window failed, outputs are off; "
        "4 a record is damaged or would be overwritten; 130 interrupted, outputs are off, data kept."
    ),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    # Help as plain text: a library of markup would take four times as long to load as all else.
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
