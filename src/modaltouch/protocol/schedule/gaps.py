"""Orders without like neighbours, by inserting one kind after the other into gaps.

What is already there holds gaps between like neighbours, which later kinds must fill, and other gaps, which
they may. How the inserted items spread over both is drawn with the exact count of the ways to finish.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from math import comb

from modaltouch.protocol.schedule.streams import Stream


def draw_unlike_neighbours(counts: tuple[int, ...], stream: Stream) -> list[int]:
    """Return an order drawn uniformly among those in which no kind follows itself.

    Parameters
    ----------
    counts : tuple of int
        How often each kind comes; at least one such order must exist.
    stream : Stream
        Where chance comes from.
    """
    order: list[int] = []
    for kind, count in enumerate(counts):
        like = [place for place, (one, other) in enumerate(pairwise(order), start=1) if one == other]
        unlike = sorted(set(range(len(order) + 1)) - set(like))
        spreads = _spreads(counts, kind, len(like))
        n_groups, n_like = spreads[stream.weighted([weight for *_, weight in spreads])][:2]
        gaps = stream.chosen(like, n_like) + stream.chosen(unlike, n_groups - n_like)
        # Group sizes: cut the row of items at places drawn without replacement.
        cuts = [0, *sorted(stream.chosen(range(1, count), n_groups - 1)), count]
        sizes = dict(zip(sorted(gaps), (b - a for a, b in pairwise(cuts)), strict=True))
        grown: list[int] = []
        for place in range(len(order) + 1):
            grown += [kind] * sizes.get(place, 0) + order[place : place + 1]
        order = grown
    return order


def _spreads(counts: tuple[int, ...], kind: int, n_like: int) -> list[tuple[int, int, int]]:
    """Return number of groups, number of them between like neighbours, and number of ways, for each spread."""
    count, after = counts[kind], _ways_to_finish(counts)[kind + 1]
    n_unlike = sum(counts[:kind]) + 1 - n_like
    spreads = []
    for n_groups in range(1, count + 1):
        for filled in range(min(n_groups, n_like) + 1):
            left = n_like - filled + count - n_groups
            ways = after[left] if left < len(after) and n_groups - filled <= n_unlike else 0
            if ways:
                ways *= comb(count - 1, n_groups - 1) * comb(n_like, filled) * comb(n_unlike, n_groups - filled)
                spreads.append((n_groups, filled, ways))
    return spreads


@lru_cache(maxsize=8)
def _ways_to_finish(counts: tuple[int, ...]) -> list[list[int]]:
    """Return the ways to finish before each kind but the first is inserted, by the number of like neighbours."""
    table: list[list[int]] = [[] for _ in counts] + [[1]]
    for kind in reversed(range(1, len(counts))):
        count, after, placed = counts[kind], table[kind + 1], sum(counts[:kind])
        row = []
        for n_like in range(placed):
            n_unlike = placed + 1 - n_like
            total = 0
            for n_groups in range(1, count + 1):
                lowest = max(0, n_groups - n_unlike, n_like + count - n_groups - len(after) + 1)
                total += comb(count - 1, n_groups - 1) * sum(
                    comb(n_like, filled) * comb(n_unlike, n_groups - filled) * after[n_like - filled + count - n_groups]
                    for filled in range(lowest, min(n_groups, n_like) + 1)
                )
            row.append(total)
        table[kind] = row
    return table
