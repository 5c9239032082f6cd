"""Psychometric functions by the method of constant stimuli: threshold or point of subjective equality (PSE).

With one interval, a success is an answer that something was felt, and catch trials give the guess rate. With several,
it is a correct answer if no comparison is below the standard. If some are, and the stronger of two intervals is asked
for, it is a choice of the comparison.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.columns import LevelScale, scale_of
from modaltouch.analysis.intervals import Interval
from modaltouch.analysis.measures import Cell, IndividualValue, Measure, cells, kind_of
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.task import TrialTask
from modaltouch.analysis.thresholds.psychometric import Psychometric, fit_psychometric

MOST_LAPSE = 0.02
"""Maximum lapse rate of a fit, at either end [1]; with 0.05, the spread from 144 answers is 10 % too small."""

FEWEST_LEVELS = 3

JND_OF_SPREAD = NormalDist().inv_cdf(0.75)
"""Ratio of the just noticeable difference (from 50 % to 75 % of the answers) to the spread [1]."""


@dataclass(frozen=True, eq=False)
class FittedCell:
    """Psychometric function of one participant in one finger condition and pair of zones.

    Attributes
    ----------
    cell : Cell
        Participant and cell.
    levels, shares, tries : (n_levels,) arrays
        Levels [mm/s, or multiples of own threshold], proportions of successes [1], and numbers of answers.
    fitted : Psychometric
        The function, in dB re one unit of the levels.
    is_choice : bool
        Whether a success is a choice of the comparison, so that the midpoint is a point of subjective equality.
    """

    cell: Cell
    levels: NDArray[np.float64]
    shares: NDArray[np.float64]
    tries: NDArray[np.float64]
    fitted: Psychometric
    is_choice: bool


def fit_cells(responses: Responses, task: TrialTask) -> tuple[FittedCell, ...]:
    """Fit the psychometric functions; empty if the design has none, e.g. with fewer than three levels.

    Parameters
    ----------
    responses : Responses
        The answers.
    task : TrialTask
        Task of the participant.
    """
    scale = scale_of(responses.frame.columns)
    frame = task.told(responses.frame, scale.column)
    is_felt = task.n_intervals == 1 and responses.answers.naming() is not None and not responses.answers.compares
    if frame[scale.column].nunique() < FEWEST_LEVELS or not (task.named or is_felt):
        return ()
    if task.no_d_prime_reason:  # the guess rate is unknown, too
        return ()
    is_below = bool(task.named) and bool((frame[scale.column] < task.standard).any())
    is_choice = is_below and task.turns(-math.inf)
    if is_below and not is_choice:
        return ()
    return tuple(
        _fit(cell, part, responses, task, scale, is_choice) for cell, part in cells(frame, scale, by_level=False)
    )


def _fit(
    cell: Cell, part: pd.DataFrame, responses: Responses, task: TrialTask, scale: LevelScale, is_choice: bool
) -> FittedCell:
    answers, catches = part.loc[part.index.repeat(part["n"])], []
    guess_rate: float | NDArray[np.float64] = 1 / task.n_intervals
    if task.named:
        success = answers["response"].map(task.named).astype(int) == answers["interval"].astype(int)
    else:
        nothing = {each.name for each in responses.answers if each.means_nothing_felt}
        success, guess_rate = ~answers["response"].isin(nothing), 0.0
        catches = [word not in nothing for word in responses.caught(cell[0], cell[1], kind_of(part)).elements()]
    if is_choice:
        guess_rate = np.linspace(0.0, MOST_LAPSE, 3)
    given = answers[scale.column].to_numpy(dtype=float)
    fitted = fit_psychometric(
        (20 * np.log10(given)).tolist(), success.tolist(), guess_rate=guess_rate, most_lapse=MOST_LAPSE,
        catches=catches, unit=scale.unit,
    )  # fmt: skip
    levels, places = np.unique(given, return_inverse=True)
    tries = np.bincount(places).astype(float)
    return FittedCell(cell, levels, np.bincount(places, weights=success) / tries, tries, fitted, is_choice)


def measures_of_fits(fits: tuple[FittedCell, ...], task: TrialTask, scale: LevelScale) -> Iterator[IndividualValue]:
    """Yield the threshold, or the PSE and the just noticeable difference, of each function."""
    name = "threshold" if task.named else "detection threshold"
    threshold = Measure(name, f"{name} [{scale.unit}]", "function", is_ratio=True)
    equal = Measure("PSE", f"point of subjective equality [{scale.unit}]", "function", task.standard or None, True)
    jnd = Measure("JND", "just noticeable difference [dB]", "function")
    for each in fits:
        fitted, n = each.fitted, each.fitted.n_trials
        value = _interval(fitted.threshold, lambda level: 10 ** (level / 20))
        yield IndividualValue(equal if each.is_choice else threshold, *each.cell, value, n, fitted.why_not)
        if each.is_choice:
            yield IndividualValue(
                jnd,
                *each.cell,
                _interval(fitted.spread, lambda spread: JND_OF_SPREAD * max(spread, 0.0)),
                n,
                fitted.why_not,
            )


def _interval(estimate: Interval | None, told: Callable[[float], float]) -> Interval:
    return Interval.point(math.nan, 0) if estimate is None else estimate.changed(told)
