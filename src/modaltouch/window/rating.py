"""Rating scales: entry of a number, and drawing of the scale."""

from __future__ import annotations

import math

from modaltouch.protocol import AnswersSection, ScaleSection, Texts
from modaltouch.window.buttons import common_size, key_caps, key_name, typesetter_of
from modaltouch.window.interface import Event
from modaltouch.window.layout import Layout, Theme
from modaltouch.window.shapes import Box, Mark, Words, capsule, framed, rectangle, triangle
from modaltouch.window.typesetting import Typesetter, first_letter_is_rtl

_MOVES = {"lower": -1, "higher": 1, "ten_lower": -10, "ten_higher": 10}
_BEFORE_CREEPING, _CREEP = 0.4, 0.03
"""Delay before a held key moves the mark repeatedly, and the time per step [s]."""
_LONGEST = 8
"""Maximum length of a typed number [characters]."""


class Entry:
    """A number being entered on a scale.

    Parameters
    ----------
    scale : ScaleSection
        The scale.
    line : Box
        Line of the scale on the screen, if any.
    text : str
        Initial text of the number.
    """

    def __init__(self, scale: ScaleSection, line: Box | None = None, text: str = "") -> None:
        self._scale, self._line = scale, line
        self._names = [f"{point:.10g}" for point in self._scale.points]
        self._held, self._moves_at = "", 0.0
        self.text = text

    @property
    def value(self) -> float | None:
        """The entered number; None if the scale does not accept the text."""
        try:
            value = float(self.text)
        except ValueError:
            return None
        return value if self._scale.takes(value) else None

    def take(self, action: str, event: Event) -> bool:
        """Apply an action, and return whether the number is confirmed.

        Parameters
        ----------
        action : str
            Name in `ScaleSection.actions`, number of a point, ``line`` for a position on it, or ``release``.
        event : Event
            Event of the action.
        """
        self._held = ""
        if action == "confirm":
            return self.value is not None
        if not self._names:
            self._type(action)
        elif action == "line" and self._line is not None:
            share = (event.x - self._line.left) / self._line.width
            share = 1 - share if self._scale.is_from_right else share
            self.text = self._names[round(min(max(share, 0.0), 1.0) * (len(self._names) - 1))]
        elif action in _MOVES:
            self._move(action)
            self._held, self._moves_at = (action if event.kind == "key" else ""), event.time + _BEFORE_CREEPING
        elif action in ("lowest", "highest"):
            self.text = self._names[0 if action == "lowest" else -1]
        elif action in self._names:
            self.text = action
        return False

    def creeps(self, now: float) -> bool:
        """Move the mark while a key is held, and return whether it moved."""
        if not self._held or now < self._moves_at:
            return False
        self._moves_at = now + _CREEP
        self._move(self._held)
        return True

    def towards(self, value: float) -> str:
        """Return the next action to enter and confirm a number."""
        if self.value == value:
            return "confirm"
        wanted = f"{value:.10g}"
        if not self._names:
            return wanted[len(self.text)] if wanted.startswith(self.text) else "back"
        if not self.text:
            return "higher"
        away = self._names.index(wanted) - self._names.index(self.text)
        named = [("ten_lower" if away < 0 else "ten_higher")] * (abs(away) >= 10 and self._scale.kind == "vas")
        return (named or ["lower" if away < 0 else "higher"])[0]

    def _move(self, action: str) -> None:
        last = len(self._names) - 1
        place = self._names.index(self.text) + _MOVES[action] if self.text else last // 2
        self.text = self._names[min(max(place, 0), last)]

    def _type(self, sign: str) -> None:
        if sign == "back":
            self.text = self.text[:-1]
        elif sign == "-":
            self.text = self.text[1:] if self.text.startswith("-") else f"-{self.text}"
        elif len(self.text) < _LONGEST and len(sign) == 1 and not (sign == "." and "." in self.text):
            self.text += sign


def as_read(asked: AnswersSection, texts: Texts) -> AnswersSection:
    """Return the question with its scale in the reading direction of the texts."""
    if asked.scale is None or not first_letter_is_rtl(texts.question):
        return asked
    return asked.model_copy(update={"scale": asked.scale.from_right()})


def draw_scale(
    layout: Layout, theme: Theme, texts: Texts, scale: ScaleSection, entered: str, *, confirmed: bool, keys: bool
) -> tuple[Mark, ...]:
    """Draw the scale with the number entered so far.

    Parameters
    ----------
    layout : Layout
        Layout with the parts of the scale.
    theme, texts, scale
        Colours, texts, and the scale.
    entered : str
        The number entered so far; empty at first.
    confirmed : bool
        Whether it is confirmed.
    keys : bool
        Whether to show the participant's keys.
    """
    parts = {"vas": _draw_line, "likert": _draw_points, "number": _draw_keypad}
    way = -1 if scale.is_from_right else 1
    marks = parts[scale.kind](layout, theme, entered, [f"{point:.10g}" for point in scale.points][::way], confirmed)
    words = tuple(texts.answers.get(each, each) for each in scale.words)[::way]
    marks += _draw_words(layout, theme, words, typesetter_of(texts))
    if scale.kind == "number" and math.isfinite(scale.high) and not entered:
        marks.append(Words(f"{scale.low:g} – {scale.high:g}", _field(layout).inset(0.008), 0.03, theme.dim))
    if confirmed:
        return tuple(marks)
    box, size = layout.buttons["confirm"], 0.032 * layout.type_scale
    key = key_name(texts, scale.actions["confirm"][0])
    label = texts.confirm_rating.format(key=key) if keys else texts.confirm_rating.format(key="")
    ink = theme.text if entered else theme.dim
    marks += framed(box, 0.016, theme.button_edge, theme.button, 0.003)
    marks.append(Words(label.rstrip(" :：(（)）"), box.inset(0.008), size, ink))
    for action, side in (("lower", -way), ("higher", way)) if keys and scale.points else ():
        beside = Box(side * (box.width / 2 + 0.07 * layout.unit), box.y, 0.1, 0.042)
        marks += key_caps(texts, theme, scale.actions[action][:1], beside)
    return tuple(marks)


def _fills(theme: Theme, *, chosen: bool, confirmed: bool) -> tuple[str, str]:
    """Return fill and text colour of a part: those of a pressed button if confirmed, of a touched zone if chosen."""
    if chosen:
        return (theme.pressed, theme.pressed_text) if confirmed else (theme.zone, theme.text)
    return theme.button, theme.text


def _draw_line(layout: Layout, theme: Theme, entered: str, names: list[str], confirmed: bool) -> list[Mark]:
    line, unit = layout.buttons["line"], layout.unit
    marks: list[Mark] = [rectangle(Box(0, line.y, line.width, 0.006), theme.button_edge)]
    marks += [rectangle(Box(x, line.y, 0.005, 0.04), theme.button_edge) for x in (line.left, line.right)]
    if entered:
        x = line.left + line.width * names.index(entered) / (len(names) - 1)
        reach = 0.036 if confirmed else 0.028
        marks.append(capsule((x, line.y - reach), (x, line.y + reach), 0.009 * unit, theme.text))
    return marks


def _draw_points(layout: Layout, theme: Theme, entered: str, names: list[str], confirmed: bool) -> list[Mark]:
    marks: list[Mark] = []
    for name in names:
        box = layout.buttons[name]
        fill, ink = _fills(theme, chosen=name == entered, confirmed=confirmed)
        marks += framed(box, 0.018, theme.text if name == entered else theme.button_edge, fill, 0.005)
        marks.append(Words(name, box.inset(0.008), 0.042 * layout.type_scale, ink, bold=name == entered))
    return marks


def _field(layout: Layout) -> Box:
    return Box(0, -0.2, 0.42 * layout.unit, 0.066)


def _draw_keypad(layout: Layout, theme: Theme, entered: str, names: list[str], confirmed: bool) -> list[Mark]:
    box = _field(layout)
    fill, ink = _fills(theme, chosen=confirmed, confirmed=confirmed)
    marks: list[Mark] = [*framed(box, 0.014, theme.text, fill, 0.004)]
    if entered:
        marks.append(Words(entered, box.inset(0.006), 0.046, ink, bold=True))
    for name, key in layout.buttons.items():
        if name != "confirm" and not confirmed:
            marks += framed(key, 0.012, theme.button_edge, theme.button, 0.003)
            sign = triangle("left", key.x, key.y, 0.013, theme.text)
            marks.append(sign if name == "back" else Words(name, key.inset(0.006), 0.032, theme.text))
    return marks


def _draw_words(layout: Layout, theme: Theme, words: tuple[str, ...], typesetter: Typesetter) -> list[Mark]:
    """Return the words under the points, or under the two ends and shifted towards the middle."""
    if not words:
        return []
    boxes = [box for name, box in layout.buttons.items() if name != "confirm"]
    under, size = min(box.bottom for box in boxes), 0.03 * layout.type_scale
    if len(words) == len(boxes):
        places = [Box(box.x, under - 0.043, box.width * 1.12, 0.07) for box in boxes]
        size = common_size(typesetter, words, places[0], size)
    else:
        y, height, measure = under - 0.028, 0.05, typesetter.measure
        left, right = min(box.left for box in boxes), max(box.right for box in boxes)
        widths = [min(0.36 * (right - left), (measure(text) + 1) * size) for text in words]
        reach = [max(width / 2 - 0.02, 0.02) for width in widths]
        xs = left + reach[0], right - reach[1]
        places = [Box(x, y, width, height) for x, width in zip(xs, widths, strict=True)]
    return [Words(text, place, size, theme.text) for text, place in zip(words, places, strict=True)]
