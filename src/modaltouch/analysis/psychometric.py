"""Maximum-likelihood fits of psychometric functions, to runs and by the method of constant stimuli.

The probability of success at a level x [dB re 1 mm/s] is g + (1 - g - l) Phi((x - m) / s), with the threshold m halfway
between the asymptotes, the spread s, the guess rate g and the lapse rate l. The likelihood is evaluated on a grid, so
nothing diverges if answers are separated. Intervals are projections of the joint 95 % region of m and s, with a profile
log likelihood within 3.00 of the maximum. Intervals of m alone, within 1.92, would have too low a coverage, since
levels depend on the answers and the spread is underestimated.

By the method of constant stimuli, with one interval, a success is an answer that something was felt, and catch trials
give the guess rate. With several, it is a correct answer if no comparison is below the standard. If some are, and the
stronger of two intervals is asked for, it is a choice of the comparison, with a point of subjective equality (PSE).

References
----------
Wichmann and Hill, Perception & Psychophysics 63 (2001) 1293-1313 (the function; bounded lapse rate).
Venzon and Moolgavkar, J. R. Stat. Soc. C 37 (1988) 87-94 (profile likelihood; joint regions).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from statistics import NormalDist

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.columns import LevelScale, scale_of
from modaltouch.analysis.intervals import DROP, REGION, Interval
from modaltouch.analysis.measures import Cell, IndividualValue, Measure, cells, kind_of
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.sums import FloatArray, IntArray
from modaltouch.analysis.task import TrialTask

STEP = 0.25
"""Step of the grid of thresholds [dB]."""

BEYOND = 20.0
"""Range of the grid of thresholds beyond the presented levels [dB]."""

# Minimum distance of probabilities from 0 and 1, so that no outcome is impossible [1].
_LEAST = 1e-9

_SPREADS = np.geomspace(0.5, 20.0, 28)
# Grids of spreads [dB] and, if there are catch trials, of guess rates [1].
_GUESSES = np.array([0.0, 0.01, 0.025, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])

# Maximum size of temporary arrays of likelihoods, which fit into the cache of a processor.
_AT_ONCE = 100_000


@dataclass(frozen=True)
class Psychometric:
    """Psychometric function fitted to the answers of a run.

    Attributes
    ----------
    n_trials, n_successes : int
        Number of trials with a stimulus, and of successes among them.
    n_catch, n_false : int
        Number of catch trials, and of successes among them.
    threshold, spread : Interval or None
        Threshold [dB re 1 mm/s] and spread [dB]; None if not determined by the answers.
    guess_rate, lapse_rate : float
        Maximum-likelihood estimates [1].
    why_not : str
        Reason why there is no threshold; empty if there is one.
    is_uncertain, is_step : bool
        Whether a constant probability, or the steepest function, fits the answers equally well.
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
        """Slope of the function at the threshold [1/dB]; None if a step fits the answers equally well."""
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
    """Fit the psychometric function of a run.

    There is no threshold if a constant probability fits equally well. If `flat_rate` is given, it is the only constant
    considered: levels of adaptive forced-choice runs cluster where the function is flat, so comparison with the best
    constant would reject one in four runs with a wide spread.

    Parameters
    ----------
    levels : sequence of float
        Level of each trial with a stimulus [dB re 1 mm/s, or another unit].
    successes, catches : sequence of bool
        Whether each of these trials, and each catch trial, was a success.
    guess_rate : float or array
        Guess rate, or a grid of guess rates [1]; with catch trials, it is fitted instead.
    most_lapse : float
        Maximum lapse rate [1].
    unit : str
        Unit of the levels, in words.
    flat_rate : float, optional
        Probability of success regardless of the level, if known [1].

    Raises
    ------
    ValueError
        If there is no trial, or levels and successes differ in number.
    """
    if not levels or len(levels) != len(successes):
        raise ValueError(f"given {len(levels)} levels and {len(successes)} answers; give one answer to each level")
    x, hits, tries = counted(levels, successes)
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
    """Fits of a batch of runs, as arrays of shape (n_runs,).

    Attributes
    ----------
    threshold, spread : Interval
        Threshold [dB re 1 mm/s] and spread [dB]; bounds not determined by the answers are infinite.
    guess_rate, lapse_rate : arrays
        Maximum-likelihood estimates [1].
    gain, settled : arrays
        Gain in log likelihood over the best constant probability, and over `flat_rate` (if unknown, the same).
    is_determined, is_step : arrays of bool
        Whether the answers determine a threshold, and whether the steepest function fits equally well.
    """

    threshold: Interval
    spread: Interval
    guess_rate: FloatArray
    lapse_rate: FloatArray
    gain: FloatArray
    settled: FloatArray
    is_determined: NDArray[np.bool_]
    is_step: NDArray[np.bool_]


def fit_counts(
    levels: FloatArray,
    hits: FloatArray,
    tries: FloatArray,
    *,
    guess_rate: ArrayLike,
    most_lapse: float,
    n_catch: int = 0,
    n_false: int | IntArray = 0,
    flat_rate: float | None = None,
) -> Fits:
    """Fit the psychometric functions of a batch of runs on a common set of levels.

    Parameters
    ----------
    levels : (n_levels,) array
        Levels in increasing order [dB]; a run need not include all of them.
    hits, tries : (n_runs, n_levels) arrays
        Number of successes and trials of each run.
    guess_rate, most_lapse, flat_rate
        As for `fit_psychometric`.
    n_catch : int
        Number of catch trials of each run.
    n_false : int or (n_runs,) array
        Number of successes among them.
    """
    thresholds = np.arange(levels[0] - BEYOND, levels[-1] + BEYOND + STEP / 2, STEP)
    guesses = _GUESSES if n_catch else np.atleast_1d(np.asarray(guess_rate, dtype=float))
    lapses = np.linspace(0.0, most_lapse, 4) if most_lapse else np.zeros(1)
    p = np.clip(guesses, _LEAST, 1 - _LEAST)[:, None]
    of_catches = np.broadcast_to(n_false * np.log(p) + (n_catch - n_false) * np.log1p(-p), (guesses.size, len(hits)))
    lowest = np.where(tries > 0, levels, np.inf).min(axis=-1)
    highest = np.where(tries > 0, levels, -np.inf).max(axis=-1)
    by_threshold, by_spread, asymptotes = _profiles(
        levels, hits, tries, (lowest, highest), thresholds, lapses, guesses, of_catches[..., None]
    )
    best = asymptotes.max(axis=(0, 2))
    n_hits, n = hits.sum(axis=-1), tries.sum(axis=-1)
    flat = _log_constant(n_hits, n) + _log_constant(np.asarray(n_false, dtype=float), np.array(float(n_catch)))
    known = 0.0 if flat_rate is None else flat - n_hits * math.log(flat_rate) - (n - n_hits) * math.log1p(-flat_rate)
    threshold, spread = _located(thresholds, by_threshold), _located(_SPREADS, by_spread)
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
        by_spread[:, 0] >= best - DROP,
    )


def _profiles(
    levels: FloatArray,
    hits: FloatArray,
    tries: FloatArray,
    ends: tuple[FloatArray, FloatArray],
    thresholds: FloatArray,
    lapses: FloatArray,
    guesses: FloatArray,
    of_catches: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the profile log likelihoods of threshold and spread by run, and of both asymptotes by guess rate and run.

    The `ends` are the lowest and highest level of each run. The log likelihoods `of_catches` of the catch trials,
    (n_guesses, n_runs, 1), are included.
    """
    from scipy.special import ndtr

    rising = ndtr((levels[:, None, None] - thresholds) / _SPREADS[:, None]).reshape(levels.size, -1)
    # Restrict the threshold of a run to the vicinity of its levels.
    lowest, highest = (end[:, None] for end in ends)
    outside = (thresholds < lowest - BEYOND - STEP / 4) | (thresholds > highest + BEYOND + STEP / 2)
    misses = tries - hits
    by_threshold, by_spread = (np.full((len(hits), each.size), -np.inf) for each in (thresholds, _SPREADS))
    asymptotes = np.empty((guesses.size, len(hits), lapses.size))
    step = max(1, _AT_ONCE // rising[0].size)
    for (i, guess), (j, lapse) in product(enumerate(guesses), enumerate(lapses)):
        p = np.clip(guess + (1 - guess - lapse) * rising, _LEAST, 1 - _LEAST)
        of_hit, of_miss = np.log(p), np.log1p(-p)
        for some in (slice(start, start + step) for start in range(0, len(hits), step)):
            found = (hits[some] @ of_hit + misses[some] @ of_miss).reshape(-1, _SPREADS.size, thresholds.size)
            if outside[some].any():
                np.copyto(found, -np.inf, where=outside[some, None])
            of_spreads = found.max(axis=2) + of_catches[i, some]
            np.maximum(by_threshold[some], found.max(axis=1) + of_catches[i, some], out=by_threshold[some])
            np.maximum(by_spread[some], of_spreads, out=by_spread[some])
            asymptotes[i, some, j] = of_spreads.max(axis=1)
    return by_threshold, by_spread, asymptotes


def counted(levels: ArrayLike, successes: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the unique levels, with the numbers of successes and trials at each."""
    x, places = np.unique(np.asarray(levels, dtype=float).round(6), return_inverse=True)
    return (
        x,
        np.bincount(places, weights=np.asarray(successes, dtype=float)).astype(np.float64),
        np.bincount(places).astype(np.float64),
    )


def _why_not(x: FloatArray, hits: FloatArray, tries: FloatArray, gain: float, threshold: float, unit: str) -> str:
    """Return the reason why the answers give no threshold; empty if they do."""
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
    """Interpolate the maximum of profiles, and the bounds at which they have dropped by `REGION`."""
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
    """Return the points where profiles first exceed a bound; minus infinity if they exceed it from the start."""
    rows, inside = np.arange(len(profiles)), (profiles >= bound[:, None]).argmax(axis=1)
    outside = np.maximum(inside - 1, 0)
    found, left = profiles[rows, inside], profiles[rows, outside]
    is_crossed = (inside > 0) & np.isfinite(left)
    share = np.divide(found - bound, found - left, out=np.zeros(len(rows)), where=is_crossed)
    return np.where(is_crossed, values[inside] - share * (values[inside] - values[outside]), -np.inf)


def _log_constant(hits: FloatArray, tries: FloatArray) -> FloatArray:
    from scipy.special import xlogy

    share = hits / np.maximum(tries, 1)
    return np.asarray(xlogy(hits, share) + xlogy(tries - hits, 1 - share))


MOST_LAPSE = 0.02
"""Maximum lapse rate of a fit, at either end [1]; with 0.05, the spread from 144 answers is 10 % too small."""

FEWEST_LEVELS = 3

JND_OF_SPREAD = NormalDist().inv_cdf(0.75)
"""Ratio of the just noticeable difference (from 50 % to 75 % of the answers) to the spread [1]."""


@dataclass(frozen=True, eq=False)
class FittedCell:
    """Psychometric function of one participant in one finger condition and pair of zones.

    Attributes
    ----------
    cell : Cell
        Participant and cell.
    levels, shares, tries : (n_levels,) arrays
        Levels [mm/s, or multiples of own threshold], proportions of successes [1], and numbers of answers.
    fitted : Psychometric
        The function, in dB re one unit of the levels.
    is_choice : bool
        Whether a success is a choice of the comparison, so that the midpoint is a point of subjective equality.
    """

    cell: Cell
    levels: FloatArray
    shares: FloatArray
    tries: FloatArray
    fitted: Psychometric
    is_choice: bool


def fit_cells(responses: Responses, task: TrialTask) -> tuple[FittedCell, ...]:
    """Fit the psychometric functions; empty if the design has none, e.g. with fewer than three levels.

    Parameters
    ----------
    responses : Responses
        The answers.
    task : TrialTask
        Task of the participant.
    """
    scale = scale_of(responses.frame.columns)
    frame = task.informative(responses.frame, scale.column)
    is_felt = task.n_intervals == 1 and responses.answers.naming() is not None and not responses.answers.compares
    if frame[scale.column].nunique() < FEWEST_LEVELS or not (task.named or is_felt):
        return ()
    if task.no_d_prime_reason:  # the guess rate is unknown, too
        return ()
    is_below = bool(task.named) and bool((frame[scale.column] < task.standard).any())
    is_choice = is_below and task.wants_standard(-math.inf)
    if is_below and not is_choice:
        return ()
    return tuple(
        _fit_cell(cell, part, responses, task, scale, is_choice) for cell, part in cells(frame, scale, by_level=False)
    )


def _fit_cell(
    cell: Cell, part: pd.DataFrame, responses: Responses, task: TrialTask, scale: LevelScale, is_choice: bool
) -> FittedCell:
    answers, catches = part.loc[part.index.repeat(part["n"])], []
    guess_rate: float | FloatArray = 1 / task.n_intervals
    if task.named:
        success = answers["response"].map(task.named).astype(int) == answers["interval"].astype(int)
    else:
        nothing = {each.name for each in responses.answers if each.means_nothing_felt}
        success, guess_rate = ~answers["response"].isin(nothing), 0.0
        catches = [word not in nothing for word in responses.caught(cell[0], cell[1], kind_of(part)).elements()]
    if is_choice:
        guess_rate = np.linspace(0.0, MOST_LAPSE, 3)
    given = answers[scale.column].to_numpy(dtype=float)
    fitted = fit_psychometric(
        (20 * np.log10(given)).tolist(), success.tolist(), guess_rate=guess_rate, most_lapse=MOST_LAPSE,
        catches=catches, unit=scale.unit,
    )  # fmt: skip
    levels, hits, tries = counted(given, success)
    return FittedCell(cell, levels, hits / tries, tries, fitted, is_choice)


def measures_of_fits(fits: tuple[FittedCell, ...], task: TrialTask, scale: LevelScale) -> Iterator[IndividualValue]:
    """Yield the threshold, or the PSE and the just noticeable difference, of each function."""
    name = "threshold" if task.named else "detection threshold"
    threshold = Measure(name, f"{name} [{scale.unit}]", "function", is_ratio=True)
    equal = Measure("PSE", f"point of subjective equality [{scale.unit}]", "function", task.standard or None, True)
    jnd = Measure("JND", "just noticeable difference [dB]", "function")
    for each in fits:
        fitted, n = each.fitted, each.fitted.n_trials
        value, note = _interval(fitted.threshold, lambda level: 10 ** (level / 20)), fitted.why_not
        never, always = each.levels[each.shares == 0], each.levels[each.shares == 1]
        is_step = fitted.threshold is not None and len(never) + len(always) == len(each.levels)
        if each.is_choice and is_step and never.max() < task.standard < always.min():
            value = replace(value, estimate=task.standard)
            note = f"any PSE between {never.max():g} and {always.min():g} {scale.unit} fits: taken as the standard"
        yield IndividualValue(equal if each.is_choice else threshold, *each.cell, value, n, note)
        if each.is_choice:
            yield IndividualValue(
                jnd,
                *each.cell,
                _interval(fitted.spread, lambda spread: JND_OF_SPREAD * max(spread, 0.0)),
                n,
                fitted.why_not,
            )


def _interval(estimate: Interval | None, convert: Callable[[float], float]) -> Interval:
    return Interval.point(math.nan, 0) if estimate is None else estimate.changed(convert)
