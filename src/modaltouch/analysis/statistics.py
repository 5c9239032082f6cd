"""Statistics of the experiment: findings on all questions of the statistics plan.

The participant is the unit of inference. Two hypotheses are tested separately: that some participant shows an effect,
by exact permutation tests or sign flips within participants; and that participants show an effect on average, by the
mean of a bounded score, whose interval inverts the test. The former needs fewer data; only the latter estimates the
effect size.

`STATISTICS` defines the families of tests, as functions of the counts of an experiment or a batch. The analysis reports
their results; planning estimates their power from simulated experiments.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
import pandas as pd

from modaltouch.analysis.consistency import consistency_findings, effect_findings
from modaltouch.analysis.contrasts import Contrast, FamilyResult, MeanScores, Shares, equivalence_of, means_of, signs_of
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.covariates import secondary_findings
from modaltouch.analysis.exact import MOST_EXACT, multinomial_test, sign_test, smallest_trend_p, trend_test
from modaltouch.analysis.findings import Finding, correct, finding_of
from modaltouch.analysis.intervals import BoundedMean, Interval, clopper_pearson
from modaltouch.analysis.sums import IntArray


@dataclass(frozen=True)
class Statistic:
    """A family of tests, reported by the analysis and simulated by planning.

    Attributes
    ----------
    question : str
        Question of the report to which the family belongs.
    asks : str
        The question asked, for the report and the figure of a power analysis.
    name : str
        Name of the tests.
    compute : callable
        Maps the counts of an experiment or a batch to the results, or None if the test does not apply to the answers or
        the design.
    unit : str
        Quantity of the intervals.
    smallest_p : callable
        Maps the levels, the numbers of participants and repetitions, and the equivalence margin to the smallest
        attainable p; by default that of sign flips and bounded means.
    against_guessing : bool
        Whether the null hypothesis is guessing, rather than equal sensations at both fingers.
    when_alike : bool
        Whether an effect is present even with equal sensations at both fingers.
    """

    question: str
    asks: str
    name: str
    compute: Callable[[AnswerCounts], FamilyResult | None]
    unit: str = "difference of shares"
    smallest_p: Callable[[Sequence[float], int, int, float | None], float] = lambda levels, n, *_: float(2.0 ** (1 - n))
    against_guessing: bool = False
    when_alike: bool = False


def chance_tests(answers: AnswerCounts) -> FamilyResult | None:
    """Return tests of each cell against guessing, with equal probabilities of all answers.

    Each participant contributes one answer per cell: the one given or, with repetitions, the most frequent; ties are
    excluded and counted in the note. The estimate is the share of the most frequent answer. If "nothing felt" is among
    the answers, the test is conditional on the number of participants who felt something; the share is of all.
    """
    felt = answers.felt
    if len(felt) < 2 or not answers.guesses_evenly:
        return None
    cells, kinds = _cells_of(answers)
    n, nothing = kinds.sum(axis=-1), answers.answers.naming()
    # A batch takes the quantities of its first experiment; they are shown only for a single experiment.
    shown = kinds.reshape(-1, *kinds.shape[-2:])[0]
    labels = [{place: label for label, place in answers.labelled(pair) if place in felt} for pair in answers.pairs]
    most = [max(labels[q], key=own.__getitem__) for (q, _), own in zip(cells, shown, strict=True)]
    named = (
        labels[q][k] if own[k] else "most frequent answer" for (q, _), k, own in zip(cells, most, shown, strict=True)
    )

    def notes(place: int) -> list[str]:
        why = f"{answers.n_participants - n[place]} {'tied or without an answer' if answers.missing else 'tied'}"
        return [
            ", ".join(f"{answers.answers[kind].name} {kinds[place, kind]}" for kind in felt),
            f"{nothing.name} {n[place] - kinds[place, felt].sum()}, left out of the test" if nothing else "",
            f"most frequent answer of each participant, {why} and left out" if answers.n_repetitions > 1 else "",
        ]

    share = Interval.point(clopper_pearson(kinds[..., felt].max(axis=-1), n).estimate, n)
    return FamilyResult(
        [scope for _, scope in cells],
        [f"P({label})" for label in named],
        multinomial_test(kinds[..., felt]),
        share,
        n,
        notes,
    )


def _cells_of(answers: AnswerCounts) -> tuple[list[tuple[int, str]], IntArray]:
    """Return pair index and scope of each cell, and the number of participants by most frequent answer."""
    cells = product(answers.pair_cells, answers.levels)
    kinds = answers.n_modal.reshape(*answers.n_modal.shape[:-4], -1, len(answers.answers))
    return [(q, f"{scope} {answers.scale.say(level)}") for (_, q, scope), level in cells], kinds


def cell_share_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield the share of the effect, or of each answer, among participants' most frequent answers in each cell."""
    cells, kinds = _cells_of(answers)
    for (q, scope), own in zip(cells, kinds, strict=True):
        left_out = answers.n_participants - int(own.sum())
        tied = f"of each participant's most frequent answer; tied or without an answer, and left out: {left_out}"
        for label, place in answers.effects(answers.pairs[q])[: None if answers.is_nominal else 1]:
            share, n = clopper_pearson(own[place], own.sum()), int(own.sum())
            notes = [tied] if answers.n_repetitions > 1 else []
            yield finding_of("a1", "share in a cell, exact interval", scope, None, f"P({label})", share, n, notes=notes)


def joint_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield joint tests of all unordered answers over levels, finger conditions and pairs of zones."""
    from modaltouch.analysis.permutation import association_test

    counts, pairs = answers.counts, [pair.label for pair in answers.pairs]
    over_levels = counts.sum(axis=3)
    for question, scopes, own in (
        ("b", [scope for *_, scope in answers.pair_cells], np.concatenate(np.moveaxis(counts, 0, 2))),
        ("c", pairs, over_levels.transpose(2, 0, 1, 3)),
        ("d", answers.finger_conditions, over_levels.swapaxes(0, 1)),
    ):
        if own.shape[-2] > 1:
            where = " over levels" * (question == "b")
            test, n = association_test(own), len(counts)
            name = f"all answers together{where}, shuffles within participants"
            for place, scope in enumerate(scopes):
                yield finding_of(
                    question, name, scope, test[place], "shares of all answers", Interval.point(math.nan, n), n,
                    family=f"{question} together",
                )  # fmt: skip


def dominance(answers: AnswerCounts) -> Contrast | None:
    """Return the contrast of the dominant and the other zone of each pair, over all levels."""
    if not answers.compares:
        return None
    first, second = (answers.shares(each).joined(2) for each in (answers.dominant, answers.other))
    score, pairs = (first.given - second.given).sum(axis=-1), answers.pairs

    def notes(place: int) -> list[str]:
        f, q, _ = answers.pair_cells[place]
        *given, last = [
            f"{int(answers.counts[:, f, q, :, kind].sum())} "
            f"{answers.answers[kind].name if kind == answers.both_place else label}"
            for label, kind in answers.labelled(pairs[q])
        ]
        chosen = ", ".join(given) + (f" and {last}" if answers.has_none_answer else f", {last}")
        return [
            f"{chosen} of {int(first.answered[place].sum())} answers",
            f"{int((score[place] > 0).sum())} of {answers.n_participants} participants lean to {pairs[q].dominant}",
        ]

    return Contrast(
        [scope for *_, scope in answers.pair_cells],
        [f"P({pairs[q].dominant}) - P({pairs[q].other})" for _, q, _ in answers.pair_cells],
        first,
        second,
        notes,
    )


def leaning_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield the share of participants who prefer the dominant zone of a pair, out of those who prefer either zone."""
    score = answers.shares(answers.dominant - answers.other).joined(2).given.sum(axis=-1)
    leaning = (score != 0).sum(axis=-1)
    test, share = sign_test(score), clopper_pearson((score > 0).sum(axis=-1), leaning)
    for place, (_, q, scope) in enumerate(answers.pair_cells):
        quantity = f"share leaning to {answers.pairs[q].dominant} of those who lean"
        yield finding_of(
            "a2", "exact sign test of leaning participants", scope, test[place], quantity, share[place],
            int(leaning[place]),
        )  # fmt: skip


def _levels_of(answers: AnswerCounts) -> tuple[list[str], list[str], Shares]:
    """Return scopes, labels and shares for tests over levels: of the dominant zone, or else of each answer."""
    effects = answers.of_effects[: 1 if answers.compares else None]
    of_pairs = effects[0] if len(effects) == 1 else np.stack(effects, axis=-3)
    asked = answers.answered if len(effects) == 1 else np.stack([answers.answered] * len(effects), axis=-3)
    shape = (*answers.counts.shape[:-5], -1, *of_pairs.shape[-2:])
    labels = [label for _, q, _ in answers.pair_cells for label, _ in answers.effects(answers.pairs[q])[: len(effects)]]
    places = [scope for *_, scope in answers.pair_cells for _ in effects]
    scopes = [f"{place}{f' {label}' * (len(effects) > 1)}" for place, label in zip(places, labels, strict=True)]
    return scopes, labels, Shares(of_pairs.reshape(shape), asked.reshape(shape), answers.n_repetitions)


def level_tests(answers: AnswerCounts) -> FamilyResult | None:
    """Return tests of a trend over levels in any participant's choices; None for a single level."""
    if len(answers.levels) < 2:
        return None
    scopes, labels, shares = _levels_of(answers)
    test = trend_test(shares.given, answers.levels, shares.answered)
    n_most = shares.answered.sum(axis=-1).max()
    many = f"p by the normal approximation, since there are more than {MOST_EXACT} answers per participant"
    return FamilyResult(
        scopes,
        [f"change of P({label}) with the level" for label in labels],
        test,
        Interval.point(np.full(test.statistic.shape, math.nan), answers.n_participants),
        notes=lambda place: [
            f"{test.n_informative[place]} of {answers.n_participants} participants changed their answer",
            many if n_most > MOST_EXACT else "",
        ],
    )


def slopes(answers: AnswerCounts) -> MeanScores | None:
    """Return the least-squares slopes over levels, for participants with answers at all levels."""
    scopes, labels, shares = _levels_of(answers)
    centred = np.asarray(answers.levels) - np.mean(answers.levels)
    if not centred.any():
        return None
    weights = answers.scale.step * centred / (centred**2).sum()
    rising, falling = np.maximum(weights, 0), np.maximum(-weights, 0)
    steepest = float(rising.sum())
    return MeanScores(
        scopes,
        [f"change of P({label}) per {answers.scale.step_in_words}" for label in labels],
        shares.known @ weights,
        steepest,
        shares,
        shares.least @ rising - shares.most @ falling,
        shares.most @ rising - shares.least @ falling,
    )


def conditions_compared(answers: AnswerCounts) -> Contrast | None:
    """Return the contrasts between finger conditions of the share of each effect, by pair."""
    names, chosen = answers.finger_conditions, [answers.shares(each) for each in answers.of_effects]
    compared = list(combinations(range(len(names)), 2))
    if not (compared and chosen):
        return None
    first, second = (Shares.stacked([each.at(places[i], -4) for each in chosen for places in compared]) for i in (0, 1))
    labels = [[label for label, _ in answers.effects(pair)] for pair in answers.pairs]
    places = list(product(range(len(chosen)), compared, range(len(answers.pairs))))
    return Contrast(
        [
            f"{names[f]} - {names[g]} {answers.pairs[q].label}"
            f"{f' {labels[q][nth]}' * bool(nth or not answers.compares)}"
            for nth, (f, g), q in places
        ],
        [f"difference of P({labels[q][nth]})" for nth, _, q in places],
        first,
        second,
    )


def pairs_compared(answers: AnswerCounts) -> Contrast | None:
    """Return the contrasts between pairs of the share of "both" or, without a dominant zone, of each answer."""
    effects = slice(1 if answers.compares else 0, None)
    chosen = [answers.shares(each) for each in answers.of_effects[effects]]
    names = [pair.label for pair in answers.pairs]
    compared = list(combinations(range(len(names)), 2))
    if not (compared and chosen):
        return None
    first, second = (
        Shares.stacked([each.at([places[i] for places in compared], -3).joined(2) for each in chosen]) for i in (0, 1)
    )
    labels = [label for label, _ in answers.effects(answers.pairs[0])[effects]]
    tests = list(product(labels, answers.finger_conditions, compared))
    return Contrast(
        [f"{condition} {names[q]} - {names[r]}{f' {label}' * (len(labels) > 1)}" for label, condition, (q, r) in tests],
        [f"difference of P({label})" for label, _, _ in tests],
        first,
        second,
    )


def _tests_of(contrast: Contrast | None, tests: Callable[[Contrast], FamilyResult | None]) -> FamilyResult | None:
    return None if contrast is None else tests(contrast)


_SHARP_NULL = "exact sign-flip test that no participant differs"
_ON_AVERAGE = "mean over participants, test and interval of a bounded mean"

STATISTICS: dict[str, Statistic] = {
    "a1": Statistic(
        "a1", "does a cell differ from guessing",
        "exact multinomial test of all answers against chance", chance_tests, "share",
        lambda levels, n, n_repetitions, margin: float(multinomial_test([n, 0, 0]).p), against_guessing=True,
    ),
    "a2": Statistic(
        "a2", "is one zone chosen more than the other by any participant", "exact sign-flip test of net dominance",
        lambda answers: _tests_of(dominance(answers), signs_of),
    ),
    "a2 mean": Statistic(
        "a2", "is one zone chosen more than the other on average", f"net dominance, {_ON_AVERAGE}",
        lambda answers: _tests_of(dominance(answers), means_of),
    ),
    "b": Statistic(
        "b", "does the choice change with the level in any participant",
        "exact trend test that no participant's answers change with the level", level_tests,
        "", lambda levels, n, n_repetitions, margin: smallest_trend_p(levels, n, n_repetitions),
    ),
    "b mean": Statistic(
        "b", "does the choice change with the level on average", f"slope, {_ON_AVERAGE}",
        lambda answers: None if (found := slopes(answers)) is None else means_of(found), "slope per 100 mm/s",
    ),
    "c": Statistic(
        "c", "do the answers differ between finger conditions in any participant", _SHARP_NULL,
        lambda answers: _tests_of(conditions_compared(answers), signs_of),
    ),
    "c mean": Statistic(
        "c", "do the answers differ between finger conditions on average", f"difference, {_ON_AVERAGE}",
        lambda answers: _tests_of(conditions_compared(answers), means_of),
    ),
    "c alike": Statistic(
        "c", "are the finger conditions alike on average, within the margin of the protocol",
        "equivalence, two one-sided tests of a bounded mean, with the 90 % interval",
        lambda answers: _tests_of(
            conditions_compared(answers), lambda contrast: equivalence_of(contrast.scores, answers.margin)
        ),
        smallest_p=lambda levels, n, n_repetitions, margin: float(BoundedMean([0.0] * n).equivalence(margin or 0.0).p),
        when_alike=True,
    ),
    "d": Statistic(
        "d", "do the pairs of zones differ in any participant", _SHARP_NULL,
        lambda answers: _tests_of(pairs_compared(answers), signs_of),
    ),
    "d mean": Statistic(
        "d", "do the pairs of zones differ on average", f"difference, {_ON_AVERAGE}",
        lambda answers: _tests_of(pairs_compared(answers), means_of),
    ),
}  # fmt: skip
"""Families of tests, with Holm's correction in each."""


def family_findings(family: str, answers: AnswerCounts) -> Iterator[Finding]:
    """Yield the tests of a family (a key of `STATISTICS`) for a single experiment."""
    statistic = STATISTICS[family]
    found = statistic.compute(answers)
    if found is None:
        return
    for place, (scope, quantity) in enumerate(zip(found.scopes, found.quantities, strict=True)):
        n = answers.n_participants if found.n is None else int(found.n[place])
        test, interval = found.test[place], found.interval[place]
        yield finding_of(
            statistic.question, statistic.name, scope, test, quantity, interval, n, family=family,
            notes=found.notes(place),
        )  # fmt: skip


def find(answers: AnswerCounts, frame: pd.DataFrame, of_design: Iterable[Finding] = ()) -> list[Finding]:
    """Compute the statistics of the answers, in the order of the questions.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    frame : DataFrame
        Tidy answers, for trial order and reaction times.
    of_design : iterable of Finding
        Findings on catch trials and individual measures, such as d' or ratings.
    """
    return correct(uncorrected(answers, frame, of_design))


def uncorrected(answers: AnswerCounts, frame: pd.DataFrame, of_design: Iterable[Finding] = ()) -> list[Finding]:
    """Compute the statistics as in `find`, before Holm's correction."""
    findings = [
        *of_design,
        *(_choice_findings(answers) if len(answers.answers) > 1 else ()),
        *secondary_findings(answers, frame),
    ]
    order = questions()
    return sorted(findings, key=lambda finding: order.index(finding.question))


def _choice_findings(answers: AnswerCounts) -> Iterator[Finding]:
    for family in STATISTICS:
        yield from (own := list(family_findings(family, answers)))
        if family == "a1" and own:
            yield from cell_share_findings(answers)
        if family == "a2" and answers.compares:
            yield from leaning_findings(answers)
    if answers.is_nominal:
        yield from joint_findings(answers)
    yield from consistency_findings(answers)
    yield from effect_findings(answers)


def questions() -> list[str]:
    """Return the questions in the order of the report: those with families of tests, then secondary ones."""
    return [*_OF_DESIGN, *dict.fromkeys(each.question for each in STATISTICS.values()), *_FURTHER]


_OF_DESIGN = ("shares", "sensitivity", "function", "rating", "group")
_FURTHER = ("e", "f", "catch", "side", "order", "time", "speed")
