"""Screen: the PsychoPy window, drawing of pictures, and its input; no other module uses PsychoPy."""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.protocol import AnswersSection
from modaltouch.system import SYSTEM_CLOCK, Clock, versions
from modaltouch.window.interface import Event, EventKind, WindowError
from modaltouch.window.layout import Mark, Picture, Shape, cover
from modaltouch.window.machine import explain, few_imports, fit, prepare_environment
from modaltouch.window.typesetting import Typesetter

_ALIASES = {
    **AnswersSection.KEY_ALIASES,
    "num_next": "num_3",
    "num_prior": "num_9",
}
"""Aliases of keys allowed in protocols, and two names used by pyglet only."""

_FIRST_DIGIT = 10
"""X keycode of the key 1 in the upper row; the other digits follow."""


def canonical_key(name: str) -> str:
    """Return the canonical name of a key, as in protocols and reported by the tap.

    Examples
    --------
    >>> canonical_key("RETURN"), canonical_key("_1"), canonical_key("NUM_LEFT")
    ('enter', '1', 'num_4')
    """
    plain = name.strip().lower()
    if len(plain) == 2 and plain[0] == "_":
        plain = plain[1]
    return _ALIASES.get(plain, plain)


class EventTap:
    """Queue of all input to a pyglet window, time-stamped by one monotonic clock.

    PsychoPy's input classes lose fast clicks and keys, or end the process, so the tap is attached to the pyglet window.
    Its handlers only queue, since Windows would swallow an exception raised in a handler.
    """

    def __init__(self, window: Any, clock: Clock = SYSTEM_CLOCK) -> None:
        from pyglet.window import key, mouse

        self._window = window
        self._clock = clock
        self._queue: deque[Event] = deque()
        self._held: set[str] = set()
        self._symbol_name = key.symbol_string
        self._left_button = mouse.LEFT
        on_x = sys.platform.startswith("linux")
        # Elsewhere the keys are already named after their digits.
        self._digits = _engraved_digits(window) if on_x else {}
        self.repeats_are_detectable = not on_x or _report_releases_once(window)
        self.is_lost = False
        """Whether the X server is gone; nothing may be drawn any more."""
        window.push_handlers(
            on_key_press=partial(self._on_key, "key"),
            on_key_release=partial(self._on_key, "release"),
            on_text=self._ignore_text,
            on_text_motion=self._ignore_text,
            on_mouse_press=self._on_mouse_press,
            on_mouse_release=self._ignore_text,
            on_close=partial(self._add, "close"),
            on_activate=partial(self._add, "focus"),
            on_deactivate=partial(self._add, "blur"),
            on_expose=partial(self._add, "expose"),
        )

    def poll(self) -> list[Event]:
        """Return the events since the last poll in order, without key repeats."""
        self._window.dispatch_events()
        events = list(self._queue)
        self._queue.clear()
        return [event for event in events if self._is_news(event)]

    def _is_news(self, event: Event) -> bool:
        """Return whether the event is not the repeat of a held key."""
        if event.kind == "key":
            if event.key in self._held:
                return False
            self._held.add(event.key)
        elif event.kind == "release":
            self._held.discard(event.key)
        elif event.kind in ("focus", "blur"):
            # A key release outside the window is not reported.
            self._held.clear()
        return True

    def _add(self, kind: EventKind, key: str = "", x: float = 0.0, y: float = 0.0) -> bool:
        self._queue.append(Event(self._clock.now(), kind, key, x, y, self._digits.get(key, "")))
        return True

    def _on_key(self, kind: EventKind, symbol: int, modifiers: int) -> bool:
        return self._add(kind, canonical_key(self._symbol_name(symbol)))

    def _on_mouse_press(self, x: int, y: int, button: int, modifiers: int) -> bool:
        if button != self._left_button:
            return True
        width, height = self._window.get_size()
        return self._add("click", "", (x - width / 2) / height, (y - height / 2) / height)

    def lose(self, *_: object) -> int:
        """Queue the loss of the X server; called by Xlib."""
        self.is_lost = True
        self._add("lost")
        return 0

    def _ignore_text(self, *_: object) -> bool:
        """Keep PsychoPy's buffers empty."""
        return True


def _report_releases_once(window: Any) -> bool:
    """Request detectable auto-repeat from X (no releases for a held key), and return whether it is supported.

    pyglet requests it only on the connection of its hidden window, but PsychoPy opens the visible one on a separate
    connection. A release followed by a press is then always a real one, however short the time between.
    """
    from ctypes import byref, c_int

    from pyglet.window.xlib import XkbSetDetectableAutoRepeat

    agreed = c_int()
    XkbSetDetectableAutoRepeat(window.display._display, 1, byref(agreed))
    return bool(agreed.value)


_HANDLERS: list[Any] = []
"""Functions given to Xlib, which may call them as long as the process lives."""


def _report_loss(window: Any, on_loss: Callable[..., int]) -> None:
    """Have Xlib call a function when the X server is gone, where it would end the process.

    Versions of libX11 before 1.7 end the process all the same.
    """
    from ctypes import CDLL, CFUNCTYPE, c_int, c_void_p

    from pyglet import gl

    xlib = CDLL("libX11.so.6")
    at_error, at_exit = CFUNCTYPE(c_int, c_void_p)(on_loss), CFUNCTYPE(c_int, c_void_p, c_void_p)(on_loss)
    if hasattr(xlib, "XSetIOErrorExitHandler"):
        xlib.XSetIOErrorHandler(at_error)
        # pyglet's hidden window has a connection of its own.
        for display in (window.display, gl._shadow_window.display):
            xlib.XSetIOErrorExitHandler(display._display, at_exit, None)
    _HANDLERS.extend((at_error, at_exit))


def _engraved_digits(window: Any) -> dict[str, str]:
    """Return the digits typed only with Shift, as in the French layout, by the names of their keys."""
    from pyglet.libs.x11.xlib import XKeycodeToKeysym
    from pyglet.window import key

    digits = {}
    for code in range(_FIRST_DIGIT, _FIRST_DIGIT + 10):
        plain, shifted = (XKeycodeToKeysym(window.display._display, code, level) for level in (0, 1))
        if ord("0") <= shifted <= ord("9") and not ord("0") <= plain <= ord("9"):
            symbol = plain if plain in key._key_names else key.user_key(code)
            digits[canonical_key(key.symbol_string(symbol))] = chr(shifted)
    return digits


class Screen:
    """An open window.

    Parameters
    ----------
    size : (width, height) of int
        Size of the window, limited to that of the monitor; ignored for full screen [pixels].
    fullscreen : bool
        Whether the window covers the monitor.
    monitor : int
        Number of the monitor, from 0.
    ground : str
        Background colour as ``#RRGGBB``.
    title : str
        Title of the window.
    typesetter : Typesetter, optional
        Sets texts in the fonts and the language of an experiment.
    clock : Clock
        Clock of the time stamps of pictures and events.

    Raises
    ------
    WindowError
        If there is no usable display or no such monitor.
    """

    def __init__(
        self,
        *,
        size: tuple[int, int] = (1280, 800),
        fullscreen: bool = False,
        monitor: int = 0,
        ground: str = "#000000",
        title: str = "modaltouch",
        typesetter: Typesetter | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._clock = clock
        visual, monitors = _import_psychopy()
        self._visual = visual
        self._place: dict[str, Any] = {"fullscreen": fullscreen, "monitor": monitor}
        self._typesetter = typesetter or Typesetter()
        # A session with ten zone pairs needs about 600 marks.
        self._stimulus = lru_cache(1500)(self._image)
        within = fit(size, monitor)
        try:
            self._window = visual.Window(
                within,
                fullscr=fullscreen,
                allowGUI=not fullscreen,
                screen=monitor,
                color=ground,
                colorSpace="rgb",
                units="height",
                # With a monitor that has no file, PsychoPy neither warns nor writes one.
                monitor=monitors.Monitor("modaltouch", width=50, distance=60, verbose=False, autoLog=False),
                checkTiming=False,
                gammaErrorPolicy="ignore",
                winType="pyglet",
                autoLog=False,
                title=title,
            )
        except Exception as error:
            raise WindowError(explain(error)) from error
        self._window.mouseVisible = True
        self._tap = EventTap(self._window.winHandle, clock)
        if sys.platform.startswith("linux"):
            _report_loss(self._window.winHandle, self._tap.lose)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the drawing area [pixels]."""
        width, height = self._window.size
        return int(width), int(height)

    def describe(self) -> dict[str, Any]:
        """Return the facts of the window for the start record."""
        return {
            "backend": "psychopy",
            **{name: versions()[name] for name in ("psychopy", "pyglet")},
            "renderer": self._window.winHandle.context.get_info().get_renderer(),
            "size_px": list(self.size),
            **self._place,
            "detectable_key_repeat": self._tap.repeats_are_detectable,
        }

    def prepare(self, picture: Picture) -> None:
        """Prepare the picture's marks, so that drawing it later takes at most one frame."""
        for mark in picture.marks:
            self._stimulus(mark)

    def draw(self, picture: Picture) -> None:
        """Draw the picture to the back buffer, until `flip` shows it."""
        from pyglet.gl import glFinish

        with self._on_display():
            self._window.clearBuffer()
            for mark in picture.marks:
                self._stimulus(mark).draw()
            # Otherwise OpenGL would defer the work to the flip.
            glFinish()

    def flip(self, screenshot: Path | None = None) -> float:
        """Show the back buffer, and return the time of its appearance, by the window's clock [s].

        Parameters
        ----------
        screenshot : Path, optional
            PNG file to write.

        Raises
        ------
        WindowError
            If the screenshot cannot be written, or the display is lost.
        """
        with self._on_display():
            image = self._window._getFrame(buffer="back") if screenshot is not None else None
            self._window.flip()
        shown = self._clock.now()
        if image is not None and screenshot is not None:
            try:
                image.convert("RGB").save(screenshot)
            except OSError as error:
                raise WindowError(
                    f"the screenshot {screenshot} cannot be written ({error.strerror or error}); give a folder that "
                    "takes files"
                ) from error
        return shown

    def poll(self) -> list[Event]:
        """Return the events of the window since the last poll."""
        return self._tap.poll()

    def type_key(self, key: str, *, down: bool) -> None:
        """Dispatch a key press or release through the window's event queue, as if typed by a person."""
        from pyglet.window import key as keys

        symbol = getattr(keys, key.upper() if not key.isdigit() else f"_{key}")
        self._window.winHandle.dispatch_event("on_key_press" if down else "on_key_release", symbol, 0)

    def close(self) -> None:
        """Close the window; never raises."""
        with suppress(Exception):
            self._tap.poll()  # shows whether the display is gone
        if self._tap.is_lost:
            # At exit PsychoPy closes what is still open, which crashes on a lost display.
            self._window._closed = True
            return
        try:
            self._window.close()
        # The session must be concluded whatever the display raises.
        except Exception as error:
            sys.stderr.write(f"the answer window did not close cleanly: {error}\n")

    @contextmanager
    def _on_display(self) -> Iterator[None]:
        """Raise `WindowError` if the display is lost, or is lost meanwhile."""
        try:
            if not self._tap.is_lost:
                yield
        finally:
            # OpenGL raises errors of any kind on a lost display.
            if self._tap.is_lost:
                raise display_lost()

    def _image(self, mark: Mark) -> Any:
        """Return the mark as an image in the pixel grid of the window."""
        width, height = self.size
        if isinstance(mark, Shape):
            covered = cover(np.array(mark.corners) * height + (width / 2, height / 2))
        else:
            covered = self._typesetter.cover(mark, self.size)
        rows, columns = covered.alpha.shape
        image = np.empty((rows, columns, 4), dtype=np.float32)
        # Unlike elsewhere in PsychoPy, colours range from 0 to 1 in an image with opacity.
        image[..., :3] = [int(mark.fill[place : place + 2], 16) / 255 for place in (1, 3, 5)]
        image[..., 3] = covered.alpha
        return self._visual.ImageStim(
            self._window,
            image=image,
            units="pix",
            size=(columns, rows),
            pos=(covered.left + columns / 2 - width / 2, covered.bottom + rows / 2 - height / 2),
            interpolate=False,
            autoLog=False,
        )


def display_lost() -> WindowError:
    """Return the error for an X server that ended while the window was open."""
    return WindowError(
        f"the display {os.environ.get('DISPLAY', '')!r} is gone: its X server ended or closed the connection; start it "
        "again, or log in again"
    )


def _import_psychopy() -> tuple[Any, Any]:
    """Import PsychoPy's modules ``visual`` and ``monitors`` quietly, and return them."""
    prepare_environment()
    try:
        with few_imports():
            from psychopy import logging

            logging.console.setLevel(logging.ERROR)
            from psychopy import monitors, visual
    except Exception as error:
        raise WindowError(explain(error)) from error
    return visual, monitors
