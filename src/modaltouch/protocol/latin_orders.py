"""Orders by the rows of a balanced Latin square: of pairs, of velocities, or of all cells."""

from __future__ import annotations

import math

from modaltouch.protocol.conditions import Cell
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.streams import Stream


def latin_square(n_cells: int) -> list[list[int]]:
    """Return the rows of a balanced Latin square: Williams' design.

    Each cell occurs equally often at each position and follows each other cell equally often. This takes `n_cells` rows
    for an even number of cells and twice as many for an odd number.

    References
    ----------
    E. J. Williams, Australian Journal of Scientific Research A 2, 149 (1949).

    Examples
    --------
    >>> latin_square(4)
    [[0, 1, 3, 2], [1, 2, 0, 3], [2, 3, 1, 0], [3, 0, 2, 1]]
    """
    zigzag = [(place + 1) // 2 if place % 2 else -place // 2 for place in range(n_cells)]
    rows = [[(cell + shift) % n_cells for cell in zigzag] for shift in range(n_cells)]
    return rows if n_cells % 2 == 0 else [*rows, *(row[::-1] for row in rows)]


def period_of_rows(protocol: Protocol) -> int:
    """Return the number of turns after which the rows of a Latin square repeat; 1 if there is no square."""
    if protocol.schedule.order not in ("latin_square", *_PLACES):
        return 1
    return math.lcm(*(_period(protocol, protocol.cells(name)) for name in protocol.conditions.finger_conditions))


def order_by_square(protocol: Protocol, cells: list[Cell], turn: int, stream: Stream) -> list[Cell]:
    """Return the cells of a block in a participant's row of a Latin square.

    With a square of pairs or velocities, these are presented one after the other, the cells of each shuffled. With a
    square of all cells, each repetition takes the next row.
    """
    order, repetitions = protocol.schedule.order, protocol.scheduled_repetitions
    kinds = _kinds(order, cells)
    rows = latin_square(len(kinds))
    if order == "latin_square":
        turns = range(turn * repetitions, (turn + 1) * repetitions)
        return [cells[cell] for each in turns for cell in rows[_row_of_turn(each, len(rows))]]
    each_kind = [[cell for cell in cells if cell[_PLACES[order]] == kind] * repetitions for kind in kinds]
    return [cell for kind in rows[_row_of_turn(turn, len(rows))] for cell in stream.shuffled(each_kind[kind])]


def _period(protocol: Protocol, cells: list[Cell]) -> int:
    n_rows = len(latin_square(len(_kinds(protocol.schedule.order, cells))))
    # Each round begins one row later than the last, so the period is as many rounds as rows.
    period = n_rows * n_rows
    taken = protocol.scheduled_repetitions if protocol.schedule.order == "latin_square" else 1
    return period // math.gcd(period, taken)


def _row_of_turn(turn: int, n_rows: int) -> int:
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
