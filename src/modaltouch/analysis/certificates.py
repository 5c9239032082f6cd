"""Simulated error rates of tests and intervals, counted by ``make certify``, with the reasons for rates above 5 %."""

from __future__ import annotations

import json
from collections.abc import Iterable
from functools import lru_cache
from importlib.resources import files
from typing import Any

from modaltouch.analysis.findings import Finding
from modaltouch.analysis.statistics import STATISTICS

_OF_NAMES = {
    " together between": (), " between groups": ("group",), "differencing criterion": (),
    "d' compared": ("mean d' compared, as estimated", "mean d' compared"),
    "criterion compared": ("mean criterion compared, as estimated", "mean criterion compared"),
    ") compared, sign flips": ("shares compared",), " compared, sign flips": (),
    "signed ranks": ("rank", "rank interval"),
    "Friedman": ("friedman",), "leaning": ("leaning", "leaning share"), "agreement between": ("agreement",),
    "prevalence of": ("prevalence",), "share of answers": ("share",), "paired difference": ("paired difference",),
    "odds ratio": ("odds ratio",), "reaction times": ("time",), "false alarms,": ("share",), "misses,": ("share",),
    "together over levels": ("b together",), " together, shuffles": ("c together",),
    "share in a cell": ("a1 share",), "bounded mean": ("c mean",),
    "criterion over": ("mean criterion, as estimated", "mean criterion"),
    "d' over": ("d'", "mean d', as estimated", "mean d'"), "detection threshold": (),
    "threshold over": ("mean threshold, as estimated", "mean threshold"),
    "PSE over": ("mean PSE",), "JND over": ("mean JND, as estimated", "mean JND"), "exponent of": ("mean exponent",),
    "magnitude over participants": ("mean magnitude",),
}  # fmt: skip
"""Certificates of findings outside families, by a substring of their name; the first match applies.

Empty for findings without simulated error rates, such as sign flips of PSEs or JNDs.
"""


@lru_cache(maxsize=1)
def certificates() -> dict[str, tuple[float, float, str]]:
    """Return the mean and maximum error rate by name, with the reason if one is significantly above 5 %."""
    held: dict[str, Any] = json.loads(files(__package__).joinpath("certificates.json").read_text(encoding="utf-8"))
    return {name: (mean, worst, why) for name, (mean, worst, why) in held.items()}


def certificates_of(finding: Finding) -> tuple[str, ...]:
    """Return the names of the certificates that apply to a test and its interval, if any."""
    known = (names for part, names in _OF_NAMES.items() if part in finding.name)
    return (finding.family,) if finding.family in STATISTICS else next(known, ())


def certificates_in_words(names: Iterable[str]) -> str:
    """Describe the simulated error rates in words."""
    known = ((name, *certificates()[name]) for name in names if name in certificates())
    return "; ".join(
        f"{name} {100 * mean:.3g} %, at worst {100 * worst:.3g} %{f', so not a 95 % interval: {why}' if why else ''}"
        for name, mean, worst, why in known
    )
