"""Independent random streams, one per purpose, so that an additional draw from one does not change the others.

A stream is NumPy's PCG64 seeded by a SeedSequence of (study seed, participant, session, purpose). Only its raw 64-bit
words are used: an order must be reproducible years later, and NumPy guarantees these words, but not its distributions,
to be the same in every version.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Self, TypeVar

import numpy as np

_WORDS = "raw words of numpy PCG64, seeded by SeedSequence(seed, participant, session, purpose)"
ALGORITHM = f"modaltouch order 2: {_WORDS}"
"""Name and version of the algorithm that derives an order from a seed, for the record."""
FORMER_ALGORITHM = f"modaltouch order 1: {_WORDS}"
"""The one of older records, with other rows of a Latin square with several repetitions."""

Item = TypeVar("Item")


def key_of(name: str) -> int:
    """Return the integer that represents a participant or a purpose in a seed: the SHA-256 of its name."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest(), "big")


def seed_sequence(seed: int, participant: str, session: int, purpose: str) -> np.random.SeedSequence:
    """Return the seed of one stream."""
    return np.random.SeedSequence([seed, key_of(participant), session, key_of(purpose)])


@dataclass(frozen=True, slots=True)
class Cuts:
    """Increasing integers that divide a range up to the last, and numbers of words and of spare bits of a draw.

    Of each total, the leading word, aligned as in a draw, is nearly always enough to locate a drawn number.
    """

    totals: list[int]
    n_words: int
    n_spare: int
    words: list[int]

    @classmethod
    def of(cls, totals: list[int]) -> Self:
        """Return the cuts at the given totals."""
        n_bits = (totals[-1] - 1).bit_length()
        n_words = (n_bits + 63) // 64
        n_spare = 64 * n_words - n_bits
        return cls(totals, n_words, n_spare, [total << n_spare >> max(0, 64 * n_words - 64) for total in totals])


class Stream:
    """Uniform integers and orders from one stream, seeded as by `seed_sequence`."""

    def __init__(self, seed: int, participant: str, session: int, purpose: str) -> None:
        self._source = np.random.PCG64(seed_sequence(seed, participant, session, purpose))
        # A view of NumPy's buffer, since a list of all words would take longer than most draws.
        self._words, self._read, self._end = self._source.random_raw(0).data, 0, 0

    def below(self, bound: int) -> int:
        """Return an exactly uniform integer from 0 to `bound` - 1, for bounds of any size."""
        n_bits = (bound - 1).bit_length()
        n_words = (n_bits + 63) // 64
        n_spare = 64 * n_words - n_bits
        while True:
            if self._read + n_words > self._end:
                self._refill(n_words)
            read = self._read
            self._read = read + n_words
            value = (self._words[read] if n_words == 1 else self._number(read)) >> n_spare
            if value < bound:
                return value

    def among(self, cuts: Cuts) -> int:
        """Return the place of a uniform integer among totals, like `bisect_right(totals, below(totals[-1]))`."""
        n_words, words = cuts.n_words, cuts.words
        while True:
            if self._read + n_words > self._end:
                self._refill(n_words)
            read = self._read
            self._read = read + n_words
            word = self._words[read] if n_words else 0
            place = bisect_right(words, word)
            if place and word == words[place - 1]:  # the words after the first decide
                place = bisect_right(cuts.totals, self._number(read) >> cuts.n_spare)
            if place < len(words):
                return place

    def _refill(self, n_words: int) -> None:
        """Provide at least `n_words` unread words."""
        self._words = np.concatenate([self._words[self._read :], self._source.random_raw(4096 + n_words)]).data
        self._read, self._end = 0, len(self._words)

    def _number(self, begin: int) -> int:
        """Return the integer formed by the words from `begin` to the last one read."""
        value = 0
        for word in self._words[begin : self._read]:
            value = value << 64 | word
        return value

    def shuffled(self, items: Iterable[Item]) -> list[Item]:
        """Return the items in uniformly random order (Fisher-Yates)."""
        order = list(items)
        for last in range(len(order) - 1, 0, -1):
            other = self.below(last + 1)
            order[last], order[other] = order[other], order[last]
        return order

    def chosen(self, items: Iterable[Item], n_items: int) -> list[Item]:
        """Return `n_items` of the items, drawn uniformly without replacement."""
        return self.shuffled(items)[:n_items]

    def weighted(self, weights: Sequence[int]) -> int:
        """Return an index drawn with probabilities exactly proportional to integer weights."""
        totals = list(accumulate(weights))
        return bisect_right(totals, self.below(totals[-1]))
