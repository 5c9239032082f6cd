"""Orders of the cells within a block: shuffled, as listed or by a balanced Latin square.

Shuffled orders are drawn uniformly among all that keep the protocol's limits: exactly, if the only limit is on runs
and orders can be counted or found by rejection; otherwise by a random walk.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from operator import itemgetter

from modaltouch.protocol.conditions import Cell
from modaltouch.protocol.schedule_section import LIMITS, least_limit
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.streams import ALGORITHM, Stream


def order_cells(
    protocol: Protocol,
    finger_condition: str,
    turn: int,
    stream: Stream,
    effort: float = 1.0,
    algorithm: str = ALGORITHM,
) -> list[Cell]:
    """Return the ordered cells of one block, according to the protocol's `order`."""
    cells, order = protocol.cells(finger_condition), protocol.schedule.order
    if order == "as_listed":
        return cells * protocol.scheduled_repetitions
    if order == "shuffled":
        return _shuffled(protocol, cells, stream, effort)
    from modaltouch.protocol.latin_squares import order_by_square

    return order_by_square(protocol, cells, turn, stream, algorithm)


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
        if limit < least_limit(counts) or (limit > 1 and n_states_at_most(counts) > STATE_LIMIT):
            return False
    return True


STATE_LIMIT = 40_000
"""Largest number of states for which the ways to continue are counted, which takes half a second."""


def n_states_at_most(counts: Sequence[int]) -> int:
    """Return an upper bound on the number of states."""
    most, n_kinds = max(counts), len(counts)
    return (most + 1) * math.comb(most + n_kinds - 1, n_kinds - 1)


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
    if n_states_at_most(counts) <= STATE_LIMIT:
        return limited_orders.draw_counted(counts, limit, stream)
    drawn = limited_orders.draw_by_rejection(counts, limit, stream)
    if drawn is None:
        kinds = [kind for kind, count in enumerate(counts) for _ in range(count)]
        drawn = limited_orders.draw_by_walk(kinds, [limited_orders.Limit(key, lambda kind: kind, limit)], stream)
    return drawn
