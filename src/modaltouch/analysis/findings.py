"""Findings, the rows of the table of statistics (a test, an estimate, or both), and Holm's correction in families."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from modaltouch.analysis.exact import ExactTest
from modaltouch.analysis.intervals import Interval

Key = TypeVar("Key")
Value = TypeVar("Value")

ALPHA = 0.05
"""Significance level of all tests [1]."""

OUT_OF_REACH = "cannot pass Holm's correction"
"""Start of the note on a test that cannot reach significance after correction, given the size of its family."""

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
        Letter of the question in the statistics plan (a to f), or a word for secondary questions.
    name : str
        Name of the test or estimate.
    scope : str
        Finger condition, pair and level of the answers.
    quantity : str
        Quantity of `estimate`, `low` and `high`.
    estimate, low, high : float
        Estimate with its 95 % interval; NaN if there is none.
    n : int
        Number of participants (or answers, if stated in `name`).
    statistic, p, p_min : float
        Test statistic, p value and smallest attainable p value; NaN without a test.
    family : str
        Family of tests for Holm's correction; empty outside families.
    note : str
        Remarks for the reader.
    p_holm : float
        Holm-adjusted p value; NaN outside families.
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
        """Confirmatory for tests in a family, exploratory for other tests, else an estimate."""
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
    """Return a finding from an interval and an optional test; its note says if the data are uninformative."""
    words = [note for note in notes if note]
    if test is not None and test.p_min > ALPHA:
        count, of = int(test.n_informative), "answer" if question == "a1" else "participant"
        whose = f"only {count} {of}{'s' * (count > 1)} can affect the statistic" if count else "nothing varies"
        words.insert(0, f"no information: {whose}, so p cannot be below {test.p_min:.2g}")
    values = (interval.estimate, interval.low, interval.high)
    # Round numerical noise to zero.
    estimate, low, high = (0.0 if abs(each) < 1e-12 else float(each) for each in values)
    if low == high:
        words.append("one value as interval, since hardly any values differ: it does not tell how certain the mean is")
    row = Finding(question, name, scope, quantity, estimate, low, high, n, family=family, note="; ".join(words))
    if test is None:
        return row
    return replace(row, statistic=float(test.statistic), p=float(test.p), p_min=float(test.p_min))


def correct(findings: Iterable[Finding]) -> list[Finding]:
    """Apply Holm's correction within each family.

    All tests of a family count, even those that cannot become significant, which are noted as such.
    """
    rows = list(findings)
    for family in dict.fromkeys(row.family for row in rows if row.family):
        members = [i for i, row in enumerate(rows) if row.family == family]
        adjusted = holm([rows[i].p for i in members]).tolist()
        for i, p in zip(members, adjusted, strict=True):
            row = rows[i]
            out_of_reach = p > ALPHA and row.p_min <= ALPHA < row.p_min * len(members)
            reach = f"{OUT_OF_REACH}, even as the smallest of {len(members)}: p is at least {row.p_min:.2g}"
            note = "; ".join(part for part in (reach if out_of_reach else "", row.note) if part)
            rows[i] = replace(row, p_holm=p, note=note)
    return rows


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """Adjust p values by Holm's step-down method, with families along the last axis.

    Parameters
    ----------
    p_values : (..., n_tests) array
        Unadjusted p values [1].

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
    """Convert findings to a tidy table with one row each and the columns `COLUMNS`."""
    rows = [{column: getattr(finding, column) for column in COLUMNS} for finding in findings]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def test_files(tests: pd.DataFrame) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of ``tests.csv`` and ``tests.json``."""
    rows = rows_of(tests)
    return {"tests.csv": rows, "tests.json": [*map(plain_row, rows)]}


def rows_of(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table by the names of its columns."""
    return [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]


def grouped(pairs: Iterable[tuple[Key, Value]]) -> dict[Key, list[Value]]:
    """Return the values of each key, in the order of the keys' first occurrence."""
    groups: dict[Key, list[Value]] = {}
    for key, value in pairs:
        groups.setdefault(key, []).append(value)
    return groups


def plain_row(row: dict[Any, Any]) -> dict[str, Any]:
    """Convert a row of a table to plain values for JSON.

    Infinity becomes a word; NaN becomes ``undefined`` for an estimate that does not exist, else null.
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
