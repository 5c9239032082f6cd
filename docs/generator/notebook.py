"""The notebook: a page of the site whose cells are executed, with what they print and draw."""

from __future__ import annotations

import contextlib
import io
import json
import re
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib

from generator.pages import write

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorials" / "own_figure.md"
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)


def cells(page: Path) -> list[tuple[str, str, str]]:
    """Return kind, source and printed output of the cells of a page, in order; output as the page has it."""
    text, at, found = page.read_text(encoding="utf-8"), 0, []
    for block in _BLOCK.finditer(text):
        found.append(("markdown", text[at : block.start()].strip(), ""))
        if block[1] == "python":
            found.append(("code", block[2], ""))
        elif block[1] == "text":
            at_code = max(place for place, cell in enumerate(found) if cell[0] == "code")
            found[at_code] = ("code", found[at_code][1], block[2])
        at = block.end()
    found.append(("markdown", text[at:].strip(), ""))
    # What shows a picture on the site is an output of the notebook.
    prose = (re.sub(r"```\{image\}.*?```", "", source, flags=re.DOTALL).strip() for _, source, _ in found)
    return [(kind, source if kind == "code" else words, said)
            for (kind, source, said), words in zip(found, prose, strict=True) if kind == "code" or words]  # fmt: skip


def execute(page: Path, folder: Path) -> list[tuple[str, str, str, bytes]]:
    """Return kind, source, what was printed, and the picture that was saved, of every cell executed in a folder."""
    names: dict[str, object] = {"__name__": "__main__"}
    done = []
    with contextlib.chdir(folder):
        for kind, source, _ in cells(page):
            said, before = io.StringIO(), set(folder.glob("*.svg"))
            if kind == "code":
                with contextlib.redirect_stdout(said):
                    exec(compile(source, str(page), "exec"), names)
            drawn = sorted(set(folder.glob("*.svg")) - before)
            done.append((kind, source, said.getvalue(), drawn[0].read_bytes() if drawn else b""))
    return done


def notebook(executed: list[tuple[str, str, str, bytes]]) -> str:
    """Return executed cells as a notebook (nbformat 4.5)."""
    told = []
    for place, (kind, source, said, picture) in enumerate(executed):
        cell = {"id": f"cell-{place}", "cell_type": kind, "metadata": {}, "source": source.rstrip("\n")}
        if kind == "code":
            outputs: list[dict[str, object]] = []
            if said:
                outputs.append({"output_type": "stream", "name": "stdout", "text": said})
            if picture:
                data = {"image/svg+xml": picture.decode()}
                outputs.append({"output_type": "display_data", "metadata": {}, "data": data})
            cell |= {"execution_count": None, "outputs": outputs}
        told.append(cell)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {"nbformat": 4, "nbformat_minor": 5, "metadata": {"kernelspec": kernel}, "cells": told}
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def write_notebook(static: Path) -> None:
    """Execute the page, and write its notebook and its pictures."""
    with TemporaryDirectory() as name:
        executed = execute(PAGE, Path(name))
        for picture in Path(name).glob("*.svg"):
            write(static / picture.name, picture.read_bytes())
    write(static / f"{PAGE.stem}.ipynb", notebook(executed))


matplotlib.use("agg")
