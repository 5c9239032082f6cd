"""The terms of a preregistration, and what an analysis departs from them."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from modaltouch.analysis.counts import AnswerCounts
from modaltouch.analysis.covariates import ANTICIPATION
from modaltouch.analysis.findings import ALPHA, Finding
from modaltouch.analysis.outcome import Analysis
from modaltouch.analysis.responses import Responses
from modaltouch.analysis.statistics import STATISTICS
from modaltouch.protocol import InputError

_UNKNOWN = ("protocol (SHA-256)", "equivalence margin")
"""Terms that a table of answers does not tell."""


def terms_of(answers: AnswerCounts, tests: Mapping[str, int], protocol: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a preregistration fixes, by name, as plain values.

    Parameters
    ----------
    answers : AnswerCounts
        Counts of the answers, planned or given.
    tests : mapping of str to int
        Number of tests in each family.
    protocol : mapping
        Those of `_UNKNOWN` terms that are known.
    """
    return {
        "participants": answers.n_participants,
        "finger conditions": sorted(answers.finger_conditions),
        "pairs of zones": sorted(pair.label for pair in answers.pairs),
        f"levels [{answers.scale.unit}]": sorted(answers.levels),
        "repetitions": answers.n_repetitions,
        "answers": list(answers.answers.names),
        "tests by family": dict(tests),
        "level of significance": ALPHA,
        "shortest reaction time [s]": ANTICIPATION,
        **{name: protocol[name] for name in _UNKNOWN if name in protocol},
    }


def describe_families(responses: Responses) -> tuple[AnswerCounts, list[dict[str, Any]]]:
    """Return the counts of answers, and the families of confirmatory tests that their analysis holds.

    Parameters
    ----------
    responses : Responses
        Answers of a crossed design at fixed levels, such as simulated ones.

    Returns
    -------
    AnswerCounts
        Their counts.
    list of dict
        ``name``, ``asks``, ``test``, ``scopes``, and ``significant``: whether a test is, after correction.
    """
    from modaltouch.analysis.measures import claim_of
    from modaltouch.analysis.words import headings, say_scope

    analysis = Analysis.of(responses)
    answers, families = analysis.answers, dict[str, list[Finding]]()
    for row in analysis.findings:
        if row.family:
            families.setdefault(row.family, []).append(row)
    asks = {name: statistic.asks for name, statistic in STATISTICS.items()}
    asked = headings(answers)
    return answers, [
        {
            "name": name,
            "asks": asks.get(name) or claim_of(name, asked[rows[0].question][1]),
            "test": rows[0].name,
            "scopes": [say_scope(row.scope, answers.finger_conditions, answers.pairs) for row in rows],
            "significant": any(row.p_holm <= ALPHA for row in rows),
        }
        for name, rows in families.items()
    ]


def read_preregistration(path: Path) -> dict[str, Any]:
    """Return the terms that a preregistration holds in its block of JSON.

    Raises
    ------
    InputError
        If there is no such file, or no such block in it.
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


def find_departures(terms: Mapping[str, Any], analysis: Analysis) -> tuple[str, ...]:
    """Return in words what an analysis departs from.

    Parameters
    ----------
    terms : mapping
        As `read_preregistration` returns them.
    analysis : Analysis
        What was found.
    """
    start = analysis.responses.start
    known = {}
    if start.get("sources"):
        margin = (start.get("design", {}).get("analysis") or {}).get("equivalence_margin")
        known = dict(zip(_UNKNOWN, (start["sources"]["protocol"]["sha256"], margin), strict=True))
    counted = {*STATISTICS, *terms.get("tests by family", ())}
    families = Counter(row.family for row in analysis.findings if row.family in counted)
    found = terms_of(analysis.answers, families, known)
    said = [
        f"{name}: {_say(terms.get(name))} preregistered, {_say(found[name])} analysed"
        for name in found
        if found[name] != terms.get(name)
    ]
    early = [each.name for each in analysis.responses.sessions if each.day < str(terms.get("date", ""))]
    if early:
        n = len(analysis.responses.sessions)
        said.append(f"{len(early)} of {n} sessions began before the day of the preregistration, {terms['date']}")
    return tuple(said)


def _say(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} ({n})" for name, n in value.items())
    if isinstance(value, list):
        return ", ".join(format(each, "g") if isinstance(each, float) else str(each) for each in value)
    return "none" if value is None else str(value)
