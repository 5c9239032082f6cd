"""How often tests and intervals err in simulated populations, as ``make certify`` counted it, and why so often."""

from __future__ import annotations

import json
from collections.abc import Iterable
from functools import lru_cache
from importlib.resources import files
from typing import Any

from modaltouch.analysis.findings import Finding
from modaltouch.analysis.statistics import STATISTICS

_OF_NAMES = {
    " between groups": ("group",), " compared, sign flips": (), "signed ranks": ("rank", "rank interval"),
    "Friedman": ("friedman",), "leaning": ("leaning", "leaning share"), "agreement between": ("agreement",),
    "prevalence of": ("prevalence",), "share of answers": ("share",), "paired difference": ("paired difference",),
    "odds ratio": ("odds ratio",), "reaction times": ("time",), "false alarms,": ("share",), "misses,": ("share",),
    "bounded mean": ("c mean",), "d' over": ("d'", "mean d'"), "detection threshold": (),
    "threshold over": ("mean threshold",),
    "PSE over": ("mean PSE",), "JND over": ("mean JND",), "exponent of": ("mean exponent",),
}  # fmt: skip
"""Certificates of what stands in no family of `STATISTICS`, by a part of its name; the first that fits counts.

Nothing is told where nothing was counted, such as of sign flips of criteria or of ratings.
"""


@lru_cache(maxsize=1)
def certificates() -> dict[str, tuple[float, float, str]]:
    """Return the mean and worst error rate of each, and why one is certainly above 5 %, if it is."""
    held: dict[str, Any] = json.loads(files(__package__).joinpath("certificates.json").read_text(encoding="utf-8"))
    return {name: (mean, worst, why) for name, (mean, worst, why) in held.items()}


def why_not_95(name: str) -> str:
    """Return why an interval is none of 95 %, as what was counted of it shows; empty where nothing shows that."""
    return certificates().get(name, (0.0, 0.0, ""))[2]


def certificates_of(finding: Finding) -> tuple[str, ...]:
    """Return the names of the certificates of a test and its interval; none of what is not certified."""
    known = (names for part, names in _OF_NAMES.items() if part in finding.name)
    return (finding.family,) if finding.family in STATISTICS else next(known, ())


def say_certificates(names: Iterable[str]) -> str:
    """Return rates of errors in words, of what was counted."""
    known = ((name, *certificates()[name]) for name in names if name in certificates())
    return "; ".join(
        f"{name} {100 * mean:.3g} %, at worst {100 * worst:.3g} %{f', so not a 95 % interval: {why}' if why else ''}"
        for name, mean, worst, why in known
    )
