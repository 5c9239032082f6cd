"""Limits beyond that on pairs: kept in every order, each order that keeps them as likely as any other, or refused."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from modaltouch.preflight import examine
from modaltouch.protocol import Findings, InputError, Protocol, Schedule, constrained_orders
from modaltouch.protocol.constrained_orders import Limit, draw_constrained, limits_of
from modaltouch.protocol.limited_orders import longest_run
from modaltouch.protocol.order_limits import NoOrderError
from modaltouch.protocol.streams import Stream
from modaltouch.session import wire_run

SHIPPED = Path(__file__).parents[3] / "protocols"
TWO = Findings.read(SHIPPED / "two_fields.yaml").experiment().protocol


def limited(**limits: Any) -> Protocol:
    """Return two pairs, two levels and two stimuli, twice each, under some limits."""
    usual = {"max_same_pair_running": None, "repetitions": 2}
    return TWO.model_copy(update={"schedule": TWO.schedule.model_copy(update=usual | limits)})


@pytest.mark.parametrize("participant", ["p01", "p02", "p03"])
def test_every_limit_holds_in_every_block(participant: str) -> None:
    """Pair, level, stimulus and side at most so often running; no cell twice within three trials."""
    protocol = limited(
        max_same_pair_running=3, max_same_level_running=2, max_same_stimulus_running=3, max_same_side_running=3,
        min_same_cell_distance=3,
    )  # fmt: skip
    for block in Schedule.draw(protocol, participant, 1).blocks:
        cells = [(each.condition.pair, each.condition.velocity_mm_s, each.condition.stimulus) for each in block.trials]
        assert sorted(Counter(cells).values()) == [2] * 8
        assert longest_run([pair for pair, *_ in cells]) <= 3
        assert longest_run([level for _, level, _ in cells]) <= 2
        assert longest_run([stimulus for *_, stimulus in cells]) <= 3
        assert longest_run([pair.index("C") for pair, *_ in cells]) <= 3
        places = {cell: [n for n, own in enumerate(cells) if own == cell] for cell in cells}
        assert min(b - a for a, b in places.values()) >= 3


def test_the_hardest_limit_is_kept_by_drawing() -> None:
    """Of two levels at most two running as of four stimuli never one twice, the second is the rarer by chance.

    By hand, runs that are too long among 32 trials: 32 / 4 * 3 / 4 = 6 of stimuli, 32 / 4 / 2 = 4 of levels.
    """
    cells = [(pair, level, name) for pair in (("A", "C"), ("C", "E")) for level in (80.0, 150.0) for name in "abcd"] * 2
    level, stimulus = Limit("level", lambda cell: cell[1], 2), Limit("stimulus", lambda cell: cell[2], 1)
    assert (level.frequency(cells), stimulus.frequency(cells)) == (4.0, 6.0)
    for n in range(20):
        order = draw_constrained(cells, [level, stimulus], Stream(1, f"p{n}", 1, "a test"), 0.1)
        assert level.holds(order)
        assert stimulus.holds(order)


def test_all_orders_that_keep_the_limits_are_equally_likely() -> None:
    """Chi-squared over every order there is, found by going through all permutations; 1 in 1000 above the bound."""
    cells = [(("A", "C"), 80.0, ""), (("A", "C"), 150.0, ""), (("C", "E"), 80.0, "")] * 2
    limits = [
        Limit("max_same_pair_running", lambda cell: cell[0], 2),
        Limit("max_same_level_running", lambda cell: cell[1], 2),
        Limit("min_same_cell_distance", lambda cell: cell, 1, 2),
    ]
    valid = {order for order in itertools.permutations(cells) if all(limit.holds(order) for limit in limits)}
    stream = Stream(1, "p01", 1, "a test")
    drawn = Counter(tuple(draw_constrained(cells, limits, stream)) for _ in range(100 * len(valid)))
    assert set(drawn) == valid
    assert len(valid) == 12
    assert sum((n - 100) ** 2 / 100 for n in drawn.values()) < 31.3


def test_pairs_without_the_focus_break_a_row_of_one_side() -> None:
    """The side is that of the finger on the focus."""
    (limit,) = limits_of(limited(max_same_side_running=1))
    left, right, none = ((pair, 80.0, "sharp") for pair in (("C", "E"), ("A", "C"), ("B", "D")))
    assert limit.holds([left, right, left])
    assert limit.holds([left, none, left])
    assert not limit.holds([right, right, none])


@pytest.mark.parametrize(
    ("limits", "told"),
    [
        ("min_same_cell_distance: 9", "schedule.min_same_cell_distance is 9, but 4 of 24 trials are of one cell; the"),
        ("max_same_stimulus_running: 1", "schedule.max_same_stimulus_running is 1, but 24 of 24 trials are alike"),
        ("max_same_level_running: 1\n  min_same_cell_distance: 6", "most broke schedule.min_same_cell_distance: ease"),
    ],
)
def test_limits_that_cannot_be_kept_are_refused_with_the_reason(
    edit: Any, monkeypatch: pytest.MonkeyPatch, limits: str, told: str
) -> None:
    """At the key that asks too much."""
    monkeypatch.setattr(constrained_orders, "WORK_LIMIT", 5000)
    words = ("  max_same_pair_running: 2", f"  {limits}"), ("repetitions: 1", "repetitions: 4")
    problems = examine(edit("demo.yaml", *words)).problems
    assert [told in each.given for each in problems] == [True]
    assert problems[0].path in ("schedule.min_same_cell_distance", "schedule.max_same_stimulus_running")


def test_a_participant_without_an_order_is_told_and_is_rare(
    edit: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A check gives up after a tenth of the work; who has no order all the same gets words, no traceback."""
    words = ("  max_same_pair_running: 2", "  max_same_level_running: 1\n  min_same_cell_distance: 3")
    preflight = examine(edit("demo.yaml", words, ("repetitions: 1", "repetitions: 4"))).require()
    monkeypatch.setattr(constrained_orders, "WORK_LIMIT", 24 * 10)
    with pytest.raises(InputError, match="limits that no order drawn for p01 keeps, none of 10 orders .* another --se"):
        wire_run(preflight, "p01", answers="simulated", results=tmp_path)
    (problem,) = examine(preflight.experiment.sources.protocol.path).problems
    assert "none of 1 orders drawn kept" in problem.given


def test_orders_that_take_long_to_draw_are_given_up_by_what_was_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Known: 16 trials of each of two pairs take 30 words or more to shuffle, so 100 are passed after four orders."""
    monkeypatch.setattr(constrained_orders, "DRAWN_LIMIT", 100)
    cells = [((zone, "C"), 80.0, "") for zone in "AB"] * 16
    never = Limit("max_same_side_running", lambda cell: None if cell[0][0] == "A" else 1, 1)
    own = Limit("max_same_pair_running", lambda cell: cell[0], 2)
    with pytest.raises(NoOrderError, match="none of [1-4] orders drawn kept"):
        draw_constrained(cells, [own, never], Stream(1, "p01", 1, "order"))


def test_a_limit_with_an_order_that_is_not_drawn_is_refused(edit: Any) -> None:
    """Rows of a Latin square keep no limits."""
    words = ("  max_same_pair_running: 2", "  order: latin_square\n  max_same_level_running: 2")
    problems = examine(edit("demo.yaml", words)).problems
    assert [each.message for each in problems] == [
        "given 2 with the order latin_square; allowed: null, or the order shuffled; remove the limit or shuffle"
    ]
