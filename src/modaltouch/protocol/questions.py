"""Questions: a scale or a list of answers, in place of the protocol's list, after each answer, or at the end."""

from __future__ import annotations

import math
import string
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from modaltouch.protocol.reading import Reading
from modaltouch.protocol.section import Number, Positive, Section, Text, Word, described
from modaltouch.protocol.source import Problem, fault, suggest
from modaltouch.protocol.trial import RATED, TIME_OUT

_NAMED = """
ampersand apostrophe asciicircum asciitilde asterisk at backslash backspace bar begin braceleft braceright
bracketleft bracketright break cancel capslock clear colon comma delete dollar doublequote down end enter equal
escape exclamation execute find function greater help home insert lalt lcommand lctrl left less linefeed lmeta
loption lshift lwindows menu minus numlock pagedown pageup parenleft parenright pause percent period plus pound
print question quoteleft ralt rcommand rctrl redo right rmeta roption rshift rwindows scriptswitch
scrolllock select semicolon slash space sysreq tab underscore undo up
"""

_KEYPAD = """
add decimal divide enter equal f1 f2 f3 f4 multiply separator space subtract tab
"""

KEY_NAMES = frozenset(
    [
        *string.ascii_lowercase,
        *string.digits,
        *_NAMED.split(),
        *(f"f{number}" for number in range(1, 21)),
        *(f"num_{name}" for name in [*string.digits, *_KEYPAD.split()]),
    ]
)
"""Names of possible answer keys: those of the window's keyboard layer, in lower case."""

KeyName = Annotated[Text, Field(json_schema_extra={"x-allowed": "the name of a key"})]
Keys = Annotated[tuple[KeyName, ...], Field(min_length=1)]
ScaleAction = Literal["lower", "higher", "confirm"]

MOST_ANSWERS = 7
"""Largest number of answers that fit on a screen and on the digit keys of a console."""

_TAKEN = """
participant session trial block practice group interval finger_condition zone_left zone_right zone_between
finger_left finger_right finger_between placement velocity_mm_s multiple_of_threshold masked catch stimulus
repetition response response_time response_onset response_uncertainty answered_by way double confirmed onset
onset_uncertainty n_bursts n_bursts_dropped repetition_by presentation device speed_left_mm_s speed_right_mm_s
speed_between_mm_s delivered_mm_s log_line value n mode standard_mm_s correct level pair zone zones dominant
HED stim_file
"""
RESERVED_COLUMNS = frozenset(_TAKEN.split())
"""Fixed columns of a table of answers, and two to which BIDS gives a meaning: tags, and a file that must exist."""

_BOUNDS = {"vas": (0.0, 100.0), "likert": (1.0, 7.0)}
_MOST_POINTS, _MOST_STEPS = 11, 1000
_MODULUS = 10.0
"""Number that a simulated participant gives for the middle of an open scale [1]."""


class ScaleSection(Section):
    """A scale for numerical answers."""

    kind: Literal["vas", "likert", "number"] = described(
        "vas: a visual analogue scale, a line on which a mark is set; likert: a choice of one of several points; "
        "number: a typed number, as in magnitude estimation."
    )
    lowest: Number | None = described(
        "Number at the left end, or smallest number that may be typed; null for 0 on a line, 1 on points, and any "
        "typed number above 0.",
        default=None,
    )
    highest: Number | None = described(
        "Number at the right end, or largest number that may be typed; null for 100 on a line, 7 on points, and no "
        "limit on a typed number.",
        default=None,
    )
    step: Positive | None = described(
        "Step from one position of the mark, or one point, to the next; null for 1. Always null for a typed number.",
        default=None,
    )
    words: tuple[Text, ...] = described(
        "Words at the two ends, such as [not at all, extremely], or at each point; each written out, or given by its "
        "name under `answers` in the texts.",
        default=(),
    )
    keys: dict[ScaleAction, Keys] = described(
        "Keys that move the mark and confirm it, for a foot switch or a button box, such as {lower: [f1], higher: "
        "[f3], confirm: [f2]}. By default: left and down, right and up, enter and space. Home and End go to the ends, "
        "digits choose points and type numbers.",
        default={},
    )

    _is_from_right: bool = PrivateAttr(default=False)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        low, high, step = self.low, self.high, self.step or 1.0
        is_typed = self.kind == "number"
        if low >= high:
            raise fault(f"a scale from {low:g} to {high:g}", "lowest below highest", "change one of them")
        if is_typed:
            if self.step is not None or self.words:
                raise fault("a step or words for a typed number", "neither", "leave them out")
            return self
        n_steps = (high - low) / step
        most = _MOST_POINTS - 1 if self.kind == "likert" else _MOST_STEPS
        if abs(n_steps - round(n_steps)) > 1e-6 or not 1 <= round(n_steps) <= most:
            raise fault(
                f"{n_steps:.6g} steps of {step:g} from {low:g} to {high:g}",
                f"1 to {most} whole steps",
                "change step, lowest or highest",
            )
        allowed = {0, 2, len(self.points)} if self.kind == "likert" else {0, 2}
        if len(self.words) not in allowed:
            many = " or ".join(map(str, sorted(allowed - {0})))
            raise fault(f"{len(self.words)} words for a {self.kind} scale", f"{many}, or none", "add or remove words")
        return self

    @property
    def is_from_right(self) -> bool:
        """Whether the lowest number is on the right, for a right-to-left script."""
        return self._is_from_right

    def from_right(self) -> Self:
        """Return the scale for a right-to-left script."""
        turned = self.model_copy()
        turned._is_from_right = True
        return turned

    @property
    def low(self) -> float:
        """Lowest number; 0 for an open scale, which excludes it."""
        return _BOUNDS.get(self.kind, (0.0, 0.0))[0] if self.lowest is None else self.lowest

    @property
    def high(self) -> float:
        """Highest number; infinite for an open scale."""
        return _BOUNDS.get(self.kind, (0.0, math.inf))[1] if self.highest is None else self.highest

    @property
    def points(self) -> tuple[float, ...]:
        """Numbers at the points or at the positions of the marker; empty if a number is typed."""
        if self.kind == "number":
            return ()
        step = self.step or 1.0
        return tuple(round(self.low + place * step, 9) for place in range(round((self.high - self.low) / step) + 1))

    @property
    def actions(self) -> dict[str, tuple[str, ...]]:
        """Keys of each action on the scale, including the characters sent by a terminal, such as ``.``."""
        usual: dict[str, tuple[str, ...]] = {"confirm": ("enter", "num_enter", "space")}
        digits = {digit: (digit, f"num_{digit}") for digit in string.digits}
        if self.kind == "number":
            usual |= digits | {".": ("period", "comma", "num_decimal", ".", ","), "back": ("backspace", "delete")}
            usual |= {"-": ("minus", "num_subtract", "-")} if self.low < 0 else {}
        else:
            back, on = ("right", "left") if self._is_from_right else ("left", "right")
            usual |= {"lower": (back, "down"), "higher": (on, "up"), "lowest": ("home",), "highest": ("end",)}
            usual |= {"ten_lower": ("pagedown",), "ten_higher": ("pageup",)} if self.kind == "vas" else digits
        return usual | {name: keys for name, keys in self.keys.items() if name in usual}

    @property
    def allowed(self) -> str:
        """Description of the allowed answers."""
        if self.points:
            return f"{self.low:.10g} to {self.high:.10g} by {self.step or 1.0:.10g}"
        least = "a number above 0" if self.lowest is None else f"a number of at least {self.lowest:.10g}"
        return least if math.isinf(self.high) else f"{least}, at most {self.high:.10g}"

    def takes(self, value: float) -> bool:
        """Test whether a number is on the scale."""
        if self.points:
            return any(math.isclose(value, point, abs_tol=1e-9) for point in self.points)
        is_above = value > 0 if self.lowest is None else value >= self.lowest
        return is_above and value <= self.high and math.isfinite(value)

    def at(self, share: float) -> float:
        """Return the number at a fraction of the scale, for a simulated participant.

        On an open scale the fraction is a saturating response s / (1 + s), and the number is proportional to s.

        Parameters
        ----------
        share : float
            Fraction of the scale, above 0 and below 1 [1].
        """
        if self.points:
            return self.points[min(int(share * len(self.points)), len(self.points) - 1)]
        reach = share / (1 - share) * _MODULUS if math.isinf(self.high) else share * (self.high - self.low)
        least = 1e-3 if self.lowest is None else self.low
        return min(max(float(f"{self.low + reach:.3g}"), least), self.high)


class AskedSection(Section):
    """A question and its possible answers."""

    PAUSE_KEY: ClassVar[str] = "escape"
    """Key that pauses the session; reserved by the window."""
    END_KEY: ClassVar[str] = "q"
    """Key that ends the session from the pause screen; may be an answer key elsewhere."""
    KEY_ALIASES: ClassVar[dict[str, str]] = {
        "return": "enter", "esc": "escape", "spacebar": "space",
        "num_home": "num_7", "num_up": "num_8", "num_page_up": "num_9",
        "num_left": "num_4", "num_begin": "num_5", "num_right": "num_6",
        "num_end": "num_1", "num_down": "num_2", "num_page_down": "num_3",
        "num_insert": "num_0", "num_delete": "num_decimal",
        "é": "2", "è": "7", "ç": "9", "à": "0",
    }  # fmt: skip
    """Alternative key names: number pad without NumLock; French digit row, which needs Shift for digits."""

    question: Text | None = described(
        "The question, written out, or the name of a text under `further` in the texts. Null for the one that follows "
        "from the answers, if the texts have it, or else the text `question`; for a further question, or one of the "
        "form, null for the text under `further` that has its name.",
        default=None,
        exclude_if=lambda given: given is None,
    )
    keys: dict[Word, Keys] = described(
        "Keys for each of two to seven answers: left, both and right as in the paper, with or without `none` (felt "
        "nowhere); or answers with other names, shown in this order with labels from the texts. Omitted if there is a "
        "scale.",
        default={},
    )
    scale: ScaleSection | None = described(
        "A scale that is answered with a number, in place of a list of answers.",
        default=None,
        exclude_if=lambda given: given is None,
    )
    time_out_s: Annotated[Positive, Field(le=600)] | None = described(
        "Longest time from the question to an answer; after it the answer is recorded as timed out and the trial ends "
        "[s]. Null for no limit.",
        default=None,
        exclude_if=lambda given: given is None,
    )

    @property
    def actions(self) -> dict[str, tuple[str, ...]]:
        """Keys of each answer, or of each action on the scale."""
        return self.keys if self.scale is None else self.scale.actions

    @property
    def asks(self) -> tuple[object, ...]:
        """What is asked, in whatever words: the answers, or kind, ends and step of the scale."""
        scale = self.scale
        return tuple(sorted(self.keys)) if scale is None else (scale.kind, scale.low, scale.high, scale.step)

    @property
    def allowed(self) -> str:
        """Description of the allowed answers, other than a time-out."""
        return ", ".join(self.keys) if self.scale is None else self.scale.allowed

    def takes(self, answer: str, value: float | None) -> bool:
        """Test whether an answer is possible, with its number if given on a scale."""
        if answer == TIME_OUT or self.scale is None:
            return value is None and (answer == TIME_OUT or answer in self.keys)
        return answer == RATED and isinstance(value, int | float) and self.scale.takes(value)


class QuestionSection(AskedSection):
    """A question after the answer of a trial, or in the form at the end."""

    @model_validator(mode="after")
    def _asks_one_thing(self) -> Self:
        if bool(self.keys) == (self.scale is not None):
            raise fault(
                "both keys and a scale" if self.keys else "neither keys nor a scale",
                "one of them",
                "list keys for each answer, or describe a scale",
            )
        return self


def check_key(reading: Reading[Any], path: tuple[str | int, ...], name: str) -> Iterator[Problem]:
    """Yield a problem for a name that is not a key name, or is that of the pause key."""
    if name == AskedSection.PAUSE_KEY:
        yield reading.problem(path, f"'{name}', which pauses the session", "any other key", "choose another")
    elif name not in KEY_NAMES:
        meant = AskedSection.KEY_ALIASES.get(name.casefold()) or suggest(name, KEY_NAMES)
        yield reading.problem(
            path,
            f"'{name}', which is not the name of a key",
            "left, right, up, down, space, enter, letters, digits, num_0 to num_9, f1 to f20 and the like",
            f"did you mean '{meant}'?" if meant else "write one of these",
        )


def check_questions(reading: Reading[Any]) -> Iterator[Problem]:
    """Yield the problems of a scale in place of the answers, of further questions, and of the form."""
    answers, has_scale = ("answers",), bool(reading.keys("answers", "scale"))
    is_absent = reading.keys(*answers) is not None and not has_scale and reading.find((*answers, "keys")) is None
    if is_absent and not reading.has_unknown_key(*answers):
        yield reading.problem(
            (*answers, "keys"), "nothing", "a mapping", "add the missing key `keys`, or describe a `scale`"
        )
    for key in ("keys", "fingers", "below") if has_scale else ():
        if reading.find((*answers, key)) is not None:
            yield reading.problem(
                (*answers, key),
                f"{key} together with a scale",
                "answers with keys, or a scale",
                "remove one of them; `then` asks a further question",
            )
    yield from _check_scale(reading, (*answers, "scale"))
    for section in (("answers", "then"), ("form",)):
        for name in reading.keys(*section) or ():
            if name in RESERVED_COLUMNS or name.endswith("_time"):
                yield reading.problem(
                    (*section, name),
                    f"{name}, which has another meaning in the table of answers",
                    "any other name",
                    "choose another",
                    at_key=True,
                )
            names = reading.keys(*section, name, "keys") or []
            yield from reading.faults(
                (
                    names and not 2 <= len(names) <= MOST_ANSWERS,
                    (*section, name, "keys"),
                    f"{len(names)} answer{'s' * (len(names) != 1)}",
                    f"2 to {MOST_ANSWERS} answers",
                    "or use a scale",
                ),
                (
                    TIME_OUT in names,
                    (*section, name, "keys", TIME_OUT),
                    f"{TIME_OUT}, which is recorded when no answer comes in time",
                    "any other name",
                    "choose another",
                ),
            )
            yield from check_keys(reading, (*section, name, "keys"))
            yield from _check_scale(reading, (*section, name, "scale"))


def _check_scale(reading: Reading[Any], path: tuple[str, ...]) -> Iterator[Problem]:
    """Yield the problems of the keys of a scale, and emergency keys that a scale uses by default."""
    yield from check_keys(reading, (*path, "keys"))
    scale, written = reading.sound(*path), reading.keys(*path, "keys") or ()
    usual = {} if scale is None else {key: act for act, keys in scale.actions.items() for key in keys}
    for index, name in reading.items("answers", "emergency_keys"):
        if (act := usual.get(name, "")) and act not in written:
            yield reading.problem(
                ("answers", "emergency_keys", index),
                f"'{name}', which means {act.replace('_', ' ')} on the scale {'.'.join(path)}",
                "a key with no other meaning",
                f"choose another, such as f12, or give {act} another key under {'.'.join(path)}.keys",
            )


IN_EMERGENCY = "switches the outputs off (`answers.emergency_keys`)"


def check_keys(reading: Reading[Any], path: tuple[str, ...]) -> Iterator[Problem]:
    """Yield the problems of the keys of answers or actions: unknown name, two meanings, or emergency key."""
    taken = {name: IN_EMERGENCY for _, name in reading.items("answers", "emergency_keys")}
    for answer in reading.keys(*path) or ():
        for index, name in reading.items(*path, answer):
            yield from check_key(reading, (*path, answer, index), name)
            if name in taken:
                yield reading.problem(
                    (*path, answer, index),
                    f"'{name}', which already {taken[name]}",
                    "a key with no other meaning",
                    "choose another",
                )
            taken.setdefault(name, f"means {answer}")
