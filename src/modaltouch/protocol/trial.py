"""Trials, conditions, possible answers and responses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

TIME_OUT = "time_out"
"""Answer recorded at a time-out; never offered."""

RATED = "rated"
"""Answer recorded for a scale, together with the number."""

_SELDOM = ("value", "further")
"""Keys of a response recorded only if set."""

FINGERS: dict[tuple[str, str], tuple[str, str]] = {
    ("one_hand", "right"): ("right index", "right middle"),
    ("one_hand", "left"): ("left middle", "left index"),
    ("two_hands", "right"): ("left index", "right index"),
    ("two_hands", "left"): ("left index", "right index"),
}
"""Fingers on the left and right zone, by finger condition and the hand used for ``one_hand``, palms down."""

Side = Literal["left", "between", "right"]
Fingers = tuple[Side, ...]
"""Fingers by side, as the participant sees the beam; `between` is the middle one of three."""

SIDES: dict[int, Fingers] = {
    1: ("left",),
    2: ("left", "right"),
    3: ("left", "between", "right"),
}
"""Sides of the fingers, by number of fingers; a single finger is the left one."""

SHIPPED: dict[str, Fingers] = {"left": ("left",), "both": ("left", "right"), "right": ("right",), "none": ()}
"""The paper's three answers and `none` ("felt nowhere"), with the fingers that they name."""

_RANKS = {1: 0, 2: 1, 3: 1, 0: 2}

CLEAR_RATIO = 1.25
"""Clearly perceptible ratio of speeds: twice the difference threshold of vibration (Craig 1972) [1]."""
EQUAL_RATIO = 1.1
"""Ratio of speeds below the difference threshold [1]."""


@dataclass(frozen=True)
class Condition:
    """The factor levels of one cell of the design."""

    # ``one_hand`` (index and middle finger of one hand; the paper's test 1), ``two_hands`` (both index fingers; test
    # 2), or one that the protocol defines
    finger_condition: str
    # zone_left, zone_right: zones under the outer fingers, left and right as seen by the participant; for a single
    # finger, its zone and an empty string
    zone_left: str
    zone_right: str
    # peak velocity at the centre of the focus zone at the focusing instant [mm/s]; 0 in a catch trial
    velocity_mm_s: float
    # ``normal``; ``mirrored`` (the beam turned end to end, so that its last zone is on the left); ``swapped`` (the
    # other hand, or crossed hands if both are on the beam); ``mirrored_swapped``
    placement: str = "normal"
    stimulus: str = ""  # name of the stimulus; empty if the protocol has only one, and in a catch trial
    zone_between: str = ""  # zone under the middle one of three fingers; empty for fewer fingers

    @classmethod
    def on(
        cls, zones: tuple[str, ...], finger_condition: str, level: float, placement: str = "normal", stimulus: str = ""
    ) -> Condition:
        """Return a condition on one to three zones, from left to right."""
        left, right = zones[0], zones[-1] if len(zones) > 1 else ""
        return cls(finger_condition, left, right, level, placement, stimulus, "".join(zones[1:-1]))

    @property
    def zones(self) -> tuple[str, ...]:
        """Zones under the fingers, from left to right."""
        return tuple(filter(None, (self.zone_left, self.zone_between, self.zone_right)))

    @property
    def sides(self) -> tuple[str, ...]:
        """Sides of the fingers, from left to right: ``left``, ``between`` and ``right``."""
        return SIDES[len(self.zones)]

    @property
    def is_catch(self) -> bool:
        """Whether this is the condition of a catch trial."""
        return self.velocity_mm_s == 0

    @property
    def is_mirrored(self) -> bool:
        """Whether the beam is turned end to end."""
        return self.placement.startswith("mirrored")

    def fingers(self, hand: str, named: Mapping[str, tuple[str, ...]] | None = None) -> tuple[str, ...]:
        """Return the fingers on the zones, from left to right, such as ``left index``."""
        laid: tuple[str, ...] = FINGERS.get((self.finger_condition, hand), ())
        laid = (named or {}).get(self.finger_condition, laid)
        if not laid or not self.placement.endswith("swapped"):
            return laid
        first = laid[0].split()[0]
        if all(finger.startswith(first) for finger in laid):
            other = "left" if first == "right" else "right"
            return tuple(finger.replace(first, other) for finger in reversed(laid))
        return tuple(sorted(laid, key=lambda finger: finger.startswith(first)))


@dataclass(frozen=True)
class Trial:
    """One presentation and one response.

    Attributes
    ----------
    index : int
        Position in the session, from 1; practice trials are counted separately.
    block : int
        Block (one finger condition) from 1; 0 for practice.
    condition : Condition
        The condition presented.
    repetition : int
        Number of the presentation of this condition, from 1.
    practice : bool
        Whether this is a practice trial, which the analysis ignores.
    interval : int
        Interval in which the condition is presented, from 1; 0 if the trial has no intervals.
    """

    index: int
    block: int
    condition: Condition
    repetition: int = 1
    practice: bool = False
    interval: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Return the trial as a JSON-serialisable dict for the record."""
        values = asdict(self)
        for name in ("stimulus", "zone_between"):
            if not values["condition"][name]:
                del values["condition"][name]
        if not self.interval:
            del values["interval"]
        return values

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Trial:
        """Restore a trial from the output of `as_dict`."""
        return cls(**{**values, "condition": Condition(**values["condition"])})


@dataclass(frozen=True)
class Answer:
    """One possible answer."""

    name: str  # name in the protocol, the record and every table
    # fingers named, out of ``left``, ``between`` and ``right``; empty if the answer means that nothing was felt; None
    # if it does not refer to fingers
    fingers: Fingers | None = None
    is_below: bool = False  # whether its button is below the others
    # interval named, from 1; ``same`` or ``different`` for an answer on whether all intervals were alike; None if the
    # answer does not refer to intervals
    interval: int | Literal["same", "different"] | None = None

    @property
    def side(self) -> int:
        """Side of an answer that names a single finger: -1 left, 1 right; 0 for any other answer."""
        sides: dict[Fingers, int] = {("left",): -1, ("right",): 1}
        return sides.get(self.fingers or (), 0)

    @property
    def mirrored(self) -> Fingers | None:
        """Fingers named when the beam is turned end to end."""
        other: dict[Side, Side] = {"left": "right", "between": "between", "right": "left"}
        return None if self.fingers is None else tuple(sorted(other[finger] for finger in self.fingers))

    @property
    def means_nothing_felt(self) -> bool:
        """Whether the answer means that nothing was felt."""
        return self.fingers == ()


class AnswerList(tuple[Answer, ...]):
    """The answers of a protocol in screen order: the row from the left, then those below."""

    __slots__ = ()

    @classmethod
    def of(cls, section: Mapping[str, Any]) -> AnswerList:
        """Return the answers in the section ``answers`` of a protocol or of a record.

        Parameters
        ----------
        section : mapping
            ``keys`` by answer, with optional ``fingers``, ``below`` and ``intervals``. Without ``keys``, the answers
            are the paper's three; with a ``scale``, the single answer ``rated``.

        Returns
        -------
        AnswerList
            In the order of the file, except that a row of answers that all name fingers is ordered by finger.
        """
        if section.get("scale"):
            return cls((Answer(RATED),))
        fingers = {**SHIPPED, **section.get("fingers", {})}
        placed, intervals = section.get("below", ()), section.get("intervals", {})
        row: list[Answer] = []
        below: list[Answer] = []
        for name in section.get("keys") or ("left", "both", "right"):
            named = fingers.get(name)
            own = None if named is None else tuple(sorted(named))
            answer = Answer(name, own, own == () or name in placed, intervals.get(name))
            (below if answer.is_below else row).append(answer)
        if all(answer.fingers for answer in row):
            row.sort(key=lambda answer: answer.side)
        if len(row) == len(below) == 1 and not placed:
            # Two answers are side by side, since a lower place would bias participants in doubt.
            below = [replace(below[0], is_below=False)]
        return cls((*row, *below))

    @classmethod
    def of_words(cls, words: tuple[str, ...]) -> AnswerList:
        """Return the list for the answers in a table: the paper's list if it has them all, else these alone."""
        if not set(words) <= set(SHIPPED):
            return cls.of({"keys": words})
        return cls.of({"keys": [name for name, fingers in SHIPPED.items() if fingers or name in words]})

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the answers, in screen order."""
        return tuple(answer.name for answer in self)

    @property
    def ranked(self) -> AnswerList:
        """The answers sorted: those that name one finger, then several, then none."""
        return AnswerList(sorted(self, key=lambda answer: 0 if answer.fingers is None else _RANKS[len(answer.fingers)]))

    @property
    def compares(self) -> bool:
        """Whether each of two fingers can be named alone, so that one zone can be preferred."""
        return None not in (self.naming("left"), self.naming("right")) and not self.names_between

    @property
    def refers(self) -> bool:
        """Whether an answer follows from what was felt; if none does, simulated participants answer at random."""
        is_yes_or_no = len(self) == 2 and self.naming() is not None
        return is_yes_or_no or any(answer.fingers or answer.interval for answer in self)

    @property
    def names_between(self) -> bool:
        """Whether an answer names the middle one of three fingers."""
        return any("between" in (answer.fingers or ()) for answer in self)

    def naming(self, *fingers: Side) -> Answer | None:
        """Return the answer that names exactly these fingers; without arguments, the answer for nothing felt."""
        return next((answer for answer in self if answer.fingers == fingers), None)

    def named(self, name: str) -> Answer:
        """Return the answer with a name; for an unknown name, such as a time-out, an answer without a meaning."""
        return next((answer for answer in self if answer.name == name), Answer(name))

    def expected(self, *speeds: float) -> str | None:
        """Return the name of the answer expected of a sensitive participant; None if uncertain or not offered.

        Parameters
        ----------
        *speeds : float
            Predicted peak speeds under one to three fingers, from left to right, in one unit.

        Raises
        ------
        ValueError
            If a speed is negative or not finite.
        """
        for speed in speeds:
            if not (math.isfinite(speed) and speed >= 0):
                raise ValueError(f"given speeds {' and '.join(map(str, speeds))}; allowed: finite speeds, 0 or more")
        *others, high = sorted(speeds)
        sides, expected = SIDES[len(speeds)], None
        if high <= EQUAL_RATIO * min(speeds) or high == 0:
            expected = self.naming(*sorted(sides))
        elif high >= CLEAR_RATIO * max(others):
            expected = self.naming(sides[speeds.index(high)])
        return expected.name if expected is not None else None

    def is_success(self, name: str, rule: str, focus: str, zone_left: str) -> bool:
        """Test whether an answer counts as success in an adaptive run.

        ``focus_named``: the answer names only the finger on the zone in focus. Naming both fingers, neither or the
        other one is a failure, because the run seeks the level at which the focus is identified, not merely felt.
        ``felt``: any answer except that nothing was felt. The name of an answer: that answer.

        Parameters
        ----------
        name : str
            The answer.
        rule : str
            ``adaptive.success`` of the protocol.
        focus : str
            Zone in focus.
        zone_left : str
            Zone under the left finger.
        """
        named = self.named(name).fingers
        if rule == "felt" and self.naming() is not None:
            return named != ()
        if rule in self.names:
            return name == rule
        return named == (("left",) if zone_left == focus else ("right",))


@dataclass(frozen=True)
class Response:
    """The participant's answer to a trial, with its timing.

    Attributes
    ----------
    answer : str
        Name of one of the protocol's answers, or ``time_out``.
    reaction_time : float
        Time from the onset given by `onset` to the answer event or the time-out [s].
    onset : str
        ``first_burst`` or ``question`` (if the stimulus stops before the question).
    answered_by : str
        ``participant``, ``experimenter`` (typed for the participant) or ``simulated``.
    way : str
        ``free_hand``, ``lifting`` (a finger off the beam), ``foot_switch`` or ``experimenter``, as in the protocol;
        empty without a window.
    device : str
        ``key``, ``mouse``, ``console`` (the experimenter's), ``model`` (an observer without a window), or ``none`` at
        a time-out.
    key : str
        Name of the key or of the button clicked.
    double : bool
        Whether another answer followed within 50 ms.
    question_after : float or None
        Time from the onset of the stimulus to the question on the screen [s]; None without a screen.
    question_uncertainty : float
        Time taken to show the question, which was visible at most this much earlier than `question_after` [s].
    time_uncertainty : float
        Upper bound of the delay between the answer event and its time stamp [s].
    value : float or None
        The number given on a scale.
    further : dict of str to dict
        The response to each further question, by name.
    """

    answer: str
    reaction_time: float
    onset: str = "first_burst"
    answered_by: str = "participant"
    way: str = ""
    device: str = "key"
    key: str = ""
    double: bool = False
    question_after: float | None = None
    question_uncertainty: float = 0.0
    time_uncertainty: float = 0.0
    value: float | None = None
    further: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def counted_from(self) -> float:
        """Start of the reaction time [s after the onset of the stimulus]."""
        return (self.question_after or 0.0) if self.onset == "question" else 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return the response as a JSON-serialisable dict for the record."""
        return {name: value for name, value in asdict(self).items() if name not in _SELDOM or value not in (None, {})}
