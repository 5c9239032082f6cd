"""Designs of a protocol for an observer, and checks that the observer can simulate it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modaltouch.analysis import Pair
from modaltouch.planning.design import Design
from modaltouch.planning.observer import Observer
from modaltouch.planning.observer.felt import FeltSpeeds
from modaltouch.planning.observer.population import FrontEnd
from modaltouch.preflight import Preflight
from modaltouch.protocol import InputError, Protocol, Turn

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
    protocol = preflight.experiment.protocol
    adaptive = "adaptive runs, which have no fixed conditions"
    remedy = "let `modaltouch prereg` say how precisely thresholds will be known, or plan with fixed levels"
    _refuse(preflight, (protocol.adaptive, ("adaptive",), adaptive, "fixed levels", remedy))
    refuse_own_levels(preflight)
    refuse_unlike(preflight)
    placements = _placements(protocol)
    return {name: _design(name, part, observer, placements) for name, part in preflight.parts.items()}


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
    "groups": "groups of participants, which one observer cannot represent",
    "schedule": "kinds of session, whose tests are corrected together",
}


def refuse_unlike(preflight: Preflight) -> None:
    """Refuse a protocol whose cells or answers do not fit an observer that compares two fingers."""
    protocol = preflight.experiment.protocol
    offered, n_intervals = protocol.answers.offered, 1 if protocol.intervals is None else protocol.intervals.number
    unknown = next((name for name in protocol.conditions.finger_conditions if name not in _KNOWN), "")
    odd = any(answer.fingers is None for answer in offered)
    _refuse(
        preflight,
        (
            protocol.uncrossed_by,
            protocol.uncrossed_by,
            _UNCROSSED.get("".join(protocol.uncrossed_by[:1]), "a design that is not crossed"),
            "every pair at every level, equally often, in every finger condition, for all participants",
            f"{_SIMULATE}, or plan with a protocol of a part of the design",
        ),
        (
            n_intervals > 1,
            ("intervals",),
            f"trials of {n_intervals} intervals, but this compares two fingers in one interval",
            "null",
            _SIMULATE,
        ),
        (
            unknown,
            ("conditions", "finger_conditions"),
            f"{unknown}, but no observer models how its fingers suppress each other",
            ", ".join(_KNOWN),
            _SIMULATE,
        ),
        (
            odd or not offered.compares or offered.naming("left", "right") is None,
            ("answers", "keys" if protocol.answers.scale is None else "scale"),
            ("a scale" if protocol.answers.scale else f"the answers {', '.join(offered.names)}")
            + ", which an observer that compares two fingers does not give",
            "an answer for each finger and one for both, with or without one for neither",
            _SIMULATE,
        ),
    )


def _refuse(preflight: Preflight, *known: tuple[object, tuple[str, ...], str, str, str]) -> None:
    """Refuse a protocol for the first condition that holds, each with path, given value, allowed value and remedy."""
    for holds, path, given, allowed, remedy in known:
        if holds:
            raise InputError([preflight.findings.problem(path, given, allowed, remedy)])


def _design(name: str, preflight: Preflight, observer: Observer, placements: tuple[bool, ...]) -> Design:
    """Return the design of one stimulus of a protocol."""
    protocol = preflight.experiment.protocol
    felt = felt_speeds(preflight, observer.front_end)
    conditions = protocol.conditions
    fingers = tuple(sorted(conditions.finger_conditions))
    pairs = tuple(Pair.of(left, right, protocol.stimulus.focus) for left, right in sorted(conditions.pairs))
    levels = tuple(sorted(conditions.peak_velocities_mm_s))
    speeds = [
        [[felt(condition, pair.left, pair.right, level * 1e-3) for level in levels] for pair in pairs]
        for condition in fingers
    ]
    margin = protocol.analysis.equivalence_margin
    return Design(protocol.protocol, fingers, pairs, levels, np.array(speeds), placements, name, margin)


def felt_speeds(preflight: Preflight, front_end: FrontEnd) -> Callable[[str, str, str, float], tuple[float, float]]:
    """Return a function that computes the speeds felt by two fingers."""
    zones = {name: zone.centre_mm * 1e-3 for name, zone in preflight.experiment.apparatus.zones.items()}
    placed = preflight.placed or {"": preflight}
    speeds = {name: FeltSpeeds(part.stimulus, zones, front_end) for name, part in placed.items()}

    def felt(finger_condition: str, left: str, right: str, velocity: float) -> tuple[float, float]:
        place = preflight.findings.placement_of(finger_condition, left, right) if preflight.placed else ""
        played = velocity * placed[place].sound[0].share
        return speeds[place].at(left, played), speeds[place].at(right, played)

    return felt


def _placements(protocol: Protocol) -> tuple[bool, ...]:
    """Return whether the beam is turned for the first, second, ... participant, for one full cycle."""
    conditions = protocol.conditions
    if not any(name.startswith("mirrored") for name in conditions.placements):
        return (False,)
    n_turns = len(conditions.placements) * max(1, 2 * len(conditions.finger_conditions))
    turns = (Turn.of(f"p{number}", 0, 1, protocol.groups) for number in range(1, n_turns + 1))
    return tuple(turn.order(protocol)[1].startswith("mirrored") for turn in turns)
