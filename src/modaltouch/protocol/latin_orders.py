"""Orders by the rows of a balanced Latin square: of pairs, of velocities, or of all cells."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from modaltouch.protocol.cells import Cell
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.streams import Stream


def latin_square(n_cells: int) -> list[list[int]]:
    """Return the rows of a balanced Latin square: Williams' design.

    Every cell comes at every place equally often, and follows every other equally often; that takes `n_cells`
    rows for an even number of cells and twice as many for an odd one.

    Parameters
    ----------
    n_cells : int
        Number of cells.

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
    """Return after how many turns the rows of a Latin square repeat; 1 where the protocol uses none."""
    if protocol.schedule.order not in _KINDS:
        return 1
    return math.lcm(*(_period(protocol, protocol.cells(name)) for name in protocol.conditions.finger_conditions))


def _period(protocol: Protocol, cells: list[Cell]) -> int:
    n_rows = len(latin_square(len(_KINDS[protocol.schedule.order](cells))))
    # Each round of the rows begins one later than the last, so it takes as many rounds as rows.
    period = n_rows * n_rows
    taken = protocol.scheduled_repetitions if protocol.schedule.order == "latin_square" else 1
    return period // math.gcd(period, taken)


def _pairs(cells: list[Cell]) -> list[tuple[str, ...]]:
    return list(dict.fromkeys(pair for pair, *_ in cells))


def _levels(cells: list[Cell]) -> list[float]:
    return list(dict.fromkeys(level for _, level, _ in cells))


def _row_of_turn(turn: int, n_rows: int) -> int:
    """Return the row of a square for a turn.

    Each dozen of participants (for a dozen rows) begins a row later than the last, so that rows and orders of
    finger conditions, which take turns too, meet in every combination.
    """
    return (turn + turn // n_rows) % n_rows


def _by_pair(protocol: Protocol, cells: list[Cell], turn: int, stream: Stream) -> list[Cell]:
    """Take the pairs one after the other, in this participant's row of a Latin square."""
    pairs = _pairs(cells)
    kinds = [[cell for cell in cells if cell[0] == pair] * protocol.scheduled_repetitions for pair in pairs]
    rows = latin_square(len(pairs))
    return [cell for kind in rows[_row_of_turn(turn, len(rows))] for cell in stream.shuffled(kinds[kind])]


def _by_velocity(protocol: Protocol, cells: list[Cell], turn: int, stream: Stream) -> list[Cell]:
    """Take the velocities one after the other, in this participant's row of a Latin square."""
    levels = _levels(cells)
    kinds = [[cell for cell in cells if cell[1] == level] * protocol.scheduled_repetitions for level in levels]
    rows = latin_square(len(levels))
    return [cell for kind in rows[_row_of_turn(turn, len(rows))] for cell in stream.shuffled(kinds[kind])]


def _latin_square(protocol: Protocol, cells: list[Cell], turn: int, stream: Stream) -> list[Cell]:
    """Take all cells in this participant's row of a Latin square, the next row for each repetition."""
    rows = latin_square(len(cells))
    repetitions = protocol.scheduled_repetitions
    turns = range(turn * repetitions, (turn + 1) * repetitions)
    return [cells[cell] for each in turns for cell in rows[_row_of_turn(each, len(rows))]]


_KINDS: dict[str, Callable[[list[Cell]], Sequence[Any]]] = {
    "by_pair": _pairs,
    "by_velocity": _levels,
    "latin_square": list,
}
"""What the rows of a Latin square order, by the protocol's `order`."""

ORDERS: dict[str, Callable[[Protocol, list[Cell], int, Stream], list[Cell]]] = {
    "by_pair": _by_pair,
    "by_velocity": _by_velocity,
    "latin_square": _latin_square,
}
"""What takes the cells of a block in the rows of a Latin square, by the protocol's `order`."""
