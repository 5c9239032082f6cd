"""Counts as tables: per cell, and in the form of Fig. 10 and Fig. 11."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from modaltouch.analysis.counts import NONE, PAPER_CONDITIONS, WORDS, AnswerCounts, count_answers, find_focus, orient
from modaltouch.analysis.responses import CELL
from modaltouch.analysis.scale import scale_of


def count_responses(frame: pd.DataFrame, focus: str = "") -> pd.DataFrame:
    """Return the counts of every cell.

    Parameters
    ----------
    frame : DataFrame
        Tidy answers.
    focus : str
        Zone of the focus; guessed if empty.

    Returns
    -------
    DataFrame
        Columns finger_condition, pair, zone_left, zone_right, velocity_mm_s (or multiple_of_threshold), left, both,
        right, none (where that is an answer), n; one row for each cell.
    """
    return tabulate(count_answers(frame, focus))


def tabulate(answers: AnswerCounts) -> pd.DataFrame:
    """Return the counts of every cell, summed over participants, as `count_responses` does."""
    sums = answers.counts.sum(axis=0)
    rows = [
        (condition, pair.label, pair.left, pair.right, level, *sums[f, q, v].tolist(), int(sums[f, q, v].sum()))
        for f, condition in enumerate(answers.finger_conditions)
        for q, pair in enumerate(answers.pairs)
        for v, level in enumerate(answers.levels)
    ]
    words = WORDS[: answers.counts.shape[-1]]
    level = answers.scale.column
    return pd.DataFrame(rows, columns=["finger_condition", "pair", *CELL[1:3], level, *words, "n"])


def zone_table(counts: pd.DataFrame, finger_condition: str, focus: str = "") -> pd.DataFrame:
    """Return the counts of one finger condition by zone, in the form of Fig. 10 and Fig. 11.

    Parameters
    ----------
    counts : DataFrame
        As `count_responses` returns them.
    finger_condition : str
        Which finger condition.
    focus : str
        Zone of the focus; guessed if empty.

    Returns
    -------
    DataFrame
        Index (pair, answer), answers as in the paper: ``C``, ``A``, ``C & A`` and so on, then ``none`` where that is
        an answer; one column for each level, holding how many answers out of the cell's n.

    Raises
    ------
    ValueError
        If there is no such finger condition.
    """
    own = counts[counts["finger_condition"] == finger_condition]
    if own.empty:
        known = ", ".join(counts["finger_condition"].unique())
        raise ValueError(f"finger condition {finger_condition!r} is not in the counts; there are {known}")
    zones = list(dict.fromkeys(zip(own["zone_left"], own["zone_right"], strict=True)))
    focus = focus or find_focus(zones)
    none = (("none", NONE),) if "none" in own.columns else ()
    rows, level = {}, scale_of(counts.columns).column
    for left, right in zones:
        pair = orient(str(left), str(right), focus)
        cells = own[(own["zone_left"] == left) & (own["zone_right"] == right)].set_index(level)
        for label, place in (*pair.answers, *none):
            rows[pair.label, label] = cells[WORDS[place]].sort_index()
    table = pd.DataFrame(rows).T.astype(int)
    table.index.names = ["pair", "answer"]
    table.columns.name = level
    return table


def figure_names(finger_conditions: Sequence[str]) -> dict[str, str]:
    """Return the file name, without ending, of the figure of each finger condition.

    Parameters
    ----------
    finger_conditions : sequence of str
        The paper's two get its figure numbers, any other a name of its own.

    Examples
    --------
    >>> figure_names(["one_hand", "two_hands", "gloved hand"])
    {'one_hand': 'fig_10', 'two_hands': 'fig_11', 'gloved hand': 'fig_gloved_hand'}
    """
    names = dict(zip(PAPER_CONDITIONS, ("fig_10", "fig_11"), strict=True))
    for condition in finger_conditions:
        word = "".join(c if c.isascii() and c.isalnum() else "_" for c in condition)[:60]
        taken = {name.casefold() for name in names.values()}
        candidates = [f"fig_{word}", *(f"fig_{word}_{i}" for i in range(2, len(names) + 3))]
        names.setdefault(condition, next(name for name in candidates if name.casefold() not in taken))
    return {condition: names[condition] for condition in finger_conditions}
