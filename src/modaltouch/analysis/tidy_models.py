"""Answers that name no finger alone, and ratings: the tidy table, and an R script that fits mixed models to it."""

from __future__ import annotations

from typing import Any

import pandas as pd

from modaltouch.analysis.models import script_files
from modaltouch.analysis.ratings import questions_of
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.scale import scale_of
from modaltouch.analysis.zones import label_zones

FACTORS = ("group", "session_kind", "stimulus", "finger_condition", "pair")


def tidy_files(responses: Responses) -> dict[str, Any]:
    """Return the tidy table and the R script of its models, by file name.

    Parameters
    ----------
    responses : Responses
        The answers, as they were given.
    """
    taken = responses.by_choice()
    frame = taken.frame.loc[taken.frame.index.repeat(taken.frame["n"])]
    scale, asked = scale_of(frame.columns), questions_of(responses.design, frame)
    level = frame[scale.column].astype(float)
    named = [name for name in FACTORS if name in frame.columns and (frame[name] != "").any()]
    factors = {name: frame[name].astype(str) for name in named}
    factors["pair"] = label_zones(frame)
    table = pd.DataFrame({
        "participant": frame["participant"].astype(str), **factors, scale.column: level,
        "level": (level - (level.min() + level.max()) / 2) / scale.step,
        "response": frame["response"].astype(str),
    })  # fmt: skip
    if "interval" in frame.columns:
        table["interval"] = frame["interval"].astype(int)
    for each in asked:
        table[each.column] = each.numbers(frame)
    names, effect = taken.answers.names, taken.answers.names[0]
    if len(names) > 1:
        table["chosen"] = (table["response"] == effect).astype(int)
    terms = [name for name in (*factors, "level") if table[name].nunique() > 1]
    return script_files(table, "tidy_models.R.j2", terms, effect=effect, names=names, asked=asked, scale=scale)
