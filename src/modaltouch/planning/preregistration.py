"""A preregistration: what a protocol will test, and on how many participants, before the first one comes."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from modaltouch.analysis import (
    ALPHA,
    STATISTICS,
    AnswerCounts,
    Responses,
    describe_families,
    say_scope,
    terms_of,
    wilson,
)
from modaltouch.planning.design import Design
from modaltouch.planning.experiments import Study
from modaltouch.planning.observer import Observer
from modaltouch.planning.power import plan
from modaltouch.planning.presented import designs_for, refuse_open_levels
from modaltouch.preflight import Preflight
from modaltouch.protocol import InputError
from modaltouch.report import render_page
from modaltouch.system import commit, version

N_COUNTED, N_RECORDED = 1000, 20
"""Experiments that are simulated where nothing else is said: counts of answers, and whole sessions."""


@dataclass(frozen=True, eq=False)
class _Plan:
    """What an analysis will test, and how often it finds it in simulated experiments."""

    answers: AnswerCounts
    families: list[dict[str, Any]]
    power: list[dict[str, Any]]
    stimuli: tuple[str, ...]
    n_experiments: int
    repeated_by: str


def preregister(
    preflight: Preflight,
    observer: Observer,
    n_participants: int,
    *,
    study: Callable[[int], Responses] | None = None,
    n_experiments: int | None = None,
    seed: int = 1,
    on_progress: Callable[[int, int], None] | None = None,
) -> str:
    """Return the preregistration of a protocol as a page of Markdown.

    Parameters
    ----------
    preflight : Preflight
        The checked protocol; its levels are fixed.
    observer : Observer
        Who is simulated for the power.
    n_participants, n_experiments, seed : int
        Participants that are planned, simulated experiments, and their seed.
    study : callable, optional
        Takes a seed, and returns the answers of a whole experiment in simulated sessions. It is called where the counts
        of an observer that compares two fingers do not stand for the design: several intervals, ratings, one finger.
    on_progress : callable, optional
        Called with (jobs done, jobs in all) of each stimulus.

    Raises
    ------
    InputError
        If anything is wrong with the protocol, its levels follow from answers or differ between participants, or its
        conditions are not crossed.
    """
    protocol, source = preflight.experiment.protocol, preflight.experiment.sources.protocol
    path = source.path.as_posix()
    try:
        found = _by_counts(preflight, observer, n_participants, n_experiments or N_COUNTED, seed, on_progress)
    except InputError:
        refuse_open_levels(preflight)
        if study is None or protocol.uncrossed_by or protocol.stimuli:
            raise
        found = _by_sessions(study, n_experiments or N_RECORDED, seed, on_progress)
    terms = _terms(preflight, found)
    return render_page(
        "modaltouch.planning",
        "prereg.md.j2",
        protocol=protocol,
        path=path,
        plan=found,
        n=n_participants,
        level=100 * ALPHA,
        observer=observer.name,
        seed=seed,
        repeated_by=found.repeated_by.format(
            path=path, n=n_participants, experiments=found.n_experiments, observer=observer.name, seed=seed
        ),
        terms=terms,
        block=json.dumps(terms, indent=1, ensure_ascii=False),
        version=version(),
        commit=commit(),
    )


def _by_counts(
    preflight: Preflight,
    observer: Observer,
    n_participants: int,
    n_experiments: int,
    seed: int,
    on_progress: Callable[[int, int], None] | None,
) -> _Plan:
    """Return the plan of a design whose answers an observer counts without sessions."""
    schedule = preflight.experiment.protocol.schedule
    designs = designs_for(preflight, observer)
    first = next(iter(designs.values()))
    families = tuple(family for family in STATISTICS if first.scopes(family))
    rows = []
    for name, design in designs.items():
        study = Study(design, observer, families, null=False, seed=seed)
        found = plan(study, [(n_participants, schedule.repetitions)], n_experiments, on_progress=on_progress)
        floors = {floor.family: floor.least_participants or "none" for floor in found.floors}
        rows += [{**row, "stimulus": name, "floor": floors[row["family"]]} for row in found.families]
    offered = preflight.experiment.protocol.answers.offered
    shape = (n_participants, *first.shape, len(offered))
    planned = replace(first.count(np.zeros(shape, dtype=np.int64), schedule.repetitions), answers=offered)
    described = [_describe_family(family, first) for family in families]
    names = tuple(name for name in designs if name)
    again = "modaltouch power {path} -n {n} --experiments {experiments} --observer {observer} --seed {seed}"
    return _Plan(planned, described, rows, names, n_experiments, again)


def _by_sessions(
    study: Callable[[int], Responses],
    n_experiments: int,
    seed: int,
    on_progress: Callable[[int, int], None] | None,
) -> _Plan:
    """Return the plan of a design whose sessions are simulated and analysed as they will be."""
    significant: Counter[str] = Counter()
    families: list[dict[str, Any]] = []
    for number in range(n_experiments):
        answers, found = describe_families(study(seed + number))
        significant.update(each["name"] for each in found if each["significant"])
        # Of a degenerate experiment a test may be missing.
        families = max(families, found, key=lambda each: sum(len(family["scopes"]) for family in each))
        if on_progress is not None:
            on_progress(number + 1, n_experiments)
    shares = {each["name"]: wilson(significant[each["name"]], n_experiments) for each in families}
    rows = [
        {"family": name, "power": share.estimate, "low": share.low, "high": share.high, "floor": "not computed"}
        for name, share in shares.items()
    ]
    again = "modaltouch prereg {path} -n {n} --experiments {experiments} --observer {observer} --seed {seed}"
    return _Plan(answers, families, rows, (), n_experiments, f"{again} --out FILE")


def _describe_family(family: str, design: Design) -> dict[str, Any]:
    """Return a family of tests as the page names it."""
    return {
        "name": family,
        "asks": STATISTICS[family].asks,
        "test": STATISTICS[family].name,
        "scopes": [say_scope(scope, design.finger_conditions, design.pairs) for scope in design.scopes(family)],
    }


def _terms(preflight: Preflight, found: _Plan) -> dict[str, Any]:
    protocol = preflight.experiment.protocol
    known = {
        "protocol (SHA-256)": preflight.experiment.sources.protocol.sha256,
        "equivalence margin": (protocol.model_dump().get("analysis") or {}).get("equivalence_margin"),
    }
    tests = {family["name"]: len(family["scopes"]) for family in found.families}
    return {"date": datetime.now(UTC).date().isoformat(), **terms_of(found.answers, tests, known)}
