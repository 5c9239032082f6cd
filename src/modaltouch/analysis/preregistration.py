"""Terms of a preregistration, and departures of an analysis from them."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modaltouch.analysis.covariates import ANTICIPATION
from modaltouch.analysis.findings import ALPHA, Finding
from modaltouch.analysis.statistics import STATISTICS
from modaltouch.protocol import InputError

if TYPE_CHECKING:
    from modaltouch.analysis.counts import AnswerCounts
    from modaltouch.analysis.responses import Responses

ALL_PARTS = "all parts"
"""Scope of a test over all parts of a design that is not crossed."""

_UNKNOWN = ("protocol (SHA-256)", "equivalence margin")
"""Terms that are unknown for a table of answers."""


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


def terms_of_tests(tests: Mapping[str, int]) -> dict[str, Any]:
    """Return the terms common to all analyses with tests."""
    return {"tests by family": dict(tests), "level of significance": ALPHA, "shortest reaction time [s]": ANTICIPATION}


def describe_families(confirmatory: Iterable[tuple[str, AnswerCounts, Finding]]) -> list[dict[str, Any]]:
    """Describe the families of confirmatory tests, as in `RegisteredAnalysis.describe_families`."""
    from modaltouch.analysis.words import claim_of, headings, scope_in_words

    families: dict[str, list[tuple[str, AnswerCounts, Finding]]] = {}
    for each in confirmatory:
        families.setdefault(each[2].family, []).append(each)
    asks = {name: statistic.asks for name, statistic in STATISTICS.items()}
    described = []
    for name, rows in families.items():
        _, counts, first = rows[0]
        scopes = []
        for part, own, row in rows:
            said = scope_in_words(row.scope, own.finger_conditions, own.pairs)
            # The most frequent answer depends on the data.
            quantity = "P(most frequent answer)" if name == "a1" else row.quantity
            scopes.append((part, row.scope.replace("_", " ") if part == ALL_PARTS else said, quantity))
        described.append(
            {
                "name": name,
                "asks": asks.get(name) or claim_of(name, headings(counts)[first.question][1]),
                "test": "; ".join(dict.fromkeys(row.name for *_, row in rows)),
                "scopes": [": ".join(filter(None, scope)) for scope in scopes],
                "significant": any(row.p_holm <= ALPHA for *_, row in rows),
            }
        )
    return described


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


def find_departures(
    terms: Mapping[str, Any],
    found: Callable[[Mapping[str, int]], dict[str, Any]],
    confirmatory: Iterable[tuple[str, AnswerCounts, Finding]],
    responses: Responses,
) -> tuple[str, ...]:
    """Describe the departures of an analysis from a preregistration, in words.

    Parameters
    ----------
    terms : mapping
        Terms returned by `read_preregistration`.
    found, confirmatory, responses
        The terms of the analysis, its tests and its answers, as in `RegisteredAnalysis`.
    """
    start = responses.start
    known = {}
    if start.get("sources"):
        margin = (start.get("design", {}).get("analysis") or {}).get("equivalence_margin")
        known = dict(zip(_UNKNOWN, (start["sources"]["protocol"]["sha256"], margin), strict=True))
    counted = {*STATISTICS, *terms.get("tests by family", ())}
    analysed = found(Counter(row.family for *_, row in confirmatory if row.family in counted)) | known
    said = [
        f"{name}: {term_in_words(terms.get(name))} preregistered, {term_in_words(analysed[name])} analysed"
        for name in analysed
        if analysed[name] != terms.get(name)
    ]
    early = [each.name for each in responses.sessions if each.day < str(terms.get("date", ""))]
    if early:
        n = len(responses.sessions)
        said.append(f"{len(early)} of {n} sessions began before the day of the preregistration, {terms['date']}")
    return tuple(said)


def term_in_words(value: Any) -> str:
    """Return the value of a term in words."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} ({n})" for name, n in value.items())
    if isinstance(value, list):
        return ", ".join(format(each, "g") if isinstance(each, float) else str(each) for each in value)
    return "none" if value is None else str(value)
