"""The ``modaltouch`` command and its sub-commands."""

from __future__ import annotations

from typing import Annotated

import typer

from modaltouch.cli.analyse import analyse
from modaltouch.cli.calibrate import calibrate
from modaltouch.cli.check import check
from modaltouch.cli.compare import compare
from modaltouch.cli.fit import fit
from modaltouch.cli.identify import identify
from modaltouch.cli.new import new
from modaltouch.cli.power import power
from modaltouch.cli.records import doctor, verify
from modaltouch.cli.rig import app as rig_commands
from modaltouch.cli.run import demo, resume, run, simulate
from modaltouch.cli.validate import validate

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


app.command("demo")(demo)
app.command("new")(new)
app.command("check")(check)
app.command("calibrate")(calibrate)
app.command("run")(run)
app.command("resume")(resume)
app.command("simulate")(simulate)
app.command("analyse")(analyse)
app.command("power")(power)
app.command("fit")(fit)
app.command("identify")(identify)
app.command("validate")(validate)
app.command("compare")(compare)
app.command("verify")(verify)
app.command("doctor")(doctor)
app.add_typer(rig_commands, name="rig")

for each in (*app.registered_commands, *rig_commands.registered_commands):
    # The whole first line in lists of commands, where the library would cut it.
    each.short_help = (getattr(each.callback, "__doc__", None) or "").partition("\n")[0]
