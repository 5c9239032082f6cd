"""Preregistration of a protocol: hypotheses, tests, number of participants and simulated power."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.analysis import (
    STATISTICS,
    Responses,
    analyse_responses,
    scope_in_words,
    terms_of,
    wilson,
)
from modaltouch.planning.design import Design, designs_for, of_analysed_kind, refuse_own_levels
from modaltouch.planning.experiments import Study
from modaltouch.planning.observer import Observer
from modaltouch.planning.power import plan, processes
from modaltouch.preflight import Preflight
from modaltouch.protocol import InputError, Source
from modaltouch.report import render_page
from modaltouch.system import commit, version

N_COUNTED, N_RECORDED = 1000, 20
"""Default number of simulated experiments, as counts of answers and as whole sessions."""


def times_in_words(number: int) -> str:
    """Return the phrase for a number of times."""
    return "once" if number == 1 else f"{number} times"


def preregister(
    preflight: Preflight,
    observer: Observer,
    n_participants: int,
    *,
    study: Callable[[int], Responses],
    n_experiments: int | None = None,
    seed: int = 1,
    threshold_mm_s: float | None = None,
    n_processes: int = 1,
    on_progress: Callable[[int, int], None] | None = None,
) -> str:
    """Render the preregistration of a protocol as a page of Markdown.

    Parameters
    ----------
    preflight : Preflight
        The checked protocol.
    observer : Observer
        Observer simulated to estimate the power.
    n_participants, n_experiments, seed : int
        Planned participants, simulated experiments, and their seed.
    study : callable
        Takes a seed; returns the answers of an experiment in simulated sessions, for designs not simulated as counts.
    threshold_mm_s : float, optional
        Assumed threshold of all simulated participants, if levels are calibrated by participant [mm/s].
    n_processes, on_progress : int, callable
        Worker processes, on whose number the page does not depend; called with (jobs done, total jobs).

    Raises
    ------
    InputError
        If the protocol has faults, or its levels depend on a threshold that is not given.
    """
    protocol, path = preflight.experiment.protocol, _public(preflight.experiment.sources.protocol.path)
    if threshold_mm_s is None:
        refuse_own_levels(preflight, "give the threshold that you expect with --threshold")
    if not (design := _counted(preflight, observer)) or threshold_mm_s is not None:
        found = _by_sessions(study, n_experiments or N_RECORDED, seed, n_processes, on_progress)
    else:
        counted = Study(design, observer, tuple(filter(design.tests.get, STATISTICS)), null=False, seed=seed)
        found = _by_counts(counted, n_participants, n_experiments or N_COUNTED, n_processes, on_progress)
    given = f" --threshold {threshold_mm_s:g}" if threshold_mm_s else ""
    several = (preflight, *preflight.others) if preflight.others else ()
    terms, size = _terms(preflight, found["terms"]), {"n": n_participants, "observer": observer.name, "seed": seed}
    return render_page(
        "modaltouch.planning",
        "prereg.md.j2",
        protocol=protocol,
        occasions=[(" ".join(filter(None, each.findings.occasion)), each.experiment.protocol) for each in several],
        path=path,
        plan=found,
        times=times_in_words,
        repeated_by=found["repeated_by"].format(path=path, experiments=found["n_experiments"], threshold=given, **size),
        threshold_mm_s=threshold_mm_s,
        **size,
        terms=terms,
        block=json.dumps(terms, indent=1, ensure_ascii=False),
        program=(version(), commit()),
    )


def _public(path: Path) -> str:
    """Return a protocol's path, or the name of a shipped one, whose path may contain a user name."""
    shipped = {file: name for name, file in Source.shipped("protocol").items()}
    return shipped.get(path.absolute(), path.as_posix())


def _terms(preflight: Preflight, planned: dict[str, Any]) -> dict[str, Any]:
    return {
        "date": datetime.now(UTC).date().isoformat(),
        **planned,
        "protocol (SHA-256)": preflight.experiment.sources.protocol.sha256,
        "equivalence margin": preflight.experiment.protocol.analysis.equivalence_margin,
    }


def _counted(preflight: Preflight, observer: Observer) -> Design | None:
    """Return the design if its answers can be simulated as counts without sessions, else None."""
    of_analysed_kind(preflight)  # without one, sessions could not be analysed either
    if len(preflight.parts) > 1:
        return None
    try:
        return next(iter(designs_for(preflight, observer).values()))
    except InputError:
        return None


def _by_counts(
    study: Study,
    n_participants: int,
    n_experiments: int,
    n_processes: int,
    on_progress: Callable[[int, int], None] | None,
) -> dict[str, Any]:
    """Return the values of the page for a design whose answers are simulated as counts without sessions."""
    design = study.design
    found = plan(
        study, [(n_participants, design.n_repetitions)], n_experiments, n_processes=n_processes, on_progress=on_progress
    )
    floors = {floor.family: floor.least_participants or "none" for floor in found.floors}
    rows = [{**row, "floor": floors[row["family"]]} for row in found.families]
    nobody = np.zeros((n_participants, *design.shape, len(design.answers)), dtype=np.int64)
    planned = design.count(nobody, design.n_repetitions)
    described: list[dict[str, Any]] = [
        {
            "name": family,
            "asks": STATISTICS[family].asks,
            "test": STATISTICS[family].name,
            "scopes": [
                f"{scope_in_words(scope, design.finger_conditions, design.pairs)}: {quantity}"
                for scope, quantity in design.tests[family]
            ],
        }
        for family in study.families
    ]
    tests = {family["name"]: len(family["scopes"]) for family in described}
    again = "modaltouch power {path} -n {n} --experiments {experiments} --observer {observer} --seed {seed}"
    again += f" --questions '{','.join(study.families)}'"
    return {
        "answers": planned,
        "terms": terms_of(planned, tests),
        "families": described,
        "power": rows,
        "n_experiments": n_experiments,
        "repeated_by": again,
        "thresholds": [],
        "design": [],
    }


def _by_sessions(
    study: Callable[[int], Responses],
    n_experiments: int,
    seed: int,
    n_processes: int,
    on_progress: Callable[[int, int], None] | None,
) -> dict[str, Any]:
    """Return the values of the page for other designs, from whole sessions."""
    import joblib

    significant: Counter[str] = Counter()
    families: list[dict[str, Any]] = []
    estimates: dict[str, list[dict[str, Any]]] = {}
    with processes(min(n_processes, n_experiments)):
        done = joblib.Parallel(return_as="generator", batch_size=1)(
            joblib.delayed(_simulated)(study, seed + number) for number in range(n_experiments)
        )
        for number, analysis in enumerate(done, start=1):
            found = analysis.describe_families()
            significant.update(each["name"] for each in found if each["significant"])
            # Tests may be missing from a degenerate experiment.
            families = max(families, found, key=lambda each: sum(len(family["scopes"]) for family in each))
            for row in getattr(analysis, "thresholds", ()):
                name = ", ".join(str(row[key]).replace("_", " ") for key in row if isinstance(row[key], str))
                estimates.setdefault(name, []).append(row)
            if on_progress is not None:
                on_progress(number, n_experiments)
    shares = {each["name"]: wilson(significant[each["name"]], n_experiments) for each in families}
    rows = [
        {"family": name, "power": share.estimate, "low": share.low, "high": share.high, "floor": "not computed"}
        for name, share in shares.items()
    ]
    again = "modaltouch prereg {path} -n {n} --experiments {experiments} --observer {observer} --seed {seed}"
    again += "{threshold} --out FILE"
    terms = analysis.terms({family["name"]: len(family["scopes"]) for family in families})
    thresholds = [_describe_threshold(name, found) for name, found in estimates.items()]
    return {
        "answers": getattr(analysis, "answers", None),  # None if the design is not crossed: `design` then describes it
        "terms": terms,
        "families": families,
        "power": rows,
        "n_experiments": n_experiments,
        "repeated_by": again,
        "thresholds": thresholds,
        "design": analysis.design_in_words(),
    }


def _simulated(study: Callable[[int], Responses], seed: int) -> Any:
    return analyse_responses(study(seed))


def _describe_threshold(name: str, found: Sequence[dict[str, Any]]) -> dict[str, Any]:
    bounds = [(row["threshold_low_mm_s"], row["threshold_high_mm_s"]) for row in found]
    factors = [float(np.sqrt(high / low)) for low, high in bounds if low and high]
    return {
        "of": name,
        "factor": float(np.median(factors)) if factors else None,
        "n_without_interval": len(found) - len(factors),
        "without_threshold": sum(row["n_without_threshold"] for row in found) / sum(row["n_runs"] for row in found),
    }
