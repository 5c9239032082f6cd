"""The statistics of the experiment: every question of the plan as rows of one tidy table.

The participant is the unit of inference. Tests are exact, or Monte Carlo with a stated seed and interval; each
p stands beside the smallest p its data could have given.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.catches import Catches, catch_findings
from modaltouch.analysis.consistency import association_findings, consistency_findings, effect_findings
from modaltouch.analysis.counts import AnswerCounts, Pair
from modaltouch.analysis.covariates import secondary_findings
from modaltouch.analysis.exact import ExactTest, multinomial_tests, sign_flip_test, sign_test
from modaltouch.analysis.findings import Finding, correct, finding_of
from modaltouch.analysis.intervals import Interval, clopper_pearson, clustered_difference, paired_mean
from modaltouch.analysis.trend import trend_test

IntArray = NDArray[np.int64]


def chance_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield question a1, whether a cell differs from guessing, all answers alike.

    One answer of each participant enters a cell: the one given, or with repetitions the most frequent; ties are
    left out and counted in the note. Where "felt nowhere" is an answer too, the test is of those who felt something
    (given how many they are, guesses are even over the others whatever the chance of that one), the share of all.
    """
    felt = answers.felt
    if len(felt) < 2:
        return
    modal = answers.modal()
    cells = list(product(range(len(answers.finger_conditions)), range(len(answers.pairs)), range(len(answers.levels))))
    size = answers.counts.shape[-1]
    kinds = np.array([np.bincount(modal[:, f, q, v][modal[:, f, q, v] >= 0], minlength=size) for f, q, v in cells])
    counts, everyone = kinds[:, felt], kinds.sum(axis=1)
    totals = counts.sum(axis=1)
    nothing, tests = answers.answers.naming(), dict[int, ExactTest]()
    for total in np.unique(totals):
        rows = np.flatnonzero(totals == total)
        tests.update(zip(rows.tolist(), multinomial_tests(counts[rows]), strict=True))
    for row, (f, q, v) in enumerate(cells):
        pair, n = answers.pairs[q], int(everyone[row])
        ties = answers.n_participants - n
        notes = [", ".join(f"{answers.answers[place].name} {kinds[row, place]}" for place in felt)]
        if nothing is not None:
            notes.append(f"{nothing.name} {n - int(totals[row])}, left out of the test")
        if answers.n_repetitions > 1:
            notes.append(f"most frequent answer of each participant, {ties} tied and left out")
        shown, place = answers.effects(pair)[0]
        interval = clopper_pearson(float(kinds[row, place]), n)
        scope = f"{_scope(answers, f, pair)} {answers.scale.say(answers.levels[v])}"
        name = "exact multinomial test against chance"
        yield finding_of("a1", name, scope, tests[row], f"P({shown})", interval, n, family="a1", notes=notes)


def dominance_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield question a2, whether one zone of a pair is chosen more than the other, over all levels."""
    dominant, other = answers.dominant().sum(axis=3), answers.other().sum(axis=3)
    for f, q in product(range(len(answers.finger_conditions)), range(len(answers.pairs))):
        pair, n = answers.pairs[q], answers.n_participants
        first, second = dominant[:, f, q], other[:, f, q]
        score = first - second
        index = clustered_difference(first, second, answers.n_answers)
        leaning = clopper_pearson(int((score > 0).sum()), n)
        total = n * answers.n_answers
        *given, last = [
            f"{int(answers.counts[:, f, q, :, place].sum())} "
            f"{answers.answers[place].name if place == answers.both_place else label}"
            for label, place in answers.labelled(pair)
        ]
        chosen = ", ".join(given) + (f" and {last}" if answers.offers_none else f", {last}")
        shared = [
            f"{chosen} of {total} answers",
            f"{int((score > 0).sum())} of {n} participants lean to {pair.dominant}",
        ]
        scope = _scope(answers, f, pair)
        quantity = f"P({pair.dominant}) - P({pair.other})"
        yield finding_of(
            "a2", "exact sign-flip test of net dominance", scope, sign_flip_test(score), quantity, index, n,
            family="a2", notes=shared,
        )  # fmt: skip
        yield finding_of(
            "a2", "exact sign test of leaning participants", scope, sign_test(score),
            f"share of participants leaning to {pair.dominant}", leaning, n,
        )  # fmt: skip


def level_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield question b, whether the choice of the dominant zone changes with the level; else that of each answer."""
    for f, q in product(range(len(answers.finger_conditions)), range(len(answers.pairs))):
        pair = answers.pairs[q]
        for label, place in answers.effects(pair)[: 1 if answers.compares else None]:
            yield _trend(answers, f, pair, label, answers.counts[:, f, q, :, place])


def _trend(answers: AnswerCounts, f: int, pair: Pair, label: str, chosen: IntArray) -> Finding:
    """Return whether the choice of one answer changes with the level."""
    levels = np.asarray(answers.levels)
    test = trend_test(chosen, answers.levels, answers.n_repetitions)
    notes = [f"{test.n_informative} of {answers.n_participants} participants changed their answer"]
    if len(levels) > 1:
        interval = _slope(chosen / answers.n_repetitions, levels, answers.scale.step)
    else:
        interval = Interval(np.nan, np.nan, np.nan, 0.0)
        notes.append("one level only: a trend needs two")
    quantity = f"change of P({label}) per {answers.scale.step_in_words}"
    name = "exact trend test, levels shuffled within participants"
    scope, n = _scope(answers, f, pair), answers.n_participants
    return finding_of("b", name, scope, test, quantity, interval, n, family="b", notes=notes)


def condition_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield question c, whether finger conditions differ, in the dominant zone and in "both"."""
    for nth, family in enumerate(_families(answers, "c")):
        for (f, g), q in product(combinations(range(len(answers.finger_conditions)), 2), range(len(answers.pairs))):
            pair = answers.pairs[q]
            label, place = answers.effects(pair)[nth]
            counts, what = answers.counts[..., place], f"P({label})"
            first, second = answers.finger_conditions[f], answers.finger_conditions[g]
            only_first, only_second = _discordant(counts[:, f, q], counts[:, g, q], answers.n_repetitions)
            interval = clustered_difference(only_first, only_second, answers.n_answers)
            test = sign_flip_test((counts[:, f, q] - counts[:, g, q]).sum(axis=1))
            margin = max(abs(interval.low), abs(interval.high))
            notes = [f"shows equivalence only within a margin of {margin:.2f}"]
            name = "exact sign-flip test between finger conditions"
            scope, quantity = f"{first} - {second} {pair.label}", f"difference of {what}"
            n = answers.n_participants
            yield finding_of("c", name, scope, test, quantity, interval, n, family=family, notes=notes)


def pair_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield question d, whether "both" is answered more often for one pair of zones than for another.

    Without a dominant zone the same is asked of each answer.
    """
    asked = answers.effects(answers.pairs[0])[1 if answers.compares else 0 :]
    for label, place in asked:
        chosen = answers.counts[..., place]
        for f, (q, r) in product(
            range(len(answers.finger_conditions)), list(combinations(range(len(answers.pairs)), 2))
        ):
            only_first, only_second = _discordant(chosen[:, f, q], chosen[:, f, r], answers.n_repetitions)
            interval = clustered_difference(only_first, only_second, answers.n_answers)
            test = sign_flip_test((chosen[:, f, q] - chosen[:, f, r]).sum(axis=1))
            labels = f"{answers.pairs[q].label} - {answers.pairs[r].label}"
            scope = f"{answers.finger_conditions[f]} {labels}"
            name = "exact sign-flip test between pairs"
            n = answers.n_participants
            yield finding_of("d", name, scope, test, f"difference of P({label})", interval, n, family="d")


def _families(answers: AnswerCounts, question: str) -> list[str]:
    """Return the family of tests of each effect: the dominant zone and both apart, else all answers together."""
    further = answers.effects(answers.pairs[0])[1:]
    return [question, *(f"{question} both" if answers.compares else question for _ in further)]


def _scope(answers: AnswerCounts, f: int, pair: Pair) -> str:
    return f"{answers.finger_conditions[f]} {pair.label}"


def _discordant(
    first: IntArray, second: IntArray, n_repetitions: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how many of a participant's pairs of answers count only for the first, and only for the second.

    Answers to the same level are paired. Repetitions have no natural partner, so every pairing is averaged.
    """
    only_first = (first * (n_repetitions - second) / n_repetitions).sum(axis=1)
    only_second = (second * (n_repetitions - first) / n_repetitions).sum(axis=1)
    return only_first, only_second


def _slope(shares: NDArray[np.float64], levels: NDArray[np.float64], step: float) -> Interval:
    """Return the mean slope of participants' shares over the level, for a step of the scale."""
    centred = levels - levels.mean()
    weights = step * centred / (centred**2).sum()
    steepest = float(weights[weights > 0].sum())
    unit = paired_mean(shares @ weights, steepest)
    return Interval(unit.estimate * steepest, unit.low * steepest, unit.high * steepest, unit.n_effective)


def find(answers: AnswerCounts, frame: pd.DataFrame, catches: Catches | None = None) -> list[Finding]:
    """Return the statistics of the answers, in the order of the questions.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    frame : DataFrame
        The tidy answers themselves, for what counts do not hold: order and times.
    catches : mapping of str to Counter, optional
        Answers to catch trials by participant.
    """
    findings = [
        *chance_findings(answers),
        *(dominance_findings(answers) if answers.compares else ()),
        *level_findings(answers),
        *condition_findings(answers),
        *pair_findings(answers),
        *association_findings(answers),
        *consistency_findings(answers),
        *effect_findings(answers),
        *catch_findings(answers, catches or {}),
        *secondary_findings(answers, frame),
    ]
    return sorted(correct(findings), key=lambda finding: ORDER.index(finding.question))


ORDER = ("a1", "a2", "b", "c", "d", "e", "f", "catch", "side", "order", "time", "speed")
"""Questions in the order of the report: those of the plan, then the further ones."""
