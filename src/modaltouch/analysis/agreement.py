"""How far participants agree with each other: Gwet's AC1, and the share of participants who show an effect.

Kappa is left out on purpose: at 95 % agreement in one category it is negative, and with full agreement
undefined.

References
----------
Gwet, "Computing inter-rater reliability and its variance in the presence of high agreement", Br. J. Math. Stat.
Psychol. 61 (2008) 29-48.
Ince et al., "Bayesian inference of population prevalence", eLife 10 (2021) e62461.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.intervals import CONFIDENCE, Interval, student_quantile

FloatArray = NDArray[np.float64]

_LEVEL = 0.05
"""Level of the tests within participants [1]."""


def pairwise_agreement(ratings: ArrayLike) -> float:
    """Return the chance that two participants, drawn at random, gave one answer to an item [1]; NaN where none has two.

    Parameters
    ----------
    ratings : (n_items, n_categories) array
        How many participants put each item into each category.
    """
    table = np.asarray(ratings, dtype=float)
    raters = table.sum(axis=1)
    table, raters = table[raters >= 2], raters[raters >= 2]
    if not len(table):
        return math.nan
    return float(np.mean((table * (table - 1)).sum(axis=1) / (raters * (raters - 1))))


def gwet_ac1(ratings: ArrayLike) -> float:
    """Return Gwet's AC1 for any number of raters and categories [1]; 1 when all agree, NaN where none has two answers.

    Parameters
    ----------
    ratings : (n_items, n_categories) array
        How many participants put each item into each category; every category that could be chosen has its
        column. Items may have different numbers of ratings.
    """
    table = np.asarray(ratings, dtype=float)
    agreement = pairwise_agreement(table)
    rated = table[table.sum(axis=1) > 0]
    shares = (rated / rated.sum(axis=1, keepdims=True)).mean(axis=0)
    chance = float((shares * (1 - shares)).sum() / (table.shape[1] - 1))
    return (agreement - chance) / (1 - chance)


def ac1_interval(answers: ArrayLike) -> Interval:
    """Return AC1 with an interval over participants; from -1 to 1 with fewer than three.

    The interval is the jackknife over participants. Where all agree the jackknife has no width; the lower
    bound is then the smallest AC1 compatible with the exact upper bound on the share of participants who would
    ever answer otherwise.

    Parameters
    ----------
    answers : (n_participants, n_items, n_categories) array
        How often each participant gave each answer to each item.
    """
    table = np.asarray(answers, dtype=float)
    n = table.shape[0]
    total = table.sum(axis=0)
    estimate = gwet_ac1(total) if n > 1 else math.nan
    if n < 3:
        return Interval(estimate, -1.0, 1.0, n)
    left_out = np.array([gwet_ac1(total - one) for one in table])
    if np.ptp(left_out) < 1e-12:
        low = min(_least_ac1(1 - ((1 - CONFIDENCE) / 2) ** (1 / n)), estimate)
        return Interval(estimate, low, max(estimate, low), n)
    groups = left_out.size
    error = math.sqrt((groups - 1) / groups * float(((left_out - left_out.mean()) ** 2).sum()))
    half = student_quantile(groups - 1) * error
    return Interval(estimate, max(estimate - half, -1.0), min(estimate + half, 1.0), n)


def prevalence(n_positive: int, n_participants: int) -> float:
    """Return the likeliest share of the population that would show an effect within its own data.

    Parameters
    ----------
    n_positive : int
        Participants whose own test was significant.
    n_participants : int
        All participants.

    Returns
    -------
    float
        Ince et al. (2021): (k/n - alpha) / (1 - alpha), not below zero [1].
    """
    return max((n_positive / n_participants - _LEVEL) / (1 - _LEVEL), 0.0)


def _least_ac1(deviating: float) -> float:
    """Return the smallest AC1 when a share of participants deviates, all alike or spread over the rest."""
    u = deviating
    alike, alike_chance = (1 - u) ** 2 + u**2, u * (1 - u)
    spread, spread_chance = (1 - u) ** 2 + u**2 / 2, u - 0.75 * u**2
    return min((alike - alike_chance) / (1 - alike_chance), (spread - spread_chance) / (1 - spread_chance))
