"""Orders of the cells within a block: shuffled, blocked or by a balanced Latin square.

Shuffled orders are drawn uniformly among all that keep the protocol's limits: exactly, if the only limit is on runs
and orders can be counted or found by rejection; otherwise by a random walk.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from operator import itemgetter

from modaltouch.protocol.conditions import Cell
from modaltouch.protocol.schedule_section import LIMITS
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.streams import Stream


def order_cells(
    protocol: Protocol, finger_condition: str, turn: int, stream: Stream, effort: float = 1.0
) -> list[Cell]:
    """Return the ordered cells of one block, according to the protocol's `order`."""
    cells, order = protocol.cells(finger_condition), protocol.schedule.order
    if order == "as_listed":
        return cells * protocol.scheduled_repetitions
    if order == "shuffled":
        return _shuffled(protocol, cells, stream, effort)
    return order_by_square(protocol, cells, turn, stream)


def are_certain(protocol: Protocol) -> bool:
    """Test whether every draw is certain to find an order, known without a search only for a limit on pairs alone."""
    schedule, limit = protocol.schedule, protocol.schedule.max_same_pair_running
    others = schedule.catch_trials or protocol.intervals or any(getattr(schedule, key) for key in LIMITS[1:])
    if schedule.order != "shuffled" or others:
        return False
    for name in protocol.conditions.finger_conditions:
        counts = [*Counter(cell[0] for cell in protocol.cells(name) * protocol.scheduled_repetitions).values()]
        if limit is None or limit >= max(counts):
            continue
        from modaltouch.protocol.limited_orders import STATE_LIMIT, least_limit, n_states_at_most

        if limit < least_limit(counts) or (limit > 1 and n_states_at_most(counts) > STATE_LIMIT):
            return False
    return True


def _shuffled(protocol: Protocol, cells: list[Cell], stream: Stream, effort: float) -> list[Cell]:
    """Draw the order of the kinds under limits, then shuffle the cells of each kind over its places."""
    schedule, every = protocol.schedule, cells * protocol.scheduled_repetitions
    kind_of: Callable[[Cell], object] = itemgetter(0)
    running, key = schedule.max_same_pair_running, LIMITS[0]
    if any(getattr(schedule, key) for key in LIMITS[1:]):
        from modaltouch.protocol.limited_orders import draw_by_walk, limits_of

        first, *others = limits = limits_of(protocol)
        kind_of, running, key = first.kind_of, first.running, first.key
        if others or first.distance > 1 or None in map(kind_of, every):
            return draw_by_walk(every, limits, stream, effort)
    kinds: dict[object, list[Cell]] = {}
    for cell in every:
        kinds.setdefault(kind_of(cell), []).append(cell)
    order = draw_order(list(map(len, kinds.values())), running, stream, key)
    waiting = [stream.shuffled(own) for own in kinds.values()]
    return [waiting[kind].pop() for kind in order]


def draw_order(counts: Sequence[int], limit: int | None, stream: Stream, key: str = LIMITS[0]) -> list[int]:
    """Draw an order of kinds uniformly among those that keep the limit."""
    if limit is None or limit >= max(counts):
        return stream.shuffled(kind for kind, count in enumerate(counts) for _ in range(count))
    from modaltouch.protocol import limited_orders

    limited_orders.refuse_runs(counts, limit, key)
    if limit == 1:
        return limited_orders.draw_unlike_neighbours(tuple(counts), stream)
    if limited_orders.n_states_at_most(counts) <= limited_orders.STATE_LIMIT:
        return limited_orders.draw_counted(counts, limit, stream)
    drawn = limited_orders.draw_by_rejection(counts, limit, stream)
    if drawn is None:
        kinds = [kind for kind, count in enumerate(counts) for _ in range(count)]
        drawn = limited_orders.draw_by_walk(kinds, [limited_orders.Limit(key, lambda kind: kind, limit)], stream)
    return drawn


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
    square = latin_square(len(kinds))
    rows = [square[row] for row in _rows_of_turn(protocol, cells, turn)]
    if order == "latin_square":
        return [cells[cell] for row in rows for cell in row]
    each_kind = [[cell for cell in cells if cell[_PLACES[order]] == kind] * repetitions for kind in kinds]
    return [cell for row in rows for kind in row for cell in stream.shuffled(each_kind[kind])]


def rows_of_turn(protocol: Protocol, turn: int) -> tuple[tuple[int, ...], ...]:
    """Return the rows of a Latin square in a turn, for each finger condition; empty if there is no square."""
    if protocol.schedule.order not in ("latin_square", *_PLACES):
        return ()
    return tuple(_rows_of_turn(protocol, protocol.cells(name), turn) for name in protocol.conditions.finger_conditions)


def _rows_of_turn(protocol: Protocol, cells: list[Cell], turn: int) -> tuple[int, ...]:
    n_rows, taken = _n_rows(protocol, cells), _rows_per_turn(protocol)
    return tuple(_row_of_turn(each, n_rows) for each in range(turn * taken, (turn + 1) * taken))


def _n_rows(protocol: Protocol, cells: list[Cell]) -> int:
    return len(latin_square(len(_kinds(protocol.schedule.order, cells))))


def _rows_per_turn(protocol: Protocol) -> int:
    return protocol.scheduled_repetitions if protocol.schedule.order == "latin_square" else 1


def _period(protocol: Protocol, cells: list[Cell]) -> int:
    # Each round begins one row later than the last, so the period is as many rounds as rows.
    period = _n_rows(protocol, cells) ** 2
    return period // math.gcd(period, _rows_per_turn(protocol))


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
