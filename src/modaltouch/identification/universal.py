"""Frequency responses of a universal file: data sets 58 on the nodes of 15 or 2411, in units by 164."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.identification.responses import Quantity

_FUNCTION, _RESPONSE = 58, 4
_NODES = (15, 2411)
_UNITS = 164
_QUANTITIES: dict[int, Quantity] = {8: "displacement", 11: "velocity", 12: "acceleration"}
"""What a specific data type of an ordinate's numerator is."""


def read_universal(
    path: Path,
) -> tuple[NDArray[np.float64], dict[tuple[str, float | None], NDArray[np.complex128]], Quantity | None]:
    """Return frequencies [Hz], responses by reference and position [m], and what they are of.

    Positions are those of the response nodes along the axis in which the nodes spread most, from their middle.

    Raises
    ------
    ValueError
        If the file cannot be read or holds no frequency response; the message begins with the path.
    """
    sets = _read_sets(path)
    functions = [each for each in sets if each["type"] == _FUNCTION and each["func_type"] == _RESPONSE]
    if not functions:
        held = ", ".join(sorted({str(each["type"]) for each in sets})) or "none"
        raise ValueError(f"{path}: no frequency response among the data sets ({held}); export data set 58 of type 4")
    places = _places(sets, functions)
    size = _size(sets)
    kinds = {int(each.get("ordinate_spec_data_type", 0)) for each in functions}
    if len(kinds) > 1:
        raise ValueError(f"{path}: its responses are of several quantities (types {sorted(kinds)}); export one of them")
    frequency = np.asarray(functions[0]["x"], dtype=float)
    found: dict[tuple[str, float | None], NDArray[np.complex128]] = {}
    for each in functions:
        x = np.asarray(each["x"], dtype=float)
        if x.shape != frequency.shape or not np.allclose(x, frequency):
            raise ValueError(f"{path}: its responses have different frequencies; export them on one axis")
        node = int(each["rsp_node"])
        key = (f"reference {int(each['ref_node'])}", places.get(node))
        if key in found:
            key = (f"{key[0]} node {node} direction {int(each['rsp_dir'])}", key[1])
        found[key] = np.asarray(np.asarray(each["data"], dtype=complex) / size, dtype=complex)
    return frequency, found, _QUANTITIES.get(next(iter(kinds)))


def _read_sets(path: Path) -> list[dict[str, Any]]:
    """Return the data sets of a universal file."""
    import pyuff

    if not path.is_file():
        raise ValueError(f"{path}: there is no such file; give the path of a universal file")
    try:
        read = pyuff.UFF(str(path)).read_sets()
    # The library raises bare exceptions, and whatever its parsing meets.
    except Exception as error:
        raise ValueError(f"{path}: cannot be read as a universal file ({error}); export it again") from error
    return [read] if isinstance(read, dict) else list(read)


def _places(sets: list[dict[str, Any]], functions: list[dict[str, Any]]) -> dict[int, float]:
    """Return where the response nodes lie along the beam, from their middle [m]; nothing without coordinates."""
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
    along = int(np.ptp(coordinates, axis=0).argmax())
    middle = (coordinates[:, along].max() + coordinates[:, along].min()) / 2
    return {node: (place[node][along] - middle) / _size(sets) for node in measured}


def _size(sets: list[dict[str, Any]]) -> float:
    """Return the file's unit of length as its number per metre; 1 where it names none."""
    factors = [float(each["length"]) for each in sets if each["type"] == _UNITS]
    return factors[0] if factors and factors[0] > 0 else 1.0
