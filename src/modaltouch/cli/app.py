"""The ``modaltouch`` command and its sub-commands."""

from __future__ import annotations

from typing import Annotated

import typer

from modaltouch.cli import (
    analyse as analysing,
)
from modaltouch.cli import (
    calibrate as calibrating,
)
from modaltouch.cli import (
    check as checking,
)
from modaltouch.cli import (
    compare as comparing,
)
from modaltouch.cli import (
    fit as fitting,
)
from modaltouch.cli import (
    identify as identifying,
)
from modaltouch.cli import (
    new as beginning,
)
from modaltouch.cli import (
    power as planning,
)
from modaltouch.cli import (
    records as looking,
)
from modaltouch.cli import (
    rig as rigs,
)
from modaltouch.cli import (
    run as running,
)
from modaltouch.cli import (
    validate as validating,
)

app = typer.Typer(
    name="modaltouch",
    help=(
        "Run a psychophysics experiment on a vibrating beam, from a YAML protocol to the statistics of the paper.\n\n"
        "First time: `modaltouch demo`. Then `modaltouch new study`, whose README.md lists the commands in their "
        "order: `modaltouch check PROTOCOL`, `modaltouch run PROTOCOL -p p01`, `modaltouch analyse results`.\n\n"
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


app.command("demo")(running.demo)
app.command("new")(beginning.new)
app.command("check")(checking.check)
app.command("calibrate")(calibrating.calibrate)
app.command("run")(running.run)
app.command("resume")(running.resume)
app.command("simulate")(running.simulate)
app.command("analyse")(analysing.analyse)
app.command("power")(planning.power)
app.command("fit")(fitting.fit)
app.command("identify")(identifying.identify)
app.command("validate")(validating.validate)
app.command("compare")(comparing.compare)
app.command("verify")(looking.verify)
app.command("doctor")(looking.doctor)
app.add_typer(rigs.app, name="rig")

for each in (*app.registered_commands, *rigs.app.registered_commands):
    # The whole first line in lists of commands, where the library would cut it.
    each.short_help = (getattr(each.callback, "__doc__", None) or "").partition("\n")[0]
