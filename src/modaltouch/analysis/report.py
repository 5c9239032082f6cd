"""The report: one HTML file with the figures inside, which needs no network and prints well."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pandas as pd

from modaltouch.analysis.catches import catch_rows
from modaltouch.analysis.counts import AnswerCounts, Pair
from modaltouch.analysis.covariates import has_values
from modaltouch.analysis.findings import ALPHA, Finding
from modaltouch.analysis.intervals import tango
from modaltouch.analysis.outcome import Analysis
from modaltouch.analysis.responses import cell_of
from modaltouch.analysis.scale import OWN_THRESHOLD
from modaltouch.analysis.statistics import STATISTICS, questions
from modaltouch.analysis.strips import participant_strips
from modaltouch.analysis.tables import zone_table
from modaltouch.protocol import AnswerList
from modaltouch.report import ReportFigure, page_files, say_number

HEADINGS = {
    "a1": "Do the answers of a cell differ from guessing?",
    "a2": "Is one zone of each pair chosen more than the other?",
    "b": "Does the level matter?",
    "c": "Do the finger conditions differ?",
    "d": "Do the pairs of zones differ{in_both}?",
    "e": "Do the participants agree?",
    "f": "How large are the effects?",
    "catch": "Is something felt where nothing is driven?",
    "side": "Is there a side bias?",
    "order": "Do answers drift, or depend on what came first?",
    "time": "Do reaction times differ?",
    "speed": "Do the answers follow the speeds under the fingers?",
}
"""Questions of the analysis plan, then the further ones; other families of tests are headed by what they ask."""

MOST_TOLD = 12
"""Most findings of a kind that are told one by one in words."""


def _headings(answers: AnswerCounts) -> dict[str, str]:
    """Return the heading of each question, in the order of the report."""
    both = answers.answers.naming("left", "right") if answers.compares else None
    in_both = "" if both is None else f" in “{both.name}”"
    asked = {each.question: f"{each.asks[:1].upper()}{each.asks[1:]}?" for each in STATISTICS.values()}
    known = asked | {question: heading.format(in_both=in_both) for question, heading in HEADINGS.items()}
    return {question: known[question] for question in questions()}


def say_p(p: float) -> str:
    """Return a p value as it stands in a paper.

    Examples
    --------
    >>> say_p(0.0312), say_p(0.00004), say_p(1.0)
    ('= 0.031', '< 0.001', '= 1')
    """
    if math.isnan(p):
        return "not available"
    if p < 0.001:
        return "< 0.001"
    return f"= {p:.2g}" if p < 1 else "= 1"


def say_interval(finding: Finding) -> str:
    """Return an estimate with its interval, as in ``0.975 [0.798, 0.996]``."""
    bounds = ", ".join(say_number(value) for value in (finding.low, finding.high))
    return f"{say_number(finding.estimate)} [{bounds}]"


def _summarise(own: Sequence[Finding]) -> str:
    """Return what the tests of a question show, what they do not, and on what they hold no information."""
    own = [f for f in own if f.family] or own
    estimates = [f for f in own if math.isnan(f.p)]
    silent = [f for f in own if f.p_min > ALPHA]
    told = [f for f in own if f.p_min <= ALPHA]
    shown = [f for f in told if (f.p if math.isnan(f.p_holm) else f.p_holm) <= ALPHA]
    groups = {
        "Significant": shown,
        "Not significant": [f for f in told if f not in shown],
        f"No information, as no outcome could have given p ≤ {ALPHA:g}": silent,
        "Estimates": estimates,
    }
    return " ".join(f"{words}: {_list(group)}." for words, group in groups.items() if group)


def _list(findings: Sequence[Finding]) -> str:
    if len(findings) > MOST_TOLD:
        return f"{len(findings)}, in the tables below"
    told = [f"{f.scope}, {f.quantity} {say_interval(f)}" if f.quantity else f.scope for f in findings]
    return "; ".join(f"{words}{_verdict(finding)}" for words, finding in zip(told, findings, strict=True))


def _cautions(answers: AnswerCounts) -> dict[str, str]:
    """Return what a reader of a question's numbers should know, by question."""
    felt = [answers.answers[place].name for place in answers.felt]
    return {
        "a1": f"Cells are tested against an even split over {', '.join(felt[:-1])} and {felt[-1]}; "
        "an answer that nothing was felt is left out of this test, and counts in every share.",
        "b": "A lack of information is not evidence that the level does not matter."
        if len(answers.levels) > 1
        else "One level only: a trend needs two.",
        "c": "The conditions are alike only within the bounds of these intervals. A difference that is not significant "
        "does not show that the conditions are alike.",
        "e": "Gwet's AC1 is 1 where all agree; kappa is undefined there and is not used."
        if answers.n_participants > 1
        else "One participant alone: agreement between participants has no meaning.",
        "catch": "Catch trials are in no other table or test.",
        "time": "Bursts repeat at a fixed rate, so reaction times come in steps of one burst period.",
        "order": "The paper does not state the order of the two finger conditions.",
    }


def _verdict(finding: Finding) -> str:
    if math.isnan(finding.p) or finding.p_min > ALPHA:
        return ""
    corrected = "" if math.isnan(finding.p_holm) else f", Holm p {say_p(finding.p_holm)}"
    return f", p {say_p(finding.p)}{corrected}"


def report_files(analysis: Analysis, pictures: Sequence[ReportFigure], *, png: bool = False) -> dict[str, Any]:
    """Return the report and its figures, by file name."""
    from modaltouch.analysis.provenance import describe_record

    answers = analysis.answers
    felt = [answers.answers[place].name for place in answers.felt]
    return page_files(
        "modaltouch.analysis",
        "report",
        pictures,
        png=png,
        title=_title(analysis),
        source=analysis.responses.source,
        answers=answers,
        n_answers=int(answers.counts.sum()),
        levels=[format(level, "g") for level in answers.levels],
        tables={condition: _zone_rows(answers, condition) for condition in answers.finger_conditions},
        strips=participant_strips(answers),
        speeds=speed_rows(analysis.responses.frame),
        tests=list_questions(analysis.findings, answers),
        catches=catch_rows(answers, analysis.responses.catches),
        catch_words=[*(answer.name for answer in answers.answers if answer.says_nothing_felt), *felt]
        if answers.offers_none
        else ["none", *felt],
        # A table is read as the paper's answers where no protocol is named.
        is_named=answers.answers != AnswerList.of_words(("none",) if answers.offers_none else ()),
        limits=design_limits(analysis),
        left_out=analysis.responses.left_out,
        record=describe_record(analysis.responses.sessions),
        own_thresholds=answers.scale == OWN_THRESHOLD,
        alpha=ALPHA,
    )


def design_limits(analysis: Analysis) -> list[str]:
    """Return what the design of these answers cannot tell, in words."""
    answers, n = analysis.answers, analysis.answers.n_participants
    pairs = {(pair.left, pair.right) for pair in answers.pairs}
    tied = [pair for pair in answers.pairs if not pair.focused and (pair.right, pair.left) not in pairs]
    both, nothing = (answers.answers.naming(*fingers) for fingers in (("left", "right"), ()))
    known = [
        (
            analysis.responses.source.mode == "simulated",
            "These answers come from a simulated participant or a simulated rig. They say nothing about people.",
        ),
        (
            not answers.compares,
            f"The answers ({', '.join(answers.answers.names)}) do not name each finger alone, so no zone is dominant: "
            "there is no net dominance (a2), no prevalence of it, no side bias, no drift of it and no fit to the ratio "
            "of speeds. Cells are tested against an even split, and each answer by itself.",
        ),
        *((answers.compares and not answers.mirrored, _alias(pair)) for pair in tied),
        (
            answers.scale == OWN_THRESHOLD,
            "Levels are multiples of each participant's own threshold as a session before found it. How uncertain "
            "those thresholds are is in the reports of those sessions; no interval or test here takes it in.",
        ),
        (
            both is not None,
            f"“{both.name.capitalize() if both else ''}” mixes two things, feeling both fingers alike and being "
            "unable to tell; the question does not separate them.",
        ),
        (
            nothing is None,
            "No answer says that nothing was felt, so a trial without a stimulus cannot be answered correctly: lapses "
            "and guessing stay unknown.",
        ),
        (
            nothing is not None and not analysis.responses.catches,
            f"“{nothing.name.capitalize() if nothing else ''}” was an answer, but no trial was without a stimulus, so "
            "false alarms stay unknown.",
        ),
        (
            n < 8,
            f"With {n} participants no sign-flip test can pass Holm's correction over six tests: its smallest p is "
            f"2/2^{n} = {2.0 ** (1 - n):.3g}. Eight are the fewest that can.",
        ),
        (
            True,
            f"Equivalence of the finger conditions can be shown at best within {tango(0, 0, n).high:.2f} in one cell, "
            f"with {n} participants (half width of Tango's interval without any discordant pair).",
        ),
        (
            "trial" not in analysis.responses.frame.columns and len(answers.finger_conditions) > 1,
            "The table does not give the order of the finger conditions; unless it was balanced, an order effect "
            "passes for an effect of the fingers.",
        ),
    ]
    return [limit for holds, limit in known if holds]


def _alias(pair: Pair) -> str:
    return (
        f"In ({pair.left}, {pair.right}) zone, side and finger go together: {pair.left} lies on the left under one and "
        f"the same finger, so a preference for {pair.left} cannot be separated from one for that side or finger. "
        "Mirrored placement, or swapped hands in half the participants, would separate them."
    )


def _title(analysis: Analysis) -> str:
    start = analysis.responses.start
    name = str(start.get("design", {}).get("title") or start.get("protocol", ""))
    chosen = f", stimulus {analysis.responses.stimulus}" if analysis.responses.stimulus else ""
    return f"Analysis: {name}{chosen}" if name else "Analysis of answers"


def _zone_rows(answers: AnswerCounts, condition: str) -> list[dict[str, Any]]:
    table: pd.DataFrame = zone_table(answers, condition)
    total = answers.n_participants * answers.n_repetitions
    return [
        {"pair": pair, "answer": answer, "cells": [f"{int(k)}" for k in row], "of": total}
        for (pair, answer), row in zip(table.index, table.to_numpy(), strict=True)
    ]


def speed_rows(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the peak speeds predicted under the left and the right finger [mm/s], a row for each pair of zones.

    Parameters
    ----------
    frame : DataFrame
        Tidy answers; without ``speed_left_mm_s`` and ``speed_right_mm_s`` there is no row.
    """
    sides = ["speed_left_mm_s", "speed_right_mm_s"]
    if not all(has_values(frame, side) for side in sides):
        return []
    *pair, level = cell_of(frame.columns)
    bounds = frame.groupby([*pair, level], observed=True)[sides].agg(["min", "max"])
    said = bounds.round().astype(int).astype(str).apply(
        lambda row: " | ".join("–".join(dict.fromkeys(row[side])) for side in sides), axis=1
    )  # fmt: skip
    rows = said.unstack(level).fillna("")
    return [
        {"finger_condition": condition, "pair": f"{left}-{right}", "cells": list(cells)}
        for (condition, left, right), cells in zip(rows.index, rows.to_numpy(), strict=True)
    ]


def list_questions(findings: Sequence[Finding], answers: AnswerCounts) -> list[dict[str, Any]]:
    """Return the statistics question by question: in words, and each test or estimate as a table of its own.

    Parameters
    ----------
    findings : sequence of Finding
        Rows of the statistics.
    answers : AnswerCounts
        Counts of the answers.
    """
    tables, cautions = [], _cautions(answers)
    for question, heading in _headings(answers).items():
        own = [finding for finding in findings if finding.question == question]
        groups: dict[str, list[dict[str, Any]]] = {}
        for finding in own:
            groups.setdefault(finding.name, []).append(_test_row(finding))
        if groups:
            parts = [{"name": name, "lines": lines, "tested": any(row["p"] != "–" for row in lines)}
                     for name, lines in groups.items()]  # fmt: skip
            words = f"{_summarise(own)} {cautions.get(question, '')}"
            tables.append({"question": question, "heading": heading, "words": words, "parts": parts})
    return tables


def _test_row(finding: Finding) -> dict[str, Any]:
    numbers = ("statistic", "p", "p_min", "p_holm", "estimate", "low", "high")
    row: dict[str, Any] = {name: say_number(getattr(finding, name)) for name in numbers}
    significant = not math.isnan(finding.p_holm) and finding.p_holm <= ALPHA
    return {
        **row,
        "scope": finding.scope,
        "quantity": finding.quantity,
        "n": finding.n,
        "note": finding.note,
        "significant": significant,
    }
