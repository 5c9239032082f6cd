"""Secondary analyses: side bias, order and fatigue, reaction time, and the effect of the ratio of speeds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from modaltouch.analysis.columns import label_zones
from modaltouch.analysis.contrasts import Shares, mean_of_known
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.exact import sign_flip_test
from modaltouch.analysis.findings import Finding, finding_of
from modaltouch.analysis.intervals import BoundedMean, centre_interval, time_steps

ANTICIPATION = 0.15
"""Shortest plausible reaction time [s]; faster (anticipatory) answers are excluded from reaction times."""


def secondary_findings(answers: AnswerCounts, frame: pd.DataFrame) -> Iterator[Finding]:
    """Yield the secondary findings for which the table has data.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    frame : DataFrame
        Tidy answers; columns ``trial`` (order), ``response_time`` [s], ``speed_left_mm_s`` and
        ``speed_right_mm_s`` (predicted peak speeds under the fingers) are used if present.
    """
    if answers.compares:
        yield from side_findings(answers)
        if has_values(frame, "trial"):
            yield from order_findings(answers, frame)
    timed = frame.dropna(subset=["response_time"]) if "response_time" in frame else frame[:0]
    if len(timed) and has_values(timed, "response_time"):
        yield from time_findings(answers, timed, len(frame) - len(timed))
    if answers.compares and has_values(frame, "speed_left_mm_s") and has_values(frame, "speed_right_mm_s"):
        yield from speed_findings(answers, frame)


def has_values(frame: pd.DataFrame, column: str) -> bool:
    """Return whether a table of single answers has a numeric column without missing values."""
    single = bool((frame["n"] == 1).all()) if "n" in frame.columns else True
    return column in frame.columns and single and bool(frame[column].notna().all())


def side_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Test whether the focus is chosen more often on the right than on the left."""
    yield from _aliased_side_findings(answers)
    left, right = (
        [q for q, pair in enumerate(answers.pairs) if pair.focused and pair.dominant_side == side]
        for side in ("left", "right")
    )
    if not (right and left):
        return
    dominant = answers.shares(answers.dominant).mean
    for f, condition in enumerate(answers.finger_conditions):
        on_right, on_left = (mean_of_known(dominant[f, places].T) for places in (right, left))
        labels = [", ".join(answers.pairs[q].label for q in group) for group in (right, left)]
        yield _mean_finding(
            "side", "side bias", f"{condition} {labels[0]} - {labels[1]}", (on_right - on_left) * answers.facing,
            "P(focus) on the right minus on the left",
        )  # fmt: skip


def _mean_finding(
    question: str, what: str, scope: str, scores: ArrayLike, quantity: str, notes: Sequence[str] = ()
) -> Finding:
    """Return the mean of participants' scores in [-1, 1], with its test and interval."""
    mean, name = BoundedMean(scores), f"{what}, test and interval of a bounded mean"
    return finding_of(question, name, scope, mean.test(), quantity, mean.interval(), int(mean.n), notes=notes)


def _aliased_side_findings(answers: AnswerCounts) -> Iterator[Finding]:
    """Test the side bias in pairs without the focus, which only mirrored placement can separate from the zones."""
    if not answers.mirrored or len(answers.mirrored) == answers.n_participants:
        return
    for f, q, scope in answers.pair_cells:
        if answers.pairs[q].focused:
            continue
        on_left, on_right = (
            Shares(answers.sided()[:, f, q, :, place], answers.answered[f, q], answers.n_repetitions).known
            for place in (0, 1)
        )
        yield _mean_finding(
            "side", "side preference", scope, mean_of_known(on_right - on_left) * answers.facing,
            "P(right) - P(left), as the participant sees the beam",
            [f"{len(answers.mirrored)} of {answers.n_participants} participants with the beam turned end to end"],
        )  # fmt: skip


def order_findings(answers: AnswerCounts, frame: pd.DataFrame) -> Iterator[Finding]:
    """Test for a drift of the answers over the session, and an effect of the order of the finger conditions."""
    ranked = ranked_answers(answers, frame)
    scores = ranked.groupby("participant", observed=True)["drift"].sum().to_numpy()
    largest = float(ranked.groupby("participant", observed=True)["reach"].sum().max())
    yield _mean_finding(
        "order", "drift over the session", "all", scores / (largest or math.nan), "drift of P(dominant), -1 to 1",
        ["rank of the trial within its pair and finger condition against choosing the dominant zone"],
    )  # fmt: skip
    if len(answers.finger_conditions) != 2:
        return
    parts = ranked.groupby(["participant", "session", "finger_condition"], observed=True)
    starts, shares = (getattr(parts[name], how)().unstack() for name, how in (("trial", "min"), ("dominant", "mean")))
    if len(starts.columns) < 2:
        return
    lead = np.sign(starts.iloc[:, 1] - starts.iloc[:, 0])  # 0 if both begin with the same trial (unknown order)
    led = [int((lead == sign).sum()) for sign in (1, -1)]
    if not any(led):
        return
    score = (lead.where(lead != 0) * (shares.iloc[:, 0] - shares.iloc[:, 1])).groupby("participant").mean()
    first, second = (name.replace("_", " ") for name in starts.columns)
    notes = [
        f"sessions: {led[0]} began with {first}, {led[1]} with {second}",
        "" if all(led) else "the effect of order cannot be separated from that of the finger condition",
    ]
    yield _mean_finding(
        "order", "first against second finger condition", "all", score, "P(dominant), first minus second", notes
    )


def time_findings(answers: AnswerCounts, frame: pd.DataFrame, n_untimed: int = 0) -> Iterator[Finding]:
    """Test differences of reaction time between pairs, by sign flips of the participants' medians."""
    kept = frame[frame["response_time"] >= ANTICIPATION]
    dropped, unsure = len(frame) - len(kept), "response_uncertainty"
    known = float(frame[unsure].quantile(0.95)) if has_values(frame, unsure) else 0.0
    for condition in answers.finger_conditions:
        # Without any valid reaction time for a pair, there is no median to compare.
        pairs = [pair.label for pair in answers.pairs]
        medians, all_medians = (_medians(table, condition).reindex(columns=pairs) for table in (kept, frame))
        for first, second in combinations(answers.pairs, 2):
            gap = (medians[first.label] - medians[second.label]).dropna().to_numpy()
            every = (all_medians[first.label] - all_medians[second.label]).dropna().to_numpy()
            test, unfiltered = (sign_flip_test(time_steps(values)[0]) for values in (gap, every))
            notes = [
                f"{dropped} of all {len(frame)} answers left out as faster than {ANTICIPATION:g} s",
                f"with them p = {unfiltered.p:.2g}" if dropped else "",
                f"{n_untimed} more answer{'s' * (n_untimed > 1)} without a reaction time" if n_untimed else "",
                f"reaction times are known to {known * 1e3:.2g} ms" if known else "",
            ]
            yield finding_of(
                "time", "exact sign-flip test of median reaction times",
                f"{condition} {first.label} - {second.label}", test, "difference of medians [s]",
                centre_interval(gap), int(gap.size), notes=notes,
            )  # fmt: skip


def speed_findings(answers: AnswerCounts, frame: pd.DataFrame) -> Iterator[Finding]:
    """Test whether answers favour the finger with the higher predicted speed, with one score per participant.

    An answer scores 1 for the faster finger, -1 for the slower and 0 for both, weighted by the ratio of speeds in
    octaves; answers that name no finger are excluded.
    """
    ratio = (frame["speed_right_mm_s"] / frame["speed_left_mm_s"]).astype(float)
    octaves = ratio.where((ratio > 0) & np.isfinite(ratio)).transform(np.log2)
    side = frame["response"].astype(str).map({each.name: each.side for each in answers.answers if each.fingers})
    table = pd.DataFrame({"towards": octaves * side, "most": octaves.where(side.notna()).abs()})
    sums = table.groupby([frame[name].astype(str) for name in ("finger_condition", "participant")]).sum()
    share = sums["towards"] / sums["most"].where(sums["most"] > 0)
    for condition in answers.finger_conditions:
        own = share[condition].dropna().to_numpy()
        if own.size:
            notes = ["answers weighted by the octaves between the two speeds"]
            quantity = "share naming the faster finger minus the slower"
            yield _mean_finding("speed", "naming the faster finger", condition, own, quantity, notes)


def _medians(frame: pd.DataFrame, condition: str) -> pd.DataFrame:
    own = frame[frame["finger_condition"].astype(str) == condition]
    return own.groupby([own["participant"].astype(str), label_zones(own)])["response_time"].median().unstack()


def ranked_answers(answers: AnswerCounts, frame: pd.DataFrame) -> pd.DataFrame:
    """Return the answers with their rank within session, finger condition and pair, centred on zero.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    frame : DataFrame
        Tidy answers with a column ``trial``.
    """
    keys = ["participant", "finger_condition", "zone_left", "zone_right"]
    table = frame[keys].astype(str).assign(trial=frame["trial"].to_numpy())
    table["session"] = frame["session"].to_numpy() if "session" in frame else ""
    named = np.zeros(len(table), dtype=bool)
    for pair in answers.pairs:
        own = (table["zone_left"] == pair.left) & (table["zone_right"] == pair.right)
        word = answers.answers[answers.dominant_place(pair)].name
        named |= (own & (frame["response"] == word)).to_numpy(dtype=bool)
    table["dominant"] = named.astype(int)
    trials = table.groupby([*keys, "session"], observed=True)["trial"]
    centred = (2 * trials.rank() - (trials.transform("size") + 1)).astype(int)
    table["drift"] = centred * table["dominant"]
    table["reach"] = centred.where(centred > 0, 0)
    return table
