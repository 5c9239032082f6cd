"""Orders under limits too complex for counting: a random walk, uniform over the orders that keep the limits.

A step reverses a segment of the order. It is accepted if it violates no more limits than before, else with probability
2**(-k m) for m additional violations (the Metropolis rule, in integers). The stationary distribution over all orders
then has the weight 2**-k for each violation; restricted to orders without any, it is uniform.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from modaltouch.protocol.order_limits import NoOrderError, refuse_runs
from modaltouch.protocol.streams import Stream

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
                given = f"{self.distance}, but {most} of the {len(items)} trials of a block belong to one cell"
                allowed = f"at most {farthest}, or null for no limit" if farthest > 1 else "null"
                raise NoOrderError(self.key, given, allowed, "lower or remove it")
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
        places = range(1, len(order))
        return sum(self.n_broken_between(order[max(0, n - self.reach) : n], order[n : n + 1]) for n in places)


def draw_by_walk(
    items: Sequence[Item], limits: Sequence[Limit[Item]], stream: Stream, effort: float = 1.0
) -> list[Item]:
    """Draw an order that keeps all limits; all are equally likely once the walk has mixed.

    Parameters
    ----------
    items, limits, stream
        Items to order, limits to keep, and source of random numbers.
    effort : float
        Fraction of the usual work after which the search is abandoned [1].

    Raises
    ------
    NoOrderError
        If no order keeps one of the limits, or the walk finds too few that keep all.
    """
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
