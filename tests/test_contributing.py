"""What CONTRIBUTING.md shows works, and what it points to is there."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
DECISIONS = ROOT / "src" / "modaltouch" / "decisions"


def blocks(language):
    """Return the code blocks of a language, in order."""
    return re.findall(rf"```{language}\n(.*?)```", TEXT, flags=re.DOTALL)


def test_a_field_shape_takes_the_lines_shown(tmp_path):
    """The change applies to a copy of the source, and the protocol is checked with the new shape."""
    for name in ("src", "protocols"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    (diff,) = blocks("diff")
    apply = ["git", "apply", "-C1", "-"]
    applied = subprocess.run(apply, cwd=tmp_path, input=diff, text=True, capture_output=True, check=False)
    assert applied.returncode == 0, applied.stderr
    protocol = tmp_path / "protocols" / "differentiated_stimulation.yaml"
    text = protocol.read_text(encoding="utf-8")
    protocol.write_text(text.replace("shape: triangle", "shape: parabola"), encoding="utf-8")
    program = "import modaltouch; print(len(modaltouch.examine('protocols/differentiated_stimulation.yaml').problems))"
    command = [sys.executable, "-c", program]
    checked = subprocess.run(
        command, cwd=tmp_path, env={"PYTHONPATH": str(tmp_path / "src")}, text=True, capture_output=True, check=False
    )
    assert checked.stdout == "0\n", checked.stderr


def test_a_generator_an_answer_device_and_a_statistic_take_the_code_shown(tmp_path, monkeypatch):
    """The blocks of code run one after the other, each with its own assertion."""
    monkeypatch.chdir(ROOT)
    namespace = {"results": tmp_path}
    code = blocks("python")
    assert len(code) == 3
    for block in code:
        exec(compile(block, "CONTRIBUTING.md", "exec"), namespace)


def test_the_keys_of_a_foot_switch_are_a_protocol(edit):
    """The YAML shown replaces the keys of a protocol."""
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


def test_every_target_named_exists():
    """`make` targets in the list are in the Makefile."""
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    named = set(re.findall(r"make ([a-z]+)", TEXT))
    assert named
    assert named <= targets


@pytest.mark.parametrize("page", sorted(DECISIONS.glob("0*.md")), ids=lambda page: page.stem)
def test_a_decision_says_what_why_and_what_follows_on_a_page(page):
    """At most thirty lines, numbered as its file."""
    text = page.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 30
    assert text.startswith(f"# {int(page.stem[:4])}. ")
    for part in ("**Decision.**", "**Why.**", "**What follows.**"):
        assert part in text


def test_the_tour_passes_files_that_are_there():
    """At most 25 files from a level to its volts, and 16 from a key to the figure."""
    tour = TEXT.partition("## A tour of the house")[2].partition("\n## ")[0]
    walks = [re.findall(r"`(\w+/\w+\.py)`", walk) for walk in tour.split("**An answer")]
    assert all((ROOT / "src" / "modaltouch" / file).is_file() for walk in walks for file in walk)
    assert [len(set(walk)) <= most for walk, most in zip(walks, (25, 16), strict=True)] == [True, True]
