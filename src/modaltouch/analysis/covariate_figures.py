"""Figures of the answers against covariates: trial order, reaction time, and the ratio of speeds under the fingers."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from modaltouch.analysis.columns import label_zones
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.covariates import ANTICIPATION, has_values, ranked_answers
from modaltouch.analysis.figures import ANSWER_COLOURS, pair_colours
from modaltouch.analysis.intervals import BoundedMean
from modaltouch.analysis.words import condition_in_words
from modaltouch.protocol import AnswerList
from modaltouch.report import FAINT, INK, house_style, quiet_grid

MOST_TRIALS = 40
"""Maximum number of points; more trials than this are averaged in groups."""


def draw_order(answers: AnswerCounts, frame: pd.DataFrame) -> Figure | None:
    """Plot the share of the dominant zone over the session.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    frame : DataFrame
        Tidy answers.

    Returns
    -------
    Figure or None
        None if the table has no trial order.
    """
    if not has_values(frame, "trial"):
        return None
    ranked = ranked_answers(answers, frame)
    labels = ranked["zone_left"] + "-" + ranked["zone_right"]
    trials = ranked.groupby(["participant", "session"], observed=True)["trial"].rank(method="first")
    step = int(np.ceil(trials.max() / MOST_TRIALS))
    shares = ranked["dominant"].groupby([(trials - 1) // step * step + (step + 1) / 2, labels]).mean().unstack()
    with house_style(6.4, 2.8) as (figure, [[axes]]):
        for (label, colour), marker in zip(
            pair_colours([pair.label for pair in answers.pairs]).items(), "os^Dvp" * len(answers.pairs), strict=False
        ):
            axes.plot(
                shares.index, shares[label], linestyle="none", marker=marker, markersize=4.5, color=colour,
                markeredgecolor=INK, markeredgewidth=0.4, label=label,
            )  # fmt: skip
        axes.set_ylim(-0.04, 1.04)
        axes.set_xlabel(
            "answer of the session, in the order of trials" + (f", in groups of {step}" if step > 1 else "")
        )
        axes.set_ylabel("share of the\ndominant zone")
        figure.legend(loc="outside right upper", frameon=False)
        quiet_grid(axes)
        figure.suptitle(f"Order and fatigue (N = {answers.n_participants})", fontsize=9)
    return figure


def draw_times(answers: AnswerCounts, frame: pd.DataFrame) -> Figure | None:
    """Draw box plots of reaction time by pair and answer; return None without reaction times."""
    if "response_time" not in frame or not has_values(frame.dropna(subset=["response_time"]), "response_time"):
        return None
    kept = frame[frame["response_time"] >= ANTICIPATION]
    if kept.empty:
        return None
    labels = label_zones(kept)
    with house_style(6.4, 3.0) as (figure, [[axes]]):
        groups, ticks = [], []
        for pair in answers.pairs:
            for condition in answers.finger_conditions:
                own = (labels == pair.label) & (kept["finger_condition"].astype(str) == condition)
                groups.append(kept.loc[own, "response_time"].to_numpy())
                ticks.append(f"{', '.join(pair.zones)}\n{condition_in_words(condition)}")
        axes.boxplot(groups, whis=(5, 95), widths=0.55, medianprops={"color": INK, "linewidth": 1.4},
                     flierprops={"marker": ".", "markersize": 2, "markeredgecolor": FAINT})  # fmt: skip
        axes.set_xticks(range(1, len(ticks) + 1), ticks)
        axes.set_ylim(0, None)
        axes.set_ylabel("reaction time [s]")
        quiet_grid(axes)
        figure.suptitle(
            f"Reaction times: median, quartiles, 5th to 95th percentile (n = {len(kept)} answers)", fontsize=9,
        )  # fmt: skip
    return figure


def draw_speeds(answers: AnswerCounts, frame: pd.DataFrame) -> Figure | None:
    """Plot the shares of answers against the predicted ratio of speeds; return None without speeds for two fingers."""
    sides = ("speed_left_mm_s", "speed_right_mm_s")
    if "zone_between" in frame.columns or not all(has_values(frame, side) for side in sides):
        return None
    # Use the median over the placements of a pair; pool pairs with the same ratio to a tenth of an octave.
    octaves = (frame["speed_right_mm_s"] / frame["speed_left_mm_s"]).astype(float).transform(np.log2)
    cells = [frame[name].astype(str) for name in ("finger_condition", "zone_left", "zone_right")]
    ratio = 2 ** octaves.groupby(cells).transform("median").to_numpy(dtype=float).round(1)
    with house_style(
        3.3 * len(answers.finger_conditions) + 0.6, 3.0, 1, len(answers.finger_conditions), sharey=True
    ) as (figure, [panels]):
        for axes, condition in zip(panels, answers.finger_conditions, strict=True):
            own = (frame["finger_condition"].astype(str) == condition).to_numpy()
            _draw_ratios(axes, frame[own].assign(ratio=ratio[own]), answers.answers)
            axes.set_title(condition_in_words(condition))
            axes.set_xlabel("predicted peak speed, right / left finger")
        panels[0].set_ylabel("share of answers")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
        figure.suptitle(f"Answers by predicted speed ratio (95 % intervals, N = {answers.n_participants})", fontsize=9)
    return figure


def _draw_ratios(axes: Axes, frame: pd.DataFrame, answers: AnswerList) -> None:
    styles = {-1: (ANSWER_COLOURS["other"], "<"), 0: (FAINT, "o"), 1: (ANSWER_COLOURS["dominant"], ">")}
    for answer in answers:
        if not answer.fingers:
            continue
        colour, marker = styles[answer.side]
        chosen = (frame["response"] == answer.name).groupby([frame["ratio"], frame["participant"]], observed=True)
        hits = chosen.mean().unstack()
        share = BoundedMean(hits.to_numpy(), 0.0, 1.0).interval()
        estimate, low, high = share.estimate, share.low, share.high
        axes.errorbar(
            hits.index * (1 + 0.03 * answer.side), estimate, yerr=np.maximum([estimate - low, high - estimate], 0),
            marker=marker, color=colour, label=answer.name, capsize=2, markersize=5, linewidth=0.9, elinewidth=0.7,
        )  # fmt: skip
    axes.set_xscale("log", base=2)
    ratios = sorted(frame["ratio"].unique())
    axes.set_xticks(ratios, [f"{ratio:.2g}" for ratio in ratios])
    axes.minorticks_off()
    axes.set_ylim(-0.03, 1.03)
    quiet_grid(axes)
