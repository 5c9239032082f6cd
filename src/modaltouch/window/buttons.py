"""The answers on the screen: a button for each, with its word and the keys that give it."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from functools import cached_property, partial

from modaltouch.protocol import Answer, AnswersSection, Texts
from modaltouch.window.layout import Layout
from modaltouch.window.shapes import Box, Mark, Words, framed, rounded, triangle
from modaltouch.window.theme import Theme

_ARROWS = ("left", "right", "up", "down")
_BOLD_LETTER = 0.62
"""Mean width of a bold letter of Noto Sans [em]."""
_LINE = 1.4
"""Height of a line of it [em]."""
_MOST_LINES = 3
"""Lines of an answer on its button."""


@dataclass(frozen=True)
class Buttons:
    """Draws the answers of one protocol in one window.

    Attributes
    ----------
    layout : Layout
        Places and sizes.
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

    @cached_property
    def _offered(self) -> dict[str, Answer]:
        return {answer.name: answer for answer in self.answers.offered}

    def draw(self, chosen: str | None, *, with_keys: bool) -> tuple[Mark, ...]:
        """Return all buttons, the one of the `chosen` answer pressed, with the keys that give each or without."""
        marks: list[Mark] = []
        for answer, box in self.layout.buttons.items():
            if self._offered[answer].is_below:
                marks += self._low_button(answer, box, pressed=answer == chosen, with_keys=with_keys)
                continue
            marks += self._button(answer, pressed=answer == chosen, with_keys=with_keys)
            if with_keys:
                below = Box(box.x, box.y - 0.27 * box.height, box.width * 0.9, 0.25 * box.height)
                marks += self._key_caps(answer, below)
        return tuple(marks)

    def _low_button(self, answer: str, box: Box, *, pressed: bool, with_keys: bool) -> tuple[Mark, ...]:
        """Return a button too low for two lines: its word in the middle, its key beside it."""
        theme, unit = self.theme, self.layout.unit
        fill, ink = (theme.pressed, theme.pressed_text) if pressed else (theme.button, theme.text)
        longest = max(len(self._word(name)) for name, other in self._offered.items() if other.is_below)
        size = min(self._answer_size, 0.5 * box.height, 0.5 * box.width / (_BOLD_LETTER * longest))
        words = Words(self._word(answer), Box(box.x, box.y, box.width * 0.5, box.height * 0.9), size, ink, bold=True)
        beside = Box(box.x + 0.36 * box.width, box.y, box.width * 0.2, 0.6 * box.height)
        return (
            *framed(box, 0.018 * unit, theme.button_edge, fill, 0.006 * unit),
            words,
            *(self._key_caps(answer, beside) if with_keys else ()),
        )

    def _button(self, answer: str, *, pressed: bool, with_keys: bool) -> tuple[Mark, ...]:
        """Return a button with its word above the keys, or in the middle where there are none."""
        theme, box, unit = self.theme, self.layout.buttons[answer], self.layout.unit
        own = self._offered[answer]
        edge = {-1: theme.left, 1: theme.right}.get(own.side, theme.button_edge)
        fill, ink = (theme.pressed, theme.pressed_text) if pressed else (theme.button, theme.text)
        lift = 0.18 * box.height if with_keys else 0.0
        upper = Box(box.x, box.y + lift, box.width * self._share, 0.52 * box.height)
        at = 0.4 * box.width
        arrows = [
            triangle(way, box.x + sign * at, upper.y - 0.004 * unit, 0.018 * unit, ink if pressed else edge)
            for way, sign in (("left", -1), ("right", 1))
            if way in (own.fingers or ())
        ]
        return (
            *framed(box, 0.022 * unit, edge, fill, 0.006 * unit),
            Words(self._word(answer), upper, self._answer_size, ink, bold=True),
            *arrows,
        )

    def _word(self, answer: str) -> str:
        return self.texts.label(answer)

    @cached_property
    def _share(self) -> float:
        """Share of a button's width that its word may take: arrows for fingers stand on both sides of it."""
        return 0.68 if any(answer.fingers for answer in self._offered.values()) else 0.9

    @cached_property
    def _answer_size(self) -> float:
        """One size of type at which every answer of the row fits its button, on several lines where it is larger so."""
        labels = [self._word(name) for name, own in self._offered.items() if not own.is_below] or ["-"]
        width = self.layout.answer_width * self._share
        height = 0.52 * next(iter(self.layout.buttons.values())).height
        sizes = [width / (_BOLD_LETTER * max(map(len, labels)))]
        for n_lines in range(2, _MOST_LINES + 1):
            longest = max(_longest_line(label, n_lines) for label in labels)
            sizes.append(min(width / (_BOLD_LETTER * longest), height / (_LINE * n_lines)))
        return min(0.062 * self.layout.type_scale, max(sizes))

    def _key_caps(self, answer: str, box: Box) -> tuple[Mark, ...]:
        """Return the keys that give an answer: arrows where there are any, else the first two."""
        keys = self.answers.keys[answer]
        shown = [key for key in keys if key in _ARROWS] or list(keys[:2])
        marks: list[Mark] = []
        labels = [None if key in _ARROWS else key_name(self.texts, key) for key in shown]
        widths = [box.height if label is None else box.height * max(1.0, 0.34 * len(label) + 0.5) for label in labels]
        gap = 0.25 * box.height
        x = box.x - (sum(widths) + gap * (len(widths) - 1)) / 2
        for key, label, width in zip(shown, labels, widths, strict=True):
            cap = Box(x + width / 2, box.y, width, box.height)
            edge = self.theme.button_edge
            marks.append(rounded(cap, 0.2 * box.height, edge))
            marks.append(rounded(cap.inset(0.05 * box.height), 0.16 * box.height, self.theme.ground))
            if label is None:
                marks.append(triangle(key, cap.x, cap.y, 0.24 * box.height, self.theme.text))
            else:
                inner = cap.inset(0.08 * box.height)
                marks.append(Words(label, inner, 0.58 * box.height, self.theme.text))
            x += width + gap
        return tuple(marks)


def _longest_line(label: str, n_lines: int) -> int:
    """Return the letters of the longest line of a label in as many lines, broken between words alone."""
    # Not split(): a space that must not break is part of a word.
    words = label.replace("\n", " ").split(" ")
    wrap = partial(textwrap.wrap, label, break_on_hyphens=False)
    return next(n for n in range(max(map(len, words)), len(label) + 1) if len(wrap(n)) <= n_lines)


def key_name(texts: Texts, key: str) -> str:
    """Return what the participant calls a key."""
    return texts.key_names.get(key, key.removeprefix("num_").upper())
