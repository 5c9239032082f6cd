"""The keys of an observer file, which describes simulated participants."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from modaltouch.protocol.reading import read
from modaltouch.protocol.section import FileName, NotNegative, Section, Spread, Text, described
from modaltouch.protocol.source import Source

Share = Annotated[float, Field(strict=True, ge=0, le=1)]
Small = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-10, le=10)]
Gain = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=100)]


class SuppressionSection(Section):
    """Suppression of the weaker finger by the stronger one."""

    one_hand: Gain = described("Suppression between two fingers of one hand [1].", default=0.65)
    two_hands: Gain = described("Suppression between fingers of different hands [1].", default=0.6)


class ReactionSection(Section):
    """Response times."""

    quickest_s: NotNegative = described("Shortest reaction time [s].", default=0.35)
    decision_s: NotNegative = described(
        "Median time of an easy decision, in addition to the quickest [s].", default=0.5
    )
    hesitation: Gain = described("How much longer the hardest decision takes, relative to the easy one.", default=1.0)
    spread: Spread = described("Standard deviation of the logarithm of the decision time.", default=0.35)


class TypicalSection(Section):
    """The typical participant of the population."""

    weber_fraction: Gain = described(
        "Relative difference of speeds worth one standard deviation of noise, before suppression sharpens it.",
        default=0.246,
    )
    near_miss: Small = described(
        "Exponent with which the noise falls with speed above 100 mm/s; 0 if Weber's law holds.", default=0.0
    )
    criterion: Gain = described(
        "Smallest difference, as the logarithm of a ratio after suppression, at which one side is named rather than "
        "both.",
        default=0.33,
    )
    suppression: SuppressionSection = described(
        "How much the stronger finger suppresses the weaker one.", default=SuppressionSection()
    )
    side_bias: Small = described("Preference for the right side, as a difference; negative for the left.", default=0.0)
    lapse_rate: Share = described("Share of trials answered at random.", default=0.005)
    detection_speed_mm_s: NotNegative = described(
        "Speed that is just felt, as the front end expresses it [mm/s].", default=1.0
    )
    internal_noise_mm_s: NotNegative = described(
        "Standard deviation of what each finger feels without a stimulus, as an equivalent speed: 1/0.954 of the "
        "threshold that 75 % find in two intervals; 0 where only ratios count [mm/s].",
        default=0.0,
    )
    reaction: ReactionSection = described("How long answers take.", default=ReactionSection())


class SpreadSection(Section):
    """Variability between participants: standard deviations, of logarithms except for the side bias."""

    weber_fraction: Spread = described("Spread of the logarithm of the noise.", default=0.2)
    criterion: Spread = described("Spread of the logarithm of the criterion.", default=0.2)
    suppression: Spread = described("Spread of the logarithm of one plus the suppression.", default=0.08)
    side_bias: Spread = described("Spread of the side bias itself.", default=0.12)
    pace: Spread = described("Spread of the logarithm of the decision time.", default=0.2)


class ObserverFile(Section):
    """A population of simulated participants."""

    observer: FileName = described("Name of the observer.")
    description: Text = described("What this observer represents.", default="")
    front_end: Literal["peak_at_focus", "peak", "rms", "below_1_khz", "envelope"] = described(
        "What a finger feels of the velocity under it: speed at the focusing instant, highest speed, root mean square "
        "over a repetition, highest speed of the part below 1 kHz, or maximum of the rectified and smoothed velocity.",
        default="peak",
    )
    typical: TypicalSection = described("The typical participant of the population.", default=TypicalSection())
    spread: SpreadSection = described("How much participants differ.", default=SpreadSection())

    @classmethod
    def read(cls, name: Path | str) -> ObserverFile:
        """Read an observer from a file.

        Parameters
        ----------
        name : path
            A YAML file, or the name of a shipped observer, such as ``paper``.

        Raises
        ------
        InputError
            Lists every problem of the file with its line, or the shipped names if there is no such file.
        """
        return read(Source.find("observer", name), cls).require()
