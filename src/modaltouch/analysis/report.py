"""The report: one HTML file with the figures inside, which needs no network and prints well."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from modaltouch.analysis.catches import catch_rows
from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.findings import ALPHA, Finding
from modaltouch.analysis.intervals import tango
from modaltouch.analysis.outcome import Analysis
from modaltouch.analysis.scale import OWN_THRESHOLD
from modaltouch.analysis.statistics import STATISTICS, questions
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


@dataclass(frozen=True)
class Paragraph:
    """One question answered in words."""

    question: str
    heading: str
    text: str


def write_paragraphs(findings: Sequence[Finding], answers: AnswerCounts) -> tuple[Paragraph, ...]:
    """Return a paragraph for each question that the findings answer.

    Parameters
    ----------
    findings : sequence of Finding
        Rows of the statistics.
    answers : AnswerCounts
        Counts of the answers.
    """
    headings = _headings(answers)
    writers = {"a1": _chance, "a2": _dominance, "b": _level, "c": _conditions, "d": _pairs, "e": _agreement}
    paragraphs = []
    for question, heading in headings.items():
        own = [finding for finding in findings if finding.question == question]
        if own:
            text = writers[question](own, answers) if question in writers else _plain(question, own, answers)
            paragraphs.append(Paragraph(question, heading, text))
    return tuple(paragraphs)


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


def _chance(own: Sequence[Finding], answers: AnswerCounts) -> str:
    nothing, felt = answers.answers.naming(), _join([answers.answers[place].name for place in answers.felt])
    beyond = [finding for finding in own if finding.p_holm <= ALPHA]
    rest = [finding.scope for finding in own if finding.p_holm > ALPHA]
    text = (
        f"In {len(beyond)} of {len(own)} cells the answers of the {answers.n_participants} participants differ from "
        f"an even split over {felt} (exact multinomial test ordered by likelihood ratio, Holm-corrected "
        f"over {len(own)} cells, p ≤ {ALPHA:g})."
    )
    if nothing is not None:
        text += (
            f" “{nothing.name.capitalize()}” is left out of this test, which asks where something was felt; it counts "
            "in every share."
        )
    if rest and beyond:
        text += f" They do not in {_join(rest)}."
    least = own[0].p_min
    if least * len(own) > ALPHA:
        text += (
            f" Even a unanimous cell could not pass the correction: its p is {say_number(least)}; "
            "more participants are needed, so this question stays open."
        )
    return text


def _dominance(own: Sequence[Finding], answers: AnswerCounts) -> str:
    sentences = []
    both = answers.answers.naming("left", "right")
    equal = "" if both is None else f", “{both.name}” counting zero"
    for finding in (f for f in own if f.family):
        counts, leaning = finding.note.split("; ")[-2:]
        sentences.append(
            f"{finding.scope}: {counts}, {leaning}; net dominance {say_interval(finding)}, {_verdict(finding)}."
        )
    return (
        f"Net dominance over all levels (dominant less other answers{equal}), exact sign flips over "
        f"participants, Holm over {_family(own)}. " + " ".join(sentences)
    )


def _level(own: Sequence[Finding], answers: AnswerCounts) -> str:
    if len(answers.levels) < 2:
        return "Only one level was presented, so nothing can be said about the level."
    trend_of = "the dominant answer" if answers.compares else "each answer"
    tested = [f for f in own if f.family]
    open_ones = [f for f in tested if f.p_min > ALPHA]
    text = (
        f"Trend of {trend_of} over {answers.levels[0]:g} to {answers.scale.say(answers.levels[-1])}, levels "
        f"shuffled within participants (exact), Holm over {_family(own)}. "
    )
    step, several = answers.scale.step_in_words, len({f.quantity for f in tested}) > 1 and not answers.compares

    def _of(finding: Finding) -> str:
        return f"{finding.scope}, {finding.quantity}" if several else finding.scope

    text += " ".join(f"{_of(f)}: {say_interval(f)} per {step}, {_verdict(f)}." for f in tested if f not in open_ones)
    if open_ones:
        text += (
            f" No information on {_join([_of(f) for f in open_ones])}: too few participants changed their answer "
            "between levels for any trend to show. This is not evidence that the level does not matter."
        )
    return text


def _conditions(own: Sequence[Finding], answers: AnswerCounts) -> str:
    text = f"Whole-participant swaps of the finger conditions (exact sign flips), Holm over {_family(own)}. "
    text += _sum_up(own, quantity=True)
    widest = max(max(abs(f.low), abs(f.high)) for f in own)
    return text + (
        f" The data show the conditions to be alike only within the bounds of these intervals, {widest:.2f} at the "
        "widest. A difference that is not significant does not show that the conditions are alike."
    )


def _pairs(own: Sequence[Finding], answers: AnswerCounts) -> str:
    shares = [label for label, _ in answers.effects(answers.pairs[0])][1 if answers.compares else 0 :]
    if not shares:
        told = " ".join(f"{finding.scope}: {_verdict(finding)}." for finding in own)
        return f"Any association of pair and answer (answers shuffled, Monte Carlo). {told}"
    named = " and of ".join(f"“{label}”" for label in shares)
    text = (
        f"Share of {named}, compared between pairs within participants (exact sign flips), Holm over {_family(own)}. "
    )
    return text + _sum_up([f for f in own if f.family], quantity=len(shares) > 1)


def _agreement(own: Sequence[Finding], answers: AnswerCounts) -> str:
    if answers.n_participants < 2:
        return "One participant alone: agreement between participants has no meaning."
    text = (
        "Gwet's AC1 (1 where all agree; kappa is undefined there and is not used), and whether participants differ "
        "from each other (answers shuffled over participants, Monte Carlo). "
    )
    return text + _sum_up([f for f in own if f.quantity == "Gwet AC1"])


def _plain(question: str, own: Sequence[Finding], answers: AnswerCounts) -> str:
    if question == "f":
        shares = [f for f in own if f.name.startswith("Korn")]
        return (
            "Shares over all levels with intervals over participants (Korn-Graubard): "
            + "; ".join(f"{f.scope} {f.quantity} {say_interval(f)}" for f in shares)
            + ". Paired differences of single cells (Tango) and matched odds ratios are in tests.csv."
        )
    estimates = [f for f in own if math.isnan(f.p)]
    text = _sum_up([f for f in own if f not in estimates], quantity=True)
    text += " ".join(f"{f.scope}: {f.quantity} {say_interval(f)} ({f.note})." for f in estimates)
    nothing = answers.answers.naming()
    caution = {
        "catch": " Catch trials are in no other table or test; in those, "
        f"“{nothing.name if nothing else ''}” on a trial with a stimulus counts for neither zone and not for "
        "both, and shares are of all answers.",
        "time": " Bursts repeat at a fixed rate, so reaction times come in steps of one burst period.",
        "order": " The paper does not state the order of the two finger conditions.",
    }
    return text + caution.get(question, "")


def _sum_up(findings: Sequence[Finding], *, quantity: bool = False) -> str:
    """Return the tests that could have shown something one by one, then those that could not in one sentence."""

    def estimate(finding: Finding) -> str:
        return f"{finding.scope}{', ' + finding.quantity if quantity else ''}: {say_interval(finding)}"

    told = [f"{estimate(f)}, {_verdict(f)}." for f in findings if f.p_min <= ALPHA]
    silent = [estimate(f) for f in findings if f.p_min > ALPHA]
    if silent:
        told.append(
            f"No information, as no outcome could have given p ≤ {ALPHA:g}, on these, whose estimates stand alone: "
            + "; ".join(silent)
            + "."
        )
    return " ".join(told)


def _verdict(finding: Finding) -> str:
    if finding.p_min > ALPHA:
        return f"no information (whatever the answers, p could not fall below {say_number(finding.p_min)})"
    corrected = "" if math.isnan(finding.p_holm) else f", Holm p {say_p(finding.p_holm)}"
    least = "the smallest possible" if finding.p <= finding.p_min else f"smallest possible {say_number(finding.p_min)}"
    return f"p {say_p(finding.p)}{corrected} ({least})"


def _family(own: Iterable[Finding]) -> int:
    first = [f.family for f in own if f.family]
    return sum(name == first[0] for name in first) if first else 0


def _join(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def report_files(analysis: Analysis, pictures: Sequence[ReportFigure]) -> dict[str, Any]:
    """Return the report and its figures, by file name."""
    from modaltouch.analysis.provenance import describe_record

    answers = analysis.answers
    felt = [answers.answers[place].name for place in answers.felt]
    return page_files(
        "modaltouch.analysis",
        "report",
        pictures,
        title=_title(analysis),
        source=analysis.responses.source,
        answers=answers,
        n_answers=int(answers.counts.sum()),
        levels=[format(level, "g") for level in answers.levels],
        tables={condition: _zone_rows(answers, condition) for condition in answers.finger_conditions},
        paragraphs=write_paragraphs(analysis.findings, answers),
        tests=_test_tables(analysis.findings, answers),
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
    answers = analysis.answers
    pairs = {(pair.left, pair.right) for pair in answers.pairs}
    limits = []
    if not answers.compares:
        limits.append(
            f"The answers ({', '.join(answers.answers.names)}) do not name each finger alone, so no zone is dominant: "
            "there is no net dominance (a2), no prevalence of it, no side bias, no drift of it and no fit to the ratio "
            "of speeds. Cells are tested against an even split, and each answer by itself."
        )
    for pair in answers.pairs if answers.compares else ():
        if not pair.focused and (pair.right, pair.left) not in pairs and not answers.mirrored:
            limits.append(
                f"In ({pair.left}, {pair.right}) zone, side and finger go together: {pair.left} lies on the left "
                f"under one and the same finger, so a preference for {pair.left} cannot be separated from one for "
                "that side or finger. Mirrored placement, or swapped hands in half the participants, would separate "
                "them."
            )
    if answers.scale == OWN_THRESHOLD:
        limits.append(
            "Levels are multiples of each participant's own threshold as a session before found it. How uncertain "
            "those thresholds are is in the reports of those sessions; no interval or test here takes it in."
        )
    if answers.both_place is not None:
        limits.append(
            f"“{answers.answers[answers.both_place].name.capitalize()}” mixes two things, feeling both fingers alike "
            "and being unable to tell; the question does not separate them."
        )
    nothing = answers.answers.naming()
    if nothing is None:
        limits.append(
            "No answer says that nothing was felt, so a trial without a stimulus cannot be answered correctly: lapses "
            "and guessing stay unknown."
        )
    elif not analysis.responses.catches:
        limits.append(
            f"“{nothing.name.capitalize()}” was an answer, but no trial was without a stimulus, so false alarms stay "
            "unknown."
        )
    n = answers.n_participants
    if n < 8:
        limits.append(
            f"With {n} participants no sign-flip test can pass Holm's correction over six tests: its smallest p is "
            f"2/2^{n} = {2.0 ** (1 - n):.3g}. Eight are the fewest that can."
        )
    limits.append(
        f"Equivalence of the finger conditions can be shown at best within {tango(0, 0, n).high:.2f} in one cell, "
        f"with {n} participants (half width of Tango's interval without any discordant pair)."
    )
    if "trial" not in analysis.responses.frame.columns and len(answers.finger_conditions) > 1:
        limits.append(
            "The table does not give the order of the finger conditions; unless it was balanced, an order effect "
            "passes for an effect of the fingers."
        )
    if analysis.responses.source.mode == "simulated":
        limits.insert(
            0, "These answers come from a simulated participant or a simulated rig. They say nothing about people."
        )
    return limits


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


def _test_tables(findings: Sequence[Finding], answers: AnswerCounts) -> list[dict[str, Any]]:
    """Return the statistics question by question, each test or estimate a table of its own."""
    tables = []
    for question, heading in _headings(answers).items():
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
