"""One row of the statistics: a test, an estimate, or both; and Holm's correction within families."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.exact import ExactTest
from modaltouch.analysis.intervals import Interval

ALPHA = 0.05
"""Significance level that `note` refers to."""

OUT_OF_REACH = "cannot pass Holm's correction"
"""Beginning of the note on a test whose smallest p is too large for the number of tests in its family."""

COLUMNS = (
    "question",
    "name",
    "scope",
    "statistic",
    "p",
    "p_min",
    "p_holm",
    "estimate",
    "low",
    "high",
    "n",
    "quantity",
    "family",
    "role",
    "note",
)


@dataclass(frozen=True)
class Finding:
    """A test with its estimate.

    Attributes
    ----------
    question : str
        Letter of the question (statistics plan, a to f), or a word for further ones.
    name : str
        The test or estimate.
    scope : str
        Finger condition, pair and level that it is about.
    quantity : str
        What `estimate`, `low` and `high` are.
    estimate, low, high : float
        Estimate with its 95 % interval; NaN if there is none.
    n : int
        Participants (or answers, if `name` says so) that it rests on.
    statistic, p, p_min : float
        Test statistic, its p, and the smallest p these data could have given; NaN without a test.
    family : str
        Tests corrected together by Holm's method; empty outside families.
    note : str
        What a reader must know.
    p_holm : float
        Holm's p within the family; NaN outside families.
    """

    question: str
    name: str
    scope: str
    quantity: str
    estimate: float
    low: float
    high: float
    n: int
    statistic: float = math.nan
    p: float = math.nan
    p_min: float = math.nan
    family: str = ""
    note: str = ""
    p_holm: float = math.nan

    @property
    def role(self) -> str:
        """Confirmatory for tests of a family, which may support a claim; exploratory for others; else an estimate."""
        return "confirmatory" if self.family else "estimate" if math.isnan(self.p) else "exploratory"


def finding_of(
    question: str,
    name: str,
    scope: str,
    test: ExactTest | None,
    quantity: str,
    interval: Interval,
    n: int,
    *,
    family: str = "",
    notes: Sequence[str] = (),
) -> Finding:
    """Return a finding from an interval and perhaps a test; its note says if the data contain no information."""
    words = [note for note in notes if note]
    if test is not None and test.p_min > ALPHA:
        whose = f"only {int(test.n_informative)} could move the statistic" if test.n_informative else "nothing varies"
        words.insert(0, f"no information: {whose}, and in either direction p could not fall below {test.p_min:.2g}")
    values = (interval.estimate, interval.low, interval.high)
    # Rounding errors about zero become zero.
    estimate, low, high = (0.0 if abs(each) < 1e-12 else float(each) for each in values)
    row = Finding(question, name, scope, quantity, estimate, low, high, n, family=family, note="; ".join(words))
    if test is None:
        return row
    return replace(row, statistic=float(test.statistic), p=float(test.p), p_min=float(test.p_min))


def correct(findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings with Holm's p within each family.

    All tests of a family count, even those that could not have become significant; their note says so.
    """
    rows = list(findings)
    for family in dict.fromkeys(row.family for row in rows if row.family):
        members = [i for i, row in enumerate(rows) if row.family == family]
        adjusted = holm([rows[i].p for i in members]).tolist()
        for i, p in zip(members, adjusted, strict=True):
            row = rows[i]
            out_of_reach = p > ALPHA and row.p_min <= ALPHA < row.p_min * len(members)
            reach = f"{OUT_OF_REACH} as smallest p of {len(members)}: p is at least {row.p_min:.2g}"
            note = "; ".join(part for part in (reach if out_of_reach else "", row.note) if part)
            rows[i] = replace(row, p_holm=p, note=note)
    return rows


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """Return Holm's step-down adjusted p values of families along the last axis.

    Parameters
    ----------
    p_values : (..., n_tests) array
        p values [1].

    References
    ----------
    Holm, Scandinavian Journal of Statistics 6 (1979) 65-70.

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03]).round(3).tolist()
    [0.03, 0.06, 0.06]
    """
    p = np.asarray(p_values, dtype=float)
    order = np.argsort(p, axis=-1, kind="stable")
    steps = np.arange(p.shape[-1], 0, -1)
    rising = np.maximum.accumulate(np.minimum(np.take_along_axis(p, order, axis=-1) * steps, 1.0), axis=-1)
    adjusted = np.empty_like(rising)
    np.put_along_axis(adjusted, order, rising, axis=-1)
    return adjusted


def to_frame(findings: Iterable[Finding]) -> pd.DataFrame:
    """Return findings as a tidy table, one row each, in the columns of `COLUMNS`."""
    rows = [{column: getattr(finding, column) for column in COLUMNS} for finding in findings]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def plain_row(row: dict[Any, Any]) -> dict[str, Any]:
    """Return a row of a table as plain values for JSON.

    Infinity becomes a word; NaN becomes ``undefined`` where something was to be estimated, else null.
    """
    values: dict[str, Any] = {}
    for key, value in row.items():
        plain = value.item() if hasattr(value, "item") else value
        if isinstance(plain, float) and math.isinf(plain):
            plain = "infinity" if plain > 0 else "-infinity"
        elif isinstance(plain, float) and math.isnan(plain):
            plain = "undefined" if key in ("estimate", "low", "high") and row.get("quantity", key) else None
        values[str(key)] = plain
    return values
