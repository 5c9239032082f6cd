"""What a session costs in time: start of the window, and the runner between an answer and the next burst.

Run by hand: ``python tests/benchmarks/bench_window.py``. Writes results/benchmarks/window.json. On a machine
without a display it runs on a virtual one and says so; frames then wait for no monitor.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
RESULT = ROOT / "results" / "benchmarks" / "window.json"
N_TRIALS = 40

OPEN = """
import time
from pathlib import Path
from modaltouch.protocol import read_protocol
from modaltouch.window import open_window
class Shown(Exception): pass
experiment = read_protocol(Path("protocols/demo.yaml"))
polls = []
def tick():
    polls.append(time.time())
    raise Shown
window = open_window("window", experiment.protocol, experiment.texts, zones=tuple(experiment.apparatus.zones),
                     tick=tick, log=lambda event, **facts: None)
try:
    window.welcome()
except Shown:
    print(polls[0])
window.close()
"""


def measure_start(n_starts: int = 5) -> list[float]:
    """Return the times from the start of the interpreter to the first screen [s]."""
    times = []
    for _ in range(n_starts):
        began = time.time()
        done = subprocess.run([sys.executable, "-c", OPEN], cwd=ROOT, capture_output=True, text=True, check=True)
        times.append(float(done.stdout) - began)
    return times


def write_protocol(folder: Path) -> Path:
    """Write a protocol of one pair, so that nothing but runner and pause stand between two trials."""
    text = (ROOT / "protocols" / "demo.yaml").read_text(encoding="utf-8")
    for old, new in (
        ("apparatus: apparatus", f"apparatus: {ROOT}/protocols/apparatus"),
        ("texts: texts", f"texts: {ROOT}/protocols/texts"),
        ("finger_conditions: [one_hand, two_hands]", "finger_conditions: [one_hand]"),
        ("zone_pairs: [[A, C], [B, D], [C, E]]", "zone_pairs: [[A, C]]"),
        ("repetitions: 1", f"repetitions: {N_TRIALS // 2}"),
        ("max_same_pair_running: 2", "max_same_pair_running: null"),
        ("break_after_trials: 6", "break_after_trials: null"),
        ("practice_trials: 1", "practice_trials: 0"),
    ):
        if old not in text:
            raise ValueError(f"protocols/demo.yaml has no {old!r} any more; bring this benchmark up to date")
        text = text.replace(old, new)
    path = folder / "bench.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def measure_trials(folder: Path) -> dict[str, np.ndarray[Any, Any]]:
    """Return, for each trial of a session answered through the real window, its times [s]."""
    from modaltouch.preflight import examine
    from modaltouch.sitting import begin
    from modaltouch.wiring import wire_run

    preflight = examine(write_protocol(folder))
    session = begin(wire_run(preflight, "p01", answers="robot", results=folder / "results"))
    events = session.trials
    answered = np.array([e["confirmed"]["onset"] + e["response"]["reaction_time"] for e in events])
    armed = np.array([e["confirmed"]["onset"] for e in events])
    answers = preflight.experiment.protocol.answers
    return {
        "answer_to_next_burst_beyond_the_pause": armed[1:] - answered[:-1] - answers.pause_s,
        "question_late": np.array([e["response"]["question_after"] for e in events]) - answers.question_delay_s,
        "time_uncertainty": np.array([e["response"]["time_uncertainty"] for e in events]),
    }


def summarise(values: Any) -> dict[str, float]:
    """Return median, 95th percentile and maximum [ms]."""
    values = np.asarray(values) * 1e3
    return {
        "median_ms": round(float(np.median(values)), 2),
        "p95_ms": round(float(np.quantile(values, 0.95)), 2),
        "max_ms": round(float(values.max()), 2),
        "n": len(values),
    }


def main() -> None:
    """Measure, print and write the figures."""
    from modaltouch.window.virtual_display import some_display

    load = os.getloadavg()[0]
    with some_display() as where, tempfile.TemporaryDirectory() as folder:
        starts = measure_start()
        trials = measure_trials(Path(folder))
    figures = {
        "display": where.split(" (")[0],
        "python": platform.python_version(),
        "n_cores": os.cpu_count(),
        "load_average_before": round(load, 2),
        "start_of_interpreter_to_first_screen": summarise(starts),
        **{name: summarise(values) for name, values in trials.items()},
    }
    RESULT.parent.mkdir(parents=True, exist_ok=True)
    RESULT.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    sys.stdout.write(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
