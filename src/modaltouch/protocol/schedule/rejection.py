"""Orders by rejection, for designs with too many states to count."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

from modaltouch.protocol.schedule.streams import Stream

WORK_LIMIT = 4_000_000
"""Most items placed in rejected orders before a design is given up: a few seconds."""


def draw_by_rejection(counts: Sequence[int], limit: int, stream: Stream) -> list[int]:
    """Return the first order that keeps limit and counts, of many that keep one of the two by construction.

    Parameters
    ----------
    counts, limit, stream
        As `draw_order` takes them.

    Raises
    ------
    ValueError
        If none is found with reasonable work.
    """
    n_trials, n_kinds = sum(counts), len(counts)
    # Rough sizes only choose the quicker way: either draws uniformly.
    excess = n_trials * n_kinds ** -float(limit) * (1 - 1 / n_kinds)
    spread = (n_kinds - 1) / 2 * math.log(2 * math.pi * n_trials / n_kinds)
    by_counts = excess < spread
    kinds = [kind for kind, count in enumerate(counts) for _ in range(count)]
    work = 0
    while work < WORK_LIMIT:
        order = stream.shuffled(kinds) if by_counts else _draw_word(tuple(counts), limit, stream)
        work += len(order)
        if len(order) == n_trials and (not by_counts or longest_run(order) <= limit):
            return order
    raise ValueError(
        f"orders of {n_kinds} pairs with {max(counts)} trials of each in which a pair comes at most {limit} "
        f"times running are too many to count and too rare to find; allow {limit + 1} or more running, or "
        f"repeat each condition less often"
    )


def _draw_word(counts: tuple[int, ...], limit: int, stream: Stream) -> list[int]:
    """Return a uniform draw among all orders that keep the limit, cut where its counts go wrong."""
    ways = _ways_to_fill(sum(counts), len(counts), limit)
    left, last, order = list(counts), -1, list[int]()
    while len(order) < sum(counts):
        rest = sum(counts) - len(order)
        place = stream.below(ways[rest])
        run = 1
        while place >= (len(counts) - 1) * ways[rest - run]:
            place -= (len(counts) - 1) * ways[rest - run]
            run += 1
        kind = stream.below(len(counts) - (last >= 0))
        kind += 0 <= last <= kind
        left[kind] -= run
        if left[kind] < 0:
            return order
        order += [kind] * run
        last = kind
    return order


@lru_cache(maxsize=8)
def _ways_to_fill(length: int, n_kinds: int, limit: int) -> tuple[int, ...]:
    """Return how many ways there are to go on after a run, by the number of places left."""
    ways = [1]
    for rest in range(1, length + 1):
        ways.append((n_kinds - 1) * sum(ways[rest - run] for run in range(1, min(limit, rest) + 1)))
    return tuple(ways)


def longest_run(order: Sequence[object]) -> int:
    """Return how often the same item comes running at most.

    >>> longest_run("ABBBA")
    3
    """
    longest = run = 0
    previous: object = None
    for place, item in enumerate(order):
        run = run + 1 if place and item == previous else 1
        longest, previous = max(longest, run), item
    return longest
