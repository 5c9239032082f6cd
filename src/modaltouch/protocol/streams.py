"""A random stream of its own for each purpose, so that a draw added to one shifts no other.

A stream is numpy's PCG64 seeded by a SeedSequence of (study seed, participant, session, purpose). Only its raw
64-bit words are used: numpy promises these, and not what its distributions make of them, to stay the same in
every version, and an order must be recomputable years later.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import TypeVar

import numpy as np

ALGORITHM = "modaltouch order 1: raw words of numpy PCG64, seeded by SeedSequence(seed, participant, session, purpose)"
"""Name and version of what turns a seed into an order, for the record."""

Item = TypeVar("Item")


def key_of(name: str) -> int:
    """Return the number that stands for a participant or a purpose: its SHA-256."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest(), "big")


def seed_sequence(seed: int, participant: str, session: int, purpose: str) -> np.random.SeedSequence:
    """Return the seed of one stream.

    Parameters
    ----------
    seed : int
        Seed of the study, 0 or above.
    participant : str
        Identifier of the participant.
    session : int
        Number of the session, from 1.
    purpose : str
        What the stream is for.
    """
    return np.random.SeedSequence([seed, key_of(participant), session, key_of(purpose)])


class Stream:
    """Uniform whole numbers and orders from one stream.

    Parameters
    ----------
    seed, participant, session, purpose
        As `seed_sequence` takes them.
    """

    def __init__(self, seed: int, participant: str, session: int, purpose: str) -> None:
        self._source = np.random.PCG64(seed_sequence(seed, participant, session, purpose))
        self._bytes, self._read = b"", 0

    def below(self, bound: int) -> int:
        """Return a uniform whole number from 0 to `bound` - 1, exactly, however large the bound."""
        n_bits = (bound - 1).bit_length()
        n_words = (n_bits + 63) // 64
        while True:
            end = self._read + 8 * n_words
            if end > len(self._bytes):
                fresh = self._source.random_raw(1024 + n_words).astype(">u8").tobytes()
                self._bytes, self._read, end = self._bytes[self._read :] + fresh, 0, 8 * n_words
            value = int.from_bytes(self._bytes[self._read : end]) >> 64 * n_words - n_bits
            self._read = end
            if value < bound:
                return value

    def shuffled(self, items: Iterable[Item]) -> list[Item]:
        """Return the items in an order drawn uniformly among all of them (Fisher-Yates)."""
        order = list(items)
        for last in range(len(order) - 1, 0, -1):
            other = self.below(last + 1)
            order[last], order[other] = order[other], order[last]
        return order

    def chosen(self, items: Iterable[Item], n_items: int) -> list[Item]:
        """Return some of the items, drawn uniformly among all choices of so many."""
        return self.shuffled(items)[:n_items]

    def weighted(self, weights: Sequence[int]) -> int:
        """Return an index drawn with whole-number weights, exactly."""
        totals = list(accumulate(weights))
        return bisect_right(totals, self.below(totals[-1]))
