"""``modaltouch run`` without options: prompts, refusals, the check, and the wait for `start`."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from modaltouch import simulate_session
from modaltouch.session import propose_participant


@pytest.fixture
def ask(terminal: Callable[..., Any], tmp_path: Path) -> Callable[..., Any]:
    """Start the demonstration on a terminal, answered by a model."""

    def start(*words: Any) -> Any:
        given = ("--rig", "simulated", "--answers", "simulated", "--results", tmp_path)
        return terminal("run", "protocols/demo.yaml", *given, *words)

    return start


def expect(terminal: Any, words: str, count: int = 1) -> None:
    """Wait until some words have been written a number of times."""
    terminal.wait_until(lambda: terminal.text.count(words) >= count, f"{words!r} ({count})")


def test_run_prompts_for_missing_options_and_waits_for_start(ask: Callable[..., Any], tmp_path: Path) -> None:
    """Paths are refused as ids, Enter accepts the proposal, and only `start` starts."""
    session = ask()
    expect(session, "Participant id (a code of letters and digits, never a name) [p01]: ")
    session.type("../../etc\r")
    expect(session, "is not allowed: use 1 to 32 letters and digits")
    expect(session, "never a name) [p01]: ", 2)
    session.type("\r")
    expect(session, "Type start to begin")
    for words in ("12 trials", "Largest speed", "Participant p01, session 1, rig simulated (simulated data)"):
        assert words in session.text
    assert not list(tmp_path.rglob("session.jsonl"))
    session.type("yes?\r")
    expect(session, "Type start to begin", 2)
    session.type("start\r")
    assert session.finish() == 0
    assert "Done: 12 answers" in session.text
    assert session.is_restored


def test_a_participant_who_has_had_every_session_is_refused(ask: Callable[..., Any], tmp_path: Path) -> None:
    """An additional session needs its number; an existing number is refused immediately."""
    simulate_session("demo", "p07", tmp_path)
    session = ask("-p", "p07")
    assert session.finish() == 4
    text = " ".join(session.text.split())
    assert "has had its one session of the protocol" in text
    assert "--session 2 for one more" in text
    session = ask("-p", "p07", "-s", "2")
    expect(session, "Participant p07, session 2")
    session.type("q\r")
    assert session.finish() == 130
    assert "not started; nothing was recorded" in session.text
    assert len(list(tmp_path.rglob("session.jsonl"))) == 1
    refused = ask("-p", "p07", "-s", "1")
    assert refused.finish() == 4
    assert "exists already and is never overwritten" in refused.text.replace("\r\n", "")
    assert "Type start" not in refused.text
    proposed = ask()
    expect(proposed, "never a name) [p08]: ")
    proposed.type("\x03")
    assert proposed.finish() == 130
    assert "not started; nothing was recorded" in proposed.text


def test_the_next_participant_follows_the_last_one(tmp_path: Path) -> None:
    """With its letters and width; ids without a number give no proposal."""
    assert propose_participant(tmp_path / "absent") == "p01"
    for name in ("sub-anonymous", "sub-P007", "sub-P012"):
        (tmp_path / name).mkdir()
    assert propose_participant(tmp_path) == "P013"


def test_prompts_appear_on_a_visible_stream(
    terminal: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If standard error is a file, the prompts are written to standard output."""
    (tmp_path / "sitecustomize.py").write_text(
        f"import sys; sys.stderr = open({str(tmp_path / 'errors.txt')!r}, 'w')\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path) + os.pathsep + os.environ.get("PYTHONPATH", ""))
    given = ("--rig", "simulated", "--answers", "simulated", "--results", tmp_path / "results")
    session = terminal("run", "protocols/demo.yaml", *given)
    expect(session, "Participant id (a code of letters and digits, never a name) [p01]: ")
    session.type("\r")
    expect(session, "Type start to begin")
    session.type("q\r")
    assert session.finish() == 130


def test_run_prompts_for_the_rig(terminal: Callable[..., Any], tmp_path: Path) -> None:
    """There is no default, so that nobody sits at a silent beam; `simulated` must be typed."""
    session = terminal("run", "protocols/demo.yaml", "--answers", "simulated", "--results", tmp_path)
    expect(session, "Generator's VISA address")
    session.type("\r")
    expect(session, "given ''; allowed: a VISA address, or simulated")
    session.type("17\r")
    expect(session, "given '17'; allowed")
    session.type("simulated\r")
    expect(session, "Participant id")
    session.type("\r")
    expect(session, "rig simulated (simulated data)")
    session.type("q\r")
    assert session.finish() == 130


def test_a_session_is_continued_once_start_is_typed(terminal: Callable[..., Any], tmp_path: Path) -> None:
    """The prompt shows the session and its progress; -y continues immediately."""
    log = simulate_session("demo", "p01", tmp_path).path
    lines = log.read_text(encoding="utf-8").splitlines(keepends=True)
    answered = [place for place, line in enumerate(lines) if '"event":"trial"' in line and '"practice":false' in line]
    log.write_text("".join(lines[: answered[4] + 1]), encoding="utf-8")
    for left in log.parent.glob("*beh*"):
        left.unlink()
    kept = log.read_bytes()
    session = terminal("resume", log.parent)
    expect(session, "Type start to begin")
    assert "Participant p01, session 1, 5 of 12 trials answered, rig simulated" in session.text
    session.type("q\r")
    assert session.finish() == 130
    assert "not started; nothing was recorded" in session.text and log.read_bytes() == kept
    session = terminal("resume", log.parent, "-y")
    assert session.finish() == 0
    assert "Done: 12 answers" in session.text and "Type start" not in session.text
    session = terminal("resume", log.parent)
    assert session.finish() == 0
    assert "Type start" not in session.text, "nothing is left to begin"
