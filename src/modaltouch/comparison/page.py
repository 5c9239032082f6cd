"""The comparison on one page, and as files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from modaltouch import __version__
from modaltouch.analysis.output import csv_bytes, json_bytes, refuse_other, write_files
from modaltouch.analysis.page import embed_svg, render_page
from modaltouch.analysis.style import level_label, render
from modaltouch.comparison.pictures import draw_drives, draw_fields, draw_price, draw_robustness
from modaltouch.comparison.results import Row, criteria
from modaltouch.comparison.study import Contest
from modaltouch.comparison.words import paragraphs

COMMAND = "compare"
"""The command that owns the folder."""


def as_dict(contest: Contest, rows: Sequence[Row], about: dict[str, Any]) -> dict[str, Any]:
    """Return everything as plain values, as ``modaltouch compare --json`` prints it.

    Parameters
    ----------
    contest : Contest
        The comparison.
    rows : sequence of dict
        As `rows_of` returns them.
    about : dict
        Protocol, apparatus, seed and records at each point (``n_records``), plain values.
    """
    return {
        **about,
        "mode": "simulated",
        "velocity_mm_s": contest.task.wish.velocity * 1e3,
        "voltage_limit_V": contest.known.amplifier.limit,
        "n_points": int(contest.known.responses.position.size),
        "n_other_beams": len(contest.changed[0]),
        "methods": list(rows),
    }


def write_comparison(folder: Path, contest: Contest, rows: Sequence[Row], about: dict[str, Any]) -> dict[str, Path]:
    """Write page, figures and tables into a folder, and return where each file lies.

    Parameters
    ----------
    folder : Path
        Where the files go; made where it does not exist.
    contest, rows, about
        As for `as_dict`; ``about`` also has ``title`` and ``commit``.

    Raises
    ------
    RecordError
        If the folder holds something else, or cannot be written.
    """
    refuse_other(folder, COMMAND)
    values = as_dict(contest, rows, about)
    limit, level = values["voltage_limit_V"], values["velocity_mm_s"]
    figures = {
        "fields": (
            draw_fields(contest),
            "The true velocity field at the focusing instant, and the wished one.",
        ),
        "price": (draw_price(rows, limit), "What each method pays, and what for. Dark: the exact law."),
        "robustness": (
            draw_robustness(contest),
            "The same drives on other beams, drawn around the learned one: each beam a dot, the learned one a line.",
        ),
        "drives": (draw_drives(contest), "The drives; each row has a scale of its own."),
    }
    files: dict[str, bytes] = {}
    pictures = []
    for name, (figure, caption) in figures.items():
        vector = render(figure, "svg")
        files |= {f"{name}.svg": vector, f"{name}.png": render(figure, "png")}
        pictures.append({"name": name, "caption": caption, "uri": embed_svg(vector)})
    files["comparison.json"] = json_bytes(values)
    files["comparison.csv"] = _csv(rows)
    page = render_page(
        "modaltouch.comparison",
        "comparison.html.j2",
        title=f"Comparison: {about['title']}",
        values=values,
        level=level_label(round(level, 6)),
        rows=rows,
        table=_table(rows, level),
        paragraphs=paragraphs(rows, level, values["n_other_beams"]),
        pictures=pictures,
        delay=contest.delay * 1e6,
        version=__version__,
    )
    return write_files(folder, {"comparison.html": page.encode(), **files}, {"version": __version__}, COMMAND)


def _table(rows: Sequence[Row], level: float) -> list[dict[str, Any]]:
    """Return a line to each criterion, with a cell to each method and whether it is the best."""
    lines = []
    for each in criteria(rows):
        best = each.winners(rows, level)
        cells = [{"text": each.printed(row), "best": row in best} for row in rows]
        lines.append({"name": each.name, "unit": each.unit, "cells": cells})
    times = [{"text": f"{row['computing_time_s'] * 1e3:.0f}", "best": False} for row in rows]
    lines.append({"name": "computing time, on this machine", "unit": "ms", "cells": times})
    return lines


def _csv(rows: Sequence[Row]) -> bytes:
    # How long it took is this machine's, and would make other bytes each time.
    left_out = ("computing_time_s", "zone_peak_mm_s")
    flat = [{key: _rounded(value) for key, value in row.items() if key not in left_out} for row in rows]
    for line, row in zip(flat, rows, strict=True):
        line |= {f"zone_peak_{zone}_mm_s": _rounded(peak) for zone, peak in row["zone_peak_mm_s"].items()}
    return csv_bytes(flat)


def _rounded(value: Any) -> Any:
    return round(value, 4) if isinstance(value, float) else value
