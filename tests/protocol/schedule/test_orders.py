"""Uniform draws among the orders that keep a limit on runs."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from modaltouch.protocol.limited_orders import (
    Limit,
    count_states,
    draw_by_rejection,
    draw_by_walk,
    draw_counted,
    draw_unlike_neighbours,
    longest_run,
    moves,
)
from modaltouch.protocol.orders import draw_order
from modaltouch.protocol.schedule_section import least_limit
from modaltouch.protocol.streams import Stream

Draw = Callable[[Sequence[int], int, Stream], list[int] | None]


def count_orders(counts: tuple[int, ...], limit: int) -> int:
    """Return the number of orders that the counting draw distinguishes (items of a kind are identical)."""
    return sum(weight for *_, weight in moves(counts, None, limit, count_states(counts, limit)))


def by_gaps(counts: Sequence[int], limit: int, stream: Stream) -> list[int]:
    """Draw by gaps, the method for a limit of one."""
    assert limit == 1
    return draw_unlike_neighbours(tuple(counts), stream)


def by_walk(counts: Sequence[int], limit: int, stream: Stream) -> list[int]:
    """Draw by a random walk among all orders of these counts."""
    items = [kind for kind, count in enumerate(counts) for _ in range(count)]
    return draw_by_walk(items, [Limit("max_same_pair_running", lambda kind: kind, limit)], stream)


def stream(seed: int = 1) -> Stream:
    """Return a stream for tests."""
    return Stream(seed, "p01", 1, "test")


def every_order(counts: Sequence[int], limit: int) -> set[tuple[int, ...]]:
    """Return all valid orders, by brute force."""
    items = [kind for kind, count in enumerate(counts) for _ in range(count)]
    return {order for order in itertools.permutations(items) if longest_run(order) <= limit}


def carlitz(counts: Sequence[int]) -> int:
    """Return the number of words without equal neighbours, by inclusion and exclusion over merged items."""
    total = 0
    for blocks in itertools.product(*(range(1, count + 1) for count in counts)):
        sign = (-1) ** (sum(counts) - sum(blocks))
        ways = math.factorial(sum(blocks))
        for count, block in zip(counts, blocks, strict=True):
            ways *= math.comb(count - 1, block - 1)
            ways //= math.factorial(block)
        total += sign * ways
    return total


@pytest.mark.parametrize(
    ("counts", "limit", "draw"),
    [
        ((2, 2, 2), 1, by_gaps),
        ((3, 2, 1), 1, by_gaps),
        ((2, 2, 1, 1), 1, by_gaps),
        ((2, 2, 2), 1, draw_counted),
        ((4, 2, 1), 2, draw_counted),
        ((3, 2, 2), 2, draw_counted),
        ((2, 2, 2), 1, draw_by_rejection),
        ((4, 2, 1), 2, draw_by_rejection),
        ((3, 2, 1), 1, by_walk),
    ],
)
def test_every_valid_order_is_equally_likely(counts: tuple[int, ...], limit: int, draw: Draw) -> None:
    """Chi-square over all orders found by brute force; fixed seed, p above 0.001."""
    orders = every_order(counts, limit)
    source, n_draws = stream(3), 30 * len(orders)
    drawn = Counter(tuple(draw(counts, limit, source) or ()) for _ in range(n_draws))
    assert set(drawn) == orders
    statistic = sum((drawn[order] - 30) ** 2 / 30 for order in orders)
    assert chi2.sf(statistic, len(orders) - 1) > 1e-3


def test_long_orders_are_drawn_by_the_walk() -> None:
    """Six pairs with 100 trials each: about one order in ten million keeps the limit."""
    assert draw_by_rejection((100,) * 6, 2, stream()) is None
    order = draw_order((100,) * 6, 2, stream())
    assert longest_run(order) == 2
    assert [order.count(kind) for kind in range(6)] == [100] * 6


def test_the_chi_square_detects_a_greedy_draw() -> None:
    """Picking each next item among the allowed ones, with restarts, is biased."""
    counts, limit, source = (3, 2, 1), 1, stream(3)
    orders = every_order(counts, limit)

    def greedy() -> tuple[int, ...]:
        while True:
            left, order = list(counts), []
            while any(left):
                allowed = [kind for kind, n in enumerate(left) if n and longest_run([*order, kind]) <= limit]
                if not allowed:
                    break
                order.append(allowed[source.below(len(allowed))])
                left[order[-1]] -= 1
            else:
                return tuple(order)

    drawn = Counter(greedy() for _ in range(100 * len(orders)))
    statistic = sum((drawn[order] - 100) ** 2 / 100 for order in orders)
    assert chi2.sf(statistic, len(orders) - 1) < 1e-6


@pytest.mark.parametrize(("counts", "limit"), [((2, 2, 2), 1), ((3, 2, 2), 2), ((4, 2, 1), 2), ((3, 3), 2)])
def test_counts_of_orders_agree_with_brute_force(counts: tuple[int, ...], limit: int) -> None:
    """Four small designs."""
    assert count_orders(counts, limit) == len(every_order(counts, limit))


@pytest.mark.parametrize("counts", [(4, 4, 4), (12, 12, 12), (5, 3, 2, 2), (8, 8, 8, 8)])
def test_orders_without_like_neighbours_are_the_carlitz_numbers(counts: tuple[int, ...]) -> None:
    """Inclusion and exclusion, which for three kinds gives OEIS A110706: 6, 30, 174, 1092."""
    assert [carlitz((n, n, n)) for n in range(1, 5)] == [6, 30, 174, 1092]
    assert count_orders(counts, 1) == carlitz(counts)


def test_the_papers_design_loses_39_percent_of_plain_shuffles() -> None:
    """A plain shuffle of 3 pairs x 4 levels has a pair three times running in 39 % of sessions."""
    plain = math.factorial(12) // math.factorial(4) ** 3
    assert round(100 * (1 - count_orders((4, 4, 4), 2) / plain)) == 39
    source = stream()
    drawn = [draw_order((4, 4, 4), None, source) for _ in range(4000)]
    share = np.mean([longest_run(order) >= 3 for order in drawn])
    assert abs(share - 0.39) < 4 * math.sqrt(0.39 * 0.61 / 4000)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(1, 8), min_size=2, max_size=5), st.integers(1, 4), st.integers(0, 2**64))
def test_every_order_keeps_counts_and_limit(counts: list[int], limit: int, seed: int) -> None:
    """Or is refused, if the limit is below `least_limit`."""
    source = Stream(seed, "p", 1, "test")
    if limit < least_limit(counts):
        with pytest.raises(ValueError, match=f"at least {least_limit(counts)}, or null"):
            draw_order(counts, limit, source)
        return
    order = draw_order(counts, limit, source)
    assert [order.count(kind) for kind in range(len(counts))] == counts
    assert longest_run(order) <= limit


@pytest.mark.parametrize("counts", [(3, 1), (2, 1, 1), (5, 2), (4, 4), (6,), (1, 1)])
def test_the_least_limit_is_the_least_that_works(counts: tuple[int, ...]) -> None:
    """Brute force over all orders."""
    items = [kind for kind, count in enumerate(counts) for _ in range(count)]
    assert least_limit(counts) == min(longest_run(order) for order in itertools.permutations(items))


@pytest.mark.parametrize(
    ("counts", "limit"),
    [((40,) * 3, 2), ((100,) * 3, 2), ((12,) * 10, 1), ((12,) * 10, 2), ((40,) * 6, 1), ((500, 500), 3)],
)
def test_large_designs_are_drawn(counts: tuple[int, ...], limit: int) -> None:
    """Up to all ten pairs of five zones and a thousand trials."""
    order = draw_order(counts, limit, stream())
    assert [order.count(kind) for kind in range(len(counts))] == list(counts)
    assert longest_run(order) <= limit


def test_large_whole_numbers_are_uniform() -> None:
    """The mean of uniform numbers below 10**40 is within 4 standard errors of the middle."""
    source, bound, n_draws = stream(), 10**40, 4000
    mean = sum(source.below(bound) for _ in range(n_draws)) / n_draws / bound
    assert abs(mean - 0.5) < 4 / math.sqrt(12 * n_draws)


def test_small_whole_numbers_are_uniform() -> None:
    """Chi-square over the values below 6; fixed seed."""
    source = stream()
    drawn = Counter(source.below(6) for _ in range(6000))
    assert set(drawn) == set(range(6))
    assert chi2.sf(sum((n - 1000) ** 2 / 1000 for n in drawn.values()), 5) > 1e-3
    assert source.below(1) == 0
