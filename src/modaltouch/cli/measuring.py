"""What the commands that measure a beam share: whose rig, how far, and who moves the vibrometer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

RIG = Annotated[
    str, typer.Option(help="`simulated`, or the generator's VISA address; beside a real one stands a PicoScope.")
]


@contextmanager
def progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show on standard error what is being done, how far it is, and how long the rest will take."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as shown:
        tasks: dict[str, TaskID] = {}

        def update(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = shown.add_task(what, total=total)
            shown.update(tasks[what], completed=done, total=total)

        yield update


def ask_to_aim(position: float) -> None:
    """Ask the person at the rig to bring the vibrometer's spot to a position, and wait until it is there.

    Parameters
    ----------
    position : float
        Where, origin at mid-beam [m].
    """
    typer.echo(f"Aim the vibrometer at {position * 1e3:+.2f} mm from mid-beam, then press Enter.", err=True)
    try:
        input()
    except EOFError:
        raise typer.BadParameter(
            "nobody is there to aim the vibrometer (standard input is closed); allowed: a terminal; start the "
            "command from one"
        ) from None
