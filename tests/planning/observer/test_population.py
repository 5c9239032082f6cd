"""Many participants together, against single participants and closed forms."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modaltouch.planning.experiments import answer_shares
from modaltouch.planning.observer import Observer
from modaltouch.planning.participant import REFERENCE, Participant
from modaltouch.protocol import AnswerList

SPEEDS = np.array([[0.08, 0.13], [0.1, 0.1], [0.2, 0.12]])


def test_shares_are_those_of_single_answers() -> None:
    """They agree with 6000 answers of the same person within 4 standard errors."""
    observer = replace(Observer(), typical=replace(Participant(), lapse_rate=0.06, near_miss=0.4, side_bias=0.1))
    person = observer.draw(np.random.default_rng(4))
    crowd = observer.draw_participants(np.random.default_rng(4), ())
    left, right = answer_shares(crowd, SPEEDS, ("one_hand", "two_hands", "one_hand"))
    rng, n = np.random.default_rng(9), 6000
    for cell, condition in enumerate(("one_hand", "two_hands", "one_hand")):
        given = [person.answer(*SPEEDS[cell], condition, rng)[0] for _ in range(n)]
        for share, answer in ((left[cell], "left"), (right[cell], "right")):
            spread = math.sqrt(share * (1 - share) / n)
            assert given.count(answer) / n == pytest.approx(share, abs=4 * spread + 1e-3)


def test_shares_with_internal_noise_are_those_of_single_answers() -> None:
    """Near the threshold of touch and far above it, they agree with 6000 answers within 4 standard errors."""
    observer = replace(Observer(), typical=replace(Participant(), internal_noise=0.004, detection_speed=0.0105))
    person = observer.draw(np.random.default_rng(4))
    speeds = np.array([[0.006, 0.01], [0.02, 0.012], [0.1, 0.15]])
    left, right = answer_shares(observer.draw_participants(np.random.default_rng(4), ()), speeds, ("one_hand",) * 3)
    rng, n = np.random.default_rng(9), 6000
    for cell in range(3):
        given = [person.answer(*speeds[cell], "one_hand", rng)[0] for _ in range(n)]
        for share, answer in ((left[cell], "left"), (right[cell], "right")):
            spread = math.sqrt(share * (1 - share) / n)
            assert given.count(answer) / n == pytest.approx(share, abs=4 * spread + 3e-3)


@pytest.mark.parametrize("internal_noise", [0.0, 0.004])
def test_shares_with_an_answer_none_are_those_of_single_answers(internal_noise: float) -> None:
    """Below, near and far above the threshold, they agree with 6000 answers within 4 standard errors.

    A lapse is then one of four answers and not of three: of 20 % lapses each gets 5 %.
    """
    typical = Participant(lapse_rate=0.2, detection_speed=0.01, internal_noise=internal_noise, near_miss=0.1)
    observer, offered = replace(Observer(), typical=typical), AnswerList.of_words(("none",))
    person = observer.draw(np.random.default_rng(4))
    speeds = np.array([[0.004, 0.006], [0.008, 0.011], [0.1, 0.3]])
    crowd = observer.draw_participants(np.random.default_rng(4), ())
    shares = answer_shares(crowd, speeds, ("one_hand",) * 3, offers_nothing=True)
    assert shares[2, 2] == pytest.approx(0.05, abs=1e-6)
    rng, n = np.random.default_rng(9), 6000
    for cell, own in enumerate(shares.T):
        given = [person.answer(*speeds[cell], "one_hand", rng, offered)[0] for _ in range(n)]
        for share, answer in zip(own, ("left", "right", "none"), strict=True):
            spread = math.sqrt(share * (1 - share) / n)
            assert given.count(answer) / n == pytest.approx(share, abs=4 * spread + 3e-3)


def test_one_drawn_participant_is_a_crowd_of_one() -> None:
    """The same draws give the same person, alone or in a crowd."""
    observer = Observer()
    person = observer.draw(np.random.default_rng(2))
    crowd = observer.draw_participants(np.random.default_rng(2), (1,))
    assert person.noise == crowd.noise[0]
    assert person.side_bias == crowd.side_bias[0]
    assert person.suppression == pytest.approx(crowd.contrast("one_hand")[0] - 1)
    assert person.suppression_across_hands == pytest.approx(crowd.contrast("two_hands")[0] - 1)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0, 2), min_size=2, max_size=2), st.floats(0, 1), st.floats(-1, 1))
def test_shares_are_probabilities(speeds: list[float], lapse_rate: float, side_bias: float) -> None:
    """Left, right and both are never negative and add up to one at any speeds."""
    observer = replace(Observer(), typical=replace(Participant(), lapse_rate=lapse_rate, side_bias=side_bias))
    left, right = answer_shares(observer.draw_participants(np.random.default_rng(1), (7,)), [speeds], ("two_hands",))
    assert left.shape == (7, 1)
    assert ((left >= 0) & (right >= 0) & (left + right <= 1 + 1e-12)).all()


def test_a_turned_beam_reverses_only_the_side_bias() -> None:
    """With the beam turned, the bias acts on its other end."""
    observer = Observer(replace(Participant(), side_bias=0.3, lapse_rate=0.0), 0, 0, 0, 0, 0)
    crowd = observer.draw_participants(np.random.default_rng(1), (1,))
    left, right = answer_shares(crowd, [[0.1, 0.1]], ("one_hand",))
    turned_left, turned_right = answer_shares(crowd, [[0.1, 0.1]], ("one_hand",), -1.0)
    assert right[0, 0] > 3 * left[0, 0]
    assert (turned_left[0, 0], turned_right[0, 0]) == pytest.approx((right[0, 0], left[0, 0]))


def test_the_near_miss_multiplies_the_noise() -> None:
    """Weber's law holds at the reference speed; with exponent 1/2 the noise is half at four times that speed."""
    person = Participant(near_miss=0.5, detection_speed=0.0)
    assert person.noise_at(REFERENCE, REFERENCE / 2) == pytest.approx(person.noise)
    assert person.noise_at(REFERENCE, 4 * REFERENCE) == pytest.approx(person.noise / 2)
    assert Participant().noise_at(0.01, 0.5) == Participant().noise


def test_an_observer_survives_the_round_trip_through_json() -> None:
    """Written to JSON and read back, it is the same observer."""
    observer = replace(Observer(), front_end="envelope", name="x", typical=Participant(noise=0.3))
    assert Observer.from_dict(json.loads(json.dumps(observer.as_dict()))) == observer


def test_an_overflowing_spread_gives_no_warning() -> None:
    """A fit also tries spreads under which a participant's suppression overflows."""
    far = replace(Observer.read("paper"), suppression_spread=500.0).participants_at(np.full((5, 1), 2.0))
    assert np.isinf(far.sharpening).all()
