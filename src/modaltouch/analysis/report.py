"""The report: one HTML file with the figures inside, which needs no network and prints well."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from modaltouch import __version__
from modaltouch.analysis.catches import catch_rows
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.findings import ALPHA, Finding
from modaltouch.analysis.gallery import Picture
from modaltouch.analysis.outcome import Analysis
from modaltouch.analysis.page import embed_svg, render_page
from modaltouch.analysis.scale import OWN_THRESHOLD
from modaltouch.analysis.style import level_label
from modaltouch.analysis.tables import tabulate, zone_table
from modaltouch.analysis.words import HEADINGS, say_number, write_paragraphs

TEMPLATE = "report.html.j2"


def render_report(analysis: Analysis, pictures: Sequence[Picture], vectors: Mapping[str, bytes]) -> str:
    """Return the report as HTML."""
    from modaltouch.analysis.record_facts import describe_record
    from modaltouch.provenance import commit, versions

    answers = analysis.answers
    return render_page(
        "modaltouch.analysis",
        TEMPLATE,
        title=_title(analysis),
        source=analysis.responses.source,
        answers=answers,
        n_answers=int(answers.counts.sum()),
        levels=[level_label(level) for level in answers.levels],
        pictures=[_embed(picture, vectors[picture.name]) for picture in pictures],
        tables={condition: _zone_rows(answers, condition) for condition in answers.finger_conditions},
        paragraphs=write_paragraphs(analysis.findings, answers),
        tests=_test_tables(analysis.findings),
        catches=catch_rows(answers, analysis.responses.catches),
        limits=design_limits(analysis),
        left_out=analysis.responses.left_out,
        record=describe_record(analysis.responses.sessions),
        own_thresholds=answers.scale == OWN_THRESHOLD,
        version=__version__,
        commit=commit(),
        versions={k: v for k, v in versions().items() if v != "absent"},
        alpha=ALPHA,
    )


def design_limits(analysis: Analysis) -> list[str]:
    """Return what the design of these answers cannot tell, in words."""
    answers = analysis.answers
    pairs = {(pair.left, pair.right) for pair in answers.pairs}
    limits = []
    for pair in answers.pairs:
        if not pair.focused and (pair.right, pair.left) not in pairs and not answers.mirrored:
            limits.append(
                f"In ({pair.left}, {pair.right}) zone, side and finger go together: {pair.left} lies on the left "
                f"under one and the same finger, so a preference for {pair.left} cannot be told from a preference for "
                "that side or finger. Mirrored placement, or swapped hands in half the participants, would tell them "
                "apart."
            )
    if answers.scale == OWN_THRESHOLD:
        limits.append(
            "Levels are multiples of each participant's own threshold as a session before found it. How uncertain "
            "those thresholds are is in the reports of those sessions; no interval or test here takes it in."
        )
    limits.append(
        "“Both” mixes two things, feeling both fingers alike and being unable to tell; the question does not part them."
    )
    if not answers.offers_none:
        limits.append(
            "There is no answer “none”, so a trial without a stimulus cannot be answered correctly: lapses and "
            "guessing stay unknown."
        )
    elif not analysis.responses.catches:
        limits.append("“None” was an answer, but no trial was without a stimulus, so false alarms stay unknown.")
    n = answers.n_participants
    if n < 8:
        limits.append(
            f"With {n} participants no sign-flip test can pass Holm's correction over six tests: its smallest p is "
            f"2/2^{n} = {2.0 ** (1 - n):.3g}. Eight are the fewest that can."
        )
    half = 1.96**2 / (n + 1.96**2)
    limits.append(
        f"Equivalence of the finger conditions can be shown at best within {half:.2f} in one cell, with {n} "
        "participants (half width of Tango's interval without any discordant pair)."
    )
    if "trial" not in analysis.responses.frame.columns and len(answers.finger_conditions) > 1:
        limits.append(
            "The table does not tell the order of the finger conditions; unless it was balanced, an order effect "
            "passes for an effect of the fingers."
        )
    if analysis.responses.source.mode == "simulated":
        limits.insert(
            0, "These answers come from a simulated participant or a simulated rig. They tell nothing of people."
        )
    return limits


def _title(analysis: Analysis) -> str:
    start = analysis.responses.start
    name = str(start.get("design", {}).get("title") or start.get("protocol", ""))
    chosen = f", stimulus {analysis.responses.stimulus}" if analysis.responses.stimulus else ""
    return f"Analysis: {name}{chosen}" if name else "Analysis of answers"


def _embed(picture: Picture, svg: bytes) -> dict[str, Any]:
    return {
        "name": picture.name,
        "section": picture.section,
        "caption": picture.caption,
        "finger_condition": picture.finger_condition,
        "uri": embed_svg(svg),
    }


def _zone_rows(answers: AnswerCounts, condition: str) -> list[dict[str, Any]]:
    table: pd.DataFrame = zone_table(tabulate(answers), condition, answers.focus)
    total = answers.n_participants * answers.n_repetitions
    return [
        {"pair": pair, "answer": answer, "cells": [f"{int(k)}" for k in row], "of": total}
        for (pair, answer), row in zip(table.index, table.to_numpy(), strict=True)
    ]


def _test_tables(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """Return the statistics question by question, each test or estimate a table of its own."""
    tables = []
    for question, heading in HEADINGS.items():
        groups: dict[str, list[dict[str, Any]]] = {}
        for finding in (finding for finding in findings if finding.question == question):
            groups.setdefault(finding.name, []).append(_test_row(finding))
        if groups:
            parts = [{"name": name, "lines": lines, "tested": any(row["p"] != "–" for row in lines)}
                     for name, lines in groups.items()]  # fmt: skip
            tables.append({"question": question, "heading": heading, "parts": parts})
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
