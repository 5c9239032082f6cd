"""The statistics of the experiment: every question of the plan as rows of one tidy table.

The participant is the unit of inference. Tests are exact, or Monte Carlo with a stated seed and interval; each
p stands beside the smallest p its data could have given.

`STATISTICS` holds the families of tests. Each is one function of the counted answers, of one experiment or of a batch:
the analysis prints what it finds, and planning counts in how many of its simulated experiments it finds it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.catches import Catches, catch_findings
from modaltouch.analysis.consistency import association_findings, consistency_findings, effect_findings
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.covariates import secondary_findings
from modaltouch.analysis.exact import ExactTest, multinomial_test, sign_flip_test, sign_test
from modaltouch.analysis.findings import Finding, correct, finding_of
from modaltouch.analysis.intervals import Interval, clopper_pearson, clustered_difference, mean_slope
from modaltouch.analysis.trend import smallest_trend_p, trend_test

IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class FamilyResult:
    """What a family of tests, corrected together by Holm's method, finds in an experiment or a batch of them.

    Attributes
    ----------
    scopes : sequence of str
        What each test is about.
    quantities : sequence of str
        What each test estimates.
    test : ExactTest
        The tests, arrays of shape (..., n_tests).
    interval : Interval
        The estimates, of the same shape.
    n : array of int, optional
        Participants that each test rests on, of the same shape; by default all.
    notes : callable
        The notes of a test of a single experiment, by its place.
    """

    scopes: Sequence[str]
    quantities: Sequence[str]
    test: ExactTest
    interval: Interval
    n: IntArray | None = None
    notes: Callable[[int], Sequence[str]] = lambda place: ()


def _unanimous_p(levels: Sequence[float], n_participants: int, n_repetitions: int) -> float:
    """Return p where all participants lean one way."""
    return float(2.0 ** (1 - n_participants))


def _one_answer_p(levels: Sequence[float], n_participants: int, n_repetitions: int) -> float:
    """Return p where all participants give one answer of three."""
    return float(multinomial_test([n_participants, 0, 0]).p)


@dataclass(frozen=True)
class Statistic:
    """A family of tests, to be printed by the analysis and powered by planning.

    Attributes
    ----------
    question : str
        Question of the report under which it stands.
    asks : str
        What it asks, for the report and the picture of a plan.
    name : str
        Name of its tests.
    compute : callable
        Takes the counts of answers, of one experiment or a batch, and returns what it finds; None where these answers
        or this design have no such test.
    unit : str
        What its intervals are of.
    smallest_p : callable
        From the levels, the number of participants and that of repetitions, the smallest p that a test can give,
        however the answers fall; by default that of sign flips.
    against_guessing : bool
        Whether there is nothing to be found where participants guess, rather than where both fingers feel alike.
    """

    question: str
    asks: str
    name: str
    compute: Callable[[AnswerCounts], FamilyResult | None]
    unit: str = "difference of shares"
    smallest_p: Callable[[Sequence[float], int, int], float] = _unanimous_p
    against_guessing: bool = False


def chance_tests(answers: AnswerCounts) -> FamilyResult | None:
    """Return whether cells differ from guessing, all answers alike.

    One answer of each participant enters a cell: the one given, or with repetitions the most frequent; ties are
    left out and counted in the note. Where "felt nowhere" is an answer too, the test is of those who felt something
    (given how many they are, guesses are even over the others whatever the chance of that one), the share of all.
    """
    felt = answers.felt
    if len(felt) < 2:
        return None
    shown = [answers.effects(pair)[0] for pair in answers.pairs]
    kinds = answers.n_modal
    chosen = np.stack([kinds[..., q, :, place] for q, (_, place) in enumerate(shown)], axis=-2)
    chosen, kinds = chosen.reshape(*chosen.shape[:-3], -1), kinds.reshape(*kinds.shape[:-4], -1, kinds.shape[-1])
    n, nothing = kinds.sum(axis=-1), answers.answers.naming()

    def notes(place: int) -> list[str]:
        said = [", ".join(f"{answers.answers[kind].name} {kinds[place, kind]}" for kind in felt)]
        if nothing is not None:
            said.append(f"{nothing.name} {n[place] - kinds[place, felt].sum()}, left out of the test")
        if answers.n_repetitions > 1:
            ties = answers.n_participants - n[place]
            said.append(f"most frequent answer of each participant, {ties} tied and left out")
        return said

    cells = list(product(answers.pair_cells, answers.levels))
    return FamilyResult(
        [f"{scope} {answers.scale.say(level)}" for (*_, scope), level in cells],
        [f"P({shown[q][0]})" for (_, q, _), _ in cells],
        multinomial_test(kinds[..., felt]),
        clopper_pearson(chosen, n),
        n,
        notes,
    )


def dominance_tests(answers: AnswerCounts) -> FamilyResult | None:
    """Return whether one zone of a pair is chosen more than the other, over all levels."""
    if not answers.compares:
        return None
    first, second = (_joined(each.sum(axis=-1), 1) for each in (answers.dominant, answers.other))
    score, pairs = first - second, answers.pairs

    def notes(place: int) -> list[str]:
        f, q, _ = answers.pair_cells[place]
        *given, last = [
            f"{int(answers.counts[:, f, q, :, kind].sum())} "
            f"{answers.answers[kind].name if kind == answers.both_place else label}"
            for label, kind in answers.labelled(pairs[q])
        ]
        chosen = ", ".join(given) + (f" and {last}" if answers.offers_none else f", {last}")
        leaning = (
            f"{int((score[place] > 0).sum())} of {answers.n_participants} participants lean to {pairs[q].dominant}"
        )
        return [f"{chosen} of {answers.n_participants * answers.n_answers} answers", leaning]

    return FamilyResult(
        [scope for *_, scope in answers.pair_cells],
        [f"P({pairs[q].dominant}) - P({pairs[q].other})" for _, q, _ in answers.pair_cells],
        sign_flip_test(score),
        clustered_difference(first, second, answers.n_answers),
        notes=notes,
    )


def leaning_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Yield how many participants lean to the dominant zone of each pair."""
    n = answers.n_participants
    score = _joined((answers.dominant - answers.other).sum(axis=-1), 1)
    test, share = sign_test(score), clopper_pearson((score > 0).sum(axis=-1), n)
    for place, (_, q, scope) in enumerate(answers.pair_cells):
        quantity = f"share of participants leaning to {answers.pairs[q].dominant}"
        name = "exact sign test of leaning participants"
        yield finding_of("a2", name, scope, test[place], quantity, share[place], n)


def level_tests(answers: AnswerCounts) -> FamilyResult:
    """Return whether the choice of the dominant zone changes with the level; else that of each answer."""
    effects = answers.of_effects[: 1 if answers.compares else None]
    of_pairs = effects[0] if len(effects) == 1 else np.stack(effects, axis=-3)
    chosen = of_pairs.reshape(*answers.counts.shape[:-5], -1, *effects[0].shape[-2:])
    test = trend_test(chosen, answers.levels, answers.n_repetitions)
    labels = [label for _, q, _ in answers.pair_cells for label, _ in answers.effects(answers.pairs[q])[: len(effects)]]
    alone = ["one level only: a trend needs two"] if len(answers.levels) < 2 else []
    return FamilyResult(
        [scope for *_, scope in answers.pair_cells for _ in effects],
        [f"change of P({label}) per {answers.scale.step_in_words}" for label in labels],
        test,
        mean_slope(chosen / answers.n_repetitions, answers.levels, answers.scale.step),
        notes=lambda place: [
            f"{test.n_informative[place]} of {answers.n_participants} participants changed their answer",
            *alone,
        ],
    )


def condition_tests(answers: AnswerCounts, effects: slice) -> FamilyResult | None:
    """Return whether finger conditions differ in the shares of some effects."""
    names, chosen = answers.finger_conditions, answers.of_effects[effects]
    compared = list(combinations(range(len(names)), 2))
    if not (compared and chosen):
        return None
    first, second = (
        np.concatenate([each[..., places[i], :, :, :] for each in chosen for places in compared], axis=-3)
        for i in (0, 1)
    )
    test, interval = _compare(first, second, answers)
    labels = [[label for label, _ in answers.effects(pair)[effects]] for pair in answers.pairs]
    places = list(product(range(len(chosen)), compared, range(len(answers.pairs))))

    def notes(place: int) -> list[str]:
        margin = max(abs(interval.low[place]), abs(interval.high[place]))
        return [f"shows equivalence only within a margin of {margin:.2f}"]

    return FamilyResult(
        [f"{names[f]} - {names[g]} {answers.pairs[q].label}" for _, (f, g), q in places],
        [f"difference of P({labels[q][nth]})" for nth, _, q in places],
        test,
        interval,
        notes=notes,
    )


def pair_tests(answers: AnswerCounts) -> FamilyResult | None:
    """Return whether "both" is answered more often for one pair of zones than for another.

    Without a dominant zone the same is asked of each answer.
    """
    effects = slice(1 if answers.compares else 0, None)
    names, chosen = [pair.label for pair in answers.pairs], answers.of_effects[effects]
    compared = list(combinations(range(len(names)), 2))
    if not (compared and chosen):
        return None
    first, second = (
        np.concatenate([_joined(each[..., [places[i] for places in compared], :, :], 2) for each in chosen], axis=-3)
        for i in (0, 1)
    )
    labels = [label for label, _ in answers.effects(answers.pairs[0])[effects]]
    tests = list(product(labels, answers.finger_conditions, compared))
    return FamilyResult(
        [f"{condition} {names[q]} - {names[r]}" for _, condition, (q, r) in tests],
        [f"difference of P({label})" for label, _, _ in tests],
        *_compare(first, second, answers),
    )


def _compare(first: IntArray, second: IntArray, answers: AnswerCounts) -> tuple[ExactTest, Interval]:
    """Return the tests between counts, (..., n_tests, n_participants, n_levels) arrays, and the differences of shares.

    Answers to the same level are paired. Repetitions have no natural partner, so every pairing is averaged.
    """
    n = answers.n_repetitions
    only_first, only_second = (first * (n - second)).sum(axis=-1), (second * (n - first)).sum(axis=-1)
    interval = clustered_difference(only_first / n, only_second / n, answers.n_answers)
    return sign_flip_test((only_first - only_second) // n), interval


def _joined(counts: IntArray, n_after: int) -> IntArray:
    """Return counts with finger conditions and pairs, which end before some axes, as one axis of tests."""
    after = counts.ndim - n_after
    return counts.reshape(*counts.shape[: after - 2], -1, *counts.shape[after:])


_DOMINANT, _REST = slice(0, 1), slice(1, None)

STATISTICS: dict[str, Statistic] = {
    "a1": Statistic(
        "a1", "does a cell differ from guessing", "exact multinomial test against chance", chance_tests,
        "share", _one_answer_p, against_guessing=True,
    ),
    "a2": Statistic(
        "a2", "is one zone chosen more than the other", "exact sign-flip test of net dominance", dominance_tests,
    ),
    "b": Statistic(
        "b", "does the choice of the dominant zone change with the level",
        "exact trend test, levels shuffled within participants", level_tests, "slope per 100 mm/s", smallest_trend_p,
    ),
    "c": Statistic(
        "c", "does the choice of the dominant zone differ between finger conditions",
        "exact sign-flip test between finger conditions",
        lambda answers: condition_tests(answers, _DOMINANT if answers.compares else slice(None)),
    ),
    "c both": Statistic(
        "c", 'does "both" differ between finger conditions', "exact sign-flip test between finger conditions",
        lambda answers: condition_tests(answers, _REST) if answers.compares else None,
    ),
    "d": Statistic(
        "d", 'is "both" answered more often for one pair than for another', "exact sign-flip test between pairs",
        pair_tests,
    ),
}  # fmt: skip
"""Families of tests, each corrected by Holm's method."""


def family_findings(family: str, answers: AnswerCounts) -> Iterator[Finding]:
    """Yield the tests of a family, one of `STATISTICS`, in a single experiment."""
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
    tested = {family: list(family_findings(family, answers)) for family in STATISTICS}
    if answers.compares:
        tested["a2"] = list(chain.from_iterable(zip(tested["a2"], leaning_findings(answers), strict=True)))
    findings = [
        *chain.from_iterable(tested.values()),
        *association_findings(answers),
        *consistency_findings(answers),
        *effect_findings(answers),
        *catch_findings(answers, catches or {}),
        *secondary_findings(answers, frame),
    ]
    order = questions()
    return sorted(correct(findings), key=lambda finding: order.index(finding.question))


def questions() -> list[str]:
    """Return the questions in the order of the report: those with families of tests, then the further ones."""
    return [*dict.fromkeys(each.question for each in STATISTICS.values()), *_FURTHER]


_FURTHER = ("e", "f", "catch", "side", "order", "time", "speed")
