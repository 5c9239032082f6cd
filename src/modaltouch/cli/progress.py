"""Bars on standard error, for work that takes more than a moment."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress(what: str, *, counted: bool = True) -> Iterator[Callable[[int, int], None]]:
    """Show how much is done and how long the rest will take, or a spinner where nothing is counted.

    Parameters
    ----------
    what : str
        What is done.
    counted : bool
        Whether the function that is yielded will be called with (done, total).
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

    description = TextColumn("{task.description}")
    columns = (
        (description, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        if counted
        else (SpinnerColumn(), description)
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task(what, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
