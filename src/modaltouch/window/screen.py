"""Screen: the PsychoPy window, drawing of pictures, and its events; no other module uses PsychoPy."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.system import SYSTEM_CLOCK, Clock
from modaltouch.window.environment import explain, few_imports, fit, missing_libraries, prepare_environment
from modaltouch.window.events import EventTap
from modaltouch.window.interface import Event, WindowError
from modaltouch.window.shapes import Mark, Picture, Shape, cover
from modaltouch.window.typesetting import Typesetter

_HANDLERS: list[Any] = []
"""Callbacks of Xlib, which stores only their addresses, kept alive with the process."""


class DisplayLoss:
    """Detection of a lost X server; never happens on systems without X.

    Xlib calls ``exit(1)`` when its connection breaks. Since libX11 1.7 this can be prevented
    (``XSetIOErrorExitHandler``): calls on the connection then do nothing, and the session can end properly. With an
    older libX11 the process ends, and the watchdog switches the outputs off.
    """

    def __init__(self, look: Callable[[], object]) -> None:
        self.happened = False
        self._look = look
        if sys.platform.startswith("linux"):
            self._decline_to_exit()

    @contextmanager
    def told(self) -> Iterator[None]:
        """Report a lost display as such, whatever OpenGL and pyglet raise.

        Raises
        ------
        WindowError
            If the display is lost.
        """
        try:
            yield
        except Exception:
            with suppress(Exception):
                self._look()
            self._check()
            raise
        self._check()

    def _check(self) -> None:
        if self.happened:
            name = os.environ.get("DISPLAY", "")
            raise WindowError(f"the display {name!r} is gone; check why its X server ended, and start it again")

    def _decline_to_exit(self) -> None:
        """Prevent exit on a broken connection, of which pyglet has one per window, including hidden ones."""
        from ctypes import CFUNCTYPE, c_void_p, cast

        import pyglet.canvas
        from pyglet.libs.x11 import xlib

        decline = getattr(xlib._lib, "XSetIOErrorExitHandler", None)
        if decline is None:
            return
        kind = CFUNCTYPE(None, c_void_p, c_void_p)
        decline.restype, decline.argtypes = None, [c_void_p, kind, c_void_p]
        quiet, stay = xlib.XIOErrorHandler(self._note), kind(self._note)
        _HANDLERS.extend((quiet, stay))
        xlib.XSetIOErrorHandler(quiet)
        for display in pyglet.canvas._displays:
            decline(cast(display._display, c_void_p), stay, None)

    def _note(self, *_: object) -> int:
        self.happened = True
        return 0


_KEPT_MARKS = 1500
"""Number of cached marks; a session with ten zone pairs needs about 600."""


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
        self._stimulus = lru_cache(_KEPT_MARKS)(self._image)
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
        self._loss = DisplayLoss(self._tap.poll)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the drawing area [pixels]."""
        width, height = self._window.size
        return int(width), int(height)

    def describe(self) -> dict[str, Any]:
        """Return the facts of the window for the start record."""
        import psychopy
        import pyglet

        return {
            "backend": "psychopy",
            "psychopy": psychopy.__version__,
            "pyglet": pyglet.version,
            "renderer": self._window.winHandle.context.get_info().get_renderer(),
            "size_px": list(self.size),
            **self._place,
            "detectable_key_repeat": self._tap.repeats_are_detectable,
        }

    def prepare(self, picture: Picture) -> None:
        """Prepare the picture's marks, so that drawing it later takes at most one frame."""
        with self._loss.told():
            for mark in picture.marks:
                self._stimulus(mark)

    def draw(self, picture: Picture) -> None:
        """Draw the picture to the back buffer, until `flip` shows it."""
        from pyglet.gl import glFinish

        with self._loss.told():
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
        with self._loss.told():
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
        """Return the events of the window since the last poll.

        Raises
        ------
        WindowError
            If the display is lost.
        """
        with self._loss.told():
            return self._tap.poll()

    def type_key(self, key: str, *, down: bool) -> None:
        """Dispatch a key press or release through the window's event queue, as if typed by a person."""
        from pyglet.window import key as keys

        symbol = getattr(keys, key.upper() if not key.isdigit() else f"_{key}")
        self._window.winHandle.dispatch_event("on_key_press" if down else "on_key_release", symbol, 0)

    def close(self) -> None:
        """Close the window; never raises."""
        if self._loss.happened:
            # There is nothing to close, and OpenGL would crash on closing, now or at exit.
            self._window._closed = True
            return
        try:
            self._window.close()
        # The session must be concluded whatever the display raises.
        except Exception as error:
            sys.stderr.write(f"the answer window did not close cleanly: {error}\n")

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


def _import_psychopy() -> tuple[Any, Any]:
    """Import PsychoPy's modules ``visual`` and ``monitors`` quietly, and return them."""
    prepare_environment()
    try:
        with few_imports():
            from psychopy import logging

            logging.console.setLevel(logging.ERROR)
            from psychopy import monitors, visual
    except ImportError as error:
        if missing_libraries():
            raise WindowError(explain(error)) from error
        raise WindowError(
            f"PsychoPy cannot be imported ({error}); install the project's environment again (`make install`), "
            "or answer without a window (`--answers simulated`)"
        ) from error
    except Exception as error:
        raise WindowError(explain(error)) from error
    return visual, monitors
