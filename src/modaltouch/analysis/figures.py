"""The figures of the answers: bars as in Fig. 10 and Fig. 11, an overview, and participants one by one."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from modaltouch.analysis.counts import AnswerCounts, Pair
from modaltouch.analysis.intervals import clopper_pearson, korn_graubard
from modaltouch.analysis.scale import scale_of
from modaltouch.report import FAINT, INK, PAIR_COLOURS, house_style, quiet_grid

ANSWER_COLOURS = {"dominant": "#0b3c8c", "both": "#c9ced6", "other": "#d1603d"}


def pair_colours(labels: Sequence[str]) -> dict[str, str]:
    """Return a colour for each zone pair, in order."""
    return {label: PAIR_COLOURS[i % len(PAIR_COLOURS)] for i, label in enumerate(labels)}


FINGERS = {
    "one_hand": "index and middle finger of one hand",
    "two_hands": "index fingers of both hands",
}
PAIRS_PER_ROW = 3
LEVEL_SIZE, ANSWER_SIZE, LONG_ANSWER_SIZE = 6.2, 9.5, 7.5
"""Sizes of type below the bars: levels, answers, and answers that are too long for one line [points]."""
MOST_LINES = 3
"""Lines of an answer's name below its bars, if fewer pairs in a row can help."""
BAR_WIDTH, ANSWER_GAP, PAIR_GAP = 1.0, 1.1, 2.2
"""A bar, and what lies between the bars of two answers and of two pairs, on the horizontal axis [1]."""
ROW_WIDTH = 6.9
"""Width of a row of bars [inch]."""
TITLE_SIZE, LEGEND_SIZE = 9, 8
"""Sizes of type of a title and a legend [points]."""
LEGEND_MARGIN = 0.45
"""What a column of a legend needs beside its words [inch]."""
LETTER = 0.6 / 72
"""Mean width of a letter over the size of its type [inch/point]."""

OTHER_COLOURS = (*PAIR_COLOURS[1:5], "#f0b3cf", PAIR_COLOURS[0], "#d1603d")
"""Colours of answers that name no zone; the last two are left to zones where there are any."""
MARKERS = ("o", "s", "^", "D", "v", "P")
LINES = ("-", "--", "-.", ":")
_DARK = frozenset({PAIR_COLOURS[0], "#9a5b9f", "#d1603d"})
"""Colours on which letters are white."""
ZONE_COLOURS = (ANSWER_COLOURS["dominant"], ANSWER_COLOURS["both"], ANSWER_COLOURS["other"])
TIED, NOTHING = "white", FAINT
"""Colours of cells where repetitions tie, and where nothing was felt."""
STRIP_PARTICIPANTS = 40
"""Participants that one figure of strips can show."""

_TIE = "tie between repetitions (?)"

LETTER_PARTICIPANTS = 24
"""Participants up to whom every answer also carries its letter."""


def draw_counts(table: pd.DataFrame, finger_condition: str, n_participants: int | None = None) -> Figure:
    """Return the answers of one finger condition as bars, in the form of Fig. 10 and Fig. 11.

    Parameters
    ----------
    table : DataFrame
        As `zone_table` returns it: index (pair, answer), one column for each level.
    finger_condition : str
        Named in the title.
    n_participants : int, optional
        With several answers of each participant in a cell: intervals as if each had given one, the most cautious
        reading. By default every answer is another participant's.

    Returns
    -------
    Figure
        Bars with exact 95 % intervals (Clopper-Pearson); the labels say pair, answer and level, so nothing
        hangs on colour alone.
    """
    pairs = list(dict.fromkeys(table.index.get_level_values("pair")))
    colours = pair_colours(pairs)
    names = _lay_out_names(table)
    rows = [pairs[i : i + names.n_pairs] for i in range(0, len(pairs), names.n_pairs)]
    totals = {pair: table.loc[pair].sum() for pair in pairs}
    most = int(max(total.max() for total in totals.values()))
    with house_style():
        figure = Figure(figsize=(7.6, 0.5 + 2.9 * len(rows)))
        panels = figure.subplots(len(rows), 1, squeeze=False)[:, 0]
        for axes, row in zip(panels, rows, strict=True):
            _draw_row(axes, table, row, colours, totals, n_participants, names)
            axes.set_ylim(0, most * 1.02)
            axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True, steps=[1, 2, 5, 10]))
            axes.set_ylabel(f"answers out of {most}")
            quiet_grid(axes)
        panels[-1].set_xlabel(f"answer, and below each bar the {scale_of([str(table.columns.name)]).quantity}")
        title = f"{finger_condition}: {FINGERS[finger_condition]}" if finger_condition in FINGERS else finger_condition
        figure.suptitle(title, fontsize=10.5)
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
    levels = [float(level) for level in table.columns]
    width, gap, apart = BAR_WIDTH, ANSWER_GAP, PAIR_GAP
    left = 0.0
    for pair in pairs:
        start = left
        for answer, counts in table.loc[pair].iterrows():
            places = left + np.arange(len(levels)) * width
            _draw_group(axes, places, counts.to_numpy(), totals[pair].to_numpy(), colours[pair], n)
            for place, level in zip(places, levels, strict=True):
                axes.text(
                    place, -0.015, format(level, "g"), rotation=90, ha="center", va="top", fontsize=LEVEL_SIZE,
                    color=FAINT, transform=axes.get_xaxis_transform(),
                )  # fmt: skip
            axes.text(
                float(places.mean()), -0.125, names.written(str(answer)), ha="center", va="top", fontsize=names.size,
                transform=axes.get_xaxis_transform(),
            )  # fmt: skip
            left = float(places[-1]) + width + gap
        middle = (start + left - width - gap) / 2
        axes.text(
            middle, 1.02, f"({pair.replace('-', ', ')})", ha="center", fontsize=9,
            transform=axes.get_xaxis_transform(),
        )  # fmt: skip
        left += apart - gap
    axes.set_xlim(-width, left - apart)
    axes.set_xticks([])
    axes.xaxis.labelpad = 34 + 1.2 * names.size * (names.n_lines - 1)


@dataclass(frozen=True)
class _Names:
    """How the names of the answers are written below the bars.

    Attributes
    ----------
    n_pairs : int
        Zone pairs in a row.
    n_letters : int
        Letters in a line.
    size : float
        Size of type [points].
    n_lines : int
        Lines of the longest name.
    """

    n_pairs: int
    n_letters: int
    size: float
    n_lines: int = 1

    def written(self, name: str) -> str:
        """Return a name in lines, cut behind an underscore or hyphen where there is one."""
        if len(name) <= self.n_letters:
            return name
        lines = textwrap.wrap(name.replace("_", "_ "), self.n_letters)
        return "\n".join(line.replace("_ ", "_") for line in lines)


def _lay_out_names(table: pd.DataFrame) -> _Names:
    """Return names in one line if they fit, else in several, with as many pairs in a row as leave room for them."""
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


def _draw_group(
    axes: Axes, places: NDArray[Any], counts: NDArray[Any], totals: NDArray[Any], colour: str, n: int | None
) -> None:
    axes.bar(places, counts, width=0.82, color=colour, edgecolor=INK, linewidth=0.5)
    trials = np.full(totals.shape, n) if n else totals
    interval = clopper_pearson(counts * trials / totals, trials)
    spread = np.maximum([counts - totals * interval.low, totals * interval.high - counts], 0)
    # A white line under the dark one keeps the interval visible within a dark bar.
    for colour, width in (("white", 2.2), (INK, 0.8)):
        axes.errorbar(
            places,
            counts,
            yerr=spread,
            fmt="none",
            ecolor=colour,
            elinewidth=width,
            capsize=1.8,
            capthick=width,
        )


def draw_overview(answers: AnswerCounts) -> Figure:
    """Return the share of every answer but the last over level, a panel for each pair and finger condition."""
    width = min(2.4 * len(answers.pairs) + 0.6, 12)
    height = 0.9 + 2.1 * len(answers.finger_conditions)
    with house_style():
        figure = Figure(figsize=(width, height))
        shape = len(answers.finger_conditions), len(answers.pairs)
        grid = figure.subplots(*shape, sharex=True, sharey=True, squeeze=False)
        for f, q, _ in answers.pair_cells:
            _draw_answers(grid[f][q], answers, f, q)
        for panels, condition in zip(grid, answers.finger_conditions, strict=True):
            panels[0].set_ylabel(f"share of answers\n{condition}")
        middle = grid[-1][(len(answers.pairs) - 1) // 2]
        middle.set_xlabel(answers.scale.quantity, x=0.5 if len(answers.pairs) % 2 else 1.04)
        handles, labels = grid[0][0].get_legend_handles_labels()
        n_columns = _columns(labels, width, 4)
        # Panels keep their height, however many lines the legend has.
        figure.set_figheight(height + 0.17 * max(-(-len(labels) // n_columns) - 2, 0))
        figure.legend(handles, labels, loc="outside lower center", ncols=n_columns, frameon=False)
        figure.suptitle(_fitted(f"Share of answers (95 % intervals), {_sample(answers)}", width), fontsize=TITLE_SIZE)
    return figure


def _draw_answers(axes: Axes, answers: AnswerCounts, f: int, q: int) -> None:
    """Draw the share of each answer of a pair in one finger condition, with a colour, marker and line of its own."""
    pair = answers.pairs[q]
    effects, zones = answers.effects(pair), f"({pair.left}, {pair.right})"
    for i, (label, place) in enumerate(effects):
        name = "dominant zone" if answers.compares and i == 0 else label
        chosen = answers.counts[:, f, q, :, place]
        share = korn_graubard(chosen.T, answers.n_repetitions)
        axes.errorbar(
            np.arange(len(answers.levels), dtype=float) + 0.09 * (i - (len(effects) - 1) / 2),
            share.estimate,
            yerr=np.maximum([share.estimate - share.low, share.high - share.estimate], 0),
            color=OTHER_COLOURS[i % len(OTHER_COLOURS)], marker=MARKERS[i % 6], linestyle=LINES[i % 4], label=name,
            markersize=4.5, markeredgecolor=INK, markeredgewidth=0.4, linewidth=1.0, elinewidth=0.8, capsize=2,
        )  # fmt: skip
    axes.set_title(f"{pair.dominant} of {zones}" if answers.compares else zones)
    axes.set_xticks(range(len(answers.levels)), [format(level, "g") for level in answers.levels])
    axes.set_ylim(-0.03, 1.03)
    quiet_grid(axes)


def _columns(labels: Sequence[str], width: float, most: int) -> int:
    """Return in how many columns a legend of some labels fits into a figure [inch], `most` at most."""
    for n_columns in range(min(len(labels), most), 1, -1):
        longest = [max(map(len, column)) for column in np.array_split(np.array(labels, dtype=object), n_columns)]
        if sum(longest) * LEGEND_SIZE * LETTER + LEGEND_MARGIN * len(longest) <= width:
            return n_columns
    return 1


def _fitted(title: str, width: float) -> str:
    """Return a title in as many lines as a figure [inch] needs."""
    return textwrap.fill(title, int(width / (TITLE_SIZE * LETTER)))


def draw_participants(answers: AnswerCounts) -> Figure:
    """Return one strip for each participant: every cell's answer, by colour and letter.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers; the first `STRIP_PARTICIPANTS` participants are drawn.
    """
    shown = answers.participants[:STRIP_PARTICIPANTS]
    n_columns = len(answers.pairs) * len(answers.levels)
    modal = answers.modal()[: len(shown)]
    with house_style():
        size = 0.22
        width = 1.0 + size * n_columns * len(answers.finger_conditions) + 0.3 * len(answers.finger_conditions)
        figure = Figure(figsize=(max(width, 5.0), 1.7 + size * len(shown)))
        panels = figure.subplots(1, len(answers.finger_conditions), sharey=True, squeeze=False)[0]
        for f, (axes, condition) in enumerate(zip(panels, answers.finger_conditions, strict=True)):
            _draw_strip(axes, answers, modal[:, f], shown)
            axes.set_title(condition, pad=14)
        panels[0].set_yticks(range(len(shown)), list(shown))
        panels[0].set_ylabel("participant")
        more = "" if len(shown) == answers.n_participants else f", first {len(shown)} of {answers.n_participants} shown"
        names = {kind.name: kind.colour for kind in _kinds(answers, answers.pairs[0])}
        if not (modal < 0).any():
            del names[_TIE]
        patches = [Patch(facecolor=colour, edgecolor=INK, linewidth=0.5, label=name) for name, colour in names.items()]
        width = float(figure.get_figwidth())
        n_columns = _columns(list(names), width, len(names) if width > 1.4 * len(names) else 3)
        figure.legend(handles=patches, loc="outside lower center", ncols=n_columns, frameon=False)
        figure.suptitle(_fitted(f"Every participant's answer in every cell{more}", width), fontsize=TITLE_SIZE)
        panels[(len(panels) - 1) // 2].set_xlabel(answers.scale.quantity, x=0.5 if len(panels) % 2 else 1.04)
    return figure


@dataclass(frozen=True)
class _Kind:
    """What a cell of a strip can hold: an answer, or a tie; with its letter, colour and ink."""

    place: int
    name: str
    letter: str
    colour: str
    ink: str = INK


def _kinds(answers: AnswerCounts, pair: Pair) -> list[_Kind]:
    """Return what the cells of a pair can hold, in the order of the legend."""
    tie = _Kind(-1, _TIE, "?", TIED)
    nothing = [_Kind(p, f"{a.name} (–)", "–", NOTHING) for p, a in enumerate(answers.answers) if a.says_nothing_felt]
    kinds = []
    if answers.compares:
        dominant, both, other = ZONE_COLOURS
        kinds = [_Kind(answers.dominant_place(pair), "dominant zone", pair.dominant, dominant, "white")]
        both_place = answers.both_place
        if both_place is not None:
            kinds.append(_Kind(both_place, f"{answers.answers[both_place].name} (&)", "&", both))
        kinds += [_Kind(answers.other_place(pair), "other zone", pair.other, other, "white")]
    rest = {p: answers.answers[p].name for p in answers.felt if p not in {kind.place for kind in kinds}}
    # Two letters tell them apart, or else their places.
    is_clear = len({name[:2] for name in rest.values()}) == len(rest)
    for (place, name), colour in zip(rest.items(), OTHER_COLOURS, strict=False):
        letter, ink = name[:2] if is_clear else str(place + 1), "white" if colour in _DARK else INK
        kinds.append(_Kind(place, f"{name} ({letter})", letter, colour, ink))
    return [*kinds, tie, *nothing]


def _draw_strip(axes: Axes, answers: AnswerCounts, modal: NDArray[np.int64], shown: Sequence[str]) -> None:
    n_levels = len(answers.levels)
    picture = np.zeros((len(shown), len(answers.pairs) * n_levels), dtype=np.int64)
    for q, pair in enumerate(answers.pairs):
        kinds = _kinds(answers, pair)
        place_of = {kind.place: place for place, kind in enumerate(kinds)}
        kind = np.vectorize(place_of.__getitem__)(modal[:, q])
        picture[:, q * n_levels : (q + 1) * n_levels] = kind
        for (row, column), value in np.ndenumerate(kind) if len(shown) <= LETTER_PARTICIPANTS else ():
            axes.text(
                q * n_levels + column, row, kinds[value].letter[:2], ha="center", va="center", fontsize=6,
                color=kinds[value].ink,
            )  # fmt: skip
        if q:
            axes.axvline(q * n_levels - 0.5, color=INK, linewidth=1.2)
        axes.text(
            (q + 0.5) * n_levels - 0.5, 1.0, pair.label, ha="center", va="bottom", fontsize=7, color=FAINT,
            transform=axes.get_xaxis_transform(),
        )  # fmt: skip
    colours = ListedColormap([kind.colour for kind in kinds])
    axes.imshow(picture, cmap=colours, vmin=0, vmax=len(kinds) - 1, aspect="equal", interpolation="nearest")
    axes.set_xticks(
        range(picture.shape[1]),
        [format(level, "g") for level in answers.levels] * len(answers.pairs),
        rotation=90,
    )
    axes.tick_params(length=0, labelsize=6.5)
    for edge in ("left", "bottom"):
        axes.spines[edge].set_visible(False)


def _sample(answers: AnswerCounts) -> str:
    times = "" if answers.n_repetitions == 1 else f", {answers.n_repetitions} answers a cell"
    return f"N = {answers.n_participants}{times}"
