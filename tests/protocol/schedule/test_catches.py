"""Positions of catch trials, and limits on runs with catch trials."""

import pytest

from modaltouch.protocol.catch_trials import place_catches
from modaltouch.protocol.schedule_section import NoOrderError
from modaltouch.protocol.streams import Stream

ORDER = [("A", "C"), ("B", "D"), ("A", "C"), ("A", "C"), ("C", "E"), ("B", "D")] * 4


@pytest.mark.parametrize("seed", range(20))
def test_limits_that_cannot_bind_do_not_change_the_positions(seed):
    """Runs in this order have at most seven trials, including the next block's and the catch trials."""
    placed = [
        place_catches(ORDER, 5, limit, Stream(seed, "p01", 1, "catch trials within one_hand"))
        for limit in (7, 8, 100, 1000)
    ]
    assert placed[1:] == placed[:-1]


@pytest.mark.timeout(60)
def test_a_huge_limit_takes_no_longer():
    """A limit of 608,616, found by fuzzing, once took minutes."""
    place_catches(ORDER, 5, 608_616, Stream(1, "p01", 1, "catch trials within one_hand"))


def test_a_catch_trial_may_follow_every_trial():
    """As many catch trials as trials fit if pairs alternate and runs of two are allowed."""
    order = [("A", "C"), ("B", "D")] * 3
    placed = place_catches(order, 6, 2, Stream(1, "p01", 1, "catch trials within one_hand"), own_pair=True)
    assert placed == list(enumerate(order))


def test_a_limit_that_catch_trials_cannot_keep_is_refused():
    """A trial and a catch trial of the same pair form a run of two."""
    said = "schedule.max_same_pair_running: given 1, but 2 catch trials cannot be spread over 24 trials"
    with pytest.raises(NoOrderError, match=said):
        place_catches(ORDER, 2, 1, Stream(1, "p01", 1, "catch trials within one_hand"), own_pair=True)
