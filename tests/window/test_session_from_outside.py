"""A whole session through ``modaltouch run``, led from outside by real keys and clicks alone."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from modaltouch.window.virtual_display import virtual_display

pytestmark = [pytest.mark.window, pytest.mark.timeout(300)]
ROOT = Path(__file__).resolve().parents[2]
TITLE = "Demonstration"
BUTTONS = {"left": (320, 620), "both": (640, 620), "right": (960, 620)}
"""Middles of the answer buttons in a window of 1280 x 800 pixels, from its top left corner."""


@pytest.fixture(scope="module")
def empty_display() -> Iterator[str]:
    """Give a display with no other window on it, so that every key goes to the session."""
    with virtual_display((1920, 1080)) as name:
        yield name


@pytest.fixture
def outside_hands(empty_display: str, make_hands: Callable[[str], Any]) -> Any:
    """Give hands on that display."""
    return make_hands(empty_display)


@pytest.fixture
def process(empty_display: str, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a session of the demonstration for a person at the window."""
    command = [sys.executable, "-m", "modaltouch", "run", "protocols/demo.yaml", "-p", "p01", "--yes"]
    started = subprocess.Popen(
        [*command, "--results", str(tmp_path), "--json"],
        cwd=ROOT,
        env={**os.environ, "DISPLAY": empty_display},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with started:
        yield started
        started.kill()


def events(results: Path) -> list[dict[str, Any]]:
    """Return what the session log says so far, a line that is being written left out."""
    logs = list(results.rglob("session.jsonl"))
    if not logs:
        return []
    return [
        json.loads(line) for line in logs[0].read_text(encoding="utf-8").splitlines(keepends=True) if line[-1] == "\n"
    ]


def wait_for_window(hands: Any, process: subprocess.Popen[str]) -> None:
    """Return once the window is on the display."""
    end = time.monotonic() + 90
    while time.monotonic() < end and process.poll() is None:
        try:
            hands.find(TITLE)
        except LookupError:
            time.sleep(0.1)
        else:
            return
    raise TimeoutError(TITLE)


def test_keys_and_clicks_lead_through_a_whole_session(
    process: subprocess.Popen[str], outside_hands: Any, tmp_path: Path
) -> None:
    """Expected: twelve answers, those given, by key and by mouse in turn; every step by Enter."""
    wait_for_window(outside_hands, process)
    left, top = outside_hands.origin(TITLE)
    given: list[tuple[str, str]] = []
    end = time.monotonic() + 150
    while process.poll() is None and time.monotonic() < end:
        answer = ("left", "both", "right")[len(given) % 3]
        n_before = sum(event["event"] == "trial" for event in events(tmp_path))
        if len(given) % 2:
            x, y = BUTTONS[answer]
            outside_hands.click(left + x, top + y)
        else:
            outside_hands.key({"left": "Left", "both": "Up", "right": "Right"}[answer])
        time.sleep(0.25)
        if sum(event["event"] == "trial" for event in events(tmp_path)) > n_before:
            given.append((answer, "mouse" if len(given) % 2 else "key"))
        else:
            outside_hands.key("Return")
            time.sleep(0.15)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    log = events(tmp_path)
    trials = [event for event in log if event["event"] == "trial"]
    assert [(event["response"]["answer"], event["response"]["device"]) for event in trials] == given
    assert sum(not event["trial"]["practice"] for event in trials) == 12
    assert {event["response"]["answered_by"] for event in trials} == {"participant"}
    assert log[-1]["event"] == "stop"
    assert log[-1]["reason"] == "finished"
    assert json.loads(out)


@pytest.mark.parametrize(
    ("way", "returncode", "reason"), [("close button", 130, "window closed"), ("Ctrl-C", 130, "SIGINT")]
)
def test_a_session_that_is_ended_keeps_what_it_has(
    process: subprocess.Popen[str], outside_hands: Any, tmp_path: Path, way: str, returncode: int, reason: str
) -> None:
    """Expected: exit status 130 and the reason in the log, whether the window is closed or Ctrl-C pressed."""
    wait_for_window(outside_hands, process)
    while not events(tmp_path):
        time.sleep(0.05)
    if way == "Ctrl-C":
        process.send_signal(signal.SIGINT)
    else:
        outside_hands.press_close_button(TITLE)
    _, err = process.communicate(timeout=60)
    assert process.returncode == returncode, err
    assert "Traceback" not in err
    log = events(tmp_path)
    assert (log[-1]["event"], log[-1]["reason"]) == ("stop", reason)
