"""A session in real time, through the window, on a twin in another process: the record against what was played.

``python tests/session/accounted.py --repetitions 10 --out results/benchmarks/accounted.json``
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

from modaltouch.record.session import Session, read_session
from modaltouch.window.machine import some_display

ROOT = Path(__file__).parents[2]
PROTOCOL = ROOT / "protocols" / "differentiated_stimulation.yaml"


def write_protocol(folder: Path, repetitions: int) -> Path:
    """Write the paper's protocol with more repetitions and no breaks, with the files that it refers to."""
    text = PROTOCOL.read_text(encoding="utf-8")
    for name in ("apparatus", "texts"):
        text = text.replace(f"{name}: {name}/", f"{name}: {PROTOCOL.parent}/{name}/")
    text = text.replace("repetitions: 1", f"repetitions: {repetitions}").replace("break_after_trials: 12\n", "")
    path = folder / "accounted.yaml"
    path.write_text(text.replace("protocol: differentiated_stimulation", "protocol: accounted"), encoding="utf-8")
    return path


def sit(folder: Path, repetitions: int) -> tuple[Session, list[dict[str, Any]]]:
    """Return a recorded session, and the bursts that the twin reports as played."""
    folder.mkdir(parents=True, exist_ok=True)
    played = folder / "played.jsonl"
    command = [sys.executable, "-m", "modaltouch", "rig", "simulate", "--played", str(played)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as twin:
        assert twin.stdout is not None
        address = twin.stdout.readline().strip()
        with contextlib.suppress(OSError, AttributeError):
            # A generator has a processor of its own.
            os.sched_setscheduler(twin.pid, os.SCHED_RR, os.sched_param(1))
        run = [sys.executable, "-m", "modaltouch", "run", str(write_protocol(folder, repetitions)), "-p", "p01"]
        options = ["--rig", address, "--answers", "robot", "--results", str(folder), "--yes", "--json"]
        with some_display():
            said = subprocess.run([*run, *options], stdout=subprocess.PIPE, text=True, check=True).stdout
        twin.terminate()
    session = read_session(Path(json.loads(said)["session"]) / "session.jsonl")
    return session, [json.loads(line) for line in played.read_text(encoding="utf-8").splitlines()]


def compare(session: Session, played: list[dict[str, Any]]) -> dict[str, Any]:
    """Compare the record of every presentation with the bursts played in it."""
    events = [event for event in session.events if event["event"] in ("trial", "trial_cut") and event.get("bursts")]
    wrong, outside, lengths, gaps, before = [], 0, [], [], 0.0
    for event in events:
        bursts = event["bursts"]
        own = [each for each in played if before < each["start_s"] <= event["clock"]]
        before = event["clock"]
        gaps += [b["start_s"] - a["start_s"] for a, b in zip(own, own[1:], strict=False)]
        if event["confirmed"]["confirmed"]:
            n_whole = sum(each["whole"] for each in own)
            amplitude = event["confirmed"]["confirmed_amplitude"]
            levels = {tuple(round(each, 3) for each in burst["amplitude_Vpp"]) for burst in own}
            if (len(own), n_whole) != (bursts["played"], bursts["whole"]) or levels != {
                tuple(round(each, 3) for each in amplitude)
            }:
                wrong.append(event["n"])
            outside += abs(own[0]["start_s"] - bursts["first_s"]) > bursts["uncertainty_s"]
            lengths.append(2e3 * bursts["uncertainty_s"])
    regular = [gap for gap in gaps if gap < 1.5 / 7]
    lengths.sort()
    confirmed = [event for event in events if event["confirmed"]["confirmed"]]
    return {
        "n_trials": session.n_answered,
        "n_presentations": len(events),
        "n_confirmed": len(confirmed),
        "n_bursts_played": len(played),
        "n_bursts_cut": sum(not each["whole"] for each in played),
        "n_bursts_recorded": sum(event["bursts"]["played"] or 0 for event in events),
        "n_bursts_dropped": sum(event["bursts"]["dropped"] or 0 for event in events),
        "trials_that_disagree": wrong,
        "first_bursts_outside_their_interval": outside,
        "interval_length_ms_median": round(statistics.median(lengths), 3),
        "interval_length_ms_p99": round(lengths[int(0.99 * (len(lengths) - 1))], 3),
        "burst_interval_ms_sd": round(1e3 * statistics.pstdev(regular), 3),
        "burst_interval_ms_mean": round(1e3 * statistics.fmean(regular), 4),
    }


def main() -> int:
    """Run the session, compare, and write the result."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--repetitions", type=int, default=10, help="of each of the paper's 24 conditions")
    parser.add_argument("--folder", type=Path, default=Path("build/accounted"))
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    number = 1
    while (folder := options.folder / str(number)).exists():
        number += 1
    session, played = sit(folder, options.repetitions)
    verified = subprocess.run([sys.executable, "-m", "modaltouch", "verify", str(session.path)], check=False)
    result = {**compare(session, played), "verified": verified.returncode == 0}
    text = json.dumps(result, indent=2)
    print(text)
    if options.out is not None:
        options.out.write_text(text + "\n", encoding="utf-8")
    holds = not result["trials_that_disagree"] and not result["n_bursts_cut"] and result["verified"]
    return 0 if holds and result["first_bursts_outside_their_interval"] <= 1e-3 * result["n_confirmed"] else 1


if __name__ == "__main__":
    sys.exit(main())
