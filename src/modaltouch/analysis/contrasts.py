"""Shares of answers, and their contrasts: tests of exchangeability, of the mean difference, and of equivalence."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from modaltouch.analysis.exact import ExactTest, sign_flip_test
from modaltouch.analysis.findings import ALPHA, holm
from modaltouch.analysis.intervals import BoundedMean, Interval
from modaltouch.analysis.sums import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Shares:
    """Counts of one answer out of all answers given and scheduled; arrays of the same shape, levels last.

    Attributes
    ----------
    given : array of int
        Counts of this answer.
    answered : array of int
        Counts of all answers.
    asked : int
        Number of scheduled answers.
    """

    given: IntArray
    answered: IntArray
    asked: int

    def at(self, place: int | list[int], axis: int) -> Shares:
        """Select along an axis."""
        return Shares(self.given.take(place, axis), self.answered.take(place, axis), self.asked)

    def joined(self, n_after: int) -> Shares:
        """Flatten the axes of finger conditions and pairs (the last two before `n_after` axes) to one axis of tests."""
        after = self.given.ndim - n_after
        shape = (*self.given.shape[: after - 2], -1, *self.given.shape[after:])
        return Shares(self.given.reshape(shape), self.answered.reshape(shape), self.asked)

    @classmethod
    def stacked(cls, parts: Sequence[Shares]) -> Shares:
        """Concatenate several along the axis of tests."""
        given, answered = (np.concatenate([getattr(p, name) for p in parts], axis=-3) for name in ("given", "answered"))
        return cls(given, answered, parts[0].asked)

    @property
    def known(self) -> FloatArray:
        """Share of the answers given [1]; NaN without any."""
        nothing = np.full(self.given.shape, np.nan)
        return np.asarray(np.divide(self.given, self.answered, out=nothing, where=self.answered > 0))

    @property
    def mean(self) -> FloatArray:
        """Mean share over the levels with answers [1]; NaN without any."""
        return mean_of_known(self.known)

    @property
    def least(self) -> FloatArray:
        """Share if all missing answers were other ones [1]."""
        return np.asarray(self.given / self.asked)

    @property
    def most(self) -> FloatArray:
        """Share if all missing answers were this one [1]."""
        return np.asarray((self.given + self.asked - self.answered) / self.asked)


def mean_of_known(values: FloatArray) -> FloatArray:
    """Return the mean of the finite values along the last axis; NaN without any."""
    known = np.isfinite(values)
    # einsum is three times faster than sum for few values.
    n, total = np.einsum("...i->...", known.astype(float)), np.einsum("...i->...", np.where(known, values, 0.0))
    return np.asarray(np.divide(total, n, out=np.full(n.shape, np.nan), where=n > 0))


@dataclass(frozen=True, eq=False)
class FamilyResult:
    """Results of a family of tests, corrected together by Holm's method, for one experiment or a batch.

    Attributes
    ----------
    scopes : sequence of str
        Scope of each test.
    quantities : sequence of str
        Quantity estimated with each test.
    test : ExactTest
        The tests, arrays of shape (..., n_tests).
    interval : Interval
        Estimates and intervals, of the same shape.
    n : array of int, optional
        Number of participants in each test, of the same shape; by default all.
    notes : callable
        Maps the index of a test in a single experiment to its notes.
    """

    scopes: Sequence[str]
    quantities: Sequence[str]
    test: ExactTest
    interval: Interval
    n: IntArray | None = None
    notes: Callable[[int], Sequence[str]] = lambda place: ()

    @property
    def quick_p_holm(self) -> FloatArray:
        """Holm-adjusted `quick_p` of the tests, (..., n_tests) array [1]."""
        return holm(self.test.quick_p)


@dataclass(frozen=True, eq=False)
class MeanScores:
    """Bounded scores of participants, to be averaged in each test of a family.

    Attributes
    ----------
    scopes, quantities : sequence of str
        As in `FamilyResult`.
    scores : (..., n_tests, n_participants) array
        Scores from -scale to scale; NaN for participants without one.
    scale : float
        Largest possible score.
    shares : Shares
        Shares of answers from which the scores were computed.
    lowest, highest : array
        Bounds of the scores over all possible values of the missing answers.
    notes : callable
        As in `FamilyResult`.
    """

    scopes: Sequence[str]
    quantities: Sequence[str]
    scores: FloatArray
    scale: float
    shares: Shares
    lowest: FloatArray
    highest: FloatArray
    notes: Callable[[int], Sequence[str]] = lambda place: ()

    @property
    def mean(self) -> BoundedMean:
        """Mean of the scores over participants."""
        return BoundedMean(self.scores, -self.scale, self.scale)

    def say(self, place: int) -> list[str]:
        """Return the notes on a test, with the number of missing answers and their worst-case effect."""
        answered = self.shares.answered[place]
        n_asked = answered.size * self.shares.asked
        n_missing = n_asked - int(answered.sum())
        if not n_missing:
            return [*self.notes(place)]
        means = [BoundedMean(each[place], -self.scale, self.scale) for each in (self.lowest, self.highest)]
        low, high = (mean.interval() for mean in means)
        # If the extreme means differ in sign, missing answers could make the mean zero.
        p = 1.0 if low.estimate <= 0 <= high.estimate else max(float(mean.test().p) for mean in means)
        return [
            *self.notes(place),
            f"{n_missing} of {n_asked} answers missing; with them the estimate could be {low.estimate:.3g} to "
            f"{high.estimate:.3g}, its interval {low.low:.3g} to {high.high:.3g} and p at most {p:.2g}",
        ]


@dataclass(frozen=True, eq=False)
class Contrast:
    """Two shares of each participant, to be compared in each test of a family.

    Attributes
    ----------
    scopes, quantities, notes
        As in `MeanScores`.
    first, second : Shares
        The shares, (..., n_tests, n_participants, n_levels) arrays.
    """

    scopes: Sequence[str]
    quantities: Sequence[str]
    first: Shares
    second: Shares
    notes: Callable[[int], Sequence[str]] = lambda place: ()

    @property
    def scores(self) -> MeanScores:
        """Difference of the two shares, averaged over levels with answers in both [1]."""
        first, second = self.first, self.second
        return MeanScores(
            self.scopes,
            self.quantities,
            mean_of_known(first.known - second.known),
            1.0,
            Shares(first.given, np.minimum(first.answered, second.answered), first.asked),
            (first.least - second.most).mean(axis=-1),
            (first.most - second.least).mean(axis=-1),
            self.notes,
        )


def signs_of(contrast: Contrast) -> FamilyResult:
    """Return exact sign-flip tests of the null hypothesis that each participant's two shares are exchangeable.

    Answers within a condition may be dependent, so the conditions of a participant are exchanged as a whole. This is
    exact with equally many answers at each level in both; otherwise, surplus answers are dropped at random.
    """
    first, second = contrast.first, contrast.second
    n_kept = np.minimum(first.answered, second.answered)
    n_left_out = (first.answered + second.answered - 2 * n_kept).sum(axis=(-2, -1))
    score = first.given - second.given
    for at in map(tuple, np.argwhere(n_left_out)):
        score[at] = _drawn_differences(contrast, at, 1)[0]
    mean = contrast.scores.mean

    def notes(place: int) -> list[str]:
        if not (n := int(n_left_out[place])):
            return [*contrast.notes(place)]
        p = sign_flip_test(_drawn_differences(contrast, place, 200).sum(axis=-1)).quick_p
        low, high = np.quantile(p, [0.05, 0.95])
        note = f"{n} answers left out of the test, drawn at random to have equal numbers at each level; nine in ten"
        return [*contrast.notes(place), f"{note} other draws give p from {low:.2g} to {high:.2g}"]

    test, interval = sign_flip_test(score.sum(axis=-1)), Interval.point(mean.estimate, mean.n)
    return FamilyResult(contrast.scopes, contrast.quantities, test, interval, notes=notes)


def _drawn_differences(contrast: Contrast, at: int | tuple[int, ...], n_draws: int) -> IntArray:
    """Draw equally many answers at each level for one test, and return the differences of the two counts by draw.

    The seed depends on the counts but not on the order of participants, so that the same answers have the same p.
    """
    counts = ((each.given[at], each.answered[at]) for each in (contrast.first, contrast.second))
    table = np.stack([np.stack([given, answered - given], axis=-1) for given, answered in counts], axis=1)
    table = table[np.lexsort(table.reshape(len(table), -1).T)]
    good, bad = np.moveaxis(table, -1, 0)
    n_kept = (good + bad).min(axis=1, keepdims=True)
    rng = np.random.default_rng(zlib.crc32(table.tobytes()))
    drawn = rng.hypergeometric(good, bad, n_kept, size=(n_draws, *good.shape))
    return np.asarray(drawn[:, :, 0] - drawn[:, :, 1])


def means_of(compared: Contrast | MeanScores) -> FamilyResult:
    """Return tests of the null hypothesis of no mean difference, with the intervals that invert them."""
    scores = compared.scores if isinstance(compared, Contrast) else compared
    mean = scores.mean
    return FamilyResult(scores.scopes, scores.quantities, mean.test(), mean.interval(), mean.n, scores.say)


def equivalence_of(scores: MeanScores, margin: float | None) -> FamilyResult | None:
    """Return equivalence tests of a mean difference within a margin; None without a margin."""
    if margin is None:
        return None
    mean = scores.mean
    test, interval = mean.equivalence(margin), mean.interval(0.9)

    def notes(place: int) -> list[str]:
        shown = "shown" if test.p[place] <= ALPHA else "not shown"
        return [f"{shown} to be alike within {margin:g} by this test alone; 90 % interval"]

    return FamilyResult(scores.scopes, scores.quantities, test, interval, mean.n, notes)
