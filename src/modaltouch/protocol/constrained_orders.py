"""Orders under any limits that a protocol sets, each order that keeps them all being as likely as any other."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from modaltouch.protocol.cells import Cell
from modaltouch.protocol.order_limits import LIMITS
from modaltouch.protocol.order_walk import Limit, draw_by_walk
from modaltouch.protocol.orders import draw_order
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.streams import Stream


def limits_of(protocol: Protocol) -> list[Limit[Cell]]:
    """Return the limits of a protocol on its shuffled orders."""

    def side(cell: Cell) -> int | None:
        focus = protocol.stimulus_of(cell[2]).focus
        return cell[0].index(focus) if focus in cell[0] else None

    kinds: dict[str, Callable[[Cell], object]] = {
        "max_same_pair_running": lambda cell: cell[0],
        "max_same_level_running": lambda cell: cell[1],
        "max_same_stimulus_running": lambda cell: cell[2],
        "max_same_side_running": side,
    }
    given = {key: getattr(protocol.schedule, key) for key in LIMITS}
    limits = [Limit(key, kind_of, given[key]) for key, kind_of in kinds.items() if given[key] is not None]
    distance = given["min_same_cell_distance"]
    if distance:
        limits.append(Limit("min_same_cell_distance", lambda cell: cell, 1, distance))
    return limits


def draw_constrained(
    cells: Sequence[Cell], limits: Sequence[Limit[Cell]], stream: Stream, effort: float = 1.0
) -> list[Cell]:
    """Return an order that keeps all limits: one limit on runs exactly uniformly, others by a random walk.

    Parameters
    ----------
    cells, limits, stream, effort
        As `draw_by_walk` takes them.

    Raises
    ------
    NoOrderError
        If no order keeps one of them, or those that keep all are too rare to be found.
    """
    kinds: dict[object, list[Cell]] = {}
    for cell in cells:
        kinds.setdefault(limits[0].kind_of(cell), []).append(cell)
    if len(limits) > 1 or limits[0].distance > 1 or None in kinds:
        return draw_by_walk(cells, limits, stream, effort)
    order = draw_order(list(map(len, kinds.values())), limits[0].running, stream, limits[0].key)
    waiting = [stream.shuffled(own) for own in kinds.values()]
    return [waiting[kind].pop() for kind in order]
