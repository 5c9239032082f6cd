"""Protocols with several designs: of several stimuli, or for each placement of fingers, expected or measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from modaltouch.preflight.checked import Preflight
from modaltouch.preflight.single_design import (
    DesignInputs,
    design_to_fit,
    errors_of_gains,
    speeds_when_lifted,
    zone_points,
)
from modaltouch.protocol import Apparatus, Findings, InputError, Problem, Trial
from modaltouch.rig import instrument_of
from modaltouch.stimulus import Burst, Stimulus

if TYPE_CHECKING:
    from modaltouch.stimulus import Finger


DRIFT = 0.05
"""Relative difference between delivered and predicted speed above which a trial is marked [1]."""


def examine_several(findings: Findings, examine: Callable[[Findings], Preflight], shared: set[Problem]) -> Preflight:
    """Check a protocol with several stimuli, each on its own and all together, with their `shared` problems."""
    variants = {
        name: examine(replace(alone, problems=(*alone.problems, *findings.problems)))
        for name, alone in findings.each_stimulus()
    }
    problems = {
        problem
        for name, part in variants.items()
        for problem in findings.at_stimulus(name, set(part.problems) - shared)
    }
    first = next(iter(variants.values()))
    together = Preflight(findings, (), first.inputs, first.designed, variants)
    if not problems | shared and first.inputs is not None:
        by_placement: dict[str, list[Burst]] = {}
        for part in variants.values():
            for place, each in part.by_placement.items():
                by_placement.setdefault(place, []).append(each.stimulus.burst)
        for bursts in by_placement.values():
            problems.update(_check_memories(findings, first.inputs.apparatus, bursts))
    return replace(together, problems=tuple(sorted(problems | shared)))


def _check_memories(findings: Findings, apparatus: Apparatus, bursts: Sequence[Burst]) -> Iterator[Problem]:
    """Yield a problem if a placement needs more records than the generator has memories."""
    n_memories = instrument_of(apparatus).records.n_memories
    n_records = len({record.tobytes() for burst in bursts for record in burst.codes})
    if n_records > n_memories:
        yield findings.problem(
            ("stimuli",),
            f"{len(bursts)} stimuli with {n_records} different records",
            f"at most {n_memories}, one for each memory of the generator: two stimuli on two outputs",
            "use fewer (those that differ only in rate, bursts or masking share theirs), or several protocols",
        )


def examine_placements(
    findings: Findings, inputs: DesignInputs, examine: Callable[[Findings, DesignInputs], Preflight]
) -> Preflight:
    """Check a stimulus that has a design for each finger placement."""
    placed: dict[str, Preflight] = {}
    for name, fingers in ({} if findings.placements is None else findings.placements.all()).items():
        own = replace(inputs, fingers=fingers)
        # Placements whose fingers load the modes alike share a design.
        same = next((each for each in placed.values() if each.inputs and each.inputs.loads == own.loads), None)
        if same is not None and same.inputs is not None:
            placed[name] = replace(same, inputs=replace(same.inputs, fingers=fingers))
            continue
        placed[name], first = examine(findings, own), next(iter(placed.values()), None)
        if own.section.equalise_band_Hz and first and not {*placed[name].problems, *first.problems}:
            placed[name] = examine(findings, equalised(*placed[name].sound, first.sound))
    first = next(iter(placed.values()))
    problems = {
        replace(problem, given=f"{problem.given} under fingers at {name}")
        for name, part in placed.items()
        for problem in part.problems
    }
    return Preflight(findings, tuple(sorted(problems)), first.inputs, first.designed, placed=placed)


def attainable_level(inputs: DesignInputs, stimulus: Stimulus) -> float:
    """Return the highest level that amplifier, generator and safety allow, also if fingers are lifted [mm/s]."""
    amplifier = inputs.apparatus.amplifier.limit_V / float(stimulus.peak_drive(inputs.reference * 1e-3).max())
    generator = inputs.highest_amplitude / max(stimulus.burst.full_scale_for(inputs.reference * 1e-3))
    level, most = inputs.reference * min(amplifier, generator), inputs.velocity_limit * 1e-3
    error = errors_of_gains(inputs, stimulus, level)
    speeds = speeds_when_lifted(inputs, stimulus, level, most - float(error.max()))
    speeds[""] = stimulus.peak_velocity(zone_points(inputs).ravel(), level * 1e-3)
    level *= min(most / max(float((each + error).max()) for each in speeds.values()), 1.0)
    # Round down to a thousandth, the recorded precision.
    return math.floor(level * 1e3) / 1e3


def equalised(inputs: DesignInputs, stimulus: Stimulus, first: tuple[DesignInputs, Stimulus]) -> DesignInputs:
    """Return a placement's design inputs with levels scaled to the band velocity of the first placement.

    Velocity is equalised since perceived intensity follows it (Grigorii et al. 2021, under load, 20 to 400 Hz); the
    tactile channels span 0.4 to above 500 Hz (Bolanowski et al. 1988, J. Acoust. Soc. Am. 84, 1680).
    """
    share = round(_band_velocity(*first) / _band_velocity(inputs, stimulus), 4)
    return replace(inputs, levels={key: level * share for key, level in inputs.levels.items()}, share=share)


def _band_velocity(inputs: DesignInputs, stimulus: Stimulus) -> float:
    """Return the RMS velocity at the focus within the band, relative to the level [1]."""
    level, (low, high) = inputs.reference * 1e-3, inputs.section.equalise_band_Hz or (0.0, np.inf)
    velocity = stimulus.velocity_history([inputs.centre_mm * 1e-3], level, whole_period=True)[0]
    frequency = np.fft.rfftfreq(velocity.size, 1 / stimulus.timing.sampling_rate)
    size = np.abs(np.fft.rfft(velocity)) / velocity.size
    return float(np.sqrt(2 * (size[(frequency >= low) & (frequency <= high)] ** 2).sum())) / level


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
