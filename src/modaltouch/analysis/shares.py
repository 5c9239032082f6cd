"""Shares of an answer, with bounds for missing answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Shares:
    """Counts of one answer out of all answers given and scheduled; arrays of the same shape, levels last.

    Attributes
    ----------
    given : array of int
        Counts of this answer.
    answered : array of int
        Counts of all answers.
    asked : int
        Number of scheduled answers.
    """

    given: NDArray[np.int64]
    answered: NDArray[np.int64]
    asked: int

    @property
    def is_short(self) -> bool:
        """Whether any answer is missing."""
        return bool((self.answered < self.asked).any())

    def at(self, place: int | list[int], axis: int) -> Shares:
        """Select along an axis."""
        return Shares(self.given.take(place, axis), self.answered.take(place, axis), self.asked)

    def joined(self, n_after: int) -> Shares:
        """Flatten the axes of finger conditions and pairs (the last two before `n_after` axes) to one axis of tests."""
        after = self.given.ndim - n_after
        shape = (*self.given.shape[: after - 2], -1, *self.given.shape[after:])
        return Shares(self.given.reshape(shape), self.answered.reshape(shape), self.asked)

    @classmethod
    def stacked(cls, parts: Sequence[Shares]) -> Shares:
        """Concatenate several along the axis of tests."""
        given, answered = (np.concatenate([getattr(p, name) for p in parts], axis=-3) for name in ("given", "answered"))
        return cls(given, answered, parts[0].asked)

    @property
    def known(self) -> NDArray[np.float64]:
        """Share of the answers given [1]; NaN without any."""
        nothing = np.full(self.given.shape, np.nan)
        return np.asarray(np.divide(self.given, self.answered, out=nothing, where=self.answered > 0))

    @property
    def mean(self) -> NDArray[np.float64]:
        """Mean share over the levels with answers [1]; NaN without any."""
        return mean_of_known(self.known)

    @property
    def least(self) -> NDArray[np.float64]:
        """Share if all missing answers were other ones [1]."""
        return np.asarray(self.given / self.asked)

    @property
    def most(self) -> NDArray[np.float64]:
        """Share if all missing answers were this one [1]."""
        return np.asarray((self.given + self.asked - self.answered) / self.asked)


def mean_of_known(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of the finite values along the last axis; NaN without any."""
    known = np.isfinite(values)
    # einsum is three times faster than sum for few values.
    n, total = np.einsum("...i->...", known.astype(float)), np.einsum("...i->...", np.where(known, values, 0.0))
    return np.asarray(np.divide(total, n, out=np.full(n.shape, np.nan), where=n > 0))
