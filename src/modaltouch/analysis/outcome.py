"""Results of an analysis of a crossed design at fixed levels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import pandas as pd

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.findings import Finding, plain_row, to_frame
from modaltouch.analysis.preregistration import RegisteredAnalysis, terms_of
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.statistics import find
from modaltouch.analysis.tables import tabulate
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
            from modaltouch.analysis.mixed_logistic import model_findings

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
