"""A psychometric function fitted to the answers of one run, or the reason why these answers give no threshold.

The probability of success at a level x [dB re 1 mm/s] is g + (1 - g - l) Phi((x - m) / s): m is the threshold, halfway
between guessing and lapsing, s the spread, g the guess rate and l the lapse rate. Everything is read off the
likelihood on a grid, so nothing diverges where answers are separated; intervals are those of the profile likelihood,
all levels whose best fit is within 1.92 of the best of all.

References
----------
Wichmann and Hill, Perception & Psychophysics 63 (2001) 1293-1313 (the function; lapses held to a small range).
Venzon and Moolgavkar, J. R. Stat. Soc. C 37 (1988) 87-94 (profile likelihood intervals).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
    def around(cls, levels: FloatArray, guess_rate: ArrayLike, most_lapse: float, *, fits_guesses: bool) -> Self:
        """Return a grid for some levels [dB re 1 mm/s].

        Parameters
        ----------
        levels : array
            The levels that were presented.
        guess_rate : float or array
            The guess rates, unless catch trials tell of them [1].
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
            else np.atleast_1d(np.asarray(guess_rate, dtype=float)),
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


DROP = 1.920729
"""Half the 95 % point of chi-squared with one degree of freedom."""


@dataclass(frozen=True)
class ThresholdEstimate:
    """A number with its interval; a bound is None where the answers set none.

    Attributes
    ----------
    value : float
        The likeliest value.
    low, high : float or None
        95 % interval by profile likelihood.
    """

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Psychometric:
    """What the answers of a run tell of a psychometric function.

    Attributes
    ----------
    n_trials, n_successes : int
        Trials with a stimulus, and successes among them.
    n_catch, n_false : int
        Catch trials, and successes among them.
    threshold, spread : ThresholdEstimate or None
        Threshold and spread [dB re 1 mm/s, dB]; None where these answers tell none.
    guess_rate, lapse_rate : float
        The likeliest asymptotes [1].
    why_not : str
        Why no threshold can be told; empty where it can.
    is_uncertain : bool
        Whether a constant chance explains the answers as well as the function does.
    """

    n_trials: int
    n_successes: int
    n_catch: int
    n_false: int
    threshold: ThresholdEstimate | None
    spread: ThresholdEstimate | None
    guess_rate: float
    lapse_rate: float
    why_not: str = ""
    is_uncertain: bool = False

    @property
    def slope(self) -> float | None:
        """Rise of the function at the threshold [1/dB]; None where the answers fit a step as well."""
        if self.spread is None or self.spread.low is None:
            return None
        return (1 - self.guess_rate - self.lapse_rate) / (self.spread.value * math.sqrt(2 * math.pi))

    def probability(self, levels: FloatArray) -> FloatArray | None:
        """Return the fitted probability of success at levels [dB re 1 mm/s]; None where there is no fit."""
        if self.threshold is None or self.spread is None:
            return None
        from scipy.special import ndtr

        rising = ndtr((levels - self.threshold.value) / self.spread.value)
        return np.asarray(self.guess_rate + (1 - self.guess_rate - self.lapse_rate) * rising)


def fit_psychometric(
    levels: Sequence[float],
    successes: Sequence[bool],
    *,
    guess_rate: ArrayLike,
    most_lapse: float,
    catches: Sequence[bool] = (),
    unit: str = "mm/s",
    flat_rate: float | None = None,
) -> Psychometric:
    """Return the psychometric function of a run.

    Answers that a constant share of successes explains as well give no threshold, unless that share is known: adaptive
    runs of a forced choice gather where the function is flat, and one in four of a wide spread would be lost.

    Parameters
    ----------
    levels : sequence of float
        Level of each trial with a stimulus [dB re 1 mm/s, or another unit].
    successes : sequence of bool
        Whether each of them was a success.
    guess_rate : float or array
        Share of successes where nothing is felt, or those that are tried [1]; fitted where there are catch trials.
    most_lapse : float
        Largest lapse rate that a fit may find [1].
    catches : sequence of bool
        Whether each catch trial was a success.
    unit : str
        Unit of the levels, in words.
    flat_rate : float, optional
        Share of successes where the level is ignored, as far as it is known [1].

    Raises
    ------
    ValueError
        If there is no trial, or levels and successes differ in number.
    """
    x, hits, tries = _counted(levels, successes)
    grid, n_false = Grid.around(x, guess_rate, most_lapse, fits_guesses=bool(len(catches))), sum(catches)
    likelihood = grid.log_likelihood(x, hits, tries) + grid.log_guesses(n_false, len(catches))
    best = np.unravel_index(int(likelihood.argmax()), likelihood.shape)
    threshold = _estimate(grid.thresholds, likelihood.max(axis=(1, 2, 3)))
    spread = _estimate(grid.spreads, likelihood.max(axis=(0, 2, 3)))
    constant = _log_binomial(hits.sum(), tries.sum()) + _log_binomial(n_false, len(catches))
    gain, known = float(likelihood.max()) - constant, 0.0
    if flat_rate is not None:
        known = constant - hits.sum() * math.log(flat_rate) - (tries - hits).sum() * math.log1p(-flat_rate)
    why = _why_not(x, hits, tries, gain + known, threshold.value, unit)
    return Psychometric(
        n_trials=int(tries.sum()),
        n_successes=int(hits.sum()),
        n_catch=len(catches),
        n_false=n_false,
        threshold=None if why else threshold,
        spread=None if why else spread,
        guess_rate=float(grid.guesses[best[3]]),
        lapse_rate=float(grid.lapses[best[2]]),
        why_not=why,
        is_uncertain=bool(not why and gain < DROP),
    )


def _counted(levels: Sequence[float], successes: Sequence[bool]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the levels that there were, and the successes and trials at each."""
    if not levels or len(levels) != len(successes):
        raise ValueError(f"given {len(levels)} levels and {len(successes)} answers; give one answer to each level")
    x, places = np.unique(np.round(levels, 6), return_inverse=True)
    hits = np.bincount(places, weights=np.asarray(successes, dtype=float))
    return x, hits.astype(np.float64), np.bincount(places).astype(np.float64)


def _why_not(x: FloatArray, hits: FloatArray, tries: FloatArray, gain: float, threshold: float, unit: str) -> str:
    """Return why these answers give no threshold; empty where they do."""
    lowest, highest = (f"{10 ** (level / 20):.3g} {unit}" for level in (x[0], x[-1]))
    reasons = (
        (
            hits.sum() == tries.sum(),
            f"every answer was a success: the threshold lies below {lowest}, or there is none",
        ),
        (hits.sum() == 0, f"no answer was a success: the threshold lies above {highest}, or there is none"),
        (gain < DROP, "successes do not depend on the level: a constant chance explains the answers as well"),
        (threshold < x[0], f"the threshold lies below the levels that were presented, from {lowest}"),
        (threshold > x[-1], f"the threshold lies above the levels that were presented, up to {highest}"),
    )
    return next((reason for holds, reason in reasons if holds), "")


def _estimate(values: FloatArray, profile: FloatArray) -> ThresholdEstimate:
    """Return where a profile is highest, between the points of the grid, and where it has fallen by `DROP`."""
    place, bound = int(profile.argmax()), float(profile.max()) - DROP
    value = float(values[place])
    if 0 < place < len(values) - 1:
        before, here, after = (float(each) for each in profile[place - 1 : place + 2])
        curve = before - 2 * here + after
        shift = 0.5 * (before - after) / curve if curve < 0 else 0.0
        value += shift * float(values[place + 1] - values[place])
    within = np.flatnonzero(profile >= bound)
    low = _crossing(values, profile, int(within[0]), -1, bound)
    high = _crossing(values, profile, int(within[-1]), 1, bound)
    return ThresholdEstimate(value, low, high)


def _crossing(values: FloatArray, profile: FloatArray, inside: int, step: int, bound: float) -> float | None:
    outside = inside + step
    if not 0 <= outside < len(values):
        return None
    share = (profile[inside] - bound) / (profile[inside] - profile[outside])
    return float(values[inside] + share * (values[outside] - values[inside]))


def _log_binomial(hits: float, tries: float) -> float:
    """Return the highest log likelihood of a constant probability."""
    return sum(n * math.log(n / tries) for n in (hits, tries - hits) if n > 0)
