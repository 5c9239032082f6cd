"""The designs for fingers that were measured as they lay on the beam."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from modaltouch.preflight.checked import Preflight
from modaltouch.preflight.examination import attainable_level, design_to_fit
from modaltouch.protocol import InputError, Trial

if TYPE_CHECKING:
    from modaltouch.stimulus import Finger


def with_measured(preflight: Preflight, trial: Trial, found: Mapping[str, Any]) -> Preflight:
    """Return the preflight with a placement designed for the fingers, and on the beam, that were measured there.

    The focus is under the finger that lies on its zone, wherever in the zone that is.

    Parameters
    ----------
    preflight : Preflight
        Of a protocol whose fingers are measured, for those that are expected.
    trial : Trial
        Whose placement it is.
    found : mapping
        As the record has it: ``fingers``, the keys of each in a file and its zone, by its name; ``modes``, frequency
        [Hz], damping ratio [1] and gains [mm/s^2 per V] of each mode of the table.
    """
    placements = preflight.findings.placements
    if placements is None:
        raise InputError(preflight.problems)
    by_zone = placements.measured(found["fingers"])
    place = preflight.findings.placement(trial.condition)
    parts = {name: _designed(part, place, by_zone, found["modes"]) for name, part in preflight.parts.items()}
    return replace(preflight, variants=parts) if preflight.variants else parts[""]


def _designed(part: Preflight, place: str, by_zone: Mapping[str, Finger], modes: list[dict[str, Any]]) -> Preflight:
    inputs, _ = part.placed[place].sound
    # Intervals of an identification say nothing of values that were found since.
    pairs = zip(inputs.apparatus.modes, modes, strict=True)
    refitted = tuple(mode.model_copy(update={**values, "intervals_95": None}) for mode, values in pairs)
    on_focus = by_zone.get(inputs.section.focus)
    own = replace(
        inputs,
        apparatus=inputs.apparatus.model_copy(update={"modes": refitted}),
        centre_mm=inputs.centre_mm if on_focus is None else on_focus.position * 1e3,
        fingers=tuple(sorted(by_zone.values(), key=lambda finger: finger.position)),
    )
    stimulus = design_to_fit(own)
    designed = replace(part.placed[place], inputs=own, designed=stimulus, attainable=attainable_level(own, stimulus))
    return replace(part, placed=part.placed | {place: designed})
