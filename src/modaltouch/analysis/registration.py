"""The preregistration that an analysis is checked against, and the terms that it fixes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.covariates import ANTICIPATION
from modaltouch.analysis.findings import ALPHA

ALL_PARTS = "all parts"
"""Scope of a test of all parts together, for a design that is not crossed."""


@dataclass(frozen=True)
class Registration:
    """The preregistration that an analysis was checked against.

    Attributes
    ----------
    path : Path or None
        Its file; None without one.
    departures : tuple of str
        Departures of the analysis from it, in words.
    """

    path: Path | None = None
    departures: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return both as plain values for ``--json``."""
        return {"preregistration": str(self.path) if self.path else None, "departures": list(self.departures)}


def terms_of(answers: AnswerCounts, tests: Mapping[str, int]) -> dict[str, Any]:
    """Return the terms that a preregistration of a crossed design fixes, by name, as plain values.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers, planned or given.
    tests : mapping of str to int
        Number of tests in each family.
    """
    return {
        "participants": answers.n_participants,
        "finger conditions": sorted(answers.finger_conditions),
        "pairs of zones": sorted(pair.label for pair in answers.pairs),
        f"levels [{answers.scale.unit}]": sorted(answers.levels),
        "repetitions": answers.n_repetitions,
        "answers": list(answers.answers.names),
        **terms_of_tests(tests),
    }


def terms_of_tests(tests: Mapping[str, int]) -> dict[str, Any]:
    """Return the terms of every analysis with tests."""
    return {"tests by family": dict(tests), "level of significance": ALPHA, "shortest reaction time [s]": ANTICIPATION}
