"""Learns that the display has gone, where Xlib would otherwise end the process past every ``finally``."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from modaltouch.window.interface import WindowError

_HANDLERS: list[Any] = []
"""What Xlib may call for as long as the process lives; it keeps their addresses alone."""


class Loss:
    """Whether the X server behind a window has gone; elsewhere than on X this never happens.

    Xlib calls ``exit(1)`` once its connection is broken. Since libX11 1.7 a program may decline that
    (``XSetIOErrorExitHandler``): then every call on the connection does nothing, and the session can end in order. With
    an older libX11 the process ends, and the watchdog switches the outputs off.

    Parameters
    ----------
    look : callable
        Asks the display for events, so that a broken connection is noticed.
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
