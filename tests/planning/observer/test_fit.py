"""Fits of an observer: recovery of a known one, and what answers cannot identify."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from modaltouch.planning.experiments import answer_shares
from modaltouch.planning.fitting import Fit, RecordedAnswers, fit_observer, log_likelihood
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant

TRUTH = Observer(
    Participant(
        noise=0.3, criterion=0.5, suppression=0.5, suppression_across_hands=0.2, side_bias=0.1, lapse_rate=0.02
    ),
    side_bias_spread=0.2,
    criterion_spread=0.35,
)
PEAKS = np.array([[0.123, 0.2], [0.115, 0.115], [0.2, 0.123]])
SPEEDS = np.concatenate([PEAKS, PEAKS])
CONDITIONS = ("one_hand",) * 3 + ("two_hands",) * 3


def recorded(observer: Observer, n_participants: int, n_repetitions: int, seed: int) -> RecordedAnswers:
    """Return the answers of simulated participants, every second one at the turned beam."""
    rng = np.random.default_rng(seed)
    facing = np.where(np.arange(n_participants) % 2, -1.0, 1.0)
    left, right = answer_shares(observer.draw_participants(rng, (n_participants,)), SPEEDS, CONDITIONS, facing)
    shares = np.stack([left, 1 - left - right, right], axis=-1)
    return RecordedAnswers(rng.multinomial(n_repetitions, shares), SPEEDS, CONDITIONS, facing)


@pytest.fixture(scope="module")
def fitted() -> Fit:
    """A fit to 60 participants with 16 answers in each of six cells."""
    return fit_observer(recorded(TRUTH, 60, 16, seed=3), Observer())


def test_a_known_observer_is_recovered(fitted: Fit) -> None:
    """From a distant start, the identifiable ratios lie within 1.5 times their 95 % intervals."""
    typical = TRUTH.typical
    expected = {
        "speed ratio named half the time, one_hand": math.exp(typical.criterion / (1 + typical.suppression)),
        "noise of the log ratio, one_hand": typical.noise / (1 + typical.suppression),
        "speed ratio named half the time, two_hands": math.exp(
            typical.criterion / (1 + typical.suppression_across_hands)
        ),
        "noise of the log ratio, two_hands": typical.noise / (1 + typical.suppression_across_hands),
    }
    assert fitted.converged
    assert [estimate.name for estimate in fitted.identified] == list(expected)
    for estimate in fitted.identified:
        slack = (estimate.high - estimate.low) / 4
        assert estimate.low - slack < expected[estimate.name] < estimate.high + slack, estimate
        assert estimate.high - estimate.low < 0.4 * estimate.value
        assert estimate.learned > 0.9


def test_lapses_and_spreads_are_recovered_from_enough_answers(fitted: Fit) -> None:
    """The true values lie within 1.5 times their intervals; none depends on the scale."""
    found = {estimate.name: estimate for estimate in fitted.parameters}
    for name, truth in (("lapse_rate", 0.02), ("criterion_spread", 0.35)):
        slack = (found[name].high - found[name].low) / 4
        assert found[name].low - slack < truth < found[name].high + slack
        assert not found[name].tied_to_scale


def test_the_fit_is_more_likely_than_the_truth_and_the_start(fitted: Fit) -> None:
    """A maximum exceeds any other point, except for the small effect of the prior."""
    data = recorded(TRUTH, 60, 16, seed=3)
    assert fitted.log_likelihood > log_likelihood(TRUTH, data) - 3
    assert fitted.log_likelihood > log_likelihood(Observer(), data) + 100


def test_the_scale_cannot_be_identified() -> None:
    """Multiplying noise, criterion, 1 + suppressions and side bias by 1.7 leaves the likelihood exactly unchanged."""
    k, typical = 1.7, replace(TRUTH.typical, suppression_across_hands=0.5)
    truth = replace(TRUTH, typical=typical)
    data = recorded(truth, 5, 2, seed=1)
    scaled = replace(
        typical,
        noise=k * typical.noise,
        criterion=k * typical.criterion,
        suppression=k * (1 + typical.suppression) - 1,
        suppression_across_hands=k * (1 + typical.suppression_across_hands) - 1,
        side_bias=k * typical.side_bias,
    )
    other = replace(truth, typical=scaled, side_bias_spread=k * truth.side_bias_spread)
    assert log_likelihood(other, data) == pytest.approx(log_likelihood(truth, data), abs=1e-9)


def test_a_parameter_without_data_stays_at_the_prior() -> None:
    """With one finger condition only, nothing is learned about the other's suppression."""
    whole = recorded(TRUTH, 8, 2, seed=2)
    half = RecordedAnswers(whole.counts[:, :3], SPEEDS[:3], CONDITIONS[:3], whole.facing)
    fit = fit_observer(half, Observer())
    unasked = next(estimate for estimate in fit.parameters if estimate.name == "suppression_across_hands")
    assert unasked.learned < 0.02
    assert unasked.value == pytest.approx(Observer().typical.suppression_across_hands, abs=1e-3)
    assert {estimate.name.split(", ")[1] for estimate in fit.identified} == {"one_hand"}


def test_a_spread_of_zero_is_kept_fixed() -> None:
    """A quantity at the end of its range is not fitted."""
    fit = fit_observer(recorded(TRUTH, 4, 1, seed=2), replace(Observer(), noise_spread=0.0))
    assert "noise_spread" not in [estimate.name for estimate in fit.parameters]
    assert fit.observer.noise_spread == 0.0


def test_with_an_answer_none_lapses_are_spread_over_four_answers() -> None:
    """The likelihood has lapses of one in four answers, conditional on left, both or right, in closed form."""
    still = Observer(TRUTH.typical, 0, 0, 0, 0, 0)
    data = replace(recorded(TRUTH, 2, 3, seed=5), offers_nothing=True)
    lapses, expected = still.typical.lapse_rate, 0.0
    attentive = Observer(replace(still.typical, lapse_rate=0.0), 0, 0, 0, 0, 0)
    for person, facing in enumerate(data.facing):
        left, right = answer_shares(
            attentive.draw_participants(np.random.default_rng(0), ()), SPEEDS, CONDITIONS, facing
        )
        shares = (1 - lapses) * np.stack([left, 1 - left - right, right], axis=-1) + lapses / 4
        expected += float((data.counts[person] * np.log(shares / shares.sum(axis=-1, keepdims=True))).sum())
    assert log_likelihood(still, data) == pytest.approx(expected, rel=1e-9)


def test_the_likelihood_of_a_population_without_spread_is_multinomial() -> None:
    """It is the sum of counts times log shares in closed form, with left and right exchanged at the turned beam."""
    still = Observer(TRUTH.typical, 0, 0, 0, 0, 0)
    data = recorded(TRUTH, 2, 3, seed=5)
    expected = 0.0
    for person, facing in enumerate(data.facing):
        left, right = answer_shares(still.draw_participants(np.random.default_rng(0), ()), SPEEDS, CONDITIONS, facing)
        expected += float((data.counts[person] * np.log(np.stack([left, 1 - left - right, right], axis=-1))).sum())
    assert log_likelihood(still, data) == pytest.approx(expected, rel=1e-12)
