"""The likelihood of a psychometric function over a grid of its four parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

STEP = 0.25
"""Distance of the thresholds [dB]."""

BEYOND = 20.0
"""How far beyond the levels presented a threshold is looked for [dB]."""

_LEAST = 1e-9
"""No outcome is impossible: probabilities are kept this far from 0 and 1."""


@dataclass(frozen=True)
class Grid:
    """Values of the parameters that are compared.

    Attributes
    ----------
    thresholds, spreads : arrays
        [dB re 1 mm/s], [dB].
    lapses, guesses : arrays
        [1].
    """

    thresholds: FloatArray
    spreads: FloatArray
    lapses: FloatArray
    guesses: FloatArray

    @classmethod
    def around(cls, levels: FloatArray, guess_rate: float, most_lapse: float, *, fits_guesses: bool) -> Self:
        """Return a grid for some levels [dB re 1 mm/s].

        Parameters
        ----------
        levels : array
            The levels that were presented.
        guess_rate : float
            The only guess rate, unless guesses are fitted [1].
        most_lapse : float
            Largest lapse rate [1].
        fits_guesses : bool
            Whether catch trials tell of guesses.
        """
        return cls(
            thresholds=np.arange(levels.min() - BEYOND, levels.max() + BEYOND + STEP / 2, STEP),
            spreads=np.geomspace(0.5, 20.0, 28),
            lapses=np.linspace(0.0, most_lapse, 4) if most_lapse else np.zeros(1),
            guesses=np.array([0.0, 0.01, 0.025, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])
            if fits_guesses
            else np.array([guess_rate]),
        )

    def log_likelihood(self, levels: FloatArray, hits: FloatArray, tries: FloatArray) -> FloatArray:
        """Return the log likelihood of successes, (n_thresholds, n_spreads, n_lapses, n_guesses) array.

        Parameters
        ----------
        levels, hits, tries : (n_levels,) arrays
            Levels [dB re 1 mm/s], successes, and trials.
        """
        from scipy.special import ndtr

        rising = ndtr((levels - self.thresholds[:, None, None]) / self.spreads[:, None])
        total = np.empty((*rising.shape[:2], len(self.lapses), len(self.guesses)))
        for i, lapse in enumerate(self.lapses):
            for j, guess in enumerate(self.guesses):
                p = np.clip(guess + (1 - guess - lapse) * rising, _LEAST, 1 - _LEAST)
                total[:, :, i, j] = np.log(p) @ hits + np.log1p(-p) @ (tries - hits)
        return total

    def log_guesses(self, n_false: int, n_catch: int) -> FloatArray:
        """Return the log likelihood of successes on catch trials, (n_guesses,) array."""
        p = np.clip(self.guesses, _LEAST, 1 - _LEAST)
        return np.asarray(n_false * np.log(p) + (n_catch - n_false) * np.log1p(-p)) if n_catch else np.zeros_like(p)
