"""Style of the figures, in the paper's colours and legible in greyscale, and their reproducible SVG and PNG output."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

PAIR_COLOURS = ("#0b3c8c", "#5bb8e8", "#f4c518", "#9a5b9f", "#2f9e77", "#c4c4c4")
"""Dark blue, light blue and yellow as in Fig. 10 and Fig. 11, then colours for further pairs."""

CONDITION_COLOURS = ("#0b3c8c", "#c2541b", "#2f9e77", "#9a5b9f")
INK = "#1d2530"
FAINT = "#5d6775"
"""Legible on white: contrast 5.7."""

_RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "figure.constrained_layout.use": True,
    # The default height; unless it is set, Matplotlib looks for ticks above every axes at each draw.
    "axes.titley": 1.0,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "hatch.linewidth": 0.6,
    "svg.hashsalt": "modaltouch",
    "svg.fonttype": "path",
}

PNG_DPI = 200


@contextmanager
def house_style(
    width: float = 7.6, height: float = 3.0, n_rows: int = 1, n_columns: int = 1, **panels: Any
) -> Iterator[tuple[Figure, NDArray[Any]]]:
    """Create a figure in the project's style without changing matplotlib's global settings.

    Parameters
    ----------
    width, height : float
        Size of the figure [inch].
    n_rows, n_columns : int
        Number of panels.
    **panels
        Further arguments of `matplotlib.figure.Figure.subplots`.

    Yields
    ------
    figure : Figure
        The figure.
    panels : (n_rows, n_columns) array
        The axes.
    """
    with mpl.rc_context(_RC):
        figure = Figure(figsize=(width, height))
        yield figure, figure.subplots(n_rows, n_columns, squeeze=False, **panels)


def render(figure: Figure, kind: str) -> bytes:
    """Render a figure as ``svg`` or ``png``; the same figure always gives the same bytes."""
    buffer = io.BytesIO()
    with mpl.rc_context(_RC):
        # Lay out once for both formats, since layout takes as long as drawing. With the rcParam on, None would select
        # constrained layout again.
        engine = figure.get_layout_engine()
        with mpl.rc_context({"figure.constrained_layout.use": False}):
            if engine is not None:
                engine.execute(figure)
                figure.set_layout_engine(None)
            metadata = {"svg": {"Date": None, "Creator": "modaltouch"}, "png": {"Software": "modaltouch"}}
            figure.savefig(buffer, format=kind, dpi=PNG_DPI, metadata=metadata[kind])
    return buffer.getvalue()


def figure_files(figures: Mapping[str, Figure]) -> dict[str, bytes]:
    """Return figures as SVG and PNG, by file name.

    Parameters
    ----------
    figures : mapping of str to Figure
        Figures by name.
    """
    return {f"{name}.{kind}": render(figure, kind) for name, figure in figures.items() for kind in ("svg", "png")}


def quiet_grid(axes: Axes) -> None:
    """Draw faint horizontal lines behind the data."""
    axes.set_axisbelow(True)
    axes.grid(axis="y", color="#e3e7ec", linewidth=0.7)
