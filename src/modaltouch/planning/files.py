"""Files of a power analysis: tables, JSON, and a figure of power over participants and repetitions."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from modaltouch.analysis import STATISTICS
from modaltouch.planning.power import Power
from modaltouch.report import (
    FAINT,
    INK,
    PAIR_COLOURS,
    house_style,
    quiet_grid,
    write_files,
)
from modaltouch.system import version

_COLUMNS = 3
_LINE_STYLES = ("-", "--", ":", "-.")


def write_power(folder: Path, power: Power, target: float = 0.8) -> dict[str, Path]:
    """Write a power analysis into a folder, and return the path of each file.

    Parameters
    ----------
    folder : Path
        Output folder, created if needed.
    power : Power
        Power analysis with at least one simulated size.
    target : float
        Target power [1].

    Raises
    ------
    RecordError
        If the folder belongs to another command, or cannot be written.
    """
    values = power.as_dict(target)
    files = {
        "power.csv": values["power"],
        "power_tests.csv": values["tests"],
        "power_needed.csv": values["needed"],
        "power.json": values,
    }
    about = {"version": version(), "seed": power.study.seed}
    return write_files(folder, files, about, "power", power=draw_power(power, target))


def draw_power(power: Power, target: float = 0.8) -> Figure:
    """Plot power over the number of participants, one panel per family of tests, with the target power marked.

    Each number of repetitions has a curve with its Monte Carlo intervals.
    """
    families = power.study.families
    n_rows = -(-len(families) // _COLUMNS)
    with house_style(
        3.2 * min(len(families), _COLUMNS) + 0.8, 2.7 * n_rows + 0.5, n_rows, min(len(families), _COLUMNS)
    ) as (figure, axes):
        for place, panel in zip(axes.flat, (*families, *[None] * (axes.size - len(families))), strict=True):
            if panel is None:
                place.set_axis_off()
                continue
            rows = [row for row in power.families if row["family"] == panel]
            _draw_curves(place, rows, power.study.alpha if power.study.null else target)
            place.set_title(textwrap.fill(f"{panel}: {STATISTICS[panel].asks}?", 38), fontsize=8.5)
            place.set_xlabel("participants")
        figure.suptitle(_headline(power), fontsize=9, color=INK)
    return figure


def _draw_curves(place: Axes, rows: list[dict[str, Any]], mark: float) -> None:
    for i, r in enumerate(sorted({row["n_repetitions"] for row in rows})):
        own = sorted((row for row in rows if row["n_repetitions"] == r), key=lambda row: int(row["n_participants"]))
        n = [row["n_participants"] for row in own]
        colour = PAIR_COLOURS[i % len(PAIR_COLOURS)]
        place.fill_between(n, [row["low"] for row in own], [row["high"] for row in own], color=colour, alpha=0.25, lw=0)
        style = _LINE_STYLES[i % len(_LINE_STYLES)]
        place.plot(
            n, [row["power"] for row in own], color=colour, ls=style, marker="o", ms=2.5, label=f"{r} repetitions"
        )
    place.axhline(mark, color=FAINT, lw=0.8, ls=":")
    place.set_ylim(-0.02, 1.02)
    place.set_ylabel("power")
    quiet_grid(place)
    if len({row["n_repetitions"] for row in rows}) > 1:
        place.legend(frameon=False)


def _headline(power: Power) -> str:
    study = power.study
    done = min(tally.n_experiments for found in power.tallies.values() for tally in found.values())
    kind = "false alarms where nothing is to be found" if study.null else "power"
    return (
        f"{study.design.title}, observer {study.observer.name or 'made in code'}: {kind}, at least one test of the "
        f"family significant at {study.alpha:g} after Holm\n"
        f"{done} simulated experiments of each size, seed {study.seed}"
    )
