"""Figures of what each participant tells: measures by level or condition, psychometric functions, and groups."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from modaltouch.analysis.designs import DesignAnalysis
from modaltouch.analysis.detection import CRITERION
from modaltouch.analysis.measures import Measure, Own, by_measure, of_participants, over_participants
from modaltouch.analysis.scale import LevelScale
from modaltouch.analysis.thresholds.constant import FittedCell
from modaltouch.analysis.words import say_condition
from modaltouch.report import CONDITION_COLOURS, FAINT, ReportFigure, house_style, quiet_grid

PANELS_PER_ROW = 3
_MARKERS = "os^D"
_THIN = "Thin: each participant. Bold: mean over participants with its 95 % interval, by sign flips"


def draw_design(design: DesignAnalysis) -> Iterator[ReportFigure]:
    """Yield the figures: one of each measure, one of the psychometric functions, one of the groups.

    Parameters
    ----------
    design : DesignAnalysis
        What each participant tells.
    """
    scale, groups = design.scale, design.groups
    if design.fits:
        caption = "Psychometric functions. Dots: share of successes of each participant, the larger the more answers."
        yield ReportFigure("functions", draw_functions(design.fits, scale), caption, "each")
    for measure, own in by_measure(design.values):
        if measure != CRITERION and any(math.isfinite(each.interval.estimate) for each in own):
            name = "".join(letter if letter.isalnum() else "_" for letter in measure.name.replace("'", "_prime"))
            caption = f"{measure.quantity[:1].upper()}{measure.quantity[1:]}. {_THIN}."
            yield ReportFigure(f"measure_{name}", draw_measure(measure, own, scale), caption, "each")
    if groups:
        caption = f"Groups of participants. {_THIN.replace('Thin', 'Dots')}."
        yield ReportFigure("groups", draw_groups(design.values, groups), caption, "each")


def draw_measure(measure: Measure, values: Sequence[Own], scale: LevelScale) -> Figure:
    """Return a measure against the level, or the finger condition; a panel for each pair of zones.

    Parameters
    ----------
    measure : Measure
        What it is.
    values : sequence of Own
        Its values.
    scale : LevelScale
        What the levels are.
    """
    pairs, conditions = (
        list(dict.fromkeys(v.pair for v in values)),
        list(dict.fromkeys(v.finger_condition for v in values)),
    )
    has_levels = not math.isnan(values[0].level)
    with _panels(len(pairs), sharey=True) as (figure, panels):
        for axes, pair in zip(panels, pairs, strict=False):
            for k, condition in enumerate(conditions):
                own = [v for v in values if (v.pair, v.finger_condition) == (pair, condition)]
                _draw_people(axes, measure, own, k, has_levels=has_levels)
            axes.set_title(f"({pair.replace('-', ', ')})" if pair else "", fontsize=9)
            if measure.is_ratio:
                axes.set_yscale("log")
                axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
                axes.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            if has_levels:
                _mark_levels(axes, sorted({v.level for v in values}))
                axes.set_xlabel(scale.quantity)
            else:
                axes.set_xticks(range(len(conditions)), [say_condition(name) for name in conditions])
                axes.set_xlim(-0.6, len(conditions) - 0.4)
            if measure.null is not None:
                axes.axhline(measure.null, color=FAINT, linewidth=0.8, linestyle=(0, (4, 2)), zorder=0)
            quiet_grid(axes)
        panels[0].set_ylabel(measure.quantity)
        if len(conditions) > 1 and has_levels:
            panels[0].legend(frameon=False)
    return figure


def _draw_people(axes: Axes, measure: Measure, own: Sequence[Own], k: int, *, has_levels: bool) -> None:
    """Draw each participant thinly, and the mean with its interval at each place."""
    colour, marker = CONDITION_COLOURS[k % 4], _MARKERS[k % 4]
    people: dict[str, list[tuple[float, float]]] = {}
    places: dict[float, list[Own]] = {}
    for each in own:
        place = each.level if has_levels else float(k)
        people.setdefault(each.participant, []).append((place, each.interval.estimate))
        places.setdefault(place, []).append(each)
    for i, line in enumerate(people.values()):
        x, y = np.array(line, dtype=float).T
        x = x if has_levels else x - 0.25 + 0.02 * (i % 11)
        axes.plot(x, y, color=colour, alpha=0.3, linewidth=0.7, marker=".", ms=4, zorder=1)
    means = [over_participants(measure, those)[1] for those in places.values()]
    estimate, low, high = np.array([(m.estimate, m.low, m.high) for m in means], dtype=float).T
    open_low = ~np.isfinite(low) | (measure.is_ratio & (low == 0))
    ends = np.where(open_low, estimate, low), np.where(np.isfinite(high), high, estimate)
    reach = np.abs(np.stack(ends) - estimate)
    label = say_condition(own[0].finger_condition) if own else ""
    axes.errorbar(
        list(places), estimate, reach, color=colour, marker=marker, ms=5, linewidth=1.6 if has_levels else 0,
        elinewidth=1.4, capsize=2, zorder=3, label=label,
    )  # fmt: skip


def draw_functions(fits: Sequence[FittedCell], scale: LevelScale) -> Figure:
    """Return the psychometric functions of all participants, a panel for each finger condition and pair of zones.

    Parameters
    ----------
    fits : sequence of FittedCell
        The functions.
    scale : LevelScale
        What the levels are.
    """
    kinds = list(dict.fromkeys(each.cell[1:3] for each in fits))
    levels = sorted({float(level) for each in fits for level in each.levels})
    fine = np.geomspace(levels[0], levels[-1], 150)
    with _panels(len(kinds), sharey=True) as (figure, panels):
        for axes, (condition, pair) in zip(panels, kinds, strict=False):
            for i, each in enumerate(one for one in fits if one.cell[1:3] == (condition, pair)):
                colour = CONDITION_COLOURS[i % 4]
                axes.scatter(each.levels, each.shares, s=4 + 2 * each.tries, color=colour, alpha=0.35, linewidth=0)
                curve = each.fitted.probability(20 * np.log10(fine))
                if curve is not None:
                    axes.plot(fine, curve, color=colour, linewidth=0.9, alpha=0.8)
            axes.set_title(f"{say_condition(condition)} ({pair.replace('-', ', ')})", fontsize=9)
            axes.set_ylim(-0.04, 1.04)
            _mark_levels(axes, levels)
            axes.set_xlabel(scale.quantity)
            quiet_grid(axes)
        panels[0].set_ylabel("share of comparisons chosen" if fits[0].is_choice else "share of successes")
    return figure


def draw_groups(values: Sequence[Own], groups: Mapping[str, str]) -> Figure:
    """Return each measure by group; a participant is a dot, the mean over conditions and levels.

    Parameters
    ----------
    values : sequence of Own
        The values.
    groups : mapping of str to str
        Group of each participant.
    """
    kinds, names = list(by_measure(values)), sorted(set(groups.values()))
    with _panels(max(len(kinds), 1)) as (figure, panels):
        for axes, (measure, own) in zip(panels, kinds, strict=False):
            for k, name in enumerate(names):
                theirs = [v for v in of_participants(own) if groups.get(v.participant) == name]
                _draw_people(axes, measure, theirs, k, has_levels=False)
            axes.set_xticks(range(len(names)), names)
            axes.set_xlim(-0.6, len(names) - 0.4)
            axes.set_title(measure.quantity, fontsize=8, wrap=True)
            quiet_grid(axes)
    return figure


@contextmanager
def _panels(number: int, *, sharey: bool = False) -> Iterator[tuple[Figure, list[Axes]]]:
    """Yield a figure with panels in rows; those that stay empty are switched off."""
    columns = min(number, PANELS_PER_ROW)
    rows = math.ceil(number / columns)
    width = max(2.5 * columns + 0.3, 4.6)
    with house_style(width, 2.8 * rows, rows, columns, sharey=sharey) as (figure, panels):
        every = list(panels.flat)
        for axes in every[number:]:
            axes.set_axis_off()
        yield figure, every[:number]


def _mark_levels(axes: Axes, levels: Sequence[float]) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(levels))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.tick_params(axis="x", labelrotation=90 if len(levels) > 5 else 0)
    axes.set_xlim(levels[0] / 1.1, levels[-1] * 1.1)
