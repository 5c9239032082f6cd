"""Ratings and further questions: means and shares, rank tests over levels, and the power law of magnitude estimates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from modaltouch.analysis.columns import scale_of
from modaltouch.analysis.findings import Finding, finding_of
from modaltouch.analysis.intervals import Interval, student_quantile
from modaltouch.analysis.measures import IndividualValue, Measure, cells, from_linear, linear
from modaltouch.analysis.permutation import by_ranks, friedman
from modaltouch.analysis.responses import Responses
from modaltouch.protocol import ScaleSection


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
