"""A command loads only what it uses: the lines of modaltouch it leaves loaded are bounded."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import modaltouch

DEMO = "demo"
PROGRAM = """
import json, sys
from modaltouch.__main__ import main
try:
    main(sys.argv[1:])
except SystemExit as left:
    assert not left.code, left.code
files = {name: module.__file__ for name, module in sys.modules.items() if name.partition(".")[0] == "modaltouch"}
sys.stderr.write("LOADED " + json.dumps(files))
"""


def load(*words):
    """Return the modules of modaltouch that a command leaves loaded, and their number of lines."""
    command = [sys.executable, "-c", PROGRAM, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=150, check=True)
    files = json.loads(done.stderr.split("LOADED ")[1])
    return {name.removeprefix("modaltouch.") for name in files}, sum(
        len(Path(file).read_text("utf-8").splitlines()) for file in files.values()
    )


def rooms(modules):
    """Return the packages that contain the modules."""
    return {name.partition(".")[0] for name in modules}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Results with one session."""
    folder = tmp_path_factory.mktemp("results")
    modaltouch.simulate_session(DEMO, "p01", folder)
    return folder


def test_a_simulated_session_loads_neither_lab_nor_analysis_nor_screen(tmp_path):
    """Nor a network, a watchdog process, a scope, a keyboard, or what few protocols, resumption or faults need."""
    loaded, lines = load("simulate", DEMO, "-n", 1, "--results", tmp_path, "--json")
    assert not rooms(loaded) & {"lab", "analysis", "report"}
    assert not loaded & {
        "planning.power",
        "preflight.designs",
        "preflight.results",
        "protocol.calibration",
        "protocol.catch_trials",
        "protocol.latin_squares",
        "protocol.levels",
        "protocol.wording",
        "record.audit",
        "rig.scope",
        "rig.simulator.faults",
        "rig.simulator.vxi11",
        "rig.visa",
        "rig.watchdog_client",
        "session.console.__main__",
        "session.resumption",
        "stimulus.other_shapes",
        "stimulus.touched",
        "window.masking",
        "window.screen",
    }
    assert lines <= 19_500


def test_an_analysis_of_sessions_loads_only_reading_and_auditing(results, tmp_path):
    """The audit recomputes the drive as `verify` does; no code for playing, asking or planning is loaded."""
    loaded, lines = load("analyse", results, "--out", tmp_path / "out", "--json")
    assert not rooms(loaded) & {"lab", "planning", "session", "window"}
    assert not loaded & {"rig.generator", "rig.simulator", "analysis.tidy", "analysis.runs", "record.recovery"}
    assert lines <= 20_300


def test_check_loads_no_library_that_it_does_not_use():
    """A search for plugins would load e-mail and sockets; no valid file needs ruamel.yaml or SciPy, no table Rich."""
    program = (
        PROGRAM
        + """
sys.stderr.write(" ".join({"email", "socket", "ruamel", "scipy", "pandas", "psychopy", "rich"} & set(sys.modules)))
"""
    )
    command = [sys.executable, "-c", program, "check", DEMO]
    done = subprocess.run(command, capture_output=True, text=True, timeout=150, check=True)
    assert done.stderr.endswith("}")


@pytest.mark.parametrize("words", ["check nothing_there", "run nothing_there", "analyse nothing_there"])
def test_a_missing_file_is_reported_before_heavy_imports(words):
    """Importing NumPy takes two thirds of the time allowed for such an error, and pydantic as much."""
    program = PROGRAM.replace("    assert not left.code, left.code\n", "    assert left.code == 2\n").replace(
        'if name.partition(".")[0] == "modaltouch"',
        'if name in ("numpy", "pandas", "pydantic_core", "yaml", "rich")',
    )
    done = subprocess.run([sys.executable, "-c", program, *words.split()], capture_output=True, text=True, check=True)
    assert "nothing_there" in done.stderr
    assert done.stderr.endswith("LOADED {}")


def test_an_analysis_of_a_table_designs_nothing(tmp_path):
    """A CSV has no drive and no session, so no physics, instrument, protocol file or log is loaded."""
    rows = ["participant,finger_condition,zone_left,zone_right,velocity_mm_s,response"]
    rows += [f"p{n},one_hand,A,C,80,right" for n in range(3)]
    (tmp_path / "answers.csv").write_text("\n".join(rows) + "\n")
    loaded, lines = load("analyse", tmp_path / "answers.csv", "--out", tmp_path / "out", "--json")
    assert not rooms(loaded) & {"lab", "planning", "preflight", "rig", "session", "stimulus", "window"}
    assert not loaded & {"record.folders", "record.session"}
    assert lines <= 9_940


@pytest.mark.parametrize("command", ["analyse", "verify", "rig", "new"])
def test_a_command_loads_no_other(command):
    """Its module alone, in the package with what all commands share."""
    loaded, _ = load(command, "--help")
    others = {name for name in loaded if name.startswith("cli.")}
    module = {"verify": "records"}.get(command, command)
    assert others == {f"cli.{module}"}
