"""Tables that a protocol names, of cells and of the points of a field, and its listed cells, with their checks."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from modaltouch.protocol.reading import Reading
from modaltouch.protocol.source import Problem, Source, suggest
from modaltouch.protocol.stimulus_sections import POINT_COLUMNS, Points, StimulusVariant, unordered
from modaltouch.protocol.tree import Node, resolve

DERIVED = ("zone_pairs", "peak_velocities_mm_s", "finger_conditions", "zones")
"""Keys of the section ``conditions`` derived from cells."""

_REQUIRED = ("zone_left", "zone_right", "peak_velocity_mm_s")
COLUMNS = (*_REQUIRED, "zone_between", "finger_condition", "stimulus", "weight")
"""Columns of a table of cells; the last four are optional, and their fields and `zone_right` may be empty."""


def with_cells(source: Source, root: Node, table: Source | None) -> tuple[Node, list[Problem]]:
    """Add the cells of a table, and the keys derived from cells, to the tree of a protocol; return tree and problems.

    Values from the table keep their position there, so that later problems refer to the table.
    """
    conditions, problems = root.child("conditions"), list[Problem]()
    if conditions is None:
        return root, problems
    written = [key for key in ("table", "cells", *DERIVED[:2], "zones") if conditions.child(key)]
    for other in written[1:]:
        given, place = f"{other} and {written[0]}, which say the same", conditions.keys[other]
        problems.append(
            Problem(str(source.path), *place, f"conditions.{other}", given, "one of the two", "remove one of them")
        )
    if table is not None and "table" in written:
        listed, faults = _read_table(table)
        problems += faults
        conditions = conditions.with_child("cells", listed)
    cells = conditions.child("cells")
    rows = [] if cells is None else [row for row in cells.children if isinstance(row.content, dict)]
    pairs = [node for row in rows if (node := row.child("pair")) is not None]
    zones = "zone_pairs" if all(len(node.children) == 2 for node in pairs) else "zones"
    for key, own in zip((zones, *DERIVED[1:3]), ("pair", "peak_velocities_mm_s", "finger_conditions"), strict=True):
        if cells is None or conditions.child(key) is not None:
            continue
        found = [node for row in rows if (node := row.child(own)) is not None]
        found = found if own == "pair" else [each for node in found for each in node.children]
        if found:
            unlike: dict[object, Node] = {}
            for node in found:
                # 80 and 80.0 are the same level.
                value = node.plain()
                unlike.setdefault(value if isinstance(value, (int, float)) else str(value), node)
            conditions = conditions.with_child(key, Node([*unlike.values()], cells.line, cells.column, file=cells.file))
    return root.with_child("conditions", conditions), problems


def at_own_levels(reading: Reading[Any]) -> Reading[Any]:
    """Return a protocol whose tree contains only the levels of its value, with their positions."""
    root, levels = reading.root, reading.find(("conditions", "peak_velocities_mm_s"))
    conditions = None if root is None else root.child("conditions")
    if root is None or conditions is None or levels is None or reading.value is None:
        return reading
    own = [each for each in levels.children if each.content in reading.value.conditions.peak_velocities_mm_s]
    listed = conditions.with_child("peak_velocities_mm_s", replace(levels, content=own))
    return replace(reading, root=root.with_child("conditions", listed))


def without_derived(reading: Reading[Any]) -> tuple[Problem, ...]:
    """Return the problems of a protocol except those of keys derived from cells, which are reported at the cells."""
    follows = (*DERIVED[:2], "zones", *(DERIVED[2:3] if reading.find(("conditions", "table")) else ()))
    derived = tuple(f"conditions.{key}" for key in follows)
    return tuple(each for each in reading.problems if not each.path.startswith(derived))


def _read_table(source: Source) -> tuple[Node, list[Problem]]:
    """Return the rows of a table of cells in the form of a protocol's list, and the problems of the table."""
    path, rows, problems = str(source.path), list[Node](), list[Problem]()
    lines = source.text.splitlines()
    header = lines[0] if lines else ""
    separator = _separator(header)
    names = [name for name, _ in _fields(header, separator)]
    missing = [name for name in _REQUIRED if name not in names]
    for name, column in _fields(header, separator):
        if name not in COLUMNS or names.count(name) > 1:
            meant = suggest(name, set(COLUMNS) - set(names))
            missing = [each for each in missing if each != meant]
            remedy = f"did you mean '{meant}'?" if meant else "remove it"
            if name in StimulusVariant.model_fields:
                remedy = f"give it to the `stimuli` of the protocol ({name}), and name one in the column stimulus"
            problems.append(
                Problem(path, 1, column, "", f"the column {name!r}", f"once each: {', '.join(COLUMNS)}", remedy)
            )
    if missing:
        given = f"a table without the column{'s' * (len(missing) > 1)} {', '.join(missing)}"
        problems.append(Problem(path, 1, 1, "", given, ", ".join(COLUMNS), "name the columns in the first line"))
    for number, line in enumerate(lines[1:], start=2):
        fields = _fields(line, separator)
        if not line.strip() or problems and problems[0].line == 1:
            continue
        if len(fields) != len(names):
            given, allowed = f"{len(fields)} field{'s' * (len(fields) != 1)}", f"{len(names)}, one for each column"
            remedy = "correct the line"
            if line.count('"') % 2:
                given, allowed, remedy = "an unpaired quotation mark", "quotation marks in pairs", "close it"
            elif separator == "," and len(fields) > len(names):
                remedy += "; a decimal comma splits a number into two fields: write 80.5"
            problems.append(Problem(path, number, 1, "", given, allowed, remedy))
            continue
        rows.append(_row(path, number, dict(zip(names, fields, strict=True))))
    if not rows and not problems:
        problems.append(Problem(path, 1, 1, "", "a table without rows", "at least one cell", "write one to a line"))
    return Node(rows, 1, 1, file=path), problems


def _separator(header: str) -> str:
    return next((mark for mark in ",;\t" if mark in header), ",")


def _fields(line: str, separator: str) -> list[tuple[str, int]]:
    """Split a line into fields, each with its start column, from 1."""
    found, end = [], 0
    for field in next(csv.reader([line], delimiter=separator, skipinitialspace=True), []):
        begin = max(end, line.find(field.replace('"', '""').strip(), end))
        found.append((field.strip(), begin + 1))
        end = begin + len(field.strip()) + 1
    return found


def _row(path: str, line: int, fields: dict[str, tuple[str, int]]) -> Node:
    def node(name: str) -> Node:
        word, column = fields[name]
        content = resolve(word) if name in ("peak_velocity_mm_s", "weight") else word or None
        return Node(content, line, column, {name: (line, column)}, text=word, file=path)

    def several(*names: str) -> Node:
        nodes = [node(name) for name in names]
        return Node(nodes, line, nodes[0].column, dict.fromkeys(names, (line, 1)), file=path)

    zones = ("zone_left", "zone_between", "zone_right")
    given = [name for name in zones if fields.get(name, ("", 0))[0]]
    row = {"pair": several(*given or zones[:1]), "peak_velocities_mm_s": several("peak_velocity_mm_s")}
    row |= {f"{key}": several(name) for key, name in _OPTIONAL.items() if fields.get(name, ("", 0))[0]}
    if fields.get("weight", ("", 0))[0]:
        row["weight"] = node("weight")
    return Node(row, line, 1, {key: (each.line, each.column) for key, each in row.items()}, file=path)


_OPTIONAL = {"finger_conditions": "finger_condition", "stimuli": "stimulus"}


_NAME_IT = "add it there, or leave it out"


def check_cells(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield the problems of listed and excluded cells: unknown names, and levels that are set in another way."""
    conditions = reading.sound("conditions")
    if conditions is None:
        return
    key = "cells" if conditions.cells else "exclude"
    for other, path in (("adaptive", ("adaptive",)), ("sensation_levels", ("conditions", "sensation_levels"))):
        if reading.sound(*path) is not None:
            yield reading.problem(
                ("conditions", key),
                f"{key} with {other}, which sets its own levels",
                "one of the two",
                "remove one of them",
            )
            return
    names = {"finger_condition": conditions.finger_conditions, "stimulus": tuple(reading.keys("stimuli") or ())}
    nouns = "a finger condition of the protocol", "a stimulus of the protocol"
    for index in range(len(conditions.cells)):
        for key, noun, known in zip(("finger_conditions", "stimuli"), nouns, names.values(), strict=True):
            yield from reading.unlisted(("conditions", "cells", index, key), noun, known, _NAME_IT)
    for index, left_out in enumerate(conditions.exclude):
        for noun, (kind, known) in zip(nouns, names.items(), strict=True):
            if (name := getattr(left_out, kind)) is not None and name not in known:
                yield reading.unknown(("conditions", "exclude", index, kind), noun, known, _NAME_IT)


def check_excluded(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield excluded cells not in the design, and finger conditions and stimuli without cells, if all else is valid."""
    protocol = reading.require()
    conditions = protocol.conditions
    every = [(name, cell) for name in conditions.finger_conditions for cell in protocol.cells(name, excluded=True)]
    for index, left_out in enumerate(conditions.exclude):
        if not any(left_out.holds(*each) for each in every):
            yield reading.problem(
                ("conditions", "exclude", index),
                "cells that are not in the design",
                "cells of the design",
                "correct it, or remove it",
            )
    for name in protocol.stimuli:
        if not protocol.with_stimulus(name).conditions.peak_velocities_mm_s:
            yield reading.problem(
                ("stimuli", name),
                f"{name}, which is in no cell",
                "stimuli with cells",
                "leave it out, or give it cells",
                at_key=True,
            )
    for index, name in enumerate(conditions.finger_conditions):
        if not protocol.cells(name):
            yield reading.problem(
                ("conditions", "finger_conditions", index),
                f"{name}, which has no cells left",
                "finger conditions with cells",
                "leave it out, or give it cells",
            )


def are_crossed(conditions: Mapping[str, Any], stimuli: Iterable[str] = ()) -> bool:
    """Test whether the cells of a design, without those left out, are every combination of its factors, equally often.

    Parameters
    ----------
    conditions : mapping
        A section ``conditions`` as plain values.
    stimuli : iterable of str
        Names of the stimuli.
    """
    fingers, names = conditions.get("finger_conditions"), tuple(stimuli) or ("",)
    contacts, levels = conditions.get("zones") or conditions.get("zone_pairs"), conditions.get("peak_velocities_mm_s")
    listed, excluded = conditions.get("cells"), conditions.get("exclude")
    if not (listed or excluded):
        return True
    met = Counter(
        (finger_condition, tuple(each["pair"]), level, stimulus)
        for each in listed or [{"pair": pair, "peak_velocities_mm_s": levels or ()} for pair in contacts or ()]
        for finger_condition in each.get("finger_conditions") or fingers or ("",)
        for level in each["peak_velocities_mm_s"]
        for stimulus in each.get("stimuli") or names
        for _ in range(each.get("weight", 1))
    )
    left_out = [
        (each.get("finger_condition"), tuple(each.get("pair") or ()) or None, each.get("peak_velocity_mm_s"),
         each.get("stimulus"))
        for each in excluded or ()
    ]  # fmt: skip
    kept = {
        cell: n
        for cell, n in met.items()
        if not any(all(want in (None, own) for want, own in zip(each, cell, strict=True)) for each in left_out)
    }
    n_crossed = math.prod(len(set(part)) for part in zip(*kept, strict=True))
    return len(kept) == n_crossed and len(set(kept.values())) == 1


def read_points(source: Source) -> tuple[Points, list[Problem]]:
    """Read the points in a file, positions [mm] and relative velocities; return points and problems.

    Other columns, and text beyond the last column, may contain anything.
    """
    path, lines = str(source.path), source.text.splitlines()
    separator = _separator(lines[0] if lines else "")
    # The empty line at the end is a row of its own unless a quotation mark is left open.
    rows = csv.reader([*lines, ""], delimiter=separator, skipinitialspace=True)
    header = [name.strip() for name in next(rows)]
    if any(header.count(name) != 1 for name in POINT_COLUMNS):
        given = f"the columns {separator.join(header) or 'of an empty file'}"
        allowed = f"{', '.join(POINT_COLUMNS)}, once each"
        return (), [Problem(path, 1, 1, "", given, allowed, "name them in the first line")]
    places = [header.index(name) for name in POINT_COLUMNS]
    n_named = max(place for place, name in enumerate(header, start=1) if name)
    points, problems, numbers = list[tuple[float, float]](), list[Problem](), list[int]()
    end = rows.line_num
    for row in rows:
        begin, end = end + 1, rows.line_num
        words = [word.strip() for word in row]
        if not any(words):
            continue
        own = [words[place] if place < len(words) else "" for place in places]
        after = words[max(places) + 1] if any(words[n_named:]) else ""
        if end > len(lines):
            given, allowed, remedy = "an unpaired quotation mark", "quotation marks in pairs", "close it"
        else:
            given, allowed, remedy = repr(lines[begin - 1]), "two finite numbers", _mend(own, after, separator)
        if remedy:
            problems.append(Problem(path, begin, 1, "", given, allowed, remedy))
        else:
            points.append((_number(own[0]), _number(own[1])))
            numbers.append(begin)
    if len(points) < 2 and not problems:
        remedy = f"write one line per point, such as `-20{separator}0.5`"
        problems.append(Problem(path, 1, 1, "", f"{len(points)} points", "at least 2", remedy))
    problems += [
        Problem(path, numbers[index], 1, "", given, "increasing positions", "sort the lines")
        for index, given in unordered(points)
    ]
    return tuple(points), problems


def _mend(point: Sequence[str], after: str, separator: str) -> str:
    """Return the remedy for a line without the two numbers of a point, given the field after them; empty if it has."""
    if math.isfinite(_number(after)):
        split = "a decimal comma splits a number into two fields: write 0.5; or " if separator == "," else ""
        return f"{split}name every column in the first line"
    wrong = [word for word in point if not math.isfinite(_number(word))]
    pointed = wrong[0].replace(",", ".") if wrong else ""
    if math.isfinite(_number(pointed)):
        return f"write {pointed}, with a decimal point"
    return f"write one line per point, such as `-20{separator}0.5`" if wrong else ""


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
