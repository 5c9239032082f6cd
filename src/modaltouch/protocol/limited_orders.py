"""Uniform draws among the orders in which no kind comes more than n times running.

Each way is uniform over all valid orders: by the gaps between unlike neighbours where nothing may come twice
running, by counting the ways to go on where these can be counted, by rejection where they cannot. A long order
is rejected by its beginning alone: how many ways there are to end it can be counted.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import accumulate, groupby, pairwise
from math import comb

from modaltouch.protocol.order_limits import LIMITS, NoOrderError
from modaltouch.protocol.streams import Stream


def count_orders(counts: Sequence[int], limit: int) -> int:
    """Return how many orders keep the limit, kinds told apart and items of a kind not.

    Examples
    --------
    Three kinds, two of each, no two alike running: the 30 of OEIS A110706.

    >>> count_orders([2, 2, 2], 1)
    30
    """
    table = count_states(tuple(counts), limit)
    return sum(weight for *_, weight in moves(tuple(counts), None, limit, table))


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
    """Return the number of ways to go on from every state that can be met."""
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
    """Return an order drawn run by run, each with the share of the orders that begin so."""
    return _finished([], counts, None, limit, count_states(tuple(counts), limit), stream)


def _finished(
    begun: list[int], counts: Sequence[int], last: int | None, limit: int, table: dict[State, int], stream: Stream
) -> list[int]:
    """Return an order that goes on uniformly from how it began, with so many left of each kind."""
    left, order = list(counts), list(begun)
    while any(left):
        choices = list(moves(left, last, limit, table))
        kind, run = choices[stream.weighted([weight for *_, weight in choices])][:2]
        order += [kind] * run
        left[kind] -= run
        last = kind
    return order


def draw_unlike_neighbours(counts: tuple[int, ...], stream: Stream) -> list[int]:
    """Return an order drawn uniformly among those in which no kind follows itself."""
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


WORK_LIMIT = 4_000_000
"""Most items placed in rejected orders before a design is given up: a few seconds."""

LONG_ORDER = 600
"""Trials from which an order is rejected by its beginning: shorter ones are drawn as in records of version 0.2."""

SHARE_BITS = 64
"""Bits of a share of long orders, whose numbers of ways have thousands."""


def draw_by_rejection(counts: Sequence[int], limit: int, stream: Stream, key: str = LIMITS[0]) -> list[int]:
    """Return the first order that keeps limit and counts, of many that keep one of the two by construction.

    Raises
    ------
    NoOrderError
        If such an order is too rare to be found.
    """
    n_trials, n_kinds = sum(counts), len(counts)
    tail = _longest_tail(n_kinds, limit) if n_trials >= LONG_ORDER else 0
    # Rough sizes, logarithms of the tries, only choose the quicker way: each draws uniformly.
    excess = n_trials * n_kinds ** -float(limit) * (1 - 1 / n_kinds)
    spread = (n_kinds - 1) / 2 * math.log(2 * math.pi * n_trials / n_kinds / max(1, 2 * tail / n_kinds))
    by_counts = excess < spread
    kinds = [kind for kind, count in enumerate(counts) for _ in range(count)]
    hopeless = n_trials >= LONG_ORDER and min(excess, spread) > math.log(10 * WORK_LIMIT / n_trials)
    work = 0
    while work < WORK_LIMIT and not hopeless:
        order = stream.shuffled(kinds) if by_counts else _draw_word(tuple(counts), limit, tail, stream)
        work += len(order)
        if len(order) == n_trials and (not by_counts or longest_run(order) <= limit):
            return order
    noun = key.removeprefix("max_same_").removesuffix("_running")
    raise NoOrderError(
        f"orders of {n_kinds} {noun}s with {max(counts)} trials of each in which a {noun} comes at most {limit} "
        f"times running are too many to count and too rare to find; allow {limit + 1} or more running, or "
        f"repeat each condition less often",
        key,
    )


def _draw_word(counts: tuple[int, ...], limit: int, tail: int, stream: Stream) -> list[int]:
    """Return a uniform draw among all orders that keep the limit, cut where its counts go wrong.

    Where there is a tail, the beginning of such an order is kept with the share of its ends that keep the counts,
    and one of these ends is drawn.
    """
    steps = _shares_of_runs(sum(counts), len(counts), limit, exact=not tail)
    left, last, order = list(counts), -1, list[int]()
    rest = sum(counts)
    while rest > tail:
        totals = steps[rest]
        run = 1 + bisect_right(totals, stream.below(totals[-1]))
        kind = stream.below(len(counts) - (last >= 0))
        kind += 0 <= last <= kind
        left[kind] -= run
        rest -= run
        if left[kind] < 0:
            return order
        order += [kind] * run
        last = kind
    if not tail:
        return order
    table, best = _ends(len(counts), limit, tail)
    ways = table.get((left[last], tuple(sorted(left[:last] + left[last + 1 :]))), 0)
    kept = stream.below(_ways_to_fill(tail, len(counts), limit)[rest] * best.numerator) < ways * best.denominator
    return _finished(order, left, last, limit, table, stream) if kept else order


def _longest_tail(n_kinds: int, limit: int) -> int:
    """Return the most trials whose orders can be counted, however they are shared out among the kinds."""
    tail = 0
    while n_states_at_most([_most_of_a_kind(tail + 1, limit)] * n_kinds) <= STATE_LIMIT:
        tail += 1
    return tail


def _most_of_a_kind(n_trials: int, limit: int) -> int:
    """Return the most trials of one kind in an order that keeps the limit."""
    return limit * (n_trials + 1) // (limit + 1)


@lru_cache(maxsize=8)
def _ends(n_kinds: int, limit: int, tail: int) -> tuple[dict[State, int], Fraction]:
    """Return the ways to go on from every state, and the largest share of them among orders of any counts."""
    table = count_states((_most_of_a_kind(tail, limit) + 1,) * n_kinds, limit)
    ways = _ways_to_fill(tail, n_kinds, limit)
    lengths = {state: state[0] + sum(state[1]) for state in table}
    shares = (Fraction(table[state], ways[n]) for state, n in lengths.items() if tail - limit < n <= tail)
    return table, max(shares)


@lru_cache(maxsize=8)
def _shares_of_runs(length: int, n_kinds: int, limit: int, exact: bool) -> list[list[int]]:
    """Return the ways to go on with runs of 1, 2, ... at most, added up, by the number of places left."""
    ways = _ways_to_fill(length, n_kinds, limit)
    rows: list[list[int]] = [[]]
    for rest in range(1, length + 1):
        row = list(accumulate((n_kinds - 1) * ways[rest - run] for run in range(1, min(limit, rest) + 1)))
        rows.append(row if exact else [(total << SHARE_BITS) // ways[rest] for total in row])
    return rows


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
    return max((len(list(run)) for _, run in groupby(order)), default=0)
