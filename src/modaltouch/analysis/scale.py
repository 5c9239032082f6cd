"""What the levels of a table of answers are: peak velocities, or multiples of each participant's own threshold."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass


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
    "peak velocity at the focus [own threshold]",
    "x threshold",
    1.0,
    "one threshold",
)
"""Levels calibrated by participant."""


def scale_of(columns: Container[str]) -> LevelScale:
    """Return what the levels of a table are.

    Parameters
    ----------
    columns : container of str
        Names of its columns.
    """
    return OWN_THRESHOLD if OWN_THRESHOLD.column in columns else VELOCITY
