"""Limits other than that on pairs: kept in every order, with all such orders equally likely, or refused."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from scipy.stats import chi2, chi2_contingency

from modaltouch.preflight import examine
from modaltouch.protocol import Findings, InputError, Protocol, Schedule, limited_orders
from modaltouch.protocol.limited_orders import Limit, draw_by_walk, limits_of, longest_run
from modaltouch.protocol.orders import are_certain
from modaltouch.protocol.schedule_section import NoOrderError
from modaltouch.protocol.streams import Stream
from modaltouch.session import wire_run

SHIPPED = Path(__file__).parents[3] / "protocols"
TWO = Findings.read(SHIPPED / "two_fields.yaml").experiment().protocol


def limited(**limits: Any) -> Protocol:
    """Return two pairs, two levels and two stimuli, twice each, with the given limits."""
    usual = {"max_same_pair_running": None, "repetitions": 2}
    return TWO.model_copy(update={"schedule": TWO.schedule.model_copy(update=usual | limits)})


@pytest.mark.parametrize("participant", ["p01", "p02", "p03"])
def test_every_limit_holds_in_every_block(participant: str) -> None:
    """Runs of pair, level, stimulus and side are limited; no cell comes twice within three trials."""
    protocol = limited(
        max_same_pair_running=3, max_same_level_running=2, max_same_stimulus_running=3, max_same_side_running=3,
        min_same_cell_distance=3,
    )  # fmt: skip
    for block in Schedule.draw(protocol, participant, 1).blocks:
        cells = [(each.condition.zones, each.condition.velocity_mm_s, each.condition.stimulus) for each in block.trials]
        assert sorted(Counter(cells).values()) == [2] * 8
        assert longest_run([pair for pair, *_ in cells]) <= 3
        assert longest_run([level for _, level, _ in cells]) <= 2
        assert longest_run([stimulus for *_, stimulus in cells]) <= 3
        assert longest_run([pair.index("C") for pair, *_ in cells]) <= 3
        places = {cell: [n for n, own in enumerate(cells) if own == cell] for cell in cells}
        assert min(b - a for a, b in places.values()) >= 3


LIMITS = {
    "pair": lambda running: Limit("max_same_pair_running", lambda cell: cell[0], running),
    "level": lambda running: Limit("max_same_level_running", lambda cell: cell[1], running),
    # A pair without the focus has no side.
    "side": lambda running: Limit("max_same_side_running", lambda cell: {"A": 0, "B": 1}.get(cell[0]), running),
    "distance": lambda distance: Limit("min_same_cell_distance", lambda cell: cell, 1, distance),
}


def every_order(cells: Sequence[Any], limits: Sequence[Limit[Any]]) -> set[tuple[Any, ...]]:
    """Return all orders that keep the limits, by brute force."""
    return {order for order in itertools.permutations(cells) if not any(limit.n_broken(order) for limit in limits)}


@pytest.mark.parametrize(
    ("cells", "given", "n_orders"),
    [
        ("A1 A2 C1 A1 A2 C1", {"pair": 2, "level": 2, "distance": 2}, 12),
        ("A1 A2 B1 B2 C1 C2", {"pair": 1, "level": 1}, 12),
        ("A1 A1 A1 A2 B1 B2", {"pair": 3, "level": 2}, 40),
        ("A1 B1 A2 C2 C1 A1", {"side": 1, "level": 2}, 28),
        ("A1 B1 C1 A1 B1 C1", {"distance": 3}, 6),
    ],
)
def test_all_orders_that_keep_the_limits_are_equally_likely(
    cells: str, given: dict[str, int], n_orders: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Chi-squared over all orders found by brute force, with a tenth of the usual steps; p above 0.001."""
    monkeypatch.setattr(limited_orders, "SWEEPS", 10)
    limits, items = [LIMITS[name](limit) for name, limit in given.items()], cells.split()
    valid = every_order(items, limits)
    stream = Stream(1, "p01", 1, "a test")
    drawn = Counter(tuple(draw_by_walk(items, limits, stream)) for _ in range(20 * n_orders))
    assert (set(drawn), len(valid)) == (valid, n_orders)
    assert chi2.sf(sum((n - 20) ** 2 / 20 for n in drawn.values()), n_orders - 1) > 1e-3


def test_the_walk_draws_as_rejection_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """18 trials with limits on pair and level: repeated pairs are as frequent as in rejection sampling."""
    monkeypatch.setattr(limited_orders, "SWEEPS", 10)
    cells = [pair + level for pair in "AB" for level in "123"] * 3
    limits, stream = [LIMITS["pair"](4), LIMITS["level"](3)], Stream(1, "p01", 1, "a test")

    def alike(order: Sequence[str]) -> int:
        return sum(one[0] == other[0] for one, other in itertools.pairwise(order))

    shuffled = (stream.shuffled(cells) for _ in itertools.count())
    rejected = (order for order in shuffled if not any(limit.n_broken(order) for limit in limits))
    one = Counter(alike(order) for order in itertools.islice(rejected, 500))
    other = Counter(alike(draw_by_walk(cells, limits, stream)) for _ in range(500))
    middle = range(5, 11)
    table = [[each[n] for n in middle] + [500 - sum(each[n] for n in middle)] for each in (one, other)]
    assert chi2_contingency(table).pvalue > 1e-3


@pytest.mark.parametrize("participant", ["p01", "p02", "p03"])
def test_long_orders_keep_limits(participant: str) -> None:
    """144 trials of 3 pairs and 4 levels; about one shuffle in exp(17) would keep both limits."""
    cells = [pair + level for pair in "ABC" for level in "1234"] * 12
    order = draw_by_walk(cells, [LIMITS["pair"](2), LIMITS["level"](2)], Stream(1, participant, 1, "a test"))
    assert Counter(order) == Counter(cells)
    assert [longest_run([cell[n] for cell in order]) for n in (0, 1)] == [2, 2]


def test_pairs_without_the_focus_end_a_run_of_one_side() -> None:
    """The side is that of the finger on the focus."""
    (limit,) = limits_of(limited(max_same_side_running=1))
    left, right, none = ((pair, 80.0, "sharp") for pair in (("C", "E"), ("A", "C"), ("B", "D")))
    assert not limit.n_broken([left, right, left])
    assert not limit.n_broken([left, none, left])
    assert limit.n_broken([right, right, none]) == 1


@pytest.mark.parametrize(
    ("limits", "told"),
    [
        (
            "min_same_cell_distance: 9",
            "given 9, but 4 of the 24 trials of a block belong to one cell; allowed: at most 6, or null for no limit",
        ),
        ("max_same_stimulus_running: 1", "given 1, but 24 of the 24 trials of a block have the same stimulus; allowed"),
    ],
)
def test_impossible_limits_are_refused_at_their_key(edit: Any, limits: str, told: str) -> None:
    """With the reason."""
    words = ("  max_same_pair_running: 2", f"  {limits}"), ("repetitions: 1", "repetitions: 4")
    problems = examine(edit("demo.yaml", *words)).problems
    assert [told in each.message for each in problems] == [True]
    assert problems[0].path in ("schedule.min_same_cell_distance", "schedule.max_same_stimulus_running")


def test_a_limit_on_runs_that_cannot_be_kept_is_refused_before_the_search() -> None:
    """Nine of ten trials have one pair, so at best a run of five remains."""
    told = "max_same_pair_running: given 2, but 9 of the 10 trials of a block have the same pair; at least 5"
    with pytest.raises(NoOrderError, match=told):
        LIMITS["pair"](2).refuse_impossible(["A1"] * 9 + ["C1"])
    LIMITS["pair"](5).refuse_impossible(["A1"] * 9 + ["C1"])
    LIMITS["distance"](3).refuse_impossible(["A1", "A2", "C1"])


def test_a_participant_without_an_order_gets_a_clear_error(
    edit: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check stops after a quarter of the work; a session without an order ends with a message."""
    words = ("  max_same_pair_running: 2", "  max_same_level_running: 1\n  min_same_cell_distance: 3")
    preflight = examine(edit("demo.yaml", words, ("repetitions: 1", "repetitions: 4"))).require()
    monkeypatch.setattr(limited_orders, "SWEEPS", 10**6)
    monkeypatch.setattr(limited_orders, "STEPS_OUTSIDE", 0)
    with pytest.raises(InputError, match="orders that keep it together .* too rare to find") as caught:
        wire_run(preflight, "p01", answers="simulated", results=tmp_path)
    assert caught.value.__notes__ == ["this is the order of p01: another --seed draws another"]
    (problem,) = examine(preflight.experiment.sources.protocol.path).problems
    assert "do not exist or are too rare to find" in problem.given


def test_incompatible_limits_are_refused_together() -> None:
    """If two pairs and two levels both alternate, each pair has only one level."""
    cells = [pair + level for pair in "AB" for level in "12"] * 4
    limits = [LIMITS["pair"](1), LIMITS["level"](1)]
    told = "given 1, but orders that keep it together with schedule.max_same_.*_running do not exist .* is broken most"
    with pytest.raises(NoOrderError, match=told):
        draw_by_walk(cells, limits, Stream(1, "p01", 1, "a test"), effort=0.1)


def test_limits_need_a_shuffled_order(edit: Any) -> None:
    """The rows of a Latin square cannot keep limits."""
    words = ("  max_same_pair_running: 2", "  order: latin_square\n  max_same_level_running: 2")
    problems = examine(edit("demo.yaml", words)).problems
    assert [each.message for each in problems] == [
        "given 2 with the order latin_square; allowed: null, or order: shuffled; remove the limit or shuffle the trials"
    ]


@pytest.mark.parametrize(
    ("counts", "n_orders"), [((3, 3, 3, 3), 8), ((3, 2, 3, 2), 2)], ids=["alike", "two more often"]
)
def test_the_largest_distance_repeats_one_permutation(counts: tuple[int, ...], n_orders: int) -> None:
    """The largest allowed distance works together with other limits, with all permutations equally likely."""
    cells = [cell for cell, n in zip(("A1", "A2", "B1", "B2"), counts, strict=True) for _ in range(n)]
    limits = [LIMITS["pair"](1), Limit("min_same_cell_distance", lambda cell: cell, 1, 4)]
    orders = [draw_by_walk(cells, limits, Stream(seed, "p01", 1, "a test")) for seed in range(400)]
    assert all(
        Counter(order) == Counter(cells) and not sum(limit.n_broken(order) for limit in limits) for order in orders
    )
    # Known by hand: pairs alternate, so 8 of 24 permutations are left, and 2 with A1 and B1 first.
    drawn = Counter(tuple(order[:4]) for order in orders)
    assert len(drawn) == n_orders
    assert max(drawn.values()) < 1.6 * 400 / n_orders


def test_a_limit_that_is_too_hard_is_refused_with_its_value() -> None:
    """Eight cells, seven trials apart: orders exist, but none is found."""
    cells = [cell for cell in "abcdefgh" for _ in range(10)]
    told = "schedule.min_same_cell_distance: given 7, but orders that keep it are too rare to find; lower it"
    with pytest.raises(NoOrderError, match=told):
        draw_by_walk(cells, [LIMITS["distance"](7)], Stream(1, "p", 1, "x"), effort=0.02)


@pytest.mark.parametrize("repetitions", [1, 2, 9, 30])
@pytest.mark.parametrize("limit", [None, 1, 2, 3])
def test_certain_orders_exist_for_every_participant(limit: int | None, repetitions: int) -> None:
    """The check then draws nothing: two pairs with equal counts always have an order."""
    protocol = limited(max_same_pair_running=limit, repetitions=repetitions)
    assert are_certain(protocol)
    for participant in ("p01", "p02", "p03"):
        for block in Schedule.draw(protocol, participant, 1).blocks:
            assert longest_run([each.condition.zones for each in block.trials]) <= (limit or len(block.trials))


@pytest.mark.parametrize(
    "limits",
    [{"max_same_level_running": 2}, {"min_same_cell_distance": 2}, {"catch_trials": 2}, {"order": "blocked"}],
    ids=lambda given: next(iter(given)),
)
def test_orders_that_need_a_search_are_not_certain(limits: dict[str, Any]) -> None:
    """Nor are impossible limits on pairs, or orders that are too many to count."""
    assert not are_certain(limited(**limits))
    uneven = TWO.conditions.model_copy(update={"zone_pairs": (("A", "C"),)})
    assert not are_certain(limited(max_same_pair_running=1).model_copy(update={"conditions": uneven}))
    assert not are_certain(limited(max_same_pair_running=2, repetitions=10_000))
