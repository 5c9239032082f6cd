"""Event tap: all input to the window, time-stamped by one monotonic clock.

PsychoPy's input classes lose fast clicks and keys, or end the process, so the tap is attached to the pyglet window that
PsychoPy draws into. Its handlers only queue, since Windows would swallow an exception raised in a handler.
"""

from __future__ import annotations

import sys
from collections import deque
from functools import partial
from typing import Any

from modaltouch.protocol import AnswersSection
from modaltouch.system import SYSTEM_CLOCK, Clock
from modaltouch.window.interface import Event, EventKind

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
    """Queue of the events of a pyglet window.

    Parameters
    ----------
    window : pyglet window
        The window that PsychoPy draws into (its ``winHandle``).
    clock : Clock
        Clock of the time stamps.
    """

    def __init__(self, window: Any, clock: Clock = SYSTEM_CLOCK) -> None:
        from pyglet.window import key, mouse

        self._window = window
        self._clock = clock
        self._queue: deque[Event] = deque()
        self._held: set[str] = set()
        self._symbol_name = key.symbol_string
        self._left_button = mouse.LEFT
        self._digits = _engraved_digits(window)
        self.repeats_are_detectable = _report_releases_once(window)
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

    def _ignore_text(self, *_: object) -> bool:
        """Keep PsychoPy's buffers empty."""
        return True


def _report_releases_once(window: Any) -> bool:
    """Request detectable auto-repeat from X (no releases for a held key), and return whether it is supported.

    pyglet requests it only on the connection of its hidden window, but PsychoPy opens the visible one on a separate
    connection. A release followed by a press is then always a real one, however short the time between.
    """
    if not sys.platform.startswith("linux"):
        return True
    from ctypes import byref, c_int

    from pyglet.window.xlib import XkbSetDetectableAutoRepeat

    agreed = c_int()
    XkbSetDetectableAutoRepeat(window.display._display, 1, byref(agreed))
    return bool(agreed.value)


def _engraved_digits(window: Any) -> dict[str, str]:
    """Return the digits typed only with Shift, as in the French layout, by the names of their keys.

    On systems without X, the keys are already named after their digits.
    """
    if not sys.platform.startswith("linux"):
        return {}
    from pyglet.libs.x11.xlib import XKeycodeToKeysym
    from pyglet.window import key

    digits = {}
    for code in range(_FIRST_DIGIT, _FIRST_DIGIT + 10):
        plain, shifted = (XKeycodeToKeysym(window.display._display, code, level) for level in (0, 1))
        if ord("0") <= shifted <= ord("9") and not ord("0") <= plain <= ord("9"):
            symbol = plain if plain in key._key_names else key.user_key(code)
            digits[canonical_key(key.symbol_string(symbol))] = chr(shifted)
    return digits
