"""A plan as files: tables, everything as JSON, the picture."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

from modaltouch import __version__
from modaltouch.analysis.output import write_files
from modaltouch.planning.power import Power

COMMAND = "power"
"""The command that owns the folder."""


def write_power(folder: Path, power: Power, target: float = 0.8) -> dict[str, Path]:
    """Write a plan into a folder, and return where each file lies.

    Parameters
    ----------
    folder : Path
        Where the files go; made where it does not exist.
    power : Power
        The plan; at least one size was simulated.
    target : float
        Power that is wanted [1].

    Raises
    ------
    RecordError
        If the folder holds something else, or cannot be written.
    """
    from modaltouch.analysis.style import render
    from modaltouch.planning.pictures import draw_power

    values = power.as_dict(target)
    figure = draw_power(power, target)
    files = {
        "power.csv": _table(values["power"]),
        "power_tests.csv": _table(values["tests"]),
        "power_needed.csv": _table(values["needed"]),
        "power.json": (json.dumps(values, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode(),
        "power.svg": render(figure, "svg"),
        "power.png": render(figure, "png"),
    }
    return write_files(folder, files, {"version": __version__, "seed": power.study.seed}, COMMAND)


def _table(rows: list[dict[str, Any]]) -> bytes:
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue().encode()
