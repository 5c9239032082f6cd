"""Bar charts of the answers, as in Fig. 10 and Fig. 11 of the paper, and the velocity fields of the stimulus."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from modaltouch.analysis.columns import scale_of
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.crossed import figure_names, zone_table
from modaltouch.analysis.intervals import clopper_pearson
from modaltouch.analysis.preregistration import name_part
from modaltouch.report import CONDITION_COLOURS, FAINT, INK, PAIR_COLOURS, ReportFigure, house_style, quiet_grid

FINGERS = {"one_hand": "index and middle finger of one hand", "two_hands": "index fingers of both hands"}
PAIRS_PER_ROW = 3
LEVEL_SIZE, ANSWER_SIZE, LONG_ANSWER_SIZE = 6.2, 9.5, 7.5
"""Font sizes below the bars [points]: levels, answers, and answers too long for one line."""
MOST_LINES = 3
"""Maximum number of lines of an answer's name; for longer names, a row has fewer pairs."""
BAR_WIDTH, ANSWER_GAP, PAIR_GAP = 1.0, 1.1, 2.2
"""Bar width, and gaps between answers and between pairs, in units of the horizontal axis [1]."""
ROW_WIDTH = 6.9
"""Width of a row of bars [inch]."""
LETTER = 0.6 / 72
"""Mean width of a letter relative to its font size [inch/point]."""


INTERVALS = "Error bars: exact 95 % intervals (Clopper-Pearson) over participants."
OF_SEVERAL = "Error bars: Clopper and Pearson's 95 % intervals, as if each participant had given one answer."


def draw_bars(answers: AnswerCounts, part: str = "", number: int = 0) -> list[ReportFigure]:
    """Draw Fig. 10 and Fig. 11, or the like for other finger conditions, or for a numbered part of a design."""
    pictures, n = [], answers.n_participants
    for condition, name in figure_names(answers.finger_conditions if len(answers.answers) > 1 else ()).items():
        figure = draw_counts(zone_table(answers, condition), condition, n if answers.n_repetitions > 1 else None, part)
        papers = {"fig_10": "Fig. 10. ", "fig_11": "Fig. 11. "} if answers.is_paper_design and not number else {}
        several = f", {answers.n_repetitions} answers each" if answers.n_repetitions > 1 else ""
        whose = name_part(replace(answers, finger_conditions=(condition,)), part) if number else condition
        whose = f"{whose.replace('_', ' ')}, {n} participant{'s' * (n != 1)}"
        caption = f"{papers.get(name, '')}Answers: {whose}{several}. {OF_SEVERAL if several else INTERVALS}"
        file = f"part_{number}_{condition}" if number else name
        pictures.append(ReportFigure(file, figure, caption, "answers", condition))
    return pictures


def draw_counts(
    table: pd.DataFrame, finger_condition: str, n_participants: int | None = None, part: str = ""
) -> Figure:
    """Draw the answers of one finger condition as bars, in the form of Fig. 10 and Fig. 11.

    Parameters
    ----------
    table : DataFrame
        As returned by `zone_table`: index (pair, answer), one column per level.
    finger_condition : str
        Finger condition, for the title.
    n_participants : int, optional
        Number of participants, if each gave several answers in a cell. Intervals are then conservative, as for one
        answer per participant. By default, every answer is taken to be from a different participant.
    part : str, optional
        Stimulus, group or kind of session of the answers, for the title.

    Returns
    -------
    Figure
        Bars with exact 95 % intervals (Clopper-Pearson), labelled by pair, answer and level, so that nothing depends on
        colour alone.
    """
    pairs = list(dict.fromkeys(table.index.get_level_values("pair")))
    colours = {pair: PAIR_COLOURS[i % len(PAIR_COLOURS)] for i, pair in enumerate(pairs)}
    names = _lay_out_names(table)
    rows = [pairs[i : i + names.n_pairs] for i in range(0, len(pairs), names.n_pairs)]
    totals = {pair: table.loc[pair].sum() for pair in pairs}
    most = int(max(total.max() for total in totals.values()))
    with house_style(7.6, 0.5 + 2.9 * len(rows), len(rows)) as (figure, panels):
        for axes, row in zip(panels[:, 0], rows, strict=True):
            _draw_row(axes, table, row, colours, totals, n_participants, names)
            axes.set(ylim=(0, most * 1.02), ylabel=f"answers out of {most}")
            axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True, steps=[1, 2, 5, 10]))
            quiet_grid(axes)
        panels[-1, 0].set_xlabel(f"answer, and below each bar the {scale_of([str(table.columns.name)]).quantity}")
        named = finger_condition.replace("_", " ")
        title = f"{named}: {FINGERS[finger_condition]}" if finger_condition in FINGERS else named
        figure.suptitle(", ".join(filter(None, (part, title))), fontsize=10.5)
    return figure


def _draw_row(
    axes: Axes,
    table: pd.DataFrame,
    pairs: Sequence[str],
    colours: dict[str, str],
    totals: dict[str, pd.Series],
    n: int | None,
    names: _Names,
) -> None:
    below = axes.get_xaxis_transform()
    levels = [format(float(level), "g") for level in table.columns]
    places: list[NDArray[Any]] = []
    left = 0.0
    for pair in pairs:
        start = left
        for answer in table.loc[pair].index:
            group = left + np.arange(len(levels)) * BAR_WIDTH
            middle = float(group.mean())
            axes.text(
                middle, -0.125, names.written(str(answer)), ha="center", va="top", size=names.size, transform=below
            )
            left = float(group[-1]) + BAR_WIDTH + ANSWER_GAP
            places.append(group)
        middle = (start + left - BAR_WIDTH - ANSWER_GAP) / 2
        axes.text(middle, 1.02, f"({pair.replace('-', ', ')})", ha="center", size=9, transform=below)
        left += PAIR_GAP - ANSWER_GAP
    along = np.concatenate(places)
    style: dict[str, Any] = {"rotation": 90, "ha": "center", "va": "top", "fontsize": LEVEL_SIZE, "color": FAINT}
    for place, level in zip(along, levels * len(places), strict=True):
        axes.text(place, -0.015, level, transform=below, **style)
    own = table.loc[list(pairs)]
    counts = own.to_numpy().ravel()
    given = [pair for pair, _ in own.index]
    of_bars = np.repeat([colours[pair] for pair in given], len(levels)).tolist()
    _draw_bars(axes, along, counts, np.concatenate([totals[pair].to_numpy() for pair in given]), of_bars, n)
    axes.set(xlim=(-BAR_WIDTH, left - PAIR_GAP), xticks=[])
    axes.xaxis.labelpad = 34 + 1.2 * names.size * (names.n_lines - 1)


@dataclass(frozen=True)
class _Names:
    """Layout of the answers' names below the bars.

    Attributes
    ----------
    n_pairs : int
        Zone pairs per row.
    n_letters : int
        Letters per line.
    size : float
        Font size [points].
    n_lines : int
        Number of lines of the longest name.
    """

    n_pairs: int
    n_letters: int
    size: float
    n_lines: int = 1

    def written(self, name: str) -> str:
        """Wrap a name, preferably after an underscore or hyphen."""
        if len(name) <= self.n_letters:
            return name
        lines = textwrap.wrap(name.replace("_", "_ "), self.n_letters)
        return "\n".join(line.replace("_ ", "_") for line in lines)


def _lay_out_names(table: pd.DataFrame) -> _Names:
    """Choose the layout: names on one line if they fit, else wrapped, with as many pairs per row as fit."""
    labels = [str(answer) for _, answer in table.index]
    n_all, n_levels = len({pair for pair, _ in table.index}), len(table.columns)
    n_answers = len(labels) // n_all
    longest_part = max(len(part) for label in labels for part in re.split(r"(?<=[_-])| ", label))
    for n_pairs in range(min(PAIRS_PER_ROW, n_all), 0, -1):
        group = n_levels * BAR_WIDTH + ANSWER_GAP
        unit = ROW_WIDTH / (n_pairs * (n_answers * group + PAIR_GAP - ANSWER_GAP))
        names = _Names(n_pairs, int(group * unit / (ANSWER_SIZE * LETTER)), ANSWER_SIZE)
        if max(map(len, labels)) > names.n_letters:
            names = _Names(n_pairs, max(int(group * unit / (LONG_ANSWER_SIZE * LETTER)), 4), LONG_ANSWER_SIZE)
            names = replace(names, n_lines=max(names.written(label).count("\n") + 1 for label in labels))
        fits = names.n_lines <= MOST_LINES and names.n_letters >= longest_part
        if fits and BAR_WIDTH * unit * 72 >= LEVEL_SIZE:
            break
    return names


def _draw_bars(
    axes: Axes, places: NDArray[Any], counts: NDArray[Any], totals: NDArray[Any], colours: list[str], n: int | None
) -> None:
    axes.bar(places, counts, width=0.82, color=colours, edgecolor=INK, linewidth=0.5)
    trials = np.minimum(totals, n) if n else totals  # with missing answers, totals may be below n
    interval = clopper_pearson(counts * trials / np.maximum(totals, 1), trials)
    # A white outline keeps the interval visible on a dark bar.
    for colour, width in (("white", 2.6), (INK, 1.1)):
        axes.vlines(places, totals * interval.low, totals * interval.high, colors=colour, linewidth=width)


FIELDS = (
    "Left: the target velocity field along the beam, and the field predicted at the focusing instant from the codes "
    "that were played, on the identified modes. Right: predicted peak speed over time at the centre of each zone."
)
"""Caption of the figure of the velocity fields."""


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
        None if the record contains no field, as those of version 0.2.0.
    """
    fields = _of(stimulus, start.get("stimulus", {}).get("fields", []))
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
