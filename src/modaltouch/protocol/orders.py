"""Orders in which no kind comes more than n times running, drawn uniformly among all of them.

Exactly so wherever they can be counted or are met by chance; by a random walk where they are too many and too rare.
"""

from __future__ import annotations

from collections.abc import Sequence

from modaltouch.protocol.order_limits import LIMITS, refuse_runs
from modaltouch.protocol.streams import Stream


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
        If no order keeps the limit.
    """
    if limit is None or limit >= max(counts):
        return stream.shuffled(kind for kind, count in enumerate(counts) for _ in range(count))
    refuse_runs(counts, limit, key)
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
    drawn = draw_by_rejection(counts, limit, stream)
    if drawn is None:
        from modaltouch.protocol.order_walk import Limit, draw_by_walk

        kinds = [kind for kind, count in enumerate(counts) for _ in range(count)]
        drawn = draw_by_walk(kinds, [Limit(key, lambda kind: kind, limit)], stream)
    return drawn
