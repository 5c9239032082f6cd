"""Where catch trials stand: a limit that cannot bind costs nothing and changes nothing."""

import pytest

from modaltouch.protocol.catches import place_catches
from modaltouch.protocol.streams import Stream

ORDER = [("A", "C"), ("B", "D"), ("A", "C"), ("A", "C"), ("C", "E"), ("B", "D")] * 4


@pytest.mark.parametrize("seed", range(20))
def test_every_limit_that_cannot_bind_places_alike(seed):
    """Three like trials running (two, and the next block's) and the catch trials between make at most seven."""
    placed = [
        place_catches(ORDER, 5, limit, Stream(seed, "p01", 1, "catch trials within one_hand"))
        for limit in (7, 8, 100, 1000)
    ]
    assert placed[1:] == placed[:-1]


@pytest.mark.timeout(60)
def test_a_limit_beyond_all_reason_takes_no_longer():
    """Found by spoilt protocols: a limit of 608,616 took minutes."""
    place_catches(ORDER, 5, 608_616, Stream(1, "p01", 1, "catch trials within one_hand"))
