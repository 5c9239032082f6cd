"""Times of a session: start of the window, the runner between an answer and the next burst, the console.

Run by hand: ``python tests/benchmarks/bench_window.py``. Writes results/benchmarks/window.json, each bar with the
measured value and whether it is met. On a machine without a display it uses a virtual one, and the results state it;
frames then do not wait for a monitor.
"""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from bars import at_most, write

ROOT = Path(__file__).resolve().parents[2]
N_TRIALS = 40
IDLE = 2.0
"""Duration of a frame on the screen [s]."""
SETTLED = 0.75
"""Time during which a window that has just appeared may be exposed and redrawn [s]."""

OPEN = """
import time
from pathlib import Path
from modaltouch.protocol import Findings
from modaltouch.protocol.trial import Condition, Trial
from modaltouch.window import WindowOptions
class Shown(Exception): pass
experiment = Findings.read(Path("protocols/demo.yaml")).experiment()
polls = []
def tick():
    polls.append(time.time())
    raise Shown
window = WindowOptions().open(experiment.protocol, experiment.texts, zones=experiment.apparatus.zone_spans,
                              tick=tick, log=lambda event, **facts: None)
try:
    window.welcome(Trial(1, 0, Condition("one_hand", "A", "C", 80.0), practice=True))
except Shown:
    print(polls[0], time.process_time())
window.close()
"""


def measure_start(n_starts: int = 5) -> tuple[list[float], list[float]]:
    """Return the times from the start of the interpreter to the first screen, and the processor time of them [s]."""
    walls, processor = [], []
    for _ in range(n_starts):
        began = time.time()
        done = subprocess.run([sys.executable, "-c", OPEN], cwd=ROOT, capture_output=True, text=True, check=True)
        shown, spent = map(float, done.stdout.split())
        walls.append(shown - began)
        processor.append(spent)
    return walls, processor


def write_protocol(folder: Path) -> Path:
    """Write a protocol with one pair, so that only runner and pause are between two trials."""
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


def measure_trials(folder: Path, *, with_console: bool) -> dict[str, np.ndarray[Any, Any]]:
    """Return the times of each trial of a session answered through the real window [s]."""
    from modaltouch.preflight import examine
    from modaltouch.session.setup import begin
    from modaltouch.session.wiring import wire_run

    preflight = examine(write_protocol(folder))
    setup = wire_run(preflight, "p01", answers="robot", results=folder / f"results{with_console:d}")
    with console_on_a_terminal() if with_console else silence() as console:
        session = begin(replace(setup, console=console))
    events = session.trials
    fired = next(event for event in session.events if event["event"] == "fired")
    answered = np.array([e["confirmed"]["onset"] + e["response"]["reaction_time"] for e in events])
    armed = np.array([e["confirmed"]["onset"] for e in events])
    answers = preflight.experiment.protocol.answers
    return {
        "start_to_first_burst": np.array([fired["clock"] - session.start["clock"]]),
        "end_of_pause_to_next_burst_armed": armed[1:] - answered[:-1] - answers.pause_s,
        "question_late": np.array([e["response"]["question_after"] for e in events]) - answers.question_delay_s,
        "time_uncertainty": np.array([e["response"]["time_uncertainty"] for e in events]),
    }


@contextmanager
def console_on_a_terminal() -> Iterator[Any]:
    """Yield the live console on a separate terminal, which is read continuously."""
    import threading

    from modaltouch.session.console.consoles import TerminalConsole

    master, slave = pty.openpty()

    def read() -> None:
        try:
            while os.read(master, 65536):
                pass
        except OSError:
            return

    threading.Thread(target=read, daemon=True).start()
    console = TerminalConsole(slave, slave)
    try:
        yield console
    finally:
        console.close()
        os.close(slave)
        os.close(master)


@contextmanager
def silence() -> Iterator[Any]:
    """Yield no console."""
    from modaltouch.session.console import Console

    yield Console()


def count_idle_frames() -> int:
    """Return how many frames are drawn while a question waits for its answer and nothing changes."""
    from modaltouch.protocol import Findings
    from modaltouch.window import WindowOptions

    experiment = Findings.read(ROOT / "protocols" / "demo.yaml").experiment()
    frames: list[float] = []
    end = [0.0]

    def tick() -> None:
        if end[0] and time.perf_counter() > end[0]:
            raise TimeoutError

    with WindowOptions().open(
        experiment.protocol,
        experiment.texts,
        zones=experiment.apparatus.zone_spans,
        tick=tick,
        log=lambda event, **facts: None,
    ) as window:
        display = window._loop._display  # type: ignore[attr-defined]
        flip = display.flip
        display.flip = lambda *words: (frames.append(time.perf_counter()), flip(*words))[1]
        end[0] = time.perf_counter() + IDLE
        try:
            window.announce("start")
        except TimeoutError:
            return len([frame for frame in frames if frame > end[0] - IDLE + SETTLED])
    raise AssertionError("the window did not wait")


def summarise(values: Any) -> dict[str, float]:
    """Return median, 95th percentile and maximum [ms], and every value."""
    values = np.asarray(values) * 1e3
    return {
        "median_ms": round(float(np.median(values)), 2),
        "p95_ms": round(float(np.quantile(values, 0.95)), 2),
        "max_ms": round(float(values.max()), 2),
        "n": len(values),
        "raw_ms": [round(float(value), 3) for value in values],
    }


def main() -> int:
    """Measure, print and write the figures."""
    from modaltouch.window.display_loop import Robot
    from modaltouch.window.machine import some_display

    with some_display() as where, tempfile.TemporaryDirectory() as folder:
        starts, processor = measure_start()
        alone = measure_trials(Path(folder), with_console=False)
        watched = measure_trials(Path(folder), with_console=True)
        idle = count_idle_frames()
    start, overhead = summarise(starts), summarise(alone["end_of_pause_to_next_burst_armed"])
    # Two screens of instructions, finger placement, and "start": the time for reading them is the participant's.
    reading = 4 * signature(Robot).parameters["patience"].default
    first = summarise(alone["start_to_first_burst"] - reading)["median_ms"]
    beside = summarise(watched["time_uncertainty"])
    bars = [
        at_most("from the start of the interpreter to the first screen, median", start["median_ms"], 3000, "ms"),
        at_most("from the start of a session to its first burst, without reading time", first, 3000, "ms"),
        at_most("from the pause after an answer to the next armed burst, 95th percentile", overhead["p95_ms"], 5, "ms"),
        at_most(f"frames drawn in {IDLE - SETTLED:g} s without any change", idle, 0, "frames"),
        at_most(
            "longest wait of a key for its time stamp beside the live console, 95th percentile",
            beside["p95_ms"],
            5,
            "ms",
        ),
    ]
    figures = {
        "display": where.split(" (")[0],
        "start_of_interpreter_to_first_screen": start,
        "processor_time_to_first_screen": summarise(processor),
        **{name: summarise(values) for name, values in alone.items()},
        **{f"{name}_beside_the_console": summarise(values) for name, values in watched.items()},
    }
    return write("window", figures, bars)


if __name__ == "__main__":
    sys.exit(main())
