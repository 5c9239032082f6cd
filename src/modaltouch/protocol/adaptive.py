"""The keys of an adaptive run: which level comes next, given the answers so far."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from modaltouch.protocol.document.section import Count, Positive, Section, described

Decibels = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=40)]
GuessRate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=0.6)]
LapseRate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=0.2)]


class StaircaseSection(Section):
    """Weighted and transformed up-down: down after so many successes in a row, up after each failure."""

    down_after: Annotated[Count, Field(le=6)] = described(
        "Successes in a row after which the level falls; each failure lifts it.", default=1
    )
    steps_dB: tuple[Decibels, ...] = described(  # noqa: N815
        "Steps down, the next one after each reversal, the last one for the rest of the run [dB, 20 to a decade].",
        default=(8.0, 4.0, 2.0),
        min_length=1,
        max_length=20,
    )
    up_over_down: Annotated[float, Field(strict=True, gt=0, le=10)] = described(
        "Step up relative to the step down.", default=1.0
    )

    @property
    def target(self) -> float:
        """Probability of success at which the staircase settles [1].

        Where going down is as likely per step as going up: p^n / (1 - p^n) = up / down (Kaernbach, Perception &
        Psychophysics 49 (1991) 227-229, for n = 1; Levitt, J. Acoust. Soc. Am. 49 (1971) 467-477, for equal steps).
        """
        share = self.up_over_down / (1 + self.up_over_down)
        return float(share ** (1 / self.down_after))


class AdaptiveSection(Section):
    """A run over the level for each finger condition, pair of zones and stimulus, instead of fixed levels."""

    method: Literal["staircase", "quest_plus"] = described(
        "staircase: up and down by the latest answers; quest_plus: the level that is expected to tell most.",
        default="quest_plus",
    )
    trials: Annotated[int, Field(strict=True, ge=8, le=1000)] = described(
        "Trials of each run, of which there is one for each finger condition, pair and stimulus.", default=40
    )
    start_mm_s: Positive = described("Level of the first trial of each run [mm/s].")
    success: Literal["focus_named", "felt"] = described(
        "Which answers count as success: focus_named, the finger in focus alone; felt, any but none.",
        default="focus_named",
    )
    guess_rate: GuessRate = described(
        "Share of successes where nothing is felt [1]; fitted instead where there are catch trials.", default=0.0
    )
    lapse_rate: LapseRate = described(
        "Share of failures where everything is felt, as assumed by quest_plus and as the most a fit may find [1].",
        default=0.06,
    )
    staircase: StaircaseSection = described("The rule of the staircase.", default=StaircaseSection())
