"""Ratings and further answers: means and shares, rank tests over levels, the power law of magnitude estimates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from modaltouch.analysis.association import shuffle_conditions
from modaltouch.analysis.exact import ExactTest
from modaltouch.analysis.findings import Finding, finding_of
from modaltouch.analysis.intervals import Interval, student_quantile
from modaltouch.analysis.location import by_ranks
from modaltouch.analysis.measures import IndividualValue, Measure, as_told, cells, linear
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.scale import LevelScale, scale_of
from modaltouch.analysis.task import TrialTask
from modaltouch.protocol import ScaleSection


@dataclass(frozen=True)
class Question:
    """Something that was rated, or an answer of a list, which is counted.

    Attributes
    ----------
    name : str
        Its name.
    column : str
        Column of the tidy answers.
    is_magnitude : bool
        Whether numbers were typed, to be compared as ratios.
    answers : tuple of str
        The list of answers; empty for a scale.
    counted : str
        The answer of the list whose share is taken.
    ends : (float, float) or None
        Lowest and highest rating, if the scale has them.
    """

    name: str
    column: str
    is_magnitude: bool = False
    answers: tuple[str, ...] = ()
    counted: str = ""
    ends: tuple[float, float] | None = None

    @classmethod
    def of(cls, name: str, column: str, asked: Mapping[str, Any]) -> tuple[Question, ...]:
        """Return a question of the protocol with a scale, or the answers of its list, which need have no order."""
        if answers := tuple(asked.get("keys") or ()):
            # Of two answers, the share of the second tells both.
            counted = answers[len(answers) == 2 :]
            return tuple(cls(f"P({name}: {each})", column, False, answers, each, (0.0, 1.0)) for each in counted)
        if not asked.get("scale"):
            return (cls(name, column),)
        scale = ScaleSection.model_validate(asked["scale"])
        ends = None if math.isinf(scale.high) else (scale.low, scale.high)
        return (cls(name, column, scale.kind == "number", ends=ends),)

    @property
    def measure(self) -> Measure:
        """The measure that a participant's mean is a value of."""
        way = " (geometric mean)" if self.is_magnitude else ""
        ends = None if self.is_magnitude else self.ends
        return Measure(self.name, f"{self.name}{way}", "rating", None, self.is_magnitude, is_ranked=True, ends=ends)

    def numbers(self, frame: pd.DataFrame) -> pd.Series:
        """Return the rating of each answer, or 1 if it is the counted one and 0 if not; NaN where there is none.

        A magnitude that is not above zero is none.
        """
        if self.answers:
            given = frame[self.column].astype(str)
            return (given == self.counted).astype(float).where(given.isin(self.answers))
        values = pd.to_numeric(frame[self.column], errors="coerce")
        return values.where(values > 0) if self.is_magnitude else values

    def told(self, frame: pd.DataFrame) -> pd.Series:
        """Return what was answered, as a table for models has it: a word of the list, or the rating."""
        return frame[self.column].astype(str) if self.answers else self.numbers(frame)


def questions_of(design: Mapping[str, Any], frame: pd.DataFrame) -> tuple[Question, ...]:
    """Return what was rated: the question of the trial, if it has a scale, and further questions.

    Parameters
    ----------
    design : mapping
        The protocol's sections; empty if they are unknown: then a column ``value`` holds ratings.
    frame : DataFrame
        Tidy answers.
    """
    section = design.get("answers") or {}
    known: list[Question] = []
    if "value" in frame.columns and pd.to_numeric(frame["value"], errors="coerce").notna().any():
        scale = section.get("scale")
        name = "magnitude" if scale and scale["kind"] == "number" else "rating"
        known += Question.of(name, "value", {"scale": scale})
    for name, asked in (section.get("then") or {}).items():
        known += Question.of(name, name, asked)
    return tuple(each for each in known if each.column in frame.columns)


def ratings(responses: Responses, task: TrialTask, asked: Sequence[Question]) -> Iterator[IndividualValue]:
    """Yield mean ratings by level, exponents of magnitudes, and differences of ratings between right and wrong answers.

    Parameters
    ----------
    responses : Responses
        The answers.
    task : TrialTask
        What the answers mean.
    asked : sequence of Question
        What was rated.
    """
    frame, scale = responses.frame, scale_of(responses.frame.columns)
    is_correct = correct(frame, task, scale)
    for question in asked:
        rated = frame.assign(rated=question.numbers(frame))
        rated = rated[rated["rated"].notna()]
        for cell, part in cells(rated, scale, by_level=True):
            values = part["rated"].to_numpy(dtype=float)
            mean = math.exp(np.log(values).mean()) if question.is_magnitude else float(values.mean())
            yield IndividualValue(question.measure, *cell, Interval.point(mean, len(values)), len(values))
        for cell, part in cells(rated, scale, by_level=False):
            if question.is_magnitude and part[scale.column].nunique() > 1:
                exponent = Measure(f"exponent of {question.name}", "exponent of the power law", "rating", 0.0)
                yield IndividualValue(exponent, *cell, power_law(part[scale.column], part["rated"]), len(part))
            right = is_correct[part.index]
            if (right == 1).any() and (right == 0).any():
                gap = part["rated"][right == 1].mean() - part["rated"][right == 0].mean()
                words = f"{question.name} when correct less when not"
                yield IndividualValue(
                    Measure(words, words, "rating", 0.0), *cell, Interval.point(float(gap), len(part)), len(part)
                )


def correct(frame: pd.DataFrame, task: TrialTask, scale: LevelScale) -> pd.Series:
    """Return which answers are correct, 1 or 0; NaN if the design does not determine it.

    Parameters
    ----------
    frame : DataFrame
        Tidy answers, by what they name.
    task : TrialTask
        What the answers mean.
    scale : LevelScale
        Scale of the levels.
    """
    level = frame[scale.column]
    if task.different:
        right = frame["response"].isin(task.different) != task.is_same(frame, scale.column)
    elif task.named:
        right = frame["response"].map(task.named).astype(float) == frame["interval"].astype(float)
        right = (right != level.map(task.turns)).where(~task.is_same(frame, scale.column) & level.map(task.tells))
    else:
        return pd.Series(math.nan, frame.index)
    return right.astype(float).reindex(task.told(frame, scale.column).index).reindex(frame.index)


def power_law(levels: ArrayLike, magnitudes: ArrayLike) -> Interval:
    """Return the exponent of magnitude over level, by least squares of their logarithms, with its t interval.

    Parameters
    ----------
    levels, magnitudes : (n,) arrays
        Level and magnitude of each answer, above zero.

    References
    ----------
    Stevens, "Psychophysics" (1975), chapter 1.
    """
    x, y = np.log(np.asarray(levels, dtype=float)), np.log(np.asarray(magnitudes, dtype=float))
    spread = ((x - x.mean()) ** 2).sum()
    slope = float(((x - x.mean()) * (y - y.mean())).sum() / spread)
    if len(x) < 3:
        return Interval.point(slope, len(x))
    residual = y - y.mean() - slope * (x - x.mean())
    half = student_quantile(len(x) - 2) * math.sqrt(float((residual**2).sum()) / (len(x) - 2) / spread)
    return Interval(slope, slope - half, slope + half, len(x))


def level_findings(values: Sequence[IndividualValue], groups: Mapping[str, str]) -> Iterator[Finding]:
    """Yield Friedman's test of each rating over levels, with Kendall's coefficient; for two levels, signed ranks.

    Groups that met different levels have tests of their own.

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
            yield from _over_levels(measure, where, levels, people)


def _over_levels(
    measure: Measure, scope: str, levels: Sequence[float], people: Sequence[Mapping[float, float]]
) -> Iterator[Finding]:
    """Yield the test of a rating over levels, of participants by their ratings at the levels; none at one level."""
    rows = np.array([[own[level] for level in levels] for own in people if len(own) == len(levels)])
    if len(levels) < 2 or len(rows) < 2:
        return
    if len(levels) == 2:
        test, interval = by_ranks(rows[:, 1] - rows[:, 0])
        way, interval = "signed ranks", as_told(measure, interval)
        quantity = f"{'ratio' if measure.is_ratio else 'difference'} of {measure.quantity}, higher to lower level"
    else:
        test, concordance = friedman(rows)
        way, interval = "Friedman's test by shuffles within participants", Interval.point(concordance, len(rows))
        quantity = "Kendall's W"
    left_out = len(people) - len(rows)
    yield finding_of(
        "rating", f"{measure.name} over levels, {way}", scope, test, quantity, interval, len(rows),
        family="rating over levels",
        notes=[f"{left_out} participants without a rating at every level left out" if left_out else ""],
    )  # fmt: skip


def friedman(rows: np.ndarray) -> tuple[ExactTest, Any]:
    """Return Friedman's test, with p from shuffles within participants, and Kendall's W.

    Parameters
    ----------
    rows : (..., n_participants, n_levels) array
        Mean ratings.
    """
    shape, (n, k) = rows.shape[:-2], rows.shape[-2:]
    ranks = pd.DataFrame(rows.reshape(-1, k)).round(9).rank(axis=1).to_numpy().reshape(-1, n, k)
    ties = ((ranks[..., np.newaxis] == ranks[..., np.newaxis, :]).sum(axis=-1) ** 2 - 1).sum(axis=(1, 2))
    most = n**2 * (k**3 - k) / 12 - n * ties / 12
    # Sums of halves are exact in single precision.
    test = shuffle_conditions((ranks - (k + 1) / 2).astype(np.float32)[..., np.newaxis])
    concordance = np.divide(test.statistic, most, out=np.full(most.shape, math.nan), where=most > 0)
    statistic = np.where(most > 0, n * (k - 1) * concordance, 0.0)
    found: list[Any] = [
        each.reshape(shape)[()] for each in (statistic, test.p, test.p_min, test.n_informative, concordance)
    ]
    return ExactTest(*found[:4]), found[4]
