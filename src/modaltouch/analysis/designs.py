"""Individual measures (sensitivity, psychometric functions, ratings), and their comparison between groups."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

from modaltouch.analysis.columns import LevelScale, scale_of
from modaltouch.analysis.counts import Pair
from modaltouch.analysis.detection import CatchRow, catch_findings, catch_rows, sensitivities
from modaltouch.analysis.findings import Finding
from modaltouch.analysis.intervals import Interval
from modaltouch.analysis.measures import (
    IndividualValue,
    Measure,
    Places,
    cells,
    contrast_findings,
    group_findings,
    mean_findings,
)
from modaltouch.analysis.psychometric import FittedCell, fit_cells, measures_of_fits
from modaltouch.analysis.ratings import level_findings, questions_of, ratings
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.task import TrialTask
from modaltouch.analysis.words import certificates_in_words

# Certificates of individual intervals, by a substring of the model's or measure's name; the first match applies.
_CERTIFICATES = {
    "detection threshold": "detection threshold of one",
    "differencing criterion": "differencing criterion of one", "criterion": "criterion of one",
    "differencing": "same and different of one", "2AFC": "d' of one", "AFC": "a1 share", "triangular": "a1 share",
    "d'": "d' of one", "threshold": "threshold of one", "PSE": "PSE of one", "JND": "JND of one",
    "exponent": "exponent of one",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class DesignAnalysis:
    """Results of individual participants.

    Attributes
    ----------
    values : tuple of IndividualValue
        Measures of each participant.
    fits : tuple of FittedCell
        Psychometric functions of each participant.
    findings : tuple of Finding
        Findings over participants and between groups, before Holm's correction.
    catches : tuple of CatchRow
        Answers to catch trials.
    scale : LevelScale
        Scale of the levels.
    groups : dict of str to str
        Group of each participant; empty if there is only one.
    limits : tuple of str
        Limitations of the design, in words.
    shared : tuple of IndividualValue
        Values from the cells common to all groups.
    """

    values: tuple[IndividualValue, ...]
    fits: tuple[FittedCell, ...]
    findings: tuple[Finding, ...]
    catches: tuple[CatchRow, ...]
    scale: LevelScale
    groups: Mapping[str, str]
    limits: tuple[str, ...] = ()
    shared: tuple[IndividualValue, ...] = ()

    @cached_property
    def rows(self) -> list[dict[str, Any]]:
        """Rows of ``measures.csv``."""
        return [each.as_dict(self.scale, self.groups) for each in self.values]

    @property
    def certified(self) -> str:
        """Simulated error rates of the reported individual intervals, in words."""
        bounded = (each for each in self.values if not math.isnan(each.interval.low))
        described = dict.fromkeys(f"{each.note} {each.measure.name}" for each in bounded)
        names = (next((name for part, name in _CERTIFICATES.items() if part in each), "") for each in described)
        return certificates_in_words(dict.fromkeys(names))


def analyse_design(responses: Responses, parts: Sequence[Places] | None = None) -> DesignAnalysis:
    """Compute the individual measures of a design, and compare groups.

    Parameters
    ----------
    responses : Responses
        The answers as given.
    parts : sequence of Places, optional
        Places of each crossed part of a design that is not crossed; shares are compared between parts.
    """
    task, scale, groups = responses.task, scale_of(responses.frame.columns), responses.groups
    fits, names = fit_cells(responses, task), tuple(dict.fromkeys(groups.values()))
    values = tuple(_measures(responses, fits))
    is_within = bool(responses.stimuli or responses.kinds) or len(parts or ()) > 1
    shares = tuple(_shares(responses)) if groups or is_within else ()
    every = (*values, *shares)
    shared = {some: _shared(responses, some, every) for some in (*combinations(names, 2), names) if some}
    findings = (
        *catch_findings(responses),
        *mean_findings(values, scale, groups),
        *contrast_findings(every if is_within else values, parts),
        *level_findings(values, groups),
        *(row for two in combinations(names, 2) for row in group_findings(every, shared[two], groups, two)),
    )
    limits, catches = _limits(responses, task, fits), catch_rows(responses)
    return DesignAnalysis(values, fits, findings, catches, scale, groups, limits, shared.get(names, ()))


def _measures(responses: Responses, fits: tuple[FittedCell, ...]) -> Iterator[IndividualValue]:
    task, frame = responses.task, responses.frame
    yield from sensitivities(responses, task)
    yield from measures_of_fits(fits, task, scale_of(frame.columns))
    yield from ratings(responses, questions_of(responses.design, frame))


def _shared(
    responses: Responses, groups: Sequence[str], values: tuple[IndividualValue, ...]
) -> tuple[IndividualValue, ...]:
    """Return the values from the cells common to some groups; `values` if all cells are common."""
    met = responses.of_groups(groups)
    if len(met.frame) == responses.frame["group"].isin(groups).sum():
        return values
    return () if met.frame.empty else (*_measures(met, fit_cells(met, met.task)), *_shares(met))


def _limits(responses: Responses, task: TrialTask, fits: Sequence[FittedCell]) -> tuple[str, ...]:
    """Return notes on what is not tested or estimated here, and on the files for other analyses."""
    frame = responses.frame
    missing = {asked.column: int(asked.numbers(frame).isna().sum()) for asked in questions_of(responses.design, frame)}
    known = (
        *(
            (n, f"Of {len(frame)} answers to {column}, {n} are missing: its results are those of the others.")
            for column, n in missing.items()
        ),
        (
            task.n_intervals > 1 and not (task.named or task.different),
            "No answer says which interval it names, or same or different (answers.intervals), so neither d' nor a "
            "threshold is estimated.",
        ),
        (
            task.named and not fits and frame[scale_of(frame.columns).column].nunique() > 2,
            "No psychometric function is fitted: with the question asked, the answers do not rise with the level.",
        ),
        (
            task.named and set(responses.answers.names) - task.named.keys(),
            "Answers that name no interval are left out of d' and of psychometric functions.",
        ),
        (
            task.named and (task.n_intervals > 2 or frame["interval"].nunique() < 2),
            "d' assumes no preference for an interval: these answers cannot show a preference.",
        ),
        (
            True,
            "No test here covers interactions between factors, or several measures together: answers.csv is a tidy "
            "table for tests of your own, and models.R fits mixed models to it.",
        ),
    )
    return tuple(limit for holds, limit in known if holds)


def _shares(responses: Responses) -> Iterator[IndividualValue]:
    chosen = responses.by_choice()
    counts = chosen.count()
    for cell, part in cells(chosen.frame, counts.scale, by_level=True):
        first = part.iloc[0]
        left, right, between = (str(first.get(f"zone_{side}", "")) for side in ("left", "right", "between"))
        pair = Pair.of(left, right, str(first.get("focus", counts.focus)), between)
        n = int(part["n"].sum())
        for word, place in counts.effects(pair):
            given = int(part["n"][part["response"] == counts.answers.names[place]].sum())
            measure = Measure(f"P({word})", f"P({word})", "shares")
            yield IndividualValue(measure, *cell, Interval.point(given / n, n), n)
