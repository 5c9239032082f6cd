"""d' and criterion of each participant in yes/no, forced-choice and same-different designs; false alarms and misses.

A false alarm is a catch trial (without a stimulus) in which something was felt; a miss is a trial with a stimulus in
which nothing was felt.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import pandas as pd

from modaltouch.analysis.columns import scale_of, zones_of
from modaltouch.analysis.findings import Finding, finding_of
from modaltouch.analysis.intervals import BoundedMean, Interval
from modaltouch.analysis.measures import Cell, IndividualValue, Measure, cells, kind_of
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.sensitivity import (
    Count,
    SignalDetection,
    m_intervals,
    odd_of_three,
    same_different,
    two_intervals,
    yes_no,
)
from modaltouch.analysis.task import TrialTask

D_PRIME = Measure("d'", "sensitivity d'", "sensitivity", null=0.0)
CRITERION = Measure("criterion", "criterion c", "sensitivity")
DIFFERENCE = Measure("differencing criterion", "least difference called different", "sensitivity")

FEWEST = 4
"""Minimum number of answers per participant and cell to compute d' at each level rather than over all levels."""


def sensitivities(responses: Responses, task: TrialTask) -> Iterator[IndividualValue]:
    """Yield d' and criterion of each participant, if the design determines them.

    With one interval, they follow from the answer "nothing felt" and catch trials, or from a choice between two fingers
    of which one touches the focus; with several intervals, from the interval chosen, or from "same" and "different".

    Parameters
    ----------
    responses : Responses
        The answers.
    task : TrialTask
        Task of the participant.
    """
    left, right = (responses.answers.naming(side) for side in ("left", "right"))
    if left and right and len(responses.answers) == 2 and responses.focus:
        # Two alternatives in space: treat the finger on the focus as the interval of the signal.
        focus = responses.frame.get("focus", responses.focus)
        place = sum(k * (responses.frame[f"zone_{side}"] == focus) for k, side in ((1, "left"), (2, "right")))
        frame = responses.frame.assign(interval=place, zone_left="", zone_right="")
        responses = replace(responses, frame=frame[frame["interval"] > 0])
        task = TrialTask(2, {left.name: 1, right.name: 2})
    scale = scale_of(responses.frame.columns)
    frame = task.told(responses.frame, scale.column)
    per_cell = [int(part["n"].sum()) for _, part in cells(frame, scale, by_level=True)]
    by_level = min(per_cell, default=0) >= FEWEST
    if task.different:
        yield from _of_differences(frame, task)
    elif task.named:
        for cell, part in cells(frame, scale, by_level=by_level or not task.detects):
            # If the standard is an equally strong stimulus with another field, no answer is correct; use the PSE.
            is_right = task.detects or task.tells(cell[-1])
            if is_right and not task.is_same(part, scale.column).all():
                why = task.no_d_prime_reason
                yield from (
                    _without_d_prime(cell, why, part) if why else _told(cell, _of_intervals(part, task, cell[-1]), part)
                )
    elif responses.answers.naming() is not None:
        nothing = [each.name for each in responses.answers if each.means_nothing_felt]
        if responses.answers.compares:  # fingers are compared: pool felt or not over cells
            frame, by_level = frame.assign(finger_condition="all", zone_left="", zone_right=""), False
        for cell, part in cells(frame, scale, by_level=by_level):
            # The criterion may differ with other fingers or before training, so use only false alarms from this cell.
            caught = responses.caught(cell[0], cell[1], kind_of(part))
            alarms = caught.total() - sum(caught[word] for word in nothing), caught.total()
            if caught:
                yield from _told(cell, yes_no(_share(part, ~part["response"].isin(nothing)), alarms), part)
            elif responses.catches:
                yield from _without_d_prime(cell, "answers without catch trials of their own", part)


def _of_intervals(part: pd.DataFrame, task: TrialTask, level: float) -> SignalDetection:
    """Return the sensitivity in a cell of a forced-choice design."""
    place, named = part["interval"].astype(int), part["response"].map(task.named).astype(int)
    if task.turns(level):
        place = 3 - place
    if task.n_intervals == 3 and not task.asks_stronger and not task.detects:
        return odd_of_three(_share(part, named == place))
    if task.n_intervals != 2 or place.nunique() < 2:
        return m_intervals(_share(part, named == place), task.n_intervals)
    first, second = (_share(part[place == each], named[place == each] == 1) for each in (1, 2))
    return two_intervals(first, second)


def _of_differences(frame: pd.DataFrame, task: TrialTask) -> Iterator[IndividualValue]:
    """Yield d' of a same-different design by level; trials whose comparison equals the standard are "same" trials."""
    scale = scale_of(frame.columns)
    is_same = task.is_same(frame, scale.column)
    alike = frame[is_same]
    # Match "same" trials by fingers and zones, and by level or stimulus if the standard has that of the comparison.
    keys = ["participant", "finger_condition", *zones_of(frame.columns), "session_kind"]
    keys += [scale.column] * math.isnan(task.standard) + ["stimulus"] * (not task.stimulus)
    keys = [name for name in keys if name in frame.columns]
    for cell, part in cells(frame[~is_same], scale, by_level=True):
        own = alike[(alike[keys].astype(str) == part[keys].iloc[0].astype(str)).all(axis=1)]
        why = task.no_d_prime_reason or ("" if len(own) else "no trial whose stimuli are the same")
        called = (_share(each, each["response"].isin(task.different)) for each in (part, own))
        yield from _without_d_prime(cell, why, part) if why else _told(cell, same_different(*called), part)


def _share(part: pd.DataFrame, chosen: pd.Series) -> Count:
    return int(part["n"][chosen].sum()), int(part["n"].sum())


def _without_d_prime(cell: Cell, why: str, part: pd.DataFrame) -> Iterator[IndividualValue]:
    yield IndividualValue(D_PRIME, *cell, Interval.point(math.nan, 0), int(part["n"].sum()), f"no d' from {why}")


def _told(cell: Cell, found: SignalDetection, part: pd.DataFrame) -> Iterator[IndividualValue]:
    n = int(part["n"].sum())
    yield IndividualValue(D_PRIME, *cell, found.d_prime, n, f"{found.model} model", found.contrast)
    if found.criterion is not None and math.isfinite(found.criterion.estimate):
        measure = DIFFERENCE if found.model.startswith("differencing") else CRITERION
        yield IndividualValue(measure, *cell, found.criterion, n, f"{found.model} model")


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
    mean = BoundedMean([k / n if n else math.nan for k, n in zip(counts, totals, strict=True)], 0.0, 1.0)
    method = "interval of a bounded mean over participants"
    return finding_of("catch", f"{name}, {method}", "all", None, quantity, mean.interval(), int(mean.n), notes=[note])
