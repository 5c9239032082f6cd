"""A preregistration: what a protocol will test, and on how many participants, before the first one comes."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import numpy as np

from modaltouch.analysis import ALPHA, STATISTICS, say_scope, terms_of
from modaltouch.planning.design import Design
from modaltouch.planning.experiments import Study
from modaltouch.planning.observer import Observer
from modaltouch.planning.power import plan
from modaltouch.planning.presented import designs_for
from modaltouch.preflight import Preflight
from modaltouch.report import render_page
from modaltouch.system import commit, version


def preregister(
    preflight: Preflight,
    observer: Observer,
    n_participants: int,
    *,
    n_experiments: int = 1000,
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
    on_progress : callable, optional
        Called with (jobs done, jobs in all) of each stimulus.

    Raises
    ------
    InputError
        If anything is wrong with the protocol, or its levels follow from answers or differ between participants.
    """
    protocol, source = preflight.experiment.protocol, preflight.experiment.sources.protocol
    designs = designs_for(preflight, observer)
    first, n_repetitions = next(iter(designs.values())), protocol.schedule.repetitions
    families = tuple(family for family in STATISTICS if first.scopes(family))
    rows = []
    for name, design in designs.items():
        study = Study(design, observer, families, null=False, seed=seed)
        found = plan(study, [(n_participants, n_repetitions)], n_experiments, on_progress=on_progress)
        floors = {floor.family: floor.least_participants for floor in found.floors}
        rows += [{**row, "stimulus": name, "floor": floors[row["family"]]} for row in found.families]
    terms = _terms(preflight, first, n_participants, families)
    return render_page(
        "modaltouch.planning",
        "prereg.md.j2",
        protocol=protocol,
        path=source.path.as_posix(),
        design=first,
        levels=[f"{level:g}" for level in first.levels],
        stimuli=[name for name in designs if name],
        n=n_participants,
        families=[_describe_family(family, first) for family in families],
        level=100 * ALPHA,
        margin=terms["equivalence margin"],
        observer=observer.name,
        n_experiments=n_experiments,
        seed=seed,
        power=rows,
        terms=terms,
        block=json.dumps(terms, indent=1, ensure_ascii=False),
        version=version(),
        commit=commit(),
    )


def _describe_family(family: str, design: Design) -> dict[str, Any]:
    """Return a family of tests as the page names it."""
    return {
        "name": family,
        "asks": STATISTICS[family].asks,
        "test": STATISTICS[family].name,
        "scopes": [say_scope(scope, design.finger_conditions, design.pairs) for scope in design.scopes(family)],
    }


def _terms(preflight: Preflight, design: Design, n_participants: int, families: tuple[str, ...]) -> dict[str, Any]:
    protocol = preflight.experiment.protocol
    offered = protocol.answers.offered
    shape = (n_participants, *design.shape, len(offered))
    planned = design.count(np.zeros(shape, dtype=np.int64), protocol.schedule.repetitions)
    known = {
        "protocol (SHA-256)": preflight.experiment.sources.protocol.sha256,
        "equivalence margin": (protocol.model_dump().get("analysis") or {}).get("equivalence_margin"),
    }
    tests = {family: len(design.scopes(family)) for family in families}
    terms = terms_of(planned, tests, known) | {"answers": list(offered.names)}
    return {"date": datetime.now(UTC).date().isoformat(), **terms}
