"""``modaltouch new``: a folder for a study, to begin with."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from modaltouch.cli.exit_status import print_json, reporting
from modaltouch.cli.options import JSON


def new(
    folder: Annotated[Path, typer.Argument(help="Folder of the study, new or empty.", show_default=False)],
    template: Annotated[str, typer.Option("--from", help="A shipped protocol.")] = "differentiated_stimulation",
    json_output: JSON = False,
) -> None:
    """Write a study: a shipped protocol with its apparatus, texts and schemas, ready to be changed.

    Its README.md lists the commands in their order. Nothing is ever overwritten.
    """
    from modaltouch.cli.new_study import write_study

    with reporting(json_output=json_output):
        files = write_study(folder, template)
        if json_output:
            print_json({"folder": str(folder), "protocol": str(files[0]), "files": [*map(str, files)]})
        else:
            print(f"{len(files)} files in {folder}; its README.md lists the commands of the study")
            print(f"Next: modaltouch check {shlex.quote(files[0].as_posix())}")
