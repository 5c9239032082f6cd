"""Wording of findings: answers to questions, families of tests and their error rates, finger conditions and zones."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Any

from modaltouch.analysis.counts import AnswerCounts, Pair
from modaltouch.analysis.findings import ALPHA, OUT_OF_REACH, Finding, grouped
from modaltouch.analysis.statistics import STATISTICS, questions
from modaltouch.report import format_number

HEADINGS = {
    "shares": ("Do the shares of the answers differ?", "the share of an answer differs"),
    "sensitivity": ("How well can the stimuli be distinguished?", "d' or the criterion differs"),
    "function": ("At which level does the answer change?", "the threshold, the PSE or the JND differs"),
    "rating": ("What do ratings and further answers say?", "ratings or further answers differ"),
    "group": ("Do the groups of participants differ?", "the groups differ"),
    "a1": ("Do the answers of a cell differ from guessing?", "answers differ from guessing"),
    "a2": ("Is one zone of each pair chosen more than the other?", "one zone is chosen more than the other"),
    "b": ("Does the level matter?", "the choice changes with the level"),
    "c": ("Do the finger conditions differ?", "the finger conditions differ"),
    "d": ("Do the pairs of zones differ{in_both}?", "the pairs of zones differ{in_both}"),
    "e": ("Do the participants agree?", ""),
    "f": ("How large are the effects?", ""),
    "catch": ("Is something felt where nothing is driven, or missed where something is?", ""),
    "side": ("Is there a side bias?", ""),
    "order": ("Do answers drift, or depend on what came first?", ""),
    "time": ("Do reaction times differ?", ""),
    "speed": ("Do the answers follow the speeds under the fingers?", ""),
    "model": ("What does a mixed model say?", ""),
}
"""Heading and claim of each question; for other families of tests, the heading is their question."""


def headings(answers: AnswerCounts) -> dict[str, tuple[str, str]]:
    """Return the heading and claim of each question, in the order of the report."""
    both = answers.answers.naming("left", "right") if answers.compares else None
    in_both = "" if both is None else f" in “{both.name}”"
    asked = {each.question: (f"{each.asks[:1].upper()}{each.asks[1:]}?", "") for each in STATISTICS.values()}
    known = {
        question: (heading.format(in_both=in_both), claim.format(in_both=in_both))
        for question, (heading, claim) in HEADINGS.items()
    }
    return {question: (asked | known)[question] for question in (*questions(), "model")}


def condition_in_words(finger_condition: str) -> str:
    """Format a finger condition in words.

    Examples
    --------
    >>> condition_in_words("one_hand")
    'one hand'
    """
    return finger_condition.replace("_", " ")


def scope_in_words(scope: str, finger_conditions: Sequence[str], pairs: Sequence[Pair]) -> str:
    """Format the scope of a finding in words, as in ``one hand, A and C, 80 mm/s``.

    Parameters
    ----------
    scope : str
        Scope of a finding: ``one_hand A-C 80 mm/s``, ``one_hand - two_hands A-C``, ``one_hand A-C - C-E``.
    finger_conditions, pairs : sequence of str, sequence of Pair
        Finger conditions and pairs that may occur in the scope.
    """
    names = {name: condition_in_words(name) for name in finger_conditions}
    names |= {pair.label: pair.in_words for pair in pairs}
    longest_first = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True))
    known = re.compile(rf"(?<![\w-])({longest_first})(?![\w-])")
    sides = ([names.get(part, part.strip(" ,")) for part in known.split(side)] for side in scope.split(" - "))
    return " against ".join(", ".join(filter(None, words)) for words in sides)


def format_p(p: float) -> str:
    """Format a p value for publication.

    Examples
    --------
    >>> format_p(0.0312), format_p(0.00004), format_p(1.0)
    ('= 0.031', '< 0.001', '= 1')
    """
    if math.isnan(p):
        return "not available"
    if p < 0.001:
        return "< 0.001"
    return f"= {p:.2g}" if p < 1 else "= 1"


def format_interval(finding: Finding) -> str:
    """Format an estimate with its interval, as in ``0.975 [0.798, 0.996]``."""
    estimate, *bounds = (format_number(value) for value in (finding.estimate, finding.low, finding.high))
    return estimate if bounds == ["–", "–"] else f"{estimate} [{', '.join(bounds)}]"


def quantity_in_words(finding: Finding) -> str:
    """Return the quantity of a finding with minus signs in place of hyphens, as in ``P(C) − P(A)``."""
    return finding.quantity.replace(" - ", " − ")


def answer_question(own: Sequence[Finding], claim: str, answers: AnswerCounts) -> str:
    """Answer a question in sentences with numbers, first on average, then for individual participants.

    Parameters
    ----------
    own : sequence of Finding
        Findings on the question.
    claim : str
        Claim of its tests.
    answers : AnswerCounts
        Counts of the answers.
    """
    families = sorted(
        dict.fromkeys(row.family for row in own if row.family),
        key=lambda name: (" " not in name, name) if name in STATISTICS else (False, ""),
    )
    if not families:
        return _estimate(own, answers)
    claim = claim or "there is such an effect"
    parts = {name: [row for row in own if row.family == name] for name in families}
    return " ".join(_answer_family(rows, _claim(claim, name), answers) for name, rows in parts.items())


# Claims of the families of tests of measures, by suffix of the family's name.
_CLAIMS = {
    " on average": "{claim} between conditions on average",
    "shares compared": "{claim} between conditions for at least one participant",
    " compared": "{claim} between conditions",
    " together": "{claim} for at least one participant, in any of the answers",
    " over levels": "ratings or further answers change with the level",
    "groups": "{claim}",
    "PSE": "the PSE differs from the standard",
    "": "{family} differs from zero",
}


def claim_of(family: str, claim: str) -> str:
    """Return the claim of a family of tests of measures, given the claim of its question."""
    end = next(end for end in _CLAIMS if family.endswith(end))
    return _CLAIMS[end].format(claim=claim, family=family)


def _claim(claim: str, family: str) -> str:
    """Return the claim of a family of tests: on average, for some participant, or of equivalence."""
    if family not in STATISTICS:
        return claim_of(family, claim)
    if family == "c alike":
        return "the finger conditions are alike on average, within the margin"
    if family.endswith(" mean"):
        return f"{claim} on average"
    return f"{claim} for at least one participant" if f"{family} mean" in STATISTICS else claim


def _answer_family(tested: Sequence[Finding], claim: str, answers: AnswerCounts) -> str:
    """Summarise the results of a family of tests, with the numbers of its most significant test."""
    m = len(tested)
    shown = [row for row in tested if row.p_holm <= ALPHA]
    clearest = min(tested, key=lambda row: (row.p_holm, row.p, -abs(row.estimate)))
    number = f"{_about(clearest, answers)}, p {format_p(clearest.p)}, Holm p {format_p(clearest.p_holm)}"
    none = f"none of {m} tests" if m > 1 else "no test"
    if all(row.p_min > ALPHA or row.note.startswith(OUT_OF_REACH) for row in tested):
        corrected = "" if all(row.p_min > ALPHA for row in tested) else " after Holm's correction"
        return f"The data cannot tell whether {claim}: {none} could reach p ≤ {ALPHA:g}{corrected}. Estimate: {number}."
    if not shown:
        return f"Not shown: {none} finds that {claim}. Smallest p: {number}."
    all_of = "both" if m == 2 else f"all {m}"
    where = f"in {all_of if len(shown) == m else f'{len(shown)} of {m}'} tests"
    return f"Yes, {where if m > 1 else 'in the one test'}: {claim}. Clearest: {number}."


def _estimate(own: Sequence[Finding], answers: AnswerCounts) -> str:
    """Summarise the range of estimates of each quantity, and the number of significant uncorrected tests."""
    alike = grouped((row.quantity, row) for row in own if row.name == own[0].name and math.isfinite(row.estimate))
    # Shares of different answers are not comparable; of two zones, the dominant one defines the effect.
    dominant = {f"P({pair.dominant})" for pair in answers.pairs} & alike.keys() if answers.compares else set()
    ranges = "; ".join(_range(alike[each], answers) for each in alike if each in (dominant or alike))
    parts = [ranges or "not estimable: see the notes"]
    tested = [row for row in own if row.p == row.p]
    if tested:
        n_low = sum(row.p <= ALPHA for row in tested)
        parts.append(
            f"Exploratory: p ≤ {ALPHA:g} in {n_low} of {len(tested)} uncorrected tests, where chance alone would "
            f"give {ALPHA * len(tested):.2g} on average"
        )
    return ". ".join(words[:1].upper() + words[1:] for words in parts) + "."


def _range(rows: Sequence[Finding], answers: AnswerCounts) -> str:
    """Format the lowest and the highest estimate of a quantity, with their scopes."""
    in_order = sorted(rows, key=lambda row: row.estimate)
    if len(rows) < 2:
        return _about(rows[0], answers)
    quantity = quantity_in_words(rows[0])
    ends = (_about(row, answers).removeprefix(f"{quantity} = ") for row in (in_order[0], in_order[-1]))
    return f"{quantity} from {' to '.join(ends)}"


def _about(row: Finding, answers: AnswerCounts) -> str:
    scope = "" if row.scope == "all" else f" ({scope_in_words(row.scope, answers.finger_conditions, answers.pairs)})"
    quantity = quantity_in_words(row)
    is_estimated = not row.family or row.estimate == row.estimate
    return f"{quantity} = {format_interval(row)}{scope}" if is_estimated else f"{quantity}{scope}"


def state_families(findings: Sequence[Finding]) -> str:
    """State the families of tests and the resulting error rates."""
    families = Counter(row.family for row in findings if row.family)
    n = len(families)
    if not n:
        return "No test was possible."
    named = ", ".join(f"{family} ({m})" for family, m in families.items())
    level, together = 100 * ALPHA, ""
    if n > 1:
        at_most = min(n * level, 100)
        together = f" Families are corrected separately: over all {n}, that probability is {at_most:g} % at most."
    return (
        f"Confirmatory tests, by family: {named}. Holm's correction keeps the probability of any false claim within a "
        f"family at {level:g} % at most.{together} All other tests are exploratory: their p values are not corrected "
        "and support no claim."
    )


# Certificates of findings outside families, by a pattern of question, name and note; the first match applies.
#
# A mean may have another certificate, against the mean of such estimates.
_OF_FINDINGS = {
    "shares .* compared, sign flips": ("shares compared",),
    "rating exponent of .* over .* sign flips": ("mean exponent",),
    "rating exponent of .* compared, sign flips": ("mean exponent compared",),
    "rating .* sign flips;.* geometric mean": ("mean magnitude",),
    "rating .* over participants, sign flips": ("mean rating without ends",),
    r"rating P\(.* bounded mean": ("share",), "rating .* bounded mean": ("mean rating",),
    "sensitivity d' over .* differencing": ("d'", "mean d', same and different"),
    "sensitivity d' over .* triangular": ("d', of three", "mean d', odd of three"),
    "sensitivity d' over .* 3AFC": ("d', of three", "mean d', of three"),
    "sensitivity d' over": ("d'", "mean d'"),
    "sensitivity d' compared.* differencing": ("mean d' compared, same and different",),
    "sensitivity d' compared.* triangular": ("mean d' compared, odd of three",),
    "sensitivity d' compared.* 3AFC": ("mean d' compared, of three",),
    "(?:sensitivity|function) (.*) over participants": (r"mean \1",),
    "(?:sensitivity|function) (.*) compared": (r"mean \1 compared",),
    ".* between groups": ("group",),
    ".* signed ranks": ("rank", "rank interval"), ".* Friedman": ("friedman",),
    ".* together over levels": ("b together",), ".* together, shuffles": ("c together",),
    ".* leaning participants": ("leaning", "leaning share"), ".* agreement between": ("agreement",),
    ".* prevalence of": ("prevalence",), ".* share of answers": ("share",), "catch": ("share",),
    ".* paired difference": ("paired difference",), ".* reaction times": ("time",),
    ".* share in a cell": ("a1 share",), ".* bounded mean": ("c mean",),
}  # fmt: skip


@lru_cache(maxsize=1)
def certificates() -> Any:
    """Return the mean and maximum error rate by name, with the reason if one is significantly above 5 %.

    The rates are counted by ``make certify``.
    """
    return json.loads(files(__package__).joinpath("certificates.json").read_text(encoding="utf-8"))


def certificates_of(finding: Finding) -> tuple[str, ...]:
    """Return the names of the certificates that apply to a test and its interval, if any."""
    if finding.family in STATISTICS:
        return (finding.family,)
    described = f"{finding.question} {finding.name}; {finding.note}"
    found = next(((match, names) for part, names in _OF_FINDINGS.items() if (match := re.match(part, described))), None)
    expanded = map(found[0].expand, found[1]) if found else ()
    return tuple(each for name in expanded for each in (f"{name}, as estimated", name) if each in certificates())


def coverage_note(finding: Finding) -> str:
    """Return a note if the interval of a mean covers less than 95 % by its certificates; else an empty string."""
    reasons = [certificates()[name][2] for name in certificates_of(finding) if name.startswith("mean ")]
    if not (reasons and reasons[-1] and math.isfinite(finding.low + finding.high)):
        return ""
    if reasons[0]:
        return f"not a 95 % interval: {reasons[-1]}"
    return f"95 % interval of the mean of such estimates, not of the true mean: {reasons[-1]}"


def certificates_in_words(names: Iterable[str]) -> str:
    """Describe the simulated error rates in words."""
    known = ((name, *certificates()[name]) for name in names if name in certificates())
    return "; ".join(
        f"{name} {100 * mean:.3g} %, at worst {100 * worst:.3g} %{f', so not a 95 % interval: {why}' if why else ''}"
        for name, mean, worst, why in known
    )
