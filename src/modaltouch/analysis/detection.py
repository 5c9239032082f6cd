"""Signal detection theory: d', criterion, false alarms and misses of each participant.

Estimates of d' use rates with the log-linear correction, (k + 0.5) / (n + 1), to be finite. Intervals use uncorrected
counts and exact limits of the rates, so their coverage is at least 95 %; a bound not determined by the answers is
infinite. A false alarm is a catch trial (without a stimulus) in which something was felt; a miss is a trial with a
stimulus in which nothing was felt.

References
----------
Macmillan and Creelman, "Detection Theory: A User's Guide", 2nd ed. (2005), chapters 1, 7 and 9.
Hautus, Behavior Research Methods 27 (1995) 46-51 (log-linear correction).
Hacker and Ratcliff, Perception & Psychophysics 26 (1979) 168-170 (m alternatives).
Frijters, British Journal of Mathematical and Statistical Psychology 32 (1979) 229-241 (the odd one of three).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import ncfdtr, ndtr, ndtri

from modaltouch.analysis.columns import scale_of, zones_of
from modaltouch.analysis.findings import Finding, finding_of
from modaltouch.analysis.intervals import DROP, BoundedMean, Interval, clopper_pearson
from modaltouch.analysis.measures import Cell, IndividualValue, Measure, cells, kind_of
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.sums import FloatArray
from modaltouch.analysis.task import TrialTask

Statistic = Callable[[FloatArray, FloatArray], FloatArray]
Count = tuple[int, int]
"""Count of an answer, and number of trials."""

_HALVINGS = 50
# Largest finite d'.
_FARTHEST = 40.0


@dataclass(frozen=True, eq=False)
class SignalDetection:
    """Sensitivity and criterion of one participant.

    Attributes
    ----------
    d_prime : Interval
        Sensitivity d', in standard deviations of the percept of one presentation.
    contrast : float
        Difference of the two rates, or of one rate and chance [1]. Unlike d', whose rates are biased by the correction
        if the numbers of trials differ, its expectation is zero without discrimination. NaN without trials of both
        kinds.
    criterion : Interval or None
        Criterion; 0 without response bias, and higher with fewer answers of the first kind. None if all answers are
        pooled.
    model : str
        Decision model.
    """

    d_prime: Interval
    contrast: float
    criterion: Interval | None = None
    model: str = "yes-no"


def yes_no(signal: Count, noise: Count) -> SignalDetection:
    """Return d' = z(H) - z(F) and c = -(z(H) + z(F)) / 2 from the rates of hits H and false alarms F.

    Parameters
    ----------
    signal, noise : (int, int)
        Answers "yes" in trials with and without the signal.

    Examples
    --------
    >>> found = yes_no((40, 40), (0, 38))
    >>> round(found.d_prime.estimate, 3), found.d_prime.high
    (4.483, inf)
    """
    return SignalDetection(
        _joint(lambda hit, alarm: ndtri(hit) - ndtri(alarm), signal, noise),
        _rate(signal) - _rate(noise),
        _joint(lambda hit, alarm: -(ndtri(hit) + ndtri(alarm)) / 2, signal, noise),
    )


def two_intervals(first: Count, second: Count) -> SignalDetection:
    """Return d' = (z(H) - z(F)) / sqrt(2) and c for two alternatives in time or space.

    Parameters
    ----------
    first, second : (int, int)
        Answers "first" in trials with the signal in the first and in the second interval.
    """
    found = yes_no(first, second)
    return replace(found, d_prime=found.d_prime.changed(lambda d_prime: d_prime / math.sqrt(2)), model="2AFC")


def m_intervals(correct: Count, m: int) -> SignalDetection:
    """Return d' of an unbiased observer of m alternatives, with the interval from that of the proportion correct.

    Parameters
    ----------
    correct : (int, int)
        Correct answers.
    m : int
        Number of alternatives, at least two.
    """
    found = _of_share(correct, lambda d: share_correct(d, m), -_FARTHEST)
    return SignalDetection(found, _rate(correct) - 1 / m, model=f"{m}AFC")


def odd_of_three(correct: Count) -> SignalDetection:
    """Return d' of the triangular method, in which the percept farthest from the other two is judged as odd.

    With percepts x, y of the equal stimuli and z of the odd one, u = (x - y) / sqrt(2) and v = (z - (x + y) / 2)
    sqrt(2 / 3) have unit variance. The answer is correct if v^2 / u^2 > 3; this ratio has a noncentral F distribution
    with 1 and 1 degrees of freedom and noncentrality 2 d'^2 / 3. d' is at least 0.

    Parameters
    ----------
    correct : (int, int)
        Correct answers.
    """
    found = _of_share(correct, lambda d: 1 - ncfdtr(1, 1, 2 * d**2 / 3, 3), 0.0)
    return SignalDetection(found, _rate(correct) - 1 / 3, model="triangular (odd one of three)")


def _of_share(correct: Count, rising: Callable[[FloatArray], FloatArray], lowest: float) -> Interval:
    """Return the d', at least `lowest`, for a proportion of correct answers, with exact bounds."""
    share = clopper_pearson(*correct)
    rates = np.array([_corrected(*correct), share.low, share.high])
    ends = np.full(rates.shape, lowest), np.full(rates.shape, _FARTHEST)
    estimate, low, high = _inverted(rising, rates, *ends).tolist()
    return Interval(estimate, low, high, correct[1])


def share_correct(d_prime: ArrayLike, m: int) -> FloatArray:
    """Return the proportion of correct answers of an unbiased observer of m alternatives [1].

    Parameters
    ----------
    d_prime : float or array
        Sensitivity d'.
    m : int
        Number of alternatives.
    """
    if m == 2:
        return np.asarray(ndtr(np.asarray(d_prime) / np.sqrt(2)))
    nodes, weights = _nodes()
    felt = np.asarray(d_prime, dtype=float)[..., np.newaxis] + nodes
    return np.asarray((weights * ndtr(felt) ** (m - 1)).sum(axis=-1) / np.sqrt(2 * np.pi))


@lru_cache(maxsize=1)
def _nodes() -> tuple[FloatArray, FloatArray]:
    """Return the 80 nodes and weights of Gauss-Hermite quadrature, accurate to 1e-9."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    return nodes, weights


def same_different(differing: Count, alike: Count) -> SignalDetection:
    """Return d' and criterion k of the differencing model: "different" if two percepts differ by more than k.

    If equal stimuli are called different more often than different stimuli, d' is negative, so that it is unbiased
    without discrimination.

    Parameters
    ----------
    differing, alike : (int, int)
        Answers "different" in trials with different and with equal stimuli.
    """
    return SignalDetection(
        _joint(_signed, differing, alike),
        _rate(differing) - _rate(alike),
        _joint(lambda hit, alarm: _criterion(alarm), differing, alike),
        "differencing (same or different)",
    )


def _criterion(alarm: FloatArray) -> FloatArray:
    return np.asarray(-np.sqrt(2) * ndtri(alarm / 2))


def _signed(hit: FloatArray, alarm: FloatArray) -> FloatArray:
    low, high = np.minimum(hit, alarm), np.maximum(hit, alarm)
    return np.where(hit < alarm, -1.0, 1.0) * _differencing(high, low)


def _differencing(hit: FloatArray, alarm: FloatArray) -> FloatArray:
    """Return the d' for a rate `hit` of answers "different" to different stimuli; 0 if not above `alarm`."""
    hit, k = np.broadcast_arrays(hit, _criterion(alarm))
    known = np.where(np.isfinite(k), k, 0.0)
    root, far = np.sqrt(2), np.full(hit.shape, _FARTHEST)
    d = _inverted(lambda d: ndtr((d - known) / root) + ndtr((-d - known) / root), hit, np.zeros(hit.shape), far)
    return np.where(np.isfinite(k), d, np.where(hit > 0, np.inf, 0.0))


def _inverted(
    rising: Callable[[FloatArray], FloatArray], wanted: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Invert an increasing function by bisection; infinite at a bound of `_FARTHEST`."""
    bottom, top = low, high
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        is_low = rising(middle) < wanted
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    # Round the bisection error at zero.
    found = np.where((wanted >= 1) | (high == top), np.inf, np.where(np.abs(low) < 1e-6, 0.0, low))
    return np.where((low == bottom) & (bottom < 0), -np.inf, found)


def _rate(count: Count) -> float:
    return count[0] / count[1] if count[1] else math.nan


def _corrected(given: int, n: int) -> float:
    return (given + 0.5) / (n + 1)


def _joint(statistic: Statistic, first: Count, second: Count) -> Interval:
    """Return a statistic that is monotonic in each of two rates, with its bounds.

    At a bound, both rates are at exact limits whose squared normal quantiles add up to that of 97.5 %.
    """
    estimate = statistic(*(np.asarray(_corrected(*count)) for count in (first, second)))
    one, other = _limits(*first), _limits(*second)[:, ::-1]
    with np.errstate(invalid="ignore"):
        values = statistic(one[:, np.newaxis], other[np.newaxis])
    # Round numerical noise to positive zero.
    best, low, high = (round(float(each), 12) + 0.0 for each in (estimate, np.nanmin(values), np.nanmax(values)))
    return Interval(best, low, high, first[1] + second[1])


# Confidence levels of the limits of a rate, from 0 to 95 %, closely spaced at both ends [1].
_PARTS = 2 * ndtr(math.sqrt(2 * DROP) * np.sin(np.linspace(0, np.pi / 2, 61))) - 1


@lru_cache(maxsize=4096)
def _limits(given: int, n: int) -> FloatArray:
    """Return the lower and upper exact limits of a rate at each confidence level of `_PARTS`, (2, 61) array."""
    share = clopper_pearson(given, n, _PARTS)
    return np.stack([share.low, share.high])


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
    frame = task.informative(responses.frame, scale.column)
    per_cell = [int(part["n"].sum()) for _, part in cells(frame, scale, by_level=True)]
    by_level = min(per_cell, default=0) >= FEWEST
    if task.different:
        yield from _of_differences(frame, task)
    elif task.named:
        for cell, part in cells(frame, scale, by_level=by_level or not task.detects):
            # If the standard is an equally strong stimulus with another field, no answer is correct; use the PSE.
            is_right = task.detects or task.has_correct_answer(cell[-1])
            if is_right and not task.is_same(part, scale.column).all():
                why = task.no_d_prime_reason
                yield from (
                    _without_d_prime(cell, why, part)
                    if why
                    else _measured(cell, _of_intervals(part, task, cell[-1]), part)
                )
    elif responses.answers.naming() is not None:
        nothing = [each.name for each in responses.answers if each.means_nothing_felt]
        if responses.answers.compares:  # fingers are compared: pool felt or not over cells
            frame, by_level = frame.assign(finger_condition="all", zone_left="", zone_right=""), False
        for cell, part in cells(frame, scale, by_level=by_level):
            # The criterion may differ with other fingers or before training, so use only false alarms from this cell.
            caught = responses.caught(cell[0], cell[1], kind_of(part))
            if caught:
                yield from _measured(
                    cell,
                    yes_no(
                        _share(part, ~part["response"].isin(nothing)),
                        (caught.total() - sum(caught[word] for word in nothing), caught.total()),
                    ),
                    part,
                )
            elif responses.catches:
                yield from _without_d_prime(cell, "answers without catch trials of their own", part)


def _of_intervals(part: pd.DataFrame, task: TrialTask, level: float) -> SignalDetection:
    place, named = part["interval"].astype(int), part["response"].map(task.named).astype(int)
    if task.wants_standard(level):
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
        yield from _without_d_prime(cell, why, part) if why else _measured(cell, same_different(*called), part)


def _share(part: pd.DataFrame, chosen: pd.Series) -> Count:
    return int(part["n"][chosen].sum()), int(part["n"].sum())


def _without_d_prime(cell: Cell, why: str, part: pd.DataFrame) -> Iterator[IndividualValue]:
    yield IndividualValue(D_PRIME, *cell, Interval.point(math.nan, 0), int(part["n"].sum()), f"no d' from {why}")


def _measured(cell: Cell, found: SignalDetection, part: pd.DataFrame) -> Iterator[IndividualValue]:
    n = int(part["n"].sum())
    yield IndividualValue(D_PRIME, *cell, found.d_prime, n, f"{found.model} model", found.contrast)
    if found.criterion is not None and math.isfinite(found.criterion.estimate):
        measure = DIFFERENCE if found.model.startswith("differencing") else CRITERION
        yield IndividualValue(measure, *cell, found.criterion, n, f"{found.model} model")


# Name of the answer "nothing felt" if the protocol does not offer one.
_ABSENT = "none"


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
        yield _rate_finding("false alarms", alarms, [row.n_catch for row in own], words, total)
    note = f"{total.n_missed} of {total.n_driven} answers"
    yield _rate_finding("misses", [row.n_missed for row in own], [row.n_driven for row in own], note, total)


def _rate_finding(name: str, counts: list[int], totals: list[int], note: str, total: CatchRow) -> Finding:
    quantity = "P(something felt | nothing driven)" if name == "false alarms" else f"P({total.nothing} | stimulus)"
    mean = BoundedMean([k / n if n else math.nan for k, n in zip(counts, totals, strict=True)], 0.0, 1.0)
    method = "interval of a bounded mean over participants"
    return finding_of("catch", f"{name}, {method}", "all", None, quantity, mean.interval(), int(mean.n), notes=[note])
