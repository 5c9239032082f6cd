"""Preregistrations: their terms, and the departures of an analysis from them."""

from __future__ import annotations

import json
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modaltouch.analysis.covariates import ANTICIPATION
from modaltouch.analysis.findings import ALPHA, Finding, grouped
from modaltouch.analysis.statistics import STATISTICS
from modaltouch.analysis.words import claim_of, headings, scope_in_words
from modaltouch.protocol import InputError

if TYPE_CHECKING:
    from modaltouch.analysis.counts import AnswerCounts
    from modaltouch.analysis.responses import Responses

ALL_PARTS = "all parts"
"""Scope of a test over all parts of a design that is not crossed."""

PARTS = "crossed parts, with repetitions"
"""Term of a preregistration of such a design."""


@dataclass(frozen=True)
class Registration:
    """The preregistration checked against an analysis.

    Attributes
    ----------
    path : Path or None
        File of the preregistration, if any.
    departures : tuple of str
        Departures of the analysis from the preregistration, in words.
    """

    path: Path | None = None
    departures: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the attributes as plain values for ``--json``."""
        return {"preregistration": str(self.path) if self.path else None, "departures": list(self.departures)}


@dataclass(frozen=True, eq=False)
class RegisteredAnalysis(ABC):
    """Base class of analyses that can be checked against a preregistration.

    Attributes
    ----------
    responses : Responses
        The answers.
    files : dict of str to Path
        Files written, by name.
    registration : Registration
        The preregistration checked against the analysis.
    """

    responses: Responses
    files: dict[str, Path] = field(default_factory=dict, kw_only=True)
    registration: Registration = field(default=Registration(), kw_only=True)

    @property
    @abstractmethod
    def confirmatory(self) -> list[tuple[str, AnswerCounts, Finding]]:
        """Tests corrected in families: part of the design (or empty), counts, and test."""

    @abstractmethod
    def terms(self, tests: Mapping[str, int]) -> dict[str, Any]:
        """Return the terms fixed by a preregistration, by name; `tests` is the number of tests in each family."""

    def design_in_words(self) -> list[tuple[str, str]]:
        """Describe a design without counts of the whole, as terms in words by name."""
        return []

    def describe_families(self) -> list[dict[str, Any]]:
        """Describe the families of confirmatory tests.

        Returns
        -------
        list of dict
            ``name``, ``asks``, ``test``, ``scopes``, and ``significant`` (whether any test is, after correction).
        """
        described = []
        for name, rows in grouped((each[2].family, each) for each in self.confirmatory).items():
            _, counts, first = rows[0]
            scopes = []
            for part, own, row in rows:
                labelled = scope_in_words(row.scope, own.finger_conditions, own.pairs)
                # The most frequent answer depends on the data.
                quantity = "P(most frequent answer)" if name == "a1" else row.quantity
                scopes.append((part, row.scope.replace("_", " ") if part == ALL_PARTS else labelled, quantity))
            described.append(
                {
                    "name": name,
                    "asks": STATISTICS[name].asks
                    if name in STATISTICS
                    else f"is it true that {claim_of(name, headings(counts)[first.question][1])}",
                    "test": "; ".join(dict.fromkeys(row.name for *_, row in rows)),
                    "scopes": [": ".join(filter(None, scope)) for scope in scopes],
                    "significant": any(row.p_holm <= ALPHA for *_, row in rows),
                }
            )
        return described

    def departures_from(self, terms: Mapping[str, Any]) -> tuple[str, ...]:
        """Describe the departures from a preregistration with these terms, in words."""
        start, known = self.responses.start, {}
        if start.get("sources"):  # a table of answers has none
            margin = (start.get("design", {}).get("analysis") or {}).get("equivalence_margin")
            known = {"protocol (SHA-256)": start["sources"]["protocol"]["sha256"], "equivalence margin": margin}
        counted = {*STATISTICS, *terms.get("tests by family", ())}
        analysed = self.terms(Counter(row.family for *_, row in self.confirmatory if row.family in counted)) | known
        departures = [
            f"{name}: {term_in_words(terms.get(name))} preregistered, {term_in_words(analysed[name])} analysed"
            for name in analysed
            if analysed[name] != terms.get(name)
        ]
        early = [each.name for each in self.responses.sessions if each.day < str(terms.get("date", ""))]
        if early:
            departures.append(
                f"{len(early)} of {len(self.responses.sessions)} sessions began before the day of the preregistration, "
                f"{terms['date']}"
            )
        return tuple(departures)


def terms_of(answers: AnswerCounts, tests: Mapping[str, int]) -> dict[str, Any]:
    """Return the terms fixed by a preregistration of a crossed design, by name, as plain values.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of planned or actual answers.
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


def name_part(answers: AnswerCounts, *factors: str) -> str:
    """Return the factors of a crossed part of a design, its finger conditions, pairs and levels in words."""
    levels = ", ".join(format(level, "g") for level in answers.levels)
    pairs = ", ".join(pair.label for pair in answers.pairs)
    words = [*filter(None, factors), " and ".join(answers.finger_conditions), pairs]
    return f"{' '.join(words)} at {levels} {answers.scale.unit}"


def terms_of_tests(tests: Mapping[str, int]) -> dict[str, Any]:
    """Return the terms common to all analyses with tests."""
    return {"tests by family": dict(tests), "level of significance": ALPHA, "shortest reaction time [s]": ANTICIPATION}


def read_preregistration(path: Path) -> dict[str, Any]:
    """Read the terms from the JSON block of a preregistration.

    Raises
    ------
    InputError
        If the file cannot be read, or has no JSON block with terms.
    """
    remedy = "write one with `modaltouch prereg PROTOCOL`"
    try:
        block = re.search(r"```json\n(.*?)\n```", path.read_text(encoding="utf-8"), re.DOTALL)
        terms = json.loads(block[1] if block else "")
        if not isinstance(terms, dict):
            raise ValueError
    except OSError as error:
        raise InputError.of(
            path, f"a file that cannot be read ({error.strerror})", "a preregistration", remedy
        ) from None
    except ValueError:
        raise InputError.of(path, "no block of JSON with the terms", "a preregistration", remedy) from None
    return terms


def term_in_words(value: Any) -> str:
    """Return the value of a term in words."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} ({n})" for name, n in value.items())
    if isinstance(value, list):
        return ", ".join(format(each, "g") if isinstance(each, float) else str(each) for each in value)
    return "none" if value is None else str(value)
