"""The one place where PsychoPy is: opens its window, draws pictures into it, reports what happens to it."""

from __future__ import annotations

import math
import os
import sys
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modaltouch.system import SYSTEM_CLOCK, Clock
from modaltouch.window.environment import explain, few_imports, fit, missing_libraries, prepare_environment
from modaltouch.window.events import EventTap
from modaltouch.window.interface import Event, WindowError
from modaltouch.window.shapes import Mark, Picture, Shape, Words


@dataclass(frozen=True, eq=False)
class Coverage:
    """The part of the screen that a polygon touches."""

    left: int
    bottom: int
    alpha: NDArray[np.float32]


def cover(corners: NDArray[np.float64]) -> Coverage:
    """Return how much of each pixel a convex polygon covers.

    A pixel's share is taken from the distance of its centre to the nearest edge: exact for a straight edge
    along the pixel grid, and within 0.1 of the true area elsewhere.

    Parameters
    ----------
    corners : (n_corners, 2) array
        Corners in order, either way round [pixels], y upwards.
    """
    left, bottom = (math.floor(low) - 1 for low in corners.min(axis=0))
    right, top = (math.ceil(high) + 1 for high in corners.max(axis=0))
    x = np.arange(left, right, dtype=np.float32) + np.float32(0.5)
    y = np.arange(bottom, top, dtype=np.float32)[:, np.newaxis] + np.float32(0.5)
    following = np.roll(corners, -1, axis=0)
    turn = np.sign(np.sum(corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1]))
    inside = np.full((top - bottom, right - left), np.inf, dtype=np.float32)
    for (x0, y0), (x1, y1) in zip(corners, following, strict=True):
        length = math.hypot(x1 - x0, y1 - y0)
        if length < 1e-9:
            continue
        normal_x, normal_y = -turn * (y1 - y0) / length, turn * (x1 - x0) / length
        distance = np.float32(normal_x) * (x - np.float32(x0)) + np.float32(normal_y) * (y - np.float32(y0))
        np.minimum(inside, distance, out=inside)
    return Coverage(left, bottom, np.clip(inside + np.float32(0.5), 0, 1))


_HANDLERS: list[Any] = []
"""What Xlib may call for as long as the process lives; it keeps their addresses alone."""


class DisplayLoss:
    """Whether the X server behind a window has gone; elsewhere than on X this never happens.

    Xlib calls ``exit(1)`` once its connection is broken. Since libX11 1.7 a program may decline that
    (``XSetIOErrorExitHandler``): then every call on the connection does nothing, and the session can end in order. With
    an older libX11 the process ends, and the watchdog switches the outputs off.
    """

    def __init__(self, look: Callable[[], object]) -> None:
        self.happened = False
        self._look = look
        if sys.platform.startswith("linux"):
            self._decline_to_exit()

    @contextmanager
    def told(self) -> Iterator[None]:
        """Tell a lost display as such, whatever OpenGL and pyglet make of it.

        Raises
        ------
        WindowError
            If the display has gone.
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
            raise WindowError(f"the display {name!r} is gone; see why its X server ended, and start it again")

    def _decline_to_exit(self) -> None:
        """Stay alive when a connection breaks: pyglet has one for each window, hidden ones too."""
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
"""Marks kept ready to draw; a session with ten zone pairs needs about 600."""
_SMALLEST_SHRINK = 0.4
"""Type is never made smaller than this share of its intended size."""


class Screen:
    """An open window.

    Parameters
    ----------
    size : (width, height) of int
        Size of the window [pixels], cut to the monitor's; a full screen takes the monitor's.
    fullscreen : bool
        Whether the window covers the monitor.
    monitor : int
        Which monitor, from 0.
    ground : str
        Background colour as ``#RRGGBB``.
    title : str
        Title of the window.
    clock : Clock
        Stamps pictures and events.

    Raises
    ------
    WindowError
        If there is no display, none that can draw, or no such monitor.
    """

    def __init__(
        self,
        *,
        size: tuple[int, int] = (1280, 800),
        fullscreen: bool = False,
        monitor: int = 0,
        ground: str = "#000000",
        title: str = "modaltouch",
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._clock = clock
        visual, monitors = _import_psychopy()
        self._visual = visual
        self._place: dict[str, Any] = {"fullscreen": fullscreen, "monitor": monitor}
        _load_fonts()
        self._ready: OrderedDict[Mark, tuple[Any, ...]] = OrderedDict()
        self._window = _open(
            visual,
            fit(size, monitor),
            fullscr=fullscreen,
            allowGUI=not fullscreen,
            screen=monitor,
            color=ground,
            colorSpace="rgb",
            units="height",
            # A monitor without a file behind it: PsychoPy then neither warns nor writes one.
            monitor=monitors.Monitor("modaltouch", width=50, distance=60, verbose=False, autoLog=False),
            checkTiming=False,
            gammaErrorPolicy="ignore",
            winType="pyglet",
            autoLog=False,
            title=title,
        )
        self._window.mouseVisible = True
        self._tap = EventTap(self._window.winHandle, clock)
        self._loss = DisplayLoss(self._tap.poll)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the drawing area [pixels]."""
        width, height = self._window.size
        return int(width), int(height)

    def describe(self) -> dict[str, Any]:
        """Return what the start record says about the window."""
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
        """Make the picture's marks ready, so that drawing it later takes no longer than a frame."""
        with self._loss.told():
            for mark in picture.marks:
                self._stimuli(mark)

    def draw(self, picture: Picture) -> None:
        """Draw the picture where nobody sees it, until `flip` brings it onto the screen."""
        from pyglet.gl import glFinish

        with self._loss.told():
            self._window.clearBuffer()
            for mark in picture.marks:
                for stimulus in self._stimuli(mark):
                    stimulus.draw()
            # Else OpenGL would do the work within the flip.
            glFinish()

    def flip(self, screenshot: Path | None = None) -> float:
        """Bring what is drawn onto the screen, and return when it was there, by the window's clock [s].

        Parameters
        ----------
        screenshot : Path, optional
            PNG file to write it to.

        Raises
        ------
        WindowError
            If the screenshot cannot be written, or the display has gone.
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
                    f"the screenshot {screenshot} cannot be written ({error}); give a folder that takes files"
                ) from error
        return shown

    def poll(self) -> list[Event]:
        """Return what happened to the window since the last poll.

        Raises
        ------
        WindowError
            If the display has gone.
        """
        with self._loss.told():
            return self._tap.poll()

    def type_key(self, key: str, *, down: bool) -> None:
        """Put a key press or release into the window's own event queue, as if a person had typed it."""
        from pyglet.window import key as keys

        name = key.upper() if not key.isdigit() else f"_{key}"
        symbol = getattr(keys, name)
        self._window.winHandle.dispatch_event("on_key_press" if down else "on_key_release", symbol, 0)

    def close(self) -> None:
        """Close the window; never raises."""
        if self._loss.happened:
            # Nothing is left to close, and OpenGL would crash: neither here nor as the process ends.
            self._window._closed = True
            return
        try:
            self._window.close()
        # Whatever the display does, the session must go on to its end.
        except Exception as error:
            sys.stderr.write(f"the answer window did not close cleanly: {error}\n")

    def _stimuli(self, mark: Mark) -> tuple[Any, ...]:
        """Return what draws a mark, made once and kept."""
        ready = self._ready.get(mark)
        if ready is None:
            ready = (self._polygon(mark),) if isinstance(mark, Shape) else (self._text(mark),)
            self._ready[mark] = ready
            if len(self._ready) > _KEPT_MARKS:
                self._ready.popitem(last=False)
        else:
            self._ready.move_to_end(mark)
        return ready

    def _polygon(self, shape: Shape) -> Any:
        """Return the polygon as an image whose pixels are the window's own."""
        width, height = self.size
        corners = np.array(shape.corners) * height + (width / 2, height / 2)
        covered = cover(corners)
        rows, columns = covered.alpha.shape
        image = np.empty((rows, columns, 4), dtype=np.float32)
        # Unlike everywhere else in PsychoPy, colours count from 0 to 1 in an image with opacity.
        image[..., :3] = [int(shape.fill[place : place + 2], 16) / 255 for place in (1, 3, 5)]
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

    def _text(self, words: Words) -> Any:
        """Return the text, at its intended size or the largest that fits its box."""
        share = 1.0
        while True:
            stimulus = self._visual.TextStim(
                self._window,
                words.text,
                font="Noto Sans",
                pos=(words.box.x, words.box.y),
                height=words.size * share,
                wrapWidth=words.box.width,
                color=words.fill,
                bold=words.bold,
                autoLog=False,
            )
            width, height = self._measure(stimulus)
            if (width <= words.box.width and height <= words.box.height) or share <= _SMALLEST_SHRINK:
                return stimulus
            share -= 0.05

    def _measure(self, stimulus: Any) -> tuple[float, float]:
        """Return the extent of a text [window heights]."""
        width, height = stimulus.boundingBox
        return width / self.size[1], height / self.size[1]


def _import_psychopy() -> tuple[Any, Any]:
    """Import PsychoPy's drawing half quietly, and return its modules ``visual`` and ``monitors``."""
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


def _load_fonts() -> None:
    """Load the fonts that PsychoPy brings along, so that every machine shows the same picture."""
    import psychopy
    import pyglet.font

    folder = Path(psychopy.__file__).parent / "assets" / "fonts"
    for name in ("NotoSans-Regular.ttf", "NotoSans-Bold.ttf"):
        with (folder / name).open("rb") as file:
            try:
                pyglet.font.add_file(file)
            except ImportError as error:
                raise WindowError(explain(error)) from error


def _open(visual: Any, size: tuple[int, int], **options: Any) -> Any:
    """Return a PsychoPy window."""
    try:
        return visual.Window(size, **options)
    except Exception as error:
        raise WindowError(explain(error)) from error
