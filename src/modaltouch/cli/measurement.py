"""What the commands that measure a beam share: whose rig, how far, and who moves the vibrometer."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


class MeasurementProgress:
    """Bars on standard error, out of the way while somebody is asked to aim.

    Parameters
    ----------
    bars : rich.progress.Progress
        Where they are shown.
    """

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, what: str, done: int, total: int) -> None:
        """Show how much of something is done."""
        if what not in self._tasks:
            self._tasks[what] = self._bars.add_task(what, total=total)
        self._bars.update(self._tasks[what], completed=done, total=total)

    def aim(self, position: float) -> None:
        """Have the person at the rig bring the vibrometer's spot to a position [m from mid-beam].

        The outputs are off meanwhile, so Ctrl-C may end it at once.
        """
        with aside(self._bars):
            ask_to_aim(position)


@contextmanager
def bars() -> Iterator[MeasurementProgress]:
    """Show on standard error what is being done, how far it is, and how long the rest will take."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as shown:
        yield MeasurementProgress(shown)


@contextmanager
def aside(bars: Progress) -> Iterator[None]:
    """Have the bars out of the way while somebody is asked for something, and Ctrl-C end that at once."""
    bars.stop()
    noting = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, noting)
        bars.start()


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
