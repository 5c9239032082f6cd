"""Counts of answers by participant and cell, as one array."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modaltouch.analysis.columns import VELOCITY, LevelScale, scale_of, zones_in_words, zones_of
from modaltouch.analysis.contrasts import Shares
from modaltouch.protocol import AnswerList

PAPER_CONDITIONS = ("one_hand", "two_hands")


@dataclass(frozen=True)
class Pair:
    """The zones under one to three fingers, usually two.

    Attributes
    ----------
    left, right : str
        Zones under the left and the right finger; the right one is empty for one finger.
    dominant : str
        Zone whose choice is the effect: the focus if it is touched, else the left zone.
    focused : bool
        Whether the focus is one of the zones.
    between : str
        Zone under the middle finger; empty for fewer than three fingers.
    """

    left: str
    right: str
    dominant: str
    focused: bool
    between: str = ""

    @classmethod
    def of(cls, left: str, right: str, focus: str, between: str = "") -> Pair:
        """Return the pair of zones under the left, the right and any middle finger; the focus may be empty."""
        focused = focus in (left, right, between) and focus != ""
        return cls(left, right, focus if focused else left, focused, between)

    @property
    def zones(self) -> tuple[str, ...]:
        """The zones from left to right."""
        return tuple(filter(None, (self.left, self.between, self.right)))

    @property
    def label(self) -> str:
        """All zones, as in ``A-C``."""
        return "-".join(self.zones)

    @property
    def in_words(self) -> str:
        """All zones in words, as in ``A and C``."""
        return zones_in_words(self.zones)

    @property
    def other(self) -> str:
        """The zone that is not the dominant one."""
        return self.right if self.dominant == self.left else self.left

    @property
    def dominant_side(self) -> Literal["left", "right"]:
        """Finger on the dominant zone."""
        return "left" if self.dominant == self.left else "right"

    @property
    def other_side(self) -> Literal["left", "right"]:
        """Finger on the other zone."""
        return "right" if self.dominant == self.left else "left"

    @property
    def both(self) -> str:
        """Left and right zone in the paper's notation, with the focus first."""
        return (
            f"{self.right} & {self.left}"
            if self.focused and self.dominant == self.right
            else f"{self.left} & {self.right}"
        )


@dataclass(frozen=True, eq=False)
class AnswerCounts:
    """Counts of answers by participant and cell.

    Attributes
    ----------
    participants, finger_conditions : tuple of str
        Names along the first two axes.
    pairs : tuple of Pair
        Zone pairs along the third axis.
    levels : tuple of float
        Levels along the fourth axis, on `scale`: peak velocities [mm/s] or multiples of each participant's threshold.
    counts : (..., n_participants, n_finger_conditions, n_pairs, n_levels, n_answers) array of int
        Counts of the `answers`; leading axes are those of a batch of experiments.
    n_repetitions : int
        Scheduled answers per participant and cell; if `counts` has fewer, the rest are missing.
    focus : str
        Zone of the focus; empty if unknown.
    scale : LevelScale
        Scale of the levels.
    mirrored : frozenset of str
        Participants with the beam turned end to end, so that left and right are exchanged.
    answers : AnswerList
        The answers offered.
    margin : float or None
        Equivalence margin of the shares in finger conditions, specified by the protocol [1].
    guesses_evenly : bool
        Whether a guessing participant gives all answers with equal probability.
    """

    participants: tuple[str, ...]
    finger_conditions: tuple[str, ...]
    pairs: tuple[Pair, ...]
    levels: tuple[float, ...]
    counts: NDArray[np.int64]
    n_repetitions: int
    focus: str = ""
    mirrored: frozenset[str] = frozenset()
    scale: LevelScale = VELOCITY
    answers: AnswerList = field(default_factory=lambda: AnswerList.of({}))
    margin: float | None = None
    guesses_evenly: bool = True

    @property
    def has_none_answer(self) -> bool:
        """Whether "nothing felt" was among the answers."""
        return self.answers.naming() is not None

    @property
    def compares(self) -> bool:
        """Whether there are two fingers, each with an answer naming it alone, so that a pair has a dominant zone."""
        return self.answers.compares and all(len(pair.zones) == 2 for pair in self.pairs)

    @property
    def is_nominal(self) -> bool:
        """Whether there are three or more answers, none of which defines the effect."""
        return not self.compares and len(self.answers) > 2

    @property
    def is_paper_design(self) -> bool:
        """Whether the pairs and levels are those of the paper's experiment."""
        pairs = {pair.label for pair in self.pairs}
        return pairs == {"A-C", "B-D", "C-E"} and (self.levels, self.scale) == ((80.0, 100.0, 150.0, 200.0), VELOCITY)

    @property
    def felt(self) -> list[int]:
        """Indices of all answers except "nothing felt"."""
        return [place for place, answer in enumerate(self.answers) if not answer.means_nothing_felt]

    @property
    def both_place(self) -> int | None:
        """Index of the answer that names both fingers, if any."""
        return self._place("left", "right")

    def labelled(self, pair: Pair) -> tuple[tuple[str, int], ...]:
        """Return the label and index of each answer to a pair, in the paper's order.

        Parameters
        ----------
        pair : Pair
            One of `pairs`.
        """
        if not self.compares:
            return tuple((answer.name, place) for place, answer in enumerate(self.answers))
        zones: dict[tuple[str, ...] | None, str] = {
            (pair.dominant_side,): pair.dominant,
            (pair.other_side,): pair.other,
            ("left", "right"): pair.both,
        }
        own = [
            (label, self.answers.index(answer))
            for fingers, label in zones.items()
            for answer in self.answers
            if answer.fingers == fingers
        ]
        rest = [(answer.name, place) for place, answer in enumerate(self.answers) if answer.fingers not in zones]
        return (*own, *rest)

    def effects(self, pair: Pair) -> tuple[tuple[str, int], ...]:
        """Return the label and index of each answer whose share is an effect: the dominant zone, and "both" if offered.

        Without a dominant zone, return all answers, or the first of two, whose share determines the other.

        Parameters
        ----------
        pair : Pair
            One of `pairs`.
        """
        if not self.compares:
            counted = self.answers if self.is_nominal else self.answers[:-1]
            return tuple((answer.name, place) for place, answer in enumerate(counted))
        place = self.both_place
        both = [] if place is None else [(self.answers[place].name, place)]
        return ((pair.dominant, self.dominant_place(pair)), *both)

    def dominant_place(self, pair: Pair) -> int:
        """Return the index of the answer naming the dominant zone of a pair."""
        return self._found(pair.dominant_side)

    def other_place(self, pair: Pair) -> int:
        """Return the index of the answer naming the other zone of a pair."""
        return self._found(pair.other_side)

    def _found(self, side: Literal["left", "right"]) -> int:
        place = self._place(side)
        if place is None:
            raise ValueError(
                f"no answer names the {side} finger alone: the answers are {', '.join(self.answers.names)}"
            )
        return place

    def _place(self, *fingers: Literal["left", "right"]) -> int | None:
        answer = self.answers.naming(*fingers)
        return None if answer is None else self.answers.index(answer)

    @property
    def pair_cells(self) -> list[tuple[int, int, str]]:
        """Indices and scope of all combinations of finger condition and pair, in the order of the tests."""
        named = product(enumerate(self.finger_conditions), enumerate(self.pairs))
        return [(f, q, f"{condition} {pair.label}") for (f, condition), (q, pair) in named]

    @property
    def n_participants(self) -> int:
        """Number of participants."""
        return len(self.participants)

    @property
    def facing(self) -> NDArray[np.int64]:
        """Placement of each participant: 1, or -1 with the beam turned end to end."""
        return np.array([-1 if name in self.mirrored else 1 for name in self.participants], dtype=np.int64)

    @property
    def n_answers(self) -> int:
        """Scheduled answers per participant, finger condition and pair."""
        return self.n_repetitions * len(self.levels)

    @cached_property
    def of_effects(self) -> tuple[NDArray[np.int64], ...]:
        """Counts of each of the `effects`, (..., n_finger_conditions, n_pairs, n_participants, n_levels) arrays."""
        places = [[place for _, place in self.effects(pair)] for pair in self.pairs]
        return tuple(self._picked(each) for each in zip(*places, strict=True))

    @cached_property
    def dominant(self) -> NDArray[np.int64]:
        """Counts of the dominant zone, shaped like each of `of_effects`."""
        return self._picked([self.dominant_place(pair) for pair in self.pairs])

    @cached_property
    def other(self) -> NDArray[np.int64]:
        """Counts of the other zone, shaped like each of `of_effects`."""
        return self._picked([self.other_place(pair) for pair in self.pairs])

    def _picked(self, places: Sequence[int]) -> NDArray[np.int64]:
        """Return the counts of one answer per pair, with the participants' axis after the pairs' axis."""
        own = [np.moveaxis(self.counts[..., q, :, place], -3, -2) for q, place in enumerate(places)]
        return np.stack(own, axis=-3)

    @cached_property
    def answered(self) -> NDArray[np.int64]:
        """Counts of all answers, shaped like each of `of_effects`."""
        return np.moveaxis(self.counts.sum(axis=-1), -4, -2)

    def shares(self, given: NDArray[np.int64]) -> Shares:
        """Return counts, shaped like each of `of_effects`, as shares of all answers."""
        return Shares(given, self.answered, self.n_repetitions)

    @cached_property
    def missing(self) -> list[tuple[str, str, int]]:
        """Participant, cell and number of missing answers of a single experiment."""
        lacks = self.n_repetitions - self.counts.sum(axis=-1)
        return [
            (
                self.participants[who],
                f"{self.finger_conditions[f]} {self.pairs[q].label} {self.scale.say(self.levels[v])}",
                int(lacks[who, f, q, v]),
            )
            for who, f, q, v in np.argwhere(lacks).tolist()
        ]

    def sided(self) -> NDArray[np.int64]:
        """Return the counts of left and right along the last axis."""
        return self.counts[..., [self._found("left"), self._found("right")]]

    def compared(self) -> NDArray[np.int64]:
        """Return the counts of left, both and right, along the last axis.

        Raises
        ------
        ValueError
            If one of these answers was not offered.
        """
        if self.both_place is None:
            raise ValueError(f"no answer names both fingers: the answers are {', '.join(self.answers.names)}")
        return self.counts[..., [self._found("left"), self.both_place, self._found("right")]]

    @cached_property
    def n_modal(self) -> NDArray[np.int64]:
        """Number of participants by most frequent answer, excluding ties; `counts` without the participants' axis."""
        most = self.counts == self.counts.max(axis=-1, keepdims=True)
        return np.asarray((most & (most.sum(axis=-1, keepdims=True) == 1)).sum(axis=-5))

    def modal(self) -> NDArray[np.int64]:
        """Return the index of each participant's most frequent answer per cell; -1 for ties."""
        tied = (self.counts == self.counts.max(axis=-1, keepdims=True)).sum(axis=-1) > 1
        return np.where(tied, -1, self.counts.argmax(axis=-1))


def count_answers(
    frame: pd.DataFrame,
    focus: str = "",
    offered: AnswerList | None = None,
    margin: float | None = None,
    asked: int | None = None,
) -> AnswerCounts:
    """Count the answers of a tidy table.

    Parameters
    ----------
    frame : DataFrame
        Tidy answers; a column ``n`` counts identical answers.
    focus : str
        Zone of the focus; guessed by `find_focus` if empty.
    offered : AnswerList, optional
        The answers offered; by default the paper's, with ``none`` if it occurs in the table.
    margin : float, optional
        As in `AnswerCounts`.
    asked : int, optional
        Scheduled answers per participant and cell; by default the maximum over cells.

    Raises
    ------
    ValueError
        If a response is not one of the answers.
    """
    participants = sorted(map(str, frame["participant"].unique()), key=_natural)
    names, named = zones_of(frame.columns), list(map(str, frame["finger_condition"].unique()))
    conditions = sorted(named, key=[*PAPER_CONDITIONS, *named].index)
    touched = sorted({str(zone) for name in names for zone in frame[name].unique()})
    placed = np.stack([_codes(frame[name], touched) for name in names])
    joint, pairing = np.unique(np.ravel_multi_index(tuple(placed), (len(touched),) * len(names)), return_inverse=True)
    places = np.stack(np.unravel_index(joint, (len(touched),) * len(names)), axis=1)
    zones = [tuple(touched[place] for place in each) for each in places.tolist()]
    scale = scale_of(frame.columns)
    levels, level = np.unique(frame[scale.column].to_numpy(dtype=float), return_inverse=True)
    offered, focus = _offered(frame["response"], offered), focus or find_focus(zones)
    cells = (
        _codes(frame["participant"], participants),
        _codes(frame["finger_condition"], conditions),
        pairing,
        level,
        _codes(frame["response"], offered.names),
    )
    counts = np.zeros((len(participants), len(conditions), len(zones), len(levels), len(offered)), dtype=np.int64)
    np.add.at(counts, cells, frame["n"].to_numpy() if "n" in frame.columns else 1)
    return AnswerCounts(
        tuple(participants),
        tuple(conditions),
        tuple(Pair.of(each[0], each[-1], focus, *each[1:-1]) for each in zones),
        tuple(levels.tolist()),
        counts,
        asked or int(counts.sum(axis=-1).max()),
        focus,
        _mirrored(frame),
        scale,
        offered,
        margin,
    )


def _offered(responses: pd.Series, offered: AnswerList | None) -> AnswerList:
    if offered is None:
        words = responses.astype("category").cat.categories
        offered = AnswerList.of_words(("none",) if "none" in words else ())
    if unknown := sorted(set(responses.unique()) - set(offered.names)):
        raise ValueError(f"response {unknown[0]!r} is not an answer: allowed: {', '.join(offered.ranked.names)}")
    return offered


def find_focus(zones: Sequence[tuple[str, ...]]) -> str:
    """Return the zone shared by most pairs; for ties, C if it is touched, else an empty string.

    Examples
    --------
    >>> find_focus([("A", "C"), ("B", "D"), ("C", "E")])
    'C'
    """
    touched = Counter(zone for each in zones for zone in each if zone).most_common()
    if touched[0][1] > 1 and (len(touched) == 1 or touched[1][1] < touched[0][1]):
        return touched[0][0]
    return "C" if any(zone == "C" for zone, _ in touched) else ""


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return a natural sort key, so that p2 precedes p10."""
    parts = filter(None, re.split(r"(\d+)", name))
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts)


def _codes(column: pd.Series, words: Sequence[str]) -> NDArray[np.int64]:
    return np.asarray(column.astype("category").cat.set_categories(list(words)).cat.codes, dtype=np.int64)


def _mirrored(frame: pd.DataFrame) -> frozenset[str]:
    if "placement" not in frame.columns:
        return frozenset()
    turned = frame["placement"].astype(str).str.startswith("mirrored")
    return frozenset(frame.loc[turned, "participant"].astype(str))
