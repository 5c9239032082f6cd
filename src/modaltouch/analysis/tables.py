"""Tables of counts: by cell, and in the form of Fig. 10 and Fig. 11."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from modaltouch.analysis.counts import PAPER_CONDITIONS, AnswerCounts
from modaltouch.analysis.responses import CELL

PAPER_TEXT: dict[str, dict[tuple[str, str], str]] = {
    "one_hand": {
        ("A-C", "C"): "10, 10, 9, 10",
        ("A-C", "A"): "0, 0, 0, 0",
        ("A-C", "C & A"): "0, 0, 1, 0",
        ("B-D", "B"): "some",
        ("B-D", "D"): "one",
        ("B-D", "B & D"): "most",
        ("C-E", "C"): "9, 9, 10, 10",
        ("C-E", "E"): "0, 0, 0, 0",
        ("C-E", "C & E"): "1, 1, 0, 0",
    },
    "two_hands": {},
}
"""Answers of ten participants at 80, 100, 150 and 200 mm/s, from the text of section V of the paper, which gives no
numbers for two hands."""


def tabulate(answers: AnswerCounts) -> pd.DataFrame:
    """Return the counts by cell, summed over participants: factors, level, count of each answer, and their sum n."""
    sums = answers.counts.sum(axis=0)
    rows = [
        (condition, pair.label, pair.left, pair.right, level, *sums[f, q, v].tolist(), int(sums[f, q, v].sum()))
        for f, condition in enumerate(answers.finger_conditions)
        for q, pair in enumerate(answers.pairs)
        for v, level in enumerate(answers.levels)
    ]
    columns = ["finger_condition", "pair", *CELL[1:3], answers.scale.column, *answers.answers.names, "n"]
    return pd.DataFrame(rows, columns=columns)


def zone_table(answers: AnswerCounts, finger_condition: str) -> pd.DataFrame:
    """Return the counts of one finger condition by zone, in the form of Fig. 10 and Fig. 11.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    finger_condition : str
        Name of the finger condition.

    Returns
    -------
    DataFrame
        Index (pair, answer), with answers as in the paper: ``C``, ``A``, ``C & A`` and so on, then all others by name;
        one column of counts per level.

    Raises
    ------
    ValueError
        If there is no such finger condition.
    """
    if finger_condition not in answers.finger_conditions:
        known = ", ".join(answers.finger_conditions)
        raise ValueError(f"finger condition {finger_condition!r} is not in the counts; there are {known}")
    sums = answers.counts[:, answers.finger_conditions.index(finger_condition)].sum(axis=0)
    rows = {
        (pair.label, label): sums[q, :, place]
        for q, pair in enumerate(answers.pairs)
        for label, place in answers.labelled(pair)
    }
    index = pd.MultiIndex.from_tuples(rows, names=["pair", "answer"])
    columns = pd.Index(answers.levels, name=answers.scale.column)
    return pd.DataFrame(np.array(list(rows.values())), index=index, columns=columns)


def figure_names(finger_conditions: Sequence[str]) -> dict[str, str]:
    """Return the file name, without extension, of the figure of each finger condition.

    Parameters
    ----------
    finger_conditions : sequence of str
        Finger conditions; those of the paper have its figure numbers.

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
