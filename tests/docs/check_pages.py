"""Runs every command and code block of the site, and checks its pages in a browser. Part of ``make docs-check``.

A page has a folder, in which its blocks run in order. ``$`` starts a command; the lines below it must appear in its
output, in order; ``...`` matches any text. A Python block continues the one before it. A YAML block with a file name as
caption is that file.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from html import unescape
from pathlib import Path

import pytest
from browser import CHROMIUM, Browser

import modaltouch

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
    "compare": "--averages 2 --points 26 --beams 1",
}
"""What is added to the long commands: no averages that no check needs, as few points as tell the modes apart."""

BLOCK = re.compile(r"^```(\{code-block\} )?(\w+)\n((?::\w+:[^\n]*\n)*)\n?(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(page):
    """Yield language, caption and text of every block of a page."""
    for found in BLOCK.finditer(page.read_text(encoding="utf-8")):
        caption = re.search(r":caption: (.*)", found.group(3))
        yield found.group(2), caption.group(1).strip() if caption else "", found.group(4)


def commands(text):
    """Yield each command of a console block, its exit status and the lines it must print."""
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
    """Return a line without characters that depend on the terminal."""
    return " ".join(re.sub(r"[│┃─━┏┳┓┡╇┩└┴┘|]", " ", line).split())


def first_missing(expected, said):
    """Return the first expected line that is missing or out of order; empty if there is none."""
    lines = iter([squeezed(line) for line in said.splitlines()])
    for line in expected:
        pattern = ".*".join(map(re.escape, squeezed(line).split("...")))
        if squeezed(line) and not any(re.fullmatch(pattern, each) for each in lines):
            return line
    return ""


def run(command, folder):
    """Run a command in a folder, with this program first on the path.

    Returns its status, its output, and the folder it ends in.
    """
    words = command.split()
    place = next((i + 1 for i, word in enumerate(words) if word == "modaltouch"), None)
    if place is not None and words[place] in SHORTER:
        command = f"{command} {SHORTER[words[place]]}"
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "MPLBACKEND": "agg",
                                "PYTHONPATH": str(ROOT / "src"), "COLUMNS": "110"}  # fmt: skip
    done = subprocess.run(
        f'{command}\nstatus=$?; printf "\\n%s" "$PWD"; exit $status', shell=True, cwd=folder, env=environment,
        text=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=1500,
        check=False,
    )  # fmt: skip
    said, _, left_in = done.stdout.rpartition("\n")
    return done.returncode, said, Path(left_in)


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: str(page.relative_to(DOCS).with_suffix("")))
def test_every_block_of_a_page_works_as_shown(page, tmp_path, monkeypatch):
    """The folder holds only the shipped protocols and what the page creates."""
    shutil.copytree(ROOT / "protocols", tmp_path / "protocols")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names, folder = {}, tmp_path
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
                ended, said, folder = run(command, folder)
                assert ended == status, f"{command}\n{said}"
                assert "Traceback" not in said
                assert first_missing(expected, said) == "", f"{command}\n{said}"


def test_every_internal_link_of_the_site_works():
    """The files and anchors of all links, pictures and scripts exist, also those in raw HTML."""
    anchors, dead = {}, []
    for page in SITE.rglob("*.html"):
        anchors[page] = set(re.findall(r'\bid="([^"]+)"', page.read_text(encoding="utf-8")))
    for page in anchors:
        for target in re.findall(r'\b(?:href|src)="([^"]+)"', page.read_text(encoding="utf-8")):
            if re.match(r"[a-z]+:", target):
                continue
            path, _, anchor = unescape(target).partition("#")
            file = (page.parent / path.partition("?")[0]).resolve() if path else page
            if not file.exists() or (anchor and file in anchors and anchor not in anchors[file]):
                dead.append(f"{page.relative_to(SITE)}: {target}")
    assert dead == []


@pytest.fixture(scope="module")
def browser():
    """A headless browser, if installed."""
    if CHROMIUM is None:
        pytest.skip("no Chromium: apt-get install chromium")
    with Browser() as opened:
        yield opened


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_no_page_overflows_or_logs_an_error(browser, width, dark):
    """Every page on a desktop and on a phone, in light and dark colours; nothing is loaded from other hosts."""
    wide = []
    for page in sorted(SITE.rglob("*.html")):
        browser.open(page, width, dark=dark)
        if browser.run("document.documentElement.scrollWidth > innerWidth"):
            wide.append(str(page.relative_to(SITE)))
    assert wide == []
    assert browser.problems == []


def speeds_shown(browser, finger):
    """Return the speeds that the page shows at a finger: at the focusing instant, and the maximum [mm/s]."""
    cells = browser.run(f"[...document.querySelectorAll('#field-row-{finger} td')].map((each) => each.textContent)")
    return [float(cell.removesuffix(" mm/s")) for cell in cells[2:]]


def dragged(browser, name, places):
    """Drag a handle of the field along the beam by the given millimetres, with the mouse."""
    box = f"document.querySelector('[data-name={name}] circle, [data-name={name}] path').getBoundingClientRect()"
    x, y, width, height, scale = browser.run(
        f"(() => {{ const b = {box}; const s = document.querySelector('#field svg').getBoundingClientRect();"
        "return [b.x, b.y, b.width, b.height, s.width / 720]; })()"
    )
    x, y = x + width / 2, y + height / 2
    browser.mouse("mousePressed", x, y)
    browser.mouse("mouseMoved", x + places * 6.28 * scale / 2, y)
    browser.mouse("mouseMoved", x + places * 6.28 * scale, y)
    browser.mouse("mouseReleased", x + places * 6.28 * scale, y)


def test_the_interactive_field_agrees_with_the_engine(browser):
    """Untouched and under fingers, for the paper's modes and for others; with mouse, check boxes and keys."""
    from generator.field import typical_finger

    stimulus = modaltouch.examine("differentiated_stimulation").require().stimulus
    browser.open(SITE / "look" / "field.html")
    for finger, place in (("left", -0.04), ("right", 0.0)):
        at_focus = float(stimulus.velocity_at_focus([place], 0.2)[0]) * 1e3
        highest = float(stimulus.peak_velocity([place], 0.2)[0]) * 1e3
        assert speeds_shown(browser, finger) == pytest.approx([at_focus, highest], abs=0.2)
    browser.run("document.querySelector('#field-heavy').click()")
    beam = stimulus.touched((typical_finger(-40), typical_finger(0)))
    under = beam.velocity_at_focus([-0.04, 0.0], stimulus.volts_per_code(0.2)) * 1e3
    assert [speeds_shown(browser, finger)[0] for finger in ("left", "right")] == pytest.approx(under.tolist(), abs=0.2)
    browser.run("document.querySelector('#field-heavy').click()")
    for mode in (4, 6, 8):
        browser.run(f"document.querySelectorAll('[data-mode]')[{mode}].click()")
    few = replace(stimulus, target_field=replace(stimulus.target_field, selection=(1, 3, 5, 7, 9, 11, 17)))
    at_focus = float(few.velocity_at_focus([-0.04], 0.2)[0]) * 1e3
    assert speeds_shown(browser, "left")[0] == pytest.approx(at_focus, abs=0.2)
    browser.run("document.querySelector('#field-reset').click()")
    dragged(browser, "right", 20)
    assert browser.run("document.querySelector('#field-right').value") == "20"
    at_d = float(stimulus.peak_velocity([0.02], 0.2)[0]) * 1e3
    assert speeds_shown(browser, "right")[1] == pytest.approx(at_d, abs=0.2)
    dragged(browser, "focus", -10)
    assert browser.run("document.querySelector('#field-focus').value") == "-10"
    assert browser.run("Number(document.querySelector('#field').dataset.reached)") == pytest.approx(200, abs=0.01)
    browser.run("document.querySelector('#field-left').focus()")
    before = browser.run("document.querySelector('#field-left').value")
    browser.press("ArrowRight", code=39)
    assert browser.run("document.querySelector('#field-left').value") == str(int(before) + 1)
    assert browser.problems == []


def test_the_interactive_page_is_usable_by_keyboard(browser):
    """Tab visits the four sliders, nine modes, the finger box and the button, each with a focus ring."""
    browser.open(SITE / "look" / "field.html")
    browser.run("document.querySelector('#field-focus').focus()")
    seen = []
    for _ in range(15):
        seen.append(browser.run("document.activeElement.id || document.activeElement.dataset.mode || ''"))
        assert browser.run("getComputedStyle(document.activeElement).outlineStyle") == "solid"
        browser.press("Tab", code=9)
    expected = [
        "field-focus",
        "field-level",
        "field-left",
        "field-right",
        *map(str, range(9)),
        "field-heavy",
        "field-reset",
    ]
    assert seen == expected
