"""Universal files: frequency responses (data set 58), or time records, with their nodes and units."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.lab.identification.responses import Key, MeasuredResponse, Part, Place, Quantity, ResponseFormat
from modaltouch.lab.identification.time_records import TimeRecord, part_of

_FUNCTION, _TIME, _RESPONSE, _FORCE = 58, 1, 4, 13
_NODES = (15, 2411)
_UNITS = 164
_QUANTITIES: dict[int, Quantity] = {8: "displacement", 11: "velocity", 12: "acceleration"}
"""Quantity of each specific data type of an ordinate's numerator."""


def read_universal(path: Path, how: ResponseFormat) -> Part:
    """Read the responses in a universal file, or compute them from its time records.

    Places are those of the response nodes, relative to the middle of all nodes: `along` is the axis of the largest
    extent of the nodes, `across` that of the second largest.
    """
    sets = _read_sets(path)
    functions = [each for each in sets if each["type"] == _FUNCTION and each["func_type"] in (_TIME, _RESPONSE)]
    if not functions:
        raise ValueError(
            f"{path}: it contains no frequency response and no time record; export data set 58 of type 4 or 1"
        )
    responses = [each for each in functions if each["func_type"] == _RESPONSE]
    moved = responses or [each for each in functions if _kind(each) in _QUANTITIES]
    places, size = _places(sets, moved), _size(sets)
    directions = {abs(int(each["rsp_dir"])) for each in moved}

    def name(function: dict[str, Any], reference: float) -> Key:
        node, direction = int(function["rsp_node"]), abs(int(function["rsp_dir"]))
        # A single word, as are the names of actuator sets in an apparatus file.
        label = f"reference_{int(reference)}" + (f"_node_{node}" if node not in places else "")
        return label + (f"_direction_{direction}" if len(directions) > 1 else ""), places.get(node)

    kinds = {_kind(each) for each in moved}
    if len(kinds) > 1:
        raise ValueError(
            f"{path}: it contains responses of several quantities (types {sorted(kinds)}); export only one"
        )
    quantity = _QUANTITIES.get(next(iter(kinds), 0))
    if responses:
        frequency, *others = (np.asarray(each["x"], dtype=float) for each in responses)
        if any(other.shape != frequency.shape or not np.allclose(other, frequency) for other in others):
            raise ValueError(f"{path}: its responses have different frequencies; export them on the same axis")
        keys = [name(each, each["ref_node"]) for each in responses]
        if any(int(each.get("orddenom_spec_data_type", 0)) in _QUANTITIES for each in responses):
            raise ValueError(f"{path}: it contains ratios of two motions; export responses to the excitation")
        values = [np.asarray(each["data"], dtype=np.complex128) * (_sign(each) / size) for each in responses]
        by_force = all(int(each.get("orddenom_spec_data_type", 0)) == _FORCE for each in responses)
        return Part(frequency, list(map(MeasuredResponse, keys, values)), quantity, per="N" if by_force else "")
    records = []
    drive = next((each for each in functions if _kind(each) not in _QUANTITIES), None)
    for each in functions:
        if _kind(each) not in _QUANTITIES:
            drive = each
        elif drive is not None:
            # Each motion belongs to the preceding excitation.
            step = float(each["x"][1] - each["x"][0])
            key = name(each, drive["rsp_node"])
            motion = np.real(each["data"]) * (_sign(each) / size)
            records.append(TimeRecord(key, np.real(drive["data"]) * _sign(drive), motion, step))
    if not records:
        raise ValueError(
            f"{path}: its time records are not one excitation followed by motions; mark each by the data type of its "
            "ordinate (8 displacement, 11 velocity, 12 acceleration, 13 force)"
        )
    return part_of(path, records, quantity, how, "N" if drive is not None and _kind(drive) == _FORCE else "")


def _sign(function: dict[str, Any]) -> float:
    """Return -1 if only one of response and reference points against its axis, else 1."""
    return -1.0 if (float(function["rsp_dir"]) < 0) != (float(function.get("ref_dir", 0)) < 0) else 1.0


def _kind(function: dict[str, Any]) -> int:
    return int(function.get("ordinate_spec_data_type", 0))


def _read_sets(path: Path) -> list[dict[str, Any]]:
    """Read the data sets of a universal file."""
    import pyuff

    lines = path.read_bytes().rstrip().splitlines()
    # Binary numbers may precede the end mark in its line.
    if b"    -1" in map(bytes.rstrip, lines) and not lines[-1].endswith(b"    -1"):
        raise ValueError(f"{path}: it ends within a data set: it was cut off; export or copy it again")
    try:
        file = pyuff.UFF(str(path))
        # Sets that are not needed may be large, or of a type that the library prints or cannot read.
        kinds = file.get_set_types()
        needed = np.flatnonzero(np.isin(kinds, (_FUNCTION, *_NODES, _UNITS)))
        read = file.read_sets(needed.tolist()) if needed.size else []
    # The library raises bare exceptions and any error of its parser.
    except Exception as error:
        raise ValueError(f"{path}: cannot be read as a universal file ({error}); export it again") from error
    return read if isinstance(read, list) else [read]


def _places(sets: list[dict[str, Any]], functions: list[dict[str, Any]]) -> dict[int, Place]:
    """Return the places of the response nodes relative to the middle of all nodes; empty without coordinates."""
    measured = {int(each["rsp_node"]) for each in functions}
    place = {
        int(number): [float(each[axis][i]) for axis in ("x", "y", "z")]
        for each in sets
        if each["type"] in _NODES
        for i, number in enumerate(each["node_nums"])
    }
    if not measured <= set(place) or len(measured) < 2:
        return {}
    coordinates = np.array(list(place.values()))
    axes = np.argsort(-np.ptp(coordinates, axis=0), kind="stable")[:2]
    middle = (coordinates.max(axis=0) + coordinates.min(axis=0)) / 2
    return {node: Place(*((np.array(place[node]) - middle)[axes] / _size(sets)).tolist()) for node in measured}


def _size(sets: list[dict[str, Any]]) -> float:
    """Return the number of the file's units of length per metre; 1 if it states no unit."""
    factors = [float(each["length"]) for each in sets if each["type"] == _UNITS]
    return factors[0] if factors and factors[0] > 0 else 1.0
