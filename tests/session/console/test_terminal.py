"""The live console on a real terminal with real keys, beside a session that a model answers."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture
def run(terminal: Callable[..., Any], long_protocol: Path, tmp_path: Path) -> Callable[..., Any]:
    """Start a long session on a terminal and wait until its first trials are answered."""

    def start(**options: Any) -> Any:
        words = (
            "run",
            long_protocol,
            "-p",
            "p01",
            "--rig",
            "simulated",
            "--answers",
            "simulated",
            "--results",
            tmp_path / "results",
            "--yes",
        )
        started = terminal(*words, **options)
        started.wait_for("last answer  ")
        started.wait_until(lambda: "(trial " in "".join(started.picture), "an answer that counts")
        return started

    return start


def named(events: list[dict[str, Any]], name: str) -> list[dict[str, Any]]:
    """Return the events of one kind."""
    return [event for event in events if event["event"] == name]


def console_of(process: int) -> int:
    """Return the process id of the console."""
    listed = subprocess.run(
        ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(process)], capture_output=True, text=True, check=True
    )
    return next(int(line.split()[0]) for line in listed.stdout.splitlines() if "modaltouch.session.console" in line)


def test_the_keys_pause_note_repeat_and_stop_a_session(
    run: Callable[..., Any], tmp_path: Path, events_of: Callable[[Path], list[dict[str, Any]]]
) -> None:
    """Each key has its effect and is recorded, and the terminal is restored."""
    console = run()
    picture = "\n".join(console.picture)
    for words in (
        "p01, session 1",
        "SIMULATED",
        "predicted    left",
        "generator    TEKTRONIX",
        "outputs",
        "last error   none",
    ):
        assert words in picture
    assert max(map(len, console.picture)) <= 80
    console.type("p")
    console.wait_for("PAUSED")
    held = events_of(tmp_path / "results")
    console.type("n")
    console.wait_for("note (Enter keeps it")
    console.type("coughz\x7f, p. é 3\r")
    console.wait_for("1 note kept")
    assert len(named(events_of(tmp_path / "results"), "trial")) == len(named(held, "trial")), "paused is paused"
    console.type("r")
    console.wait_for("repeat trial")
    console.type("p")
    console.wait_until(
        lambda: any(event["supersedes"] for event in named(events_of(tmp_path / "results"), "trial")),
        "the repeated trial",
    )
    console.type("q")
    console.wait_for("stop the session now?")
    console.type("n")
    console.wait_until(
        lambda: not any("stop the session now?" in line for line in console.picture), "a session that goes on"
    )
    console.type("qy")
    assert console.finish() == 130
    assert "ended by experimenter" in console.text
    assert console.is_restored
    events = events_of(tmp_path / "results")
    assert [event.get("text") for event in named(events, "experimenter") if event["asks"] == "note"] == [
        "cough, p. é 3"
    ]
    assert named(events, "stop")[-1]["reason"] == "experimenter"
    line = named(events, "withdrawn")[0]["lines"][0]
    again = next(event for event in named(events, "trial") if event["supersedes"] == line)
    assert again["trial"] == events[line - 1]["trial"], "the old answer stays, superseded"


def test_a_session_can_end_after_its_block_and_continue_later(
    run: Callable[..., Any],
    terminal: Callable[..., Any],
    tmp_path: Path,
    events_of: Callable[[Path], list[dict[str, Any]]],
) -> None:
    """All trials of the block are answered and none of the next; `resume` continues with it."""
    console = run()
    console.type("b")
    console.wait_for("end after this block")
    assert console.finish() == 130
    events = events_of(tmp_path / "results")
    assert {event["trial"]["block"] for event in named(events, "trial")} == {0, 1}
    assert named(events, "stop")[-1]["reason"] == "end of block"
    assert named(events, "stop")[-1]["n_answered"] == 90


@pytest.mark.parametrize("key", ["x", "\x1b[24~"], ids=["x", "F12"])
def test_an_emergency_stop_needs_one_key(
    run: Callable[..., Any], tmp_path: Path, events_of: Callable[[Path], list[dict[str, Any]]], key: str
) -> None:
    """No further stimulus begins, and the session ends normally; F12 works in a note, too."""
    console = run()
    if key != "x":
        console.type("n")
        console.wait_for("note (Enter")
    pressed = time.time()
    console.type(key)
    assert console.finish() == 130
    assert console.is_restored
    events = events_of(tmp_path / "results")
    stop = named(events, "stop")[-1]
    assert stop["reason"] == "emergency stop"
    # A second is generous: measured are 35 ms at most on a busy machine, in which a model answers one trial.
    fired = [datetime.fromisoformat(event["time"]).timestamp() for event in named(events, "fired")]
    assert max(fired) < pressed + 1.0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGKILL])
def test_the_terminal_is_restored_after_any_end(run: Callable[..., Any], number: signal.Signals) -> None:
    """After SIGKILL of the session, the console process restores the terminal."""
    console = run()
    if number == signal.SIGINT:
        console.type("\x03")
    else:
        os.kill(console.process.pid, number)
    status = console.finish()
    assert status == (-9 if number == signal.SIGKILL else 130)
    console.wait_until(lambda: console.is_restored, "the terminal as it was", 10)


def test_a_session_survives_its_console(run: Callable[..., Any]) -> None:
    """If the console process is killed, the terminal is restored, and plain lines continue."""
    console = run()
    os.kill(console_of(console.process.pid), signal.SIGKILL)
    assert console.finish() == 0
    assert "Done: 180 answers" in console.text
    assert "180 of 180 answered" in console.text
    assert "its keys do nothing now; Ctrl-C stops the session" in console.text
    assert console.is_restored


def test_the_console_is_readable_without_colours(run: Callable[..., Any]) -> None:
    """With NO_COLOR no colour is set, and the state is shown in words."""
    console = run(NO_COLOR="1")
    console.type("p")
    console.wait_for("PAUSED")
    assert not any(f"\x1b[{code}m" in console.raw for code in (*range(30, 38), *range(90, 98)))
    assert "38;5" not in console.raw
    console.type("qy")
    assert console.finish() == 130


def test_a_stopped_console_does_not_block_the_session(
    run: Callable[..., Any], tmp_path: Path, events_of: Callable[[Path], list[dict[str, Any]]]
) -> None:
    """Trials continue while the console process is stopped."""
    console = run()
    process = console_of(console.process.pid)
    os.kill(process, signal.SIGSTOP)
    before = len(named(events_of(tmp_path / "results"), "trial"))
    limit = time.monotonic() + 60
    while len(named(events_of(tmp_path / "results"), "trial")) <= before + 5:
        assert time.monotonic() < limit
        time.sleep(0.05)
    os.kill(process, signal.SIGCONT)
    console.type("qy")
    assert console.finish() == 130
