"""Random orders that keep limits on their sequence, uniform over all that do.

Orders in which no kind occurs more than n times in a row are drawn exactly: by insertion of one kind after the other,
if no kind may follow itself; by counting the ways to continue, if these are few enough; otherwise by rejection.

Limits too complex for counting take a random walk. A step reverses a segment of the order. It is accepted if it
violates no more limits than before, else with probability 2**(-k m) for m additional violations (the Metropolis rule,
in integers). The stationary distribution over all orders then has the weight 2**-k for each violation; restricted to
orders without any, it is uniform.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate, groupby, pairwise
from math import comb
from typing import Generic, TypeVar

from modaltouch.protocol.conditions import Cell
from modaltouch.protocol.schedule_section import LIMITS, NoOrderError, least_limit
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.streams import Cuts, Stream


def refuse_runs(counts: Sequence[int], limit: int, key: str, n_others: int = 0) -> None:
    """Raise NoOrderError if no order keeps a limit on runs."""
    least = least_limit([*counts, *[1] * n_others])
    if limit < least:
        n_trials, noun = sum(counts) + n_others, key.split("_")[2]
        raise NoOrderError(
            key,
            f"{limit}, but {max(counts)} of the {n_trials} trials of a block have the same {noun}",
            f"at least {least}, or null for no limit",
            "raise or remove it",
        )


State = tuple[int, tuple[int, ...]]
"""Remaining count of the last kind, and those of the other kinds in increasing order."""


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
    """Yield each possible next run: kind, length and number of ways to continue after it."""
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


Item = TypeVar("Item", bound=Hashable)

REPEATS = 10_000
"""Largest number of permutations drawn if only a repeated permutation of the cells keeps the distance."""

SWEEPS = 100
"""Steps per trial of the walk among orders that keep all limits; in most designs two suffice for mixing."""

STEPS_OUTSIDE, SWEEPS_OUTSIDE = 200_000, 200
"""Steps, plus steps per trial, among orders that violate a limit before the search is abandoned."""


@dataclass(frozen=True)
class Limit(Generic[Item]):
    """A limit on the sequence of trials.

    Attributes
    ----------
    key : str
        Key of the section schedule that sets it.
    kind_of : callable
        Kind of an item, such as its pair; None for an item not subject to the limit.
    running : int
        Maximum number of times in a row; 1 for a distance.
    distance : int
        Minimum number of trials from one of a kind to the next; 1 if the limit is on runs.
    """

    key: str
    kind_of: Callable[[Item], object]
    running: int
    distance: int = 1

    def refuse_impossible(self, items: Sequence[Item]) -> None:
        """Raise NoOrderError if no order of these items keeps the limit."""
        counts = Counter(map(self.kind_of, items))
        n_free = counts.pop(None, 0)
        most = max(counts.values(), default=0)
        if self.distance > 1 and most > 1:
            farthest = (len(items) - list(counts.values()).count(most)) // (most - 1)
            if self.distance > farthest:
                raise NoOrderError(
                    self.key,
                    f"{self.distance}, but {most} of the {len(items)} trials of a block belong to one cell",
                    f"at most {farthest}, or null for no limit" if farthest > 1 else "null",
                    "lower or remove it",
                )
        elif most:
            refuse_runs([*counts.values()], self.running, self.key, n_free)

    @property
    def reach(self) -> int:
        """Number of trials on each side of a place that determine whether the limit is violated there."""
        return max(self.running, self.distance - 1)

    def n_broken_between(self, before: Sequence[Item], after: Sequence[Item]) -> int:
        """Count the violations across a place, given the items just before and just after it.

        A run counts once for each item in excess, a distance once for each pair of items too close together.
        """
        if not before or not after:
            return 0
        if self.distance > 1:
            near, far = before[: -self.distance : -1], after[: self.distance - 1]
            if set(near).isdisjoint(far):
                return 0
            return sum(one == other for gap, one in enumerate(near) for other in far[: self.distance - 1 - gap])
        kind, n_alike = self.kind_of(after[0]), 0
        if kind is None or kind != self.kind_of(before[-1]):
            return 0
        for side in (before[: -self.running - 1 : -1], after[: self.running]):
            for item in side:
                if self.kind_of(item) != kind:
                    break
                n_alike += 1
        return max(0, n_alike - self.running)

    def n_broken(self, order: Sequence[Item]) -> int:
        """Count the violations in an order, each at its last trial."""
        return sum(
            self.n_broken_between(order[max(0, n - self.reach) : n], order[n : n + 1]) for n in range(1, len(order))
        )


def limits_of(protocol: Protocol) -> list[Limit[Cell]]:
    """Return the limits of a protocol on its shuffled orders."""

    def side(cell: Cell) -> int | None:
        focus = protocol.stimulus_of(cell[2]).focus
        return cell[0].index(focus) if focus in cell[0] else None

    kinds: dict[str, Callable[[Cell], object]] = {
        "max_same_pair_running": lambda cell: cell[0],
        "max_same_level_running": lambda cell: cell[1],
        "max_same_stimulus_running": lambda cell: cell[2],
        "max_same_side_running": side,
    }
    given = {key: getattr(protocol.schedule, key) for key in LIMITS}
    limits = [Limit(key, kind_of, given[key]) for key, kind_of in kinds.items() if given[key] is not None]
    distance = given["min_same_cell_distance"]
    if distance:
        limits.append(Limit("min_same_cell_distance", lambda cell: cell, 1, distance))
    return limits


def draw_by_walk(
    items: Sequence[Item], limits: Sequence[Limit[Item]], stream: Stream, effort: float = 1.0
) -> list[Item]:
    """Draw an order that keeps all limits; all are equally likely once the walk has mixed."""
    for limit in limits:
        limit.refuse_impossible(items)
    # Look the kind of each item up instead of computing it again.
    limits = [replace(limit, kind_of={item: limit.kind_of(item) for item in items}.__getitem__) for limit in limits]
    if any(limit.distance == len(set(items)) for limit in limits):
        return _draw_repeated(items, limits, stream)
    order, n = stream.shuffled(items), len(items)
    reach = max(limit.reach for limit in limits)
    # A weight below 1 / n: a random order has a few violations per ten trials, but the walk should mostly have none.
    bits, n_steps = n.bit_length(), [0, 0]
    n_broken = sum(limit.n_broken(order) for limit in limits)
    while n_steps[True] < effort * (STEPS_OUTSIDE + SWEEPS_OUTSIDE * n):
        begin, last = sorted(divmod(stream.below(n * n), n))
        end = last + 1
        before, after = order[max(0, begin - reach) : begin], order[end : end + reach]
        # Only the ends of a long segment can violate a limit with its neighbours; a short one matters as a whole.
        head, tail = order[begin : min(end, begin + reach)], order[max(begin, end - reach) : end]
        new_head, new_tail = tail[::-1], head[::-1]
        if end - begin < reach:
            head, new_head, tail, new_tail = head + after, new_head + after, before + tail, before + new_tail
        more = 0
        for limit in limits:
            more += limit.n_broken_between(before, new_head) - limit.n_broken_between(before, head)
            more += limit.n_broken_between(new_tail, after) - limit.n_broken_between(tail, after)
        if more <= 0 or not stream.below(1 << bits * more):
            order[begin:end] = order[begin:end][::-1]
            n_broken += more
        n_steps[n_broken > 0] += 1
        if n_steps[False] == SWEEPS * n:
            return order
    raise _too_rare(limits, [limit.n_broken(order) for limit in limits])


def _draw_repeated(items: Sequence[Item], limits: Sequence[Limit[Item]], stream: Stream) -> list[Item]:
    """Draw a repeated permutation of the kinds, the only order if the distance equals the number of kinds.

    Kinds with one more trial than the others are first, as the last repetition is incomplete.
    """
    counts = Counter(items)
    most = max(counts.values())
    often, others = ([kind for kind, n in counts.items() if (n == most) is is_most] for is_most in (True, False))
    broken = [0] * len(limits)
    for _ in range(REPEATS):
        order = ([*stream.shuffled(often), *stream.shuffled(others)] * most)[: len(items)]
        # No run spans more than two permutations: limits that a single kind would violate were rejected before.
        if not any(found := [limit.n_broken(order[: 3 * len(counts)]) for limit in limits]):
            return order
        broken = [n + more for n, more in zip(broken, found, strict=True)]
    raise _too_rare(limits, broken)


def _too_rare(limits: Sequence[Limit[Item]], broken: Sequence[int]) -> NoOrderError:
    """Return the error that no order was found, with the key of the most violated limit."""
    worst = limits[broken.index(max(broken))]
    number, eased = (worst.distance, "lower it") if worst.distance > 1 else (worst.running, "raise it")
    given = f"{number}, but orders that keep it are too rare to find"
    if len(limits) > 1:
        others = " and ".join(f"schedule.{limit.key}" for limit in limits if limit is not worst)
        given = f"{number}, but orders that keep it together with {others} do not exist or are too rare to find"
        eased += ", as it is broken most, or leave one of them out"
    return NoOrderError(worst.key, given, "", eased)
