"""Orders of the cells within a block: shuffled, blocked or by a balanced Latin square, with catch trials among them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby

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


Pair = tuple[str, str]


def place_catches(
    order: Sequence[Pair], n_catches: int, limit: int | None, stream: Stream, *, own_pair: bool = False
) -> list[tuple[int, Pair]]:
    """Return after which trial each catch trial comes, counted from 0, and its pair of zones."""
    pairs = list(dict.fromkeys(order))
    if limit is None:
        places = sorted(stream.chosen(range(len(order)), n_catches))
        return [(place, order[place] if own_pair else pairs[stream.below(len(pairs))]) for place in places]
    # Catch trials are no neighbours, so k like trials running become at most 2 k + 1; a limit beyond is none.
    limit = min(limit, 2 * max((len(list(run)) for _, run in groupby(order)), default=0) + 1)
    ways = _count_ways(order, pairs, n_catches, limit, own_pair=own_pair)
    if not ways[0][n_catches][1]:
        raise ValueError(
            f"no way to spread {n_catches} catch trials over {len(order)} trials keeps the same pair to {limit} "
            "times running; take fewer catch trials or allow a pair more often running"
        )
    placed = []
    left, run = n_catches, 1
    for place in range(len(order)):
        moves = list(_moves(order, pairs, place, left, run, own_pair=own_pair))
        weights = [ways[place + 1][rest][after] if after <= limit and most <= limit else 0
                   for _, rest, most, after in moves]  # fmt: skip
        pair, left, _, run = moves[stream.weighted(weights)]
        if pair is not None:
            placed.append((place, pair))
    return placed


def _moves(
    order: Sequence[Pair], pairs: Sequence[Pair], place: int, left: int, run: int, *, own_pair: bool
) -> Iterator[tuple[Pair | None, int, int, int]]:
    """Yield what may come after the trial at a place, which ends a run: nothing, or a catch trial on a pair.

    With it the catch trials then left, the longest run on the way, and the run that the next trial ends; after the
    last trial that is 1.
    """
    own = order[place]
    following = order[place + 1] if place + 1 < len(order) else None
    yield None, left, run, run + 1 if following == own else 1
    if not left:
        return
    for pair in (own,) if own_pair else pairs:
        caught = run + 1 if pair == own else 1
        yield pair, left - 1, caught, caught + 1 if following == pair else 1


def _count_ways(
    order: Sequence[Pair], pairs: Sequence[Pair], n_catches: int, limit: int, *, own_pair: bool
) -> list[list[list[int]]]:
    """Return the number of ways to go on from the trial at a place, by catch trials left and the run it ends."""
    # Beyond the last trial, one way if no catch trial is left; runs count from 1.
    table = [[[int(left == 0)] * (limit + 1) for left in range(n_catches + 1)]]
    for place in reversed(range(len(order))):
        after = table[-1]
        table.append(
            [
                [
                    sum(
                        after[rest][ending]
                        for _, rest, most, ending in _moves(order, pairs, place, left, run, own_pair=own_pair)
                        if most <= limit and ending <= limit
                    )
                    for run in range(limit + 1)
                ]
                for left in range(n_catches + 1)
            ]
        )
    return table[::-1]
