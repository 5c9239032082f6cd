"""The console in a terminal beside the real window, with real keys on both."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from Xlib import XK, X
from Xlib.display import Display
from Xlib.ext import xtest

from modaltouch.window.machine import virtual_display

pytestmark = pytest.mark.window


@pytest.fixture
def press() -> Iterator[Callable[[str], None]]:
    """Press keys on a separate display, whose name is the function's attribute."""
    with virtual_display((1280, 800)) as name:
        display = Display(name)

        def type_key(key: str) -> None:
            code = display.keysym_to_keycode(XK.string_to_keysym(key))
            for kind in (X.KeyPress, X.KeyRelease):
                xtest.fake_input(display, kind, code)
                display.sync()
                time.sleep(0.02)

        type_key.display = name  # type: ignore[attr-defined]
        yield type_key
        display.close()


def named(events: list[dict[str, Any]], name: str) -> list[dict[str, Any]]:
    """Return the events of one kind."""
    return [event for event in events if event["event"] == name]


def test_console_pause_and_window_emergency_key(
    terminal: Callable[..., Any],
    press: Any,
    tmp_path: Path,
    events_of: Callable[[Path], list[dict[str, Any]]],
) -> None:
    """P interrupts the trial and pauses the window, P again continues; F12 in the window ends the session."""
    session = terminal(
        "run",
        "protocols/demo.yaml",
        "-p",
        "p01",
        "--rig",
        "simulated",
        "--yes",
        "--results",
        tmp_path,
        DISPLAY=press.display,
    )
    session.wait_for("between trials", 90)

    def answer_until(holds: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + 150
        while not holds():
            assert time.monotonic() < end, f"{what} did not come:\n" + "\n".join(session.picture)
            press("space")
            press("Left")
            time.sleep(0.1)

    answer_until(lambda: len(named(events_of(tmp_path), "trial")) >= 2, "two answers")
    session.wait_for("left, ")
    press("space")
    session.wait_until(lambda: _plays(events_of(tmp_path), press), "a stimulus")
    session.type("p")
    session.wait_for("PAUSED")
    events = events_of(tmp_path)
    assert named(events, "pause")[-1]["by"] == "experimenter"
    n_fired = len(named(events, "fired"))
    session.type("n")
    session.type("a pause\r")
    session.wait_for("1 note kept")
    press("Left")
    assert len(named(events_of(tmp_path), "fired")) == n_fired, "an answer key does not end a pause"
    session.type("p")
    session.wait_until(lambda: len(named(events_of(tmp_path), "fired")) > n_fired, "the trial once more")
    events = events_of(tmp_path)
    cut = named(events, "trial_cut")[-1]
    assert cut["reason"] == "experimenter"
    assert named(events, "fired")[-1]["trial"] == cut["trial"]
    pressed = time.perf_counter()
    press("F12")
    assert session.finish() == 130
    assert session.is_restored
    stop = named(events_of(tmp_path), "stop")[-1]
    assert stop["reason"] == "emergency stop"
    exchanges = [each for event in named(events_of(tmp_path), "rig") for each in event["exchanges"]]
    assert "OUTP1 OFF" in " ".join(each.get("sent", "") for each in exchanges[-12:])
    # Both clocks are the machine's monotonic one; 20 ms of it is the key's own way up.
    assert stop["clock"] - pressed < 5.0


def test_the_experimenter_conducts_a_session_from_the_terminal(
    terminal: Callable[..., Any],
    press: Any,
    edit: Callable[..., Path],
    tmp_path: Path,
    events_of: Callable[[Path], list[dict[str, Any]]],
) -> None:
    """As over ssh, no key reaches the window: Space continues, and the console's keys answer."""
    protocol = edit("demo.yaml", ("given_by: participant", "given_by: experimenter"))
    words = ("run", protocol, "-p", "p01", "--rig", "simulated", "--yes", "--results", tmp_path / "results")
    session = terminal(*words, DISPLAY=press.display)
    session.wait_for("between trials", 90)

    def lead_until(holds: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + 150
        while not holds():
            assert time.monotonic() < end, f"{what} did not come:\n" + "\n".join(session.picture)
            session.type(" ")
            time.sleep(0.4)

    for keys, answer, named in (("\x1b[D", "left", "left"), ("3", "right", "3"), ("2", "both", "2")):
        n_before = len(_answers(events_of(tmp_path)))
        lead_until(lambda: any("left: left arrow or 4 or 1" in line for line in session.picture), "a question")
        while len(_answers(events_of(tmp_path))) == n_before:
            session.type(keys)
            time.sleep(0.3)
        response = _answers(events_of(tmp_path))[-1]["response"]
        given = {name: response[name] for name in ("answer", "device", "key", "answered_by", "way")}
        expected = {"answer": answer, "device": "console", "key": named}
        assert given == {**expected, "answered_by": "experimenter", "way": "experimenter"}
        assert 0 < response["reaction_time"] < 60
    session.type("q")
    session.wait_for("stop the session now?")
    session.type("y")
    assert session.finish() == 130


def _answers(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the answers of a record, once each."""
    return named(events, "trial")


def _plays(events: list[dict[str, Any]], press: Callable[[str], None]) -> bool:
    """Return whether an unanswered stimulus plays; otherwise confirm the placement."""
    last = next((event for event in reversed(events) if event["event"] in ("fired", "trial", "trial_cut")), None)
    if last is not None and last["event"] == "fired":
        return True
    press("space")
    return False
