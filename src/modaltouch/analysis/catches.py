"""Catch trials, in which nothing was driven, and the answer none: false alarms, misses, and detection.

A false alarm is a catch trial answered with a finger; a miss is a trial with a stimulus answered with none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from modaltouch.analysis.counts import NONE, AnswerCounts
from modaltouch.analysis.findings import Finding
from modaltouch.analysis.intervals import Interval, clopper_pearson, korn_graubard
from modaltouch.protocol import ANSWERS_WITH_NONE

Catches = Mapping[str, Counter[str]]
"""Answers to catch trials by participant."""


@dataclass(frozen=True)
class CatchRow:
    """What one participant answered where nothing was driven, and how often none where something was.

    Attributes
    ----------
    participant : str
        Who; ``all`` for the sum.
    n_catch : int
        Catch trials.
    answers : dict of str to int
        Answers to them, by word.
    n_driven, n_missed : int
        Answers to trials with a stimulus, and those of them that were none.
    """

    participant: str
    n_catch: int
    answers: dict[str, int]
    n_driven: int
    n_missed: int

    @property
    def n_false_alarms(self) -> int:
        """Catch trials answered with a finger."""
        return self.n_catch - self.answers["none"]

    @property
    def false_alarms(self) -> str:
        """Number and share of the false alarms, in words."""
        return f"{self.n_false_alarms} of {self.n_catch}" if self.n_catch else "–"


def catch_rows(answers: AnswerCounts, catches: Catches) -> tuple[CatchRow, ...]:
    """Return a row for each participant and one for all; empty where there is neither catch trial nor answer none."""
    if not catches and not answers.offers_none:
        return ()
    missed = _missed(answers)
    n_driven = answers.n_answers * len(answers.pairs) * len(answers.finger_conditions)
    rows = []
    for name, n_missed in zip(answers.participants, missed, strict=True):
        own = catches.get(name, Counter())
        given: dict[str, int] = {word: own[word] for word in ANSWERS_WITH_NONE}
        rows.append(CatchRow(name, sum(given.values()), given, n_driven, n_missed))
    total: dict[str, int] = {word: sum(row.answers[word] for row in rows) for word in ANSWERS_WITH_NONE}
    rows.append(CatchRow("all", sum(total.values()), total, n_driven * len(rows), sum(missed)))
    return tuple(rows)


def catch_findings(answers: AnswerCounts, catches: Catches) -> Iterator[Finding]:
    """Yield the rates of false alarms and misses, and detection; estimates over participants, no p.

    Parameters
    ----------
    answers, catches
        As `catch_rows` takes them.
    """
    *rows, total = catch_rows(answers, catches) or (None,)
    if total is None or not answers.offers_none:
        return
    n = len(rows)
    if total.n_catch:
        alarms = [row.n_false_alarms for row in rows if row is not None]
        words = ", ".join(f"{total.answers[word]} {word}" for word in ANSWERS_WITH_NONE)
        yield _rate("false alarms", alarms, [row.n_catch for row in rows if row is not None], words)
    misses = [row.n_missed for row in rows if row is not None]
    note = f"{total.n_missed} of {total.n_driven} answers"
    yield _rate("misses", misses, [row.n_driven for row in rows if row is not None], note)
    if total.n_catch:
        hit = (total.n_driven - total.n_missed + 0.5) / (total.n_driven + 1)
        alarm = (total.n_false_alarms + 0.5) / (total.n_catch + 1)
        z = NormalDist().inv_cdf
        sensitivity = z(hit) - z(alarm)
        yield Finding(
            "catch", "detection, log-linear correction", "all", "d'", sensitivity, np.nan, np.nan, n,
            note=f"criterion c {-(z(hit) + z(alarm)) / 2:.2f}; all answers together, so no interval",
        )  # fmt: skip


def _missed(answers: AnswerCounts) -> list[int]:
    if not answers.offers_none:
        return [0] * answers.n_participants
    missed: list[int] = answers.counts[..., NONE].sum(axis=(1, 2, 3)).tolist()
    return missed


def _rate(name: str, counts: list[int], totals: list[int], note: str) -> Finding:
    quantity = "P(a finger | nothing driven)" if name == "false alarms" else "P(none | stimulus)"
    interval: Interval
    if len(set(totals)) == 1:
        interval = korn_graubard(np.array(counts), totals[0])
        method = "Korn-Graubard interval over participants"
    else:
        interval = clopper_pearson(sum(counts), sum(totals))
        method = "Clopper-Pearson interval over answers"
    return Finding(
        "catch", f"{name}, {method}", "all", quantity, interval.estimate, interval.low, interval.high,
        len(counts), note=note,
    )  # fmt: skip
