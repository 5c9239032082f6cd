"""Tables and bars in the terminal, in one form for all commands."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]], *, n_words: int = 1) -> None:
    """Print a table; cells may have Rich's markup, and hold numbers but in the first `n_words` columns."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for place, heading in enumerate(headings):
        table.add_column(heading, justify="left" if place < n_words else "right", no_wrap=place >= n_words)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def make_bars() -> Progress:
    """Return bars on standard error that show how much is done and how long the rest will take."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True))


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show how far something is; yield what is called with (done, total)."""
    with make_bars() as bars:
        task = bars.add_task(what, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)
