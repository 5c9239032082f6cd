"""A psychophysical observer: from the speeds under two fingers to an answer and its reaction time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np

from modaltouch.trial import ANSWERS, Answer

_SAME_HAND = "one_hand"


@dataclass(frozen=True)
class Participant:
    r"""One simulated person.

    The two fingers are compared by the logarithm of their speeds, as Weber's law has it:

    .. math:: d = (1 + s) \ln\frac{v_r + v_0}{v_l + v_0} + b + \sigma z, \qquad z \sim N(0, 1)

    The answer is ``both`` where :math:`|d| < c`, else the side of the stronger finger. In a share of trials
    (lapses) the answer is any of the three.

    Attributes
    ----------
    noise : float
        Standard deviation sigma of the compared log ratio [1].
    criterion : float
        Least difference c for which one side is named [1].
    suppression : float
        How much the stronger finger pushes the weaker one down, s, for two fingers of one hand [1].
    suppression_across_hands : float
        The same for fingers of different hands [1].
    side_bias : float
        Preference b for the right side [1].
    lapse_rate : float
        Share of trials answered at random [1].
    detection_speed : float
        Speed v_0 that is just felt, below which ratios mean nothing [m/s].
    quickest : float
        Shortest reaction time [s].
    decision_time : float
        Median time of an easy decision, on top of `quickest` [s].
    hesitation : float
        How much longer the hardest decision takes than an easy one, relative to `decision_time` [1].
    decision_spread : float
        Standard deviation of the logarithm of the decision time [1].
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

    def __post_init__(self) -> None:
        """Refuse numbers without a meaning.

        Raises
        ------
        ValueError
            If one is not finite, negative where it must not be, or a lapse rate above 1.
        """
        for item in fields(self):
            value = getattr(self, item.name)
            least = -math.inf if item.name == "side_bias" else 0.0
            most = 1.0 if item.name == "lapse_rate" else math.inf
            if not (math.isfinite(value) and least <= value <= most):
                raise ValueError(f"{item.name}: given {value}; allowed: a finite number from {least:g} to {most:g}")

    def difference(self, speed_left: float, speed_right: float, finger_condition: str) -> float:
        """Return how much stronger the right finger feels, apart from noise (log ratio) [1].

        Parameters
        ----------
        speed_left, speed_right : float
            Peak speeds under the two fingers [m/s].
        finger_condition : str
            ``one_hand`` or another.

        Raises
        ------
        ValueError
            If a speed is negative or not finite.
        """
        for side, speed in (("left", speed_left), ("right", speed_right)):
            if not (math.isfinite(speed) and speed >= 0):
                raise ValueError(f"given {speed} m/s under the {side} finger; allowed: a finite speed, 0 or more")
        floor = max(self.detection_speed, 1e-12)
        ratio = math.log((speed_right + floor) / (speed_left + floor))
        suppression = self.suppression if finger_condition == _SAME_HAND else self.suppression_across_hands
        return (1 + suppression) * ratio + self.side_bias

    def answer(
        self, speed_left: float, speed_right: float, finger_condition: str, rng: np.random.Generator
    ) -> tuple[Answer, float]:
        """Return an answer and its reaction time from the first burst [s].

        Parameters
        ----------
        speed_left, speed_right : float
            Peak speeds under the two fingers [m/s].
        finger_condition : str
            ``one_hand`` or another.
        rng : numpy.random.Generator
            Source of chance; the same number of draws is taken for every answer.

        Raises
        ------
        ValueError
            If a speed is negative or not finite.
        """
        noise, lapse, guess, pace = rng.standard_normal(), rng.random(), rng.random(), rng.standard_normal()
        felt = self.difference(speed_left, speed_right, finger_condition) + self.noise * noise
        # Deciding is hardest at the criterion, where two answers are equally near.
        margin = abs(abs(felt) - self.criterion)
        difficulty = math.exp(-margin / max(self.noise, 1e-12))
        median = self.decision_time * (1 + self.hesitation * difficulty)
        reaction_time = self.quickest + median * math.exp(self.decision_spread * pace)
        if lapse < self.lapse_rate:
            return ANSWERS[int(guess * len(ANSWERS))], reaction_time
        if abs(felt) < self.criterion:
            return "both", reaction_time
        return ("right" if felt > 0 else "left"), reaction_time


@dataclass(frozen=True)
class Observer:
    """A population of participants.

    The defaults answer as the paper's participants did: nearly all name the zone of the higher speed where the
    speeds differ by 1.6 : 1 or more, and most say ``both`` where they are equal. They agree with what is known
    of touch:

    - Intensity is compared by ratio: difference thresholds for vibration are 0.7 dB (far above threshold) to
      2.5 dB, Weber fractions of about 0.1 to 0.3 [1]_ [2]_.
    - A stronger vibration pushes a weaker one nearby down, across fingers and even hands: funnelling [3]_.
    - Some answers have nothing to do with the stimulus, typically up to 5 % [4]_.
    - The fingertip feels about 0.1 um at 250 Hz, a speed of some 0.2 mm/s [5]_; the default of 1 mm/s allows
      for bursts shorter than the skin sums over.

    Attributes
    ----------
    typical : Participant
        The participant in the middle of the population.
    side_bias_spread : float
        Standard deviation of the side bias over participants [1].
    noise_spread, criterion_spread, suppression_spread, pace_spread : float
        Standard deviation, over participants, of the logarithm of the noise, the criterion, one plus the
        suppression, and the decision time [1].

    References
    ----------
    .. [1] J. C. Craig, "Difference threshold for intensity of tactile stimuli", Perception & Psychophysics 11,
       150-152 (1972).
    .. [2] G. A. Gescheider, S. J. Bolanowski, R. T. Verrillo, D. J. Arpajian, T. F. Ryan, "Vibrotactile
       intensity discrimination measured by three methods", J. Acoust. Soc. Am. 87, 330-338 (1990).
    .. [3] G. von Bekesy, "Funneling in the nervous system and its role in loudness and sensation intensity on
       the skin", J. Acoust. Soc. Am. 30, 399-412 (1958).
    .. [4] F. A. Wichmann, N. J. Hill, "The psychometric function: I. Fitting, sampling, and goodness of fit",
       Perception & Psychophysics 63, 1293-1313 (2001).
    .. [5] S. J. Bolanowski, G. A. Gescheider, R. T. Verrillo, C. M. Checkosky, "Four channels mediate the
       mechanical aspects of touch", J. Acoust. Soc. Am. 84, 1680-1694 (1988).
    """

    typical: Participant = field(default_factory=Participant)
    side_bias_spread: float = 0.12
    noise_spread: float = 0.2
    criterion_spread: float = 0.2
    suppression_spread: float = 0.08
    pace_spread: float = 0.2

    def __post_init__(self) -> None:
        """Refuse spreads without a meaning.

        Raises
        ------
        ValueError
            If a spread is negative or not finite.
        """
        for item in fields(self)[1:]:
            value = getattr(self, item.name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{item.name}: given {value}; allowed: a finite number, 0 or more")

    def draw(self, rng: np.random.Generator) -> Participant:
        """Return one participant of the population.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of chance.
        """
        bias, noise, criterion, suppression, pace = rng.standard_normal(5)
        middle = self.typical
        pushed = math.exp(self.suppression_spread * suppression)
        return Participant(
            noise=middle.noise * math.exp(self.noise_spread * noise),
            criterion=middle.criterion * math.exp(self.criterion_spread * criterion),
            suppression=max((1 + middle.suppression) * pushed - 1, 0.0),
            suppression_across_hands=max((1 + middle.suppression_across_hands) * pushed - 1, 0.0),
            side_bias=middle.side_bias + self.side_bias_spread * bias,
            lapse_rate=middle.lapse_rate,
            detection_speed=middle.detection_speed,
            quickest=middle.quickest,
            decision_time=middle.decision_time * math.exp(self.pace_spread * pace),
            hesitation=middle.hesitation,
            decision_spread=middle.decision_spread,
        )
