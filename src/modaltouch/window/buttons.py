"""Answer buttons on the screen, with labels and keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

from modaltouch.protocol import AnswersSection, Texts
from modaltouch.window.layout import Layout, Theme
from modaltouch.window.shapes import Box, Mark, Words, framed, triangle
from modaltouch.window.typesetting import Typesetter

_ARROWS = ("left", "right", "up", "down")
_REFERENCE = 1000
"""Height of a window in which labels are measured [pixels]."""


@dataclass(frozen=True)
class Buttons:
    """Answer buttons of a protocol in a window.

    Attributes
    ----------
    layout : Layout
        Positions and sizes.
    theme : Theme
        Colours.
    texts : Texts
        Words.
    answers : AnswersSection
        Keys.
    """

    layout: Layout
    theme: Theme
    texts: Texts
    answers: AnswersSection

    def draw(self, chosen: str | None, *, with_keys: bool) -> tuple[Mark, ...]:
        """Return all buttons, with that of the `chosen` answer pressed, and optionally the keys of each answer."""
        marks: list[Mark] = []
        for answer, box in self.layout.buttons.items():
            if self.answers.offered.named(answer).is_below:
                marks += self._low_button(answer, box, pressed=answer == chosen, with_keys=with_keys)
                continue
            marks += self._button(answer, pressed=answer == chosen, with_keys=with_keys)
            if with_keys:
                below = Box(box.x, box.y - 0.27 * box.height, box.width * 0.9, 0.25 * box.height)
                marks += key_caps(self.texts, self.theme, self.answers.keys[answer], below)
        return tuple(marks)

    def _low_button(self, answer: str, box: Box, *, pressed: bool, with_keys: bool) -> tuple[Mark, ...]:
        """Return a button too low for two lines, with its label in the middle and its key beside it."""
        theme, unit = self.theme, self.layout.unit
        fill, ink = (theme.pressed, theme.pressed_text) if pressed else (theme.button, theme.text)
        middle = Box(box.x, box.y, box.width * 0.5, box.height * 0.9)
        labels = tuple(self.texts.label(each.name) for each in self.answers.offered if each.is_below)
        size = common_size(typesetter_of(self.texts), labels, middle, min(self._answer_size, 0.5 * box.height))
        words = Words(self.texts.label(answer), middle, size, ink, bold=True)
        beside = Box(box.x + 0.36 * box.width, box.y, box.width * 0.2, 0.6 * box.height)
        return (
            *framed(box, 0.018 * unit, theme.button_edge, fill, 0.006 * unit),
            words,
            *(key_caps(self.texts, theme, self.answers.keys[answer], beside) if with_keys else ()),
        )

    def _button(self, answer: str, *, pressed: bool, with_keys: bool) -> tuple[Mark, ...]:
        """Return a button with its label above the keys, or in the middle without keys."""
        theme, box, unit = self.theme, self.layout.buttons[answer], self.layout.unit
        own = self.answers.offered.named(answer)
        edges = {"left": theme.left, "between": theme.between, "right": theme.right}
        edge = edges.get("".join(own.fingers or ()), theme.button_edge)
        fill, ink = (theme.pressed, theme.pressed_text) if pressed else (theme.button, theme.text)
        lift = 0.18 * box.height if with_keys else 0.0
        upper = Box(box.x, box.y + lift, box.width * self._share, 0.52 * box.height)
        at = 0.4 * box.width
        arrows = [
            triangle(way, box.x + sign * at, upper.y, 0.018 * unit, ink if pressed else edge)
            for way, sign in (("left", -1), ("right", 1))
            if way in (own.fingers or ())
        ]
        return (
            *framed(box, 0.022 * unit, edge, fill, 0.006 * unit),
            Words(self.texts.label(answer), upper, self._answer_size, ink, bold=True),
            *arrows,
        )

    @cached_property
    def _share(self) -> float:
        """Share of a button's width for its label, between arrows if answers name fingers."""
        return 0.68 if any(answer.fingers for answer in self.answers.offered) else 0.84

    @cached_property
    def _answer_size(self) -> float:
        """Type size at which every answer of the row fits its button, on several lines if that is larger."""
        labels = tuple(self.texts.label(each.name) for each in self.answers.offered if not each.is_below)
        box = Box(0, 0, self.layout.answer_width * self._share, 0.52 * next(iter(self.layout.buttons.values())).height)
        return common_size(typesetter_of(self.texts), labels or ("-",), box, 0.062 * self.layout.type_scale)


def key_caps(texts: Texts, theme: Theme, keys: Sequence[str], box: Box) -> tuple[Mark, ...]:
    """Return key caps side by side, of the height of a box: the arrow keys if any, else the first two keys."""
    shown = [key for key in keys if key in _ARROWS] or list(keys[:2])
    marks: list[Mark] = []
    labels = [None if key in _ARROWS else key_name(texts, key) for key in shown]
    measure = typesetter_of(texts).measure
    widths = [box.height * (1.0 if not label else max(1.0, 0.58 * measure(label) + 0.5)) for label in labels]
    gap = 0.25 * box.height
    x = box.x - (sum(widths) + gap * (len(widths) - 1)) / 2
    for key, label, width in zip(shown, labels, widths, strict=True):
        cap = Box(x + width / 2, box.y, width, box.height)
        marks += framed(cap, 0.2 * box.height, theme.button_edge, theme.ground, 0.05 * box.height)
        if label is None:
            marks.append(triangle(key, cap.x, cap.y, 0.24 * box.height, theme.text))
        else:
            marks.append(Words(label, cap.inset(0.08 * box.height), 0.58 * box.height, theme.text))
        x += width + gap
    return tuple(marks)


@cache
def common_size(typesetter: Typesetter, labels: tuple[str, ...], box: Box, size: float) -> float:
    """Return the largest type size up to `size` at which every label fits a box; cached."""
    words = (Words(label, box, size, "", bold=True) for label in labels)
    return size * min(typesetter.set_type(each, _REFERENCE).share for each in words)


def typesetter_of(texts: Texts) -> Typesetter:
    """Return the typesetter for the texts of an experiment."""
    return Typesetter(texts.font, texts.language_code or "")


def key_name(texts: Texts, key: str) -> str:
    """Return the name of a key for the participant."""
    return texts.key_names.get(key, key.removeprefix("num_").upper())
