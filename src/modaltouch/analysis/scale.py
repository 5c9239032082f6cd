"""The scale of the levels in a table of answers: peak velocities, or multiples of each participant's own threshold."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class LevelScale:
    """A scale of levels, recognised by the column that holds them.

    Attributes
    ----------
    column : str
        Column of the tidy table.
    quantity : str
        Name with unit, for a figure's axis.
    unit : str
        Unit, as written after a number.
    step : float
        Change of level for which slopes are reported.
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
"""Levels as the speed predicted under the faster finger."""

DELIVERED = replace(
    PREDICTED, column="speed_delivered_mm_s", quantity="delivered peak speed under the faster finger [mm/s]"
)
"""Levels as the speed that the vibrometer measured in each trial, or the predicted speed if it gave none."""

Speed = Literal["nominal", "predicted", "delivered"]
"""What defines levels: the speed asked for at the focus, or that predicted or delivered under the faster finger."""


def scale_of(columns: Container[str]) -> LevelScale:
    """Return the scale of a table's levels.

    Parameters
    ----------
    columns : container of str
        Names of its columns.
    """
    return next((scale for scale in (OWN_THRESHOLD, PREDICTED, DELIVERED) if scale.column in columns), VELOCITY)
