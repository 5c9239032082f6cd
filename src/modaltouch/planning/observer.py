"""Populations of participants: typical participant, spread between participants, and front end."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modaltouch.planning.participant import SAME_HAND, Participant
from modaltouch.protocol import ObserverFile, Protocol

FloatArray = NDArray[np.float64]

FrontEnd = Literal["peak_at_focus", "peak", "rms", "below_1_khz", "envelope"]
"""``peak_at_focus``: speed at the focusing instant; ``peak``: peak speed; ``rms``: RMS over one repetition;
``below_1_khz``: peak speed below 1 kHz; ``envelope``: peak of the rectified velocity, low-pass filtered at 1 kHz."""


@dataclass(frozen=True, eq=False)
class DrawnParticipants:
    """Participants drawn from a population, as arrays of one shape."""

    typical: Participant  # the typical participant, with the parameters common to all
    # noise, criterion, side_bias, pace: as in `Participant`; `pace` multiplies the decision time [1]
    noise: FloatArray
    criterion: FloatArray
    side_bias: FloatArray
    pace: FloatArray
    sharpening: FloatArray  # factor on the typical value of one plus the suppression [1]

    def contrast(self, finger_condition: str) -> FloatArray:
        """Return one plus the suppression of each participant in a finger condition [1]."""
        return np.maximum((1 + self.typical.suppression_in(finger_condition)) * self.sharpening, 1.0)


@dataclass(frozen=True)
class Observer:
    """A population of participants.

    The defaults reproduce the answers of the paper's participants: nearly all name the zone of the higher speed if the
    speeds differ by 1.6 : 1 or more, and most answer ``both`` if they are equal. They agree with the literature:

    - Intensity is compared by ratio: difference thresholds for vibration are 0.7 dB (far above threshold) to
      2.5 dB, Weber fractions of about 0.1 to 0.3 [1]_ [2]_; they shrink a little with level, the near miss to
      Weber's law [2]_, which the default leaves out.
    - A stronger vibration suppresses a weaker one nearby, across fingers and even hands: funnelling [3]_.
    - Lapses, answers independent of the stimulus, are typically up to 5 % [4]_.
    - The detection threshold of the fingertip is about 0.1 um at 250 Hz, a speed of about 0.2 mm/s [5]_; the default
      of 1 mm/s allows for bursts shorter than the integration time of touch.

    Attributes
    ----------
    typical : Participant
        The typical participant of the population.
    side_bias_spread : float
        Standard deviation of the side bias over participants [1].
    noise_spread, criterion_spread, suppression_spread, pace_spread : float
        Standard deviation, over participants, of the logarithm of the noise, the criterion, one plus the
        suppression, and the decision time [1].
    front_end : str
        Definition of the felt speed; see `FrontEnd`.
    name : str
        Name in reports; empty for an observer created in code.

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
    front_end: FrontEnd = "peak"
    name: str = ""

    def draw(self, rng: np.random.Generator) -> Participant:
        """Draw a participant from the population.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of random numbers.
        """
        one = self.draw_participants(rng, ())
        middle = self.typical
        return replace(
            middle,
            noise=float(one.noise),
            criterion=float(one.criterion),
            suppression=float(one.contrast(SAME_HAND)) - 1,
            suppression_across_hands=float(one.contrast("two_hands")) - 1,
            side_bias=float(one.side_bias),
            decision_time=middle.decision_time * float(one.pace),
        )

    def draw_participants(self, rng: np.random.Generator, shape: tuple[int, ...]) -> DrawnParticipants:
        """Draw an array of participants from the population.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of random numbers.
        shape : tuple of int
            Shape of the array, such as (n_experiments, n_participants).
        """
        return self.participants_at(rng.standard_normal((5, *shape)))

    def participants_at(self, deviates: ArrayLike) -> DrawnParticipants:
        """Return the participants at given points of the population.

        Parameters
        ----------
        deviates : (5, ...) array
            Standard normal deviates of side bias, noise, criterion, suppression and pace [1].
        """
        bias, noise, criterion, suppression, pace = np.asarray(deviates, dtype=float)
        middle = self.typical
        with np.errstate(over="ignore"):  # a fit also tries spreads that nobody has
            return DrawnParticipants(
                typical=middle,
                noise=middle.noise * np.exp(self.noise_spread * noise),
                criterion=middle.criterion * np.exp(self.criterion_spread * criterion),
                side_bias=middle.side_bias + self.side_bias_spread * bias,
                pace=np.exp(self.pace_spread * pace),
                sharpening=np.exp(self.suppression_spread * suppression),
            )

    def as_dict(self) -> dict[str, Any]:
        """Return the observer as plain values, for records and ``--json``."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """Return the observer from the values of `as_dict`."""
        return cls(**{**values, "typical": Participant(**values["typical"])})

    @classmethod
    def read(cls, name: Path | str) -> Self:
        """Read an observer from its file.

        Parameters
        ----------
        name : path
            YAML file, or name of a shipped observer such as ``paper``.

        Raises
        ------
        InputError
            With all faults of the file and their positions, or with the shipped names if there is no such file.
        """
        file = ObserverFile.read(name)
        typical, spread = file.typical, file.spread
        return cls(
            typical=Participant(
                noise=math.log1p(typical.weber_fraction),
                criterion=typical.criterion,
                suppression=typical.suppression.one_hand,
                suppression_across_hands=typical.suppression.two_hands,
                side_bias=typical.side_bias,
                lapse_rate=typical.lapse_rate,
                detection_speed=typical.detection_speed_mm_s * 1e-3,
                quickest=typical.reaction.quickest_s,
                decision_time=typical.reaction.decision_s,
                hesitation=typical.reaction.hesitation,
                decision_spread=typical.reaction.spread,
                near_miss=typical.near_miss,
                internal_noise=typical.internal_noise_mm_s * 1e-3,
            ),
            side_bias_spread=spread.side_bias,
            noise_spread=spread.weber_fraction,
            criterion_spread=spread.criterion,
            suppression_spread=spread.suppression,
            pace_spread=spread.pace,
            front_end=file.front_end,
            name=file.observer,
        )

    @staticmethod
    def usual_name(protocol: Protocol) -> str:
        """Return the name of the default shipped observer for a protocol.

        Adaptive runs, levels derived from their thresholds, silent standards and yes/no detection need `fingertip`,
        whose thresholds lie within the range of a beam; `paper` feels every level and discriminates the zones.

        Parameters
        ----------
        protocol : Protocol
            The protocol.
        """
        at_thresholds = protocol.adaptive is not None or protocol.conditions.sensation_levels is not None
        is_silent = protocol.intervals is not None and protocol.intervals.standard.velocity_mm_s == 0
        offered = protocol.answers.offered
        is_detected = len(offered) == 2 and offered.naming() is not None
        return "fingertip" if at_thresholds or is_silent or is_detected else "paper"

    def as_file(self, name: str, description: str) -> str:
        """Format the observer as the text of its YAML file.

        Parameters
        ----------
        name, description : str
            Name and description in the file.
        """
        typical = self.typical
        return f"""\
observer: {name}
description: {json.dumps(description, ensure_ascii=False)}
front_end: {self.front_end}
typical:
  weber_fraction: {math.expm1(typical.noise):.4g}
  near_miss: {typical.near_miss:.4g}
  criterion: {typical.criterion:.4g}
  suppression: {{one_hand: {typical.suppression:.4g}, two_hands: {typical.suppression_across_hands:.4g}}}
  side_bias: {typical.side_bias:.4g}
  lapse_rate: {typical.lapse_rate:.4g}
  detection_speed_mm_s: {typical.detection_speed * 1e3:.4g}
  internal_noise_mm_s: {typical.internal_noise * 1e3:.4g}
  reaction:
    quickest_s: {typical.quickest:.4g}
    decision_s: {typical.decision_time:.4g}
    hesitation: {typical.hesitation:.4g}
    spread: {typical.decision_spread:.4g}
spread:
  weber_fraction: {self.noise_spread:.4g}
  criterion: {self.criterion_spread:.4g}
  suppression: {self.suppression_spread:.4g}
  side_bias: {self.side_bias_spread:.4g}
  pace: {self.pace_spread:.4g}
"""
