"""Report of an analysis, as a self-contained, printable HTML file with embedded figures."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from modaltouch.analysis.columns import OWN_THRESHOLD, zones_in_words, zones_of
from modaltouch.analysis.counts import AnswerCounts, Pair
from modaltouch.analysis.covariates import has_values
from modaltouch.analysis.crossed import PAPER_TEXT, Analysis, zone_table
from modaltouch.analysis.findings import ALPHA, Finding, grouped
from modaltouch.analysis.responses import cell_of
from modaltouch.analysis.words import (
    answer_question,
    certificates_in_words,
    certificates_of,
    condition_in_words,
    format_interval,
    headings,
    quantity_in_words,
    scope_in_words,
    state_families,
)
from modaltouch.report import ReportFigure, format_number, page_files

MOST_ROWS = 8
"""Maximum number of rows of an unfolded table; longer tables are folded, and not printed."""

CATCHES = "Beside d', criteria and detection thresholds, catch trials are in no other table, figure or test."


def _cautions(answers: AnswerCounts) -> dict[str, str]:
    felt = [answers.answers[place].name for place in answers.felt]
    return {
        "a1": "Each p is of all answers in a cell, tested against an even split over "
        f"{', '.join(felt[:-1])} and {felt[-1]}"
        + (
            "; an answer that nothing was felt is left out of the test, and counts in the shares"
            * answers.has_none_answer
        )
        + ".",
        "b": "A lack of information is not evidence that the level does not matter.",
        "c": "A difference that is not significant does not show that the conditions are alike; "
        + (
            "that takes analysis.equivalence_margin, fixed in the protocol beforehand, and here there is none."
            if answers.margin is None
            else f"the tests of equivalence do, within the protocol's margin of {answers.margin:g}; that all are alike "
            "is shown where every one of their p is at most 0.05."
        ),
        "e": "Gwet's AC1 is 1 where all agree; kappa is undefined there and is not used."
        if answers.n_participants > 1
        else "Only one participant: agreement between participants has no meaning.",
        "catch": CATCHES,
    }


def report_files(analysis: Analysis, pictures: Sequence[ReportFigure]) -> dict[str, Any]:
    """Render the report and its figures, by file name."""
    from modaltouch.analysis.provenance import describe_record

    answers, chosen = analysis.answers, analysis.responses.stimulus
    felt = [answers.answers[place].name for place in answers.felt]
    return page_files(
        "modaltouch.analysis",
        "report",
        pictures,
        title=analysis.responses.heading("Analysis") + f", stimulus {chosen}" * bool(chosen),
        source=analysis.responses.source,
        answers=answers,
        n_answers=int(answers.counts.sum()),
        conditions=[condition_in_words(name) for name in answers.finger_conditions],
        levels=[format(level, "g") for level in answers.levels],
        tables={condition: _zone_rows(answers, condition) for condition in answers.finger_conditions},
        strips=participant_strips(answers),
        values=analysis.design.rows if analysis.design else [],
        certified=analysis.design.certified if analysis.design else "",
        speeds=speed_rows(analysis.responses.frame),
        delivered=delivered_rows(analysis.responses.frame),
        tests=list_questions(analysis.findings, answers),
        families=state_families(analysis.findings),
        most_rows=MOST_ROWS,
        catches=analysis.design.catches if analysis.design else (),
        catches_enter=CATCHES,
        catch_words=[*(answer.name for answer in answers.answers if answer.means_nothing_felt), *felt]
        if answers.has_none_answer
        else ["none", *felt],
        limits=design_limits(analysis) + list(analysis.design.limits if analysis.design else ()),
        registration=analysis.registration,
        left_out=analysis.responses.left_out,
        command=analysis.responses.command,
        notes=analysis.responses.notes,
        record=describe_record(analysis.responses.sessions),
        own_thresholds=answers.scale == OWN_THRESHOLD,
        alpha=ALPHA,
    )


def design_limits(analysis: Analysis) -> list[str]:
    """Return the limitations of the design, in sentences."""
    answers, n = analysis.answers, analysis.answers.n_participants
    both, nothing = answers.answers.naming("left", "right"), answers.answers.naming()
    flips = Counter(row.family for row in analysis.findings if row.family and re.search("sign.flip", row.name))
    fewest = 1 + math.ceil(math.log2(m / ALPHA)) if (m := min(flips.values(), default=0)) else 0
    known = [
        (
            analysis.responses.source.mode == "simulated",
            "These answers come from a simulated participant or a simulated rig. They say nothing about people.",
        ),
        (
            analysis.registration.path is None,
            "No preregistration was found (modaltouch prereg writes one), so nothing shows that hypotheses, tests and "
            "sample size were chosen before the data.",
        ),
        (
            not answers.compares and len(answers.answers) > 1,
            f"The answers ({', '.join(answers.answers.names)}) do not name each of two fingers alone, so no zone is "
            "dominant: there is no net dominance (a2), no prevalence of it, no side bias, no drift of it and no fit to "
            f"the ratio of speeds. The tests are of each answer alone{', and of all together' * answers.is_nominal}.",
        ),
        *((answers.compares and not answers.mirrored, words) for words in _aliases(answers.pairs)),
        (
            answers.scale == OWN_THRESHOLD,
            "Levels are multiples of each participant's own threshold, found in an earlier session. The reports of "
            "those sessions give the uncertainty of the thresholds; no interval or test here includes it.",
        ),
        (
            both is not None,
            f"“{both.name.capitalize() if both else ''}” mixes two things, feeling both fingers alike and being "
            "unable to tell; the question does not separate them.",
        ),
        (  # With several intervals, the guess rate follows from the design; for numbers, there is none.
            nothing is None and len(answers.answers) > 1 and analysis.responses.task.n_intervals == 1,
            "No answer says that nothing was felt, so a trial without a stimulus cannot be answered correctly: lapses "
            "and guessing stay unknown.",
        ),
        (
            nothing is not None and not analysis.responses.catches,
            f"“{nothing.name.capitalize() if nothing else ''}” was an answer, but no trial was without a stimulus, so "
            "false alarms stay unknown.",
        ),
        (
            n < fewest,
            f"With n = {n} no sign-flip test can pass Holm's correction over a family of {m}: its smallest p is "
            f"2/2^{n} = {2.0 ** (1 - n):.3g}. At least {fewest} participants are needed.",
        ),
        (
            len(answers.finger_conditions) > 1,
            f"With n = {n}, finger conditions can be shown to be alike on average within {1 - 0.05 ** (1 / n):.2f} at "
            "best, if no participant's answers differ: the sample may lack participants who differ.",
        ),
        (
            "trial" not in analysis.responses.frame.columns and len(answers.finger_conditions) > 1,
            "The table does not give the order of the finger conditions; unless it was balanced, an order effect "
            "looks like an effect of the fingers.",
        ),
    ]
    return [limit for holds, limit in known if holds]


def _aliases(pairs: Sequence[Pair]) -> Iterator[str]:
    sides = {(pair.left, pair.right) for pair in pairs}
    for left, right in ((pair.left, pair.right) for pair in pairs if not pair.focused):
        if (right, left) not in sides:
            yield (
                f"In ({left}, {right}) zone, side and finger are confounded: {left} always lies on the left under the "
                f"same finger, so a preference for {left} cannot be distinguished from one for that side or finger. "
                "Mirrored placement, or swapped hands in half the participants, would separate them."
            )


def _zone_rows(answers: AnswerCounts, condition: str) -> list[dict[str, Any]]:
    table: pd.DataFrame = zone_table(answers, condition)
    total = answers.n_participants * answers.n_repetitions
    paper = PAPER_TEXT.get(condition, {}) if answers.is_paper_design else {}
    return [
        {
            "pair": pair.replace("-", ", "),
            "answer": answer,
            "cells": [f"{int(k)}" for k in row],
            "of": total,
            "paper": paper.get((pair, answer), ""),
        }
        for (pair, answer), row in zip(table.index, table.to_numpy(), strict=True)
    ]


def speed_rows(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the predicted peak speeds under the fingers from left to right [mm/s], one row per pair of zones.

    Parameters
    ----------
    frame : DataFrame
        Tidy answers; without the speed under each finger, there are no rows.
    """
    sides = ["speed_left_mm_s", "speed_between_mm_s", "speed_right_mm_s"]
    sides = [side for side in sides if has_values(frame, side)]
    zones = [name for name in zones_of(frame.columns) if (frame[name] != "").any()]
    return [] if len(sides) < len(zones) else _ranges(frame, sides)


def delivered_rows(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the peak speeds delivered under the faster finger [mm/s], one row per pair, in trials where known."""
    is_known = "delivered_mm_s" in frame and frame["delivered_mm_s"].notna().any()
    return _ranges(frame, ["delivered_mm_s"]) if is_known else []


def _ranges(frame: pd.DataFrame, columns: list[str]) -> list[dict[str, Any]]:
    """Return one row per pair of zones, with the ranges of the columns at each level."""
    *pair, level = cell_of(frame.columns)
    bounds = frame.dropna(subset=columns).groupby([*pair, level], observed=True)[columns].agg(["min", "max"])
    labels = bounds.round().astype(int).astype(str).apply(
        lambda row: " | ".join("–".join(dict.fromkeys(row[column])) for column in columns), axis=1
    )  # fmt: skip
    rows = labels.unstack(level, fill_value="").reindex(columns=sorted(frame[level].unique()), fill_value="")
    return [
        {"finger_condition": condition_in_words(condition), "pair": zones_in_words(zones), "cells": list(cells)}
        for (condition, *zones), cells in zip(rows.index, rows.to_numpy(), strict=True)
    ]


def list_questions(findings: Sequence[Finding], answers: AnswerCounts) -> list[dict[str, Any]]:
    """Return the statistics by question: a summary in words, and a table for each test or estimate.

    Parameters
    ----------
    findings : sequence of Finding
        Rows of the statistics.
    answers : AnswerCounts
        Counts of the answers.
    """
    tables, cautions = [], _cautions(answers)
    for question, (heading, claim) in headings(answers).items():
        own = [finding for finding in findings if finding.question == question]
        is_shown = question in ("b", "c") and all(row.p_holm <= ALPHA for row in own)
        if own:
            tables.append({
                "question": question,
                "heading": heading,
                "answer": answer_question(own, claim, answers),
                # Omit cautions on non-significant results if all are significant.
                "caution": "" if is_shown else cautions.get(question, ""),
                "parts": [_part(name, rows, answers) for name, rows in grouped((row.name, row) for row in own).items()],
            })  # fmt: skip
    return tables


def _part(name: str, rows: Sequence[Finding], answers: AnswerCounts) -> dict[str, Any]:
    tested, corrected = any(row.p == row.p for row in rows), any(row.family for row in rows)
    printed = [row for row in rows if row.p == row.p or row.low == row.low]
    return {
        "name": name + (" (exploratory, not corrected)" if tested and not corrected else ""),
        "certificate": certificates_in_words(dict.fromkeys(name for row in printed for name in certificates_of(row))),
        "tested": tested,
        "corrected": corrected,
        "folded": len(rows) > MOST_ROWS,
        "lines": [
            {
                "scope": scope_in_words(row.scope, answers.finger_conditions, answers.pairs),
                "quantity": quantity_in_words(row),
                "estimate": format_interval(row),
                "p": format_number(row.p, 2),
                "p_min": format_number(row.p_min, 2),
                "p_holm": format_number(row.p_holm, 2),
                "n": row.n,
                "note": row.note,
                "significant": row.p_holm <= ALPHA,
            }
            for row in rows
        ],
    }


MOST_PARTICIPANTS = 40
"""Maximum number of participants on one page of strips."""

ZONE_COLOURS = ("#a9c3ee", "#e6e9ee", "#f2b196")
"""Colours of dominant zone, both, and other zone; light enough for dark letters, also in print."""
OTHER_COLOURS = ("#f6e08a", "#a6dcc0", "#d7b9e0", "#9fe0f5", *ZONE_COLOURS)
"""Colours of answers that name no zone; the last ones, those of zones, are used only if no answer names a zone."""
TIED, NOTHING = "#ffffff", "#c3c8d0"


@dataclass(frozen=True)
class Kind:
    """Content of a cell: an answer, or a tie between repetitions (place -1), with its letter and colour."""

    place: int
    name: str
    letter: str
    colour: str


def kinds_of(answers: AnswerCounts, pair: Pair) -> list[Kind]:
    """Return the possible contents of the cells of a pair, in the order of the legend.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    pair : Pair
        One of its pairs.
    """
    kinds = []
    if answers.compares:
        dominant, both, other = ZONE_COLOURS
        kinds = [Kind(answers.dominant_place(pair), "dominant zone", pair.dominant, dominant)]
        if (place := answers.both_place) is not None:
            kinds.append(Kind(place, answers.answers[place].name, "&", both))
        kinds.append(Kind(answers.other_place(pair), "other zone", pair.other, other))
    rest = {p: answers.answers[p].name for p in answers.felt if p not in {kind.place for kind in kinds}}
    # Use two letters if they are distinct, else the number of the answer.
    is_clear = len({name[:2] for name in rest.values()}) == len(rest)
    letters = [name[:2] if is_clear else str(place + 1) for place, name in rest.items()]
    kinds += [Kind(*each) for each in zip(rest, rest.values(), letters, OTHER_COLOURS, strict=False)]
    kinds += [Kind(p, each.name, "–", NOTHING) for p, each in enumerate(answers.answers) if each.means_nothing_felt]
    return [*kinds, Kind(-1, "no answer, or a tie between repetitions", "?", TIED)]


def participant_strips(answers: AnswerCounts) -> dict[str, Any]:
    """Return each participant's most frequent answer in each cell, as a table for each finger condition.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers; only the first `MOST_PARTICIPANTS` participants are shown.
    """
    modal = answers.modal()[:MOST_PARTICIPANTS]
    kinds = [kinds_of(answers, pair) for pair in answers.pairs]
    by_place = [{kind.place: kind for kind in own} for own in kinds]
    rows = {
        condition_in_words(condition): {
            name: [[by_place[q][place] for place in cells] for q, cells in enumerate(own[f].tolist())]
            for name, own in zip(answers.participants, modal, strict=False)
        }
        for f, condition in enumerate(answers.finger_conditions)
    }
    legend = [kind for kind in kinds[0] if kind.place >= 0 or (modal < 0).any()]
    return {"rows": rows, "legend": legend, "n_shown": len(modal)}
