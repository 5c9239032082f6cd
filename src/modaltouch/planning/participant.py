"""Model of a single participant: answers and reaction times from the speeds felt by the fingers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modaltouch.protocol import AnswerList

SAME_HAND = "one_hand"
"""Finger condition with two fingers of one hand."""

REFERENCE = 0.1
"""Speed at which `Participant.noise` holds if `near_miss` is not zero, and reference of `Participant.rate` [m/s]."""

_LEAST_FLOOR = 1e-12


@dataclass(frozen=True)
class Participant:
    r"""A simulated participant.

    The log ratio of the felt speeds of the two fingers is compared, according to Weber's law:

    .. math:: d = (1 + s) \ln\frac{v_r + v_0}{v_l + v_0} + b + \sigma z, \qquad z \sim N(0, 1)

    The answer is both fingers if :math:`|d| < c`, else the stronger one. If no answer means both, the stronger one is
    always named; if no answer names the stronger one, the remaining answer is given. In a share of trials (lapses),
    the answer is drawn at random from those offered. An answer for nothing felt, if offered, is given when the stronger
    finger feels less than :math:`v_0 e^{\sigma z'}`, with an independent normal z'. If no answer names a finger, all
    are equally likely. The felt speed v of a finger is defined by the observer's front end.

    With internal noise, each finger feels :math:`\max(v + \sigma_0 n, 0)` instead of v, with an independent normal n in
    each trial. This noise is present without a stimulus, so that ratios are no longer discriminated near the threshold
    of touch and false alarms occur (Gescheider, "Psychophysics: the fundamentals", 3rd ed. (1997), chapter 5). In
    two-interval detection, 75 % of answers are correct at :math:`0.954\,\sigma_0` (where d' is
    :math:`\sqrt 2\,\Phi^{-1}(0.75)`), which gives sigma_0 from a measured threshold.

    Attributes
    ----------
    noise : float
        Standard deviation sigma of the compared log ratio [1].
    criterion : float
        Smallest difference c for which one side is named [1].
    suppression : float
        Suppression s of the weaker finger by the stronger one, for two fingers of one hand [1].
    suppression_across_hands : float
        Suppression for fingers of different hands [1].
    side_bias : float
        Preference b for the right side [1].
    lapse_rate : float
        Share of trials answered at random [1].
    detection_speed : float
        Detection threshold v_0, below which ratios are not discriminated [m/s].
    quickest : float
        Shortest reaction time [s].
    decision_time : float
        Median time of an easy decision, added to `quickest` [s].
    hesitation : float
        Additional time of the hardest decision, relative to `decision_time` [1].
    decision_spread : float
        Standard deviation of the logarithm of the decision time [1].
    near_miss : float
        Exponent m of the decrease of noise with the stronger finger's speed, 0 for Weber's law: the noise is multiplied
        by (speed / 0.1 m/s)^-m [1].
    internal_noise : float
        Standard deviation sigma_0 of the felt speed without a stimulus; if 0, only ratios count [m/s].
    """

    noise: float = 0.22
    criterion: float = 0.33
    suppression: float = 0.65
    suppression_across_hands: float = 0.6
    side_bias: float = 0.0
    lapse_rate: float = 0.005
    detection_speed: float = 0.001
    quickest: float = 0.35
    decision_time: float = 0.5
    hesitation: float = 1.0
    decision_spread: float = 0.35
    near_miss: float = 0.0
    internal_noise: float = 0.0

    @property
    def floor(self) -> float:
        """Detection speed, kept above zero so that the ratio is defined for fingers at rest [m/s]."""
        return max(self.detection_speed, _LEAST_FLOOR)

    def suppression_in(self, finger_condition: str) -> float:
        """Return the suppression between the two fingers of a finger condition [1]."""
        return self.suppression if finger_condition == SAME_HAND else self.suppression_across_hands

    def noise_at(self, speed_left: float, speed_right: float) -> float:
        """Return the standard deviation of the comparison of two felt speeds [m/s], as a log ratio [1]."""
        if self.near_miss == 0:
            return self.noise
        return float(self.noise * ((max(speed_left, speed_right) + self.floor) / REFERENCE) ** -self.near_miss)

    def difference(self, speed_left: float, speed_right: float, finger_condition: str) -> float:
        """Return the noiseless difference of two felt speeds [m/s], right against left, as a weighted log ratio [1]."""
        ratio = math.log((speed_right + self.floor) / (speed_left + self.floor))
        return (1 + self.suppression_in(finger_condition)) * ratio + self.side_bias

    def answer(
        self,
        speed_left: float,
        speed_right: float,
        finger_condition: str,
        rng: np.random.Generator,
        answers: AnswerList | None = None,
        *speed_between: float,
    ) -> tuple[str, float]:
        """Simulate an answer and its reaction time from the first burst [s]; each takes the same number of draws.

        The offered `answers` are those of the paper if not given; a third finger may lie between the two.
        """
        answers = AnswerList.of({}) if answers is None else answers
        nothing = answers.naming()
        draw, lapse, guess, pace = rng.standard_normal(), rng.random(), rng.random(), rng.standard_normal()
        doubt = rng.standard_normal() if nothing is not None else 0.0
        if self.internal_noise:
            speed_left, speed_right, *others = (
                max(speed + self.internal_noise * rng.standard_normal(), 0.0)
                for speed in (speed_left, speed_right, *speed_between)
            )
            speed_between = tuple(others)
        expected = self.difference(speed_left, speed_right, finger_condition)
        noise = self.noise_at(speed_left, speed_right)
        felt = expected + noise * draw
        # The decision is hardest at the criterion, between two answers.
        reaction_time = self._reaction_time(abs(abs(felt) - self.criterion), noise, pace)
        if lapse < self.lapse_rate:
            return answers.ranked[int(guess * len(answers))].name, reaction_time
        threshold = self.detection_speed * math.exp(noise * doubt)
        if nothing is not None and max(speed_left, speed_right, *speed_between) < threshold:
            return nothing.name, reaction_time
        if speed_between and answers.names_between:
            speeds = np.log(np.array((speed_left, *speed_between, speed_right)) + self.floor)
            strongest = int(np.argmax(speeds + noise / math.sqrt(2) * rng.standard_normal(3)))
            named = answers.naming(("left", "between", "right")[strongest])
            return (named or answers[0]).name, reaction_time
        return _name(answers, felt, self.criterion, guess), reaction_time

    def rate(self, speeds: Sequence[float], rng: np.random.Generator) -> tuple[float, float]:
        """Simulate a rating as a share of the scale, and its reaction time from the first burst [s].

        With s the speed of the faster finger relative to `REFERENCE`, times log-normal noise, the share is s / (1 + s).
        A scale without an upper end maps it back to s: a power law of exponent 1, close to the 0.95 of vibration at
        60 Hz (S. S. Stevens, J. Exp. Psychol. 57, 210 (1959)).
        """
        draw, pace = rng.standard_normal(), rng.standard_normal()
        strength = (max(speeds) + self.floor) / REFERENCE * math.exp(self.noise_at(max(speeds), 0.0) * draw)
        reaction_time = self.quickest + self.decision_time * math.exp(self.decision_spread * pace)
        return strength / (1 + strength), reaction_time

    def compare(
        self, speeds: Sequence[tuple[float, ...]], rng: np.random.Generator, answers: AnswerList
    ) -> tuple[str, float]:
        """Simulate an answer to several intervals and its reaction time from the question [s].

        The percept of a finger in an interval is the logarithm of speed plus v_0, with half the variance of a
        comparison, so that the difference of two intervals has the noise of a difference of two fingers. Of two
        intervals, the one with the strongest percept of any finger is named; of three, the one farthest from the
        others. Intervals are judged the same if no two of them differ by more than the criterion for any finger.
        """
        lapse, guess, pace = rng.random(), rng.random(), rng.standard_normal()
        given = np.asarray(speeds, dtype=float)
        given = np.maximum(given + self.internal_noise * rng.standard_normal(given.shape), 0.0)
        noise = self.noise_at(float(given.max()), 0.0)
        felt = np.log(given + self.floor) + noise / math.sqrt(2) * rng.standard_normal(given.shape)
        apart = np.abs(felt[:, None] - felt).max(axis=2)
        weight = felt.max(axis=1) if len(felt) == 2 else apart.sum(axis=1)
        named = {answer.interval: answer.name for answer in answers}
        numbers = sorted((n for n in named if isinstance(n, int)), key=lambda n: weight[n - 1])
        difference = float(apart.max()) - self.criterion
        chosen: int | str = "different" if difference > 0 else "same"
        if numbers:
            chosen, difference = numbers[-1], float(weight[numbers[-1] - 1] - weight[numbers[-2:][0] - 1])
        reaction_time = self._reaction_time(abs(difference), noise, pace)
        if lapse < self.lapse_rate or chosen not in named:
            return answers[int(guess * len(answers))].name, reaction_time
        return named[chosen], reaction_time

    def _reaction_time(self, margin: float, noise: float, pace: float) -> float:
        median = self.decision_time * (1 + self.hesitation * math.exp(-margin / max(noise, _LEAST_FLOOR)))
        return self.quickest + median * math.exp(self.decision_spread * pace)


def _name(answers: AnswerList, felt: float, criterion: float, guess: float) -> str:
    """Return the answer for a difference between the fingers; a random one if no answer names a finger."""
    others = [answer for answer in answers if not answer.means_nothing_felt]
    naming = {answer.side: answer.name for answer in others if answer.fingers}
    if not naming:
        return others[int(guess * len(others))].name
    if abs(felt) < criterion and 0 in naming:
        return naming[0]
    side = 1 if felt > 0 else -1
    return naming.get(side) or naming.get(0) or naming[-side]
