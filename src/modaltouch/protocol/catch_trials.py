"""Catch trials, at which nothing is played: where they stand in a block, and on which pair of zones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

from modaltouch.protocol.conditions import Cell
from modaltouch.protocol.schedule_section import LIMITS, NoOrderError
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.streams import Stream

Pair = tuple[str, ...]


def insert_catches(protocol: Protocol, cells: list[Cell], stream: Stream) -> list[Cell]:
    """Insert the protocol's catch trials, which have velocity 0, into the cells of a block."""
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


def place_catches(
    order: Sequence[Pair], n_catches: int, limit: int | None, stream: Stream, *, own_pair: bool = False
) -> list[tuple[int, Pair]]:
    """Return, for each catch trial, the index of the trial that it follows and its pair of zones."""
    pairs = list(dict.fromkeys(order))
    if limit is None:
        places = sorted(stream.chosen(range(len(order)), n_catches))
        return [(place, order[place] if own_pair else pairs[stream.below(len(pairs))]) for place in places]
    # Catch trials are never adjacent, so a run of k becomes at most 2 k + 1; a higher limit has no effect.
    limit = min(limit, 2 * max((len(list(run)) for _, run in groupby(order)), default=0) + 1)
    ways = _count_ways(order, pairs, n_catches, limit, own_pair=own_pair)
    if not ways[0][n_catches][1]:
        raise NoOrderError(
            LIMITS[0],
            f"{limit}, but {n_catches} catch trials cannot be spread over {len(order)} trials without longer runs",
            "",
            "use fewer catch trials or allow longer runs",
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
    """Yield the choices after the trial at a place, where a run has the length `run`: no catch trial, or one.

    Each choice consists of the pair of the catch trial (None for none), the number of catch trials left, the length of
    the run so far, and the length at the next trial (1 after the last trial).
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
    """Count the ways to continue, by place of a trial, catch trials left and length of the run ending at the trial."""
    # After the last trial there is one way if no catch trial is left; run lengths start at 1.
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
