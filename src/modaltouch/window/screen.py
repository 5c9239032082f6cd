"""The one place where PsychoPy is: opens its window, draws pictures into it, reports what happens to it."""

from __future__ import annotations

import sys
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np

from modaltouch.clock import SYSTEM_CLOCK, Clock
from modaltouch.window.environment import explain, few_imports, fit, prepare_environment
from modaltouch.window.events import Event, EventTap
from modaltouch.window.interface import WindowError
from modaltouch.window.loss import Loss
from modaltouch.window.marks import Mark, Picture, Shape, Words
from modaltouch.window.softening import cover

_KEPT_MARKS = 1500
"""Marks kept ready to draw; a session with ten zone pairs needs about 600."""
_SMALLEST_SHRINK = 0.4
"""Type is never made smaller than this share of its wished size."""


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
        self._loss = Loss(self._tap.poll)

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
        """Put a key press or release into the window's own event queue, as if a person had typed it.

        Raises
        ------
        ValueError
            If no key has that name.
        """
        from pyglet.window import key as keys

        name = key.upper() if not key.isdigit() else f"_{key}"
        symbol = getattr(keys, name, None)
        if symbol is None:
            raise ValueError(f"given the key {key!r}; allowed: a key name of pyglet, such as left, space, num_4 or a")
        self._window.winHandle.dispatch_event("on_key_press" if down else "on_key_release", symbol, 0)

    def fits(self, words: Words) -> bool:
        """Return whether the words lie inside their box."""
        width, height = self._measure(self._stimuli(words)[0])
        return width <= words.box.width and height <= words.box.height

    def shrinks(self, words: Words) -> float:
        """Return the share of its wished size at which the text is drawn, 1 where it fits as it is."""
        return float(self._stimuli(words)[0].height) / words.size

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
        """Return the text, at its wished size or the largest that fits its box."""
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
    """Import PsychoPy's drawing half quietly, and return its modules ``visual`` and ``monitors``.

    Raises
    ------
    WindowError
        If there is no display, or no PsychoPy.
    """
    prepare_environment()
    try:
        with few_imports():
            from psychopy import logging

            logging.console.setLevel(logging.ERROR)
            from psychopy import monitors, visual
    except ImportError as error:
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
            pyglet.font.add_file(file)


def _open(visual: Any, size: tuple[int, int], **options: Any) -> Any:
    """Return a PsychoPy window."""
    try:
        return visual.Window(size, **options)
    except Exception as error:
        raise WindowError(explain(error)) from error
