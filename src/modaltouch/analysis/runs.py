"""Analysis of adaptive sessions: runs with their psychometric functions, and thresholds over participants."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.columns import label_zones, scale_of, zones_of
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.findings import Finding, grouped, plain_row, to_frame
from modaltouch.analysis.intervals import Interval, student_interval
from modaltouch.analysis.measures import IndividualValue, Measure, contrast_findings, group_findings
from modaltouch.analysis.preregistration import RegisteredAnalysis, term_in_words
from modaltouch.analysis.psychometric import Psychometric, fit_psychometric
from modaltouch.analysis.responses import Responses
from modaltouch.report import format_number

KEYS = ("participant", "session", "finger_condition")
THRESHOLD = Measure("threshold", "threshold", "threshold", is_ratio=True)


@dataclass(frozen=True, eq=False)
class Run:
    """One adaptive run of one participant.

    Attributes
    ----------
    participant : str
        Participant id.
    session : int
        Number of the session.
    finger_condition : str
        ``one_hand``, ``two_hands`` or another name from the protocol.
    pair : str
        Zones under the fingers, such as ``A-C``.
    stimulus : str
        Name of the stimulus; empty if the protocol has only one.
    levels : (n_trials,) array
        Level of each trial, in order [mm/s].
    successes : (n_trials,) array of bool
        Whether each answer was a success.
    fitted : Psychometric
        Function fitted to the answers.
    n_missing : int
        Number of trials that timed out, which are failures for the adaptive rule but excluded from the fit.
    group : str
        Group or lab of the participant; empty if there is only one.
    session_kind : str
        Kind of session; empty if only one kind is analysed.
    """

    participant: str
    session: int
    finger_condition: str
    pair: str
    stimulus: str
    levels: NDArray[np.float64]
    successes: NDArray[np.bool_]
    fitted: Psychometric
    n_missing: int = 0
    group: str = ""
    session_kind: str = ""

    @property
    def kind(self) -> str:
        """Factors in words, common to runs of different participants."""
        factors = self.factors | {"finger_condition": self.finger_condition.replace("_", " ")}
        return " ".join(factors.values())

    @property
    def factors(self) -> dict[str, str]:
        """Values of the varying factors (group, kind of session, finger condition, pair, stimulus) by name."""
        names = ("group", "session_kind", "finger_condition", "pair", "stimulus")
        return {name: getattr(self, name) for name in names if getattr(self, name)}

    @property
    def n_reversals(self) -> int:
        """Number of reversals of the track."""
        turns = np.sign(np.diff(self.levels))
        moving = turns[turns != 0]
        return int((moving[1:] != moving[:-1]).sum())

    def as_dict(self) -> dict[str, Any]:
        """Return the run as plain values; undetermined values are null."""
        fitted = self.fitted
        threshold, spread = (each or Interval.point(math.nan, 0) for each in (fitted.threshold, fitted.spread))
        is_determined = fitted.threshold is not None
        return {
            "participant": self.participant,
            "session": self.session,
            **self.factors,
            "n_trials": fitted.n_trials,
            "n_missing": self.n_missing,
            "n_successes": fitted.n_successes,
            "n_catch_trials": fitted.n_catch,
            "n_catch_successes": fitted.n_false,
            "n_reversals": self.n_reversals,
            "threshold_mm_s": _velocity(threshold.estimate),
            "threshold_low_mm_s": _velocity(threshold.low),
            "threshold_high_mm_s": _velocity(threshold.high),
            "spread_dB": _known(spread.estimate),
            "spread_low_dB": _known(spread.low),
            "spread_high_dB": _known(spread.high),
            "slope_per_dB": fitted.slope,
            "guess_rate": fitted.guess_rate if is_determined else None,
            "lapse_rate": fitted.lapse_rate if is_determined else None,
            "is_uncertain": fitted.is_uncertain,
            "why_not": fitted.why_not or None,
        }


def find_runs(responses: Responses) -> tuple[Run, ...]:
    """Find and fit all runs of adaptive sessions.

    Parameters
    ----------
    responses : Responses
        Answers of adaptive sessions; catch trials are rows at 0 mm/s, and trials that timed out have no response.
    """
    rule = responses.start["design"]["adaptive"]
    frame = responses.frame.sort_values(["participant", "session", "trial"], kind="stable")
    runs = []
    for key, part in frame.groupby([*KEYS, *zones_of(frame.columns)], sort=True, observed=True):
        silent = part[scale_of(part.columns).column] == 0
        for stimulus in sorted(part["stimulus"][~silent].unique()):
            # Catch trials have no stimulus, so they count for the runs of all stimuli, scored with the focus of each.
            runs.append(_run(key, stimulus, part[silent | (part["stimulus"] == stimulus)], rule, responses))
    return tuple(runs)


def is_forced(responses: Responses) -> bool:
    """Return whether the guess rate is the chance level of a forced choice, rather than estimated from catch trials."""
    silent = responses.frame.dropna(subset="response")[scale_of(responses.frame.columns).column] == 0
    # Allow for a rounded guess rate such as 0.33, as in the check of the protocol.
    chance = 1 / len(responses.answers) - 0.01
    return bool(responses.start["design"]["adaptive"]["guess_rate"] >= chance and not silent.any())


def _run(key: tuple[Any, ...], stimulus: str, part: pd.DataFrame, rule: dict[str, Any], responses: Responses) -> Run:
    participant, session, finger_condition, left, *_ = key
    focus = responses.foci.get(stimulus, responses.focus)
    names, session_kind = (str(finger_condition), label_zones(part).iloc[0], stimulus), part["session_kind"].iloc[0]
    part = part[part["response"].notna()]
    succeeds = responses.answers.is_success
    success = np.array([succeeds(str(answer), rule["success"], focus, left) for answer in part["response"]])
    success = (part["correct"] == 1).to_numpy() if rule["success"] == "correct" else success
    level = part[scale_of(part.columns).column].to_numpy(dtype=float)
    driven = level > 0
    catches, n_missing = success[~driven].tolist(), rule["trials"] - int(driven.sum())
    fitted = Psychometric(0, 0, len(catches), sum(catches), None, None, 0.0, 0.0, "no trial was answered in time")
    if driven.any():
        fitted = fit_psychometric(
            [20 * math.log10(each) for each in level[driven]],
            success[driven].tolist(),
            guess_rate=rule["guess_rate"],
            most_lapse=rule["lapse_rate"],
            catches=catches,
            flat_rate=rule["guess_rate"] if is_forced(responses) else None,
        )
    group = responses.groups.get(str(participant), "")
    kind = str(session_kind) if responses.frame["session_kind"].nunique() > 1 else ""
    return Run(str(participant), int(session), *names, level[driven], success[driven], fitted, n_missing, group, kind)


def over_participants(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Compute the geometric mean threshold over participants for each kind of run.

    Thresholds are first averaged over a participant's sessions of a kind. Runs without a threshold are excluded and
    counted; the mean is over participants with at least one threshold.
    """
    rows = []
    for own in grouped((run.kind, run) for run in runs).values():
        found = grouped((run.participant, each.estimate) for run in own if (each := run.fitted.threshold))
        means = np.array([np.mean(values) for values in found.values()])
        interval = student_interval(means)
        rows.append(
            {
                **own[0].factors,
                "n_runs": len(own),
                "n_without_threshold": sum(run.fitted.threshold is None for run in own),
                "n_uncertain": sum(run.fitted.is_uncertain for run in own),
                "n_participants": len(means),
                "threshold_mm_s": _velocity(interval.estimate),
                "threshold_low_mm_s": _velocity(interval.low),
                "threshold_high_mm_s": _velocity(interval.high),
            }
        )
    return rows


def compare_runs(runs: Sequence[Run]) -> list[Finding]:
    """Compare thresholds between kinds of run that differ in one factor, as ratios with tests.

    Log thresholds are compared within participants by sign flips, and between groups by permuting participants, for
    kinds of run common to both groups. They are first averaged over a participant's sessions of a kind; participants
    without a threshold in one of two kinds are excluded from the comparison. The tests are exploratory and not
    corrected.
    """
    thresholds = grouped(
        (
            (run.participant, run.finger_condition, " ".join(filter(None, (run.pair, run.stimulus, run.session_kind)))),
            each.estimate,
        )
        for run in runs
        if (each := run.fitted.threshold)
    )
    own = [
        IndividualValue(THRESHOLD, *key, math.nan, Interval.point(10 ** (float(np.mean(values)) / 20), 1), len(values))
        for key, values in thresholds.items()
    ]
    groups = {run.participant: run.group for run in runs if run.group}
    found = list(contrast_findings(own))
    for names in combinations(dict.fromkeys(groups.values()), 2):
        met = [{each[1:] for each in thresholds if groups.get(each[0]) == name} for name in names]
        shared = [each for each in own if (each.finger_condition, each.pair) in met[0] & met[1]]
        found += group_findings(own, shared, groups, names)
    return [replace(each, family="") for each in found]


def in_words(estimate: Interval, unit: str = "") -> str:
    """Format a threshold with its interval [mm/s], as in ``12.3 (9.1 to 17)``."""
    value, *bounds = (_velocity(each) for each in (estimate.estimate, estimate.low, estimate.high))
    low, high = ("no bound" if bound is None else format_number(bound) for bound in bounds)
    return f"{format_number(value)}{unit} ({low} to {high})"


def _velocity(level: float) -> float | None:
    """Convert a level from dB re 1 mm/s to mm/s; None if not finite."""
    return float(f"{10 ** (level / 20):.5g}") if math.isfinite(level) else None


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


@dataclass(frozen=True, eq=False)
class ThresholdAnalysis(RegisteredAnalysis):
    """Results of adaptive sessions, and the files written.

    Attributes
    ----------
    runs : tuple of Run
        All runs with their fits.
    """

    runs: tuple[Run, ...]

    @property
    def confirmatory(self) -> list[tuple[str, AnswerCounts, Finding]]:
        """Empty, since comparisons of thresholds are exploratory."""
        return []

    def terms(self, tests: Mapping[str, int]) -> dict[str, Any]:
        """Return the terms fixed by a preregistration, by name."""
        adaptive = self.responses.start["design"]["adaptive"]
        return {
            "participants": len({run.participant for run in self.runs}),
            "runs": sorted({run.kind for run in self.runs}),
            "levels [mm/s]": list(self.bounds),
            "method": adaptive["method"],
            "trials a run": adaptive["trials"],
            "answers": list(self.responses.answers.names),
        }

    def design_in_words(self) -> list[tuple[str, str]]:
        """Describe the runs, levels and method in words, by name."""
        terms = self.terms({})
        return [(name, term_in_words(terms[name])) for name in ("runs", "levels [mm/s]", "method", "trials a run")]

    @property
    def thresholds(self) -> list[dict[str, Any]]:
        """Mean thresholds over participants, one row per kind of run."""
        return over_participants(self.runs)

    @cached_property
    def comparisons(self) -> list[Finding]:
        """Comparisons of thresholds between kinds of run."""
        return compare_runs(self.runs)

    @property
    def tests(self) -> list[dict[str, Any]]:
        """The comparisons, one row each."""
        return [
            {str(key): value for key, value in row.items()} for row in to_frame(self.comparisons).to_dict("records")
        ]

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest possible level of a run [mm/s]."""
        levels = self.responses.start["design"]["conditions"]["peak_velocities_mm_s"]
        return min(levels), max(levels)

    def as_dict(self) -> dict[str, Any]:
        """Return all results as plain values for ``--json``; undetermined values are null."""
        return {
            "thresholds": [run.as_dict() for run in self.runs],
            "over_participants": self.thresholds,
            "tests": [plain_row(row) for row in self.tests],
            "files": {name: str(path) for name, path in self.files.items()},
            "n_participants": len({run.participant for run in self.runs}),
            "n_responses": int(self.responses.frame["response"].count()),
            "n_missing": sum(run.n_missing for run in self.runs),
            "missing": [
                {"participant": run.participant, "cell": f"session {run.session}, {run.kind}", "n": run.n_missing}
                for run in self.runs
                if run.n_missing
            ],
            **self.responses.as_dict(),
            **self.registration.as_dict(),
        }


def analyse_runs(responses: Responses) -> ThresholdAnalysis:
    """Analyse adaptive sessions.

    Parameters
    ----------
    responses : Responses
        Answers of adaptive sessions.
    """
    return ThresholdAnalysis(responses, find_runs(responses))
