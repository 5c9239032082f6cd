"""Time and memory of the analysis against the number of trials.

Writes ``results/benchmarks/analysis.json``. Every run is a separate process, imports included, on synthetic answers
with a given seed; trees contain sessions of the paper's design, every tenth incomplete, damaged, pilot or simulated.
"""

from __future__ import annotations

import argparse
import json
import os
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
from bars import at_most, write

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

    Orders, amplitudes and velocities are the true ones, since the analysis excludes trials that disagree with the log's
    start record; the answers and their reaction times are random.
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
            answer = ANSWERS[rng.choice(3, p=SHARES[trial.condition.zones])]
            events += _presented(preflight, trial, answer, round(rng.lognormal(-0.2, 0.4), 4))
        data, check = b"", GENESIS
        for n, event in enumerate(events, 1):
            events[n - 1] = {"n": n, "time": "2026-01-02T10:00:00+00:00", "clock": float(n), **event}
            line, check = encode_line(events[n - 1], check)
            data += line
        make_folder(place.folder)
        place.log.write_bytes(data.replace(b'"answer":"both"', b'"answer":"BOTH"') if kind == "damaged" else data)
        write_view(place, Session(place.log, tuple(events)), {"lines": len(events), "check": check})


def _presented(preflight: Preflight, trial: Trial, answer: str, reaction_time: float) -> list[dict[str, Any]]:
    """Return the lines of one trial, answered after the reaction time [s]."""
    values, amplitudes, (left, right) = trial.as_dict(), *_figures(preflight, trial.condition)
    confirmed = {"commanded_amplitude": amplitudes, "confirmed_amplitude": amplitudes, "confirmed": True}
    fired = {"event": "fired", "trial": values, "confirmed": confirmed}
    response = {"answer": answer, "reaction_time": reaction_time, "onset": "first_burst", "way": "",
                "answered_by": "participant"}  # fmt: skip
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
    """Return the cost of one analysis in a separate process."""
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
    """Return the processor time of a separate process [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def exponent(rows: list[dict[str, Any]], of: str) -> float:
    """Return the slope of log CPU time over log size, after subtracting the time of the smallest."""
    base, *larger = rows
    sizes, times = [row[of] for row in larger], [row["cpu_s"] - base["cpu_s"] for row in larger]
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def main() -> int:
    """Measure and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--participants", type=int, nargs="+", default=[10, 500, 1000, 2000])
    parser.add_argument("--sessions", type=int, nargs="+", default=[10, 300, 1000, 3000])
    options = parser.parse_args()
    tables, trees = [], []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for n in options.participants:
            write_table(folder / f"{n}.csv", n, 10)
            tables.append({"participants": n, **measure(folder / f"{n}.csv", folder / f"table{n}")})
            print(tables[-1])
        write_table(folder / "million.csv", 42, 1000)
        million = measure(folder / "million.csv", folder / "million")
        print(million)
        for n in options.sessions:
            write_tree(folder / f"results{n}", n, 1)
            trees.append({"sessions": n, **measure(folder / f"results{n}", folder / f"tree{n}")})
            print(trees[-1])
    of_thousand = {name: [row["cpu_s"] for row in rows if 1000 in row.values()]
                   for name, rows in (("participants", tables), ("sessions", trees))}  # fmt: skip
    promises = [
        *(
            at_most(f"processor time of analyse for 1,000 {name}", cpu, 10, "s")
            for name, found in of_thousand.items()
            for cpu in found
        ),
        at_most("exponent of processor time over trials", exponent(tables, "n_responses"), 1.25, ""),
        at_most("exponent of processor time over sessions", exponent(trees, "sessions"), 1.05, ""),
        at_most(
            "memory for the most sessions, relative to the fewest", trees[-1]["peak_MB"] / trees[0]["peak_MB"], 1.45
        ),
        at_most("processor time of analyse for 42 participants with 1,000 repetitions", million["cpu_s"], 30, "s"),
        at_most("memory of analyse for 42 participants with 1,000 repetitions", million["peak_MB"], 1000, "MB"),
    ]
    return write("analysis", {"tables": tables, "million_answers": million, "trees": trees}, promises)


if __name__ == "__main__":
    sys.exit(main())
