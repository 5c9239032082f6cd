"""A psychometric function fitted to the answers of one run, or the reason why these answers give no threshold.

The probability of success at a level x [dB re 1 mm/s] is g + (1 - g - l) Phi((x - m) / s): m is the threshold, halfway
between guessing and lapsing, s the spread, g the guess rate and l the lapse rate. The likelihood is evaluated on a
grid, so nothing diverges if answers are separated. Intervals are the ends of the joint 95 % region of m and s, all
pairs whose greatest log likelihood is within 3.00 of the maximum: the levels of a run follow from its answers and its
most likely spread is too small, so that an interval of m alone, within 1.92, would miss the threshold too often.

References
----------
Wichmann and Hill, Perception & Psychophysics 63 (2001) 1293-1313 (the function; lapses held to a small range).
Venzon and Moolgavkar, J. R. Stat. Soc. C 37 (1988) 87-94 (profile likelihood; joint regions).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.intervals import DROP, REGION, Interval

FloatArray = NDArray[np.float64]

STEP = 0.25
"""Step of the grid of thresholds [dB]."""

BEYOND = 20.0
"""How far beyond the presented levels the grid of thresholds reaches [dB]."""

_LEAST = 1e-9
"""No outcome is impossible: probabilities are kept this far from 0 and 1."""

_SPREADS = np.geomspace(0.5, 20.0, 28)
_GUESSES = np.array([0.0, 0.01, 0.025, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])
"""Grids of spreads [dB] and, if there are catch trials, of guess rates [1]."""

_AT_ONCE = 4_000_000
"""Likelihoods in the largest temporary array."""


@dataclass(frozen=True)
class Psychometric:
    """The psychometric function fitted to the answers of a run.

    Attributes
    ----------
    n_trials, n_successes : int
        Trials with a stimulus, and successes among them.
    n_catch, n_false : int
        Catch trials, and successes among them.
    threshold, spread : Interval or None
        Threshold and spread [dB re 1 mm/s, dB]; None if the answers do not determine them.
    guess_rate, lapse_rate : float
        Most likely rates [1].
    why_not : str
        Why there is no threshold; empty if there is one.
    is_uncertain, is_step : bool
        Whether a constant probability, or the steepest function, explains the answers as well as the fitted function.
    """

    n_trials: int
    n_successes: int
    n_catch: int
    n_false: int
    threshold: Interval | None
    spread: Interval | None
    guess_rate: float
    lapse_rate: float
    why_not: str = ""
    is_uncertain: bool = False
    is_step: bool = False

    @property
    def slope(self) -> float | None:
        """Slope of the function at the threshold [1/dB]; None if a step fits the answers as well."""
        if self.spread is None or self.is_step:
            return None
        return (1 - self.guess_rate - self.lapse_rate) / float(self.spread.estimate * math.sqrt(2 * math.pi))

    def probability(self, levels: FloatArray) -> FloatArray | None:
        """Return the fitted probability of success at levels [dB re 1 mm/s]; None without a fit."""
        if self.threshold is None or self.spread is None:
            return None
        from scipy.special import ndtr

        rising = ndtr((levels - self.threshold.estimate) / self.spread.estimate)
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

    Answers that a constant probability explains as well give no threshold. If `flat_rate` is known, it is the only
    constant tried: adaptive forced-choice runs gather where the function is flat, and one in four with a wide spread
    would otherwise be lost.

    Parameters
    ----------
    levels : sequence of float
        Level of each trial with a stimulus [dB re 1 mm/s, or another unit].
    successes : sequence of bool
        Whether each of them was a success.
    guess_rate : float or array
        Probability of success if nothing is felt, or several to try [1]; with catch trials, it is fitted instead.
    most_lapse : float
        Largest lapse rate that a fit may find [1].
    catches : sequence of bool
        Whether each catch trial was a success.
    unit : str
        Unit of the levels, in words.
    flat_rate : float, optional
        Probability of success if the level is ignored, if known [1].

    Raises
    ------
    ValueError
        If there is no trial, or levels and successes differ in number.
    """
    x, hits, tries = _counted(levels, successes)
    n_catch, n_false = len(catches), sum(catches)
    fits = fit_counts(
        x, hits[np.newaxis], tries[np.newaxis], guess_rate=guess_rate, most_lapse=most_lapse, n_catch=n_catch,
        n_false=n_false, flat_rate=flat_rate,
    )  # fmt: skip
    why = _why_not(x, hits, tries, float(fits.settled[0]), float(fits.threshold.estimate[0]), unit)
    threshold, spread = (None if why else each[0].changed(float) for each in (fits.threshold, fits.spread))
    return Psychometric(
        n_trials=int(tries.sum()),
        n_successes=int(hits.sum()),
        n_catch=n_catch,
        n_false=n_false,
        threshold=threshold,
        spread=spread,
        guess_rate=float(fits.guess_rate[0]),
        lapse_rate=float(fits.lapse_rate[0]),
        why_not=why,
        is_uncertain=bool(not why and fits.gain[0] < DROP),
        is_step=bool(fits.is_step[0]),
    )


@dataclass(frozen=True, eq=False)
class Fits:
    """The fits of a batch of runs, arrays of shape (n_runs,).

    Attributes
    ----------
    threshold, spread : Interval
        [dB re 1 mm/s], [dB]; a bound is infinite if the answers do not determine it.
    guess_rate, lapse_rate : arrays
        Most likely rates [1].
    gain, settled : arrays
        Gain of log likelihood over a constant probability: the most likely one; and `flat_rate` instead, if known.
    is_told, is_step : arrays of bool
        Whether the answers determine a threshold, and whether the steepest function fits as well.
    """

    threshold: Interval
    spread: Interval
    guess_rate: FloatArray
    lapse_rate: FloatArray
    gain: FloatArray
    settled: FloatArray
    is_told: NDArray[np.bool_]
    is_step: NDArray[np.bool_]


def fit_counts(
    levels: FloatArray,
    hits: FloatArray,
    tries: FloatArray,
    *,
    guess_rate: ArrayLike,
    most_lapse: float,
    n_catch: int = 0,
    n_false: int = 0,
    flat_rate: float | None = None,
) -> Fits:
    """Return the fits of a batch of runs, whose levels are all or some of those given.

    Parameters
    ----------
    levels : (n_levels,) array
        Levels, increasing [dB].
    hits, tries : (n_runs, n_levels) arrays
        Successes and trials of each run.
    guess_rate, most_lapse, flat_rate
        As for `fit_psychometric`.
    n_catch, n_false : int
        Catch trials of each run, and successes among them.
    """
    thresholds = np.arange(levels[0] - BEYOND, levels[-1] + BEYOND + STEP / 2, STEP)
    guesses = _GUESSES if n_catch else np.atleast_1d(np.asarray(guess_rate, dtype=float))
    lapses = np.linspace(0.0, most_lapse, 4) if most_lapse else np.zeros(1)
    step = max(1, _AT_ONCE // (thresholds.size * _SPREADS.size))
    parts = [
        _profiles(levels, hits[k : k + step], tries[k : k + step], thresholds, lapses, guesses)
        for k in range(0, len(hits), step)
    ]
    by_threshold, by_spread, asymptotes = (
        np.concatenate(each, axis=1) + _log_chance(n_false, n_catch, guesses)[:, None, None]
        for each in zip(*parts, strict=True)
    )
    best = asymptotes.max(axis=(0, 2))
    n_hits, n = hits.sum(axis=-1), tries.sum(axis=-1)
    flat = _log_constant(n_hits, n) + _log_constant(np.array(float(n_false)), np.array(float(n_catch)))
    known = 0.0 if flat_rate is None else flat - n_hits * math.log(flat_rate) - (n - n_hits) * math.log1p(-flat_rate)
    of_spreads = by_spread.max(axis=0)
    threshold, spread = _located(thresholds, by_threshold.max(axis=0)), _located(_SPREADS, of_spreads)
    lowest = np.where(tries > 0, levels, np.inf).min(axis=-1)
    highest = np.where(tries > 0, levels, -np.inf).max(axis=-1)
    is_within = (lowest <= threshold.estimate) & (threshold.estimate <= highest)
    settled = best - flat + known
    return Fits(
        threshold,
        spread,
        guesses[asymptotes.max(axis=2).argmax(axis=0)],
        lapses[asymptotes.max(axis=0).argmax(axis=1)],
        best - flat,
        settled,
        (n_hits > 0) & (n_hits < n) & (settled >= DROP) & is_within,
        of_spreads[:, 0] >= best - DROP,
    )


def _profiles(
    levels: FloatArray,
    hits: FloatArray,
    tries: FloatArray,
    thresholds: FloatArray,
    lapses: FloatArray,
    guesses: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the highest log likelihood of each threshold, spread and lapse rate, by guess rate and run."""
    from scipy.special import ndtr

    rising = ndtr((levels - thresholds[:, None, None]) / _SPREADS[:, None])
    # A threshold is searched for around a run's own levels.
    lowest, highest = (np.where(tries > 0, levels, end) for end in (np.inf, -np.inf))
    inside = thresholds >= lowest.min(axis=-1)[:, None] - BEYOND - STEP / 4
    inside &= thresholds <= highest.max(axis=-1)[:, None] + BEYOND + STEP / 2
    by_threshold = np.full((guesses.size, len(hits), thresholds.size), -np.inf)
    by_spread = np.full((guesses.size, len(hits), _SPREADS.size), -np.inf)
    asymptotes = np.empty((guesses.size, len(hits), lapses.size))
    for i, guess in enumerate(guesses):
        for j, lapse in enumerate(lapses):
            p = np.clip(guess + (1 - guess - lapse) * rising, _LEAST, 1 - _LEAST).reshape(-1, levels.size).T
            found = (hits @ np.log(p) + (tries - hits) @ np.log1p(-p)).reshape(len(hits), -1, _SPREADS.size)
            found[~inside] = -np.inf
            of_spreads = found.max(axis=1)
            np.maximum(by_threshold[i], found.max(axis=2), out=by_threshold[i])
            np.maximum(by_spread[i], of_spreads, out=by_spread[i])
            asymptotes[i, :, j] = of_spreads.max(axis=1)
    return by_threshold, by_spread, asymptotes


def _log_chance(n_false: int, n_catch: int, guesses: FloatArray) -> FloatArray:
    """Return the log likelihood of successes on catch trials, for each guess rate."""
    p = np.clip(guesses, _LEAST, 1 - _LEAST)
    return np.asarray(n_false * np.log(p) + (n_catch - n_false) * np.log1p(-p))


def _counted(levels: Sequence[float], successes: Sequence[bool]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the distinct levels, and the successes and trials at each."""
    if not levels or len(levels) != len(successes):
        raise ValueError(f"given {len(levels)} levels and {len(successes)} answers; give one answer to each level")
    x, places = np.unique(np.round(levels, 6), return_inverse=True)
    hits = np.bincount(places, weights=np.asarray(successes, dtype=float))
    return x, hits.astype(np.float64), np.bincount(places).astype(np.float64)


def _why_not(x: FloatArray, hits: FloatArray, tries: FloatArray, gain: float, threshold: float, unit: str) -> str:
    """Return why these answers give no threshold; empty if they do."""
    lowest, highest = (f"{10 ** (level / 20):.3g} {unit}" for level in (x[0], x[-1]))
    reasons = (
        (hits.sum() == tries.sum(), f"every answer was a success: the threshold lies below {lowest}, or there is none"),
        (hits.sum() == 0, f"no answer was a success: the threshold lies above {highest}, or there is none"),
        (gain < DROP, "successes do not depend on the level: a constant probability explains the answers equally well"),
        (threshold < x[0], f"the threshold lies below the levels that were presented, from {lowest}"),
        (threshold > x[-1], f"the threshold lies above the levels that were presented, up to {highest}"),
    )
    return next((reason for holds, reason in reasons if holds), "")


def _located(values: FloatArray, profiles: FloatArray) -> Interval:
    """Return where profiles are highest, between grid points, and where they have dropped by `REGION`."""
    rows, place = np.arange(len(profiles)), profiles.argmax(axis=1)
    padded = np.pad(profiles, ((0, 0), (1, 1)), constant_values=-np.inf)
    before, here, after = (padded[rows, place + shift] for shift in range(3))
    inner = np.isfinite(before) & np.isfinite(after)
    curve = np.where(inner, before - 2 * here + after, 0.0)
    shift = np.divide(0.5 * np.where(inner, before - after, 0.0), curve, out=np.zeros(len(rows)), where=curve < 0)
    step = np.append(np.diff(values), 0.0)[place]
    bound = here - REGION
    low = _crossing(values, profiles, bound)
    high = -_crossing(-values[::-1], profiles[:, ::-1], bound)
    return Interval(values[place] + shift * step, low, high, np.zeros(len(rows)))


def _crossing(values: FloatArray, profiles: FloatArray, bound: FloatArray) -> FloatArray:
    """Return where profiles first rise above a bound; minus infinity if they are above it from the start."""
    rows, inside = np.arange(len(profiles)), (profiles >= bound[:, None]).argmax(axis=1)
    outside = np.maximum(inside - 1, 0)
    found, left = profiles[rows, inside], profiles[rows, outside]
    is_crossed = (inside > 0) & np.isfinite(left)
    share = np.divide(found - bound, found - left, out=np.zeros(len(rows)), where=is_crossed)
    return np.where(is_crossed, values[inside] - share * (values[inside] - values[outside]), -np.inf)


def _log_constant(hits: FloatArray, tries: FloatArray) -> FloatArray:
    """Return the highest log likelihood of a constant probability."""
    from scipy.special import xlogy

    share = hits / np.maximum(tries, 1)
    return np.asarray(xlogy(hits, share) + xlogy(tries - hits, 1 - share))
