"""How long the analysis takes and how much memory it needs, against the number of trials.

Writes ``results/benchmarks/analysis.json``. Every run is a process of its own, imports included, on synthetic answers
of a stated seed. The exponent is the slope of log CPU time over log trials, less the time of the smallest table.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.preflight import Preflight, examine, examine_findings
from modaltouch.protocol import Findings
from modaltouch.protocol.schedule import Schedule
from modaltouch.protocol.source import Source
from modaltouch.protocol.trial import Condition, Trial
from modaltouch.record.chain import GENESIS, encode_line
from modaltouch.record.files import make_folder
from modaltouch.record.folders import Mode, SessionFolder
from modaltouch.record.session import Session
from modaltouch.record.view import write_view
from modaltouch.session.events import describe_start

ROOT = Path(__file__).parents[2]
SHARES = {("A", "C"): (0.02, 0.06, 0.92), ("B", "D"): (0.25, 0.70, 0.05), ("C", "E"): (0.93, 0.06, 0.01)}
ANSWERS = ("left", "both", "right")
LEVELS = (80, 100, 150, 200)
CONDITIONS = ("one_hand", "two_hands")
CHILD = """
import json, resource, sys, time
from modaltouch.analysis.pipeline import analyse
result = analyse(sys.argv[1], sys.argv[2])
usage = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps({"cpu_s": usage.ru_utime + usage.ru_stime, "peak_MB": usage.ru_maxrss / 1024,
                  "n_responses": result.as_dict()["n_responses"], "n_left_out": len(result.responses.left_out)}))
"""


def write_table(path: Path, n_participants: int, n_repetitions: int, seed: int = 1) -> int:
    """Write a synthetic CSV and return its number of answers."""
    rng = np.random.default_rng(seed)
    with path.open("w", encoding="utf-8") as file:
        file.write("participant,finger_condition,zone_left,zone_right,velocity_mm_s,response,repetition\n")
        for i in range(n_participants):
            for condition in CONDITIONS:
                for (left, right), shares in SHARES.items():
                    words = rng.choice(3, (len(LEVELS), n_repetitions), p=shares)
                    for level, row in zip(LEVELS, words.tolist(), strict=True):
                        for r, word in enumerate(row, 1):
                            file.write(f"p{i:05d},{condition},{left},{right},{level},{ANSWERS[word]},{r}\n")
    return n_participants * n_repetitions * 24


def write_tree(root: Path, n_sessions: int, n_repetitions: int, seed: int = 1) -> None:
    """Write session logs of the paper's protocol, every tenth incomplete, damaged, pilot or simulated in turn.

    Orders, amplitudes and speeds are the true ones, since the analysis leaves out what does not follow from a log's own
    start record; the answers are synthetic.
    """
    text = (ROOT / "protocols" / "differentiated_stimulation.yaml").read_text(encoding="utf-8")
    sources = examine(ROOT / "protocols" / "differentiated_stimulation.yaml").experiment.sources
    repeated = text.replace("repetitions: 1", f"repetitions: {n_repetitions}")
    sources = replace(sources, protocol=Source(sources.protocol.path, repeated))
    preflight = examine_findings(Findings.restored(sources)).require()
    rng = np.random.default_rng(seed)
    for i in range(n_sessions):
        kind = ("incomplete", "damaged", "pilot", "simulated")[i // 10 % 4] if i % 10 == 0 else "sound"
        mode: Mode = kind if kind in ("pilot", "simulated") else "real"  # type: ignore[assignment]
        place = SessionFolder(root, mode, "differentiated_stimulation", f"p{i:05d}")
        schedule = Schedule.draw(preflight.experiment.protocol, place.participant, seed)
        about = {"seed": seed, "rig_choice": "TCPIP::1::INSTR", "answers_choice": "window", "rig": {"identity": "AFG"}}
        start = {**describe_start(preflight, schedule, place), "schema": 1, "versions": {}, "boot": "", **about}
        events: list[dict[str, Any]] = [{"event": "start", **start}]
        trials = (*schedule.practice, *schedule.trials[: -4 if kind == "incomplete" else None])
        for trial in trials:
            answer = ANSWERS[rng.choice(3, p=SHARES[trial.condition.pair])]
            events += _presented(preflight, trial, answer)
        data, check = b"", GENESIS
        for n, event in enumerate(events, 1):
            events[n - 1] = {"n": n, "time": "2026-01-02T10:00:00+00:00", "clock": float(n), **event}
            line, check = encode_line(events[n - 1], check)
            data += line
        make_folder(place.folder)
        place.log.write_bytes(data.replace(b'"answer":"both"', b'"answer":"BOTH"') if kind == "damaged" else data)
        write_view(place, Session(place.log, tuple(events)), {"lines": len(events), "check": check})


def _presented(preflight: Preflight, trial: Trial, answer: str) -> list[dict[str, Any]]:
    """Return the lines of one trial."""
    values, amplitudes, (left, right) = trial.as_dict(), *_figures(preflight, trial.condition)
    confirmed = {"commanded_amplitude": amplitudes, "confirmed_amplitude": amplitudes, "confirmed": True}
    fired = {"event": "fired", "trial": values, "confirmed": confirmed}
    response = {"answer": answer, "reaction_time": 0.8, "onset": "first_burst", "way": "", "answered_by": "participant"}
    planned = {"velocity_mm_s": trial.condition.velocity_mm_s, "speed_left_mm_s": left, "speed_right_mm_s": right}
    return [
        fired,
        {"event": "trial", "trial": values, "presentation": 1, "fingers": list(trial.condition.fingers("right")),
         "planned": planned, "commanded": {"amplitude_Vpp": amplitudes}, "confirmed": confirmed, "response": response,
         "supersedes": None},
    ]  # fmt: skip


@lru_cache
def _figures(preflight: Preflight, condition: Condition) -> tuple[list[float], tuple[float, float]]:
    """Return the amplitudes [V peak to peak] and the speeds under the fingers [mm/s] of a condition."""
    left, right = preflight.speeds(Trial(1, 1, condition))
    amplitudes = preflight.stimulus.burst.amplitude_for(condition.velocity_mm_s * 1e-3)
    return list(amplitudes), (round(left * 1e3, 3), round(right * 1e3, 3))


def measure(source: Path, out: Path) -> dict[str, Any]:
    """Return what one analysis costs in a process of its own."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    started = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(source), str(out)],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
    )
    return {"wall_s": round(time.perf_counter() - started, 2), **json.loads(done.stdout)}


def spend(command: list[str]) -> float:
    """Return the processor time of a process of its own [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def bar(what: str, measured: float | None, highest: float) -> dict[str, Any]:
    """Return whether a figure stays below its bar; None where it could not be measured."""
    return {
        "what": what,
        "bar": highest,
        "measured": measured,
        "met": None if measured is None else measured <= highest,
    }


def main() -> None:
    """Measure and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--participants", type=int, nargs="+", default=[10, 500, 1000, 2000])
    parser.add_argument("--repetitions", type=int, default=10)
    parser.add_argument("--sessions", type=int, default=1000)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks" / "analysis.json")
    options = parser.parse_args()
    rows = []
    numpy_s = min(spend([sys.executable, "-c", "import numpy"]) for _ in range(5))
    with tempfile.TemporaryDirectory() as scratch:
        for n in options.participants:
            table = Path(scratch) / f"{n}.csv"
            write_table(table, n, options.repetitions)
            rows.append({"participants": n, **measure(table, Path(scratch) / f"out{n}")})
            print(rows[-1])
        write_table(Path(scratch) / "ten.csv", 10, 1)
        write_tree(Path(scratch) / "ten", 11, 1)
        ratios = {
            kind: min(
                spend([sys.executable, "-m", "modaltouch", "analyse", str(Path(scratch) / name)]) for _ in range(3)
            )
            / numpy_s
            for kind, name in (("a table", "ten.csv"), ("sessions", "ten"))
        }
        print(ratios)
        write_tree(Path(scratch) / "results", options.sessions, options.repetitions)
        tree = {"sessions": options.sessions, **measure(Path(scratch) / "results", Path(scratch) / "tree")}
        print(tree)
    base = rows[0]["cpu_s"]
    large = [row for row in rows[1:] if row["cpu_s"] > base]
    trials = np.log([row["n_responses"] for row in large])
    exponent = (
        float(np.polyfit(trials, np.log([row["cpu_s"] - base for row in large]), 1)[0]) if len(large) > 1 else None
    )
    results = {
        "what": "modaltouch analyse, whole command with imports, figures and report; synthetic answers, seed 1; wall "
        "time only means something where the load average is near zero",
        "machine": {
            "python": platform.python_version(),
            "system": platform.platform(),
            "cores": os.cpu_count(),
            "load_average": [round(load, 1) for load in os.getloadavg()],
        },
        "tables": rows,
        "exponent_of_cpu_time_beyond_the_smallest": exponent,
        "tree": tree,
        "bars": [
            *(
                bar("CPU time of 1,000 participants [s]", row["cpu_s"], 10.0)
                for row in rows
                if row["participants"] == 1000
            ),
            *(
                bar(f"CPU time of ten participants from {kind}: times import numpy", round(ratio, 1), 20)
                for kind, ratio in ratios.items()
            ),
            bar(f"CPU time of a tree of {options.sessions} sessions [s]", tree["cpu_s"], 10.0),
            bar("exponent of CPU time over trials", exponent, 1.25),
        ],
    }
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    print(f"exponent {exponent}; written to {options.out}")


if __name__ == "__main__":
    main()
