"""Schedules: complete, reproducible, counterbalanced, with a separate random stream for each purpose."""

from __future__ import annotations

import hashlib
import itertools
from bisect import bisect_right
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modaltouch.protocol import Findings, Protocol
from modaltouch.protocol.catch_trials import place_catches
from modaltouch.protocol.latin_squares import latin_square
from modaltouch.protocol.limited_orders import longest_run
from modaltouch.protocol.orders import order_cells
from modaltouch.protocol.schedule import Schedule, Turn
from modaltouch.protocol.streams import ALGORITHM, FORMER_ALGORITHM, Cuts, Stream

SHIPPED = Path(__file__).parents[3] / "protocols"
ORDERS = ["shuffled", "by_pair", "by_velocity", "latin_square"]
PAPER = Findings.read(SHIPPED / "differentiated_stimulation.yaml").experiment().protocol


def changed(section: str, **values: Any) -> Protocol:
    """Return the paper's protocol with changed values in one section."""
    part = getattr(PAPER, section).model_copy(update=values)
    return PAPER.model_copy(update={section: part})


@settings(max_examples=40, deadline=None)
@given(st.text("abcpxyz0123456789", min_size=1, max_size=8), st.integers(0, 2**70), st.integers(1, 9))
def test_every_condition_has_the_number_of_trials_of_the_protocol(participant: str, seed: int, session: int) -> None:
    """3 pairs x 4 levels x 2 finger conditions, once each, in blocks, with no pair three times running."""
    schedule = Schedule.draw(PAPER, participant, seed, session)
    conditions = Counter(trial.condition for trial in schedule.trials)
    assert len(conditions) == 24
    assert set(conditions.values()) == {1}
    assert [trial.index for trial in schedule.trials] == list(range(1, 25))
    for block in schedule.blocks:
        assert {trial.condition.finger_condition for trial in block.trials} == {block.finger_condition}
        assert {trial.block for trial in block.trials} == {block.number}
        assert longest_run([trial.condition.zones for trial in block.trials]) <= 2


def test_repetitions_count_in_the_order_of_presentation() -> None:
    """The first presentation of a condition is repetition 1."""
    schedule = Schedule.draw(changed("schedule", repetitions=3), "p01", 1)
    seen: Counter[Any] = Counter()
    for trial in schedule.trials:
        seen[trial.condition] += 1
        assert trial.repetition == seen[trial.condition]
    assert set(seen.values()) == {3}


def test_a_schedule_depends_on_its_arguments_only() -> None:
    """Protocol, participant, seed and session."""
    schedule = Schedule.draw(PAPER, "p01", 7)
    assert Schedule.draw(PAPER, "p01", 7) == schedule
    others = [
        Schedule.draw(PAPER, "p03", 7),
        Schedule.draw(PAPER, "p01", 8),
        Schedule.draw(PAPER, "p01", 7, session=2),
        Schedule.draw(changed("schedule", repetitions=2), "p01", 7),
    ]
    assert len({each.order_hash for each in (schedule, *others)}) == 5


@pytest.mark.parametrize(
    ("algorithm", "version", "changes", "hash_begins"),
    [
        (ALGORITHM, 2, {}, "88743af0c42dc4a8"),
        (FORMER_ALGORITHM, 1, {}, "88743af0c42dc4a8"),
        (ALGORITHM, 2, {"order": "latin_square", "repetitions": 3}, "bf21fbe41615de83"),
        (FORMER_ALGORITHM, 1, {"order": "latin_square", "repetitions": 3}, "1fd689ac2f11b891"),
    ],
)
def test_recorded_orders_are_drawn_again_by_the_algorithm_they_name(
    algorithm: str, version: int, changes: dict[str, Any], hash_begins: str
) -> None:
    """Records must stay verifiable: a hash may change only with the name of the algorithm."""
    protocol = changed("schedule", max_same_pair_running=None if changes else 2, **changes)
    schedule = Schedule.draw(protocol, "p02" if changes else "p01", 1, algorithm=algorithm)
    assert f"modaltouch order {version}:" in schedule.seeds["algorithm"]
    assert schedule.order_hash.startswith(hash_begins)
    start = {"participant": schedule.participant, "seed": 1, "schedule": schedule.as_dict()}
    assert Schedule.draw_again(protocol, start, 1) == schedule


@pytest.mark.parametrize("number", [0, 1, 5, 17, 30])
def test_a_former_turn_counts_as_the_one_that_now_has_its_first_rows(number: int) -> None:
    """Rows went on by as many as there are repetitions, and now by one: balance counts what was presented."""
    protocol = changed("schedule", order="latin_square", repetitions=3, max_same_pair_running=None)
    turn = Turn(number, "given")
    former = Schedule.draw(protocol, "anna", 1, given=turn, algorithm=FORMER_ALGORITHM)
    now = Schedule.draw(protocol, "anna", 1, given=turn.as_now({"schedule": former.as_dict()}, protocol))
    one, other = ([trial.condition for block in each.blocks for trial in block.trials[:12]] for each in (former, now))
    assert one == other
    assert turn.as_now({"schedule": now.as_dict()}, protocol) == turn


def test_each_purpose_has_its_own_stream() -> None:
    """Changing practice, the order of blocks or one block changes no other draw."""
    schedule = Schedule.draw(PAPER, "p01", 1)
    more_practice = Schedule.draw(changed("schedule", practice_trials=9), "p01", 1)
    assert more_practice.trials == schedule.trials
    one_block = Schedule.draw(changed("conditions", finger_conditions=("one_hand",)), "p01", 1)
    assert one_block.trials == schedule.blocks[0].trials
    fixed = Schedule.draw(changed("schedule", counterbalance_finger_conditions=False), "p02", 1)
    turned = Schedule.draw(PAPER, "p02", 1)
    orders = [
        {block.finger_condition: [trial.condition for trial in block.trials] for block in each.blocks}
        for each in (fixed, turned)
    ]
    assert orders[0] == orders[1]
    assert fixed.blocks[0].finger_condition != turned.blocks[0].finger_condition


def test_numbered_participants_alternate() -> None:
    """p01 has the protocol's order, p02 the opposite; a second session reverses it."""
    first = [Schedule.draw(PAPER, f"p{n:02d}", 1).blocks[0].finger_condition for n in range(1, 5)]
    assert first == ["one_hand", "two_hands", "one_hand", "two_hands"]
    again = Schedule.draw(PAPER, "p01", 1, session=2)
    assert again.blocks[0].finger_condition == "two_hands"
    assert again.finger_conditions_by == "number of the participant"


def test_unnumbered_participants_are_assigned_by_hash() -> None:
    """200 names: each order gets at least 70, which a fair coin misses in 1 of 60,000 studies."""
    names = [f"{a}{b}" for a in "abcdefghijklmnopqrst" for b in "abcdefghij"]
    schedules = [Schedule.draw(PAPER, name, 1) for name in names]
    counts = Counter(schedule.blocks[0].finger_condition for schedule in schedules)
    assert min(counts.values()) >= 70
    assert {schedule.finger_conditions_by for schedule in schedules} == {"hash of the participant"}


def test_without_counterbalancing_the_order_is_that_of_the_protocol() -> None:
    """All participants begin alike, and the record says so."""
    protocol = changed("schedule", counterbalance_finger_conditions=False)
    schedule = Schedule.draw(protocol, "p02", 1)
    assert [block.finger_condition for block in schedule.blocks] == ["one_hand", "two_hands"]
    assert schedule.finger_conditions_by == "protocol"


def test_placements_are_crossed_with_orders_of_finger_conditions() -> None:
    """Four participants have both orders in both placements; on a turned beam A and C change sides."""
    protocol = changed("conditions", placements=("normal", "mirrored"))
    schedules = [Schedule.draw(protocol, f"p{number}", 1) for number in range(1, 5)]
    met = [(each.blocks[0].finger_condition, each.trials[0].condition.placement) for each in schedules]
    assert met == [
        ("one_hand", "normal"),
        ("two_hands", "normal"),
        ("one_hand", "mirrored"),
        ("two_hands", "mirrored"),
    ]
    for schedule in schedules:
        assert len({trial.condition.placement for trial in (*schedule.practice, *schedule.trials)}) == 1
    assert {trial.condition.zones for trial in schedules[0].trials} == {("A", "C"), ("B", "D"), ("C", "E")}
    assert {trial.condition.zones for trial in schedules[2].trials} == {("C", "A"), ("D", "B"), ("E", "C")}


def test_practice_uses_the_conditions_of_the_first_block() -> None:
    """The fingers need not change afterwards; all conditions come once before any comes again."""
    schedule = Schedule.draw(changed("schedule", practice_trials=14), "p02", 1)
    assert all(trial.practice and trial.block == 0 for trial in schedule.practice)
    assert [trial.index for trial in schedule.practice] == list(range(1, 15))
    assert {trial.condition.finger_condition for trial in schedule.practice} == {"two_hands"}
    assert len({trial.condition for trial in schedule.practice[:12]}) == 12
    assert [trial.repetition for trial in schedule.practice[12:]] == [2, 2]


def test_the_record_has_everything_an_order_was_drawn_from() -> None:
    """Seeds, algorithm, hash and the order itself, as plain values."""
    schedule = Schedule.draw(PAPER, "p01", 5)
    record = schedule.as_dict()
    assert record["order_hash"] == schedule.order_hash
    assert record["seeds"]["study_seed"] == 5
    assert set(record["seeds"]["purposes"]) == {
        "order of finger conditions",
        "practice",
        "order within one_hand",
        "order within two_hands",
    }
    first = schedule.trials[0].condition
    assert record["order"][0] == [1, "one_hand", *first.zones, first.velocity_mm_s, "normal"]
    assert (record["n_trials"], record["n_practice_trials"]) == (24, 3)


def test_an_impossible_limit_is_refused_with_its_reason() -> None:
    """Four trials of a single pair necessarily come four times running."""
    protocol = changed("conditions", zone_pairs=(("A", "C"),))
    with pytest.raises(
        ValueError, match=r"_pair_running: given 2, but 4 of the 4 trials of a block have the same pair; at least 4"
    ):
        Schedule.draw(protocol, "p01", 1)


def test_generators_of_two_purposes_differ() -> None:
    """A simulated observer does not share the random numbers of the order."""
    one, other = (
        Schedule.random_generator(1, "p01", 1, purpose).random(4).tolist() for purpose in ("observer", "practice")
    )
    assert one != other


def test_blocked_orders_keep_pairs_or_velocities_together() -> None:
    """Three pairs by four velocities: three runs of four, or four runs of three."""
    by_pair = Schedule.draw(changed("schedule", order="by_pair", max_same_pair_running=None), "p01", 1)
    pairs = [trial.condition.zones for trial in by_pair.blocks[0].trials]
    assert [len(list(run)) for _, run in itertools.groupby(pairs)] == [4, 4, 4]
    by_velocity = Schedule.draw(changed("schedule", order="by_velocity", max_same_pair_running=None), "p01", 1)
    levels = [trial.condition.velocity_mm_s for trial in by_velocity.blocks[0].trials]
    assert [len(list(run)) for _, run in itertools.groupby(levels)] == [3, 3, 3, 3]
    for schedule in (by_pair, by_velocity):
        assert len({trial.condition for trial in schedule.trials}) == 24


def test_twelve_participants_balance_the_latin_square() -> None:
    """Over twelve participants each cell is once at each place and follows each other cell once."""
    protocol = changed("schedule", order="latin_square", max_same_pair_running=None)
    orders = []
    for number in range(1, 13):
        blocks = Schedule.draw(protocol, f"p{number:02d}", 1).blocks
        (one_hand,) = [block for block in blocks if block.finger_condition == "one_hand"]
        orders.append([trial.condition for trial in one_hand.trials])
    for place in range(12):
        assert len({order[place] for order in orders}) == 12
    assert len({pair for order in orders for pair in itertools.pairwise(order)}) == 12 * 11


@pytest.mark.parametrize("repetitions", [2, 3, 5, 11])
def test_each_repetition_balances_the_latin_square(repetitions: int) -> None:
    """Twelve participants have each of twelve cells once at each place, as with one repetition."""
    protocol = changed("schedule", order="latin_square", max_same_pair_running=None, repetitions=repetitions)
    blocks = [Schedule.draw(protocol, f"p{number:02d}", 1).blocks for number in range(1, 13)]
    orders = [own.trials for each in blocks for own in each if own.finger_condition == "one_hand"]
    for place in range(12 * repetitions):
        assert len({order[place].condition for order in orders}) == 12


def test_rows_are_crossed_with_orders_of_finger_conditions() -> None:
    """Twelve rows and two orders give 24 different combinations for 24 participants."""
    protocol = changed("schedule", order="latin_square", max_same_pair_running=None)
    schedules = [Schedule.draw(protocol, f"p{number:02d}", 1) for number in range(1, 25)]
    met = {(each.blocks[0].finger_condition, each.blocks[0].trials[0].condition) for each in schedules}
    assert len(met) == 24


@pytest.mark.parametrize("n_cells", range(1, 9))
def test_a_latin_square_is_balanced(n_cells: int) -> None:
    """Williams 1949: places for any number; successions once for even numbers, twice for odd ones.

    The first rows begin with the cells in turn; this assignment of rows to participants must never change.
    """
    rows = latin_square(n_cells)
    assert [row[0] for row in rows[:n_cells]] == list(range(n_cells))
    each = 1 if n_cells % 2 == 0 else 2
    places = Counter((place, cell) for row in rows for place, cell in enumerate(row))
    assert set(places.values()) == {each}
    assert len(places) == n_cells**2
    successions = Counter(pair for row in rows for pair in itertools.pairwise(row))
    assert set(successions.values()) <= {each}
    assert len(successions) == n_cells * (n_cells - 1)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 12), st.sampled_from([1, 2, 3, None]), st.integers(0, 2**40), st.sampled_from(ORDERS))
def test_catch_trials_are_unpredictable(n: int, limit: int | None, seed: int, order: str) -> None:
    """As many as requested, none first in a block, no two adjacent, and no run longer than the limit."""
    limit = limit if order == "shuffled" else None
    protocol = changed("schedule", catch_trials=n, max_same_pair_running=limit, order=order)
    schedule = Schedule.draw(protocol, "p01", seed)
    bare = Schedule.draw(changed("schedule", max_same_pair_running=limit, order=order), "p01", seed)
    assert [t.index for t in schedule.trials] == list(range(1, 25 + 2 * n))
    for block, other in zip(schedule.blocks, bare.blocks, strict=True):
        catch = [trial.condition.is_catch for trial in block.trials]
        assert sum(catch) == n
        assert not catch[0]
        assert not any(one and two for one, two in itertools.pairwise(catch))
        pairs = [trial.condition.zones for trial in block.trials]
        assert limit is None or longest_run(pairs) <= limit
        driven = [trial.condition for trial in block.trials if not trial.condition.is_catch]
        assert driven == [trial.condition for trial in other.trials]
        if order == "by_pair":
            assert len([key for key, _ in itertools.groupby(pairs)]) == 3


def test_without_catch_trials_the_record_is_unchanged() -> None:
    """No additional purpose, and the same hash."""
    assert (
        Schedule.draw(changed("schedule", catch_trials=0), "p01", 1).as_dict()
        == Schedule.draw(PAPER, "p01", 1).as_dict()
    )
    purposes = Schedule.draw(changed("schedule", catch_trials=1), "p01", 1).seeds["purposes"]
    assert {"catch trials within one_hand", "catch trials within two_hands"} < set(purposes)


def test_catch_trials_are_drawn_uniformly() -> None:
    """Two among A B B A with runs of at most two: ten ways; 5000 draws, chi-square below its 0.9999."""
    first, second = ("A", "C"), ("B", "D")
    order, limit = [first, second, second, first], 2

    def merged(placed: tuple[tuple[int, tuple[str, str]], ...]) -> list[tuple[str, str]]:
        after = dict(placed)
        return [pair for place, own in enumerate(order) for pair in (own, *([after[place]] if place in after else []))]

    ways = [
        tuple(zip(places, pairs, strict=True))
        for places in itertools.combinations(range(4), 2)
        for pairs in itertools.product([first, second], repeat=2)
    ]
    valid = {way for way in ways if longest_run(merged(way)) <= limit}
    stream = Stream(1, "p01", 1, "a test")
    drawn = Counter(tuple(place_catches(order, 2, limit, stream)) for _ in range(5000))
    assert set(drawn) == valid
    expected = 5000 / len(valid)
    assert len(valid) == 10
    assert sum((n - expected) ** 2 / expected for n in drawn.values()) < 33.7


def test_catch_trials_that_cannot_keep_the_limit_are_refused() -> None:
    """Between two alternating pairs no catch trial fits; only the end of the block is free."""
    order = [("A", "C"), ("B", "D")] * 3
    stream = Stream(1, "p01", 1, "a test")
    assert place_catches(order, 1, 1, stream) == [(5, ("A", "C"))]
    with pytest.raises(ValueError, match="2 catch trials cannot be spread over 6 trials"):
        place_catches(order, 2, 1, stream)


def signature(protocol: Protocol, turn: int) -> tuple[Any, ...]:
    """Return the part of a block's order that its turn decides: the row of a Latin square, drawn orders excluded."""
    cells = order_cells(protocol, protocol.conditions.finger_conditions[0], turn, Stream(1, "p01", 1, "a test"))
    keys = {"by_pair": lambda cell: cell[0], "by_velocity": lambda cell: cell[1], "latin_square": lambda cell: cell}
    if protocol.schedule.order not in keys:
        return ()
    return tuple(key for key, _ in itertools.groupby(cells, keys[protocol.schedule.order]))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("repetitions", [1, 2, 3])
@pytest.mark.parametrize("name", ["differentiated_stimulation", "two_fields"])
def test_rows_repeat_after_their_period_and_not_before(order: str, repetitions: int, name: str) -> None:
    """The period is the least number of turns after which all rows repeat, checked over two periods."""
    protocol = Findings.read(SHIPPED / f"{name}.yaml").experiment().protocol
    alone = {"order": order, "repetitions": repetitions, "counterbalance_finger_conditions": False}
    protocol = protocol.model_copy(update={"schedule": protocol.schedule.model_copy(update=alone)})
    period = Turn.period(protocol)
    rows = [signature(protocol, turn) for turn in range(2 * period)]
    assert rows[:period] == rows[period:]
    shorter = [each for each in range(1, period) if period % each == 0]
    assert not [each for each in shorter if all(rows[i] == rows[i + each] for i in range(period))]


def test_the_period_of_turns_combines_rows_fingers_and_placements() -> None:
    """Two orders of finger conditions, four placements and 36 rows of three pairs: 72; without rows 2 or 8."""
    assert Turn.period(PAPER) == 2 * len(PAPER.conditions.placements)
    everywhere = ("normal", "mirrored", "swapped", "mirrored_swapped")
    placed = changed("conditions", placements=everywhere)
    assert Turn.period(placed) == 8
    blocked = placed.model_copy(update={"schedule": placed.schedule.model_copy(update={"order": "by_pair"})})
    assert Turn.period(blocked) == 72


def test_turns_by_hash_never_change() -> None:
    """Later versions must assign participants as recorded."""
    assert Turn.of("anna", 7, 1) == Turn(6325489328891300822, "hash of the participant")
    assert Turn.of("anna", 7, 3).number == 6325489328891300824
    assert Turn.of("p012", 7, 3) == Turn(13, "number of the participant")


def test_the_record_lists_all_trials() -> None:
    """Keys for given turns and adaptive levels are present only if needed."""
    schedule = Schedule.draw(PAPER, "p01", 7)
    record = schedule.as_dict()
    assert list(record) == [
        "order_hash", "seeds", "finger_conditions", "finger_conditions_by", "n_trials", "n_practice_trials", "practice",
        "order",
    ]  # fmt: skip
    assert (record["n_trials"], record["n_practice_trials"]) == (24, len(schedule.practice))
    assert record["practice"] == [
        [0, t.condition.finger_condition, *t.condition.zones, t.condition.velocity_mm_s, t.condition.placement]
        for t in schedule.practice
    ]
    assert [line[0] for line in record["order"]] == [1] * 12 + [2] * 12
    assert list(record["seeds"]) == ["algorithm", "study_seed", "participant", "participant_key", "session", "purposes"]
    assert record["seeds"]["participant_key"] == hashlib.sha256(b"p01").hexdigest()
    given = Schedule.draw(PAPER, "p01", 7, given=Turn(5, "fewest filled it")).as_dict()
    assert (given["turn"], given["turn_by"]) == (5, "fewest filled it")
    adaptive = Findings.read(SHIPPED / "threshold.yaml").experiment().protocol
    assert Schedule.draw(adaptive, "p01", 7).as_dict()["levels"] == "adaptive"


@pytest.mark.parametrize(
    "totals",
    [
        [1],
        [0, 1],
        [1, 2],
        [3, 5, 6],
        [2**63, 2**64],
        [2**64, 2**64 + 1],
        [1, 2**65],
        [2**64 - 1, 2**130 + 7],
        [5, 10**400],
    ],
)
def test_the_first_word_usually_locates_a_number_among_totals(totals: list[int]) -> None:
    """Reference: the whole number drawn from the same words, then looked up."""
    one, other = (Stream(7, "p01", 1, "a test") for _ in range(2))
    cuts = Cuts.of(totals)
    assert all(one.among(cuts) == bisect_right(totals, other.below(totals[-1])) for _ in range(10_000))
    assert one.below(10**30) == other.below(10**30)


@pytest.mark.parametrize(("more", "place"), [(-1, 1), (0, 1), (1, 0), (2**63, 0)])
def test_later_words_decide_if_the_first_is_equal(more: int, place: int) -> None:
    """A total whose first word equals that of the number drawn."""
    number = Stream(7, "p01", 1, "a test").below(2**128)
    assert Stream(7, "p01", 1, "a test").among(Cuts.of([number + more, 2**128])) == place
