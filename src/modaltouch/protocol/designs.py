"""Orders of the cells within a block: shuffled, blocked or by a balanced Latin square, with catch trials among them."""

from __future__ import annotations

import math
from collections.abc import Callable

from modaltouch.protocol.orders import draw_order
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.streams import Stream

Cell = tuple[tuple[str, str], float, str]
"""A pair of zones, a peak velocity [mm/s], and the name of a stimulus."""


def order_cells(protocol: Protocol, turn: int, stream: Stream) -> list[Cell]:
    """Return the pairs and velocities of one block in order, as the protocol's `order` says.

    Parameters
    ----------
    protocol : Protocol
        The design.
    turn : int
        Which of several balanced orders is this participant's.
    stream : Stream
        Where chance comes from.

    Raises
    ------
    ValueError
        If no order keeps the protocol's limit on runs.
    """
    return _ORDERS[protocol.schedule.order](protocol, turn, stream)


def insert_catches(protocol: Protocol, cells: list[Cell], stream: Stream) -> list[Cell]:
    """Return the cells of a block with the protocol's catch trials among them, whose velocity is 0.

    Raises
    ------
    ValueError
        If the catch trials cannot keep the protocol's limit on runs.
    """
    from modaltouch.protocol.catches import place_catches

    schedule = protocol.schedule
    placed = dict(
        place_catches(
            [pair for pair, _, _ in cells],
            schedule.catch_trials,
            schedule.max_same_pair_running,
            stream,
            own_pair=schedule.order == "by_pair",
        )
    )
    merged: list[Cell] = []
    for place, cell in enumerate(cells):
        merged.append(cell)
        if place in placed:
            merged.append((placed[place], 0.0, ""))
    return merged


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
    n_pairs, n_levels = len(protocol.conditions.zone_pairs), len(protocol.scheduled_levels)
    n_cells = n_pairs * n_levels * len(protocol.stimulus_names)
    n_kinds = {"by_pair": n_pairs, "by_velocity": n_levels, "latin_square": n_cells}
    n_items = n_kinds.get(protocol.schedule.order)
    if n_items is None:
        return 1
    n_rows = len(latin_square(n_items))
    # Each round of the rows begins one later than the last, so it takes as many rounds as rows.
    period = n_rows * n_rows
    taken = protocol.schedule.repetitions if protocol.schedule.order == "latin_square" else 1
    return period // math.gcd(period, taken)


def _levels_and_stimuli(protocol: Protocol) -> list[tuple[float, str]]:
    return [(level, stimulus) for level in protocol.scheduled_levels for stimulus in protocol.stimulus_names]


def _row_of_turn(turn: int, n_rows: int) -> int:
    """Return the row of a square for a turn.

    Each dozen of participants (for a dozen rows) begins a row later than the last, so that rows and orders of
    finger conditions, which take turns too, meet in every combination.
    """
    return (turn + turn // n_rows) % n_rows


def _shuffled(protocol: Protocol, turn: int, stream: Stream) -> list[Cell]:
    """Draw the order of pairs first, then spread each pair's velocities over its places."""
    pairs, levels = protocol.conditions.zone_pairs, _levels_and_stimuli(protocol)
    repetitions = protocol.scheduled_repetitions
    counts = [len(levels) * repetitions] * len(pairs)
    order = draw_order(counts, protocol.schedule.max_same_pair_running, stream)
    waiting = [stream.shuffled(levels * repetitions) for _ in pairs]
    return [(pairs[pair], *waiting[pair].pop()) for pair in order]


def _by_pair(protocol: Protocol, turn: int, stream: Stream) -> list[Cell]:
    """Take the pairs one after the other, in this participant's row of a Latin square."""
    pairs, levels = protocol.conditions.zone_pairs, _levels_and_stimuli(protocol)
    rows = latin_square(len(pairs))
    row = rows[_row_of_turn(turn, len(rows))]
    return [(pairs[pair], *level) for pair in row for level in stream.shuffled(levels * protocol.scheduled_repetitions)]


def _by_velocity(protocol: Protocol, turn: int, stream: Stream) -> list[Cell]:
    """Take the velocities one after the other, in this participant's row of a Latin square."""
    pairs, levels = protocol.conditions.zone_pairs, protocol.scheduled_levels
    rows = latin_square(len(levels))
    row = rows[_row_of_turn(turn, len(rows))]
    kinds = [
        (pair, stimulus) for pair in pairs for stimulus in protocol.stimulus_names
    ] * protocol.scheduled_repetitions
    return [(pair, levels[level], stimulus) for level in row for pair, stimulus in stream.shuffled(kinds)]


def _latin_square(protocol: Protocol, turn: int, stream: Stream) -> list[Cell]:
    """Take all cells in this participant's row of a Latin square, the next row for each repetition."""
    conditions = protocol.conditions
    cells = [(pair, *level) for pair in conditions.zone_pairs for level in _levels_and_stimuli(protocol)]
    rows = latin_square(len(cells))
    repetitions = protocol.scheduled_repetitions
    turns = range(turn * repetitions, (turn + 1) * repetitions)
    return [cells[cell] for each in turns for cell in rows[_row_of_turn(each, len(rows))]]


_ORDERS: dict[str, Callable[[Protocol, int, Stream], list[Cell]]] = {
    "shuffled": _shuffled,
    "by_pair": _by_pair,
    "by_velocity": _by_velocity,
    "latin_square": _latin_square,
}
