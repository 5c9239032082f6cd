"""The wished field of a protocol where a shape alone does not say it: several foci, or points, also from a file."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator

from modaltouch.protocol.document import Problem, Reading, Source
from modaltouch.protocol.sections import Protocol

Points = tuple[tuple[float, float], ...]

COLUMNS = ("position_mm", "velocity")
"""Header of a file of points."""

_FIELD = ("stimulus", "field")


def check_wished(reading: Reading[Protocol]) -> Iterator[Problem]:
    """Return the faults between the keys of the wished field, as far as its sound parts show them."""
    shape = reading.sound(*_FIELD, "shape")
    named = [key for key in ("points", "file") if reading.find((*_FIELD, key)) is not None]
    if shape == "sampled" and len(named) != 1:
        given = "a sampled field with " + ("points and a file" if named else "neither points nor a file")
        remedy = f"write `points: [[-20, 0], [0, 1], [20, 0]]`, or `file:` with the columns {', '.join(COLUMNS)}"
        yield reading.problem((*_FIELD, "shape"), given, "one of points, file", remedy)
    if shape is not None and shape != "sampled":
        for key in named:
            given = f"{key} of a field whose shape is {shape}"
            yield reading.problem((*_FIELD, key), given, "only with `shape: sampled`", "write `shape: sampled`")
    foci = reading.items("stimulus", "further_foci")
    focus = reading.sound("stimulus", "focus")
    if shape == "sampled" and foci:
        given = "further foci of a sampled field"
        yield reading.problem(("stimulus", "further_foci"), given, "none", "put them into the points")
    seen = {focus}
    for index, zone in foci:
        if zone in seen:
            given = f"{zone}, a focus already"
            yield reading.problem(("stimulus", "further_foci", index), given, "each zone once", "remove it")
        seen.add(zone)
    points = reading.sound(*_FIELD, "points")
    for index, problem in _unordered(points or ()):
        yield reading.problem((*_FIELD, "points", index), problem, "increasing positions", "sort the points")


def read_points(source: Source) -> tuple[Points, list[Problem]]:
    """Return the points in a file, positions [mm] and relative velocities, and what is wrong with it.

    Parameters
    ----------
    source : Source
        Comma-separated text with a header line that has the columns of `COLUMNS`.
    """
    path, remedy = str(source.path), "write one line to a point, such as `-20,0.5`"
    rows = list(csv.reader(source.text.splitlines()))
    header = [cell.strip() for cell in rows[0]] if rows else []
    if not set(COLUMNS) <= set(header):
        given = f"the columns {', '.join(header) or 'of an empty file'}"
        return (), [Problem(path, 1, 1, "", given, ", ".join(COLUMNS), "name them in the first line")]
    places = [header.index(name) for name in COLUMNS]
    points, problems, lines = [], [], []
    for line, row in enumerate(rows[1:], 2):
        if not row:
            continue
        cells = [_number(row[place]) if place < len(row) else math.nan for place in places]
        if not all(map(math.isfinite, cells)):
            problems.append(Problem(path, line, 1, "", repr(",".join(row)), "two finite numbers", remedy))
            continue
        points.append((cells[0], cells[1]))
        lines.append(line)
    if len(points) < 2 and not problems:
        problems.append(Problem(path, 1, 1, "", f"{len(points)} points", "at least 2", remedy))
    problems += [
        Problem(path, lines[index], 1, "", given, "increasing positions", "sort the lines")
        for index, given in _unordered(points)
    ]
    return tuple(points), problems


def _unordered(points: Points | list[tuple[float, float]]) -> Iterator[tuple[int, str]]:
    for index in range(1, len(points)):
        if points[index][0] <= points[index - 1][0]:
            yield index, f"{points[index][0]:g} mm after {points[index - 1][0]:g} mm"


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
