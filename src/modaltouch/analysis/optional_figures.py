"""Optional figures: the velocity fields, and the answers against trial order, reaction time and ratio of speeds."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from modaltouch.analysis.columns import label_zones
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.covariates import ANTICIPATION, has_values, ranked_answers
from modaltouch.analysis.figures import ANSWER_COLOURS, pair_colours
from modaltouch.analysis.intervals import BoundedMean
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.words import condition_in_words
from modaltouch.protocol import AnswerList
from modaltouch.report import CONDITION_COLOURS, FAINT, INK, ReportFigure, house_style, quiet_grid

FIGURES = {
    "fields": (
        "Left: the target velocity field along the beam, and the field predicted at the focusing instant from the "
        "codes that were played, on the identified modes. Right: predicted peak speed over time at the centre of each "
        "zone.",
        "stimulus",
    ),
    "order": ("Share of the dominant zone over the course of the session.", "further"),
    "reaction_times": (
        "An answer may wait for the next burst, so reaction times are quantised and small differences mean little. "
        "Answers that come too early to be genuine are left out.",
        "further",
    ),
    "speed_ratio": (
        "Predicted peak speeds come from the identified modes of the beam, not from a measurement.",
        "further",
    ),
}
"""Captions and report sections of the optional figures."""

MOST_TRIALS = 40
"""Maximum number of points; more trials than this are averaged in groups."""


def draw_optional(answers: AnswerCounts, responses: Responses, asked: Collection[str]) -> list[ReportFigure]:
    """Draw the requested figures as far as the answers allow.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    responses : Responses
        The answers.
    asked : collection of str
        Requested figures, keys of `FIGURES`.
    """
    frame = responses.frame
    ways: dict[str, Callable[[], Figure | None]] = {
        "fields": lambda: draw_fields(responses.start, responses.stimulus),
        "order": lambda: draw_order(answers, frame),
        "reaction_times": lambda: draw_times(answers, frame),
        "speed_ratio": lambda: draw_speeds(answers, frame),
    }
    drawn = {name: draw() for name, draw in ways.items() if name in asked}
    return [ReportFigure(name, figure, *FIGURES[name]) for name, figure in drawn.items() if figure is not None]


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
        None if the table has no trial order, or no answer names each finger alone.
    """
    if not (answers.compares and has_values(frame, "trial")):
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
        grouped = f", in groups of {step}" if step > 1 else ""
        axes.set(
            ylim=(-0.04, 1.04),
            xlabel=f"answer of the session, in the order of trials{grouped}",
            ylabel="share of the\ndominant zone",
        )
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
        axes.set(ylim=(0, None), ylabel="reaction time [s]")
        quiet_grid(axes)
        figure.suptitle(
            f"Reaction times: median, quartiles, 5th to 95th percentile (n = {len(kept)} answers)", fontsize=9,
        )  # fmt: skip
    return figure


def draw_speeds(answers: AnswerCounts, frame: pd.DataFrame) -> Figure | None:
    """Plot the shares of answers against the predicted ratio of speeds; return None without speeds for two fingers."""
    sides = ("speed_left_mm_s", "speed_right_mm_s")
    if not answers.compares or "zone_between" in frame.columns or not all(has_values(frame, side) for side in sides):
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
            axes.set(title=condition_in_words(condition), xlabel="predicted peak speed, right / left finger")
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


def draw_fields(start: dict[str, Any], stimulus: str = "") -> Figure | None:
    """Plot the target and the predicted field at the highest level, and the peak speeds at the zones.

    Parameters
    ----------
    start : dict
        Start record of a session.
    stimulus : str
        Name of the stimulus; empty if there is only one.

    Returns
    -------
    Figure or None
        None without a record, or if the record contains no field and its protocol cannot be read by this version.
    """
    if not start.get("sources"):
        return None
    fields = _of(stimulus, start.get("stimulus", {}).get("fields") or _predict_again(start))
    if not fields:
        return None
    stimuli = _of(stimulus, start.get("stimulus", {}).get("stimuli", []))
    with house_style(7.6, 2.9, 1, 2, width_ratios=(3, 2)) as (figure, [[left, right]]):
        _draw_field(left, fields)
        _draw_zones(right, stimuli)
        whose = f" (levels of participant {start['participant']})" if start.get("sensation_levels") else ""
        touched = ", under the fingers that it is designed for" if "placement" in fields[0] else ""
        figure.suptitle(f"Stimulus: focus {fields[0]['focus']}, law {fields[0]['law']}{touched}{whose}", fontsize=9)
    return figure


def _of(stimulus: str, recorded: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [each for each in recorded if each.get("stimulus", "") == stimulus]


def _predict_again(start: dict[str, Any]) -> list[dict[str, Any]]:
    """Recompute the fields of a record without any from its protocol; empty if the protocol cannot be read."""
    from modaltouch.preflight import examine_findings
    from modaltouch.protocol import Findings, InputError

    try:
        preflight = examine_findings(Findings.recorded(start)).require()
        own = start.get("sensation_levels")
        return (preflight.with_levels(tuple(own["levels_mm_s"])) if own else preflight).fields
    except (InputError, KeyError, TypeError):
        return []


def _draw_field(axes: Axes, fields: list[dict[str, Any]]) -> None:
    field = fields[0]
    half, target = field["length_mm"] / 2, field["target_mm_s"]
    place = np.linspace(-half, half, len(target))
    reached = [each["predicted_mm_s"] for each in fields]
    for name, (first, last) in field["zones_mm"].items():
        axes.axvspan(first, last, color="#eef2f7", linewidth=0.8, ec="white", zorder=0)
        centre = (first + last) / 2
        axes.text(centre, 0.97, name, ha="center", va="top", color=FAINT, transform=axes.get_xaxis_transform())
    axes.plot(place, target, color=INK, linestyle="--", linewidth=1, label="target")
    for i, (each, predicted) in enumerate(zip(fields, reached, strict=True)):
        axes.plot(
            place,
            predicted,
            color=CONDITION_COLOURS[i % len(CONDITION_COLOURS)],
            linestyle=("-", "--", ":")[i % 3],
            linewidth=1.6,
            label=f"predicted, {each['placement']}" if "placement" in each else "predicted",
        )
    axes.set(
        ylim=(min(0, 1.1 * np.min(reached)), 1.16 * max(np.max(target), np.max(reached))),
        xlim=(-half, half),
        xlabel="place along the beam [mm]",
        ylabel=f"velocity at the focusing\ninstant [mm/s], level {field['velocity_mm_s']:g}",
    )
    axes.legend(frameon=False, loc="center left", fontsize=7)


def _draw_zones(axes: Axes, stimuli: list[dict[str, Any]]) -> None:
    highest = max((each["velocity_mm_s"] for each in stimuli), default=0.0)
    placed = [each for each in stimuli if "placement" in each and each["velocity_mm_s"] == highest]
    for i, stimulus in enumerate(placed or stimuli):
        zones = stimulus["zone_peak_mm_s"]
        axes.plot(
            list(zones),
            list(zones.values()),
            color=CONDITION_COLOURS[i % len(CONDITION_COLOURS)],
            linewidth=0.8,
            marker="os^Dvp"[i % 6],
            markersize=4,
            label=stimulus["placement"] if placed else format(float(stimulus["velocity_mm_s"]), "g"),
        )
    axes.set(ylim=(0, None), xlabel="zone", ylabel="peak speed [mm/s]")
    axes.legend(
        title="fingers at" if placed else "level [mm/s]",
        frameon=False,
        fontsize=7,
        title_fontsize=7,
        loc="upper left",
        bbox_to_anchor=(1, 1),
    )
    quiet_grid(axes)
