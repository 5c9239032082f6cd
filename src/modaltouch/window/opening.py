"""Options of the answer window: opening for a person or a robot, legible texts, timing, and checks of the machine."""

from __future__ import annotations

import math
import sys
import time
import unicodedata
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from modaltouch.protocol import Schedule
from modaltouch.system import SYSTEM_CLOCK, Clock
from modaltouch.window.interface import POLL_INTERVAL, WindowError
from modaltouch.window.layout import THEMES, Box, Picture, Spans, Words, rectangle
from modaltouch.window.machine import MachineCheck, examine_devices, examine_installation, some_display
from modaltouch.window.typesetting import Typesetter, find_font

if TYPE_CHECKING:
    from modaltouch.protocol import Findings, Problem, Protocol, Texts, Trial
    from modaltouch.window.interface import AnswerWindow, Log, Tick
    from modaltouch.window.pictures import Illustrator
    from modaltouch.window.screen import Screen
    from modaltouch.window.simulated import Answerer


@dataclass(frozen=True)
class WindowOptions:
    """Options of the answer window.

    Attributes
    ----------
    size : (width, height) of int
        Size of the window [pixels].
    fullscreen : bool
        Whether the window covers the monitor.
    theme : str
        ``dark`` or ``light``.
    screen : int
        Number of the monitor, from 0.
    screenshots : Path, optional
        Folder for one PNG of each kind of screen.
    """

    size: tuple[int, int] = (1280, 800)
    fullscreen: bool = False
    theme: str = "dark"
    screen: int = 0
    screenshots: Path | None = None

    @classmethod
    def recorded(cls, window: Mapping[str, Any]) -> Self:
        """Return the options of a recorded window, with defaults for facts missing from older records.

        Parameters
        ----------
        window : mapping
            Facts of the window in the record's line `start` or `resume`.
        """
        usual, size = cls(), window.get("size_px")
        fullscreen, theme = bool(window.get("fullscreen", False)), window.get("theme")
        return cls(
            # The recorded size of a full screen is that of the monitor.
            size=(int(size[0]), int(size[1])) if size and not fullscreen else usual.size,
            fullscreen=fullscreen,
            theme=theme if theme in THEMES else usual.theme,
            screen=int(window.get("monitor", usual.screen)),
        )

    def open(
        self,
        protocol: Protocol,
        texts: Texts,
        *,
        zones: Spans,
        tick: Tick,
        log: Log,
        answerer: Answerer | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> AnswerWindow:
        """Open the window.

        Parameters
        ----------
        protocol, texts, zones, tick, log, clock
            As for `participant.ParticipantWindow`.
        answerer : Answerer, optional
            Observer that types into the window in place of a person.

        Raises
        ------
        WindowError
            If the window cannot be opened.
        """
        from modaltouch.window.controls import typesetter_of
        from modaltouch.window.display_loop import Robot
        from modaltouch.window.participant import ParticipantWindow

        robot = None if answerer is None else Robot(answerer, protocol, texts=texts)
        display = self._screen(title=protocol.title, typesetter=typesetter_of(texts), clock=clock)
        try:
            return ParticipantWindow(
                display, protocol, texts, zones=zones, theme=self.theme, tick=tick, log=log,
                screenshots=self.screenshots, robot=robot, clock=clock,
            )  # fmt: skip
        except BaseException:
            display.close()
            raise

    def _screen(self, **options: Any) -> Screen:
        from modaltouch.window.screen import Screen

        ground = THEMES[self.theme].ground
        return Screen(size=self.size, fullscreen=self.fullscreen, monitor=self.screen, ground=ground, **options)

    def measure_timing(self) -> tuple[dict[str, Any], str]:
        """Measure the timing of pictures and keys in the window (`time_window`); takes some seconds.

        Raises
        ------
        WindowError
            If no window can be opened.
        """
        with some_display() as display, closing(self._screen(title="modaltouch doctor")) as screen:
            return time_window(screen, display=display)

    def check_texts(self, findings: Findings, *, letters_only: bool = False) -> Iterator[Problem]:
        """Yield a problem for each text that is illegible: a missing glyph, or type that is too small.

        Parameters
        ----------
        findings : Findings
            The protocol's files; must be valid unless `letters_only`.
        letters_only : bool
            Whether to check only for missing glyphs.
        """
        lacking = list(_check_letters(findings))
        yield from lacking
        if not (lacking or letters_only):
            yield from _check_type(findings, None if self.fullscreen else self.size)


LEAST_ANGLE = 20.0
"""Minimum visual angle of the height of a capital; ISO 9241-303 recommends 20 to 22 [arcmin]."""
_NOT_SHOWN = {"protocol", "title", "apparatus", "texts", "language", "language_code", "font", "stimulus", "stimuli"}
_PAGES = ("practice", "start", "practice_again", "rest", "stalled", "hands_off", "measuring", "measure_again")


def _check_letters(findings: Findings) -> Iterator[Problem]:
    """Yield a problem for each text with a character that no installed font has, and for a missing named font."""
    if findings.texts is None:
        return
    typesetter = Typesetter(findings.texts.sound("font") or "")
    if typesetter.font and find_font(typesetter.font) is None:
        given, allowed = f"{typesetter.font}, which is not installed", "the file of an installed font"
        yield findings.texts.problem(("font",), given, allowed, "install it, or leave the key out")
    for reading in (findings.texts, findings.protocol):
        for path, text in _strings((), None if reading is None else reading.root):
            if reading is not None and (lacking := typesetter.lacking(text)):
                name = "a tab" if lacking[0] == "\t" else unicodedata.name(lacking[0], "a control or unnamed character")
                given, allowed = f"{lacking[0]!r} ({name}), which no installed font has", "letters of installed fonts"
                remedy = "use another character, or install a font that has it (`modaltouch doctor` names packages)"
                yield reading.problem(path, given, allowed, remedy)


def _strings(path: tuple[str | int, ...], node: Any) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Yield each text below a node of a file that may be shown, with its path."""
    content = None if node is None else node.content
    if isinstance(content, str):
        yield path, content
    elif isinstance(content, dict | list):
        for step, child in content.items() if isinstance(content, dict) else enumerate(content):
            yield from () if not path and step in _NOT_SHOWN else _strings((*path, step), child)


def _check_type(findings: Findings, window: tuple[int, int] | None) -> Iterator[Problem]:
    """Yield a problem if the smallest text is too small at the stated viewing distance."""
    experiment, reading = findings.experiment(), findings.apparatus
    protocol, screen = experiment.protocol, experiment.apparatus.screen
    if screen is None or reading is None:
        return
    size = window or (screen.width_px, screen.height_px)
    placements = {
        (each.condition.finger_condition, each.condition.zones, each.condition.placement): each
        for each in Schedule.draw_from(findings, "p01", 0).trials
    }
    pixels, text = smallest_type(
        protocol, experiment.texts, experiment.apparatus.zone_spans, [*placements.values()], size
    )
    angle = math.degrees(2 * math.atan(pixels * screen.width_mm / screen.width_px / 2 / screen.distance_mm)) * 60
    if angle < LEAST_ANGLE:
        given = f"a window of {size[0]} x {size[1]} pixels in which a capital of '{text}' is {angle:.1f} arcmin high"
        remedy = "shorten the text, take a larger window (--fullscreen), or sit nearer"
        yield reading.problem(("screen",), given, f"at least {LEAST_ANGLE:g} arcmin", remedy)


def every_picture(pictures: Illustrator, trial: Trial) -> list[Picture]:
    """Return each kind of screen that a session may show for a trial."""
    progress, texts = (trial.index, max(trial.index, 99)), pictures.texts
    names = pictures.answers.offered.names
    chosen = names[0] if pictures.answers.scale is None else f"{pictures.answers.scale.at(0.5):g}"
    expected = [answer.name for answer in pictures.answers.offered if answer.fingers or answer.interval]
    return [
        pictures.welcome(trial),
        pictures.answering(trial),
        pictures.placement(trial),
        pictures.ready(trial, progress),
        pictures.ready(trial, progress, 3),
        pictures.feel(trial, progress),
        pictures.question(trial, progress),
        pictures.question(trial, progress, chosen=chosen, confirmed=False),
        *(pictures.feedback(trial, progress, given, name) for name in expected for given in names[:2]),
        *(pictures.page(name, str(getattr(texts, name)), progress) for name in _PAGES),
        *(pictures.page(name, str(getattr(texts, name)), waits=False) for name in ("session_ended", "goodbye")),
        pictures.pause(trial),
        pictures.pause(None),
    ]


def smallest_type(
    protocol: Protocol,
    texts: Texts,
    zones: Spans,
    trials: list[Trial],
    size: tuple[int, int],
) -> tuple[float, str]:
    """Return the height of a capital in the smallest type [pixels], and the text, in a window of a size [pixels]."""
    # Import the drawing modules only to measure type.
    from modaltouch.window.controls import typesetter_of
    from modaltouch.window.pictures import Illustrator

    design = protocol.conditions
    asked = [protocol.answers, *protocol.answers.further.values(), *protocol.closing.values()]
    pictures, *others = (Illustrator.of(size, zones, "dark", texts, each, design) for each in asked)
    every = [picture for trial in trials for picture in every_picture(pictures, trial)]
    every += [picture.question(trials[0], (1, 1)) for picture in others]
    words = {mark for picture in every for mark in picture.marks if isinstance(mark, Words)}
    set_type = typesetter_of(texts).set_type
    # A capital of Noto Sans, which the other Noto fonts match, is 0.714 em high.
    return min(
        ((0.714 * set_type(mark, size[1]).size, mark.text) for mark in words),
        key=lambda found: (found[0], -len(found[1]), found[1]),  # of words that share a size, the longest decides it
    )


def examine_machine(results: Path = Path("results"), *, quick: bool = False) -> tuple[MachineCheck, ...]:
    """Check what a session needs on this machine, including a test drawing; no instrument is opened.

    Parameters
    ----------
    results : Path
        Folder where sessions will be recorded.
    quick : bool
        Whether to check only installed software, without window, sound device and disk.
    """
    window = () if quick else (_draw_letter(),)
    return *examine_installation(), *window, *examine_devices(results, quick=quick)


def _draw_letter() -> MachineCheck:
    """Draw a letter in the window, which requires a display, OpenGL, fonts and PsychoPy."""
    from modaltouch.window.screen import Screen

    try:
        with some_display() as where, closing(Screen(size=(320, 200), title="modaltouch doctor")) as screen:
            screen.draw(Picture("letter", (Words("A", Box(0.0, 0.0, 0.8, 0.8), 0.5, "#ffffff"),)))
            screen.flip()
            renderer = screen.describe()["renderer"]
    except WindowError as error:
        return MachineCheck("window", "fault", *str(error).split("; ", 1))
    return MachineCheck("window", "ok", f"a letter is drawn on {where} ({renderer})")


_TIMEOUT = 0.5
"""Time after which an unseen key counts as lost [s]."""


def time_window(
    screen: Screen, *, n_frames: int = 120, n_keys: int = 60, display: str = "the screen"
) -> tuple[dict[str, Any], str]:
    """Measure the timing of pictures and keys in an open window with keyboard focus, and assess it.

    Returns
    -------
    figures : dict
        ``display``, a description of the display; ``n_frames``, and ``n_dropped`` of at least 1.5 times the usual
        duration; ``waits_for_monitor``, whether frames follow a monitor's refresh; ``n_keys`` injected, ``n_lost``
        never seen, and ``key_path``: ``display server`` (as from a keyboard), or ``none`` without an X server, where no
        key is injected; time between frames (``frame_median_ms``, ``frame_p95_ms``), and from the injection
        of a key to its time stamp (``key_delay_median_ms``, ``key_delay_p95_ms``, ``key_delay_max_ms``), None if no key
        was seen.
    verdict : str
        Consequences for an experiment, and what to do.
    """
    frames = _measure_frames(screen, n_frames) * 1e3
    n_keys *= sys.platform.startswith("linux")
    with _injector() if n_keys else nullcontext(time.perf_counter) as press:
        delays = [_measure_key(screen, press, number) for number in range(n_keys)]
    seen = [delay * 1e3 for delay in delays if delay is not None]
    usual = float(np.median(frames))
    figures = {
        "display": display,
        "n_frames": n_frames,
        "n_dropped": int(np.sum(frames > 1.5 * usual)),
        # No monitor refreshes in less than 4 ms.
        "waits_for_monitor": usual > 4.0 and float(np.quantile(frames, 0.1)) > 0.8 * usual,
        "n_keys": n_keys,
        "n_lost": n_keys - len(seen),
        "key_path": "display server" if n_keys else "none",
        "frame_median_ms": round(usual, 3),
        "frame_p95_ms": round(float(np.quantile(frames, 0.95)), 3),
        "key_delay_median_ms": round(float(np.median(seen)), 3) if seen else None,
        "key_delay_p95_ms": round(float(np.quantile(seen, 0.95)), 3) if seen else None,
        "key_delay_max_ms": round(max(seen), 3) if seen else None,
    }
    return figures, judge_window(figures)


def judge_window(figures: Mapping[str, Any]) -> str:
    """Return what the timing figures of a window mean for an experiment, with advice."""
    lines, delay = [f"On {figures['display']}:"], figures["key_delay_p95_ms"]
    if figures["n_lost"]:
        lines.append(
            f"{figures['n_lost']} of {figures['n_keys']} keys were lost: give the window the keyboard focus, and do "
            "not run participants here until none is."
        )
    if delay is None:
        lines.append("No key was timed.")
    elif delay > 5:
        lines.append(
            f"Keys are stamped up to {delay:.0f} ms late (95 %): close other programs, and state this with every "
            "reaction time."
        )
    else:
        lines.append(f"Keys are stamped within {delay:.1f} ms (95 %): good.")
    if not figures["waits_for_monitor"]:
        lines.append(
            "Frames do not wait for a monitor, so the time at which one shows them is unknown: measure on the "
            "participants' own screen, and switch on vertical synchronisation (vsync) there."
        )
    elif figures["n_dropped"] > 0.01 * figures["n_frames"]:
        lines.append(
            f"{figures['n_dropped']} of {figures['n_frames']} frames came late: run full screen, without a compositor, "
            "and close other programs."
        )
    else:
        lines.append(f"Frames follow the monitor at {1e3 / figures['frame_median_ms']:.0f} Hz: good.")
    return " ".join(lines)


def _measure_frames(screen: Screen, n_frames: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the times between frames of two alternating pictures [s]."""
    pictures = [Picture(f"timing_{x}", (rectangle(Box(x, 0, 0.1, 0.1), "#808080"),)) for x in (-0.2, 0.2)]
    shown = []
    for number in range(n_frames + 3):
        screen.draw(pictures[number % 2])
        shown.append(screen.flip())
    # The first two frames also prepare the marks.
    return np.diff(shown[2:])


def _measure_key(screen: Screen, press: Callable[[], float], number: int) -> float | None:
    """Return the time from a key's injection to its time stamp, polled as in a session [s]; None if lost."""
    screen.poll()
    # Vary the phase of presses relative to the poll.
    until = time.perf_counter() + 0.02 + (number * 0.618 % 1) * POLL_INTERVAL
    while time.perf_counter() < until:
        time.sleep(1e-4)
    injected = press()
    while time.perf_counter() < injected + _TIMEOUT:
        for event in screen.poll():
            if event.kind == "key":
                return event.time - injected
        time.sleep(POLL_INTERVAL)
    return None


@contextmanager
def _injector() -> Iterator[Callable[[], float]]:
    """Yield a function that presses and releases F12 at the X server and returns the time."""
    # A dependency of PsychoPy.
    from Xlib import X, display
    from Xlib.ext import xtest

    with closing(display.Display()) as server:
        code = server.keysym_to_keycode(0xFFC9)  # F12, to which no program reacts

        def press() -> float:
            xtest.fake_input(server, X.KeyPress, code)
            now = time.perf_counter()
            server.sync()
            xtest.fake_input(server, X.KeyRelease, code)
            server.sync()
            return now

        yield press
