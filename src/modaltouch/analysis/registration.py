"""What an analysis was held against, and what of it a preregistration fixes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.covariates import ANTICIPATION
from modaltouch.analysis.findings import ALPHA

ALL_PARTS = "all parts"
"""Where a test is of a design that is not crossed as a whole."""


@dataclass(frozen=True)
class Registration:
    """The preregistration that an analysis was held against.

    Attributes
    ----------
    path : Path or None
        Where it lies; None for none.
    departures : tuple of str
        What departs from it, in words.
    """

    path: Path | None = None
    departures: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return both as plain values for ``--json``."""
        return {"preregistration": str(self.path) if self.path else None, "departures": list(self.departures)}


def terms_of(answers: AnswerCounts, tests: Mapping[str, int]) -> dict[str, Any]:
    """Return what a preregistration of a crossed design fixes, by name, as plain values.

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
    """Return the terms that every analysis with tests has."""
    return {
        "tests by family": dict(tests),
        "level of significance": ALPHA,
        "shortest reaction time [s]": ANTICIPATION,
    }
