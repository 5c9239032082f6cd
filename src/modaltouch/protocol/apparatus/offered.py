"""Gains that the table of modes lacks, as the places of the patches suggest them: offered, not taken by themselves."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from modaltouch.protocol.apparatus.sections import Apparatus
from modaltouch.protocol.document import Problem, Reading

_NOTHING = 1e-6
"""Gain, over the largest of its set, below which a patch does not drive a mode: it lies across a node [1]."""


def offered_gains(apparatus: Apparatus) -> tuple[tuple[int, str, float], ...]:
    """Return mode label, actuator set and gain [mm/s^2 per V] that patches suggest where the table knows none.

    Theory gives the ratios among the bending modes (`patch_gains`), the gains that the table has their common factor,
    the median of what each of them says. A set without any such gain, or without patches, offers nothing.

    Parameters
    ----------
    apparatus : Apparatus
        The lab's.
    """
    from modaltouch.stimulus import patch_gains

    offered = []
    bending = [mode for mode in apparatus.modes if mode.label > 2]
    for name, actuators in apparatus.actuator_sets.items():
        if not (actuators.patches_mm and bending):
            continue
        ends = [(left * 1e-3, right * 1e-3) for left, right in actuators.patches_mm]
        unit = patch_gains([mode.label for mode in bending], ends, apparatus.beam.length_mm * 1e-3)
        felt = np.abs(unit) > _NOTHING * np.abs(unit).max()
        pairs = list(zip(bending, unit.tolist(), felt.tolist(), strict=True))
        factors = [
            mode.gain_mm_s2_per_V[name] / each
            for mode, each, feels in pairs
            if feels and name in mode.gain_mm_s2_per_V and name not in mode.assumed
        ]
        if factors:
            factor = float(np.median(factors))
            offered += [
                (mode.label, name, factor * each)
                for mode, each, feels in pairs
                if feels and (name not in mode.gain_mm_s2_per_V or name in mode.assumed)
            ]
    return tuple(offered)


def check_patches(reading: Reading[Apparatus]) -> Iterator[Problem]:
    """Yield the patches that lie off the beam or end before they begin."""
    length = reading.sound("beam", "length_mm")
    for name, actuators in reading.items("actuator_sets"):
        for index, (left, right) in enumerate(actuators.patches_mm):
            path = ("actuator_sets", name, "patches_mm", index)
            if not left < right:
                given = f"a patch from {left:g} to {right:g} mm"
                yield reading.problem(path, given, "the left end first", "exchange the two ends")
            elif length is not None and max(-left, right) > length / 2 * (1 + 1e-9):
                given = f"a patch from {left:g} to {right:g} mm"
                allowed = f"from {-length / 2:g} to {length / 2:g} mm, where the beam of {length:g} mm ends"
                yield reading.problem(path, given, allowed, "measure from mid-beam")
