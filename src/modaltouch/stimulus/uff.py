"""Measured mode shapes from a universal file (UFF), the exchange format of modal analysis programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.stimulus.measured import MeasuredShapes

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_NODES = (15, 2411)
_MODES = 55
_UNITS = 164
_MODAL = (2, 3, 7)
"""Analysis types of data set 55 that hold mode shapes: real, complex of the first and of the second order."""

_AXES = ("x", "y", "z")
_MOTIONS = ("r1", "r2", "r3")

_QUADRATURE = 0.3
"""Share of a shape that may be out of phase with the rest; beyond it no real mode describes the motion [1]."""


def read_uff(path: Path, length: float, *, label: tuple[int, ...] | None = None, origin: float = 0.0) -> MeasuredShapes:
    """Return the mode shapes of a universal file: data sets 55 (shapes) on 15 or 2411 (nodes), in units by 164.

    The beam lies along the axis in which the nodes spread most and moves in the direction in which the shapes are
    largest. Complex shapes are turned to the phase in which they are most nearly real.

    Parameters
    ----------
    path : Path
        The file, ASCII or binary.
    length : float
        Length of the beam [m].
    label : tuple of int, optional
        Label of each shape in the order of the file; the file's own mode numbers if not given.
    origin : float
        Where the file's origin lies on the beam, from mid-beam: minus half the length if it counts from the left
        end [m].

    Raises
    ------
    ValueError
        If the file cannot be read, holds no shapes or no nodes, or its shapes span no basis; the message begins
        with the path.
    """
    sets = read_sets(path)
    shapes = [each for each in sets if each["type"] == _MODES and each["analysis_type"] in _MODAL]
    if not shapes:
        held = ", ".join(sorted({str(each["type"]) for each in sets})) or "none"
        raise ValueError(f"{path}: no mode shape among the data sets ({held}); export data set 55 of normal modes")
    labels = tuple(int(each["mode_n"]) for each in shapes) if label is None else label
    if len(labels) != len(shapes):
        raise ValueError(f"{path}: {len(shapes)} mode shapes, but {len(labels)} labels; give one to each")
    node, coordinate = _nodes(sets, shapes, path)
    along = int(np.ptp(coordinate, axis=1).argmax())
    moving = [number for number in range(3) if number != along]
    motion = np.array([_on_nodes(each, node, path) for each in shapes]).transpose(1, 0, 2)
    across = max(moving, key=lambda number: float(np.abs(motion[number]).sum()))
    real = np.array([_in_phase(row, k, path) for row, k in zip(motion[across], labels, strict=True)])
    position = coordinate[along] / _length_factor(sets) + origin
    order = np.argsort(position)
    try:
        return MeasuredShapes(labels, position[order], real[:, order], length)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_sets(path: Path) -> list[dict[str, Any]]:
    """Return the data sets of a universal file.

    Raises
    ------
    ValueError
        If there is no such file, or it cannot be read; the message begins with the path.
    """
    import pyuff

    if not path.is_file():
        raise ValueError(f"{path}: there is no such file; give the path of a universal file")
    try:
        read = pyuff.UFF(str(path)).read_sets()
    # The library raises bare exceptions, and whatever its parsing meets.
    except Exception as error:
        raise ValueError(f"{path}: cannot be read as a universal file ({error}); export it again") from error
    return [read] if isinstance(read, dict) else list(read)


def _nodes(sets: list[dict[str, Any]], shapes: list[dict[str, Any]], path: Path) -> tuple[list[int], FloatArray]:
    """Return the nodes of the first shape, and their coordinates, (3, n_nodes) array."""
    place = {
        int(number): [each[axis][i] for axis in _AXES]
        for each in sets
        if each["type"] in _NODES
        for i, number in enumerate(each["node_nums"])
    }
    node = [int(number) for number in shapes[0]["node_nums"]]
    homeless = [number for number in node if number not in place]
    if homeless:
        raise ValueError(
            f"{path}: node {homeless[0]} has a shape but no coordinates ({len(place)} nodes have); export data set "
            f"15 or 2411 too"
        )
    return node, np.array([place[number] for number in node], dtype=float).T


def _on_nodes(each: dict[str, Any], node: list[int], path: Path) -> list[ComplexArray]:
    """Return a shape's three motions in the order of the nodes."""
    index = {int(number): i for i, number in enumerate(each["node_nums"])}
    if set(index) != set(node):
        missing = sorted(set(index) ^ set(node))
        raise ValueError(
            f"{path}: mode {each['mode_n']} is given on other nodes than the first shape (node {missing[0]} has only "
            f"one of them): give every shape on the same nodes"
        )
    rows = [index[number] for number in node]
    return [np.asarray(each[name], dtype=complex)[rows] for name in _MOTIONS]


def _in_phase(shape: ComplexArray, label: int, path: Path) -> FloatArray:
    """Return a complex shape in the phase in which it is most nearly real."""
    turned = shape * np.exp(-0.5j * np.angle((shape**2).sum()))
    size, aside = np.linalg.norm(shape), np.linalg.norm(turned.imag)
    if aside > _QUADRATURE * size:
        raise ValueError(
            f"{path}: {aside / size:.0%} of mode {label} moves out of phase with the rest, allowed are "
            f"{_QUADRATURE:.0%}: identify it again as a real mode"
        )
    return np.asarray(turned.real)


def _length_factor(sets: list[dict[str, Any]]) -> float:
    """Return the file's unit of length as its number per metre; 1 where it names none."""
    factors = [float(each["length"]) for each in sets if each["type"] == _UNITS]
    return factors[0] if factors and factors[0] > 0 else 1.0
