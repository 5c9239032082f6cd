"""A whole session by ``modaltouch run``, operated only by real keys and clicks."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from modaltouch.window.machine import virtual_display

pytestmark = [pytest.mark.window, pytest.mark.timeout(300)]
ROOT = Path(__file__).resolve().parents[2]
TITLE = "Differentiated haptic stimulation"
BUTTONS = {"left": (320, 620), "both": (640, 620), "right": (960, 620)}
"""Middles of the answer buttons in a window of 1280 x 800 pixels, from its top left corner."""
NOBODY = 65534
"""The user of no rights, on every Unix."""
AS_NOBODY = (
    "setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", "--bounding-set=-all,+dac_read_search",
    "--inh-caps=-all,+dac_read_search", "--ambient-caps=-all,+dac_read_search",
)  # fmt: skip
"""An ordinary user, who may only read what root may: the interpreter of the tests may lie in root's own folder."""


@pytest.fixture(scope="module")
def empty_display() -> Iterator[str]:
    """Provide a display without other windows, so that the session gets every key."""
    with virtual_display((1920, 1080)) as name:
        yield name


@pytest.fixture
def outside_hands(empty_display: str, make_hands: Callable[[str], Any]) -> Any:
    """Provide hands on that display."""
    return make_hands(empty_display)


@pytest.fixture
def protocol(edit: Callable[..., Path]) -> Path:
    """Provide six of the paper's trials without pauses."""
    return edit(
        "differentiated_stimulation.yaml",
        ("[80, 100, 150, 200]", "[200]"),
        ("question_delay_s: 0.5", "question_delay_s: 0.1"),
        ("pause_s: 1.5", "pause_s: 0.1\n  settling_s: 0.1"),
        ("practice_trials: 3", "practice_trials: 1"),
    )


@pytest.fixture
def start(empty_display: str, tmp_path: Path, protocol: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start a session in the window, as an ordinary user if asked and if the tests run as root."""
    opened: list[subprocess.Popen[str]] = []

    def begin(*, as_nobody: bool = False) -> subprocess.Popen[str]:
        home, results = tmp_path / "home", tmp_path / "results"
        for folder in (home, results):
            folder.mkdir()
        if as_nobody:
            for folder in (home, results):
                os.chown(folder, NOBODY, NOBODY)
            temporary = Path(tempfile.gettempdir())
            for folder in (each for each in (tmp_path, *tmp_path.parents) if temporary in each.parents):
                folder.chmod(0o755)
        words = [
            sys.executable,
            "-m",
            "modaltouch",
            "run",
            str(protocol),
            "-p",
            "p01",
            "--rig",
            "simulated",
            "--yes",
            "--json",
        ]
        opened.append(
            subprocess.Popen(
                [*(AS_NOBODY if as_nobody else ()), *words, "--results", str(results)],
                cwd=ROOT,
                env={**os.environ, "DISPLAY": empty_display, **({"HOME": str(home)} if as_nobody else {})},
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        return opened[-1]

    yield begin
    for process in opened:
        with process:
            process.kill()


def events(results: Path) -> list[dict[str, Any]]:
    """Return the complete lines of the session log so far."""
    logs = list(results.rglob("session.jsonl"))
    if not logs:
        return []
    return [
        json.loads(line) for line in logs[0].read_text(encoding="utf-8").splitlines(keepends=True) if line[-1] == "\n"
    ]


def wait_for_window(hands: Any, process: subprocess.Popen[str]) -> None:
    """Wait until the window is on the display."""
    end = time.monotonic() + 90
    while time.monotonic() < end and process.poll() is None:
        try:
            hands.find(TITLE)
        except LookupError:
            time.sleep(0.1)
        else:
            return
    ending = "" if process.poll() is None else f": ended with {process.returncode}, {process.communicate()}"
    raise TimeoutError(f"{TITLE}{ending}")


def test_a_whole_session_by_keys_and_clicks(
    start: Callable[..., subprocess.Popen[str]], outside_hands: Any, tmp_path: Path
) -> None:
    """Six answers as given, alternately by key and by mouse, by an ordinary user: as root, by nobody."""
    as_nobody = os.getuid() == 0
    process = start(as_nobody=as_nobody)
    wait_for_window(outside_hands, process)
    left, top = outside_hands.origin(TITLE)
    given: list[tuple[str, str]] = []
    end = time.monotonic() + 200
    while process.poll() is None and time.monotonic() < end:
        answer = ("left", "both", "right")[len(given) % 3]
        n_before = sum(event["event"] == "answered" for event in events(tmp_path))
        if len(given) % 2:
            x, y = BUTTONS[answer]
            outside_hands.click(left + x, top + y)
        else:
            outside_hands.key({"left": "Left", "both": "Up", "right": "Right"}[answer])
        time.sleep(0.25)
        if sum(event["event"] == "answered" for event in events(tmp_path)) > n_before:
            given.append((answer, "mouse" if len(given) % 2 else "key"))
        else:
            outside_hands.key("Return")
            time.sleep(0.15)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    log = events(tmp_path)
    trials = [event for event in log if event["event"] == "answered"]
    assert [(event["response"]["answer"], event["response"]["device"]) for event in trials] == given
    # A busy machine may have a trial presented once more.
    assert {event["trial"]["index"] for event in trials if not event["trial"]["practice"]} == set(range(1, 7))
    assert {event["response"]["answered_by"] for event in trials} == {"participant"}
    assert log[-1]["event"] == "stop"
    assert log[-1]["reason"] == "finished"
    assert json.loads(out)
    if as_nobody:
        log_file = next(tmp_path.rglob("session.jsonl"))
        assert log_file.stat().st_uid == NOBODY
        assert log_file.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize(
    ("way", "reason"), [("close button", "window closed"), ("Ctrl-C", "SIGINT"), ("F12", "emergency stop")]
)
def test_a_session_that_is_ended_early_keeps_its_record(
    start: Callable[..., subprocess.Popen[str]], outside_hands: Any, tmp_path: Path, way: str, reason: str
) -> None:
    """Exit status 130, and the reason in the log: window closed, Ctrl-C, or the emergency key."""
    process = start()
    wait_for_window(outside_hands, process)
    while not events(tmp_path):
        time.sleep(0.05)
    if way == "Ctrl-C":
        process.send_signal(signal.SIGINT)
    elif way == "F12":
        time.sleep(0.5)
        outside_hands.key("F12")
    else:
        outside_hands.press_close_button(TITLE)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    log = events(tmp_path)
    assert (log[-1]["event"], log[-1]["reason"]) == ("stop", reason)
