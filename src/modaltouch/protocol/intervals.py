"""Keys of multi-interval trials, and scoring of their answers."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import Field

from modaltouch.protocol.reading import Reading
from modaltouch.protocol.section import NotNegative, Section, Step, Word, described
from modaltouch.protocol.trial import Condition

IntervalNumber = Annotated[int, Field(strict=True, ge=1, le=3)]
Meaning = IntervalNumber | Literal["same", "different"]
"""Meaning of an answer: an interval, or whether all intervals were alike."""

STANDARD_LEVEL = ("intervals", "standard", "velocity_mm_s")
"""Path of the standard's level."""


class StandardSection(Section):
    """The reference stimulus in the other intervals, under the same fingers."""

    velocity_mm_s: NotNegative | None = described(
        "Level of the standard [mm/s], such as 100; 0 for a silent interval; null for the level of the comparison.",
        default=None,
    )
    stimulus: Word | None = described(
        "Name, under stimuli, of the stimulus that is the standard; null for that of the comparison.", default=None
    )


class IntervalsSection(Section):
    """Multi-interval trials: one interval presents the condition of the trial, the others the standard."""

    number: Annotated[int, Field(strict=True, ge=2, le=3)] = described("Number of intervals in each trial.", default=2)
    gap_s: Annotated[NotNegative, Field(le=60)] = described(
        "Time from the end of an interval's last burst until the next interval is prepared, with the outputs off [s]. "
        "Its first burst comes about a tenth of a second later; the instant is in the record.",
        default=0.5,
    )
    standard: StandardSection = described("What the other intervals present: a level, a stimulus, or both.")
    comparison_in: tuple[IntervalNumber, ...] | None = described(
        "Intervals that may contain the comparison, the trial's condition: each is used equally often in each "
        "condition. Null for all; [2] puts the standard first in every trial.",
        default=None,
        json_schema_extra={"uniqueItems": True},
    )
    asked: Literal["comparison", "stronger"] = described(
        "Which interval is correct: the one with the comparison (which one was different, which one vibrated), or the "
        "one with the higher level (which one was stronger), which may be the standard.",
        default="comparison",
    )

    @property
    def places(self) -> tuple[int, ...]:
        """Intervals that may hold the comparison."""
        return self.comparison_in or tuple(range(1, self.number + 1))

    def standard_of(self, comparison: Condition) -> Condition:
        """Return the condition of the intervals that do not hold the comparison."""
        given = self.standard
        velocity = comparison.velocity_mm_s if given.velocity_mm_s is None else given.velocity_mm_s
        return replace(comparison, velocity_mm_s=velocity, stimulus=given.stimulus or comparison.stimulus)

    def is_correct(self, meaning: Meaning | None, comparison: Condition, interval: int) -> bool | None:
        """Score an answer; None if it does not refer to the intervals, or if any of them may be correct."""
        standard = self.standard_of(comparison)
        if meaning is None or isinstance(meaning, str):
            return None if meaning is None else (standard == comparison) is (meaning == "same")
        above = comparison.velocity_mm_s - standard.velocity_mm_s
        if standard == comparison or (self.asked == "stronger" and (above == 0 or (above < 0 and self.number > 2))):
            return None
        return meaning == (3 - interval if self.asked == "stronger" and above < 0 else interval)


def presented_levels(reading: Reading[Any]) -> dict[tuple[Step, ...], float]:
    """Return the valid levels of a protocol by path [mm/s], including that of the standard if not among them."""
    section = ("conditions", "peak_velocities_mm_s")
    levels: dict[tuple[Step, ...], float] = {(*section, index): level for index, level in reading.items(*section)}
    presented = reading.value is None or reading.value.intervals is not None
    if presented and (standard := reading.sound(*STANDARD_LEVEL)) and standard not in levels.values():
        levels[STANDARD_LEVEL] = standard
    return levels
