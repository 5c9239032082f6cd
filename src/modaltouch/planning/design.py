"""Designs of a protocol for an observer: its cells in the order of the analysis, with the felt speeds in each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modaltouch.analysis import STATISTICS, AnswerCounts, Pair
from modaltouch.planning.felt import felt_per_level
from modaltouch.planning.observer import FloatArray, FrontEnd, Observer
from modaltouch.preflight import Preflight
from modaltouch.protocol import AnswerList, InputError, Protocol, Turn


@dataclass(frozen=True, eq=False)
class Design:
    """Cells of a protocol in the order of the analysis, with the speeds felt by an observer in each.

    Attributes
    ----------
    protocol : str
        Name of the protocol.
    finger_conditions : tuple of str
        Finger conditions.
    pairs : tuple of Pair
        Zone pairs, each with its dominant zone.
    levels : tuple of float
        Peak velocities, increasing [mm/s].
    speeds : (n_finger_conditions, n_pairs, n_levels, 2) array
        Speeds felt by the left and the right finger, as defined by the observer's front end [m/s].
    placements : tuple of bool
        Whether the beam is turned for the first, second, ... participant; repeated for more participants.
    stimulus : str
        Stimulus presented in the cells; empty if the protocol has only one.
    margin : float or None
        Equivalence margin of the finger conditions [1].
    answers : AnswerList
        The answers offered: one for each finger, one for both, and possibly one for nothing felt.
    n_repetitions : int
        Answers per participant and cell in all analysed sessions of the protocol.
    """

    protocol: str
    finger_conditions: tuple[str, ...]
    pairs: tuple[Pair, ...]
    levels: tuple[float, ...]
    speeds: FloatArray
    placements: tuple[bool, ...] = (False,)
    stimulus: str = ""
    margin: float | None = None
    answers: AnswerList = field(default_factory=lambda: AnswerList.of({}))
    n_repetitions: int = 1

    @property
    def places(self) -> list[int]:
        """Indices of the answers left, both, right and, if offered, nothing felt."""
        naming = self.answers.naming
        offered = naming("left"), naming("left", "right"), naming("right"), naming()
        return [self.answers.index(answer) for answer in offered if answer is not None]

    @property
    def title(self) -> str:
        """Name of the protocol, with the stimulus if there are several."""
        return f"{self.protocol}, stimulus {self.stimulus}" if self.stimulus else self.protocol

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of finger conditions, pairs and levels."""
        return len(self.finger_conditions), len(self.pairs), len(self.levels)

    @property
    def cells(self) -> tuple[str, ...]:
        """Finger condition of every cell, in the order of `speeds`."""
        _, n_pairs, n_levels = self.shape
        return tuple(name for name in self.finger_conditions for _ in range(n_pairs * n_levels))

    def facing(self, n_participants: int) -> FloatArray:
        """Return 1 for each participant, or -1 if the beam is turned for them, (n_participants,) array."""
        return np.where(np.resize(np.array(self.placements), n_participants), -1.0, 1.0)

    def count(self, counts: NDArray[np.int64], n_repetitions: int) -> AnswerCounts:
        """Return counts of answers in the form used by the analysis.

        Parameters
        ----------
        counts : (..., n_participants, n_finger_conditions, n_pairs, n_levels, n_answers) array of int
            Counts of the `answers` by participant and cell, for one experiment or a batch.
        n_repetitions : int
            Answers per participant and cell.
        """
        names = tuple(f"p{number}" for number in range(1, counts.shape[-5] + 1))
        return AnswerCounts(
            names,
            self.finger_conditions,
            self.pairs,
            self.levels,
            counts,
            n_repetitions,
            answers=self.answers,
            margin=self.margin,
        )

    @cached_property
    def tests(self) -> dict[str, list[tuple[str, str]]]:
        """Scope and quantity of each test, as worded by the analysis, by family (a key of `STATISTICS`)."""
        nothing_yet = self.count(np.zeros((1, *self.shape, len(self.answers)), dtype=np.int64), 1)
        found = {family: statistic.compute(nothing_yet) for family, statistic in STATISTICS.items()}
        return {
            family: [] if result is None else list(zip(result.scopes, result.quantities, strict=True))
            for family, result in found.items()
        }


_KNOWN = ("one_hand", "two_hands")
_SIMULATE = "simulate sessions and analyse those, as `modaltouch prereg` does"


def designs_for(preflight: Preflight, observer: Observer) -> dict[str, Design]:
    """Return the design of each stimulus of a protocol for an observer, by name; the name is empty for a single one.

    As in ``modaltouch analyse --stimulus``, each stimulus has its own families of tests, so each has its own design.

    Parameters
    ----------
    preflight : Preflight
        The checked protocol.
    observer : Observer
        Observer, whose front end defines the felt speeds.

    Raises
    ------
    InputError
        If the protocol has faults, or its levels depend on answers or differ between participants.
    """
    preflight = of_analysed_kind(preflight)
    protocol = preflight.experiment.protocol
    _refuse(
        preflight,
        (
            protocol.adaptive,
            ("adaptive",),
            "adaptive runs, which have no fixed conditions",
            "fixed levels",
            "let `modaltouch prereg` say how precisely thresholds will be known, or plan with fixed levels",
        ),
    )
    refuse_own_levels(preflight)
    refuse_unlike(preflight)
    placements, listed = _placements(protocol), Counter(protocol.cells(protocol.conditions.finger_conditions[0]))
    designs = {}
    for name, part in preflight.parts.items():
        if cells := {(pair, level): weight for (pair, level, own), weight in listed.items() if own == name}:
            designs[name] = _design(name, part, observer, placements, cells)
    return designs


def of_analysed_kind(preflight: Preflight) -> Preflight:
    """Return the preflight of the only analysed kind of session, or self if there are several; refuse none."""
    every = preflight.experiment.protocol.schedule.session_kinds
    kinds = {kind.name for kind in every if kind.analysed}
    _refuse(
        preflight,
        (
            every and not kinds,
            ("schedule", "sessions"),
            f"no kind of session that is analysed (only {', '.join(dict.fromkeys(kind.name for kind in every))})",
            "at least one kind without `analysed: false`",
            "add the sessions whose answers you will analyse",
        ),
    )
    return preflight.at("", *kinds) if len(kinds) == 1 else preflight


def refuse_own_levels(preflight: Preflight, remedy: str = "plan with the peak velocities that you expect") -> None:
    """Refuse a protocol whose levels differ between participants."""
    _refuse(
        preflight,
        (
            preflight.experiment.protocol.conditions.sensation_levels,
            ("conditions", "sensation_levels"),
            "levels calibrated by participant, which depend on thresholds not yet known",
            "fixed levels",
            remedy,
        ),
    )


_UNCROSSED = {
    "conditions": ("cells that are not every pair at every level equally often", "cells of a crossed design"),
    "groups": ("groups of participants, which one observer cannot represent", "no groups"),
    "schedule": ("several analysed kinds of session, whose tests are corrected together", "one analysed kind"),
}


def refuse_unlike(preflight: Preflight, remedy: str = _SIMULATE) -> None:
    """Refuse a protocol whose cells or answers do not fit an observer that compares two fingers."""
    protocol = preflight.experiment.protocol
    offered, n_intervals = protocol.answers.offered, 1 if protocol.intervals is None else protocol.intervals.number
    unknown = next((name for name in protocol.conditions.finger_conditions if name not in _KNOWN), "")
    odd, uncrossed_by = any(answer.fingers is None for answer in offered), protocol.uncrossed_by
    _refuse(
        preflight,
        (
            uncrossed_by,
            uncrossed_by,
            *_UNCROSSED["".join(uncrossed_by[:1]) or "groups"],
            f"{remedy}, or give the protocol of a crossed part of the design",
        ),
        (
            n_intervals > 1,
            ("intervals",),
            f"trials of {n_intervals} intervals, but this compares two fingers in one interval",
            "null",
            remedy,
        ),
        (
            unknown,
            ("conditions", "finger_conditions"),
            f"{unknown}, but no observer models how its fingers suppress each other",
            ", ".join(_KNOWN),
            remedy,
        ),
        (
            odd or not offered.compares or offered.naming("left", "right") is None,
            ("answers", "keys" if protocol.answers.scale is None else "scale"),
            ("a scale" if protocol.answers.scale else f"the answers {', '.join(offered.names)}")
            + ", which an observer that compares two fingers does not give",
            "an answer for each finger and one for both, with or without one for neither",
            remedy,
        ),
    )


def _refuse(preflight: Preflight, *known: tuple[object, tuple[str, ...], str, str, str]) -> None:
    """Refuse a protocol for the first condition that holds, each with path, given value, allowed value and remedy."""
    for holds, path, given, allowed, remedy in known:
        if holds:
            raise InputError([preflight.findings.problem(path, given, allowed, remedy)])


def _design(
    name: str,
    preflight: Preflight,
    observer: Observer,
    placements: tuple[bool, ...],
    weights: Mapping[tuple[tuple[str, ...], float], int],
) -> Design:
    """Return the design of a stimulus; `weights` has its pairs and levels, and how often each is in a repetition."""
    protocol = preflight.experiment.protocol
    felt = felt_speeds(preflight, observer.front_end)
    fingers = tuple(sorted(protocol.conditions.finger_conditions))
    zones = sorted({pair for pair, _ in weights})
    pairs = tuple(Pair.of(left, right, protocol.stimulus.focus) for left, right, *_ in zones)
    levels = tuple(sorted({level for _, level in weights}))
    speeds = [
        [[felt(condition, pair.left, pair.right, level * 1e-3) for level in levels] for pair in pairs]
        for condition in fingers
    ]
    return Design(
        protocol.protocol,
        fingers,
        pairs,
        levels,
        np.array(speeds),
        placements,
        name,
        protocol.analysis.equivalence_margin,
        protocol.answers.offered,
        protocol.schedule.all_repetitions * max(weights.values()),
    )


def felt_speeds(preflight: Preflight, front_end: FrontEnd) -> Callable[[str, str, str, float], tuple[float, float]]:
    """Return a function that computes the speeds felt by two fingers."""
    zones = {name: zone.centre_mm * 1e-3 for name, zone in preflight.experiment.apparatus.zones.items()}
    placed = preflight.placed or {"": preflight}
    shares = {name: felt_per_level(part.stimulus, zones, front_end) for name, part in placed.items()}

    def felt(finger_condition: str, left: str, right: str, velocity: float) -> tuple[float, float]:
        place = preflight.findings.placement_of(finger_condition, left, right) if preflight.placed else ""
        played = velocity * placed[place].sound[0].share
        return shares[place][left] * played, shares[place][right] * played

    return felt


def _placements(protocol: Protocol) -> tuple[bool, ...]:
    """Return whether the beam is turned for the first, second, ... participant, for one full cycle."""
    conditions = protocol.conditions
    if not any(name.startswith("mirrored") for name in conditions.placements):
        return (False,)
    n_turns = len(conditions.placements) * max(1, 2 * len(conditions.finger_conditions))
    turns = (Turn.of(f"p{number}", 0, 1, protocol.groups) for number in range(1, n_turns + 1))
    return tuple(turn.order(protocol)[1].startswith("mirrored") for turn in turns)
