"""Individual measures, such as d', thresholds or mean ratings, and their tests over participants and groups.

The participant is the unit of inference: tests use one value per participant, not pooled trials.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, cast

import numpy as np
import pandas as pd

from modaltouch.analysis.columns import LevelScale, label_zones
from modaltouch.analysis.findings import ALPHA, Finding, finding_of, grouped
from modaltouch.analysis.intervals import BoundedMean, Interval
from modaltouch.analysis.permutation import (
    NOISE,
    Located,
    by_flips,
    by_ranks,
    flip_test,
    group_test,
)
from modaltouch.analysis.sums import FloatArray
from modaltouch.analysis.words import coverage_note

Cell = tuple[str, str, str, float]
"""Participant, finger condition, pair of zones, level."""


@dataclass(frozen=True)
class Measure:
    """A quantity measured in each participant.

    Attributes
    ----------
    name : str
        Name of the measure.
    quantity : str
        Name with unit, for tables and axes.
    question : str
        Question of the report to which the measure belongs.
    null : float or None
        Value of the mean under the null hypothesis; None if it is not tested.
    is_ratio : bool
        Whether values are compared as ratios, with geometric means.
    is_ranked : bool
        Whether values are compared by rank, as for ratings.
    ends : (float, float) or None
        Lowest and highest possible value, for the interval of a `BoundedMean`; None if unbounded.
    """

    name: str
    quantity: str
    question: str
    null: float | None = None
    is_ratio: bool = False
    is_ranked: bool = False
    ends: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class IndividualValue:
    """Value of a measure for one participant and cell.

    Attributes
    ----------
    measure : Measure
        The measure.
    participant, finger_condition, pair : str
        Participant and cell.
    level : float
        Level of the cell; NaN for all levels together.
    interval : Interval
        The value with its 95 % interval, if available.
    n : int
        Number of answers.
    note : str
        Reason for a missing value, or remarks for the reader.
    tested : float or None
        Score to test instead of the value, if the expectation of the value without an effect is not the null value.
    """

    measure: Measure
    participant: str
    finger_condition: str
    pair: str
    level: float
    interval: Interval
    n: int
    note: str = ""
    tested: float | None = None

    def as_dict(self, scale: LevelScale, groups: Mapping[str, str]) -> dict[str, Any]:
        """Return the row of ``measures.csv``."""
        group = {"group": groups.get(self.participant, "")} if groups else {}
        return {
            "measure": self.measure.name,
            "quantity": self.measure.quantity,
            "participant": self.participant,
            **group,
            "finger_condition": self.finger_condition,
            "pair": self.pair,
            scale.column: "all" if math.isnan(self.level) else self.level,
            "estimate": self.interval.estimate,
            "low": self.interval.low,
            "high": self.interval.high,
            "n": self.n,
            "note": self.note,
        }


_FLIPS, _RANKS = "sign flips", "signed ranks"


def over_participants(measure: Measure, own: Sequence[IndividualValue]) -> Located:
    """Test the null hypothesis of a measure, and return its mean over the participants with a value.

    Parameters
    ----------
    measure : Measure
        The measure.
    own : sequence of IndividualValue
        Values of the participants.
    """
    null = 0.0 if measure.null is None else math.log(measure.null) if measure.is_ratio else measure.null
    values = np.array(list(_known(own).values()))
    test, interval = by_flips(values - null)
    if not values.size:
        return test, Interval.point(math.nan, 0)
    interval = interval.changed(lambda shifted: shifted + null)
    if measure.ends:
        interval = BoundedMean(values, *measure.ends).interval()
    # If all individual intervals are unbounded on one side, so is that of the mean, and also on the other side if any
    # of them is unbounded there.
    open_low, open_high = (
        [end == side * math.inf for end in ends]
        for side, ends in ((-1, [each.interval.low for each in own]), (1, [each.interval.high for each in own]))
    )
    if all(open_low) or (all(open_high) and any(open_low)):
        interval = replace(interval, low=-math.inf)
    if all(open_high) or (all(open_low) and any(open_high)):
        interval = replace(interval, high=math.inf)
    if np.ptp(values) < 1e-9 and not measure.ends:
        # Equal values, as at the ceiling: what is known of their mean is what is known of each.
        ends = np.array([(each.interval.low, each.interval.high) for each in own if math.isfinite(linear(each))])
        with np.errstate(divide="ignore"):
            ends = np.log(ends) if measure.is_ratio else ends
        lows, highs = np.where(np.isnan(ends), (-math.inf, math.inf), ends).T
        interval = replace(interval, low=min(interval.low, *lows), high=max(interval.high, *highs))
    in_place = np.array([each.tested for each in own if each.tested is not None], dtype=float)
    if in_place.size:
        test = flip_test(in_place[np.isfinite(in_place)])
        if test.p > ALPHA:  # the interval contains the null value unless rejected
            interval = replace(interval, low=min(interval.low, null), high=max(interval.high, null))
    return test, from_linear(measure, interval)


def mean_findings(values: Sequence[IndividualValue], scale: LevelScale, groups: Mapping[str, str]) -> Iterator[Finding]:
    """Yield the mean of each measure over participants, with a test if the measure has a null value."""
    names = dict.fromkeys(groups.values())
    in_order = (each for own in by_measure(values).values() for each in own)
    by_scope = grouped(((each.measure, _scope_of(each, scale)), each) for each in in_order)
    for (measure, scope), own in by_scope.items():
        test, interval = over_participants(measure, own)
        n = int(interval.n_effective)
        left_out = len({each.participant for each in own}) - n
        n_open = sum(math.isinf(each.interval.low) or math.isinf(each.interval.high) for each in own)
        tested = measure.null is not None and n > 0
        way = _FLIPS if own[0].tested is None else f"{_FLIPS}, p by those of the rates"
        met = {groups.get(each.participant) for each in own}
        notes = [
            f"met by {', '.join(name for name in names if name in met)} only" if len(met) < len(names) else "",
            "geometric mean" if measure.is_ratio else "",
            *({each.note for each in own} if len({each.note for each in own}) == 1 else ()),
            f"participants without a value, left out: {left_out}" if left_out else "",
            f"participants whose own interval is open on one side: {n_open}" if n_open else "",
            "" if tested else "described, not tested",
            "every participant has the same value" if len({each.interval.estimate for each in own}) == 1 < n else "",
            "the rates reject zero, which the interval holds"
            if own[0].tested is not None and test.p <= ALPHA and interval.low <= 0 <= interval.high
            else "",
        ]
        row = finding_of(
            measure.question, f"{measure.name} over participants, {'bounded mean' if measure.ends else way}", scope,
            test if tested else None, measure.quantity, interval, n, family=measure.name if tested else "",
            notes=notes,
        )  # fmt: skip
        yield replace(row, note="; ".join(filter(None, (row.note, coverage_note(row)))))


Places = Collection[tuple[str, str]]
"""Finger conditions and pairs of zones."""


def contrast_findings(values: Sequence[IndividualValue], tested: Sequence[Places] | None = None) -> Iterator[Finding]:
    """Compare each measure between two finger conditions, pairs of zones, stimuli or kinds of session.

    A participant's difference is the mean over the levels with values in both.

    Parameters
    ----------
    values : sequence of IndividualValue
        Values of the participants.
    tested : sequence of Places, optional
        Places whose shares have tests of counts, and are not compared here; by default all.
    """
    for measure, own in by_measure(values).items():
        tables: dict[tuple[str, str], dict[tuple[str, str], float]] = {}
        for each in own:
            tables.setdefault((each.finger_condition, each.pair), {})[each.participant, str(each.level)] = linear(each)
        places = {place: [each for each in own if (each.finger_condition, each.pair) == place] for place in tables}
        for (a, first), (b, second) in combinations(tables.items(), 2):
            differ = [x != y for x, y in zip(_factors(*a), _factors(*b), strict=True)]
            own_places = {(condition, label.split(" ")[0]) for condition, label in (a, b)}
            is_tested = tested is None or any(own_places <= {*each} for each in tested)
            if sum(differ) != 1 or (measure.question == "shares" and any(differ[:2]) and is_tested):
                continue
            if first.keys().isdisjoint(second):
                continue  # different participants, e.g. in groups
            both = sorted(first.keys() & second.keys())  # fixed order, for reproducible sums
            paired = grouped(
                (key[0], (first[key], second[key])) for key in both if math.isfinite(first[key] - second[key])
            )
            scope = f"{a[0]} - {b[0]} {a[1]}".strip() if a[1] == b[1] else f"{a[0]} {a[1]} - {b[1]}"
            name = f"{measure.name} compared, {_RANKS if measure.is_ranked else _FLIPS}"
            gaps = np.array([np.mean([x - y for x, y in each]) for each in paired.values()])
            gaps[np.abs(gaps) < NOISE] = 0.0
            apart = ["over the levels that both have"] * ({key[1] for key in first} != {key[1] for key in second})
            yield from _compared(measure, name, scope, gaps, [*_remarks(measure, places[a], places[b]), *apart])


_ALIKE = 1.25
"""Ratio of numbers of trials up to which the biases of two estimates are called equal."""


def _remarks(measure: Measure, *compared: Sequence[IndividualValue]) -> list[str]:
    """Return the models of compared estimates, and a note if unequal numbers of trials bias them unequally."""
    models = {each.note: None for own in compared for each in own if measure.question == "sensitivity"}
    n = [np.mean([max(each.n, each.interval.n_effective) for each in own]) for own in compared]
    if measure.question not in ("sensitivity", "function") or max(n) <= _ALIKE * min(n):
        return [*models]
    return [
        *models,
        f"from {' against '.join(f'{each:.3g}' for each in n)} trials each, which bias the estimates unequally",
    ]


def _compared(
    measure: Measure, name: str, scope: str, numbers: FloatArray, remarks: Sequence[str]
) -> Iterator[Finding]:
    """Test the participants' differences between two conditions; without any difference, there is no test.

    The mean difference of shares has a test of its own, since it may lie far from that of a sample in which hardly
    anybody differs, which the interval of sign flips ignores.
    """
    quantity, family = f"{_difference(measure)} of {measure.quantity}", f"{measure.question} compared"
    if not numbers.size:
        notes = ["described, not tested: no participant has a value in both"]
        yield finding_of(measure.question, name, scope, None, quantity, Interval.point(math.nan, 0), 0, notes=notes)
        return
    test, interval = (by_ranks if measure.is_ranked else by_flips)(numbers)
    ends = measure.is_ranked and 0 in (interval.low, interval.high) and test.p <= ALPHA
    notes = ["the interval ends at 0, which the test rejects: zeros count only in the interval"] if ends else []
    if is_share := measure.question == "shares":
        mean = BoundedMean(numbers)
        interval = Interval.point(mean.estimate, numbers.size)
    elif not numbers.any():
        interval = replace(interval, low=-math.inf, high=math.inf)
        notes = ["without a difference, there is no interval"]
    yield finding_of(
        measure.question, name, scope, test, quantity, from_linear(measure, interval), numbers.size, family=family,
        notes=[*notes, *remarks],
    )  # fmt: skip
    if is_share:
        name = f"{measure.name} compared, mean over participants, test and interval of a bounded mean"
        yield finding_of(
            measure.question, name, scope, mean.test(), quantity, mean.interval(), numbers.size,
            family=f"{family} on average",
        )  # fmt: skip


def _factors(finger_condition: str, place: str) -> tuple[str, ...]:
    """Return the factors to compare one at a time: finger condition, zones, and others from `label_places`."""
    return finger_condition, *place.split(" ")


def group_findings(
    values: Sequence[IndividualValue],
    shared: Sequence[IndividualValue],
    groups: Mapping[str, str],
    names: tuple[str, str],
) -> Iterator[Finding]:
    """Compare each measure between two groups, with one mean value per participant.

    Parameters
    ----------
    values, shared : sequence of IndividualValue
        All values, and those from cells common to both groups; only the latter are compared.
    groups : mapping of str to str
        Group of each participant.
    names : (str, str)
        The two groups.
    """
    compared, (a, b) = by_measure(shared), names
    for measure in by_measure(each for each in values if groups.get(each.participant) in names):
        numbers = _known(compared.get(measure, ()))
        first, second = (np.array([n for who, n in numbers.items() if groups.get(who) == name]) for name in names)
        scope, quantity = f"{a} - {b}", f"{_difference(measure)} of {measure.quantity}"
        if not (first.size and second.size):
            why = "described, not tested: no values from both groups in cells that both met"
            name = f"{measure.name} between groups"
            yield finding_of("group", name, scope, None, quantity, Interval.point(math.nan, 0), 0, notes=[why])
            continue
        test, interval = group_test(first, second)
        if not np.ptp([*first, *second]):
            interval = replace(interval, low=-math.inf, high=math.inf)
        n_values = Counter(each.participant for each in compared[measure] if math.isfinite(linear(each)))
        n_part = sum(n < max(n_values.values()) for n in n_values.values())
        yield finding_of(
            "group", f"{measure.name} between groups, permutation test of participants", scope, test, quantity,
            from_linear(measure, interval), first.size + second.size, family="groups",
            notes=[
                f"{a}: {first.size}, {b}: {second.size} participants; interval of a shift",
                "over the cells that both groups met" if shared is not values else "",
                f"participants without a value in some cell, averaged over the others: {n_part}" if n_part else "",
                *_remarks(measure, *([each for each in compared[measure] if groups.get(each.participant) == name]
                                    for name in names)),
            ],
        )  # fmt: skip


def label_places(frame: pd.DataFrame) -> pd.Series:
    """Label each row by pair and, if they vary, by stimulus, kind of session and focus, as an ordered categorical."""
    zones = label = label_zones(frame)
    named = [name for name in ("stimulus", "session_kind") if name in frame.columns and frame[name].nunique() > 1]
    for name in named:
        label = label + " " + frame[name].astype(str)
    has_foci = {"focus", "stimulus"} <= set(frame.columns)
    if has_foci and frame.groupby("stimulus", observed=True)["focus"].nunique().max() > 1:
        label, named = label + " focus " + frame["focus"], [*named, "focus"]
    order = frame[named].assign(zones=zones, label=label).drop_duplicates("label").sort_values(["zones", *named])
    return label.astype(pd.CategoricalDtype(order["label"]))


def kind_of(part: pd.DataFrame) -> str:
    """Return the kind of session of a cell's answers; empty if there are no kinds."""
    return str(part["session_kind"].iloc[0]) if "session_kind" in part.columns else ""


def cells(frame: pd.DataFrame, scale: LevelScale, *, by_level: bool) -> Iterator[tuple[Cell, pd.DataFrame]]:
    """Yield each cell (participant, finger condition, pair of zones and level) with its answers.

    Parameters
    ----------
    frame : DataFrame
        Tidy answers.
    scale : LevelScale
        Scale of the levels.
    by_level : bool
        Whether to separate levels; if not, all levels are pooled, and the level is NaN.
    """
    keys = [frame["participant"].astype(str), frame["finger_condition"].astype(str), label_places(frame)]
    levels = [frame[scale.column]] if by_level else []
    for key, part in frame.groupby([*keys, *levels], sort=True, observed=True):
        who, finger_condition, label, *level = cast(tuple[Any, ...], key)
        yield (str(who), str(finger_condition), str(label), float(level[0]) if level else math.nan), part


def by_measure(values: Iterable[IndividualValue]) -> dict[Measure, list[IndividualValue]]:
    """Group values by measure."""
    return grouped((each.measure, each) for each in values)


def _scope_of(each: IndividualValue, scale: LevelScale) -> str:
    level = "" if math.isnan(each.level) else f" {scale.say(each.level)}"
    return f"{each.finger_condition} {each.pair}".strip() + level


def _known(own: Iterable[IndividualValue]) -> dict[str, float]:
    """Return the mean of each participant's values on the scale of `linear`, excluding participants without values."""
    known = grouped((each.participant, value) for each in own if math.isfinite(value := linear(each)))
    return {who: float(np.mean(values)) for who, values in known.items()}


def of_participants(own: Sequence[IndividualValue]) -> list[IndividualValue]:
    """Average the values of a measure within each participant, excluding participants without values."""
    whole = [(who, from_linear(own[0].measure, Interval.point(mean, 1))) for who, mean in _known(own).items()]
    return [IndividualValue(own[0].measure, who, "", "", math.nan, interval, 1) for who, interval in whole]


def linear(own: IndividualValue) -> float:
    """Return a value on the scale of comparison: its logarithm for ratios."""
    value = float(own.interval.estimate)
    if own.measure.is_ratio:
        return math.log(value) if value > 0 else math.nan
    return value


def from_linear(measure: Measure, interval: Interval) -> Interval:
    """Convert an interval from the scale of comparison back to that of the measure."""
    return interval.changed(np.exp) if measure.is_ratio else interval


def _difference(measure: Measure) -> str:
    return "ratio" if measure.is_ratio else "difference"
