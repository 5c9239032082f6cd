"""Samples out of a period of noise, faded in and out; pure, so that it is heard in tests without a device."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Playback:
    """Goes round a period of noise for ever.

    Parameters
    ----------
    period : (n_samples,) array
        One period, at its full level.
    n_fade : int
        Samples that a fade takes.
    """

    def __init__(self, period: NDArray[np.float32], n_fade: int) -> None:
        self._period = period
        self._n_fade = max(n_fade, 1)
        self._place = 0
        self._way = self._target = 0

    def fade_in(self) -> None:
        """Let what follows grow to its full level."""
        self._target = self._n_fade

    def fade_out(self) -> None:
        """Let what follows fall silent."""
        self._target = 0

    @property
    def is_full(self) -> bool:
        """Whether the noise is at its full level."""
        return self._way == self._target == self._n_fade

    @property
    def is_silent(self) -> bool:
        """Whether nothing is heard any more."""
        return self._way == self._target == 0

    def fill(self, out: NDArray[np.float32]) -> None:
        """Write what comes next into a block.

        Parameters
        ----------
        out : (n_samples, n_channels) array
            Where it goes; every channel gets the same.
        """
        n = len(out)
        if self.is_silent:
            out.fill(0)
            return
        samples = np.take(self._period, np.arange(self._place, self._place + n), mode="wrap")
        self._place = (self._place + n) % len(self._period)
        if self._way != self._target:
            ahead = np.arange(1, n + 1) * (1 if self._target > self._way else -1)
            way = np.clip(self._way + ahead, 0, self._n_fade)
            self._way = int(way[-1])
            # Along half a sine: neither end has a corner.
            samples = samples * np.sin(np.pi / 2 * way / self._n_fade).astype(np.float32) ** 2
        out[:] = samples[:, np.newaxis]
