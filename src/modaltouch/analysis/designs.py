"""Individual measures (sensitivity, psychometric functions, ratings), and their comparison between groups.

Ratings and further questions have means and shares, rank tests over levels, and the power law of magnitude estimates.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from modaltouch.analysis.columns import LevelScale, scale_of
from modaltouch.analysis.counts import Pair
from modaltouch.analysis.detection import CatchRow, catch_findings, catch_rows, sensitivities
from modaltouch.analysis.findings import Finding, finding_of
from modaltouch.analysis.intervals import Interval, student_quantile
from modaltouch.analysis.measures import (
    IndividualValue,
    Measure,
    Places,
    cells,
    contrast_findings,
    from_linear,
    group_findings,
    linear,
    mean_findings,
)
from modaltouch.analysis.permutation import by_ranks, friedman
from modaltouch.analysis.psychometric import FittedCell, fit_cells, measures_of_fits
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.task import TrialTask
from modaltouch.analysis.words import certificates_in_words
from modaltouch.protocol import ScaleSection

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


@dataclass(frozen=True)
class Question:
    """A question with a rating scale, or one answer to a question with a list of answers.

    Attributes
    ----------
    name : str
        Name of the question.
    column : str
        Column of the tidy answers.
    is_magnitude : bool
        Whether answers are magnitude estimates, compared as ratios.
    answers : tuple of str
        List of answers; empty for a scale.
    counted : str
        Answer of the list whose share is computed.
    ends : (float, float) or None
        Lowest and highest rating, if the scale is bounded.
    """

    name: str
    column: str
    is_magnitude: bool = False
    answers: tuple[str, ...] = ()
    counted: str = ""
    ends: tuple[float, float] | None = None

    @classmethod
    def of(cls, name: str, column: str, asked: Mapping[str, Any]) -> tuple[Question, ...]:
        """Return a question of the protocol with a scale, or one for each (unordered) answer of its list."""
        if answers := tuple(asked.get("keys") or ()):
            # Of two answers, the share of the second determines both.
            counted = answers[len(answers) == 2 :]
            return tuple(cls(f"P({name}: {each})", column, False, answers, each, (0.0, 1.0)) for each in counted)
        if not asked.get("scale"):
            return (cls(name, column),)
        scale = ScaleSection.model_validate(asked["scale"])
        ends = None if math.isinf(scale.high) else (scale.low, scale.high)
        # Zero and negative numbers have no ratios.
        is_magnitude = scale.kind == "number" and (scale.lowest is None or scale.lowest > 0)
        return (cls("magnitude" if is_magnitude and column == "value" else name, column, is_magnitude, ends=ends),)

    @property
    def measure(self) -> Measure:
        """Measure of a participant's mean rating or share."""
        way = " (geometric mean)" if self.is_magnitude else ""
        ends = None if self.is_magnitude else self.ends
        return Measure(self.name, f"{self.name}{way}", "rating", None, self.is_magnitude, True, ends)

    def numbers(self, frame: pd.DataFrame) -> pd.Series:
        """Return the ratings, or 1 for the counted answer and 0 for others; NaN if missing.

        Magnitudes that are not positive are treated as missing.
        """
        if self.answers:
            given = frame[self.column].astype(str)
            return (given == self.counted).astype(float).where(given.isin(self.answers))
        values = pd.to_numeric(frame[self.column], errors="coerce")
        return values.where(values > 0) if self.is_magnitude else values

    def modelled(self, frame: pd.DataFrame) -> pd.Series:
        """Return the answers for a table of models: words of the list, or ratings."""
        return frame[self.column].astype(str) if self.answers else self.numbers(frame)


def questions_of(design: Mapping[str, Any], frame: pd.DataFrame) -> tuple[Question, ...]:
    """Return the rating questions: that of the trial, if it has a scale, and further questions.

    Parameters
    ----------
    design : mapping
        Sections of the protocol; if empty (unknown), a column ``value`` holds the ratings.
    frame : DataFrame
        Tidy answers.
    """
    section = design.get("answers") or {}
    known: list[Question] = []
    if "value" in frame.columns and pd.to_numeric(frame["value"], errors="coerce").notna().any():
        known += Question.of("rating", "value", {"scale": section.get("scale")})
    for name, asked in (section.get("then") or {}).items():
        known += Question.of(name, name, asked)
    return tuple(each for each in known if each.column in frame.columns)


def ratings(responses: Responses, asked: Sequence[Question]) -> Iterator[IndividualValue]:
    """Yield mean ratings by level, and power-law exponents.

    Parameters
    ----------
    responses : Responses
        The answers.
    asked : sequence of Question
        Rating questions.
    """
    frame, scale = responses.frame, scale_of(responses.frame.columns)
    for question in asked:
        rated = frame.assign(rated=question.numbers(frame))
        rated = rated[rated["rated"].notna()]
        for cell, part in cells(rated, scale, by_level=True):
            values = part["rated"].to_numpy(dtype=float)
            mean = math.exp(np.log(values).mean()) if question.is_magnitude else float(values.mean())
            yield IndividualValue(question.measure, *cell, Interval.point(mean, len(values)), len(values))
        for cell, part in cells(rated, scale, by_level=False) if question.is_magnitude else ():
            if part[scale.column].nunique() > 1:
                exponent = Measure(f"exponent of {question.name}", "exponent of the power law", "rating", 0.0)
                yield IndividualValue(exponent, *cell, power_law(part[scale.column], part["rated"]), len(part))


def power_law(levels: ArrayLike, magnitudes: ArrayLike) -> Interval:
    """Fit the power law of magnitude over level by log-log least squares, and return its exponent with the t interval.

    Without any deviation from the power law, there is no interval.

    Parameters
    ----------
    levels, magnitudes : (n,) arrays
        Level and magnitude estimate of each answer, positive.

    References
    ----------
    Stevens, "Psychophysics" (1975), chapter 1.
    """
    x, y = np.log(np.asarray(levels, dtype=float)), np.log(np.asarray(magnitudes, dtype=float))
    spread = ((x - x.mean()) ** 2).sum()
    slope = float(((x - x.mean()) * (y - y.mean())).sum() / spread)
    residual = y - y.mean() - slope * (x - x.mean())
    if len(x) < 3 or np.abs(residual).max() < 1e-12:
        return Interval.point(slope, len(x))
    half = student_quantile(len(x) - 2) * math.sqrt(float((residual**2).sum()) / (len(x) - 2) / spread)
    return Interval(slope, slope - half, slope + half, len(x))


def level_findings(values: Sequence[IndividualValue], groups: Mapping[str, str]) -> Iterator[Finding]:
    """Yield Friedman's test of each rating over levels, with Kendall's W; for two levels, the signed-rank test.

    Groups with different levels are tested separately.

    Parameters
    ----------
    values : sequence of IndividualValue
        Ratings by level.
    groups : mapping of str to str
        Group of each participant; empty if there is only one.
    """
    tables: dict[tuple[Measure, str], dict[str, dict[float, float]]] = {}
    for each in values:
        if each.measure.is_ranked:
            own = tables.setdefault((each.measure, f"{each.finger_condition} {each.pair}"), {})
            own.setdefault(each.participant, {})[each.level] = linear(each)
    for (measure, scope), everybody in tables.items():
        met: dict[str, set[float]] = {}
        for who, rated in everybody.items():
            met.setdefault(groups.get(who, ""), set()).update(rated)
        for levels in map(sorted, dict.fromkeys(map(frozenset, met.values()))):
            alike = [name for name in met if met[name] == {*levels}]
            people = [rated for who, rated in everybody.items() if groups.get(who, "") in alike]
            where = f"{scope} {', '.join(alike)}" if len(alike) < len(met) else scope
            rows = np.array([[own[level] for level in levels] for own in people if len(own) == len(levels)])
            if len(levels) < 2 or len(rows) < 2:
                continue
            yield _over_levels(measure, where, len(people) - len(rows), rows)


def _over_levels(measure: Measure, scope: str, left_out: int, rows: np.ndarray) -> Finding:
    """Return the test of a rating over levels, given the (n_participants, n_levels) ratings."""
    if rows.shape[1] == 2:
        test, interval = by_ranks(rows[:, 1] - rows[:, 0])
        way, interval = "signed ranks", from_linear(measure, interval)
        quantity = f"{'ratio' if measure.is_ratio else 'difference'} of {measure.quantity}, higher to lower level"
    else:
        test, concordance = friedman(rows)
        way, interval = "Friedman's test by shuffles within participants", Interval.point(concordance, len(rows))
        quantity = "Kendall's W"
    return finding_of(
        "rating", f"{measure.name} over levels, {way}", scope, test, quantity, interval, len(rows),
        family="rating over levels",
        notes=[f"participants without a rating at every level, left out: {left_out}" if left_out else ""],
    )  # fmt: skip
