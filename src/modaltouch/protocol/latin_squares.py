"""Orders of the cells within a block by a balanced Latin square."""

from __future__ import annotations

from modaltouch.protocol.conditions import Cell
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.streams import FORMER_ALGORITHM, Stream


def latin_square(n_cells: int) -> list[list[int]]:
    """Return the rows of a balanced Latin square: Williams' design (Aust. J. Sci. Res. A 2, 149 (1949)).

    Each cell occurs equally often at each position and follows each other cell equally often. This takes `n_cells` rows
    for an even number of cells and twice as many for an odd number.

    >>> latin_square(4)
    [[0, 1, 3, 2], [1, 2, 0, 3], [2, 3, 1, 0], [3, 0, 2, 1]]
    """
    zigzag = [(place + 1) // 2 if place % 2 else -place // 2 for place in range(n_cells)]
    rows = [[(cell + shift) % n_cells for cell in zigzag] for shift in range(n_cells)]
    return rows if n_cells % 2 == 0 else [*rows, *(row[::-1] for row in rows)]


def order_by_square(protocol: Protocol, cells: list[Cell], turn: int, stream: Stream, algorithm: str) -> list[Cell]:
    """Return the cells of a block in a participant's row of a Latin square.

    With a square of pairs or velocities, these are presented one after the other, the cells of each shuffled. With a
    square of all cells, each repetition takes the next row, so that each is balanced over as many turns as rows.
    """
    order, repetitions = protocol.schedule.order, protocol.scheduled_repetitions
    kinds = _kinds(order, cells)
    square = latin_square(len(kinds))
    n_rows = len(square)
    if order == "latin_square":
        rows = [(row_of_turn(turn, n_rows) + each) % n_rows for each in range(repetitions)]
        if algorithm == FORMER_ALGORITHM:
            rows = [row_of_turn(turn * repetitions + each, n_rows) for each in range(repetitions)]
        return [cells[cell] for row in rows for cell in square[row]]
    each_kind = [[cell for cell in cells if cell[_PLACES[order]] == kind] * repetitions for kind in kinds]
    return [cell for kind in square[row_of_turn(turn, n_rows)] for cell in stream.shuffled(each_kind[kind])]


def numbers_of_rows(protocol: Protocol) -> list[int]:
    """Return the number of rows of the Latin square of each finger condition; empty if there is no square."""
    order = protocol.schedule.order
    if order not in ("latin_square", *_PLACES):
        return []
    numbers = [len(_kinds(order, protocol.cells(name))) for name in protocol.conditions.finger_conditions]
    return [number if number % 2 == 0 else 2 * number for number in numbers]


def row_of_turn(turn: int, n_rows: int) -> int:
    """Return the row of a square for a turn.

    Each round of `n_rows` participants begins one row later than the last, so that every row is combined with every
    order of finger conditions, which also alternates between participants.
    """
    return (turn + turn // n_rows) % n_rows


_PLACES = {"by_pair": 0, "by_velocity": 1}
"""Index, within a cell, of the factor ordered by the square, by the protocol's `order`."""


def _kinds(order: str, cells: list[Cell]) -> list[object]:
    """Return the items ordered by a Latin square: pairs, velocities, or cells (each as often as its weight)."""
    return list(cells if order == "latin_square" else dict.fromkeys(cell[_PLACES[order]] for cell in cells))
