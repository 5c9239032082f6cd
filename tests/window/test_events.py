"""Window events on a fake pyglet window: order, time and key repeats."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from modaltouch.protocol import AnswerList, AnswersSection
from modaltouch.protocol.questions import KEY_NAMES
from modaltouch.window.answering import Reader
from modaltouch.window.layout import lay_out
from modaltouch.window.screen import EventTap, canonical_key

pytestmark = pytest.mark.window


FRENCH = [[ord(letter) for letter in row] for row in ("&é\"'(-è_çà", "1234567890")]
"""X's symbols of the upper row of a French keyboard, without and with Shift."""


class PaperWindow:
    """Accepts handlers and plays events to them, as pyglet does in dispatch_events."""

    def __init__(self) -> None:
        self.handlers: dict[str, Callable[..., bool]] = {}
        self.display = SimpleNamespace(_display=None)
        self.script: list[tuple[str, tuple[Any, ...]]] = []

    def push_handlers(self, **handlers: Callable[..., bool]) -> None:
        self.handlers = handlers

    def get_size(self) -> tuple[int, int]:
        return (1000, 500)

    def dispatch_events(self) -> None:
        for name, arguments in self.script:
            assert self.handlers[name](*arguments) is True
        self.script = []


@pytest.fixture
def tap(display: str, monkeypatch: pytest.MonkeyPatch) -> tuple[EventTap, PaperWindow]:
    """Provide an event tap on a fake window; pyglet's key names need a display to be imported."""
    monkeypatch.setattr("modaltouch.window.screen._report_releases_once", lambda window: True)
    monkeypatch.setattr("pyglet.libs.x11.xlib.XKeycodeToKeysym", lambda _, code, level: FRENCH[level][code - 10])
    window = PaperWindow()
    return EventTap(window), window


def press(symbol: int) -> tuple[str, tuple[int, int]]:
    """Return a key press for the fake window."""
    return ("on_key_press", (symbol, 0))


def release(symbol: int) -> tuple[str, tuple[int, int]]:
    """Return a key release for the fake window."""
    return ("on_key_release", (symbol, 0))


A, B = ord("a"), ord("b")


def test_events_come_in_order_with_rising_times(tap: tuple[EventTap, PaperWindow]) -> None:
    """In the order of dispatch, stamped by the clock of the reaction times."""
    events, window = tap
    window.script = [press(A), press(B), release(A), ("on_mouse_press", (750, 375, 1, 0)), ("on_close", ())]
    before = time.perf_counter()
    got = events.poll()
    assert [(event.kind, event.key) for event in got] == [
        ("key", "a"),
        ("key", "b"),
        ("release", "a"),
        ("click", ""),
        ("close", ""),
    ]
    times = [event.time for event in got]
    assert before <= times[0]
    assert times == sorted(times)
    assert (got[3].x, got[3].y) == (0.5, 0.25)


def test_a_held_key_is_one_press(tap: tuple[EventTap, PaperWindow]) -> None:
    """Presses without a release between them are repeats of the keyboard."""
    events, window = tap
    window.script = [press(A), press(A), press(A)]
    assert [event.kind for event in events.poll()] == ["key"]
    window.script = [press(A), release(A)]
    assert [event.kind for event in events.poll()] == ["release"]


def test_a_release_and_press_in_one_poll_both_count(tap: tuple[EventTap, PaperWindow]) -> None:
    """After a stall of the process no keystroke is lost."""
    events, window = tap
    window.script = [press(A)]
    events.poll()
    window.script = [release(A), press(A), release(A)]
    assert [event.kind for event in events.poll()] == ["release", "key", "release"]


def test_a_key_released_in_another_window_can_be_pressed_again(tap: tuple[EventTap, PaperWindow]) -> None:
    """Events without the focus are unknown, so no key counts as held afterwards."""
    events, window = tap
    window.script = [press(A), ("on_deactivate", ()), ("on_activate", ()), press(A)]
    assert [event.kind for event in events.poll()] == ["key", "blur", "focus", "key"]


def test_only_the_main_button_clicks(tap: tuple[EventTap, PaperWindow]) -> None:
    """The right button (4) and the middle one (2) are ignored."""
    events, window = tap
    window.script = [("on_mouse_press", (1, 1, 4, 0)), ("on_mouse_press", (1, 1, 2, 0)), ("on_text", ("a",))]
    assert events.poll() == []


@pytest.mark.parametrize(
    ("name", "canonical"),
    [("LEFT", "left"), ("Return", "enter"), ("_1", "1"), ("NUM_LEFT", "num_4"), ("num_page_up", "num_9"), (" a ", "a")],
)
def test_a_key_has_one_name(name: str, canonical: str) -> None:
    """Pyglet's names in small letters, independent of NumLock."""
    assert canonical_key(name) == canonical


def test_every_key_a_protocol_may_name_exists(display: str) -> None:
    """Pyglet has a symbol for each, with the same canonical name."""
    from pyglet.window import key

    for name in KEY_NAMES:
        symbol = getattr(key, name.upper() if not name.isdigit() else f"_{name}")
        assert canonical_key(key.symbol_string(symbol)) == canonical_key(name)


def test_digit_keys_work_without_shift_on_a_french_keyboard(tap: tuple[EventTap, PaperWindow]) -> None:
    """The key 1 types & there, and 2 types é, which has no name in pyglet; both count as digits."""
    from pyglet.window import key

    events, window = tap
    window.script = [press(key.AMPERSAND), press(key.user_key(11)), press(key.A)]
    one, two, letter = events.poll()
    assert (one.key, one.digit, two.digit, letter.digit) == ("ampersand", "1", "2", "")
    layout = lay_out(1280, 800, {"A": (-0.5, 0.0), "B": (0.0, 0.5)}, AnswerList.of({}))
    answers = AnswersSection(keys={"left": ["1"], "both": ["2"], "right": ["3"]}, continue_keys=["2"])
    digits = Reader(layout, answers)
    assert [digits.answer(event) for event in (one, two, letter)] == ["left", "both", None]
    assert [digits.name(event) for event in (one, two, letter)] == ["1", "2", "a"]
    assert [digits.goes_on(event) for event in (one, two, letter)] == [False, True, False]
    named = Reader(layout, AnswersSection(keys={"left": ["ampersand"], "right": ["3"]}))
    assert (named.answer(one), named.name(one)) == ("left", "ampersand")
