"""Catch trials, in which nothing was driven, and the answer none: false alarms, misses, and detection.

A false alarm is a catch trial in which something was felt; a miss is a trial with a stimulus in which nothing was.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.covariates import detection
from modaltouch.analysis.findings import Finding, finding_of
from modaltouch.analysis.intervals import Interval
from modaltouch.analysis.means import BoundedMean

_ABSENT = "none"
"""Stands for the answer that nothing was felt where none says it."""

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
        Answers to trials with a stimulus, and those of them that nothing was felt.
    nothing : str
        Name of that answer.
    """

    participant: str
    n_catch: int
    answers: dict[str, int]
    n_driven: int
    n_missed: int
    nothing: str

    @property
    def n_false_alarms(self) -> int:
        """Catch trials answered with a finger."""
        return self.n_catch - self.answers[self.nothing]

    @property
    def false_alarms(self) -> str:
        """Number and share of the false alarms, in words."""
        return f"{self.n_false_alarms} of {self.n_catch}" if self.n_catch else "–"

    def as_dict(self) -> dict[str, Any]:
        """Return the row as plain values."""
        values = asdict(self)
        del values["nothing"]
        return values


def catch_rows(answers: AnswerCounts, catches: Catches) -> tuple[CatchRow, ...]:
    """Return a row for each participant and one for all; empty where there is neither catch trial nor answer none."""
    if not catches and not answers.offers_none:
        return ()
    missed, nothing = _missed(answers), answers.answers.naming()
    driven: list[int] = answers.counts.sum(axis=(1, 2, 3, 4)).tolist()
    words = [answer.name for answer in answers.answers.ranked] + ([] if nothing else [_ABSENT])
    name_of_nothing = nothing.name if nothing else _ABSENT
    rows = []
    for name, n_missed, n_driven in zip(answers.participants, missed, driven, strict=True):
        own = catches.get(name, Counter())
        given = {word: own[word] for word in words}
        rows.append(CatchRow(name, sum(given.values()), given, n_driven, n_missed, name_of_nothing))
    total = {word: sum(row.answers[word] for row in rows) for word in words}
    rows.append(CatchRow("all", sum(total.values()), total, sum(driven), sum(missed), name_of_nothing))
    return tuple(rows)


def catch_findings(answers: AnswerCounts, catches: Catches) -> Iterator[Finding]:
    """Yield the rates of false alarms and misses, and detection; estimates over participants, no p.

    Parameters
    ----------
    answers, catches
        As `catch_rows` takes them.
    """
    rows = catch_rows(answers, catches)
    if not rows or not answers.offers_none:
        return
    *own, total = rows
    if total.n_catch:
        words = ", ".join(f"{n_given} {word}" for word, n_given in total.answers.items())
        alarms = [row.n_false_alarms for row in own]
        yield _rate("false alarms", alarms, [row.n_catch for row in own], words, total)
    note = f"{total.n_missed} of {total.n_driven} answers"
    yield _rate("misses", [row.n_missed for row in own], [row.n_driven for row in own], note, total)
    if total.n_catch:
        driven = np.array([total.n_missed, total.n_driven - total.n_missed])
        silent = np.array([total.n_catch - total.n_false_alarms, total.n_false_alarms])
        sensitivity, criterion = detection(driven, silent)
        yield finding_of(
            "catch",
            "detection, log-linear correction",
            "all",
            None,
            "d'",
            Interval(sensitivity, np.nan, np.nan, len(own)),
            len(own),
            notes=[f"criterion c {criterion:.2f}", "all answers together, so no interval"],
        )


def _missed(answers: AnswerCounts) -> list[int]:
    nothing = answers.answers.naming()
    if nothing is None:
        return [0] * answers.n_participants
    missed: list[int] = answers.counts[..., answers.answers.index(nothing)].sum(axis=(1, 2, 3)).tolist()
    return missed


def _rate(name: str, counts: list[int], totals: list[int], note: str, total: CatchRow) -> Finding:
    quantity = "P(a finger | nothing driven)" if name == "false alarms" else f"P({total.nothing} | stimulus)"
    mean = BoundedMean([k / n if n else np.nan for k, n in zip(counts, totals, strict=True)], 0.0, 1.0)
    method = "interval of a bounded mean over participants"
    return finding_of("catch", f"{name}, {method}", "all", None, quantity, mean.interval(), int(mean.n), notes=[note])
