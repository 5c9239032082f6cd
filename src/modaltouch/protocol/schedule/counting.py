"""Orders by exact counting: how many ways there are to go on from everything that an order can have begun with.

A state is what is left of each kind. Kinds with equally many left are alike, so only the sorted numbers count.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import lru_cache

from modaltouch.protocol.schedule.streams import Stream

STATE_LIMIT = 40_000
"""Most states that are counted: half a second."""

State = tuple[int, tuple[int, ...]]
"""How many are left of the kind that came last, and of the others, increasing."""


def n_states_at_most(counts: Sequence[int]) -> int:
    """Return a bound on the number of states."""
    most, n_kinds = max(counts), len(counts)
    return (most + 1) * math.comb(most + n_kinds - 1, n_kinds - 1)


@lru_cache(maxsize=8)
def count_states(counts: tuple[int, ...], limit: int) -> dict[State, int]:
    """Return the number of ways to go on from every state that can be met.

    Parameters
    ----------
    counts : tuple of int
        How often each kind comes.
    limit : int
        Most times that a kind may come running.
    """
    layers: dict[int, set[State]] = {}
    open_states = set(_next_states(tuple(sorted(counts)), None, limit))
    while open_states:
        following: set[State] = set()
        for state in open_states:
            layers.setdefault(state[0] + sum(state[1]), set()).add(state)
            following.update(_next_states(state[1], state[0], limit))
        open_states = {s for s in following if s not in layers.get(s[0] + sum(s[1]), ())}
    table: dict[State, int] = {}
    for _, states in sorted(layers.items()):
        for last, others in states:
            done = not last and not any(others)
            ways = 0
            for count, multiplicity in Counter(others).items():
                rest = _without(others, count, last)
                ways += multiplicity * sum(table[count - run, rest] for run in range(1, min(limit, count) + 1))
            table[last, others] = 1 if done else ways
    return table


def _next_states(others: tuple[int, ...], last: int | None, limit: int) -> Iterator[State]:
    for count in set(others):
        rest = _without(others, count, last)
        for run in range(1, min(limit, count) + 1):
            yield count - run, rest


def _without(others: tuple[int, ...], count: int, last: int | None) -> tuple[int, ...]:
    """Return the others once one with `count` left has become the last, and the last one of them."""
    position = others.index(count)
    rest = others[:position] + others[position + 1 :]
    return rest if last is None else tuple(sorted((*rest, last)))


def moves(left: Sequence[int], last: int | None, limit: int, table: dict[State, int]) -> Iterator[tuple[int, int, int]]:
    """Yield each next run: its kind, its length and the number of ways to go on after it.

    Parameters
    ----------
    left : sequence of int
        How many are left of each kind.
    last : int or None
        Kind that came last.
    limit : int
        Most times that a kind may come running.
    table : dict
        As `count_states` returns it.
    """
    for kind, count in enumerate(left):
        if kind == last:
            continue
        others = tuple(sorted(c for other, c in enumerate(left) if other != kind))
        for run in range(1, min(limit, count) + 1):
            yield kind, run, table[count - run, others]


def draw_counted(counts: Sequence[int], limit: int, stream: Stream) -> list[int]:
    """Return an order drawn run by run, each with the share of the orders that begin so.

    Parameters
    ----------
    counts, limit, stream
        As `draw_order` takes them.
    """
    table = count_states(tuple(counts), limit)
    left, order = list(counts), list[int]()
    last: int | None = None
    while any(left):
        choices = list(moves(left, last, limit, table))
        kind, run = choices[stream.weighted([weight for *_, weight in choices])][:2]
        order += [kind] * run
        left[kind] -= run
        last = kind
    return order
