"""Controls on the screen: answer buttons, rating scales, and the entry of a number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

from modaltouch.protocol import AnswersSection, ScaleSection, Texts
from modaltouch.window.interface import Event
from modaltouch.window.layout import Box, Layout, Mark, Theme, Words, capsule, framed, rectangle, triangle
from modaltouch.window.typesetting import Typesetter, first_letter_is_rtl

_ARROWS = ("left", "right", "up", "down")


def draw_buttons(
    layout: Layout, theme: Theme, texts: Texts, answers: AnswersSection, chosen: str | None, *, with_keys: bool
) -> tuple[Mark, ...]:
    """Draw all answer buttons, with that of the `chosen` answer pressed, and optionally the keys of each answer.

    Labels in a row have the largest size at which each fits its button, on several lines if that is larger.
    """
    marks: list[Mark] = []
    # Narrow buttons begin with smaller type, so that their labels still have one size.
    size = min(0.062 * layout.type_scale, 0.27 * max(box.width for box in layout.buttons.values()))
    for is_below in (False, True):
        row = [answer for answer in answers.offered if answer.is_below is is_below]
        # Between arrows if answers name fingers.
        share = 0.5 if is_below else 0.68 if any(answer.fingers for answer in row) else 0.91
        boxes = [_divide(layout.buttons[each.name], share, is_below=is_below, with_keys=with_keys) for each in row]
        labels = [texts.label(answer.name) for answer in row]
        if row:
            most = min(size, 0.5 * layout.buttons[row[0].name].height) if is_below else size
            size = common_size(typesetter_of(texts), tuple(labels), replace(boxes[0][0], x=0.0), most)
        for answer, (inner, caps), words in zip(row, boxes, labels, strict=True):
            pressed, box = answer.name == chosen, layout.buttons[answer.name]
            marks += _draw_frame(layout.unit, theme, answer.fingers or (), box, pressed=pressed, level=inner.y)
            marks.append(Words(words, inner, size, theme.ground if pressed else theme.text, bold=True))
            marks += key_caps(texts, theme, answers.keys[answer.name], caps) if with_keys else ()
    return tuple(marks)


def _divide(box: Box, share: float, *, is_below: bool, with_keys: bool) -> tuple[Box, Box]:
    """Return the boxes of a button's label, a `share` of its width, and of its keys: below it, or beside if low."""
    if is_below:
        label, beside = replace(box, width=share * box.width, height=0.9 * box.height), box.x + 0.36 * box.width
        return label, Box(beside, box.y, 0.2 * box.width, 0.47 * box.height)
    height = min(0.25 * box.height, 0.044)
    caps = Box(box.x, box.bottom + 0.017 + height / 2, 0.9 * box.width, height)
    low, high = caps.top + 0.004 if with_keys else box.bottom + 0.014, box.top - 0.014
    return Box(box.x, (low + high) / 2, share * box.width, high - low), caps


def _draw_frame(
    unit: float, theme: Theme, fingers: tuple[str, ...], box: Box, *, pressed: bool, level: float
) -> tuple[Mark, ...]:
    """Draw a button in the colour of the finger it names, with arrows towards its fingers at a level."""
    edges = {"left": theme.left, "between": theme.between, "right": theme.right}
    edge = edges.get("".join(fingers), theme.button_edge)
    fill, ink = (theme.text, theme.ground) if pressed else (theme.button, edge)
    size = min(0.018 * unit, 0.065 * box.width)
    beside = min(0.4 * box.width, 0.5 * box.width - size - 0.012 * unit)  # within the frame
    ways = {"left": box.x - beside, "right": box.x + beside}
    arrows = [triangle(way, x, level, size, ink) for way, x in ways.items() if way in fingers]
    return (*framed(box, 0.022 * unit, edge, fill, 0.006 * unit), *arrows)


def key_caps(texts: Texts, theme: Theme, keys: Sequence[str], box: Box) -> tuple[Mark, ...]:
    """Return key caps side by side, of the height of a box: the arrow keys if any, else the first two keys.

    A digit is shown once for its key in the top row and the one of the keypad.
    """
    shown = [key for key in keys if key in _ARROWS] or list({key_name(texts, key): key for key in keys[:2]}.values())
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
    # In a window 1000 pixels high, whatever the real one has.
    return size * min(typesetter.set_type(each, 1000).share for each in words)


def typesetter_of(texts: Texts) -> Typesetter:
    """Return the typesetter for the texts of an experiment."""
    return Typesetter(texts.font, texts.language_code or "")


def key_name(texts: Texts, key: str) -> str:
    """Return the name of a key for the participant."""
    return texts.key_names.get(key, key.removeprefix("num_").upper())


_MOVES = {"lower": -1, "higher": 1, "ten_lower": -10, "ten_higher": 10}
_BEFORE_CREEPING, _CREEP = 0.4, 0.03
"""Delay before a held key moves the mark repeatedly, and the time per step [s]."""
_LONGEST = 10
"""Maximum length of a typed number [characters], all of whose digits are in the table of answers."""


class Entry:
    """A number being entered on a scale."""

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
        match action:
            case "confirm":
                return self.value is not None
            case _ if not self._names:
                self._type(action)
            case "line" if self._line is not None:
                share = (event.x - self._line.left) / self._line.width
                share = 1 - share if self._scale.is_from_right else share
                self.text = self._names[round(min(max(share, 0.0), 1.0) * (len(self._names) - 1))]
            case "lowest":
                self.text = self._names[0]
            case "highest":
                self.text = self._names[-1]
            case _ if action in _MOVES:
                self._move(action)
                self._held, self._moves_at = (action if event.kind == "key" else ""), event.time + _BEFORE_CREEPING
            case _ if action in self._names:
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
        step = "ten_" if abs(away) >= 10 and self._scale.kind == "vas" else ""
        return step + ("lower" if away < 0 else "higher")

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


def reads_from_right(asked: AnswersSection, texts: Texts) -> bool:
    """Return whether a question's first answer is on the right: in a right-to-left language, unless sides matter."""
    keys = {key for each in asked.keys.values() for key in each}
    has_sides = any(answer.fingers for answer in asked.offered) or not keys.isdisjoint(("left", "right"))
    return first_letter_is_rtl(texts.question) and not has_sides


def draw_scale(
    layout: Layout, theme: Theme, texts: Texts, scale: ScaleSection, entered: str, *, confirmed: bool, keys: bool
) -> tuple[Mark, ...]:
    """Draw the scale with the number entered so far."""
    parts = {"vas": _draw_line, "likert": _draw_points, "number": _draw_keypad}
    way = -1 if scale.is_from_right else 1
    marks = parts[scale.kind](layout, theme, entered, [f"{point:.10g}" for point in scale.points][::way], confirmed)
    words = tuple(texts.answers.get(each, each) for each in scale.words)[::way]
    marks += _draw_words(layout, theme, words, typesetter_of(texts))
    if scale.kind == "number" and math.isfinite(scale.high) and not entered:
        marks.append(Words(f"{scale.low:.10g} – {scale.high:.10g}", _field(layout).inset(0.008), 0.03, theme.dim))
    if confirmed:
        return tuple(marks)
    box, size = layout.buttons["confirm"], 0.032 * layout.type_scale
    label = texts.confirm_rating.format(key=key_name(texts, scale.actions["confirm"][0]) if keys else "")
    marks += framed(box, 0.016, theme.button_edge, theme.button, 0.003)
    marks.append(Words(label.rstrip(" :：(（)）"), box.inset(0.008), size, theme.text if entered else theme.dim))
    for action, side in (("lower", -way), ("higher", way)) if keys and scale.points else ():
        beside = Box(side * (box.width / 2 + 0.07 * layout.unit), box.y, 0.1, 0.042)
        marks += key_caps(texts, theme, scale.actions[action][:1], beside)
    return tuple(marks)


def _fills(theme: Theme, *, chosen: bool, confirmed: bool) -> tuple[str, str]:
    """Return fill and text colour of a part: those of a pressed button if confirmed, of a touched zone if chosen."""
    if chosen:
        return (theme.text, theme.ground) if confirmed else (theme.zone, theme.text)
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
    return Box(0, -0.2, 0.48 * layout.unit, 0.066)


def _draw_keypad(layout: Layout, theme: Theme, entered: str, names: list[str], confirmed: bool) -> list[Mark]:
    box = _field(layout)
    fill, ink = _fills(theme, chosen=confirmed, confirmed=confirmed)
    marks: list[Mark] = [*framed(box, 0.014, theme.text, fill, 0.004)]
    if entered:
        marks.append(Words(entered, box.inset(0.006), 0.046, ink, bold=True))
    for name, key in layout.buttons.items():
        if name != "confirm" and not confirmed:
            marks += framed(key, 0.012, theme.button_edge, theme.button, 0.003)
            marks.append(
                triangle("left", key.x, key.y, 0.013, theme.text)
                if name == "back"
                else Words(name, key.inset(0.006), 0.032, theme.text)
            )
    return marks


def _draw_words(layout: Layout, theme: Theme, words: tuple[str, ...], typesetter: Typesetter) -> list[Mark]:
    """Return the words under the points, or under the two ends and shifted towards the middle."""
    if not words:
        return []
    boxes = [box for name, box in layout.buttons.items() if name != "confirm"]
    under, size = min(box.bottom for box in boxes), 0.03 * layout.type_scale
    if len(words) == len(boxes):
        places = [Box(box.x, under - 0.039, box.width * 1.12, 0.07) for box in boxes]
    else:
        y, height, measure = under - 0.028, 0.05, typesetter.measure
        left, right = min(box.left for box in boxes), max(box.right for box in boxes)
        widths = [min(0.36 * (right - left), (measure(text) + 1) * size) for text in words]
        reach = [max(width / 2 - 0.02, 0.02) for width in widths]
        xs = left + reach[0], right - reach[1]
        places = [Box(x, y, width, height) for x, width in zip(xs, widths, strict=True)]
    size, heights = _common_lines(typesetter, words, tuple(places), size)
    places = [replace(place, y=place.top - height / 2) for place, height in zip(places, heights, strict=True)]
    return [Words(text, place, size, theme.text) for text, place in zip(words, places, strict=True)]


@cache
def _common_lines(
    typesetter: Typesetter, words: tuple[str, ...], places: tuple[Box, ...], size: float
) -> tuple[float, list[float]]:
    """Return the largest common type size up to `size` at which all words fit, and the height of each at that size."""
    size = min(common_size(typesetter, (text,), place, size) for text, place in zip(words, places, strict=True))
    common = (Words(text, place, size, "") for text, place in zip(words, places, strict=True))
    return size, [typesetter.set_type(each, 1000).height / 1000 for each in common]
