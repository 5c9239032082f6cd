"""Agreement between participants (Gwet's AC1), and the population prevalence of an effect.

Kappa is deliberately not used: it can be negative at 95 % agreement, and is undefined if all give the same answer.

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

from modaltouch.analysis.findings import ALPHA
from modaltouch.analysis.intervals import CONFIDENCE, Interval
from modaltouch.analysis.shares import mean_of_known

FloatArray = NDArray[np.float64]

_SEED, _DRAWS, _TAIL = 20080501, 1999, (1 - CONFIDENCE) / 2

_AT_ONCE = 1_000_000
"""Maximum number of random weights held in memory at a time [1]."""


def ac1_interval(answers: ArrayLike) -> Interval:
    """Return AC1 between participants with a confidence interval, which is [-1, 1] for fewer than three participants.

    As in `BoundedMean`, one participant is added to the sample: for the lower bound, one who gives the rarest answer to
    each item; for the upper bound, the most frequent one; ties are split evenly. The bounds are quantiles over random
    weights of the participants (Bayesian bootstrap) and do not depend on their order. The coverage is known only from
    simulation.

    Parameters
    ----------
    answers : (..., n_participants, n_items, n_categories) array
        Counts of answers.

    References
    ----------
    Rubin, "The Bayesian bootstrap", Ann. Stat. 9 (1981) 130-134.
    """
    table = np.asarray(answers, dtype=float)
    n = table.shape[-3]
    _, estimate = agreement_between(table, np.ones((1, n)))
    if n < 3:
        return Interval(estimate[..., 0], *(np.full(table.shape[:-3], each)[()] for each in (-1.0, 1.0, n)))
    order = np.lexsort(np.moveaxis(table.reshape(*table.shape[:-2], -1), -1, 0))  # independent of participant order
    table = np.take_along_axis(table, order[..., np.newaxis, np.newaxis], axis=-3)
    total, rng = table.sum(axis=-3, keepdims=True), np.random.default_rng(_SEED)
    extremes = total.min(axis=-1, keepdims=True), total.max(axis=-1, keepdims=True)
    tables = [np.concatenate([table, (total == chosen).astype(float)], axis=-3) for chosen in extremes]
    n_at_once, drawn = max(1, _AT_ONCE // (n + 1)), list[list[FloatArray]]()
    for start in range(0, _DRAWS, n_at_once):
        weights = rng.dirichlet(np.ones(n + 1), min(n_at_once, _DRAWS - start))
        drawn.append([agreement_between(each, weights)[1] for each in tables])
    each_bound = zip(zip(*drawn, strict=True), (_TAIL, 1 - _TAIL), strict=True)
    bounds = [np.quantile(np.concatenate(parts, axis=-1), tail, axis=-1) for parts, tail in each_bound]
    low, high = np.minimum(bounds[0], estimate[..., 0]), np.maximum(bounds[1], estimate[..., 0])
    return Interval(estimate[..., 0], low, high, n)


def agreement_between(answers: ArrayLike, weights: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the pairwise agreement between participants [1] and AC1 [1], for each weighting of the participants.

    Repeated answers of a participant to one item count as fractions of one answer.

    Parameters
    ----------
    answers : (..., n_participants, n_items, n_categories) array
        Counts of answers.
    weights : (n_weightings, n_participants) array
        Weights of the participants.

    Returns
    -------
    agreement, ac1 : (..., n_weightings) array
        NaN if no item was answered by at least two participants.
    """
    table, weight = np.asarray(answers, dtype=float), np.asarray(weights, dtype=float)
    n_given = table.sum(axis=-1, keepdims=True)
    shares, known = table / np.maximum(n_given, 1), (n_given[..., 0] > 0).astype(float)
    flat = shares.reshape(*shares.shape[:-2], -1)
    chosen = (weight @ flat).reshape(*flat.shape[:-2], len(weight), *shares.shape[-2:])
    total, own = weight @ known, weight**2 @ known
    same = np.einsum("...k,...k->...", chosen, chosen) - weight**2 @ (shares**2).sum(axis=-1)
    pairs, mass = total**2 - own, np.maximum(total, 1e-300)[..., np.newaxis]
    alike = np.divide(same, pairs, out=np.full(same.shape, math.nan), where=pairs > 1e-12)
    agreement = mean_of_known(alike)
    rated = np.where((total > 0)[..., np.newaxis], chosen / mass, math.nan)
    popular = mean_of_known(np.moveaxis(rated, -2, -1))
    chance = np.einsum("...k,...k->...", popular, 1 - popular) / (table.shape[-1] - 1)
    return agreement, (agreement - chance) / (1 - chance)


def prevalence(n_positive: int, n_participants: int) -> float:
    """Return the maximum likelihood estimate of the population prevalence of an effect.

    Parameters
    ----------
    n_positive : int
        Participants with a significant test of their individual data.
    n_participants : int
        Number of participants tested.

    Returns
    -------
    float
        (k/n - alpha) / (1 - alpha), clipped at zero [1]; Ince et al. (2021).
    """
    return max((n_positive / n_participants - ALPHA) / (1 - ALPHA), 0.0)
