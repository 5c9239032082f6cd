"""The answers of a protocol: names, places on the screen, and the fingers that they name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from modaltouch.protocol.trial import RATED, SIDES

Side = Literal["left", "between", "right"]
Fingers = tuple[Side, ...]
"""Fingers by side, as the participant sees the beam; `between` is the middle one of three."""

SHIPPED: dict[str, Fingers] = {"left": ("left",), "both": ("left", "right"), "right": ("right",), "none": ()}
"""The paper's three answers and `none` ("felt nowhere"), with the fingers that they name."""

_RANKS = {1: 0, 2: 1, 3: 1, 0: 2}

CLEAR_RATIO = 1.25
"""Clearly perceptible ratio of speeds: twice the difference threshold of vibration (Craig 1972) [1]."""
EQUAL_RATIO = 1.1
"""Ratio of speeds below the difference threshold [1]."""


@dataclass(frozen=True)
class Answer:
    """One possible answer.

    Attributes
    ----------
    name : str
        Name in the protocol, the record and every table.
    fingers : tuple of str or None
        Fingers named, out of ``left``, ``between`` and ``right``; empty if the answer means that nothing was felt; None
        if it does not refer to fingers.
    is_below : bool
        Whether its button is below the others.
    interval : int, str or None
        Interval named, from 1; ``same`` or ``different`` for an answer on whether all intervals were alike; None if the
        answer does not refer to intervals.
    """

    name: str
    fingers: Fingers | None = None
    is_below: bool = False
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
        """Whether any answer names a finger or an interval; if none does, simulated participants answer at random."""
        return any(answer.fingers or answer.interval for answer in self)

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
