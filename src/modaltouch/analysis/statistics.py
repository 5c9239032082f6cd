"""The statistics of the experiment: every question of the plan as rows of one tidy table.

The participant is the unit of inference. Tests are exact, or Monte Carlo with a stated seed and interval; each
p stands beside the smallest p its data could have given.
"""

from __future__ import annotations

import pandas as pd

from modaltouch.analysis.catches import Catches, catch_findings
from modaltouch.analysis.consistency import association_findings, consistency_findings, effect_findings
from modaltouch.analysis.counts import AnswerCounts, count_answers
from modaltouch.analysis.findings import Finding, correct, to_frame
from modaltouch.analysis.questions import (
    chance_findings,
    condition_findings,
    dominance_findings,
    level_findings,
    pair_findings,
)
from modaltouch.analysis.secondary import secondary_findings


def run_tests(frame: pd.DataFrame, focus: str = "") -> pd.DataFrame:
    """Return the statistics of tidy answers.

    Parameters
    ----------
    frame : DataFrame
        Tidy answers, every participant in every cell equally often.
    focus : str
        Zone of the focus; guessed if empty.

    Returns
    -------
    DataFrame
        One row for each test or estimate, with the columns question, name, scope, statistic, p, p_min, p_holm,
        estimate, low, high, n, quantity, family, note. Estimates without a test have no p.
    """
    return to_frame(find(count_answers(frame, focus), frame))


def find(answers: AnswerCounts, frame: pd.DataFrame, catches: Catches | None = None) -> list[Finding]:
    """Return the findings behind `run_tests`, in the order of the questions.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers.
    frame : DataFrame
        The tidy answers themselves, for what counts do not hold: order and times.
    catches : mapping of str to Counter, optional
        Answers to catch trials by participant.
    """
    findings = [
        *chance_findings(answers),
        *dominance_findings(answers),
        *level_findings(answers),
        *condition_findings(answers),
        *pair_findings(answers),
        *association_findings(answers),
        *consistency_findings(answers),
        *effect_findings(answers),
        *catch_findings(answers, catches or {}),
        *secondary_findings(answers, frame),
    ]
    return sorted(correct(findings), key=lambda finding: ORDER.index(finding.question))


ORDER = ("a1", "a2", "b", "c", "d", "e", "f", "catch", "side", "order", "time", "speed")
"""Questions in the order of the report: those of the plan, then the further ones."""
