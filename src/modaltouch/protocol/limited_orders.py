"""Uniform random orders in which no kind occurs more than n times in a row.

Three methods, each uniform over all valid orders: insertion of one kind after the other, if no kind may follow itself;
counting of the ways to continue, if these are few enough; otherwise rejection.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import accumulate, groupby, pairwise
from math import comb

from modaltouch.protocol.streams import Cuts, Stream

STATE_LIMIT = 40_000
"""Largest number of states for which the ways to continue are counted, which takes half a second."""

State = tuple[int, tuple[int, ...]]
"""Remaining count of the last kind, and those of the other kinds in increasing order."""


def n_states_at_most(counts: Sequence[int]) -> int:
    """Return an upper bound on the number of states."""
    most, n_kinds = max(counts), len(counts)
    return (most + 1) * math.comb(most + n_kinds - 1, n_kinds - 1)


@lru_cache(maxsize=8)
def count_states(counts: tuple[int, ...], limit: int) -> dict[State, int]:
    """Return the number of ways to continue from every reachable state."""
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
    """Return the counts of the other kinds after a kind with `count` left has replaced the last one."""
    position = others.index(count)
    rest = others[:position] + others[position + 1 :]
    return rest if last is None else tuple(sorted((*rest, last)))


def moves(left: Sequence[int], last: int | None, limit: int, table: dict[State, int]) -> Iterator[tuple[int, int, int]]:
    """Yield each possible next run: kind, length and number of ways to continue after it.

    Parameters
    ----------
    left : sequence of int
        Remaining count of each kind.
    last : int or None
        The last kind.
    limit : int
        Maximum number of times in a row.
    table : dict
        Returned by `count_states`.
    """
    for kind, count in enumerate(left):
        if kind == last:
            continue
        others = tuple(sorted(c for other, c in enumerate(left) if other != kind))
        for run in range(1, min(limit, count) + 1):
            yield kind, run, table[count - run, others]


def draw_counted(counts: Sequence[int], limit: int, stream: Stream) -> list[int]:
    """Draw an order run by run, each with the probability that a valid order continues with it."""
    table, left, order, last = count_states(tuple(counts), limit), list(counts), list[int](), None
    while any(left):
        choices = list(moves(left, last, limit, table))
        kind, run = choices[stream.weighted([weight for *_, weight in choices])][:2]
        order += [kind] * run
        left[kind] -= run
        last = kind
    return order


def draw_unlike_neighbours(counts: tuple[int, ...], stream: Stream) -> list[int]:
    """Draw an order uniformly among those in which no kind follows itself."""
    order: list[int] = []
    for kind, count in enumerate(counts):
        like = [place for place, (one, other) in enumerate(pairwise(order), start=1) if one == other]
        unlike = sorted(set(range(len(order) + 1)) - set(like))
        spreads = _spreads(counts, kind, len(like))
        n_groups, n_like = spreads[stream.weighted([weight for *_, weight in spreads])][:2]
        gaps = stream.chosen(like, n_like) + stream.chosen(unlike, n_groups - n_like)
        # Group sizes: cut the row of items at random positions, drawn without replacement.
        cuts = [0, *sorted(stream.chosen(range(1, count), n_groups - 1)), count]
        sizes = dict(zip(sorted(gaps), (b - a for a, b in pairwise(cuts)), strict=True))
        grown: list[int] = []
        for place in range(len(order) + 1):
            grown += [kind] * sizes.get(place, 0) + order[place : place + 1]
        order = grown
    return order


def _spreads(counts: tuple[int, ...], kind: int, n_like: int) -> list[tuple[int, int, int]]:
    """Return the groupings of a kind: number of groups, how many are between like neighbours, and number of orders."""
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
    """Return the number of ways to finish, by the kind to insert next (not the first) and number of like neighbours."""
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


WORK_LIMIT = 4_000_000
"""Largest number of items placed in rejected orders before rejection is abandoned, which takes a few seconds."""


def draw_by_rejection(counts: Sequence[int], limit: int, stream: Stream) -> list[int] | None:
    """Draw orders that keep either the limit or the counts until one keeps both; None if these are too rare.

    No order is drawn if this is expected to take more than about `WORK_LIMIT` items.
    """
    n_trials, n_kinds = sum(counts), len(counts)
    # Both ways are uniform; the one with the smaller estimated number of attempts (logarithms) is chosen.
    excess = n_trials * n_kinds ** -float(limit) * (1 - 1 / n_kinds)
    spread = (n_kinds - 1) / 2 * math.log(2 * math.pi * n_trials / n_kinds)
    by_counts = excess < spread
    kinds = [kind for kind, count in enumerate(counts) for _ in range(count)]
    work = WORK_LIMIT if min(excess, spread) > math.log(WORK_LIMIT / n_trials) else 0
    while work < WORK_LIMIT:
        order = stream.shuffled(kinds) if by_counts else _draw_word(tuple(counts), limit, stream)
        work += len(order)
        if len(order) == n_trials and (not by_counts or longest_run(order) <= limit):
            return order
    return None


def _draw_word(counts: tuple[int, ...], limit: int, stream: Stream) -> list[int]:
    """Draw uniformly among all orders that keep the limit, truncated where a count is exceeded."""
    steps = _totals_of_runs(sum(counts), len(counts), limit)
    left, last, order, others = list(counts), -1, list[int](), len(counts)
    rest = len(steps)
    while rest:
        run = 1 + stream.among(steps[rest - 1])
        rest -= run
        kind = stream.below(others)
        if last >= 0:
            kind += last <= kind
        else:
            others -= 1
        left[kind] -= run
        if left[kind] < 0:
            return order
        order += [kind] * run
        last = kind
    return order


@lru_cache(maxsize=8)
def _totals_of_runs(length: int, n_kinds: int, limit: int) -> list[Cuts]:
    """Return the cumulative number of ways to continue with a run of 1, 2, ..., by number of places left."""
    ways, rows = [1], list[Cuts]()
    for rest in range(1, length + 1):
        totals = list(accumulate((n_kinds - 1) * ways[rest - run] for run in range(1, min(limit, rest) + 1)))
        rows.append(Cuts.of(totals))
        ways.append(totals[-1])
    return rows


def longest_run(order: Sequence[object]) -> int:
    """Return the length of the longest run of one item.

    >>> longest_run("ABBBA")
    3
    """
    return max((len(list(run)) for _, run in groupby(order)), default=0)
