"""The files that every command of the lab writes: figures in two forms, and one page that holds them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from modaltouch.report import render, render_page
from modaltouch.system import version

DARK, MIDDLE, LIGHT = "#0b3c8c", "#5bb8e8", "#dbe3ee"
"""Measured, predicted, asked for: far apart in lightness, so that they differ without colour."""


def rounded(value: Any, digits: int) -> Any:
    """Plain values with every number to some decimals."""
    if isinstance(value, dict):
        return {key: rounded(each, digits) for key, each in value.items()}
    if isinstance(value, list):
        return [rounded(each, digits) for each in value]
    return round(value, digits) if isinstance(value, float) else value


def rendered(figures: Mapping[str, Figure]) -> dict[str, bytes]:
    """SVG and PNG of each figure, by file name."""
    return {f"{name}.{kind}": render(figure, kind) for name, figure in figures.items() for kind in ("svg", "png")}


def page_files(name: str, figures: Mapping[str, tuple[Figure, str]], /, **values: Any) -> dict[str, bytes]:
    """A page and the figures that it shows, by file name.

    Parameters
    ----------
    name : str
        Of the page and of its template.
    figures : mapping of str to (Figure, str)
        Each figure and its caption.
    **values
        What the template names besides.
    """
    files = rendered({key: figure for key, (figure, _) in figures.items()})
    pictures = [{"name": key, "caption": caption, "uri": files[f"{key}.svg"]} for key, (_, caption) in figures.items()]
    page = render_page("modaltouch.lab", f"{name}.html.j2", pictures=pictures, version=version(), **values)
    return {f"{name}.html": page.encode(), **files}
