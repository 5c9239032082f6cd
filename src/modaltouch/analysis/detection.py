"""d' and criterion of each participant in yes/no, forced-choice and same-different designs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import pandas as pd

from modaltouch.analysis.columns import scale_of, zones_of
from modaltouch.analysis.intervals import Interval
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
