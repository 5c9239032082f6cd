"""Report of adaptive sessions: figures of the track and the fitted function of each run, and of all thresholds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from modaltouch.analysis.columns import scale_of
from modaltouch.analysis.intervals import Interval
from modaltouch.analysis.provenance import describe_record
from modaltouch.analysis.psychometric import counted
from modaltouch.analysis.runs import Run, ThresholdAnalysis, in_words, is_forced
from modaltouch.analysis.words import certificates_in_words, format_interval
from modaltouch.report import CONDITION_COLOURS, FAINT, INK, ReportFigure, house_style, page_files, quiet_grid

BLUE = CONDITION_COLOURS[0]
# Height of the panels of a run [inch].
_ROW = 2.5

MOST_FIGURES = 60
"""Maximum number of sessions with figures of runs; with more, the report is too large for a browser."""


def draw_runs(runs: Sequence[Run], bounds: tuple[float, float]) -> Figure:
    """Plot the runs of a session in rows, with the track on the left and the fitted function on the right.

    Parameters
    ----------
    runs : sequence of Run
        Runs of one session.
    bounds : (float, float)
        Lowest and highest possible level of a run [mm/s].
    """
    with house_style(7.4, _ROW * len(runs) + 0.5, len(runs), 2, width_ratios=[1.35, 1]) as (figure, rows):
        for (track, function), run in zip(rows, runs, strict=True):
            _draw_track(track, run, bounds)
            _draw_function(function, run, bounds)
        rows[-1][0].set_xlabel("trial of the run")
        rows[-1][1].set_xlabel("level [mm/s]")
        rows[0][0].legend(loc="upper right", frameon=False, ncols=2)
        figure.suptitle(f"Participant {runs[0].participant}, session {runs[0].session}", fontsize=10)
    return figure


def _draw_track(axes: Axes, run: Run, bounds: tuple[float, float]) -> None:
    trials = np.arange(1, len(run.levels) + 1)
    axes.plot(trials, run.levels, color=FAINT, linewidth=0.8, zorder=1)
    _band(axes.axhspan, axes.axhline, run.fitted.threshold, bounds)
    for success, marker, face, label in ((True, "o", BLUE, "success"), (False, "o", "white", "no success")):
        chosen = run.successes == success
        axes.scatter(
            trials[chosen], run.levels[chosen], s=20, marker=marker, color=face, edgecolor=BLUE, linewidth=0.9,
            zorder=2, label=label,
        )  # fmt: skip
    axes.set(yscale="log", ylim=(bounds[0] / 1.25, bounds[1] * 1.9), ylabel="level [mm/s]")
    _mark_levels(axes.yaxis)
    axes.set_title(run.kind, loc="left", fontsize=9)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    quiet_grid(axes)


def _draw_function(axes: Axes, run: Run, bounds: tuple[float, float]) -> None:
    levels, hits, tries = counted(run.levels, run.successes)
    _band(axes.axvspan, axes.axvline, run.fitted.threshold, bounds)
    axes.scatter(
        levels, hits / tries, s=10 + 9 * tries, color=BLUE, alpha=0.75, edgecolor="white", linewidth=0.5, zorder=3
    )
    fine = np.geomspace(*bounds, 200)
    curve = run.fitted.probability(20 * np.log10(fine))
    if curve is not None:
        axes.plot(fine, curve, color=INK, linewidth=1.3, zorder=2)
    axes.set(xscale="log", xlim=(bounds[0] / 1.15, bounds[1] * 1.15), ylim=(-0.06, 1.06), ylabel="share of successes")
    _mark_levels(axes.xaxis)
    threshold = run.fitted.threshold
    title = "no threshold" if threshold is None else f"threshold {in_words(threshold, ' mm/s')}"
    axes.set_title(title, loc="left", fontsize=9)
    quiet_grid(axes)


def _mark_levels(axis: Axis) -> None:
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def _in_mm_s(threshold: Interval, bounds: tuple[float, float]) -> tuple[float, float, float]:
    """Return the lower bound, value and upper bound of a threshold [mm/s]; infinite bounds lie outside the figure."""
    bounded = threshold.changed(lambda level: float(np.clip(10 ** (level / 20), bounds[0] / 10, bounds[1] * 10)))
    return bounded.low, bounded.estimate, bounded.high


def _band(
    span: Callable[..., Any], line: Callable[..., Any], threshold: Interval | None, bounds: tuple[float, float]
) -> None:
    """Mark a threshold and its interval across a panel."""
    if threshold is not None:
        low, value, high = _in_mm_s(threshold, bounds)
        span(low, high, color="#e6ecf6", zorder=0, linewidth=0)
        line(value, color=INK, linewidth=0.9, linestyle=(0, (4, 2)), zorder=1)


def draw_thresholds(runs: Sequence[Run], bounds: tuple[float, float]) -> Figure:
    """Plot the thresholds of all runs with their intervals; runs without a threshold have open markers at the edge.

    Parameters
    ----------
    runs : sequence of Run
        All runs.
    bounds : (float, float)
        Lowest and highest possible level of a run [mm/s].
    """
    kinds = list(dict.fromkeys(run.kind for run in runs))
    people = list(dict.fromkeys((run.participant, run.session) for run in runs))
    with house_style(6.4, min(1.4 + 0.17 * len(people) * len(kinds), 40.0)) as (figure, [[axes]]):
        for k, kind in enumerate(kinds):
            own = [run for run in runs if run.kind == kind]
            heights = np.array([people.index((run.participant, run.session)) for run in own], dtype=float)
            heights += 0.62 * (k + 0.5) / len(kinds) - 0.31
            _draw_kind(axes, own, heights, k, bounds)
        axes.set_yticks(range(len(people)), [f"{name} ({number})" for name, number in people])
        axes.set(
            xscale="log",
            xlim=(bounds[0] / 1.3, bounds[1] * 1.3),
            ylim=(len(people) - 0.4, -0.6),
            xlabel="threshold [mm/s]",
            ylabel="participant (session)",
            axisbelow=True,
        )
        _mark_levels(axes.xaxis)
        axes.grid(axis="x", color="#e3e7ec", linewidth=0.7)
        figure.legend(loc="outside upper center", frameon=False, ncols=min(len(kinds), 3))
    return figure


def _draw_kind(axes: Axes, runs: Sequence[Run], heights: np.ndarray, k: int, bounds: tuple[float, float]) -> None:
    # When colours repeat, shift the markers by one, for 32 distinct combinations.
    colour, marker = CONDITION_COLOURS[k % 4], "os^DvPX*"[(k + k // 4) % 8]
    # Empty plot, so that the legend includes kinds of run without any threshold.
    axes.plot([], [], marker=marker, color=colour, ms=5, linestyle="", label=runs[0].kind)
    for run, height in zip(runs, heights, strict=True):
        threshold = run.fitted.threshold
        if threshold is None:
            succeeded = 0 < run.fitted.n_successes == run.fitted.n_trials
            edge = bounds[0] / 1.2 if succeeded else bounds[1] * 1.2
            axes.plot(edge, height, marker=marker, color=colour, markerfacecolor="white", ms=5)
            continue
        low, value, high = _in_mm_s(threshold, bounds)
        axes.plot([low, high], [height, height], color=colour, linewidth=1.2, alpha=0.8)
        axes.plot(value, height, marker=marker, color=colour, ms=5, linestyle="")


def render_runs(analysis: ThresholdAnalysis) -> dict[str, Any]:
    """Render all files of the analysis, by name, for `write_files`.

    Parameters
    ----------
    analysis : ThresholdAnalysis
        The analysis.
    """
    rows = [run.as_dict() for run in analysis.runs]
    together = analysis.thresholds
    pictures = [ReportFigure("thresholds", draw_thresholds(analysis.runs, analysis.bounds))]
    sessions = list(dict.fromkeys((run.participant, run.session) for run in analysis.runs))
    for participant, session in sessions[:MOST_FIGURES]:
        own = [run for run in analysis.runs if (run.participant, run.session) == (participant, session)]
        who = participant.replace("/", "-")
        pictures.append(ReportFigure(f"runs_sub-{who}_ses-{session}", draw_runs(own, analysis.bounds)))
    page = _page_files(analysis, together, pictures, len(sessions))
    page["report.html"] = page.pop("runs.html")
    return {
        "thresholds.csv": rows,
        "over_participants.csv": together,
        **({"tests.csv": analysis.tests} if analysis.tests else {}),
        "thresholds.json": {"thresholds": rows, "over_participants": together},
        **page,
    }


def _page_files(
    analysis: ThresholdAnalysis, together: list[dict[str, Any]], pictures: Sequence[ReportFigure], n_sessions: int
) -> dict[str, Any]:
    responses = analysis.responses
    design = responses.start["design"]
    both, nothing = responses.answers.naming("left", "right"), responses.answers.naming()
    task = "forced choice" if is_forced(responses) else "felt"
    task += ", QUEST+" if design["adaptive"]["method"] == "quest_plus" else ""
    return page_files(
        "modaltouch.analysis",
        "runs",
        pictures,
        title=responses.heading("Thresholds"),
        source=responses.source,
        runs=[{"run": run, "words": in_words(run.fitted.threshold) if run.fitted.threshold else None}
              for run in analysis.runs],
        together=together,
        tests=[(row.scope.replace("_", " "), format_interval(row), row.p, row.n, row.note)
               for row in analysis.comparisons],
        registration=analysis.registration,
        bounds=analysis.bounds,
        adaptive=design["adaptive"],
        both="" if both is None else both.name,
        nothing="" if nothing is None else nothing.name,
        named=() if nothing and design["adaptive"]["success"] == "felt" else responses.answers.names,
        task=responses.task,
        is_forced=is_forced(responses),
        certified=[certificates_in_words(names) for names in (
            (f"mean of runs, {task}, as estimated", f"mean of runs, {task}"), (f"run of one, {task}",),
            (f"mean of runs compared, {task}, as estimated", f"mean of runs compared, {task}",
             *["group"] * any(run.group for run in analysis.runs)),
        )],
        rule=responses.start.get("adaptive", {}),
        scale=scale_of(responses.frame.columns),
        focus=" or ".join(sorted(set(responses.foci.values()) or {responses.focus})),
        n_participants=len({run.participant for run in analysis.runs}),
        n_sessions=n_sessions,
        n_missing=sum(run.n_missing for run in analysis.runs),
        left_out=responses.left_out,
        notes=responses.notes,
        command=responses.command,
        record=describe_record(responses.sessions),
    )  # fmt: skip
