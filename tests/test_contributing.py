"""The code and changes shown in CONTRIBUTING.md work, and the files it points to exist."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from modaltouch.analysis import STATISTICS

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
DECISIONS = ROOT / "src" / "modaltouch" / "decisions"


def blocks(language):
    """Return the code blocks of a language, in order."""
    return re.findall(rf"```{language}\n(.*?)```", TEXT, flags=re.DOTALL)


def changed(folder, number):
    """Copy source and protocols, and apply one of the changes shown."""
    for name in ("src", "protocols"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    apply = ["git", "apply", "-C1", "-"]
    diff = blocks("diff")[number]
    applied = subprocess.run(apply, cwd=folder, input=diff, text=True, capture_output=True, check=False)
    assert applied.returncode == 0, applied.stderr


def run_in(folder, program):
    """Run a program with the changed source; return what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder,
        env={"PYTHONPATH": str(folder / "src")},
        text=True,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_shown_change_adds_a_field_shape(tmp_path):
    """The change applies to a copy of the source, and a protocol with the new shape passes the check."""
    changed(tmp_path, 0)
    protocol = tmp_path / "protocols" / "differentiated_stimulation.yaml"
    text = protocol.read_text(encoding="utf-8")
    protocol.write_text(text.replace("shape: triangle", "shape: parabola"), encoding="utf-8")
    program = "import modaltouch; print(len(modaltouch.examine('protocols/differentiated_stimulation.yaml').problems))"
    assert run_in(tmp_path, program) == "0\n"


def test_the_shown_change_adds_a_generator(tmp_path):
    """A session runs on its twin, its own sample limit is checked, and its own command switches the outputs off."""
    changed(tmp_path, 1)
    beam = tmp_path / "protocols" / "apparatus" / "keysight_33522b.yaml"
    beam.write_text(beam.read_text(encoding="utf-8").replace("model: 33522B", "model: WG2"), encoding="utf-8")
    protocol = tmp_path / "protocols" / "demo.yaml"
    text = protocol.read_text(encoding="utf-8").replace("beam_100x6x2", "keysight_33522b")
    protocol.write_text(text, encoding="utf-8")
    protocol.with_name("long.yaml").write_text(
        text.replace("\nstimulus:\n", "\nstimulus:\n  n_samples: 200002\n", 1), encoding="utf-8"
    )
    program = """
from pathlib import Path
from modaltouch import examine
from modaltouch.rig import instrument_of
from modaltouch.session.setup import begin
from modaltouch.session.wiring import wire_run

preflight = examine("protocols/demo.yaml").require()
session = begin(wire_run(preflight, "p01", answers="simulated", results=Path("results")))
print(session.complete, session.start["rig"]["identity"])
print(instrument_of(preflight.experiment.apparatus).off)
print(*examine("protocols/long.yaml").problems)
"""
    complete, off, _, refused = run_in(tmp_path, program).splitlines()
    assert complete == "True ACME,WG2,SIMULATED,1.0"
    assert off == ":OUTP1:REL OFF;:OUTP2:REL OFF;:OUTP1:REL?;:OUTP2:REL?"
    assert "given 200002; allowed: at most 200000, the points of a record of the WG2" in refused


def test_the_shown_code_adds_a_generator_an_answer_device_and_a_statistic(tmp_path, monkeypatch):
    """The code blocks run one after another, assertions included."""
    monkeypatch.chdir(ROOT)
    namespace = {"results": tmp_path}
    code = blocks("python")
    assert len(code) == 4
    try:
        for block in code:
            exec(compile(block, "CONTRIBUTING.md", "exec"), namespace)
    finally:
        STATISTICS.pop("both", None)


def test_the_foot_switch_keys_shown_are_valid(edit):
    """A protocol with the keys shown passes the check."""
    from modaltouch.preflight import examine

    (block,) = blocks("yaml")
    keys = yaml.safe_load(block)["keys"]
    file = edit(
        "demo.yaml", ("    left: [left, num_4]\n    both: [up, down, num_8]\n    right: [right, num_6]", str(keys))
    )
    text = file.read_text(encoding="utf-8").replace("keys:\n{", "keys: {")
    file.write_text(text, encoding="utf-8")
    assert examine(file).problems == ()
    assert examine(file).experiment.protocol.answers.keys["both"] == ("f2",)


def test_every_make_target_shown_exists():
    """Each `make` target in the text is in the Makefile."""
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    named = set(re.findall(r"make ([a-z]+)", TEXT))
    assert named
    assert named <= targets


@pytest.mark.parametrize("page", sorted(DECISIONS.glob("0*.md")), ids=lambda page: page.stem)
def test_a_decision_record_has_its_three_parts_on_one_page(page):
    """It has at most thirty lines and the number of its file name."""
    text = page.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 30
    assert text.startswith(f"# {int(page.stem[:4])}. ")
    for part in ("**Decision.**", "**Why.**", "**What follows.**"):
        assert part in text


def test_the_files_of_the_code_tour_exist():
    """At most 25 files lead from a level to its voltages, and 16 from a key to the figure."""
    tour = TEXT.partition("## A tour of the code")[2].partition("\n## ")[0]
    walks = [re.findall(r"`(\w+/\w+\.py)`", walk) for walk in tour.split("**An answer")]
    assert all((ROOT / "src" / "modaltouch" / file).is_file() for walk in walks for file in walk)
    for name, file in re.findall(r"`([A-Z]\w+)`\s+\(`(\w+/\w+\.py)`\)", tour):
        assert f"class {name}" in (ROOT / "src" / "modaltouch" / file).read_text(encoding="utf-8"), name
    assert [len(set(walk)) <= most for walk, most in zip(walks, (25, 16), strict=True)] == [True, True]
