"""Screens shown to the participant, as plain pictures."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise
from typing import Any, Self

from modaltouch.protocol import AnswersSection, Texts, Trial
from modaltouch.window.controls import (
    as_read,
    common_size,
    draw_buttons,
    draw_scale,
    key_name,
    reads_from_right,
    typesetter_of,
)
from modaltouch.window.layout import (
    THEMES,
    Box,
    Layout,
    Mark,
    Picture,
    Point,
    Spans,
    Theme,
    Words,
    capsule,
    framed,
    lay_out,
    mixed,
    moved,
    rectangle,
    rounded,
)
from modaltouch.window.typesetting import Typesetter

_STEPS = {"thumb": 0.0, "index": 0.06, "middle": 0.052, "ring": 0.052, "little": 0.048}
"""Distance of each finger's knuckle from the previous one for unspread fingers [window heights]."""
_MIDDLE = Box(0, -0.26, 0.4, 0.18)
"""Middle of the answers, where preceding numbers are shown so that the eyes need not move."""


def draw_beam(layout: Layout, theme: Theme, touched: tuple[str, ...], typesetter: Typesetter) -> tuple[Mark, ...]:
    """Draw the beam with its zones; all touched zones look the same, and all names have the same size."""
    unit, beam = layout.unit, layout.beam
    rim = 0.007 * unit
    outline = Box(beam.x, beam.y, beam.width + 2 * rim, beam.height + 2 * rim)
    marks: list[Mark] = [*framed(outline, 0.012 * unit, theme.beam_edge, theme.beam, 0.004 * unit)]
    edges = {round(edge, 6) for box in layout.zones.values() for edge in (box.left, box.right)}
    within = sorted(edges - {round(beam.left, 6), round(beam.right, 6)})
    marks += [rectangle(Box(x, beam.y, 0.003 * unit, beam.height), theme.beam_edge) for x in within]
    room = 0.94 * min((right.x - left.x for left, right in pairwise(layout.zones.values())), default=beam.width)
    size = common_size(typesetter, tuple(map(spoken, layout.zones)), Box(0, 0, room, 0.07 * unit), 0.05 * unit)
    for name, box in layout.zones.items():
        is_touched = name in touched
        if is_touched:
            marks += framed(box.inset(-0.004 * unit), 0.01 * unit, theme.text, theme.zone, 0.007 * unit)
        above = Box(box.x, box.top + 0.042 * unit, room, 0.07 * unit)
        marks.append(Words(spoken(name), above, size, theme.text if is_touched else theme.dim, bold=is_touched))
    return tuple(marks)


def draw_hands(
    layout: Layout,
    theme: Theme,
    zones: tuple[str, ...],
    fingers: tuple[str, ...],
    names: tuple[str, ...],
    typesetter: Typesetter,
) -> tuple[Mark, ...]:
    """Draw the hands with each finger on its zone, and the names of the fingers above, all in the same size.

    Parameters
    ----------
    zones : tuple of str
        Zones under one to three fingers, from left to right as seen by the participant.
    fingers : tuple of str
        Those fingers, such as ``left index``.
    """
    colours = (theme.left, *[theme.between] * (len(zones) - 2), theme.right)[: len(zones)]
    tips = {finger: (layout.zones[zone].x, layout.zones[zone].y) for finger, zone in zip(fingers, zones, strict=True)}
    fills = dict(zip(fingers, colours, strict=True))
    palms: list[Mark] = []
    touching: list[Mark] = []
    for side in ("left", "right"):
        own = {finger.split()[1]: tip for finger, tip in tips.items() if finger.startswith(side)}
        own_fills = {finger.split()[1]: fill for finger, fill in fills.items() if finger.startswith(side)}
        if own:
            palm, on_beam = _draw_hand(layout, theme, side, own, own_fills)
            palms += palm
            touching += on_beam
    places, room, size = _place_names(layout, [layout.zones[zone].x for zone in zones], names, typesetter)
    named = zip(places, names, colours, strict=True)
    words = (Words(name, replace(room, x=x), size, fill, bold=True) for x, name, fill in named)
    # Crossed hands on neighbouring zones overlap, and a palm must not hide the other hand's finger.
    return (*palms, *touching, *words)


def _place_names(
    layout: Layout, tips: list[float], names: tuple[str, ...], typesetter: Typesetter
) -> tuple[list[float], Box, float]:
    """Return the positions of finger names, the box of each, and their type size [window heights].

    Names wider than the distance of their fingers move outwards, and are drawn smaller only if they exceed the window.
    """
    n, size = len(tips), 0.031 * layout.type_scale
    middle, edge = (tips[(n - 1) // 2] + tips[n // 2]) / 2, 0.49 * layout.width
    needed = 1.06 * size * max(typesetter.measure(name, bold=True) for name in names)
    apart = min(needed, (edge - abs(middle)) / (n / 2))
    moved_out = (max(abs(x - middle), apart * abs(i - (n - 1) / 2)) for i, x in enumerate(tips))
    places = (middle + out * (1 if x > middle else -1) for x, out in zip(tips, moved_out, strict=True))
    within = [min(max(place, apart / 2 - edge), edge - apart / 2) for place in places]
    room = Box(0, layout.beam.top + 0.094 * layout.unit, apart, 0.05 * layout.unit)
    return within, room, size * apart / needed


def spoken(zone: str) -> str:
    """Return the displayed name of a zone, with spaces, which names in files cannot contain."""
    return zone.replace("_", " ")


def _draw_hand(
    layout: Layout, theme: Theme, side: str, tips: dict[str, Point], fills: dict[str, str]
) -> tuple[list[Mark], list[Mark]]:
    """Draw a hand: palm and resting fingers, and the touching fingers to be drawn over them."""
    unit = layout.unit
    outward = 1 if side == "right" else -1
    thick, thin = 0.034 * unit, 0.026 * unit
    knuckles = _place_knuckles(layout, outward, tips)
    xs = [x for name, x in knuckles.items() if name != "thumb" or name in tips]
    top = layout.zones[next(iter(layout.zones))].y - 0.185 * unit
    palm = Box((min(xs) + max(xs)) / 2, top - 0.035 * unit, max(xs) - min(xs) + 0.078 * unit, 0.115 * unit)
    line = 0.005 * unit
    thumb_base = (xs[0] - outward * 0.005 * unit, palm.bottom + 0.035 * unit)
    thumb_tip = (xs[0] - outward * 0.085 * unit, top + 0.03 * unit)
    lengths = {name: ((x, top), (x, top + 0.03 * unit), thin) for name, x in knuckles.items()}
    lengths["thumb"] = (thumb_base, thumb_tip, thin)
    resting = [length for name, length in lengths.items() if name not in tips]
    marks: list[Mark] = [capsule(start, end, radius + line, theme.hand_edge) for start, end, radius in resting]
    marks.append(rounded(palm.inset(-line), 0.05 * unit, theme.hand_edge))
    marks += [capsule(start, end, radius, theme.hand) for start, end, radius in resting]
    marks.append(rounded(palm, 0.048 * unit, theme.hand))
    touching: list[Mark] = []
    for name, tip in tips.items():
        knuckle = (knuckles[name], top)
        touching += [capsule(knuckle, tip, thick + line, theme.ground), capsule(knuckle, tip, thick, fills[name])]
        touching.append(_draw_nail(knuckle, tip, thick, mixed(fills[name], "#FFFFFF", 0.65)))
    return marks, touching


def _place_knuckles(layout: Layout, outward: int, tips: dict[str, Point]) -> dict[str, float]:
    """Return the horizontal positions of the knuckles, from the thumb to the little finger [window heights].

    Between the outer two touching fingers they spread with the zones; the others are next to their neighbours.
    """
    unit, names = layout.unit, list(_STEPS)
    first, last = (pick(map(names.index, tips)) for pick in (min, max))
    steps = {name: step * unit for name, step in _STEPS.items()}
    from_thumb = tips[names[first]][0] + outward * 0.012 * unit
    if last > first:
        ends = tips[names[first]][0], tips[names[last]][0]
        half = min(0.36 * abs(ends[1] - ends[0]) / 2 + 0.01 * unit, 0.085 * (last - first) * unit)
        from_thumb = sum(ends) / 2 - outward * half
        steps |= dict.fromkeys(names[first + 1 : last + 1], 2 * half / (last - first))
    places = list(accumulate(steps.values()))
    xs = [from_thumb + outward * (place - places[first]) for place in places]
    # Fingers that do not touch are closer together where the hand, with its palm or thumb, would exceed the window.
    for free, touching, rest in ((slice(1, first), xs[first], 0.12), (slice(last + 1, None), xs[last], 0.05)):
        reach, room = max(map(abs, xs[free]), default=0.0), layout.width / 2 - rest * unit
        if reach > room:
            xs[free] = [touching + (x - touching) * (room - abs(touching)) / (reach - abs(touching)) for x in xs[free]]
    return dict(zip(names, xs, strict=True))


def _draw_nail(knuckle: Point, tip: Point, radius: float, fill: str) -> Mark:
    """Draw the nail, which shows that the palm faces down."""
    share = radius / math.dist(knuckle, tip)
    run, rise = share * (tip[0] - knuckle[0]), share * (tip[1] - knuckle[1])
    near, far = ((tip[0] + along * run, tip[1] + along * rise) for along in (-0.35, 0.3))
    return capsule(near, far, 0.5 * radius, fill)


@dataclass(frozen=True)
class Illustrator:
    """Illustrator of the screens of a protocol in a window.

    Pictures do not depend on the stimulus: trials with the same fingers on the same zones look the same at every
    level.
    """

    layout: Layout  # positions and sizes
    theme: Theme  # colours
    texts: Texts  # texts
    answers: AnswersSection  # keys and ways of answering
    hand: str  # hand used in ``one_hand``
    # fingers of the finger conditions named in the protocol
    fingers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def of(
        cls, size: tuple[int, int], zones: Spans, theme: str, texts: Texts, asked: AnswersSection, design: Any
    ) -> Self:
        """Return the illustrator of a question, in a window of a size [pixels] and in the direction of the texts."""
        asked = as_read(asked, texts)
        layout = lay_out(*size, zones, asked.offered, asked.scale, from_right=reads_from_right(asked, texts))
        return cls(layout, THEMES[theme], texts, asked, design.hand, design.fingers)

    def welcome(self, trial: Trial) -> Picture:
        """Return the first screen, with the instructions, the beam and the hands."""
        lowered = moved(self._beam(trial), -0.21)
        text, size = "\n\n".join(_paragraphs(self.texts.instructions)), 0.038 * self.layout.type_scale
        words = Words(text, self.layout.body, size, self.theme.text)
        return Picture("welcome", (self._headline(self.texts.welcome, 0.054), words, *self._go_on(), *lowered))

    def answering(self, trial: Trial) -> Picture:
        """Return the screen that explains how to answer, for the finger condition of a trial."""
        layout, texts, offered = self.layout, self.texts, self.answers.offered
        nothing = offered.naming()
        words = (texts.how_to_answer_or_none if nothing else None) or texts.how_to_answer
        filled = (texts.how_to_rate if self.answers.scale else words).format(
            pause_key=key_name(texts, AnswersSection.PAUSE_KEY),
            n_answers=texts.number(len(offered)),
            nothing_felt=texts.label(nothing.name) if nothing else "",
        )
        title, *rest = _paragraphs(filled)
        below, way = Box(0, 0.07, layout.body.width, 0.4), self.answers.way(trial.condition.finger_condition)
        return Picture(
            "answers",
            (
                replace(self._headline(title, 0.054), box=replace(layout.headline, y=0.36)),  # nothing else is above
                Words("\n\n".join(rest), below, 0.042 * layout.type_scale, self.theme.text),
                *self._draw_answers(None, confirmed=False, with_keys=way != "experimenter"),
                *self._go_on(),
            ),
        )

    def placement(self, trial: Trial) -> Picture:
        """Return the screen that shows which finger goes on which zone."""
        words = self.texts.placing(self.finger_names(trial), tuple(map(spoken, trial.condition.zones)))
        marks = (self._headline(words, 0.046), *self._beam(trial), *self._go_on(self._confirm_placement(trial)))
        return Picture(f"place_fingers_{_tag(trial)}", marks)

    def ready(self, trial: Trial, progress: tuple[int, int], count: int = 0) -> Picture:
        """Return the screen between two trials: the beam, with the number of a countdown if any."""
        marks: tuple[Mark, ...] = (*self._beam(trial), *self._progress(trial, progress))
        if not count:
            return Picture(f"ready_{_tag(trial)}", marks)
        number = Words(str(count), _MIDDLE, 0.13 * self.layout.type_scale, self.theme.dim)
        return Picture(f"ready_{_tag(trial)}_{count}", (self._headline(self.texts.fingers_back, 0.056), *marks, number))

    def feel(self, trial: Trial, progress: tuple[int, int], interval: int = 0) -> Picture:
        """Return the screen during a stimulus before the question, with the number of the interval if any."""
        marks: tuple[Mark, ...] = (self._headline(self.texts.feel, 0.056, dim=True), *self._beam(trial))
        marks += self._progress(trial, progress)
        if not interval:
            return Picture(f"feel_{_tag(trial)}", marks)
        number = Words(str(interval), _MIDDLE, 0.15 * self.layout.type_scale, self.theme.text, bold=True)
        return Picture(f"feel_{_tag(trial)}_{interval}", (*marks, number))

    def question(
        self,
        trial: Trial,
        progress: tuple[int, int],
        chosen: str | None = None,
        *,
        confirmed: bool = True,
        name: str = "",
    ) -> Picture:
        """Return the screen of a question with its answers; `chosen` is shown as accepted or as to be confirmed."""
        layout, way = self.layout, self.answers.way(trial.condition.finger_condition)
        texts, hand = self.texts, self._pressing_hand(trial)
        kind, asked = f"_{name}" if name else "", self.answers.question
        rates = self.answers.scale is not None
        if chosen and not confirmed and not rates:
            name, words = f"chosen_{chosen}", self.texts.confirm_answer
        else:
            state = ("answered" if confirmed else "rating") if chosen else "question"
            name = f"{state}{kind}_{_tag(trial) if rates or not chosen else chosen}"
            words = {
                "experimenter": texts.experimenter_answers,
                "lifting": texts.lift_to_answer.format(hand=hand),
                "foot_switch": texts.foot_switch_answers,
                "free_hand": (texts.free_hand_answers or "").format(hand=hand),
            }["lifting" if self.answers.settles(trial.condition.finger_condition) else way]
        note = (Words(words, layout.note, 0.034 * layout.type_scale, self.theme.text),) if words else ()
        return Picture(
            name,
            (
                self._headline(texts.named(asked) if asked else texts.question, 0.056),
                *self._beam(trial),
                *self._draw_answers(chosen, confirmed=confirmed, with_keys=way != "experimenter"),
                *note,
                *self._progress(trial, progress),
            ),
        )

    def feedback(self, trial: Trial, progress: tuple[int, int], answer: str, expected: str) -> Picture:
        """Return the feedback after a practice trial: where the vibration was stronger, or the right answer."""
        texts, offered = self.texts, self.answers.offered
        by_fingers = {
            ("left",): texts.practice_was_left,
            ("left", "right"): texts.practice_was_both,
            ("right",): texts.practice_was_right,
        }
        felt = () if offered.names_between else offered.named(expected).fingers or ()
        was, agreed = by_fingers.get(felt, texts.practice_was.format(answer=texts.label(expected))), answer == expected
        words, name = (texts.practice_agreed, "agreed") if agreed else (was, expected)
        return Picture(
            f"feedback_{name}", (self._headline(words, 0.05), *self._beam(trial), *self._progress(trial, progress))
        )

    def page(self, name: str, text: str, progress: tuple[int, int] | None = None, *, waits: bool = True) -> Picture:
        """Return a screen of text, the first paragraph large and the rest below it."""
        title, *rest = _paragraphs(text)
        layout, scale = self.layout, self.layout.type_scale
        top = Box(layout.page.x, layout.page.y + (0.11 if rest else 0.03), layout.page.width, 0.22)
        marks: list[Mark] = [Words(title, top, 0.06 * scale, self.theme.text, bold=True)]
        if rest:
            below = Box(layout.page.x, layout.page.y - 0.12, layout.page.width, 0.25)
            marks.append(Words("\n\n".join(rest), below, 0.042 * scale, self.theme.text))
        if waits:
            marks += self._go_on()
        if progress is not None:
            marks += self._bar(progress, lift=0.14)
        return Picture(name, tuple(marks))

    def pause(self, trial: Trial | None) -> Picture:
        """Return the pause screen, with the placement of the fingers if a trial will be repeated."""
        words = (self.texts.pause if trial else self.texts.pause_between_trials).format(
            key=key_name(self.texts, self.answers.continue_keys[0]),
            end_key=key_name(self.texts, AnswersSection.END_KEY),
        )
        if trial is None:
            return self.page("pause_between_trials", words, waits=False)
        title, *rest = _paragraphs(words)
        below = Box(0, -0.285, self.layout.headline.width, 0.24)
        words_below = Words("\n\n".join(rest), below, 0.04 * self.layout.type_scale, self.theme.text)
        return Picture("pause", (self._headline(title, 0.056), *self._beam(trial), words_below))

    def finger_names(self, trial: Trial) -> tuple[str, ...]:
        """Return the names of the fingers on the zones for the participant, from left to right."""
        return tuple(map(self.texts.finger, trial.condition.fingers(self.hand, self.fingers)))

    def _pressing_hand(self, trial: Trial) -> str:
        """Return the name of the pressing hand for the participant.

        With both hands on the beam it is `hand`; with one hand, the other one, unless a finger lifts to press.
        """
        condition = trial.condition
        on_beam = {finger.split()[0] for finger in condition.fingers(self.hand, self.fingers)}
        lifts_to_press = ("right" in on_beam) == self.answers.settles(condition.finger_condition)
        is_right = self.hand == "right" if len(on_beam) == 2 else lifts_to_press
        return self.texts.right_hand if is_right else self.texts.left_hand

    def _confirm_placement(self, trial: Trial) -> str:
        """Return the text on how a placement is confirmed: by whom, with which key and hand."""
        texts, way = self.texts, self.answers.way(trial.condition.finger_condition)
        words = {
            "lifting": texts.placed_by_hand_on_beam,
            "free_hand": texts.placed_by_free_hand,
            "experimenter": texts.placed_by_experimenter,
        }.get("lifting" if self.answers.settles(trial.condition.finger_condition) else way)
        key = key_name(texts, self.answers.continue_keys[0])
        return (words or texts.press_to_continue).format(key=key, hand=self._pressing_hand(trial))

    def _headline(self, words: str, size: float, *, dim: bool = False) -> Words:
        fill = self.theme.dim if dim else self.theme.text
        return Words(words, self.layout.headline, size * self.layout.type_scale, fill, bold=not dim)

    def form(self, name: str, entered: str | None, *, confirmed: bool) -> Picture:
        """Return the screen of a question of the closing form, with the number or answer entered."""
        page, keys = self.layout.page, self.answers.given_by == "participant"
        words, state = self.texts.named(self.answers.question or name), "_answered" if confirmed else ""
        above = Box(page.x, 0.12, page.width, 0.3)
        return Picture(
            f"form_{name}{state}",
            (
                Words(words, above, 0.056 * self.layout.type_scale, self.theme.text, bold=True),
                *self._draw_answers(entered, confirmed=confirmed, with_keys=keys),
            ),
        )

    def _draw_answers(self, chosen: str | None, *, confirmed: bool, with_keys: bool) -> tuple[Mark, ...]:
        """Draw the answers, or the scale, with the chosen one."""
        own = self.layout, self.theme, self.texts
        if self.answers.scale is None:
            return draw_buttons(*own, self.answers, chosen, with_keys=with_keys)
        is_taken = confirmed and chosen is not None
        return draw_scale(*own, self.answers.scale, chosen or "", confirmed=is_taken, keys=with_keys)

    def _beam(self, trial: Trial) -> tuple[Mark, ...]:
        condition = trial.condition
        layout = self.layout.turned() if condition.is_mirrored else self.layout
        fingers = condition.fingers(self.hand, self.fingers)
        typesetter = typesetter_of(self.texts)
        return (
            *draw_beam(layout, self.theme, condition.zones, typesetter),
            *draw_hands(layout, self.theme, condition.zones, fingers, self.finger_names(trial), typesetter),
        )

    def _go_on(self, words: str = "") -> tuple[Mark, ...]:
        pill, theme = self.layout.go_on, self.theme
        words = words or self.texts.press_to_continue.format(key=key_name(self.texts, self.answers.continue_keys[0]))
        within = Box(pill.x, pill.y, pill.width - pill.height, 0.7 * pill.height)
        return (
            *framed(pill, 0.043, theme.button_edge, theme.button, 0.003),
            Words(words, within, 0.036 * self.layout.type_scale, theme.text),
        )

    def _progress(self, trial: Trial, progress: tuple[int, int]) -> tuple[Mark, ...]:
        form = self.texts.practice_of if trial.practice else self.texts.trial_of
        words = form.format(number=progress[0], total=progress[1])
        label = Words(words, self.layout.label, 0.028 * self.layout.type_scale, self.theme.dim)
        return (label, *self._bar(progress))

    def _bar(self, progress: tuple[int, int], lift: float = 0.0) -> tuple[Mark, ...]:
        """Draw the progress bar; the current trial counts as not done."""
        low = self.layout.bar
        bar = Box(low.x, low.y + lift, low.width, low.height)
        share = min(max((progress[0] - 1) / max(progress[1], 1), 0.0), 1.0)
        done = Box(bar.left + bar.width * share / 2, bar.y, bar.width * share, bar.height)
        return (rectangle(bar, self.theme.beam), *([rectangle(done, self.theme.dim)] if share > 0 else []))


_WIDE = "[\u2e80-\ua4cf\uf900-\ufaff\ufe30-\ufe4f\uff00-\uffef]"
"""Characters written without spaces between words: ideographs, kana and their punctuation."""


def _paragraphs(text: str) -> list[str]:
    """Split a text into paragraphs at blank lines; other line breaks become spaces."""
    paragraphs = re.sub(rf"(?<={_WIDE})\n(?={_WIDE})", "", text.strip()).split("\n\n")
    # Keep no-break spaces, as in French before a question mark, which split() would not.
    return [re.sub(r"[ \t\n]+", " ", paragraph) for paragraph in paragraphs]


def _tag(trial: Trial) -> str:
    return f"{trial.condition.finger_condition}_{''.join(trial.condition.zones)}"
