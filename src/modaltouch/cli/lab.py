"""What the commands that measure a beam share: progress bars, who moves the vibrometer, and how a report is given."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import typer

from modaltouch.cli.exit_status import print_json
from modaltouch.cli.tables import make_bars

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from modaltouch.lab import MeasurementProgress


class LabReport(Protocol):
    """What a command of the lab returns."""

    def write(self) -> dict[str, Any]:
        """Write the files and return everything as plain values."""


def give(report: LabReport, show: Callable[[dict[str, Any]], None], *, json_output: bool) -> None:
    """Write a report's files, and print what it holds."""
    (print_json if json_output else show)(report.write())


@contextmanager
def bars() -> Iterator[MeasurementProgress]:
    """Show on standard error what is being done and how far it is; ask there for the vibrometer to be aimed."""
    from modaltouch.lab import MeasurementProgress, TooFewPointsError

    shown = make_bars()
    tasks: dict[str, TaskID] = {}
    aimed: list[float] = []

    def show(what: str, done: int, total: int) -> None:
        shown.start()
        if what not in tasks:
            tasks[what] = shown.add_task(what, total=total)
        shown.update(tasks[what], completed=done, total=total)

    def aim(position: float) -> None:
        """Ask once for a place, however many records follow each other there."""
        if aimed != [position]:
            with _aside(shown):
                ask_for(f"Aim the vibrometer at {position * 1e3:+.2f} mm from mid-beam")
            aimed[:] = [position]

    try:
        yield MeasurementProgress(show=show, say=shown.print, aim=aim)
    except TooFewPointsError as error:
        raise typer.BadParameter(str(error)) from None
    finally:
        # Where nothing was measured, nothing was shown.
        if shown.live.is_started:
            shown.stop()


@contextmanager
def _aside(bars: Progress) -> Iterator[None]:
    """Have the bars out of the way while somebody is asked for something, and Ctrl-C end that at once."""
    bars.stop()
    noting = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, noting)
        bars.start()


def ask_for(words: str) -> None:
    """Ask for something to be done at the beam, and wait until it is."""
    typer.echo(f"{words}, then press Enter.", err=True)
    try:
        input()
    except EOFError:
        raise typer.BadParameter(
            "nobody is there to aim the vibrometer or to lay fingers on (standard input is closed); allowed: a "
            "terminal; start the command from one"
        ) from None
