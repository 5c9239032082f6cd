"""Every shipped protocol run once at a build: a session, a cohort and its analysis, for the pages that show what comes out."""

import json
from collections import defaultdict
from contextlib import chdir
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from typer.testing import CliRunner

from modaltouch.cli import app

ROOT = Path(__file__).parents[2]
PAPER = "differentiated_stimulation"
COHORT = {PAPER: 10}
"""Simulated participants of each protocol; 6 where it is not listed."""

_MORE = (
    "verify results",
    "study results",
    "fit demo results/simulated/demo --out observer.yaml",
    "power demo -n 8 --experiments 50",
)
"""What else one protocol is run through."""


@dataclass(frozen=True)
class Runs:
    """What came out.

    Attributes
    ----------
    said : mapping
        Outputs of ``--json``, by command.
    events : mapping
        Lines of the session logs and of ``--events``, under ``log`` and ``events``.
    reports : mapping
        Reports of the cohorts, by protocol.
    """

    said: dict[str, list[dict[str, Any]]]
    events: dict[str, list[dict[str, Any]]]
    reports: dict[str, bytes]


def protocols() -> list[Path]:
    """Return the shipped protocols, the paper's first."""
    return sorted((ROOT / "protocols").glob("*.yaml"), key=lambda file: (file.stem != PAPER, file.stem))


@cache
def run_all() -> Runs:
    """Run them in one folder, as a lab has it."""
    said, events, reports = defaultdict(list), defaultdict(list), {}
    # Paths in reports and outputs are those of a lab, from its own folder.
    with TemporaryDirectory() as folder, chdir(folder):
        one, told = Path("one"), Path("events.jsonl")
        # Who gets levels of their own has had the session that finds the threshold.
        for protocol in sorted((file.stem for file in protocols()), key=lambda each: each == "sensation_levels"):
            for words in [
                f"check {protocol}",
                f"run {protocol} -p p01 --rig simulated --answers simulated -y --plain --results {one} --events {told}",
                f"simulate {protocol} -n {COHORT.get(protocol, 6)} --results results",
                f"analyse results/simulated/{protocol} --out report",
                *(_MORE if protocol == "demo" else ()),
            ]:
                done = CliRunner().invoke(app, [*words.split(), "--json"])
                if done.exit_code:
                    raise RuntimeError(f"modaltouch {words} ended with {done.exit_code}: {done.output}")
                said[words.partition(" ")[0]].append(json.loads(done.stdout))
            events["events"] += _lines(told)
            told.unlink()
            reports[protocol] = Path("report", "report.html").read_bytes()
        for log in one.rglob("session.jsonl"):
            events["log"] += _lines(log)
    return Runs(dict(said), dict(events), reports)


def _lines(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
