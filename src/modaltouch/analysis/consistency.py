"""Question e, how far participants agree, and question f, the effects with their intervals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from modaltouch.analysis.agreement import ac1_interval, pairwise_agreement, prevalence
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.exact import sign_flip_test
from modaltouch.analysis.findings import ALPHA, Finding, finding_of
from modaltouch.analysis.intervals import (
    Interval,
    clopper_pearson,
    korn_graubard,
    matched_odds_ratio,
    tango,
)
from modaltouch.analysis.shuffles import level_association, pair_association, participant_heterogeneity

IntArray = NDArray[np.int64]

_NO_INTERVAL = Interval(math.nan, math.nan, math.nan, 0.0)


def consistency_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield question e, agreement between participants and whether they differ from each other."""
    n = answers.n_participants
    for f, q, scope in answers.pair_cells:
        pair, own = answers.pairs[q], answers.counts[:, f, q]
        first = own[..., answers.effects(pair)[0][1]]
        second = own[..., answers.other_place(pair)] if answers.compares else own.sum(axis=-1) - first
        shuffled = participant_heterogeneity(first - second)
        agreement = pairwise_agreement(own.sum(axis=0))
        notes = ["" if math.isnan(agreement) else f"pairwise agreement {agreement:.2f}", shuffled.note]
        yield finding_of(
            "e", "agreement, and shuffle test of differences between participants", scope, shuffled.test,
            "Gwet AC1", ac1_interval(own), n, notes=notes,
        )  # fmt: skip
        if answers.compares:
            yield _prevalence(answers, first.sum(axis=1), second.sum(axis=1), scope, pair.dominant)


def association_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield the Monte Carlo checks of questions b and d, on all answers at once."""
    n = answers.n_participants
    for f, q, scope in answers.pair_cells:
        shuffled = level_association(answers.counts[:, f, q])
        name = "shuffle test of any association of level and answer"
        yield finding_of("b", name, scope, shuffled.test, "", _NO_INTERVAL, n, notes=[shuffled.note])
    for f, condition in enumerate(answers.finger_conditions if len(answers.pairs) > 1 else ()):
        shuffled = pair_association(answers.counts[:, f].sum(axis=2))
        name = "shuffle test of any association of pair and answer"
        yield finding_of("d", name, condition, shuffled.test, "", _NO_INTERVAL, n, notes=[shuffled.note])


def effect_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield question f, every proportion over levels, and every paired difference cell by cell."""
    n = answers.n_participants
    for f, q, scope in answers.pair_cells:
        for label, place in answers.labelled(answers.pairs[q]):
            share = korn_graubard(answers.counts[:, f, q, :, place].sum(axis=1), answers.n_answers)
            worth = f"worth {share.n_effective:.1f} independent answers of {n * answers.n_answers}"
            name = "Korn-Graubard interval over levels"
            yield finding_of("f", name, scope, None, f"P({label})", share, n, notes=[worth])
    yield from _paired_cells(answers)


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
            f"; {n - m} participants tied and left out" if m < n else ""
        )
        difference = tango(b, c, m) if m else _NO_INTERVAL
        quantity = f"difference of P({shown})"
        name = "Tango interval of the paired difference"
        yield finding_of("f", name, scope, None, quantity, difference, m, notes=[note])
        notes = [note] if b + c else ["no information: no discordant pair", note]
        quantity, odds = f"odds ratio of {shown}", matched_odds_ratio(b, c)
        yield finding_of("f", "matched odds ratio, exact", scope, None, quantity, odds, m, notes=notes)


def _prevalence(answers: AnswerCounts, first: IntArray, second: IntArray, scope: str, zone: str) -> Finding:
    """Return the share of participants whose own answers show dominance, and that of the population."""
    n, quantity = answers.n_participants, f"share showing {zone}"
    least = 2.0 ** (1 - answers.n_answers)
    if least > ALPHA:
        note = f"no information: {answers.n_answers} answers of one participant cannot give p below {least:.2g}"
        return finding_of("e", "prevalence of dominance", scope, None, quantity, _NO_INTERVAL, n, notes=[note])
    pairs = list(zip(first.tolist(), second.tolist(), strict=True))
    own = {pair: sign_flip_test([1] * pair[0] + [-1] * pair[1]).p for pair in set(pairs)}
    shown = sum(own[pair] <= ALPHA and pair[0] > pair[1] for pair in pairs)
    note = (
        f"{shown} of {n} have a significant sign test by themselves; "
        f"likeliest prevalence {prevalence(shown, n):.2f} (Ince 2021)"
    )
    share = clopper_pearson(shown, n)
    return finding_of("e", "prevalence of dominance", scope, None, quantity, share, n, notes=[note])
