"""Files for mixed models, as often requested by reviewers: a tidy table, and an R script that fits the models.

Models of zones require answers that name each finger alone; tidy models accept any answers, and ratings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import pandas as pd

from modaltouch.analysis.columns import label_zones, scale_of
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.report import render_page

if TYPE_CHECKING:
    from modaltouch.analysis.ratings import Question
    from modaltouch.analysis.responses import Responses


def model_table(answers: AnswerCounts, frame: pd.DataFrame, asked: Sequence[Question] = ()) -> pd.DataFrame:
    """Return one row per answer with participant, condition, level, the zone named, if any, and ratings.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers, with answers that name each finger alone.
    frame : DataFrame
        Tidy answers.
    asked : sequence of Question
        Rating questions.
    """
    rows = frame.loc[frame.index.repeat(frame["n"])]
    pair = rows["zone_left"].astype(str) + "-" + rows["zone_right"].astype(str)
    zones = {
        (each.label, answers.answers[place].name): zone
        for each in answers.pairs
        for zone, place in (
            ("dominant", answers.dominant_place(each)),
            ("both", answers.both_place),
            ("other", answers.other_place(each)),
        )
        if place is not None
    }
    chosen = [zones.get(key, "") for key in zip(pair, rows["response"].astype(str), strict=True)]
    middle, scale = (min(answers.levels) + max(answers.levels)) / 2, answers.scale
    table = pd.DataFrame({
        "participant": rows["participant"].astype(str),
        "finger_condition": rows["finger_condition"].astype(str),
        "pair": pair,
        scale.column: rows[scale.column],
        "level": (rows[scale.column] - middle) / scale.step,
        "response": rows["response"].astype(str),
        "zone": chosen,
        **{each.column: each.told(rows) for each in asked},
    })  # fmt: skip
    return table.assign(dominant=(table["zone"] == "dominant").astype("Int64").where(table["zone"] != ""))


def terms_of_model(answers: AnswerCounts) -> list[str]:
    """Return the varying columns of the table, as terms of a model formula."""
    several = {"pair": answers.pairs, "finger_condition": answers.finger_conditions, "level": answers.levels}
    return [name for name, values in several.items() if len(values) > 1]


def model_files(answers: AnswerCounts, responses: Responses) -> dict[str, Any]:
    """Return the tidy table and the R script of the models, by file name."""
    asked: Sequence[Question] = ()
    if responses.has_individual_results:
        from modaltouch.analysis.ratings import questions_of

        asked = questions_of(responses.design, responses.frame)
    table, terms = model_table(answers, responses.frame, asked), terms_of_model(answers)
    if responses.groups:
        table.insert(1, "group", table["participant"].map(responses.groups))
        terms.append("group")
    return zone_files(table, terms, answers, asked)


def zone_files(
    table: pd.DataFrame, terms: Sequence[str], answers: AnswerCounts, asked: Sequence[Question]
) -> dict[str, Any]:
    """Return a table of the chosen zones and the R script of its models, by file name."""
    zones = [zone for zone in ("other", "both", "dominant") if zone != "both" or answers.both_place is not None]
    return script_files(table, "models.R.j2", terms, zones=zones, asked=asked, scale=answers.scale)


def script_files(table: pd.DataFrame, template: str, terms: Sequence[str], **given: Any) -> dict[str, Any]:
    """Return a tidy table and an R script to fit models with these terms, by file name."""
    script = render_page("modaltouch.analysis", template, terms=" + ".join(terms) or "1", **given)
    return {"answers.csv": table.to_csv(index=False, lineterminator="\n"), "models.R": script}


FACTORS = ("group", "session_kind", "stimulus", "finger_condition", "pair")


def tidy_files(responses: Responses) -> dict[str, Any]:
    """Return the tidy table and the R script of its models, by file name.

    Parameters
    ----------
    responses : Responses
        The answers as given.
    """
    from modaltouch.analysis.ratings import questions_of

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
        table[each.column] = each.told(frame)
    names, effect = taken.answers.names, taken.answers.names[0]
    if len(names) > 1:
        table["chosen"] = (table["response"] == effect).astype(int)
    terms = [name for name in (*factors, "level") if table[name].nunique() > 1]
    return script_files(table, "tidy_models.R.j2", terms, effect=effect, names=names, asked=asked, scale=scale)
