"""Intervals of a beam over repeated measurements: the scatter from one to the next beside the fit's own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modaltouch.lab.identification.estimates import Estimate, Identification, IdentifiedMode
from modaltouch.lab.identification.joint_fit import identify, identify_each

SAME_MODE = 0.005
"""Relative difference of natural frequencies up to which modes without a label are the same [1]."""


def over_repeats(found: Identification) -> Identification:
    """Return modes whose intervals hold their scatter over the repeats that the responses keep.

    Each repeat is fitted by itself, for the mean of responses whose frequencies wander has too much damping. A
    parameter's interval is that of Student over the repeats, and never narrower than that of the joint fit. A mode that
    fewer than two repeats show keeps its own.
    """
    repeats = [_fit(found, repeat) for repeat in range(len(found.responses.repeats))]
    return replace(found, modes=tuple(_over(mode, [_same(mode, each) for each in repeats]) for mode in found.modes))


def _fit(found: Identification, repeat: int) -> Sequence[IdentifiedMode]:
    """Return the modes of one repeat; none where nothing can be fitted to it."""
    responses = found.responses.repeats[repeat].aligned()
    try:
        if found.poles is None:
            return identify_each(responses).modes
        start = replace(found.poles, delay=found.delay.value - responses.offset)
        return identify(responses, found.length, start=start, most=0).modes
    except ValueError:
        return ()


def _same(mode: IdentifiedMode, others: Sequence[IdentifiedMode]) -> IdentifiedMode | None:
    """Return the one that is a mode again: by its label, else by its natural frequency."""
    own = mode.natural_frequency.value
    alike = [
        (abs(each.natural_frequency.value / own - 1), each)
        for each in others
        if each.label == mode.label and (mode.label or abs(each.natural_frequency.value / own - 1) < SAME_MODE)
    ]
    return min(alike, key=lambda each: each[0])[1] if alike else None


def _over(mode: IdentifiedMode, repeats: Sequence[IdentifiedMode | None]) -> IdentifiedMode:
    """Return a mode with its intervals over its repeats."""
    known = [each for each in repeats if each is not None]
    if len(known) < 2:
        return mode
    gains = zip(mode.gain, *(each.gain for each in known), strict=True)
    return replace(
        mode,
        natural_frequency=_widened(mode.natural_frequency, [each.natural_frequency for each in known]),
        damping_ratio=_widened(mode.damping_ratio, [each.damping_ratio for each in known]),
        gain=tuple(_widened(joint, each) for joint, *each in gains),
        n_repeats=len(known),
    )


def _widened(joint: Estimate, repeats: Sequence[Estimate]) -> Estimate:
    """Return the mean of repeats, with the interval of Student or the joint fit's, whichever is wider."""
    from scipy.stats import t

    values, n = [each.value for each in repeats], len(repeats)
    scatter = float(np.std(values, ddof=1)) / math.sqrt(n) * float(t.ppf(0.975, n - 1))
    half, mean = max((joint.high - joint.low) / 2, scatter), float(np.mean(values))
    return Estimate(mean, mean - half, mean + half)
