"""Figures of individual results: measures by level or condition, psychometric functions, and groups."""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from modaltouch.analysis.columns import LevelScale
from modaltouch.analysis.designs import DesignAnalysis
from modaltouch.analysis.detection import CRITERION, DIFFERENCE
from modaltouch.analysis.findings import grouped
from modaltouch.analysis.measures import IndividualValue, Measure, by_measure, of_participants, over_participants
from modaltouch.analysis.psychometric import FittedCell
from modaltouch.analysis.words import condition_in_words
from modaltouch.report import CONDITION_COLOURS, FAINT, ReportFigure, house_style, quiet_grid

PANELS_PER_ROW = 3
FEWEST_FLIPS = 6
"""Minimum number of participants for a bounded 95 % interval by sign flips: 2/2^6 is the first p below 0.05."""

_MARKERS = "os^D"
_THIN = "Thin: each participant. Bold: mean over participants with its interval, whose coverage the statistics state"


def draw_design(design: DesignAnalysis) -> Iterator[ReportFigure]:
    """Yield a figure of the psychometric functions, one of each measure, and one of the groups.

    Parameters
    ----------
    design : DesignAnalysis
        Results of individual participants.
    """
    scale, groups = design.scale, design.groups
    if design.fits:
        caption = "Psychometric functions. Dots: the share of each participant, the larger the more answers."
        yield ReportFigure("functions", draw_functions(design.fits, scale), caption, "each")
    for measure, own in by_measure(design.values).items():
        if measure not in (CRITERION, DIFFERENCE) and any(math.isfinite(each.interval.estimate) for each in own):
            name = "".join(letter if letter.isalnum() else "_" for letter in measure.name.replace("'", "_prime"))
            means = _THIN.replace("mean", "geometric mean") if measure.is_ratio else _THIN
            n = len({each.participant for each in own})
            caption = f"{measure.quantity[:1].upper()}{measure.quantity[1:]}. {means}.{_too_few([measure], n)}"
            yield ReportFigure(f"measure_{name}", draw_measure(own, scale, groups), caption, "each")
    if design.shared:
        n = min(Counter(groups.values()).values())
        caption = f"Groups of participants, over the cells that all of them met. {_THIN.replace('Thin', 'Dots')}."
        caption += _too_few([each.measure for each in design.shared], n)
        yield ReportFigure("groups", draw_groups(design.shared, groups), caption, "each")


def _too_few(measures: Sequence[Measure], n: int) -> str:
    """Return a note if n participants are too few for intervals of the means."""
    if n >= FEWEST_FLIPS or all(measure.ends for measure in measures):
        return ""
    return f" With fewer than {FEWEST_FLIPS} participants, sign flips exclude no mean at 95 %, so there is no interval."


def draw_measure(values: Sequence[IndividualValue], scale: LevelScale, groups: Mapping[str, str]) -> Figure:
    """Plot a measure against the level or the finger condition, with a panel for each pair of zones.

    Groups with different cells have separate lines.

    Parameters
    ----------
    values : sequence of IndividualValue
        Values of the measure.
    scale : LevelScale
        Scale of the levels.
    groups : mapping of str to str
        Group of each participant.
    """
    panels: dict[str, dict[str, list[IndividualValue]]] = {}
    met: dict[str, set[tuple[str, str, str]]] = {}
    for each in values:
        met.setdefault(groups.get(each.participant, ""), set()).add((each.finger_condition, each.pair, str(each.level)))
    is_uneven = len({*map(frozenset, met.values())}) > 1
    places = [*groups] if is_uneven else []
    for each in sorted(values, key=lambda each: places.index(each.participant)) if is_uneven else values:
        title = f"({each.pair.replace('-', ', ')})" if each.pair else ""
        label = [condition_in_words(each.finger_condition), *([groups[each.participant]] if is_uneven else [])]
        panels.setdefault(title, {}).setdefault(" ".join(label), []).append(each)
    return _draw(panels, values[0].measure.quantity, scale)


def draw_groups(values: Sequence[IndividualValue], groups: Mapping[str, str]) -> Figure:
    """Plot each measure by group, with a dot for each participant's mean over conditions and levels.

    Parameters
    ----------
    values : sequence of IndividualValue
        Values of all measures.
    groups : mapping of str to str
        Group of each participant.
    """
    panels: dict[str, dict[str, list[IndividualValue]]] = {}
    for measure, own in by_measure(values).items():
        for each in sorted(of_participants(own), key=lambda each: [*groups].index(each.participant)):
            panels.setdefault(measure.quantity, {}).setdefault(groups.get(each.participant, ""), []).append(each)
    return _draw(panels)


def _draw(
    panels: Mapping[str, Mapping[str, list[IndividualValue]]], quantity: str = "", scale: LevelScale | None = None
) -> Figure:
    """Plot series of values in panels, against the level if there is one, else side by side."""
    with _panels(max(len(panels), 1), sharey=bool(quantity)) as (figure, places):
        for axes, (title, series) in zip(places, panels.items(), strict=False):
            every = [each for own in series.values() for each in own]
            measure, levels = every[0].measure, sorted({each.level for each in every if not math.isnan(each.level)})
            for k, (label, own) in enumerate(series.items()):
                _draw_people(axes, label, own, k)
            if measure.is_ratio:
                axes.set_yscale("log")
                axes.yaxis.set_major_formatter("{x:g}")
                axes.yaxis.set_minor_formatter("{x:g}")
            if levels and scale:
                _mark_levels(axes, levels, scale)
            else:
                axes.set_xticks(range(len(series)), list(series))
                axes.set_xlim(-0.6, len(series) - 0.4)
            if measure.null is not None:
                axes.axhline(measure.null, color=FAINT, linewidth=0.8, linestyle=(0, (4, 2)), zorder=0)
            axes.set_title(textwrap.fill(title, 30), fontsize=9)
            quiet_grid(axes)
            if levels and (len(series) > 1 and axes is places[0] or list(series) != list(next(iter(panels.values())))):
                axes.legend(frameon=False)
        places[0].set_ylabel(quantity)
    return figure


def _draw_people(axes: Axes, label: str, own: Sequence[IndividualValue], k: int) -> None:
    """Plot each participant as a thin line and the mean with its interval, against the level or side by side."""
    colour, has_levels = CONDITION_COLOURS[k % 4], not math.isnan(own[0].level)
    places = grouped((each.level if has_levels else float(k), each) for each in own)
    for i, who in enumerate(dict.fromkeys(each.participant for each in own)):
        line = [
            (place, each.interval.estimate)
            for place, those in places.items()
            for each in those
            if each.participant == who
        ]
        x, y = np.array(line, dtype=float).T
        x = x if has_levels else x - 0.25 + 0.02 * (i % 11)
        axes.plot(x, y, color=colour, alpha=0.3, linewidth=0.7, marker=".", ms=4, zorder=1)
    means = [over_participants(those[0].measure, those)[1] for those in places.values()]
    estimate, low, high = np.array([(m.estimate, m.low, m.high) for m in means], dtype=float).T
    open_low = ~np.isfinite(low) | (own[0].measure.is_ratio & (low == 0))
    ends = np.where(open_low, estimate, low), np.where(np.isfinite(high), high, estimate)
    axes.errorbar(
        list(places), estimate, np.abs(np.stack(ends) - estimate), color=colour, marker=_MARKERS[(k + k // 4) % 4],
        ms=5, linewidth=1.6 if has_levels else 0, elinewidth=1.4, capsize=2, zorder=3, label=label,
    )  # fmt: skip


def draw_functions(fits: Sequence[FittedCell], scale: LevelScale) -> Figure:
    """Plot the psychometric functions of all participants, with a panel for each finger condition and pair of zones.

    Parameters
    ----------
    fits : sequence of FittedCell
        Fitted functions.
    scale : LevelScale
        Scale of the levels.
    """
    kinds = list(dict.fromkeys(each.cell[1:3] for each in fits))
    levels = sorted({float(level) for each in fits for level in each.levels})
    fine = np.geomspace(levels[0], levels[-1], 150)
    with _panels(len(kinds), sharey=True) as (figure, panels):
        for axes, (condition, pair) in zip(panels, kinds, strict=True):
            for i, each in enumerate(one for one in fits if one.cell[1:3] == (condition, pair)):
                colour = CONDITION_COLOURS[i % 4]
                axes.scatter(each.levels, each.shares, s=4 + 2 * each.tries, color=colour, alpha=0.35, linewidth=0)
                curve = each.fitted.probability(20 * np.log10(fine))
                if curve is not None:
                    axes.plot(fine, curve, color=colour, linewidth=0.9, alpha=0.8)
            axes.set_title(f"{condition_in_words(condition)} ({pair.replace('-', ', ')})", fontsize=9)
            axes.set_ylim(-0.04, 1.04)
            _mark_levels(axes, levels, scale)
            quiet_grid(axes)
        panels[0].set_ylabel("share of comparisons chosen" if fits[0].is_choice else "share of successes")
    return figure


@contextmanager
def _panels(number: int, *, sharey: bool = False) -> Iterator[tuple[Figure, list[Axes]]]:
    """Yield a figure with panels in rows; unused panels are hidden."""
    columns = min(number, PANELS_PER_ROW)
    rows = math.ceil(number / columns)
    with house_style(max(2.5 * columns + 0.3, 4.6), 2.8 * rows, rows, columns, sharey=sharey) as (figure, panels):
        every = list(panels.flat)
        for axes in every[number:]:
            axes.set_axis_off()
        yield figure, every[:number]


def _mark_levels(axes: Axes, levels: Sequence[float], scale: LevelScale) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(levels))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_locator(NullLocator())
    axes.tick_params(axis="x", labelrotation=90 if len(levels) > 5 else 0)
    axes.set(xlim=(levels[0] / 1.1, levels[-1] * 1.1), xlabel=scale.quantity)
