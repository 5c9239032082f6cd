"""False alarms in catch trials, and misses.

A false alarm is a catch trial (without a stimulus) in which something was felt; a miss is a trial with a stimulus in
which nothing was felt.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from modaltouch.analysis.findings import Finding, finding_of
from modaltouch.analysis.intervals import BoundedMean
from modaltouch.analysis.responses import Responses

_ABSENT = "none"
"""Name of the answer "nothing felt" if the protocol does not offer one."""


@dataclass(frozen=True)
class CatchRow:
    """Answers to catch trials and misses of one participant.

    Attributes
    ----------
    participant : str
        Participant id; ``all`` for the sum.
    n_catch : int
        Number of catch trials.
    answers : dict of str to int
        Counts of the answers to catch trials, by name.
    n_driven, n_missed : int
        Number of answers to trials with a stimulus, and of misses among them.
    nothing : str
        Name of the answer "nothing felt".
    """

    participant: str
    n_catch: int
    answers: dict[str, int]
    n_driven: int
    n_missed: int
    nothing: str

    @property
    def n_false_alarms(self) -> int:
        """Number of catch trials in which something was felt."""
        return self.n_catch - self.answers[self.nothing]

    @property
    def false_alarms(self) -> str:
        """False alarms out of all catch trials, in words."""
        return f"{self.n_false_alarms} of {self.n_catch}" if self.n_catch else "–"

    def as_dict(self) -> dict[str, Any]:
        """Return the row as plain values."""
        values = asdict(self)
        del values["nothing"]
        return values


def catch_rows(responses: Responses) -> tuple[CatchRow, ...]:
    """Return a row per participant and one for all; empty without catch trials and without an answer "nothing felt"."""
    nothing = responses.answers.naming()
    if not responses.catches and nothing is None:
        return ()
    words = [answer.name for answer in responses.answers.ranked] + ([] if nothing else [_ABSENT])
    name = nothing.name if nothing else _ABSENT
    frame, rows = responses.frame, []
    for who, part in frame.groupby(frame["participant"].astype(str)):
        own = responses.caught(str(who))
        given, n_missed = {word: own[word] for word in words}, int(part["n"][part["response"] == name].sum())
        rows.append(CatchRow(str(who), sum(given.values()), given, int(part["n"].sum()), n_missed, name))
    total = {word: sum(row.answers[word] for row in rows) for word in words}
    n_driven, n_missed = sum(row.n_driven for row in rows), sum(row.n_missed for row in rows)
    return (*rows, CatchRow("all", sum(total.values()), total, n_driven, n_missed, name))


def catch_findings(responses: Responses) -> Iterator[Finding]:
    """Yield the false-alarm and miss rates, estimated over participants without a test."""
    if responses.answers.naming() is None:
        return
    *own, total = catch_rows(responses)
    if total.n_catch:
        words = ", ".join(f"{n_given} {word}" for word, n_given in total.answers.items())
        alarms = [row.n_false_alarms for row in own]
        yield _rate("false alarms", alarms, [row.n_catch for row in own], words, total)
    note = f"{total.n_missed} of {total.n_driven} answers"
    yield _rate("misses", [row.n_missed for row in own], [row.n_driven for row in own], note, total)


def _rate(name: str, counts: list[int], totals: list[int], note: str, total: CatchRow) -> Finding:
    quantity = "P(something felt | nothing driven)" if name == "false alarms" else f"P({total.nothing} | stimulus)"
    mean = BoundedMean([k / n if n else np.nan for k, n in zip(counts, totals, strict=True)], 0.0, 1.0)
    method = "interval of a bounded mean over participants"
    return finding_of("catch", f"{name}, {method}", "all", None, quantity, mean.interval(), int(mean.n), notes=[note])
