"""Analysis of a crossed design at fixed levels: results, and tables of counts in the form of Fig. 10 and Fig. 11."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pandas as pd

from modaltouch.analysis.counts import PAPER_CONDITIONS, AnswerCounts
from modaltouch.analysis.findings import Finding, plain_row, to_frame
from modaltouch.analysis.preregistration import RegisteredAnalysis, terms_of
from modaltouch.analysis.responses import CELL, Responses
from modaltouch.analysis.statistics import find
from modaltouch.protocol import InputError

if TYPE_CHECKING:
    from modaltouch.analysis.designs import DesignAnalysis


@dataclass(frozen=True, eq=False)
class Analysis(RegisteredAnalysis):
    """Results of an analysis, and the files written.

    Attributes
    ----------
    answers : AnswerCounts
        Counts of the answers.
    findings : tuple of Finding
        The statistics.
    design : DesignAnalysis, optional
        Results of individual participants.
    """

    answers: AnswerCounts
    findings: tuple[Finding, ...]
    design: DesignAnalysis | None = None

    @classmethod
    def of(cls, responses: Responses, *, model: bool = False) -> Self:
        """Analyse the answers of a crossed design at fixed levels.

        Parameters
        ----------
        responses : Responses
            The answers.
        model : bool
            Whether to fit the mixed logistic model, too.

        Raises
        ------
        InputError
            If the answers do not suit the model.
        """
        chosen = responses.by_choice()
        counts = chosen.count()
        design = None
        if responses.has_individual_results:
            from modaltouch.analysis.designs import analyse_design

            design = analyse_design(responses)
        findings = tuple(find(counts, chosen.frame, design.findings if design else ()))
        if model:
            from modaltouch.analysis.models import model_findings

            if not counts.compares:
                given, allowed = "answers that do not name each of two fingers alone", "answers that do"
                raise InputError.of("--model", given, allowed, "leave --model out")
            findings += tuple(model_findings(counts, chosen.frame))
        return cls(chosen, counts, findings, design)

    @property
    def confirmatory(self) -> list[tuple[str, AnswerCounts, Finding]]:
        """Tests corrected in families, as in `RegisteredAnalysis`."""
        return [("", self.answers, row) for row in self.findings if row.family]

    def terms(self, tests: Mapping[str, int]) -> dict[str, Any]:
        """Return the terms fixed by a preregistration, by name."""
        return terms_of(self.answers, tests)

    @property
    def counts(self) -> pd.DataFrame:
        """Counts by cell, one row each."""
        return tabulate(self.answers)

    @property
    def tests(self) -> pd.DataFrame:
        """The statistics, one row each."""
        return to_frame(self.findings)

    def as_dict(self) -> dict[str, Any]:
        """Return all results as plain values for ``--json``, with rows as in `plain_row`."""
        return {
            "counts": [plain_row(row) for row in self.counts.to_dict("records")],
            "tests": [plain_row(row) for row in self.tests.to_dict("records")],
            **({"measures": [*map(plain_row, self.design.rows)]} if self.design and self.design.rows else {}),
            "catch_trials": [row.as_dict() for row in self.design.catches] if self.design else [],
            "files": {name: str(path) for name, path in self.files.items()},
            "n_participants": self.answers.n_participants,
            "n_responses": int(self.answers.counts.sum()),
            "n_missing": sum(n for *_, n in self.answers.missing),
            "missing": [{"participant": who, "cell": cell, "n": n} for who, cell, n in self.answers.missing],
            **self.registration.as_dict(),
            **self.responses.as_dict(),
        }


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
