"""What the levels of a table of answers are: peak velocities, or multiples of each participant's own threshold."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class LevelScale:
    """What a level is, told by the column that holds it.

    Attributes
    ----------
    column : str
        Column of the tidy table.
    quantity : str
        What it is, for a figure's axis.
    unit : str
        Its unit, as it follows a number.
    step : float
        The difference that a slope is told for.
    step_in_words : str
        The same in words.
    """

    column: str
    quantity: str
    unit: str
    step: float
    step_in_words: str

    def say(self, level: float) -> str:
        """Return a level with its unit.

        Examples
        --------
        >>> VELOCITY.say(92.5), OWN_THRESHOLD.say(1.5)
        ('92.5 mm/s', '1.5 x threshold')
        """
        return f"{level:g} {self.unit}"


VELOCITY = LevelScale("velocity_mm_s", "peak velocity at the focus [mm/s]", "mm/s", 100.0, "100 mm/s")
"""The same peak velocities for all participants."""

OWN_THRESHOLD = LevelScale(
    "multiple_of_threshold",
    "peak velocity at the focus [multiple of own threshold]",
    "x threshold",
    1.0,
    "one threshold",
)
"""Levels calibrated by participant."""

PREDICTED = LevelScale("speed_mm_s", "predicted peak speed under the faster finger [mm/s]", "mm/s", 100.0, "100 mm/s")
"""Levels by what they are predicted to do under the fingers."""

DELIVERED = replace(
    PREDICTED, column="speed_delivered_mm_s", quantity="delivered peak speed under the faster finger [mm/s]"
)
"""Levels by what the vibrometer saw of each trial; where it tells nothing, by the prediction."""

Speed = Literal["nominal", "predicted", "delivered"]
"""What levels are told by: the speed asked at the focus, or that predicted or delivered under the fingers."""


def scale_of(columns: Container[str]) -> LevelScale:
    """Return what the levels of a table are.

    Parameters
    ----------
    columns : container of str
        Names of its columns.
    """
    return next((scale for scale in (OWN_THRESHOLD, PREDICTED, DELIVERED) if scale.column in columns), VELOCITY)
