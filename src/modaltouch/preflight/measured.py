"""Designs for fingers measured on the beam."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from modaltouch.preflight.checked import Preflight
from modaltouch.preflight.design_inputs import DesignInputs, design_to_fit, equalised
from modaltouch.preflight.examination import attainable_level
from modaltouch.protocol import InputError, Trial

if TYPE_CHECKING:
    from modaltouch.stimulus import Finger


DRIFT = 0.05
"""Relative difference between delivered and predicted speed above which a trial is marked [1]."""


def with_measured(preflight: Preflight, trial: Trial, found: Mapping[str, Any]) -> Preflight:
    """Return the preflight with one placement redesigned for the measured fingers and modes.

    The focus is at the position of the finger in the focus zone.

    Parameters
    ----------
    preflight : Preflight
        Preflight of a protocol with measured fingers, designed for the expected fingers.
    trial : Trial
        A trial with this placement.
    found : mapping
        Measurement as recorded: ``fingers`` by name, each with the keys of a fingers file and its zone; ``modes``, the
        natural frequency [Hz], damping ratio [1] and gains [mm/s^2 per V] of each mode of the table.
    """
    placements = preflight.findings.placements
    if placements is None:
        raise InputError(preflight.problems)
    by_zone = placements.measured(found["fingers"])
    place = preflight.findings.placement(trial.condition)
    parts = {name: _designed(part, place, by_zone, found["modes"]) for name, part in preflight.parts.items()}
    return replace(preflight, variants=parts) if preflight.variants else parts[""]


def delivered_figures(preflight: Preflight, trial: Trial, found: Mapping[str, Any]) -> dict[str, float]:
    """Return the speeds delivered under the fingers in a trial, computed from the fingers measured during its burst.

    Parameters
    ----------
    preflight : Preflight
        Result of `with_measured` for the placement.
    trial : Trial
        The trial.
    found : mapping
        ``fingers`` and ``modes`` measured during the burst, as for `with_measured`.

    Returns
    -------
    dict
        Peak speed under each finger, ``speed_left_mm_s`` and so on [mm/s].
    """
    placements, condition = preflight.findings.placements, trial.condition
    if placements is None:
        raise InputError(preflight.problems)
    inputs, stimulus = preflight.designs[preflight.design_of(condition)].sound
    by_zone = placements.measured(found["fingers"])
    own = _on_beam(inputs, by_zone, found["modes"])
    played = replace(stimulus.touched(()), model=own.apparatus.modal_model().touched(own.fingers))
    unit = stimulus.volts_per_code(preflight.played(condition, condition.velocity_mm_s) * 1e-3)
    speeds = played.peak_velocity([by_zone[zone].position for zone in condition.zones], unit)
    return dict(zip(map("speed_{}_mm_s".format, condition.sides), (speeds * 1e3).round(3).tolist(), strict=True))


def has_drifted(preflight: Preflight, trial: Trial, delivered: Mapping[str, Any]) -> bool:
    """Return whether the whole interval of a delivered speed is more than 5 % off the prediction.

    Parameters
    ----------
    preflight, trial
        As for `delivered_figures`.
    delivered : mapping
        Interval of the speed under each finger, ``interval_left_mm_s`` and so on [mm/s].
    """
    names = map("interval_{}_mm_s".format, trial.condition.sides)
    ratios = [
        np.array(delivered[name]) / (speed * 1e3) for name, speed in zip(names, preflight.speeds(trial), strict=True)
    ]
    return any(low > 1 + DRIFT or high < 1 - DRIFT for low, high in ratios)


def _on_beam(inputs: DesignInputs, by_zone: Mapping[str, Finger], modes: list[dict[str, Any]]) -> DesignInputs:
    # The intervals of the identification do not apply to values measured later.
    pairs = zip(inputs.apparatus.modes, modes, strict=True)
    refitted = tuple(mode.model_copy(update={**values, "intervals_95": None}) for mode, values in pairs)
    return replace(
        inputs,
        apparatus=inputs.apparatus.model_copy(update={"modes": refitted}),
        fingers=tuple(sorted(by_zone.values(), key=lambda finger: finger.position)),
    )


def _designed(part: Preflight, place: str, by_zone: Mapping[str, Finger], modes: list[dict[str, Any]]) -> Preflight:
    own, on_focus = _on_beam(part.placed[place].sound[0], by_zone, modes), by_zone.get(part.sound[0].section.focus)
    own = replace(own, levels=part.sound[0].levels, share=1.0)
    own = own if on_focus is None else replace(own, centre_mm=on_focus.position * 1e3)
    stimulus = design_to_fit(own)
    if own.section.equalise_band_Hz:
        own = equalised(own, stimulus, part.sound)
        stimulus = design_to_fit(own)
    designed = replace(part.placed[place], inputs=own, designed=stimulus, attainable=attainable_level(own, stimulus))
    return replace(part, placed=part.placed | {place: designed})
