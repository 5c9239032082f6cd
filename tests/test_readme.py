"""What the README says is so: its commands and code run, what it names exists."""

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
from Xlib import XK, X, display
from Xlib.ext import xtest

from modaltouch.window.environment import virtual_display

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
GENERATOR = "TCPIP::192.168.1.20::INSTR"
INTERRUPTED = "-p p01"
"""The session that is interrupted, since the README resumes it."""

SHORTER = {
    "power": "--experiments 50",
    "prereg": "--experiments 50",
    "identify": "--averages 1 --points 11",
    "validate": "--averages 2 --points 11",
    "compare": "--averages 2 --points 11 --beams 0",
}
"""What is added to the long commands: no averages that no test needs, as few points as tell the modes apart."""

BEYOND = r"^  - \{label: (9|1\d), .*\n"
"""The modes that the lab's beam does without: what a fit costs grows with the highest of them and with their number."""


def console_lines():
    """Return every command of the README, without its comment."""
    blocks = re.findall(r"```console\n(.*?)```", TEXT, flags=re.DOTALL)
    lines = [line.removeprefix("$ ") for block in blocks for line in block.splitlines() if line.startswith("$ ")]
    return [line.partition("  #")[0].strip() for line in lines]


@contextmanager
def hurried_hands(name):
    """Type Space and the left arrow in turn on a display."""
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
    """A folder with the shipped protocols, the paper's made short, a beam of four modes, and a simulated generator."""
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
    beam = folder / "protocols" / "apparatus" / "beam_100x6x2.yaml"
    text, n_left_out = re.subn(BEYOND, "", beam.read_text(encoding="utf-8"), flags=re.MULTILINE)
    text, n_unlisted = re.subn(r"unlisted_modes:.*\n(    - .*\n)+", "unlisted_modes: []\n", text)
    assert (n_left_out, n_unlisted) == (5, 1)
    beam.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "modaltouch", "rig", "simulate"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as rig:
        yield folder, rig.stdout.readline().strip()
        rig.terminate()


def answers_in(folder):
    """Count the answers recorded under a folder."""
    return sum(log.read_bytes().count(b'"event":"trial"') for log in folder.rglob("session.jsonl"))


def run(line, folder, address, environment):
    """Run a command of the README with the simulated generator in the place of the lab's; return its exit status."""
    # What is recorded at a simulated generator lands in the simulated tree.
    line = line.replace(GENERATOR, address).replace("results/diff", "results/simulated/diff")
    words = shlex.split(line)
    words += SHORTER.get(words[1], "").split()
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


BEAM = ("identify", "validate", "calibrate", "--calibration", "compare")
"""What marks the commands that are for somebody's own beam."""


@pytest.mark.window
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("of_the_beam", [False, True])
def test_every_command_of_the_readme_works_in_its_order(lab, of_the_beam):
    """From `doctor` to `compare`, at a simulated generator; the first session is interrupted and resumed."""
    folder, address = lab
    commands = [line for line in console_lines() if line.startswith("modaltouch ")]
    commands = [line for line in commands if any(word in line for word in BEAM) is of_the_beam]
    assert len(commands) >= (5 if of_the_beam else 10)
    with virtual_display((1280, 800)) as name, hurried_hands(name):
        environment = {**os.environ, "DISPLAY": name, "MPLBACKEND": "agg"}
        for line in commands:
            begin = time.monotonic()
            status, said = run(line, folder, address, environment)
            print(f"{time.monotonic() - begin:6.1f} s  {line}")
            assert status == (130 if INTERRUPTED in line and "run" in line else 0), f"{line}\n{said}"
            assert "Traceback" not in said
    assert (folder / "calibration.yaml").is_file() is of_the_beam


def test_the_targets_of_make_are_there():
    """`make demo` and `make test` would run."""
    targets = [line.split()[1] for line in console_lines() if line.startswith("make ")]
    assert targets == ["demo", "test"]
    for target in targets:
        subprocess.run(["make", "-n", target], cwd=ROOT, check=True, capture_output=True)


def test_the_code_of_the_readme_runs(tmp_path):
    """The snippets in a process of their own, away from the repository but for the protocols."""
    shutil.copytree(ROOT / "protocols", tmp_path / "protocols")
    for code in re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL):
        environment = {**os.environ, "MPLBACKEND": "agg"}
        command = [sys.executable, "-c", code]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120, check=False
        )
        assert done.returncode == 0, done.stderr
        assert "24 answers in results" in done.stdout


def test_what_the_readme_links_to_exists():
    """Files and headings of every relative link and picture."""
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


def test_every_protocol_named_is_shipped_and_every_one_shipped_is_named():
    """The table of protocols."""
    named = set(re.findall(r"`protocols/(\w+\.yaml)`", TEXT))
    assert named == {path.name for path in (ROOT / "protocols").glob("*.yaml")}


def test_every_room_has_its_line():
    """The table of rooms names every folder of the package that is one, and there is nothing beside them."""
    table = TEXT.partition("| room | does |")[2].partition("\n\n")[0]
    named = set(re.findall(r"^\| `(\w+)` \|", table, flags=re.MULTILINE))
    package = ROOT / "src" / "modaltouch"
    assert {path.parent.name for path in package.glob("*/__init__.py")} == named
    assert {path.name for path in package.glob("*.py")} == {"__init__.py", "__main__.py"}
