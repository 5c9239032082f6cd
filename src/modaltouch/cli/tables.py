"""Tables and bars in the terminal, in one form for all commands."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress


def print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]], *, n_words: int = 1) -> None:
    """Print a table; cells may have Rich's markup, and all columns but the first `n_words` hold numbers.

    On a narrow screen headings and words are wrapped between words; numbers never are, and no column is cut off.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    lines, console = [[Text.from_markup(cell) for cell in row] for row in rows], Console()
    columns = [[line[place].plain for line in lines] for place in range(len(headings))]
    widest = [max(map(len, [heading, *cells])) for heading, cells in zip(headings, columns, strict=True)]
    rules = 3 * len(headings) + 1
    is_narrow = sum(widest) + rules > console.width
    table = Table(title=title, title_justify="left")
    for place, (heading, cells) in enumerate(zip(headings, columns, strict=True)):
        is_words = place < n_words
        longest = max(map(len, [*heading.split(), *(" ".join(cells).split() if is_words else cells)]), default=1)
        width = None if is_words or not is_narrow else longest
        table.add_column(heading, justify="left" if is_words else "right", min_width=longest, max_width=width)
    for line in lines:
        table.add_row(*line)
    least = sum(int(column.min_width or 0) for column in table.columns) + rules
    console.print(table, width=max(console.width, least), crop=False, soft_wrap=False)


def make_bars() -> Progress:
    """Return bars on standard error that show how much is done and how long the rest will take."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar; yield a function to be called with (done, total)."""
    with make_bars() as bars:
        task = bars.add_task(what, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)
