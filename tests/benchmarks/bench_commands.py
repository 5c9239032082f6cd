"""Processor time of commands relative to that of ``import numpy`` in the same run.

Writes ``results/benchmarks/commands.json``. Every command is a separate process in a user's environment, in rotation,
with warm bytecode caches; the best of several runs counts. Processor time hardly depends on other load, and its ratio
to that of an import is about the same on other machines. Bars in seconds are processor time as well.
"""

import math
import os
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from bars import at_most, write
from bench_analysis import write_table

ROOT = Path(__file__).resolve().parents[2]
PROTOCOLS = ROOT / "protocols"
PAPER = "differentiated_stimulation.yaml"
HEAVY = ("psychopy", "pyvisa", "pandas", "matplotlib", "scipy", "statsmodels")
ROUNDS = 7
USERS = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
# As the commands set it themselves: starting threads of BLAS would double the cost of the import.
USERS["OPENBLAS_NUM_THREADS"] = "1"
"""Environment of the commands: settings of developers would have every module compiled each time."""
ON_THE_TWIN = (
    ("identify", [], "identify"),
    ("validate", [str(PROTOCOLS / PAPER)], "validate"),
    ("calibrate", [str(PROTOCOLS / PAPER)], "calibration.yaml"),
    ("compare", [str(PROTOCOLS / PAPER)], "compare"),
)
LATE = """
import statistics, sys, time
from modaltouch.record import log
ends, write = [], log.SessionLog.write_view
def timed(self, place):
    write(self, place)
    ends.append(time.process_time())
log.SessionLog.write_view = timed
from modaltouch.__main__ import main
try:
    main()
except SystemExit:
    pass
took = [after - before for before, after in zip(ends, ends[1:])]
print("late", statistics.median(took[-200:]) / statistics.median(took[50:250]))
"""


def run(arguments: list[str], status: int = 0) -> tuple[float, subprocess.CompletedProcess[str]]:
    """Return the processor time of one process [s], and its output."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, env=USERS)
    if done.returncode != status:
        raise SystemExit(f"{' '.join(arguments)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done


def written_with(folder: Path, line: str, other: str) -> str:
    """Write the paper's protocol with one line changed, and return its path."""
    text = (PROTOCOLS / PAPER).read_text(encoding="utf-8").replace(": apparatus/", f": {PROTOCOLS}/apparatus/")
    assert line in text
    text = text.replace(": texts/", f": {PROTOCOLS}/texts/").replace(line, other)
    path = folder / f"{other.replace(': ', '_').strip()}.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def with_repetitions(folder: Path, n_repetitions: int) -> str:
    """Write the paper's protocol with more repetitions, and return its path."""
    return written_with(folder, "repetitions: 1\n", f"repetitions: {n_repetitions}\n")


def main() -> int:
    """Run the benchmark and write its figures."""
    with tempfile.TemporaryDirectory() as scratch:
        folder, paper = Path(scratch), str(PROTOCOLS / PAPER)
        write_table(folder / "ten.csv", 10, 1)
        program = ["-m", "modaltouch"]
        commands = {
            "import_numpy": (["-c", "import numpy"], 0),
            "help": ([*program, "--help"], 0),
            "check_help": ([*program, "check", "--help"], 0),
            "check_of_no_file": ([*program, "check", "nothing"], 2),
            "analyse_of_no_file": ([*program, "analyse", "nothing"], 2),
            "check": ([*program, "check", paper], 0),
            "check_json": ([*program, "check", paper, "--json"], 0),
            "analyse_ten": ([*program, "analyse", str(folder / "ten.csv"), "--out", str(folder / "out")], 0),
            "check_of_2400_trials": ([*program, "check", with_repetitions(folder, 100)], 0),
            "check_of_24000_trials": ([*program, "check", with_repetitions(folder, 1000)], 2),
        }
        best = dict.fromkeys(commands, math.inf)
        for _ in range(ROUNDS):
            for name, (arguments, status) in commands.items():
                best[name] = min(best[name], run(arguments, status)[0])
        imports = run(["-X", "importtime", *program, "check", paper])[1].stderr
        heavy = sorted({line.rsplit("|", 1)[-1].strip() for line in imports.splitlines()} & set(HEAVY))
        session = [*program, "simulate", paper, "-n", "1", "--results"]
        best["session_of_24_trials"] = min(run([*session, str(folder / f"one{i}")])[0] for i in range(3))
        long = ["simulate", with_repetitions(folder, 42), "-n", "1", "--results"]
        lates = [run(["-c", LATE, *long, str(folder / f"long{turn}")])[1].stdout for turn in range(3)]
        late = sorted(float(re.findall(r"late (\S+)", each)[0]) for each in lates)[1]
        for name, subject, out in ON_THE_TWIN:
            again = [[*program, name, *subject, "--out", str(folder / f"{turn}{out}")] for turn in range(2)]
            best[name] = min(run(arguments)[0] for arguments in again)
    times = {name: value / best["import_numpy"] for name, value in best.items()}
    bars = [
        at_most("modaltouch --help", times["help"], 1.5, "imports of NumPy"),
        at_most("modaltouch check --help", times["check_help"], 1.5, "imports of NumPy"),
        at_most("check of a missing file", times["check_of_no_file"], 1.5, "imports of NumPy"),
        at_most("analyse of a missing file", times["analyse_of_no_file"], 1.5, "imports of NumPy"),
        at_most("check of the paper's protocol", times["check"], 4, "imports of NumPy"),
        at_most("analyse of ten participants", times["analyse_ten"], 20, "imports of NumPy"),
        at_most("check of 2,400 trials with max_same_pair_running: 2", best["check_of_2400_trials"], 2, "s"),
        at_most("refusal of 24,000 trials", best["check_of_24000_trials"], 20, "s"),
        at_most("a trial after 800 others, relative to one after 50", late, 1.1),
        at_most("imports of PsychoPy by check", float("psychopy" in heavy), 0, ""),
    ]
    for name, most in (("identify", 20), ("validate", 15), ("calibrate", 5), ("compare", 25)):
        bars.append(at_most(f"processor time of {name} on the twin", best[name], most, "s"))
    own = best["session_of_24_trials"] - best["check"]
    bars.append(at_most("processor time of a simulated session of 24 trials, without preflight", own, 0.5, "s"))
    results = {"processor_time_s": best, "times_import_numpy": times, "heavy_imports_of_check": heavy}
    return write("commands", results, bars)


if __name__ == "__main__":
    sys.exit(main())
