"""A virtual display, the one real window that the tests share, and injection of real keys and clicks."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from modaltouch.protocol import Experiment, Findings
from modaltouch.protocol.trial import Condition, Trial
from modaltouch.system.clock import SYSTEM_CLOCK, Clock, VirtualClock
from modaltouch.window.interface import Event, Presentation
from modaltouch.window.layout import DARK, Picture
from modaltouch.window.machine import virtual_display
from modaltouch.window.participant import ParticipantWindow

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def display() -> Iterator[str]:
    """Provide a separate display, so that no test types into a desktop."""
    with virtual_display((3840, 2160)) as name:
        before = os.environ.get("DISPLAY")
        os.environ["DISPLAY"] = name
        yield name
        if before is None:
            del os.environ["DISPLAY"]
        else:
            os.environ["DISPLAY"] = before


@pytest.fixture(scope="session")
def screen(display: str) -> Iterator[Any]:
    """Provide the real window. All tests share it, since each one leaks a connection."""
    from modaltouch.window.screen import Screen

    opened = Screen(size=(1280, 800), ground=DARK.ground, title="modaltouch under test")
    yield opened
    opened.close()


@pytest.fixture(scope="session")
def experiment() -> Experiment:
    """Provide the shipped demonstration."""
    return Findings.read(ROOT / "protocols" / "demo.yaml").experiment()


@pytest.fixture
def trial() -> Trial:
    """Provide one trial with the right index finger on A and the right middle finger on C."""
    return Trial(5, 1, Condition("one_hand", "A", "C", 100.0))


class PaperDisplay:
    """A display without a window: keeps the pictures and reports the events it is given."""

    def __init__(self, clock: Clock, size: tuple[int, int] = (1280, 800)) -> None:
        self.clock = clock
        self.size = size
        self.typed: list[tuple[str, bool]] = []
        self.events: list[Event] = []
        self.prepared: list[Picture] = []
        self.is_open = True

    def describe(self) -> dict[str, Any]:
        return {"backend": "paper"}

    def prepare(self, picture: Picture) -> None:
        self.prepared.append(picture)

    def draw(self, picture: Picture) -> None:
        self.drawn = picture

    def flip(self, screenshot: Path | None = None) -> float:
        if screenshot is not None:
            screenshot.write_text(self.drawn.name)
        return self.clock.now()

    def poll(self) -> list[Event]:
        events, self.events = self.events, []
        return events

    def type_key(self, key: str, *, down: bool) -> None:
        self.typed.append((key, down))
        self.events.append(Event(self.clock.now(), "key" if down else "release", key))

    def close(self) -> None:
        self.is_open = False


@dataclass
class Room:
    """A window under test, with everything it did.

    `script` lists actions with their times: each step waits until a picture whose name starts with the given words has
    been shown for some seconds, then acts. The steps run in order from the window's own tick.
    """

    display: Any
    clock: Clock
    window: Any = None
    log: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    shown: list[tuple[str, float]] = field(default_factory=list)
    stopped: list[float] = field(default_factory=list)
    ended: list[float] = field(default_factory=list)
    script: list[tuple[str, float, Callable[[], None]]] = field(default_factory=list)
    deadline: float = 0.0
    requests: list[Any] = field(default_factory=list)

    def tick(self) -> Any:
        """Run the script; fail the test instead of hanging."""
        now = self.clock.now()
        if now > self.deadline:
            raise TimeoutError(f"the window waits; shown {self.shown[-3:]}, log {self.log[-3:]}, script {self.script}")
        if self.script and self.shown:
            name, after, act = self.script[0]
            if self.shown[-1][0].startswith(name) and now - self.shown[-1][1] >= after:
                self.script.pop(0)
                act()
        return self.requests.pop(0) if self.requests else None

    def stop(self) -> None:
        self.stopped.append(self.clock.now())

    def present(self, onset: float | None = None, seconds: float = 60.0) -> Presentation:
        """Return a stimulus that begins now and lasts some seconds; its stop and end are noted."""
        onset = self.clock.now() if onset is None else onset
        return Presentation(onset, onset + seconds, lambda: self.ended.append(self.clock.now()), self.stop)

    def events(self, name: str) -> list[dict[str, Any]]:
        return [facts for event, facts in self.log if event == name]

    @property
    def names(self) -> list[str]:
        return [name for name, _ in self.shown]


class Watched:
    """Forwards everything to a display and notes what is shown."""

    def __init__(self, display: Any, room: Room) -> None:
        self._display, self._room = display, room
        self._drawn: Picture | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._display, name)

    def draw(self, picture: Picture) -> None:
        self._display.draw(picture)
        self._drawn = picture

    def flip(self, screenshot: Path | None = None) -> float:
        assert self._drawn is not None, "nothing was drawn since the last flip"
        shown = self._display.flip(screenshot)
        self._room.shown.append((self._drawn.name, shown))
        self._drawn = None
        return shown


def furnish(display: Any, experiment: Experiment, clock: Clock, *, seconds: float = 15.0, **options: Any) -> Room:
    """Return a window on a display, with its log and script."""
    room = Room(display, clock, deadline=clock.now() + seconds)
    changes = options.pop("answers", {})
    protocol = experiment.protocol
    if changes:
        protocol = protocol.model_copy(update={"answers": protocol.answers.model_copy(update=changes)})
    room.window = ParticipantWindow(
        Watched(display, room),
        protocol,
        options.pop("texts", experiment.texts),
        zones=experiment.apparatus.zone_spans,
        theme=options.pop("theme", "dark"),
        tick=room.tick,
        log=lambda event, **facts: room.log.append((event, facts)),
        clock=clock,
        **options,
    )
    return room


@pytest.fixture
def paper_room(experiment: Experiment) -> Callable[..., Room]:
    """Provide the window's rules without a window, in virtual time."""

    def make(*, clock: Clock | None = None, **options: Any) -> Room:
        clock = clock or VirtualClock(100.0)
        return furnish(PaperDisplay(clock), experiment, clock, **options)

    return make


@pytest.fixture
def room(screen: Any, experiment: Experiment) -> Callable[..., Room]:
    """Provide the rules on the real window, in a clean state."""

    def make(**options: Any) -> Room:
        settle = time.perf_counter() + 0.05
        while time.perf_counter() < settle:
            screen.poll()
        return furnish(screen, experiment, SYSTEM_CLOCK, **options)

    return make


class Hands:
    """Presses keys and buttons at the display server, as a keyboard and a mouse do."""

    def __init__(self, display: str) -> None:
        from Xlib.display import Display

        self._display = Display(display)
        self.pressed: list[float] = []

    def key(self, name: str, *, down: bool = True, up: bool = True) -> None:
        from Xlib import XK, X
        from Xlib.ext import xtest

        code = self._display.keysym_to_keycode(XK.string_to_keysym(name))
        if down:
            xtest.fake_input(self._display, X.KeyPress, code)
            self._display.sync()
            self.pressed.append(time.perf_counter())
        if up:
            xtest.fake_input(self._display, X.KeyRelease, code)
            self._display.sync()

    def click(self, x: int, y: int, button: int = 1) -> None:
        from Xlib import X
        from Xlib.ext import xtest

        xtest.fake_input(self._display, X.MotionNotify, x=x, y=y)
        xtest.fake_input(self._display, X.ButtonPress, button)
        self._display.sync()
        self.pressed.append(time.perf_counter())
        xtest.fake_input(self._display, X.ButtonRelease, button)
        self._display.sync()

    def find(self, title: str) -> Any:
        """Return the top-level window with a title."""
        for window in self._display.screen().root.query_tree().children:
            if window.get_wm_name() == title:
                return window
        raise LookupError(title)

    def origin(self, title: str) -> tuple[int, int]:
        """Return the position of a window's top left corner on the display [pixels]."""
        geometry = self.find(title).get_geometry()
        return geometry.x, geometry.y

    def press_close_button(self, title: str) -> None:
        from Xlib import X
        from Xlib.protocol import event

        window = self.find(title)
        message = event.ClientMessage(
            window=window,
            client_type=self._display.intern_atom("WM_PROTOCOLS"),
            data=(32, [self._display.intern_atom("WM_DELETE_WINDOW"), X.CurrentTime, 0, 0, 0]),
        )
        window.send_event(message)
        self._display.sync()

    def take_focus(self) -> None:
        """Open another window and give it the keyboard focus."""
        from Xlib import X

        root = self._display.screen().root
        self._other = root.create_window(3700, 2000, 50, 50, 0, self._display.screen().root_depth)
        self._other.map()
        self._display.sync()
        time.sleep(0.05)
        self._other.set_input_focus(X.RevertToParent, X.CurrentTime)
        self._display.sync()

    def give_focus_back(self, title: str) -> None:
        from Xlib import X

        self.find(title).set_input_focus(X.RevertToParent, X.CurrentTime)
        self._display.sync()
        self._other.destroy()
        self._display.sync()

    def close(self) -> None:
        self._display.close()


@pytest.fixture
def make_hands() -> Iterator[Callable[[str], Hands]]:
    """Provide hands on any display."""
    pairs: list[Hands] = []

    def make(name: str) -> Hands:
        pairs.append(Hands(name))
        return pairs[-1]

    yield make
    for pair in pairs:
        pair.close()


@pytest.fixture
def hands(display: str, make_hands: Callable[[str], Hands]) -> Hands:
    """Provide hands on the virtual display."""
    return make_hands(display)
