"""Orders of the cells within a block: shuffled, blocked or by a balanced Latin square, with catch trials among them."""

from __future__ import annotations

from modaltouch.protocol.cells import Cell
from modaltouch.protocol.order_limits import LIMITS
from modaltouch.protocol.orders import draw_order
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.streams import Stream


def order_cells(
    protocol: Protocol, finger_condition: str, turn: int, stream: Stream, effort: float = 1.0
) -> list[Cell]:
    """Return the pairs and velocities of one block in order, as the protocol's `order` says.

    Parameters
    ----------
    protocol : Protocol
        The design.
    finger_condition : str
        That of the block.
    turn : int
        Which of several balanced orders is this participant's.
    stream : Stream
        Where chance comes from.
    effort : float
        Share of the usual work after which limits are given up [1].

    Raises
    ------
    ValueError
        If no order keeps the protocol's limit on runs.
    """
    cells, order = protocol.cells(finger_condition), protocol.schedule.order
    if order == "as_listed":
        return cells * protocol.scheduled_repetitions
    if order == "shuffled":
        return _shuffled(protocol, cells, stream, effort)
    from modaltouch.protocol.latin_orders import order_by_square

    return order_by_square(protocol, cells, turn, stream)


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


def _shuffled(protocol: Protocol, cells: list[Cell], stream: Stream, effort: float) -> list[Cell]:
    """Draw the order of pairs first, then spread each pair's velocities over its places."""
    if any(getattr(protocol.schedule, key) for key in LIMITS[1:]):
        from modaltouch.protocol.constrained_orders import draw_constrained, limits_of

        return draw_constrained(cells * protocol.scheduled_repetitions, limits_of(protocol), stream, effort)
    pairs = dict.fromkeys(pair for pair, *_ in cells)
    kinds = [[cell for cell in cells if cell[0] == pair] * protocol.scheduled_repetitions for pair in pairs]
    order = draw_order(list(map(len, kinds)), protocol.schedule.max_same_pair_running, stream)
    waiting = [stream.shuffled(own) for own in kinds]
    return [waiting[kind].pop() for kind in order]
