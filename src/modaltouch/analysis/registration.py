"""Interface between an analysis and its preregistration."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from modaltouch.analysis.counts import AnswerCounts
    from modaltouch.analysis.findings import Finding
    from modaltouch.analysis.responses import Responses


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


class RegisteredAnalysis(ABC):
    """Base class of analyses that can be checked against a preregistration."""

    responses: Responses

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
        from modaltouch.analysis.preregistration import describe_families

        return describe_families(self.confirmatory)

    def departures_from(self, terms: Mapping[str, Any]) -> tuple[str, ...]:
        """Describe the departures from a preregistration with these terms, in words."""
        from modaltouch.analysis.preregistration import find_departures

        return find_departures(terms, self.terms, self.confirmatory, self.responses)
