"""What an event means to a session: an answer, going on, a pause, the end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from modaltouch.protocol import AnswersSection
from modaltouch.window.events import canonical_key
from modaltouch.window.interface import Event
from modaltouch.window.layout import Layout

DEVICES = {"key": "key", "click": "mouse", "answer": "console", "continue": "console"}
"""Where an answer comes from, by the kind of its event."""


@dataclass(frozen=True)
class Reader:
    """Reads events by one protocol's keys and one window's layout.

    Attributes
    ----------
    layout : Layout
        Where the answer buttons are.
    keys : dict of str to str
        Answer by key.
    continue_keys : frozenset of str
        Keys that go on from one screen to the next.
    needs_focus : bool
        Whether answers come from the window alone; the experimenter has the console, too.
    rates : bool
        Whether a number is entered on a scale, so that releases count, and going on at the console confirms it.
    """

    layout: Layout
    keys: dict[str, str]
    continue_keys: frozenset[str]
    needs_focus: bool = True
    rates: bool = False

    @classmethod
    def of(cls, answers: AnswersSection, layout: Layout) -> Self:
        """Return the reader for a protocol's keys."""
        keys = {canonical_key(key): answer for answer, given in answers.actions.items() for key in given}
        goes_on = frozenset(map(canonical_key, answers.continue_keys))
        return cls(layout, keys, goes_on, answers.given_by == "participant", answers.scale is not None)

    def answer(self, event: Event) -> str | None:
        """Return the answer that somebody gives, or what is done on a scale; None for anything else."""
        if event.kind == "key":
            return self.keys.get(event.key) or self.keys.get(event.digit)
        if event.kind == "click":
            return self.layout.answer_at(event.x, event.y)
        if self.rates and event.kind in ("release", "continue"):
            return "release" if event.kind == "release" else "confirm"
        return event.answer

    def goes_on(self, event: Event) -> bool:
        """Return whether the event is a key to go on, or the experimenter's request to."""
        named = {event.key, event.digit}
        return event.kind == "continue" or (event.kind == "key" and not named.isdisjoint(self.continue_keys))

    def name(self, event: Event) -> str:
        """Return the name by which the protocol knows the key that was pressed."""
        return event.digit if event.digit and event.key not in self.keys else event.key

    def pauses(self, event: Event) -> bool:
        """Return whether the event asks for a pause, or for the end."""
        return event.kind in ("close", "pause") or (event.kind == "key" and event.key == AnswersSection.PAUSE_KEY)

    def interrupts(self, event: Event) -> bool:
        """Return whether the event cuts a trial: a pause, or keys that now go to another window."""
        return (event.kind == "blur" and self.needs_focus) or self.pauses(event)

    def ends(self, event: Event) -> bool:
        """Return whether the event ends the session from the pause screen."""
        return event.kind == "key" and event.key == AnswersSection.END_KEY


def is_press(event: Event) -> bool:
    """Return whether the event is a key press or a click, or a key typed at the console."""
    return event.kind in ("key", "click", "answer")


def describe_press(event: Event) -> dict[str, Any]:
    """Return a press as the record names it."""
    if event.kind == "answer":
        return {"key": event.key, "device": DEVICES["answer"]}
    if event.kind == "key":
        return {"key": event.key}
    return {"click": [round(event.x, 3), round(event.y, 3)]}
