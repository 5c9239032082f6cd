"""Whether a calibration has proved what it says: its errors against their limits, and why one is missed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from modaltouch.lab.calibration.doubts import HYSTERESIS
from modaltouch.lab.calibration.file import CERTAIN, CalibrationResult, Level
from modaltouch.lab.calibration.plant import INTERVAL
from modaltouch.protocol import Protocol

LARGEST_SHORTFALL = 0.01
"""What the peaks of the measured drive may lack of the commanded ones [1]."""

Missed = dict[str, Any]


def mark_of(outcome: CalibrationResult, protocol: Protocol) -> dict[str, Any]:
    """Return which limits a calibration misses, its uncertainty counted against it, and why, as its file has them.

    Parameters
    ----------
    outcome : CalibrationResult
        Of one stimulus.
    protocol : Protocol
        Its ``calibration.limits``.

    Returns
    -------
    dict
        ``missed`` and ``causes``, both empty for a calibration that has proved itself.
    """
    missed = list(_missed(outcome, protocol))
    return {"missed": missed, "causes": list(_causes(outcome, protocol, missed)) if missed else []}


def _missed(outcome: CalibrationResult, protocol: Protocol) -> Iterator[Missed]:
    reference, limits = outcome.inputs.reference, protocol.calibration.limits
    highest = max(outcome.levels, key=lambda level: level.velocity)
    for turn, level in ((outcome.best, reference), (outcome.halfway, outcome.halfway_level * 1e3)):
        target = outcome.target * level / reference
        reached = (
            np.hypot(turn.state.velocity - target, turn.state.half_width),
            np.hypot(turn.state.displacement, turn.state.half_width),
        )
        for what, each, allowed in zip(
            ("velocity", "displacement"), reached, (limits.velocity_mm_s, limits.displacement_mm_s), strict=True
        ):
            yield from _beyond(f"{what}_mm_s", level, float(each.max()) * 1e3, allowed)
        slip = float(turn.state.shown_slip.max()) * 1e3
        yield from _beyond("frequencies_mm_s", level, slip, limits.displacement_mm_s)
    for asked in outcome.levels:
        reached_percent = _level_error(asked, limits.level_percent, highest.velocity)
        yield from _beyond("level_percent", asked.velocity * 1e3, reached_percent, limits.level_percent)
    shortfall = float(outcome.drive_shortfall.max()) * 100
    yield from _beyond("drive_percent", highest.velocity * 1e3, shortfall, LARGEST_SHORTFALL * 100)


def _beyond(limit: str, level: float, reached: float, allowed: float) -> Iterator[Missed]:
    # What is no number has not been proved.
    if not reached <= allowed:
        reached = float(np.nan_to_num(reached, nan=1e9, posinf=1e9))
        yield {"limit": limit, "level_mm_s": round(level, 6), "reached": round(reached, 4), "allowed": allowed}


def _level_error(level: Level, allowed: float, highest: float) -> float:
    """Return a level's deviation [percent]; 0 where it may be noise, unless that is too large at the highest level.

    The noise is the vibrometer's, so that a low level is known less well: there proportion vouches for it.
    """
    deviation = 100 * abs(level.at_focus / level.velocity - 1)
    noise = 100 * level.spread / level.velocity
    if deviation > max(allowed, CERTAIN * noise):
        return deviation
    uncertainty = 100 * INTERVAL * level.spread / highest
    return uncertainty if uncertainty > allowed else 0.0


def _causes(outcome: CalibrationResult, protocol: Protocol, missed: list[Missed]) -> Iterator[str]:
    """Yield each cause that the records show, with its remedy."""
    limits, last = protocol.calibration.limits, outcome.turns[-1].state
    allowed = min(limits.velocity_mm_s, limits.displacement_mm_s) * 1e-3
    noise = INTERVAL * float(outcome.best.state.spread.max())
    highest = max(level.velocity for level in outcome.levels)
    level_noise = INTERVAL * max(level.spread for level in outcome.levels)
    if any(each["limit"] == "drive_percent" for each in missed):
        output = int(outcome.drive_shortfall.argmax())
        yield (
            f"the amplifier saturates: output {output + 1} commands {outcome.drive_peak[output]:.0f} V, of which the "
            f"measured peaks lack {outcome.drive_shortfall[output]:.1%}; lower the highest level, or give "
            "amplifier.limit_V its true value"
        )
    elif float(last.shown_slip.max()) > max(allowed / 2, noise):
        yield _changed_frequencies(outcome)
    elif noise > allowed / 2 or 100 * level_noise > limits.level_percent * highest:
        yield (
            f"the velocity is noisy: {noise * 1e3:.2g} mm/s of a mode and {level_noise * 1e3:.2g} mm/s of a level "
            "remain unknown; focus the vibrometer on a spot that reflects, fasten the sensor, and choose the smallest "
            "range that holds the velocity"
        )
    elif (last.disagreement > np.maximum(4 * last.spread, allowed / 4)).any():
        yield (
            "the points along the beam do not agree: the sensor is loose, or its spot not where it was asked for; "
            "fasten it, aim anew and calibrate again"
        )
    elif all(each["level_mm_s"] != outcome.inputs.reference for each in missed):
        yield HYSTERESIS
    else:
        yield (
            "nothing in the records shows the cause; identify the beam anew with `modaltouch identify`, and calibrate "
            "with what it finds"
        )


def _changed_frequencies(outcome: CalibrationResult) -> str:
    """Return whether frequencies drift from record to record or change with the amplitude, and what to do.

    Over all turns they are a constant, a part in proportion to the number of records before and one in proportion to
    the voltage squared: the larger of both is the cause.
    """
    turns, state = (*outcome.turns, outcome.halfway), outcome.turns[-1].state
    # Of the modes that show it, the one whose pole moved least against its decay rate: to first order it is known best.
    strain = state.slip / np.hypot(state.velocity, state.displacement)
    mode = int(np.argmin(np.where(state.shown_slip > 0, strain, np.inf)))
    taken = np.array([turn.n_taken for turn in turns], dtype=float)
    volts = np.array([turn.peak_voltage for turn in turns])
    terms = np.stack([np.ones(taken.size), taken / taken.max(), (volts / volts.max()) ** 2], axis=1)
    found = np.array([turn.state.change[mode] for turn in turns])
    parts = np.linalg.lstsq(terms, found, rcond=None)[0] * np.ptp(terms, axis=0)
    label = outcome.refined.modes[mode].label
    if abs(parts[2]) > abs(parts[1]):
        return (
            f"the natural frequencies change with the amplitude: mode {label} by {parts[2]:+.2g} of itself "
            f"from {volts.min():.0f} to {volts.max():.0f} V; lower the highest level, bring the levels closer "
            "together, and see whether patches and suspension are sound"
        )
    return (
        f"the beam drifts: the natural frequency of mode {label} changed by {parts[1]:+.2g} of itself from the first "
        "iteration to the last record; let beam, patches and amplifier come to a steady temperature, see whether the "
        "suspension holds, and calibrate again"
    )
