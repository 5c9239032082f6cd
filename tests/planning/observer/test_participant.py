"""The simulated participants, against the paper's results and the normal distribution."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import Participant
from modaltouch.protocol import AnswerList

N = 4000
PAPER = AnswerList.of({})
WITH_NONE = AnswerList.of({"keys": ["left", "both", "right", "none"]})


def answers(participant: Participant, left: float, right: float, condition: str = "one_hand") -> Counter[str]:
    """Return how often each answer is given in N trials."""
    rng = np.random.default_rng(7)
    return Counter(participant.answer(left, right, condition, rng)[0] for _ in range(N))


def population(left: float, right: float, condition: str) -> dict[str, float]:
    """Return the share of each answer over many participants of the default population."""
    observer, counted = Observer(), Counter[str]()
    for seed in range(500):
        rng = np.random.default_rng(seed)
        participant = observer.draw(rng)
        counted.update(participant.answer(left, right, condition, rng)[0] for _ in range(4))
    return {answer: counted[answer] / counted.total() for answer in ("left", "right", "both")}


@pytest.mark.parametrize("condition", ["one_hand", "two_hands"])
@pytest.mark.parametrize(("left", "right", "stronger"), [(0.123, 0.2, "right"), (0.2, 0.123, "left")])
def test_nearly_all_answers_are_the_focus(left: float, right: float, stronger: str, condition: str) -> None:
    """The paper has 38 and 39 of 40 in test 1 (V-C); the speeds are those of C against A or E at 200 mm/s."""
    shares = population(left, right, condition)
    assert 0.92 < shares[stronger] < 0.995
    assert shares["both"] > 0.5 * (1 - shares[stronger])


@pytest.mark.parametrize("condition", ["one_hand", "two_hands"])
def test_most_answers_are_both_at_equal_speeds(condition: str) -> None:
    """Section V-C: a majority of both in (B,D), and some answers of one side."""
    shares = population(0.115, 0.115, condition)
    assert 0.6 < shares["both"] < 0.95
    assert min(shares["left"], shares["right"]) > 0.01


@pytest.mark.parametrize(("left", "right"), [(0.1, 0.1), (0.1, 0.12), (0.15, 0.1)])
def test_shares_follow_the_normal_distribution(left: float, right: float) -> None:
    """Shares are the normal integral between the criteria, in closed form, within 4 standard errors."""
    person = Participant(lapse_rate=0.0, side_bias=0.05, detection_speed=0.0)
    shift = 1.65 * math.log(right / left) + 0.05
    normal = NormalDist(shift, person.noise)
    expected = {
        "left": normal.cdf(-person.criterion),
        "both": normal.cdf(person.criterion) - normal.cdf(-person.criterion),
        "right": 1 - normal.cdf(person.criterion),
    }
    counted = answers(person, left, right)
    for answer, share in expected.items():
        assert counted[answer] / N == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / N) + 1e-3)


def test_without_internal_noise_no_random_number_is_drawn_for_it() -> None:
    """Simulated data stay reproducible: the same draws for every answer."""
    for answers, n_normal in ((PAPER, 2), (WITH_NONE, 3)):
        rng, expected = np.random.default_rng(5), np.random.default_rng(5)
        Participant().answer(0.1, 0.12, "one_hand", rng, answers)
        drawn = [expected.standard_normal(), expected.random(), expected.random()]
        drawn += [expected.standard_normal() for _ in range(n_normal - 1)]
        assert rng.random() == expected.random(), drawn


def test_internal_noise_is_the_two_interval_threshold() -> None:
    """75 % correct at 0.954 sigma_0; `fingertip` has 4 mm/s: 0.4 um at 500 Hz as velocity, +10 dB for short bursts."""
    sigma = Observer.read("fingertip").typical.internal_noise
    rng = np.random.default_rng(3)
    with_it, without = 0.954 * sigma + sigma * rng.standard_normal(200_000), sigma * rng.standard_normal(200_000)
    assert (with_it > without).mean() == pytest.approx(0.75, abs=0.005)
    assert 2 * math.pi * 500 * 0.4e-6 * 10 ** (10 / 20) == pytest.approx(0.954 * sigma, rel=0.02)


def test_internal_noise_causes_false_alarms_and_spares_strong_vibration() -> None:
    """At rest 1 trial in 80 is felt: the tail of either finger beyond 2.5 sigma_0; far above, answers do not change."""
    person = Observer.read("fingertip").typical
    sharp = replace(person, noise=1e-9, lapse_rate=0.0)
    rng = np.random.default_rng(7)
    given = Counter(sharp.answer(0.0, 0.0, "one_hand", rng, WITH_NONE)[0] for _ in range(20_000))
    expected = 1 - NormalDist().cdf(2.5) ** 2
    assert 1 - given["none"] / 20_000 == pytest.approx(expected, abs=4 * math.sqrt(expected / 20_000))
    loud, without = answers(person, 0.123, 0.2), answers(replace(person, internal_noise=0.0), 0.123, 0.2)
    assert loud["right"] == pytest.approx(without["right"], abs=0.03 * N)


def test_lapses_are_random_answers_at_their_rate() -> None:
    """Each answer has a third of the lapses, where the noiseless answer is right."""
    counted = answers(Participant(noise=0.0, lapse_rate=0.3), 0.1, 1.0)
    for answer in ("left", "both"):
        assert counted[answer] / N == pytest.approx(0.1, abs=0.02)


def test_suppression_makes_a_difference_clearer() -> None:
    """More suppression gives fewer answers both at the same speeds."""
    weak, strong = Participant(suppression=0.0, lapse_rate=0.0), Participant(suppression=1.0, lapse_rate=0.0)
    assert answers(weak, 0.1, 0.12)["both"] > 1.2 * answers(strong, 0.1, 0.12)["both"]


def test_speeds_below_detection_are_no_difference() -> None:
    """Two fingers at rest, or below the detection speed, are compared as equal."""
    person = Participant()
    assert person.difference(0.0, 0.0, "one_hand") == 0.0
    assert abs(person.difference(1e-6, 1e-5, "two_hands")) < 0.02


def test_hard_decisions_take_longer() -> None:
    """The median reaction time is longer at the criterion, and none is shorter than the minimum."""
    person = Participant(lapse_rate=0.0)
    rng = np.random.default_rng(3)
    easy = [person.answer(0.1, 0.5, "one_hand", rng)[1] for _ in range(N)]
    at_criterion = 0.1 * math.exp(person.criterion / (1 + person.suppression))
    hard = [person.answer(0.1, at_criterion, "one_hand", rng)[1] for _ in range(N)]
    assert np.median(hard) > 1.3 * np.median(easy)
    assert min(*easy, *hard) > person.quickest


@given(st.floats(0, 10), st.floats(0, 10), st.integers(0, 2**32))
def test_the_same_seed_gives_the_same_answer(left: float, right: float, seed: int) -> None:
    """An answer depends only on speeds, condition and random generator, and its time is finite."""
    person = Observer().draw(np.random.default_rng(1))
    first = person.answer(left, right, "one_hand", np.random.default_rng(seed))
    assert first == person.answer(left, right, "one_hand", np.random.default_rng(seed))
    assert first[0] in ("left", "right", "both")
    assert math.isfinite(first[1])


@given(st.floats(1e-3, 1), st.floats(1e-3, 1))
def test_left_and_right_are_mirror_images(left: float, right: float) -> None:
    """Without a side bias, exchanging the fingers changes the sign of the difference."""
    person = Participant()
    assert person.difference(left, right, "one_hand") == pytest.approx(-person.difference(right, left, "one_hand"))


def test_participants_differ() -> None:
    """The side bias has the observer's standard deviation and zero mean."""
    observer = Observer()
    rng = np.random.default_rng(5)
    biases = [observer.draw(rng).side_bias for _ in range(2000)]
    assert np.std(biases) == pytest.approx(observer.side_bias_spread, rel=0.06)
    assert np.mean(biases) == pytest.approx(0, abs=0.012)


def test_an_observer_without_spread_is_its_typical_participant() -> None:
    """With all spreads at zero, every participant is the same."""
    still = Observer(Participant(), 0, 0, 0, 0, 0)
    drawn = still.draw(np.random.default_rng(1))
    assert drawn.noise == Participant().noise
    assert drawn.suppression == pytest.approx(Participant().suppression)


def test_a_participant_answers_none_below_the_detection_speed() -> None:
    """Apart from lapses: always at rest, in half of the trials at the detection speed, never at 0.1 m/s."""
    participant = Participant(lapse_rate=0.2, noise=0.3)
    rng = np.random.default_rng(3)

    def share(speed: float) -> float:
        given = [participant.answer(speed, 0.0, "one_hand", rng, WITH_NONE)[0] for _ in range(N)]
        return given.count("none") / N

    # A lapse is none in a quarter of the cases.
    assert share(0.0) == pytest.approx(0.8 + 0.2 / 4, abs=0.02)
    assert share(participant.detection_speed) == pytest.approx(0.8 / 2 + 0.2 / 4, abs=0.03)
    assert share(0.1) == pytest.approx(0.2 / 4, abs=0.015)
    assert "none" not in answers(participant, 0.0, 0.0)


@pytest.mark.parametrize(("speeds", "least", "most"), [((0.1, 0.2, 0.1), 0.99, 1.0), ((0.1, 0.1, 0.1), 0.28, 0.39)])
def test_of_three_fingers_the_fastest_is_answered(
    speeds: tuple[float, float, float], least: float, most: float
) -> None:
    """The middle one at twice the speed is chosen; at equal speeds each is, by chance, in a third of the trials."""
    fingers = {"index": ["left"], "middle": ["between"], "ring": ["right"]}
    answers = AnswerList.of({"keys": dict.fromkeys(fingers), "fingers": fingers})
    person, rng = Participant(lapse_rate=0.0), np.random.default_rng(5)
    left, between, right = speeds
    named = [person.answer(left, right, "spread", rng, answers, between)[0] for _ in range(1000)]
    assert least <= named.count("middle") / len(named) <= most
    assert set(named) <= set(fingers)
