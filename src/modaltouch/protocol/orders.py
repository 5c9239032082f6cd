"""Orders in which no kind comes more than n times running, drawn uniformly among all of them."""

from __future__ import annotations

from collections.abc import Sequence

from modaltouch.protocol.order_limits import LIMITS, NoOrderError
from modaltouch.protocol.streams import Stream


def least_limit(counts: Sequence[int]) -> int:
    """Return the smallest limit on runs that the counts allow.

    The most frequent kind must fit into the gaps before, between and after the others.

    >>> least_limit([4, 4, 4]), least_limit([12]), least_limit([9, 2])
    (1, 12, 3)
    """
    most = max(counts)
    return -(-most // (sum(counts) - most + 1))


def draw_order(counts: Sequence[int], limit: int | None, stream: Stream, key: str = LIMITS[0]) -> list[int]:
    """Return an order of kinds, drawn uniformly among those that keep the limit.

    Parameters
    ----------
    counts : sequence of int
        How often each kind comes, at least once.
    limit : int or None
        Most times that a kind may come running; None for no limit.
    stream : Stream
        Where chance comes from.
    key : str
        Which of `LIMITS` it is.

    Returns
    -------
    list of int
        Index of the kind at each place.

    Raises
    ------
    NoOrderError
        If no order keeps the limit, or those that do are too many to count and too rare to find.
    """
    if limit is None or limit >= max(counts):
        return stream.shuffled(kind for kind, count in enumerate(counts) for _ in range(count))
    least = least_limit(counts)
    if limit < least:
        raise NoOrderError(
            f"no order of {sum(counts)} trials keeps the same pair to {limit} times running, since one pair "
            f"has {max(counts)} of them; the least that works is {least}",
            key,
        )
    from modaltouch.protocol.limited_orders import (
        STATE_LIMIT,
        draw_by_rejection,
        draw_counted,
        draw_unlike_neighbours,
        n_states_at_most,
    )

    if limit == 1:
        return draw_unlike_neighbours(tuple(counts), stream)
    if n_states_at_most(counts) <= STATE_LIMIT:
        return draw_counted(counts, limit, stream)
    return draw_by_rejection(counts, limit, stream, key)
