"""What every generated page is made with: files that change only with their content, and Markdown in one style."""

from collections.abc import Iterable, Sequence
from pathlib import Path

_WRITTEN: set[Path] = set()


def write(file: Path, text: str | bytes) -> None:
    """Write a file where its content is new, so that a build reads again only what has changed."""
    _WRITTEN.add(file)
    data = text.encode() if isinstance(text, str) else text
    if not (file.exists() and file.read_bytes() == data):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)


def remove_others(folder: Path) -> None:
    """Remove the files of a folder that this build did not write."""
    for file in folder.rglob("*"):
        if file.is_file() and file not in _WRITTEN:
            file.unlink()


def page(title: str, *blocks: str) -> str:
    """Return a page of Markdown."""
    return "\n\n".join((f"# {title}", *blocks)) + "\n"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of Markdown; a bar inside a cell is escaped."""
    cells = [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in (head, *rows)]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    return "\n".join((lines[0], "|" + " --- |" * len(head), *lines[1:]))


def definition(name: str, anchor: str, *lines: str) -> str:
    """Return an entry of a list of definitions, which a link can name."""
    return f"[`{name}`]{{#{anchor}}}\n: " + "\n\n  ".join(line for line in lines if line)


def toctree(*names: str, depth: int = 1) -> str:
    """Return the table of contents of pages below this one."""
    return "\n".join(("```{toctree}", f":maxdepth: {depth}", "", *names, "```"))
