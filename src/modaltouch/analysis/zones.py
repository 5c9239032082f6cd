"""Columns and labels of the zones under one to three fingers."""

from __future__ import annotations

from collections.abc import Container, Iterable
from functools import reduce
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


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
