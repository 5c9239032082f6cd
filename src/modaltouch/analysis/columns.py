"""Columns of a table of answers: the scale of the levels, and the zones under one to three fingers."""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import dataclass, replace
from functools import reduce
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import pandas as pd


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


def zones_of(columns: Container[str]) -> tuple[str, ...]:
    """Return the columns of a table that contain the zones under the fingers."""
    return tuple(name for name in ("zone_left", "zone_between", "zone_right") if name in columns)


def label_zones(frame: pd.DataFrame) -> pd.Series:
    """Return the zones of each row as a label, as in ``A-C``."""
    first, *others = (frame[name].astype(str) for name in zones_of(frame.columns))
    return reduce(lambda label, zone: (label + "-" + zone).where(zone != "", label), others, first)


def zones_in_words(zones: Iterable[str]) -> str:
    """Format zones in words.

    Examples
    --------
    >>> zones_in_words(("A", "C", "E")), zones_in_words(("C", ""))
    ('A, C and E', 'C')
    """
    *others, last = filter(None, zones)
    return f"{', '.join(others)} and {last}" if others else last
