"""Up-down staircases over the level in decibels.

References
----------
Levitt, "Transformed up-down methods in psychoacoustics", J. Acoust. Soc. Am. 49 (1971) 467-477.
Kaernbach, "Simple adaptive testing with the weighted up-down method", Perception & Psychophysics 49 (1991) 227-229.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from modaltouch.protocol.adaptive import StaircaseSection


def is_success(rule: str, focus: str, zone_left: str, answer: str) -> bool:
    """Return whether an answer counts as success in an adaptive run.

    ``focus_named``: the answer is the finger on the zone in focus, alone. "both" and "none" are failures like the
    other finger: what is asked is the level from which the focus is told apart, not from which something is felt.
    ``felt``: any answer but "none".

    Parameters
    ----------
    rule : str
        ``adaptive.success`` of the protocol.
    focus : str
        Zone in focus.
    zone_left : str
        Zone under the left finger.
    answer : str
        What was answered.
    """
    if rule == "felt":
        return answer != "none"
    return answer == ("left" if zone_left == focus else "right")


@dataclass(frozen=True)
class StaircaseState:
    """A staircase after some answers.

    Attributes
    ----------
    next_dB : float
        Level of the next trial [dB].
    reversals : tuple of int
        Trials, from 0, after which the staircase turned.
    """

    next_dB: float  # noqa: N815
    reversals: tuple[int, ...]


def follow(
    rule: StaircaseSection, start: float, bounds: tuple[float, float], successes: Sequence[bool]
) -> StaircaseState:
    """Return where a staircase stands after some answers.

    Parameters
    ----------
    rule : StaircaseSection
        The rule.
    start : float
        Level of the first trial [dB].
    bounds : (float, float)
        Lowest and highest level [dB]; a step that would pass one ends there.
    successes : sequence of bool
        The answers so far, in order.

    Returns
    -------
    StaircaseState
        The step shrinks at each reversal, before it is taken.
    """
    level, in_a_row, heading = start, 0, 0
    reversals: list[int] = []
    for trial, success in enumerate(successes):
        if success:
            in_a_row += 1
            if in_a_row < rule.down_after:
                continue
        in_a_row = 0
        direction = -1 if success else 1
        if heading and direction != heading:
            reversals.append(trial)
        heading = direction
        step = rule.steps_dB[min(len(reversals), len(rule.steps_dB) - 1)]
        level += direction * step * (rule.up_over_down if direction > 0 else 1.0)
        level = min(max(level, bounds[0]), bounds[1])
    return StaircaseState(level, tuple(reversals))
