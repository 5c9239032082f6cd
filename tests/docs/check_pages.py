"""Every command and every snippet of the site is run, and its pages are looked at. Part of ``make docs-check``.

A page is a folder: its blocks run there in their order. ``$`` begins a command; what stands below it must appear in
what the command says, line by line, where ``...`` skips any number of lines. A block of Python goes on where the one
before it ended. A YAML block with a file for a caption is that file. A comment ``% needs:`` names what a page needs.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from browser import CHROMIUM, Browser

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
SITE = Path(os.environ.get("MODALTOUCH_SITE", ROOT / "build" / "docs"))
WRITTEN = sorted(
    page
    for page in DOCS.rglob("*.md")
    if not page.is_relative_to(DOCS / "generated") and "```" in page.read_text("utf-8")
)

SHORTER = {
    "power": "--experiments 50",
    "identify": "--averages 1",
    "validate": "--averages 2 --points 26",
    "compare": "--averages 2 --points 26 --beams 0",
}
"""What is added to the long commands: no averages that no check needs, as few points as tell the modes apart."""

BLOCK = re.compile(r"^```(\{code-block\} )?(\w+)\n((?::\w+:.*\n)*)\n?(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(page):
    """Yield language, caption and text of every block of a page."""
    for found in BLOCK.finditer(page.read_text(encoding="utf-8")):
        caption = re.search(r":caption: (.*)", found.group(3))
        yield found.group(2), caption.group(1).strip() if caption else "", found.group(4)


def commands(text):
    """Yield each command of a console block, its status and the lines that it must say."""
    command, said = "", []
    for line in [*text.splitlines(), "$ "]:
        if line.startswith("$ "):
            if command:
                status = re.search(r"# exit status (\d+)", command)
                yield command.partition("  #")[0], int(status.group(1)) if status else 0, said
            command, said = line[2:].strip(), []
        elif line.strip():
            said.append(line)


def squeezed(line):
    """Return a line without what differs from terminal to terminal."""
    return " ".join(re.sub(r"[│┃─━┏┳┓┡╇┩└┴┘|]", " ", line).split())


def lacking(expected, said):
    """Return the first expected line that was not said in its order; empty where all were."""
    lines = iter([squeezed(line) for line in said.splitlines()])
    for line in expected:
        pattern = ".*".join(map(re.escape, squeezed(line).split("...")))
        if squeezed(line) and not any(re.fullmatch(pattern, each) for each in lines):
            return line
    return ""


def run(command, folder):
    """Run a command in a folder, with this program in front of all others; return its status and what it says."""
    words = command.split()
    place = next((i + 1 for i, word in enumerate(words) if word == "modaltouch"), None)
    if place is not None and words[place] in SHORTER:
        command = f"{command} {SHORTER[words[place]]}"
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "MPLBACKEND": "agg",
                                "PYTHONPATH": str(ROOT / "src"), "COLUMNS": "110"}  # fmt: skip
    done = subprocess.run(
        command, shell=True, cwd=folder, env=environment, text=True, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=1500, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: str(page.relative_to(DOCS).with_suffix("")))
def test_every_block_of_a_page_does_what_it_says(page, tmp_path, monkeypatch):
    """In a folder that holds nothing but what the page makes, and the shipped protocols."""
    shutil.copytree(ROOT / "protocols", tmp_path / "protocols")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names = {}
    for language, caption, text in blocks(page):
        if language == "yaml" and caption:
            Path(caption).parent.mkdir(parents=True, exist_ok=True)
            Path(caption).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(compile(text, str(page), "exec"), names)
        elif language == "console":
            for command, status, expected in commands(text):
                if command.startswith("make "):
                    subprocess.run(["make", "-n", command.split()[1]], cwd=ROOT, check=True, capture_output=True)
                    continue
                ended, said = run(command, tmp_path)
                assert ended == status, f"{command}\n{said}"
                assert "Traceback" not in said
                assert lacking(expected, said) == "", f"{command}\n{said}"


@pytest.fixture(scope="module")
def browser():
    """A headless browser, where there is one."""
    if CHROMIUM is None:
        pytest.skip("no Chromium: apt-get install chromium")
    with Browser() as opened:
        yield opened


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_no_page_is_wider_than_its_window_or_complains(browser, width, dark):
    """Every page, wide and on a phone, in light and dark colours; nothing is loaded from elsewhere."""
    wide = []
    for page in sorted(SITE.rglob("*.html")):
        browser.open(page, width, dark=dark)
        if browser.run("document.documentElement.scrollWidth > innerWidth"):
            wide.append(str(page.relative_to(SITE)))
    assert wide == []
    assert browser.problems == []
