"""Assignment of balanced orders: by number, or the least filled in the records, with dropouts replaced."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from modaltouch.protocol import Findings, Protocol
from modaltouch.protocol.schedule import Schedule, Turn
from modaltouch.protocol.streams import FORMER_ALGORITHM
from modaltouch.record.chain import RecordError
from modaltouch.record.folders import SessionFolder
from modaltouch.record.log import SessionLog
from modaltouch.record.session import read_session
from modaltouch.session.assignment import assign_turn, is_early, next_session

PAPER = Findings.read(Path(__file__).parents[2] / "protocols" / "differentiated_stimulation.yaml").experiment().protocol


def changed(**changes: Any) -> Protocol:
    """Return the paper's protocol with other placements or another schedule."""
    placements = changes.pop("placements", PAPER.conditions.placements)
    conditions = PAPER.conditions.model_copy(update={"placements": placements})
    schedule = PAPER.schedule.model_copy(update={"balance": "least_filled", **changes})
    return PAPER.model_copy(update={"schedule": schedule, "conditions": conditions})


FOUR = changed(placements=("normal", "mirrored"))


def place_of(results: Path, participant: str, session: int = 1) -> SessionFolder:
    """Return the folder of a participant's session."""
    return SessionFolder(results, "simulated", PAPER.protocol, participant, session)


UNREAD: dict[str, Any] = {
    "rig_choice": "", "answers_choice": "", "design": {}, "versions": {}, "stimulus": {"content_hash": ""},
    "sources": dict.fromkeys(("protocol", "apparatus", "texts"), {"text": "", "path": ""}),
}  # fmt: skip
"""Members of a start record that the assignment does not read."""


def sit(
    place: SessionFolder, protocol: Protocol, *, complete: bool, drawn_as: int | None = None
) -> tuple[int, SessionLog]:
    """Record a session as far as the assignment reads it; return its turn and its open log."""
    drawn_as = drawn_as or place.session
    turn, _ = assign_turn(place, protocol, drawn_as)
    schedule = Schedule.draw(protocol, place.participant, 1, drawn_as, given=turn)
    about = {"mode": place.mode, "protocol": place.protocol}
    facts = {**about, "participant": place.participant, "session": place.session, "seed": 1, **UNREAD}
    log = SessionLog.create(place.log, "start", **facts, schedule={**schedule.as_dict(), "n_trials": int(not complete)})
    return turn.number, log


def test_participants_get_consecutive_turns(tmp_path: Path) -> None:
    """Two orders in two placements: four turns, then the first again, for any participant ids."""
    turns = []
    for name in ("zoe", "p99", "a1", "ben", "c3", "dan"):
        turn, log = sit(place_of(tmp_path, name), FOUR, complete=True)
        log.close()
        turns.append(turn)
    assert turns == [0, 1, 2, 3, 0, 1]


def test_a_gap_left_by_a_dropout_is_filled_next(tmp_path: Path) -> None:
    """The second of four drops out: the fifth gets the second's turn, the sixth starts the next round."""
    turns = []
    for number in range(1, 7):
        turn, log = sit(place_of(tmp_path, f"p{number}"), FOUR, complete=number != 2)
        log.close()
        turns.append(turn)
    assert turns == [0, 1, 2, 3, 1, 0]


def test_turns_of_former_orders_are_counted_by_the_rows_that_they_had(tmp_path: Path) -> None:
    """Turn 1 of three repetitions began in row 3 of a Latin square, where turn 3 begins now."""
    protocol = changed(order="latin_square", repetitions=3, max_same_pair_running=None)
    place, turn = place_of(tmp_path, "p1"), Turn(1, "given")
    drawn = Schedule.draw(protocol, "p1", 1, given=turn, algorithm=FORMER_ALGORITHM).as_dict() | {"n_trials": 0}
    facts = {"mode": place.mode, "protocol": place.protocol, "participant": "p1", "session": 1, "seed": 1, **UNREAD}
    SessionLog.create(place.log, "start", **facts, schedule=drawn).close()
    assert assign_turn(place_of(tmp_path, "p2"), protocol, 1)[1]["filled"] == {"3": 1}


def test_turns_are_balanced_within_a_group(tmp_path: Path) -> None:
    """Participants of another group do not count."""
    for number in (1, 2):
        place = place_of(tmp_path, f"p{number}")
        turn, _ = assign_turn(place, FOUR, 1, "near")
        assert turn.number == number - 1
        drawn = Schedule.draw(FOUR, place.participant, 1, given=turn).as_dict() | {"group": "near", "n_trials": 0}
        facts = {"mode": place.mode, "protocol": place.protocol, "participant": place.participant, "session": 1}
        SessionLog.create(place.log, "start", **facts, seed=1, schedule=drawn).close()
    turns = [assign_turn(place_of(tmp_path, "p3"), FOUR, 1, group)[0].number for group in ("near", "far")]
    assert turns == [2, 0]


def test_the_gap_counts_from_the_last_line_of_the_previous_session(tmp_path: Path) -> None:
    """Even if that is its first, as in a session killed at its start."""
    _, log = sit(place_of(tmp_path, "p1"), FOUR, complete=True)
    log.close()
    ended = datetime.fromisoformat(read_session(log.path).events[-1]["time"])
    kind = SimpleNamespace(name="test", min_gap_days=1.0)
    protocol: Any = SimpleNamespace(schedule=SimpleNamespace(kind_of=lambda session: kind))
    place, day = place_of(tmp_path, "p1", 2), timedelta(days=1)
    assert not is_early(place, protocol, 2, ended + day)
    assert "min_gap_days: 1 (schedule.sessions), so it may begin from" in is_early(
        place, protocol, 2, ended + day - timedelta(milliseconds=1)
    )


def test_a_running_session_fills_its_turn(tmp_path: Path) -> None:
    """Its log is locked by its process; without the process it is a dropout."""
    first, log = sit(place_of(tmp_path, "p1"), FOUR, complete=False)
    beside, balance = assign_turn(place_of(tmp_path, "p2"), FOUR, 1)
    assert (first, beside.number, balance["filled"]) == (0, 1, {"0": 1})
    log.close()
    _, after = assign_turn(place_of(tmp_path, "p2"), FOUR, 1)
    assert (after["filled"], after["left_incomplete"]) == ({}, {"0": 1})


def test_an_incomplete_session_breaks_ties_between_turns(tmp_path: Path) -> None:
    """It may still be resumed, so among equally filled turns its turn comes last."""
    _, log = sit(place_of(tmp_path, "p1"), FOUR, complete=False)
    log.close()
    assert [assign_turn(place_of(tmp_path, name), FOUR, 1)[0].number for name in ("p2", "p3")] == [1, 1]


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.booleans(), min_size=1, max_size=24), st.integers(0, 10**9))
def test_turns_stay_balanced_despite_dropouts(tmp_path: Path, complete: list[bool], study: int) -> None:
    """After every participant the numbers of completed sessions per turn differ by at most one."""
    results = tmp_path / f"{study}-{len(complete)}-{sum(complete)}-{len(list(tmp_path.iterdir()))}"
    filled = Counter(dict.fromkeys(range(4), 0))
    for number, completed in enumerate(complete, start=1):
        turn, log = sit(place_of(results, f"p{number}"), FOUR, complete=completed)
        log.close()
        filled[turn] += completed
        assert max(filled.values()) - min(filled.values()) <= 1


def test_sessions_of_one_participant_have_consecutive_turns(tmp_path: Path) -> None:
    """The second session has the turn after the first, and a participant counts once for others."""
    first, log = sit(place_of(tmp_path, "p1"), FOUR, complete=True)
    log.close()
    other, log = sit(place_of(tmp_path, "p2"), FOUR, complete=True)
    log.close()
    second, log = sit(place_of(tmp_path, "p1", 2), FOUR, complete=True)
    log.close()
    assert (first, other, second) == (0, 1, 1)
    third, balance = assign_turn(place_of(tmp_path, "p3"), FOUR, 1)
    assert third.number == 2
    assert balance["filled"] == {"0": 1, "1": 1}
    again, _ = assign_turn(place_of(tmp_path, "p1", 3), FOUR, 3)
    assert (again.number, again.reason) == (2, "the participant's earlier sessions")


def test_sessions_drawn_by_number_count_with_their_own_turn(tmp_path: Path) -> None:
    """A study may change its rule: p02, assigned by number, has the second turn."""
    place = place_of(tmp_path, "p02")
    schedule = Schedule.draw(PAPER, "p02", 1)
    facts = {"participant": "p02", "session": 1, "seed": 1}
    SessionLog.create(place.log, "start", **facts, schedule={**schedule.as_dict(), "n_trials": 0}).close()
    assert Turn.of("p02", 1, 1).number == 1
    assert assign_turn(place_of(tmp_path, "p07"), FOUR, 1)[1]["filled"] == {"1": 1}


def test_a_given_turn_is_restored_from_the_record(tmp_path: Path) -> None:
    """With order, placement and reason; without a given turn the record has no such key."""
    turn, _ = assign_turn(place_of(tmp_path, "p9"), FOUR, 1)
    schedule = Schedule.draw(FOUR, "p9", 1, given=replace(turn, number=3))
    start = {"schedule": schedule.as_dict()}
    assert Schedule.draw(FOUR, "p9", 1, given=Turn.recorded(start)) == schedule
    assert schedule.finger_conditions_by == "least filled in the records"
    assert [block.finger_condition for block in schedule.blocks] == ["two_hands", "one_hand"]
    assert schedule.trials[0].condition.placement == "mirrored"
    assert Turn.recorded({"schedule": Schedule.draw(PAPER, "p9", 1).as_dict()}) is None


@pytest.mark.parametrize(
    ("changes", "period"),
    [
        ({}, 2),
        ({"placements": ("normal", "mirrored", "swapped")}, 6),
        ({"order": "by_pair", "max_same_pair_running": None}, 36),
        ({"order": "by_velocity", "max_same_pair_running": None}, 16),
        ({"order": "latin_square", "max_same_pair_running": None}, 144),
        ({"counterbalance_finger_conditions": False}, 1),
    ],
)
def test_turns_repeat_after_their_period_and_not_before(changes: dict[str, Any], period: int) -> None:
    """Orders of finger conditions, placements and rows, drawn for two periods."""
    protocol = changed(**changes)
    assert Turn.period(protocol) == period
    drawn = [Schedule.draw(protocol, f"p{n}", 1) for n in range(1, 2 * period + 1)]

    def told(schedule: Any) -> Any:
        # Of a block, only what does not depend on the participant's own stream.
        key = {"by_pair": "zones", "by_velocity": "velocity_mm_s"}.get(protocol.schedule.order)
        rows = []
        for block in schedule.blocks:
            cells = [trial.condition for trial in block.trials]
            if protocol.schedule.order == "latin_square":
                rows.append([(cell.zones, cell.velocity_mm_s) for cell in cells])
            elif key is not None:
                rows.append(list(dict.fromkeys(getattr(cell, key) for cell in cells)))
        return [block.finger_condition for block in schedule.blocks], schedule.trials[0].condition.placement, rows

    kinds = [told(schedule) for schedule in drawn]
    assert kinds[:period] == kinds[period:]
    assert not any(
        kinds[:shorter] * (period // shorter) == kinds[:period] for shorter in range(1, period) if period % shorter == 0
    )


def test_the_next_session_is_the_next_free_number(tmp_path: Path) -> None:
    """The first, then the second of two; after that none, and an incomplete one must be resumed."""
    protocol = changed(sessions=2)
    place = place_of(tmp_path, "p1")
    for number in (1, 2):
        following, drawn_as = next_session(place, protocol.schedule.sessions)
        assert (following.session, drawn_as) == (number, number)
        sit(following, protocol, complete=True)[1].close()
    with pytest.raises(RecordError, match="has had all 2 sessions of the protocol.*--session 3"):
        next_session(place, protocol.schedule.sessions)
    other = place_of(tmp_path, "p2")
    with sit(other, protocol, complete=False)[1], pytest.raises(RecordError, match="another program is running this"):
        next_session(other, protocol.schedule.sessions)
    with pytest.raises(RecordError, match="exists already and is not complete; continue it with `modaltouch resume"):
        next_session(other, protocol.schedule.sessions)


def test_a_restarted_session_counts_once(tmp_path: Path) -> None:
    """Session 1 was restarted as 2: the next is number 3 in its folder and the participant's second."""
    place = place_of(tmp_path, "p1")
    _, log = sit(place, FOUR, complete=False)
    log.append("closed", begun_anew_as=2)
    log.close()
    sit(place_of(tmp_path, "p1", 2), FOUR, complete=True, drawn_as=1)[1].close()
    following, drawn_as = next_session(place, 2)
    assert (following.session, drawn_as) == (3, 2)


def test_completeness_follows_from_the_record_as_in_the_study(tmp_path: Path) -> None:
    """A complete stop, an incomplete one, a kill after the last answer, a torn last line, and a changed line."""
    logs = {}
    for name, complete in (("done", True), ("left", False), ("killed", True), ("torn", True), ("spoilt", True)):
        _, log = sit(place_of(tmp_path, name), FOUR, complete=complete)
        if name in ("done", "left", "spoilt"):
            log.append("stop", reason="finished", complete=complete)
        log.close()
        logs[name] = log.path
    with logs["torn"].open("ab") as file:
        file.write(b'{"n":2,"event":"st')
    logs["spoilt"].write_bytes(logs["spoilt"].read_bytes().replace(b'"session":1', b'"session": 1', 1))
    _, seen = assign_turn(place_of(tmp_path, "new"), FOUR, 1)
    assert sum(seen["filled"].values()) == 3
    assert sum(seen["left_incomplete"].values()) == 2
