"""A plan as files: tables, everything as JSON, the picture."""

from __future__ import annotations

from pathlib import Path

from modaltouch.planning.power import Power
from modaltouch.report import csv_bytes, json_bytes, write_files
from modaltouch.system import version

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
    from modaltouch.planning.pictures import draw_power
    from modaltouch.report import render

    values = power.as_dict(target)
    figure = draw_power(power, target)
    files = {
        "power.csv": csv_bytes(values["power"]),
        "power_tests.csv": csv_bytes(values["tests"]),
        "power_needed.csv": csv_bytes(values["needed"]),
        "power.json": json_bytes(values),
        "power.svg": render(figure, "svg"),
        "power.png": render(figure, "png"),
    }
    return write_files(folder, files, {"version": version(), "seed": power.study.seed}, COMMAND)
