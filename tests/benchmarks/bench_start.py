"""The preflight of the paper's protocol, and how long commands take to start beside the interpreter and NumPy alone.

Writes ``results/benchmarks/start.json``. The preflight is the whole of it: design, synthesis and codes, prediction at
five zones for four levels, amplifier, generator and safety limits, the order of the trials; once for the protocol's
law, then for the other one too. One BLAS thread, tables of exponentials made anew each time. The commands are
processes of their own, best of several, in turns, bytecode caches warm. All times here are processor time, which other
work on the machine hardly changes.
"""

import math
import resource
import subprocess
import sys
import time
from pathlib import Path

from bars import at_least, at_most, write
from peers import race
from threadpoolctl import threadpool_limits

from modaltouch.preflight import examine_findings
from modaltouch.protocol import Findings
from modaltouch.stimulus import synthesis

ROOT = Path(__file__).resolve().parents[2]
PROTOCOL = "protocols/differentiated_stimulation.yaml"
IMPORTS = """
import importlib, sys
for name in sys.argv[1].split(","):
    try:
        importlib.import_module(name)
    except ImportError:
        pass
"""
FIRST = f"""
import time
from pathlib import Path
import modaltouch.__main__, modaltouch.cli.check, numpy.random
from modaltouch.preflight import examine_findings
from modaltouch.protocol import Findings
files = Findings.read(Path("{PROTOCOL}"))
start = time.process_time()
preflight = examine_findings(files)
assert preflight.stimuli and preflight.comparison()
print((time.process_time() - start) * 1e3)
"""
COMMANDS = {
    "interpreter": ["-c", "pass"],
    "import_numpy": ["-c", "import numpy"],
    "help": ["-m", "modaltouch", "--help"],
    "check": ["-m", "modaltouch", "check", PROTOCOL],
    "check_json": ["-m", "modaltouch", "check", PROTOCOL, "--json"],
}
HEAVY = ("psychopy", "pyvisa", "pandas", "matplotlib", "scipy", "statsmodels")
ROUNDS = 9


def examine(files: Findings, *, both: bool) -> None:
    """Do the whole preflight, for the protocol's drive law or for both."""
    synthesis._ladders.cache_clear()
    synthesis._by_life.cache_clear()
    preflight = examine_findings(files)
    figures = preflight.stimuli + (preflight.comparison() if both else [])
    assert len(figures) == 4 * (1 + both) and all(len(each["zone_peak_mm_s"]) == 5 for each in figures)


def output(arguments: list[str]) -> tuple[float, subprocess.CompletedProcess[str]]:
    """Return the processor time of one process [s], and what it said."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, check=True, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done


def imported(arguments: list[str]) -> list[str]:
    """Return the modules that a process imports, in order of their ends."""
    report = output(["-X", "importtime", *arguments])[1].stderr
    lines = [line.rsplit("|", 1)[-1].strip() for line in report.splitlines() if line.startswith("import time:")]
    return lines[1:]


def main() -> int:
    """Run the benchmark and write its figures."""
    files = Findings.read(ROOT / PROTOCOL)
    with threadpool_limits(1):
        preflight = race(
            {"one_law_ms": lambda: examine(files, both=False), "both_laws_ms": lambda: examine(files, both=True)},
            seconds=4.0,
            clock=time.process_time,
        )
    preflight["both_laws_first_in_a_process_ms"] = min(float(output(["-c", FIRST])[1].stdout) for _ in range(ROUNDS))
    modules = {name: imported(COMMANDS[name]) for name in ("help", "check")}
    heavy = {name: sorted({each.split(".")[0] for each in some} & set(HEAVY)) for name, some in modules.items()}
    commands = {**COMMANDS, "imports_of_check": ["-c", IMPORTS, ",".join(modules["check"])]}
    best = dict.fromkeys(commands, math.inf)
    for _ in range(ROUNDS):
        for name, arguments in commands.items():
            best[name] = min(best[name], output(arguments)[0])
    share = best["imports_of_check"] / best["check"]
    bars = [
        at_most("preflight of the paper's protocol, both laws", preflight["both_laws_ms"], 20, "ms"),
        at_most("the same, first in a fresh process", preflight["both_laws_first_in_a_process_ms"], 20, "ms"),
        at_least("modaltouch check: share of its process spent on start and imports", share, 0.5, ""),
        at_most("modaltouch --help: times import numpy", best["help"] / best["import_numpy"], 3),
        at_most(
            "modaltouch --help and check: import of psychopy", sum("psychopy" in each for each in heavy.values()), 0
        ),
    ]
    results = {
        "preflight": preflight,
        "processes_ms": {name: value * 1e3 for name, value in best.items()},
        "heavy_imports": heavy,
    }
    return write("start", results, bars)


if __name__ == "__main__":
    sys.exit(main())
