"""Scales of the levels in a table of answers: peak velocities, or multiples of each participant's threshold."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class LevelScale:
    """A scale of levels, identified by its column in the tidy table.

    Attributes
    ----------
    column : str
        Column of the tidy table.
    quantity : str
        Name with unit, for axis labels.
    unit : str
        Unit, as written after a number.
    step : float
        Change of level for the report of slopes.
    step_in_words : str
        `step` in words.
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
"""Peak velocities, the same for all participants."""

OWN_THRESHOLD = LevelScale(
    "multiple_of_threshold",
    "peak velocity at the focus [multiple of own threshold]",
    "x threshold",
    1.0,
    "one threshold",
)
"""Multiples of each participant's threshold."""

PREDICTED = LevelScale("speed_mm_s", "predicted peak speed under the faster finger [mm/s]", "mm/s", 100.0, "100 mm/s")
"""Peak speeds predicted under the faster finger."""

DELIVERED = replace(
    PREDICTED, column="speed_delivered_mm_s", quantity="delivered peak speed under the faster finger [mm/s]"
)
"""Peak speeds measured by the vibrometer in each trial, or predicted if not measured."""

Speed = Literal["nominal", "predicted", "delivered"]
"""Definition of the levels: nominal speed at the focus, or predicted or delivered speed under the faster finger."""


def scale_of(columns: Container[str]) -> LevelScale:
    """Return the scale of a table's levels.

    Parameters
    ----------
    columns : container of str
        Names of its columns.
    """
    return next((scale for scale in (OWN_THRESHOLD, PREDICTED, DELIVERED) if scale.column in columns), VELOCITY)
