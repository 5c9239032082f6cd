"""Trial, condition and response."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
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

SIDES: dict[int, tuple[Literal["left", "between", "right"], ...]] = {
    1: ("left",),
    2: ("left", "right"),
    3: ("left", "between", "right"),
}
"""Sides of the fingers, by number of fingers; a single finger is the left one."""


@dataclass(frozen=True)
class Condition:
    """The factor levels of one cell of the design.

    Attributes
    ----------
    finger_condition : str
        ``one_hand`` (index and middle finger of one hand; the paper's test 1), ``two_hands`` (both index
        fingers; test 2), or one that the protocol defines.
    zone_left, zone_right : str
        Zones under the outer fingers, left and right as seen by the participant; for a single finger, its zone and an
        empty string.
    velocity_mm_s : float
        Peak velocity at the centre of the focus zone at the focusing instant [mm/s]; 0 in a catch trial.
    placement : str
        ``normal``; ``mirrored`` (the beam turned end to end, so that its last zone is on the left);
        ``swapped`` (the other hand, or crossed hands if both are on the beam); ``mirrored_swapped``.
    stimulus : str
        Name of the stimulus; empty if the protocol has only one, and in a catch trial.
    zone_between : str
        Zone under the middle one of three fingers; empty for fewer fingers.
    """

    finger_condition: str
    zone_left: str
    zone_right: str
    velocity_mm_s: float
    placement: str = "normal"
    stimulus: str = ""
    zone_between: str = ""

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
        values = asdict(self)
        return {name: value for name, value in values.items() if name not in _SELDOM or value not in (None, {})}
