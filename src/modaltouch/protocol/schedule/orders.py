"""Uniform draws among the orders in which no kind comes more than n times running.

Three ways, each uniform over all valid orders: by the gaps between unlike neighbours where nothing may come
twice running, by counting the ways to go on where these can be counted, by rejection where they cannot.
"""

from __future__ import annotations

from collections.abc import Sequence

from modaltouch.protocol.schedule.counting import STATE_LIMIT, count_states, draw_counted, moves, n_states_at_most
from modaltouch.protocol.schedule.gaps import draw_unlike_neighbours
from modaltouch.protocol.schedule.rejection import draw_by_rejection
from modaltouch.protocol.schedule.streams import Stream


def least_limit(counts: Sequence[int]) -> int:
    """Return the smallest limit on runs that the counts allow.

    The most frequent kind must fit into the gaps before, between and after the others.

    >>> least_limit([4, 4, 4]), least_limit([12]), least_limit([9, 2])
    (1, 12, 3)
    """
    most = max(counts)
    return -(-most // (sum(counts) - most + 1))


def draw_order(counts: Sequence[int], limit: int | None, stream: Stream) -> list[int]:
    """Return an order of kinds, drawn uniformly among those that keep the limit.

    Parameters
    ----------
    counts : sequence of int
        How often each kind comes, at least once.
    limit : int or None
        Most times that a kind may come running; None for no limit.
    stream : Stream
        Where chance comes from.

    Returns
    -------
    list of int
        Index of the kind at each place.

    Raises
    ------
    ValueError
        If no order keeps the limit, or those that do are too many to count and too rare to find.
    """
    if limit is None or limit >= max(counts):
        return stream.shuffled(kind for kind, count in enumerate(counts) for _ in range(count))
    least = least_limit(counts)
    if limit < least:
        raise ValueError(
            f"no order of {sum(counts)} trials keeps the same pair to {limit} times running, since one pair "
            f"has {max(counts)} of them; the least that works is {least}"
        )
    if limit == 1:
        return draw_unlike_neighbours(tuple(counts), stream)
    if n_states_at_most(counts) <= STATE_LIMIT:
        return draw_counted(counts, limit, stream)
    return draw_by_rejection(counts, limit, stream)


def count_orders(counts: Sequence[int], limit: int) -> int:
    """Return how many orders keep the limit, kinds told apart and items of a kind not.

    Parameters
    ----------
    counts : sequence of int
        How often each kind comes.
    limit : int
        Most times that a kind may come running.

    Examples
    --------
    Three kinds, two of each, no two alike running: the 30 of OEIS A110706.

    >>> count_orders([2, 2, 2], 1)
    30
    """
    table = count_states(tuple(counts), limit)
    return sum(weight for *_, weight in moves(tuple(counts), None, limit, table))
