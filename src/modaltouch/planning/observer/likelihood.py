"""How likely recorded answers are for an observer, the population integrated out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from modaltouch.planning.observer.population import Observer

FloatArray = NDArray[np.float64]

N_NODES = 512
"""Places of the population at which it is integrated."""

_LEAST_SHARE = 1e-9


@dataclass(frozen=True, eq=False)
class RecordedAnswers:
    """Answers to fit.

    Attributes
    ----------
    counts : (n_participants, n_cells, 3) array of int
        How often each participant answered left, both and right in each cell, as the beam has them.
    speeds : (n_cells, 2) array
        What the left and the right finger feel in each cell [m/s].
    finger_conditions : tuple of str
        Finger condition of each cell.
    facing : (n_participants,) array
        1, or -1 for participants who sat at the beam turned end to end.
    """

    counts: NDArray[np.int64]
    speeds: FloatArray
    finger_conditions: tuple[str, ...]
    facing: FloatArray

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return the answers of the same participants to several stimuli, cell after cell.

        Parameters
        ----------
        parts : sequence of RecordedAnswers
            The answers to each stimulus; participants in one order.

        Raises
        ------
        ValueError
            If the participants are not the same.
        """
        if any(not np.array_equal(part.facing, parts[0].facing) for part in parts):
            raise ValueError(
                f"answers of {', '.join(str(part.facing.size) for part in parts)} participants, or of others, do not "
                "join: give those of the same ones to each stimulus"
            )
        return cls(
            counts=np.concatenate([part.counts for part in parts], axis=1),
            speeds=np.concatenate([part.speeds for part in parts]),
            finger_conditions=tuple(name for part in parts for name in part.finger_conditions),
            facing=parts[0].facing,
        )


def log_likelihood(observer: Observer, recorded: RecordedAnswers) -> float:
    """Return the logarithm of the chance of recorded answers, the population integrated out."""
    crowd = observer.crowd_at(_grid())
    total = 0.0
    for side in np.unique(recorded.facing):
        left, right = crowd.shares(recorded.speeds, recorded.finger_conditions, side)
        shares = np.stack([left, 1 - left - right, right], axis=-1).reshape(N_NODES, -1)
        own = recorded.counts[recorded.facing == side].reshape(-1, shares.shape[1])
        # In one thread: the product is small, and every process gets the same sums.
        logs = np.einsum("pc,nc->pn", own.astype(float), np.log(np.maximum(shares, _LEAST_SHARE)))
        top = logs.max(axis=1, keepdims=True)
        total += float((top[:, 0] + np.log(np.exp(logs - top).mean(axis=1))).sum())
    return total


@lru_cache(maxsize=1)
def _grid() -> FloatArray:
    """Return places of the population, (5, N_NODES) array of normal deviates; paces do not matter."""
    from scipy.special import ndtri

    # The generalised golden ratio of four dimensions: points that fill the cube evenly (Roberts 2018).
    ratio = 1.0
    for _ in range(50):
        ratio = (1 + ratio) ** (1 / 5)
    steps = ratio ** -np.arange(1.0, 5.0)
    cube = (0.5 + steps[:, None] * np.arange(1, N_NODES + 1)) % 1
    return np.concatenate([ndtri(cube), np.zeros((1, N_NODES))])
