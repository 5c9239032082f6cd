"""The answers of a protocol: what each is called, where it stands on the screen, and which fingers it names."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from modaltouch.protocol.questions import RATED
from modaltouch.protocol.trial import SIDES

Side = Literal["left", "between", "right"]
Fingers = tuple[Side, ...]
"""Fingers by the side on which they lie, as the participant sees the beam; `between`, the middle one of three."""

SHIPPED: dict[str, Fingers] = {"left": ("left",), "both": ("left", "right"), "right": ("right",), "none": ()}
"""The paper's three answers, and the one for "felt nowhere", with the fingers that they name."""

_RANKS = {1: 0, 2: 1, 3: 1, 0: 2}


CLEAR_RATIO = 1.25
"""Speeds this far apart are told apart with ease: twice the difference threshold of vibration (Craig 1972)."""
EQUAL_RATIO = 1.1
"""Speeds this near are below the difference threshold [1]."""


@dataclass(frozen=True)
class Answer:
    """One answer that may be given.

    Attributes
    ----------
    name : str
        Name in the protocol, the record and every table.
    fingers : tuple of str or None
        Fingers that it names, of ``left``, ``between`` and ``right``; empty where it says that nothing was felt; None
        where it says nothing of the fingers.
    is_below : bool
        Whether its button stands below the others.
    interval : int, str or None
        Interval of the trial that it names, from 1; ``same`` or ``different`` where it says whether all were alike;
        None where it says nothing of the intervals.
    """

    name: str
    fingers: Fingers | None = None
    is_below: bool = False
    interval: int | Literal["same", "different"] | None = None

    @property
    def side(self) -> int:
        """Place of the fingers that it names: -1 on the left, 1 on the right, 0 for all else."""
        sides: dict[Fingers, int] = {("left",): -1, ("right",): 1}
        return sides.get(self.fingers or (), 0)

    @property
    def mirrored(self) -> Fingers | None:
        """The fingers that it names where the beam is turned end to end."""
        other: dict[Side, Side] = {"left": "right", "between": "between", "right": "left"}
        return None if self.fingers is None else tuple(sorted(other[finger] for finger in self.fingers))

    @property
    def says_nothing_felt(self) -> bool:
        """Whether it says that nothing was felt."""
        return self.fingers == ()


class AnswerList(tuple[Answer, ...]):
    """The answers of a protocol, as they stand on the screen: those of the row from the left, then those below."""

    __slots__ = ()

    @classmethod
    def of(cls, section: Mapping[str, Any]) -> AnswerList:
        """Return the answers of a protocol's section ``answers``, also as a record keeps it.

        Parameters
        ----------
        section : mapping
            ``keys`` by answer, and where they are given ``fingers``, ``below`` and ``intervals``; the paper's answers
            without any; one alone, ``rated``, where there is a ``scale``.

        Returns
        -------
        AnswerList
            In the order of the file; where all of a row name fingers, each on the side of its finger.
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
            # Of two answers neither stands back: that would lean on who is in doubt.
            below = [replace(below[0], is_below=False)]
        return cls((*row, *below))

    @classmethod
    def of_words(cls, words: tuple[str, ...]) -> AnswerList:
        """Return the list that words from a table belong to: the paper's where all are of it, else they alone."""
        if not set(words) <= set(SHIPPED):
            return cls.of({"keys": words})
        return cls.of({"keys": [name for name, fingers in SHIPPED.items() if fingers or name in words]})

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the answers, as they stand on the screen."""
        return tuple(answer.name for answer in self)

    @property
    def ranked(self) -> AnswerList:
        """The answers of one finger first, then those of several, then that of nothing felt."""
        return AnswerList(sorted(self, key=lambda answer: 0 if answer.fingers is None else _RANKS[len(answer.fingers)]))

    @property
    def compares(self) -> bool:
        """Whether each of two fingers can be named alone, so that one zone can be preferred to the other."""
        return None not in (self.naming("left"), self.naming("right")) and not self.names_between

    @property
    def names_between(self) -> bool:
        """Whether an answer names the middle one of three fingers."""
        return any("between" in (answer.fingers or ()) for answer in self)

    def naming(self, *fingers: Side) -> Answer | None:
        """Return the answer that names these very fingers; without any, the one that nothing was felt."""
        return next((answer for answer in self if answer.fingers == fingers), None)

    def named(self, name: str) -> Answer:
        """Return the answer of a name; one that says nothing if there is none, as for a time-out."""
        return next((answer for answer in self if answer.name == name), Answer(name))

    def expected(self, *speeds: float) -> str | None:
        """Name of the answer of somebody who feels well; None where it may be either, or no answer says it.

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
        """Whether an answer counts as success in an adaptive run.

        ``focus_named``: the answer names the finger on the zone in focus, alone. Naming both fingers or none is a
        failure like naming the other: what is asked is the level from which the focus is told apart, not from which
        something is felt. ``felt``: any answer but that nothing was felt. The name of an answer: that one.

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
