"""What a protocol presents to an observer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modaltouch.analysis import Pair
from modaltouch.planning.design import Design
from modaltouch.planning.observer import Observer
from modaltouch.planning.observer.felt import FeltSpeeds
from modaltouch.planning.observer.population import FrontEnd
from modaltouch.preflight import Preflight
from modaltouch.protocol import InputError, Protocol, Schedule

_KNOWN = ("one_hand", "two_hands")


def designs_for(preflight: Preflight, observer: Observer) -> dict[str, Design]:
    """Return the design of each stimulus of a protocol for an observer, by name; of one alone, without a name.

    The analysis takes one stimulus at a time (``modaltouch analyse --stimulus``), each with families of tests of its
    own, so each has a design of its own.

    Parameters
    ----------
    preflight : Preflight
        The checked protocol.
    observer : Observer
        Whose front end says what fingers feel.

    Raises
    ------
    InputError
        If anything is wrong with the protocol, or its levels follow from answers or differ between participants.
    """
    findings = preflight.findings
    if preflight.experiment.protocol.adaptive is not None:
        given, remedy = "adaptive runs, which have no fixed conditions", "plan with a protocol of fixed levels"
        raise InputError([findings.problem(("adaptive",), given, "fixed levels", remedy)])
    if preflight.experiment.protocol.conditions.sensation_levels is not None:
        given = "levels calibrated by participant, which depend on thresholds not yet known"
        remedy = "plan with peak velocities as you expect them"
        raise InputError([findings.problem(("conditions", "sensation_levels"), given, "fixed levels", remedy)])
    refuse_uncrossed(preflight)
    refuse_answers(preflight)
    placements = _placements(preflight.experiment.protocol)
    return {name: _design(name, part, observer, placements) for name, part in preflight.parts.items()}


def refuse_uncrossed(preflight: Preflight) -> None:
    """Refuse a protocol whose cells are not crossed, which an observer's design is.

    Raises
    ------
    InputError
        If cells are listed or left out.
    """
    protocol = preflight.experiment.protocol
    if not protocol.is_crossed:
        given = "a design that is not crossed"
        allowed = "every pair at every level, equally often, in every finger condition, for all participants"
        remedy = "simulate sessions and analyse those, or plan with a protocol of a part of the design"
        raise InputError([preflight.findings.problem(protocol.uncrossed_by, given, allowed, remedy)])


def refuse_answers(preflight: Preflight) -> None:
    """Refuse a protocol whose answers the observer's comparison of two fingers does not give.

    Raises
    ------
    InputError
        If each finger cannot be named alone, or both together, or a trial has several intervals.
    """
    if (intervals := preflight.experiment.protocol.intervals) is not None:
        given = f"trials of {intervals.number} intervals, while this compares two fingers in one"
        raise InputError(
            [preflight.findings.problem(("intervals",), given, "null", "simulate sessions and analyse those")]
        )
    offered = preflight.experiment.protocol.answers.offered
    odd = [answer.name for answer in offered if answer.fingers is None]
    if named := [name for name in preflight.experiment.protocol.conditions.finger_conditions if name not in _KNOWN]:
        given = f"{named[0]}, of which no observer knows how its fingers suppress each other"
        path, remedy = ("conditions", "finger_conditions"), "simulate sessions and analyse those"
        raise InputError([preflight.findings.problem(path, given, ", ".join(_KNOWN), remedy)])
    if odd or not offered.compares or offered.naming("left", "right") is None:
        given = f"the answers {', '.join(offered.names)}, which an observer that compares two fingers does not give"
        allowed = "an answer for each finger and one for both, with or without one for neither"
        remedy = "simulate sessions and analyse those"
        place = "keys" if preflight.experiment.protocol.answers.scale is None else "scale"
        raise InputError([preflight.findings.problem(("answers", place), given, allowed, remedy)])


def _design(name: str, preflight: Preflight, observer: Observer, placements: tuple[bool, ...]) -> Design:
    """Return the design of a protocol with one of its stimuli alone."""
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
    """Return what tells the speeds that two fingers feel.

    Parameters
    ----------
    preflight : Preflight
        A protocol with a single stimulus; it may be designed for the fingers of each placement.
    front_end : str
        Of the observer.

    Returns
    -------
    callable
        Takes the finger condition, the zones under the left and the right finger, and the level [m/s].
    """
    zones = {name: zone.centre_mm * 1e-3 for name, zone in preflight.experiment.apparatus.zones.items()}
    placed = preflight.placed or {"": preflight}
    speeds = {name: FeltSpeeds(part.stimulus, zones, front_end) for name, part in placed.items()}

    def felt(finger_condition: str, left: str, right: str, velocity: float) -> tuple[float, float]:
        place = preflight.findings.placement_of(finger_condition, left, right) if preflight.placed else ""
        return speeds[place].at(left, velocity), speeds[place].at(right, velocity)

    return felt


def _placements(protocol: Protocol) -> tuple[bool, ...]:
    """Return whether the beam is turned for the first, second, ... participant, until it begins anew."""
    conditions = protocol.conditions
    if not any(name.startswith("mirrored") for name in conditions.placements):
        return (False,)
    n_turns = len(conditions.placements) * max(1, 2 * len(conditions.finger_conditions))
    drawn = (Schedule.draw(protocol, f"p{number}", 0) for number in range(1, n_turns + 1))
    return tuple(schedule.trials[0].condition.is_mirrored for schedule in drawn)
