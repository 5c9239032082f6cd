"""Certificates of the measures of each participant and of their means: d', thresholds, exponents and ratings.

People are drawn from a population and answer by the model that is fitted; each measure of one person is a row of its
own. A mean is certified by experiments that draw participants from 2,000 such people (500 of those who are fitted
twice): against their true mean, and "as estimated" against the mean of the estimates from as many trials over all of
them, including its bias.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice

import numpy as np
from scipy.special import ncfdtr, ndtr, xlogy

from modaltouch.analysis.designs import power_law
from modaltouch.analysis.detection import m_intervals, odd_of_three, same_different, share_correct, yes_no
from modaltouch.analysis.intervals import BoundedMean, Interval, student_interval
from modaltouch.analysis.permutation import by_ranks, flip_test, friedman, rank_test, shuffle_test
from modaltouch.analysis.psychometric import JND_OF_SPREAD, MOST_LAPSE, Fits, fit_counts
from modaltouch.protocol.conditions import StaircaseSection
from modaltouch.protocol.levels import Quest

ALPHA = 0.05
TIES = 1 + 1e-9
LEVELS_DB = np.arange(-20.0, 20.5, 2.0)
"""Levels of an adaptive run, about the middle of the population [dB]."""

START = 16
"""Place of the level of its first trial."""

LEAST_DB = 0.5
"""Means of levels are of numbers rounded to this [dB], so that sign flips are counted soon."""

MANY = "its likelihood ratio follows the chi-squared distribution only for large numbers of trials"
RUNS = "there are few trials, at levels that depend on earlier answers"
BIASED = "thresholds from few trials are biased, and participants without a threshold are left out"
SHRUNK = "the correction that keeps every d' and criterion finite biases their differences towards zero"
KEPT_FINITE = "the correction that keeps every d' finite biases it"
NEVER_BELOW = "of the odd one of three, d' is never below 0, which biases small ones upwards"
FITTED_FEW = "estimates from few trials are biased, and participants without one are left out"
SKEWED = "a few participants may use much larger numbers, which sign flips take for symmetric"
REASONS = {
    "threshold of one": MANY, "PSE of one": MANY, "JND of one": MANY,
    "run of one, forced choice": RUNS, "run of one, felt": RUNS,
    "mean threshold": BIASED, "mean PSE": BIASED, "mean of runs, forced choice": BIASED, "mean of runs, felt": BIASED,
    "mean of runs, forced choice, as estimated": "Student's interval ignores the skew of thresholds from short runs",
    "mean JND": "spreads fitted to few trials are too small, which biases every JND downwards",
    "mean d'": "the correction that keeps every d' finite biases it towards zero, more so with fewer trials",
    "mean criterion": "the correction that keeps every criterion finite biases it towards zero",
    "mean d' compared": SHRUNK, "mean criterion compared": SHRUNK,
    "mean threshold compared": FITTED_FEW, "mean PSE compared": FITTED_FEW, "mean JND compared": FITTED_FEW,
    "mean of runs compared, forced choice": FITTED_FEW, "mean of runs compared, felt": FITTED_FEW,
    "mean of runs, forced choice, QUEST+": BIASED, "mean of runs, felt, QUEST+": BIASED,
    "mean of runs compared, forced choice, QUEST+": FITTED_FEW, "mean of runs compared, felt, QUEST+": FITTED_FEW,
    "mean detection threshold": FITTED_FEW, "mean detection threshold compared": FITTED_FEW,
    "mean d', same and different": KEPT_FINITE, "mean d' compared, same and different": SHRUNK,
    "mean differencing criterion compared": SHRUNK,
    "mean d', of three": KEPT_FINITE, "mean d' compared, of three": SHRUNK,
    "mean d', odd of three": NEVER_BELOW, "mean d' compared, odd of three": NEVER_BELOW,
    "mean rating without ends": "a few participants may rate much higher, which sign flips take for symmetric",
    "mean magnitude": SKEWED, "mean magnitude, as estimated": SKEWED,
    "exponent of one": "participants round their numbers, so the residuals are not normal",
}  # fmt: skip
"""Why intervals err in more than 5 % of the experiments of a population beyond doubt, where they do."""

Errors = Iterator[tuple[str, np.ndarray]]


@dataclass(frozen=True)
class Task:
    """The task of a population, and its parameters.

    Attributes
    ----------
    signals, noises : int
        Trials with and without a signal.
    tries : int
        Trials at each fixed level.
    run : int
        Trials of an adaptive run.
    alternatives : int
        Alternatives of a forced choice.
    d_prime, spread_dB, lapse : float
        Mean d', spread of the psychometric function [dB], and share of lapses [1].
    """

    signals: int
    noises: int
    tries: int
    run: int
    alternatives: int
    d_prime: float
    spread_dB: float  # noqa: N815
    lapse: float

    @classmethod
    def draw(cls, number: int) -> Task:
        """Return the task of a population."""
        rng = np.random.default_rng([1908, number])

        def one_of(*values):
            return values[rng.integers(len(values))]

        signals, noises = one_of((20, 10), (40, 10), (40, 20), (40, 40), (80, 8))
        return cls(
            signals, noises, one_of(6, 10, 20, 40), one_of(20, 30, 40, 60, 80), one_of(2, 2, 3),
            one_of(0.0, 0.5, 1.0, 2.0), one_of(2.0, 4.0, 6.0), one_of(0.0, 0.01, 0.02),
        )  # fmt: skip


def errors_of_measures(number: int, participants: int, n: int) -> Errors:
    """Yield each certificate of a population, and whether its test or interval errs, in n experiments."""
    task, rng = Task.draw(number), np.random.default_rng([1907, number])
    yield from _of_tests(task, rng, (n, participants))
    yield from _of_sensitivity(task, rng, (n, participants))
    yield from _of_fixed_levels(task, rng, (n, participants))
    yield from _of_runs(task, rng, (n, participants))
    yield from _of_exponents(rng, (n, participants))
    yield from _of_criteria(task, np.random.default_rng([1910, number]), (n, participants))
    yield from _of_compared(task, np.random.default_rng([1911, number]), (n, participants))
    yield from _of_magnitudes(np.random.default_rng([1912, number]), (n, participants))
    yield from _of_fits_compared(task, np.random.default_rng([1913, number]), (n, participants))
    yield from _of_exponents_compared(np.random.default_rng([1914, number]), (n, participants))
    yield from _of_differences(task, np.random.default_rng([1915, number]), (n, participants))
    yield from _of_alternatives(task, np.random.default_rng([1918, number]), (n, participants))
    yield from _of_ratings(task, np.random.default_rng([1916, number]), (n, participants))
    yield from _of_quests(task, np.random.default_rng([1920, number]), (n, participants))


def _of_tests(task: Task, rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield tests of populations without any difference."""
    # Differences of ratings, coarse and heavy-tailed, symmetric about zero.
    gaps = np.rint(2 * rng.laplace(size=shape))
    yield "rank", rank_test(gaps).quick_p <= ALPHA * TIES
    yield "rank interval", _missed(by_ranks(gaps)[1], 0.0)
    # People who feel nothing answer "yes" at individual rates.
    rates = rng.beta(1, 4, shape)
    contrasts = rng.binomial(task.signals, rates) / task.signals - rng.binomial(task.noises, rates) / task.noises
    yield "d'", flip_test(contrasts).quick_p <= ALPHA * TIES
    skewed, half = np.exp(rng.normal(size=shape)), shape[1] // 2
    yield "group", shuffle_test(skewed[:, :half], skewed[:, half:]).p <= ALPHA * TIES
    ratings = np.sort(rng.integers(1, 8, (*shape, 4)), axis=-1)
    rated = rng.permuted(ratings + rng.normal(0, 0.3, ratings.shape).round(), axis=-1)
    yield "friedman", friedman(rated)[0].p <= ALPHA * TIES


def _of_sensitivity(task: Task, rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    own = np.abs(rng.normal(task.d_prime, 0.5, shape[0]))
    criterion = rng.normal(0, 0.4, shape[0])
    chances = ndtr(own / 2 - criterion), ndtr(-own / 2 - criterion)
    found = _each(yes_no, rng, task, chances)
    d_primes, criteria = (_stacked(getattr(each, name) for each in found) for name in ("d_prime", "criterion"))
    yield "d' of one", _missed(d_primes, own)
    yield "criterion of one", _missed(criteria, criterion)
    yield from _of_mean("d'", rng, d_primes.estimate, own, shape, 0.05)
    apart = rng.uniform(1.0, 2.0, shape[0])
    chances = ndtr((own - apart) / math.sqrt(2)) + ndtr((-own - apart) / math.sqrt(2)), 2 * ndtr(-apart / math.sqrt(2))
    differing = _stacked(each.d_prime for each in _each(same_different, rng, task, chances))
    yield "same and different of one", _missed(differing, own)


def _of_criteria(task: Task, rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield mean criteria of people whose bias is as strong as the mean d' of their task."""
    own = np.abs(rng.normal(task.d_prime, 0.5, shape[0]))
    criterion = rng.normal(task.d_prime / 2, 0.4, shape[0])
    found = _each(yes_no, rng, task, (ndtr(own / 2 - criterion), ndtr(-own / 2 - criterion)))
    yield from _of_mean("criterion", rng, np.array([each.criterion.estimate for each in found]), criterion, shape, 0.05)


def _of_compared(task: Task, rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield sign flips of differences between two conditions.

    Shares have no systematic difference, but the numbers of answers differ; d' and criterion rise in most people.
    """
    rates = rng.beta(1, 4, (2, *shape))
    shares = [rng.binomial(n, rate) / n for n, rate in zip((task.signals, task.noises), rates, strict=True)]
    yield "shares compared", flip_test(shares[0] - shares[1]).quick_p <= ALPHA * TIES
    truth = np.abs(rng.normal(task.d_prime, 0.5, shape[0])), rng.normal(0, 0.4, shape[0])
    rise = rng.normal(0.5, 0.3, shape[0]), rng.normal(0.2, 0.2, shape[0])
    found = []
    for own, criterion in (truth, (truth[0] + rise[0], truth[1] + rise[1])):
        told = _each(yes_no, rng, task, (ndtr(own / 2 - criterion), ndtr(-own / 2 - criterion)))
        found.append(np.array([(each.d_prime.estimate, each.criterion.estimate) for each in told]).T)
    for name, known, own in zip(("d' compared", "criterion compared"), found[1] - found[0], rise, strict=True):
        yield from _of_mean(name, rng, known, own, shape, 0.05)


def _of_magnitudes(rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield geometric means of three magnitudes each; a fifth of the people use numbers ten times as large."""
    own = rng.normal(2, 0.5, shape[0]) + (rng.random(shape[0]) < 0.2) * math.log(10)
    given = np.exp(own[:, None] + rng.normal(0, 0.25, (shape[0], 3)))
    digit = 10.0 ** (np.floor(np.log10(given)) - 1)
    known = np.log(np.maximum(np.rint(given / digit) * digit, digit)).mean(axis=1)
    yield from _of_mean("magnitude", rng, known, own, shape, 0.02)


FITTED = 500
"""People whose functions are fitted twice: fits take long. Experiments draw their participants from these."""

FIXED_DB = np.arange(-9.0, 9.5, 3.0)
"""Fixed levels, about the middle of the population [dB]."""


def _of_fits_compared(task: Task, rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield sign flips of differences of fitted values between two conditions, and detection thresholds alone.

    In the second condition thresholds are 1 dB higher on average, and spreads a tenth larger.
    """
    n = min(shape[0], FITTED)
    own, spread = _people(task, rng, n)
    rise, wider = rng.normal(1, 0.5, n), np.exp(rng.normal(0.1, 0.1, n))
    people = (own, spread), (own + rise, spread * wider)
    forced, choice, felt = ([fit(task, rng, *each) for each in people] for fit in (_forced, _choice, _felt))
    runs = {name: [_run_of(task, rng, *each, name) for each in people] for name in ("forced choice", "felt")}
    compared = {"threshold compared": forced, "PSE compared": choice, "detection threshold compared": felt}
    compared |= {f"of runs compared, {name}": each for name, each in runs.items()}
    for name, (first, second) in compared.items():
        gaps = _known(second, second.threshold) - _known(first, first.threshold)
        yield from _of_mean(name, rng, gaps, rise, shape, LEAST_DB)
    gaps = JND_OF_SPREAD * (_known(choice[1], choice[1].spread) - _known(choice[0], choice[0].spread))
    yield from _of_mean("JND compared", rng, gaps, JND_OF_SPREAD * spread * (wider - 1), shape, LEAST_DB / 5)
    yield "detection threshold of one", _missed(felt[0].threshold, own)[felt[0].is_determined]
    yield from _of_mean("detection threshold", rng, _known(felt[0], felt[0].threshold), own, shape, LEAST_DB)


def _forced(task: Task, rng: np.random.Generator, own: np.ndarray, spread: np.ndarray) -> Fits:
    """Return the fits of a forced choice at fixed levels."""
    rising, guess = ndtr((FIXED_DB - own[:, None]) / spread[:, None]), 1 / task.alternatives
    hits = rng.binomial(task.tries, guess + (1 - guess - task.lapse) * rising).astype(float)
    return fit_counts(FIXED_DB, hits, np.full_like(rising, task.tries), guess_rate=guess, most_lapse=MOST_LAPSE)


def _choice(task: Task, rng: np.random.Generator, own: np.ndarray, spread: np.ndarray) -> Fits:
    """Return the fits of choices between a comparison at fixed levels and a standard."""
    rising, guesses = ndtr((FIXED_DB - own[:, None]) / spread[:, None]), np.linspace(0, MOST_LAPSE, 3)
    hits = rng.binomial(task.tries, task.lapse + (1 - 2 * task.lapse) * rising).astype(float)
    return fit_counts(FIXED_DB, hits, np.full_like(rising, task.tries), guess_rate=guesses, most_lapse=MOST_LAPSE)


def _felt(task: Task, rng: np.random.Generator, own: np.ndarray, spread: np.ndarray) -> Fits:
    """Return the fits of yes/no detection at fixed levels, with catch trials; false-alarm rates are individual."""
    guess, n = rng.beta(1, 12, own.size), min(task.noises, 20)
    false = rng.binomial(n, guess)
    rising = ndtr((FIXED_DB - own[:, None]) / spread[:, None])
    hits = rng.binomial(task.tries, guess[:, None] + (1 - guess[:, None] - task.lapse) * rising).astype(float)
    return fit_counts(
        FIXED_DB, hits, np.full_like(hits, task.tries), guess_rate=0.0, most_lapse=MOST_LAPSE, n_catch=n, n_false=false
    )


def _of_exponents_compared(rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield sign flips of differences of exponents between two conditions, 0.1 steeper in the second."""
    own, rise = rng.normal(0.6, 0.2, shape[0]), rng.normal(0.1, 0.1, shape[0])
    first, second = (_exponents(rng, each).estimate for each in (own, own + rise))
    yield from _of_mean("exponent compared", rng, second - first, rise, shape, 0.02)


def _of_differences(task: Task, rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield d' and criteria of same-different tasks: single criteria, means, and differences of two conditions."""
    own, apart = np.abs(rng.normal(task.d_prime, 0.5, shape[0])), rng.uniform(1.0, 2.0, shape[0])
    rise, later, found = rng.normal(0.5, 0.3, shape[0]), rng.normal(0.3, 0.2, shape[0]), []
    for d_prime, criterion in ((own, apart), (own + rise, apart + later)):
        chances = ndtr((d_prime - criterion) / math.sqrt(2)) + ndtr((-d_prime - criterion) / math.sqrt(2))
        found.append(_each(same_different, rng, task, (chances, 2 * ndtr(-criterion / math.sqrt(2)))))
    yield "differencing criterion of one", _missed(_stacked(each.criterion for each in found[0]), apart)
    for name, part, truth, risen in (
        ("d'", "d_prime", own, rise),
        ("differencing criterion", "criterion", apart, later),
    ):
        first, second = (_stacked(getattr(each, part) for each in own).estimate for own in found)
        of = ", same and different" * (name == "d'")
        yield from _of_mean(f"{name}{of}", rng, first, truth, shape, 0.05)
        yield from _of_mean(f"{name} compared{of}", rng, second - first, risen, shape, 0.05)


def _of_alternatives(task: Task, rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield d' of three-alternative and oddity tasks: null, means, and differences."""
    own = np.abs(rng.normal(task.d_prime, 0.5, shape[0]))
    rise, n = rng.normal(0.5, 0.3, shape[0]), task.signals
    guessed = rng.binomial(n, 1 / 3, shape) / n - 1 / 3
    yield "d', of three", flip_test(guessed).quick_p <= ALPHA * TIES
    models = {
        "of three": (lambda given: m_intervals(given, 3), lambda d: share_correct(d, 3)),
        "odd of three": (odd_of_three, lambda d: 1 - ncfdtr(1, 1, 2 * d**2 / 3, 3)),
    }
    for name, (model, chance) in models.items():
        counts = [rng.binomial(n, chance(np.maximum(each, 0))) for each in (own, own + rise)]
        told = {k: model((k, n)).d_prime.estimate for k in np.unique(counts).tolist()}
        first, second = (np.array([told[k] for k in each.tolist()]) for each in counts)
        yield from _of_mean(f"d', {name}", rng, first, own, shape, 0.05)
        yield from _of_mean(f"d' compared, {name}", rng, second - first, np.maximum(own + rise, 0) - own, shape, 0.05)


def _stacked(each: Iterable[Interval]) -> Interval:
    """Stack the intervals of several people into one of arrays."""
    rows = [(own.estimate, own.low, own.high) for own in each]
    return Interval(*np.array(rows).T, len(rows))


def _of_ratings(task: Task, rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield mean ratings: on a scale from 1 to 7, and of unbounded numbers."""
    rated = _rated(task, rng, shape[0])
    known = rated[:, :4].mean(axis=1)
    drawn = known[rng.integers(shape[0], size=shape)]
    tests = (BoundedMean(drawn[k : k + 500], 1.0, 7.0).test(known.mean()).p for k in range(0, len(drawn), 500))
    yield "mean rating", np.concatenate(list(tests)) <= ALPHA / TIES
    yield from islice(_of_mean("rating without ends", rng, known, known, shape, 0.25), 1)


def _rated(task: Task, rng: np.random.Generator, n: int) -> np.ndarray:
    """Return ratings from 1 to 7; most people rate correct answers higher.

    A fifth of the people rate much higher, up to the end of the scale.
    """
    chance, often = rng.uniform(0.6, 0.9, n), task.signals
    felt = rng.normal(-0.5, 1, n) + 3 * (rng.random(n) < 0.2)
    is_right = rng.random((n, often)) < chance[:, None]
    latent = felt[:, None] + rng.normal(0.3, 0.3, (n, 1)) * is_right + rng.normal(size=is_right.shape)
    return np.clip(np.rint(3 + latent), 1, 7)


def _each(model, rng, task, chances):
    """Return the estimates of a model for each of some people, whose counts are drawn."""
    counts = (rng.binomial(n, chance).tolist() for n, chance in zip((task.signals, task.noises), chances, strict=True))
    return [_told(model, (hits, task.signals), (alarms, task.noises)) for hits, alarms in zip(*counts, strict=True)]


@lru_cache(maxsize=20_000)
def _told(model, signal, noise):
    return model(signal, noise)


def _of_fixed_levels(task: Task, rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield thresholds of forced choice at fixed levels, and points of subjective equality and JNDs."""
    own, spread = _people(task, rng, shape[0])
    found = _forced(task, rng, own, spread)
    yield "threshold of one", _missed(found.threshold, own)[found.is_determined]
    yield from _of_mean("threshold", rng, _known(found, found.threshold), own, shape, LEAST_DB)
    found = _choice(task, rng, own, spread)
    yield "PSE of one", _missed(found.threshold, own)[found.is_determined]
    yield from _of_mean("PSE", rng, _known(found, found.threshold), own, shape, LEAST_DB)
    yield "JND of one", _missed(found.spread, spread)[found.is_determined]
    just = JND_OF_SPREAD * _known(found, found.spread)
    yield from _of_mean("JND", rng, just, JND_OF_SPREAD * spread, shape, LEAST_DB / 5)


def _of_runs(task: Task, rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield thresholds of adaptive runs: two-down forced choice, and yes/no detection."""
    for name in ("forced choice", "felt"):
        own, spread = _people(task, rng, shape[0])
        yield from _of_thresholds(name, rng, _run_of(task, rng, own, spread, name), own, shape)


def _of_thresholds(name: str, rng: np.random.Generator, found: Fits, own: np.ndarray, shape: tuple[int, int]) -> Errors:
    """Yield the thresholds of single runs, and their means over the participants of each experiment."""
    yield f"run of one, {name}", _missed(found.threshold, own)[found.is_determined]
    known = _known(found, found.threshold)
    means = [student_interval(row[np.isfinite(row)]) for row in known[rng.integers(own.size, size=shape)]]
    for kind, truth in ((name, own.mean()), (f"{name}, as estimated", np.nanmean(known))):
        yield f"mean of runs, {kind}", np.array([not each.low <= truth <= each.high for each in means])


def _of_quests(task: Task, rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield thresholds of QUEST+ runs, alone and compared with those of a condition as in `_of_fits_compared`."""
    for name in ("forced choice, QUEST+", "felt, QUEST+"):
        own, spread = _people(task, rng, min(shape[0], FITTED))
        rise, wider = rng.normal(1, 0.5, own.size), np.exp(rng.normal(0.1, 0.1, own.size))
        first, second = (_run_of(task, rng, *each, name) for each in ((own, spread), (own + rise, spread * wider)))
        yield from _of_thresholds(name, rng, first, own, shape)
        gaps = _known(second, second.threshold) - _known(first, first.threshold)
        yield from _of_mean(f"of runs compared, {name}", rng, gaps, rise, shape, LEAST_DB)


def _run_of(task: Task, rng: np.random.Generator, own: np.ndarray, spread: np.ndarray, name: str) -> Fits:
    """Return the fits of a run of each person."""
    guess, down_after = (1 / task.alternatives, 2) if name.startswith("forced choice") else (0.0, 1)
    rule = StaircaseSection(down_after=down_after, steps_dB=(8.0, 4.0, 2.0))
    rising = ndtr((LEVELS_DB - own[:, None]) / spread[:, None])
    chances = guess + (1 - guess - task.lapse) * rising
    if name.endswith("QUEST+"):
        place, success = quests(guess, rng, task.run, chances)
    else:
        place, success = staircases(rule, rng, task.run, chances)
    tries = np.stack([(place == at).sum(axis=-1) for at in range(LEVELS_DB.size)], axis=-1).astype(float)
    hits = np.stack([(success & (place == at)).sum(axis=-1) for at in range(LEVELS_DB.size)], axis=-1).astype(float)
    return fit_counts(LEVELS_DB, hits, tries, guess_rate=guess, most_lapse=0.06, flat_rate=guess or None)


def staircases(rule, rng, n_trials, chances):
    """Return the level indices of some runs and which answers succeed, (n_runs, n_trials) arrays.

    Parameters
    ----------
    rule : StaircaseSection
        Steps that are multiples of 2 dB, equal up and down.
    rng : Generator
        Source of random numbers.
    n_trials : int
        Trials of each run.
    chances : (n_runs, n_levels) array
        Probability of success at each level [1].
    """
    steps = np.array(rule.steps_dB) / 2
    rows, n = np.arange(len(chances)), len(chances)
    level = np.full(n, START)
    in_a_row, heading, turns = (np.zeros(n, int) for _ in range(3))
    places, successes = [], []
    for _ in range(n_trials):
        places.append(level)
        success = rng.random(n) < chances[rows, level]
        successes.append(success)
        in_a_row = np.where(success, in_a_row + 1, 0)
        direction = np.where(success, -1 * (in_a_row >= rule.down_after), 1)
        in_a_row = np.where(direction == -1, 0, in_a_row)
        turns = turns + ((direction != 0) & (heading == -direction))
        heading = np.where(direction != 0, direction, heading)
        moved = level + direction * steps[np.minimum(turns, steps.size - 1)].astype(int)
        level = np.clip(moved, 0, LEVELS_DB.size - 1)
    return np.stack(places, axis=-1), np.stack(successes, axis=-1)


def quests(guess, rng, n_trials, chances):
    """Return the level indices of QUEST+ runs and which answers succeed, as `staircases` does.

    The level with the least expected entropy has the largest mutual information of answer and parameters; with two
    answers this takes two products with the posterior, for all runs together.

    Parameters
    ----------
    guess : float
        Guess rate of the rule [1].
    rng, n_trials, chances
        As in `staircases`.
    """
    rule = quest_of(guess)
    likelihood = rule._likelihood.reshape(-1, 2, LEVELS_DB.size)
    posterior = np.tile(rule._prior.reshape(-1), (len(chances), 1))
    known = xlogy(likelihood, likelihood).sum(axis=1)
    rows, level = np.arange(len(chances)), np.full(len(chances), START)
    places, successes = [], []
    for _ in range(n_trials):
        places.append(level)
        success = rng.random(len(chances)) < chances[rows, level]
        successes.append(success)
        posterior *= likelihood[:, np.where(success, 0, 1), level].T
        posterior /= posterior.sum(axis=1, keepdims=True)
        chance = posterior @ likelihood[:, 0]
        level = (xlogy(chance, chance) + xlogy(1 - chance, 1 - chance) - posterior @ known).argmin(axis=1)
    return np.stack(places, axis=-1), np.stack(successes, axis=-1)


@lru_cache
def quest_of(guess: float) -> Quest:
    """Return the rule of QUEST+ runs that start at the fifth-highest level, with lapses up to 6 %."""
    return Quest((LEVELS_DB[0], LEVELS_DB[-1]), LEVELS_DB[START], guess, 0.06)


def _of_exponents(rng: np.random.Generator, shape: tuple[int, int]) -> Errors:
    """Yield exponents of magnitudes at five levels, three times each, rounded to two digits as people answer."""
    own = rng.normal(0.6, 0.2, shape[0])
    exponents = _exponents(rng, own)
    yield "exponent of one", _missed(exponents, own)
    yield from _of_mean("exponent", rng, exponents.estimate, own, shape, 0.02)


def _exponents(rng: np.random.Generator, own: np.ndarray) -> Interval:
    """Return the fitted exponent of each person, whose true one is `own`."""
    levels = np.repeat([20.0, 40.0, 80.0, 120.0, 200.0], 3)
    size = np.exp(rng.normal(2, 0.5, (own.size, 1))) * levels ** own[:, None]
    given = size * np.exp(rng.normal(0, 0.25, size.shape))
    digit = 10.0 ** (np.floor(np.log10(given)) - 1)
    return _stacked(power_law(levels, row) for row in np.maximum(np.rint(given / digit) * digit, digit))


def _people(task: Task, rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return threshold and spread of some people [dB]."""
    return rng.normal(0, 2, n), task.spread_dB * np.exp(rng.normal(0, 0.2, n))


def _known(found: Fits, estimate: Interval) -> np.ndarray:
    return np.where(found.is_determined, estimate.estimate, np.nan)


def _of_mean(name: str, rng, known, own, shape, least) -> Errors:
    """Yield where sign flips of people's rounded numbers reject the true mean, and the mean of all estimates.

    People without an estimate are left out.
    """
    drawn = rng.integers(len(known), size=shape)
    for kind, mean in ((name, own.mean()), (f"{name}, as estimated", np.nanmean(known))):
        gaps = np.nan_to_num(np.rint((known - mean) / least))
        yield f"mean {kind}", flip_test(gaps[drawn]).quick_p <= ALPHA * TIES


def _missed(interval: Interval, truth: np.ndarray | float) -> np.ndarray:
    """Return which intervals miss the true value."""
    return (truth < interval.low - 1e-9) | (interval.high + 1e-9 < truth)
