"""A spoken session through ``modaltouch run``, led by real keys, its sound going to ALSA's null device."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from modaltouch.window.virtual_display import virtual_display

pytestmark = [
    pytest.mark.window,
    pytest.mark.timeout(200),
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="ALSA is Linux's"),
]
OLD = "answers:\n  given_by"


def events(results: Path) -> list[dict[str, Any]]:
    """Return what the session log says so far, a line that is being written left out."""
    return [
        json.loads(line)
        for log in results.rglob("session.jsonl")
        for line in log.read_text(encoding="utf-8").splitlines(keepends=True)
        if line[-1] == "\n"
    ]


@pytest.fixture
def own_display() -> Iterator[str]:
    """Give a display with no other window on it, so that every key goes to the session."""
    with virtual_display((1920, 1080)) as name:
        yield name


def test_a_spoken_session_is_answered_before_its_prompts_are_over(
    edit: Callable[..., Path], own_display: str, make_hands: Callable[[str], Any], tmp_path: Path
) -> None:
    """All trials answered; the record says who spoke, and of every prompt when it began and how much was heard."""
    (tmp_path / "asound.conf").write_text("pcm.!default { type null }\nctl.!default { type null }\n")
    sections = "speech: {screens: [instructions, question, goodbye]}\nmasking: {level_dB_FS: -25, fade_s: 0.1}\n"
    fewer = (("[[A, C], [B, D], [C, E]]", "[[A, C]]"), ("max_same_pair_running: 2", "max_same_pair_running: null"))
    protocol = edit("demo.yaml", (OLD, sections + OLD), *fewer)
    words = [
        "run",
        str(protocol),
        "-p",
        "p01",
        "--rig",
        "simulated",
        "--yes",
        "--json",
        "--results",
        str(tmp_path / "results"),
    ]
    hands = make_hands(own_display)
    env = {**os.environ, "DISPLAY": own_display, "ALSA_CONFIG_PATH": str(tmp_path / "asound.conf")}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-m", "modaltouch", *words], env=env, **pipes) as process:  # type: ignore[call-overload]
        end = time.monotonic() + 150
        while process.poll() is None and time.monotonic() < end:
            hands.key("Left")
            time.sleep(0.3)
            hands.key("space")
            time.sleep(0.1)
        process.terminate()
        _, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    log = events(tmp_path)
    start = log[0]
    assert start["speech"]["state"] == "spoken"
    assert start["speech"]["library"].startswith("eSpeak NG")
    assert start["speech"]["voice"] == "en"
    assert start["masking"]["state"] == "masked"
    known = {each["words"]: each for each in start["speech"]["prompts"]}
    assert all(len(each["sha256"]) == 64 for each in known.values())
    trials = [event for event in log if event["event"] == "trial"]
    assert len(trials) == 5
    assert all(event["masked"] for event in trials)
    said = [event for event in log if event["event"] == "spoken"]
    assert {event["words"] for event in said} <= set(known)
    assert said[0]["words"].startswith("Welcome")
    assert said[0]["n"] < trials[0]["n"]
    questions = [event for event in said if event["words"] == "Where did you feel the vibration?"]
    assert len(questions) >= len(trials)
    for event in said:
        assert event["heard_s"] <= known[event["words"]]["duration_s"] + 1e-3
        assert event["began_s"] is None or event["began_s"] >= event["wanted_at_s"] - 1e-3
    assert any(event["heard_s"] > 0 for event in questions)
