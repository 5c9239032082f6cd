"""Question e, the agreement between participants, and question f, effect sizes with their intervals.

Agreement is Gwet's AC1. Kappa is deliberately not used: it can be negative at 95 % agreement, and is undefined if all
give the same answer.

References
----------
Gwet, "Computing inter-rater reliability and its variance in the presence of high agreement", Br. J. Math. Stat.
Psychol. 61 (2008) 29-48.
Ince et al., "Bayesian inference of population prevalence", eLife 10 (2021) e62461.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.contrasts import Shares
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.exact import sign_flip_test
from modaltouch.analysis.findings import ALPHA, Finding, finding_of
from modaltouch.analysis.intervals import CONFIDENCE, BoundedMean, Interval, clopper_pearson
from modaltouch.analysis.sums import FloatArray, IntArray

AGREEMENT = "agreement between participants"
SHARE = "share of answers over levels, interval of a bounded mean over participants"
PAIRED = "paired difference in a cell, interval of a bounded mean over participants"

_SEED, _DRAWS, _TAIL = 20080501, 1999, (1 - CONFIDENCE) / 2

# Maximum number of random weights held in memory at a time [1].
_AT_ONCE = 200_000


def consistency_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield the findings of question e: agreement between participants, and prevalence of the effect."""
    n = answers.n_participants
    for f, q, scope in answers.pair_cells:
        pair, own = answers.pairs[q], answers.counts[:, f, q]
        agreement = float(agreement_between(own, np.ones((1, n)))[0][0])
        note = "" if math.isnan(agreement) else f"pairwise agreement {agreement:.2f}"
        yield finding_of("e", AGREEMENT, scope, None, "Gwet AC1", ac1_interval(own), n, notes=[note])
        if answers.compares:
            first, second = (
                own[..., place(pair)].sum(axis=1) for place in (answers.dominant_place, answers.other_place)
            )
            yield _prevalence(answers, first, second, scope, pair.dominant)


def effect_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield the findings of question f: shares over levels and, for effects, paired differences in each cell."""
    for f, q, scope in answers.pair_cells:
        labelled = answers.labelled(answers.pairs[q])
        own = answers.counts[:, f, q]
        given = np.moveaxis(own[..., [place for _, place in labelled]], -1, 0)
        shares = Shares(given, np.broadcast_to(own.sum(axis=-1), given.shape), answers.n_repetitions)
        mean, worst = BoundedMean(shares.mean, 0.0, 1.0), _missing_notes(shares)
        intervals = mean.interval()
        for place, (label, _) in enumerate(labelled):
            yield finding_of(
                "f", SHARE, scope, None, f"P({label})", intervals[place], int(mean.n[place]),
                notes=worst[place : place + 1],
            )  # fmt: skip
    if not answers.is_nominal:
        yield from _paired_cells(answers)


def _missing_notes(shares: Shares) -> list[str]:
    """Return the worst-case bounds of each share due to missing answers; empty if none are missing."""
    n_missing = shares.asked * shares.given[0].size - int(shares.answered[0].sum())
    if not n_missing:
        return []
    low, high = (BoundedMean(each.mean(axis=-1), 0.0, 1.0).interval() for each in (shares.least, shares.most))
    return [
        f"missing answers: {n_missing}; with them the share could be {low.estimate[place]:.3g} to "
        f"{high.estimate[place]:.3g}, its interval {low.low[place]:.3g} to {high.high[place]:.3g}"
        for place in range(len(shares.given))
    ]


def _paired_cells(answers: AnswerCounts) -> Iterator[Finding]:
    modal, n = answers.modal(), answers.n_participants
    places = combinations(range(len(answers.finger_conditions)), 2)
    for (f, g), q, v in product(places, range(len(answers.pairs)), range(len(answers.levels))):
        pair = answers.pairs[q]
        shown, place = answers.effects(pair)[0]
        known = (modal[:, f, q, v] >= 0) & (modal[:, g, q, v] >= 0)
        first = modal[known, f, q, v] == place
        second = modal[known, g, q, v] == place
        b, c, m = int((first & ~second).sum()), int((second & ~first).sum()), int(known.sum())
        both = f"{answers.finger_conditions[f]} - {answers.finger_conditions[g]}"
        scope = f"{both} {pair.label} {answers.scale.say(answers.levels[v])}"
        note = f"{b} chose {shown} only in the first, {c} only in the second" + (
            f"; left out as tied or without an answer: {n - m} of {n} participants" if m < n else ""
        )
        difference = BoundedMean([1.0] * b + [-1.0] * c + [0.0] * (m - b - c)).interval()
        yield finding_of("f", PAIRED, scope, None, f"difference of P({shown})", difference, m, notes=[note])


def shows_dominance(first: IntArray, second: IntArray) -> NDArray[np.bool_]:
    """Return which participants choose the first zone significantly more often, by a sign test of their answers."""
    pairs, which = np.unique(np.stack([first, second], axis=-1).reshape(-1, 2), axis=0, return_inverse=True)
    own = [a > b and bool(sign_flip_test([1] * a + [-1] * b).p <= ALPHA) for a, b in pairs.tolist()]
    return np.array(own)[which].reshape(first.shape)


def _prevalence(answers: AnswerCounts, first: IntArray, second: IntArray, scope: str, zone: str) -> Finding:
    """Return the share of participants who individually show dominance, and its prevalence in the population."""
    n, least = answers.n_participants, 2.0 ** (1 - answers.n_answers)
    share = Interval.point(math.nan, 0)
    note = f"no information: {answers.n_answers} answers of one participant cannot give p below {least:.2g}"
    if least <= ALPHA:
        shown = int(shows_dominance(first, second).sum())
        share, note = clopper_pearson(shown, n), f"{shown} of {n} are significant in their own sign test; "
        note += f"maximum-likelihood prevalence {prevalence(shown, n):.2f} (Ince 2021)"
    name, quantity = "prevalence of dominance", f"share showing {zone}"
    return finding_of("e", name, scope, None, quantity, share, n, notes=[note])


def ac1_interval(answers: ArrayLike) -> Interval:
    """Return AC1 between participants with a confidence interval, which is [-1, 1] for fewer than three participants.

    It is [-1, 1], too, if all participants divide their answers evenly, so that none of them tells the spread.

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
    unknown = low == high  # all divide their answers evenly, the added participant too
    return Interval(estimate[..., 0], np.where(unknown, -1.0, low)[()], np.where(unknown, 1.0, high)[()], n)


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
    # Weightings are on the last axis, since all sums have few terms.
    chosen = np.tensordot(shares, weight, (-3, -1))
    total, own = np.tensordot(known, weight, (-2, -1)), np.tensordot(known, weight**2, (-2, -1))
    squares = np.tensordot((shares**2).sum(axis=-1), weight**2, (-2, -1))
    same, pairs = np.einsum("...ikw,...ikw->...iw", chosen, chosen) - squares, total**2 - own
    alike = np.divide(same, pairs, out=np.zeros(same.shape), where=pairs > 1e-12).sum(axis=-2)
    n_rated, n_known = (pairs > 1e-12).sum(axis=-2), (total > 0).sum(axis=-2, keepdims=True)
    agreement = np.divide(alike, n_rated, out=np.full(alike.shape, math.nan), where=n_rated > 0)
    each = np.divide(1.0, total, out=np.zeros(total.shape), where=total > 0)
    popular = np.einsum("...ikw,...iw->...kw", chosen, each) / np.maximum(n_known, 1)
    chance = (popular * (1 - popular)).sum(axis=-2) / (table.shape[-1] - 1)
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
