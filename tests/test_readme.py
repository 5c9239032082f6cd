"""The README is correct: its commands and code run, and the files it mentions exist."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from stops import HARDWARE_ENDS
from Xlib import XK, X, display
from Xlib.ext import xtest

from modaltouch.window.machine import virtual_display

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
GENERATOR = "TCPIP::192.168.1.20::INSTR"
INTERRUPTED = "-p p01"
"""The session that is interrupted, since the README resumes it."""


def console_lines():
    """Return every command of the README, without its comment."""
    blocks = re.findall(r"```console\n(.*?)```", TEXT, flags=re.DOTALL)
    lines = [line.removeprefix("$ ") for block in blocks for line in block.splitlines() if line.startswith("$ ")]
    return [line.partition("  #")[0].strip() for line in lines]


@contextmanager
def typing_on(name):
    """Type Space and the left arrow alternately on a display."""
    connection, stop = display.Display(name), threading.Event()
    codes = [connection.keysym_to_keycode(XK.string_to_keysym(key)) for key in ("space", "Left")]

    def type_on():
        while not stop.wait(0.1):
            for code in codes:
                for kind in (X.KeyPress, X.KeyRelease):
                    xtest.fake_input(connection, kind, code)
                    connection.sync()
                    time.sleep(0.02)

    thread = threading.Thread(target=type_on, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        connection.close()


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A folder with the shipped protocols (the paper's shortened) and a simulated generator."""
    folder = tmp_path_factory.mktemp("lab")
    shutil.copytree(ROOT / "protocols", folder / "protocols")
    file = folder / "protocols" / "differentiated_stimulation.yaml"
    text = file.read_text(encoding="utf-8")
    for long, short in (
        ("[80, 100, 150, 200]", "[200]"),
        ("practice_trials: 3", "practice_trials: 0"),
        ("selected_modes: 6", "selected_modes: 4"),
        ("question_delay_s: 0.5", "question_delay_s: 0.05"),
        ("pause_s: 1.5", "pause_s: 0.05\n  settling_s: 0.05"),
    ):
        assert long in text
        text = text.replace(long, short)
    file.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "modaltouch", "rig", "simulate"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as rig:
        yield folder, rig.stdout.readline().strip()
        rig.terminate()


def answers_in(folder):
    """Count the answers recorded under a folder."""
    return sum(log.read_bytes().count(b'"event":"trial"') for log in folder.rglob("session.jsonl"))


def run(line, folder, address, environment):
    """Run a README command with the simulated generator instead of the lab's; return its exit status."""
    # Sessions at a simulated generator are recorded in the tree of simulated sessions.
    line = line.replace(GENERATOR, address).replace("results/diff", "results/simulated/diff")
    words = shlex.split(line)
    command = [sys.executable, "-m", "modaltouch", *words[1:]]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(command, cwd=folder, env=environment, text=True, **pipes) as process:
        if INTERRUPTED in line:
            end = time.monotonic() + 60
            while answers_in(folder) < 2 and process.poll() is None and time.monotonic() < end:
                time.sleep(0.01)
            process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=600)
    return process.returncode, said


@pytest.mark.window
@pytest.mark.timeout(1500)
def test_every_command_of_the_readme_works_in_order(lab):
    """From `check` to `analyse` at a simulated generator; the session is interrupted and resumed."""
    folder, address = lab
    commands = [line for line in console_lines() if line.startswith("modaltouch ")]
    assert len(commands) >= 7
    with virtual_display((1280, 800)) as name, typing_on(name):
        environment = {**os.environ, "DISPLAY": name, "MPLBACKEND": "agg"}
        for line in commands:
            begin = time.monotonic()
            status, said = run(line, folder, address, environment)
            print(f"{time.monotonic() - begin:6.1f} s  {line}")
            assert status == (130 if INTERRUPTED in line and "run" in line else 0), f"{line}\n{said}"
            assert "Traceback" not in said


def test_the_make_targets_of_the_readme_exist():
    """`make -n` accepts `demo` and `test`."""
    targets = [line.split()[1] for line in console_lines() if line.startswith("make ")]
    assert targets == ["demo", "test"]
    for target in targets:
        subprocess.run(["make", "-n", target], cwd=ROOT, check=True, capture_output=True)


def test_every_link_of_the_readme_has_a_target():
    """The files and headings of all relative links and pictures exist."""
    for target in re.findall(r"\]\(([^)\s]+)\)", TEXT):
        if target.startswith("http"):
            continue
        path, _, heading = target.partition("#")
        file = ROOT / (path or "README.md")
        assert file.exists(), target
        if heading:
            headings = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
            slugs = {re.sub(r"[^\w -]", "", each.lower()).replace(" ", "-") for each in headings}
            assert heading in slugs, target


def test_speed_and_accuracy_in_the_readme_match_the_results():
    """The speed relative to other methods, the error to the target, and the saving and cost of fewer samples."""
    told = TEXT.replace("\n", " ")
    points = json.loads((ROOT / "results" / "benchmarks" / "tradeoff.json").read_text())["points"]

    def taken(figure, n_samples, **like):
        (value,) = (
            each[figure] for each in points if {"n_samples": n_samples, "n_modes": 9, **like}.items() <= each.items()
        )
        return value

    ours = {"task": "predicting", "who": "engine, state at t_F"}
    assert taken("error", 125_000, **ours) < 1e-15
    (faster,) = re.findall(r"more than (\d+) times faster than with plain NumPy", told)
    assert taken("time_ms", 125_000, task="predicting", who="plain NumPy") > int(faster) * taken(
        "time_ms", 125_000, **ours
    )
    assert taken("time_ms", 125_000, task="predicting", who="lsim, one call") > 1000 * taken("time_ms", 125_000, **ours)
    made = {"task": "making", "bits": "14 bits, settled", "law": "exact"}
    papers = taken("error", 125_000, task="making", bits="14 bits", law="paper")
    assert "by a factor of more than a million" in told and papers > 1e6 * taken("error", 125_000, **made)
    few, all_of_them = (
        {each["who"]: each for each in points if each["task"] == "command" and each["n_samples"] == n}
        for n in (12_500, 125_000)
    )
    for who in ("check", "simulate", "verify"):
        assert few[who]["time_ms"] > 0.9 * all_of_them[who]["time_ms"]
        assert few[who]["error"] / all_of_them[who]["error"] == pytest.approx(30, rel=0.15)


def test_figures_in_the_readme_match_the_results():
    """Minutes of a first demonstration, time until the beam is at rest, and level remaining under fingers."""
    doorstep = json.loads((ROOT / "results" / "benchmarks" / "doorstep.json").read_text())["trials"]
    seconds = [trial["seconds"] for trial in doorstep if trial["way"] == "clone" and trial["load"] == 0]
    assert f"about {round(max(seconds) / 60)} minutes" in TEXT
    designs = json.loads((ROOT / "results" / "benchmarks" / "fingers.json").read_text())["designs"]["A-C"]
    for name in ("free", "typical"):
        said = f"{designs[name]['level_mean_percent']:.0f} % ± {designs[name]['level_sd_percent']:.0f} %"
        assert said in TEXT.replace("\n", " ")
    assert designs["known"]["level_mean_percent"] == pytest.approx(100)
    stops = json.loads((ROOT / "results" / "benchmarks" / "stops.json").read_text())
    assert stops["n_safe"] == stops["n"] == 1000
    assert f"comes to rest within {HARDWARE_ENDS:g} s" in TEXT.replace("\n", " ")
