"""Data sets of every shipped protocol and example, judged by the BIDS validator.

``python tests/record/bids.py --validator build/bids/bin/bids-validator-deno --out results/benchmarks/bids.json``
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]

ARGUED = {
    "NO_AUTHORS", "TOO_FEW_AUTHORS", "License", "SourceDatasets", "HEDVersion", "CogAtlasID", "CogPOID",
    "InstitutionName", "InstitutionAddress", "InstitutionalDepartmentName", "TaskDescription", "Instructions",
}  # fmt: skip
"""Warnings whose reasons docs/howto/share.md gives: what they miss, a lab adds or nobody needs."""


def record_sessions(results: Path) -> None:
    """Simulate two participants of each protocol, with one session interrupted, one resumed and one damaged."""
    shipped = sorted((ROOT / "protocols").glob("*.yaml"), key=lambda path: path.stem != "threshold")
    for path in (*shipped, *sorted((ROOT / "docs" / "examples").glob("protocol_*.yaml"))):
        print(path.name, flush=True)
        _modaltouch("simulate", path, "-n", "2", "--results", results)
    for participant in ("interrupted", "resumed"):
        _interrupt(results, participant)
    _modaltouch("resume", results / "simulated" / "demo" / "sub-resumed" / "ses-1", "-y", "--plain")
    damaged = results / "simulated" / "magnitude" / "sub-sim02" / "ses-1" / "beh" / "session.jsonl"
    damaged.write_bytes(damaged.read_bytes().replace(b'"value":', b'"value":1', 1))


def _modaltouch(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "modaltouch", *map(str, words)], check=True, capture_output=True)


def _interrupt(results: Path, participant: str) -> None:
    """Kill a session of the protocol demo after a few answers."""
    words = ("run", "demo", "-p", participant, "--rig", "simulated", "--answers", "simulated", "-y", "--plain")
    command = [sys.executable, "-m", "modaltouch", *words, "--results", str(results)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as session:
        log = results / "simulated" / "demo" / f"sub-{participant}" / "ses-1" / "beh" / "session.jsonl"
        while session.poll() is None and not (log.exists() and log.read_text("utf-8").count('"event":"trial"') > 4):
            time.sleep(0.002)
        session.kill()
    if session.returncode != -signal.SIGKILL:
        raise SystemExit(f"the session of {participant} ended before it could be interrupted; run this again")


def judge(validator: Path, dataset: Path) -> tuple[str, set[tuple[str, str]]]:
    """Return the version of the BIDS rules, and the severity and code of each issue that the validator reports."""
    done = subprocess.run([validator, "--json", dataset], capture_output=True, text=True, check=False)
    found: dict[str, Any] = json.loads(done.stdout)
    if not found["summary"]["totalFiles"]:
        raise SystemExit(f"{dataset}: the validator read no file")
    issues = {
        (issue["severity"], issue["subCode"] if issue["code"].endswith("_KEY_RECOMMENDED") else issue["code"])
        for issue in found["issues"]["issues"]
    }
    return found["summary"]["schemaVersion"], issues


def main() -> int:
    """Record and validate the sessions, write the result; exit 1 on an error or a warning without a stated reason."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--validator", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder)
        record_sessions(results)
        datasets = sorted(path for path in (results / "simulated").iterdir() if path.is_dir())
        judged = {dataset.name: judge(options.validator.absolute(), dataset) for dataset in datasets}
        n_sessions = sum(1 for _ in results.rglob("session.jsonl"))
    issues = {name: found for name, (_, found) in judged.items()}
    every = set().union(*issues.values())
    wrong = {
        name: sorted(own) for name, found in issues.items() if (own := [one for one in found if not _is_argued(one)])
    }
    told = {
        "rules": judged["demo"][0],
        "n_datasets": len(issues),
        "n_sessions": n_sessions,
        "datasets with errors": sum(any(kind == "error" for kind, _ in own) for own in issues.values()),
        "warnings with a reason": sorted(code for kind, code in every if _is_argued((kind, code))),
        "others": wrong,
    }
    options.out.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(told, indent=2))
    return int(bool(wrong))


def _is_argued(issue: tuple[str, str]) -> bool:
    return issue[0] == "warning" and issue[1] in ARGUED


if __name__ == "__main__":
    raise SystemExit(main())
