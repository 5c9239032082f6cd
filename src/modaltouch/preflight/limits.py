"""Amplifier, generator and safety limits at every level, each fault at the level that breaks it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from modaltouch.apparatus import zone_edges
from modaltouch.document import Problem, Reading
from modaltouch.preflight.ground import Ground
from modaltouch.protocol import Protocol
from modaltouch.rig.settings import LOWEST_AMPLITUDE, highest_level
from modaltouch.stimulus.design import Stimulus

_POINTS_PER_ZONE = 5
"""Points at which a zone's speed is looked at: a quarter of the shortest wavelength of Table I apart."""

_LEVELS = ("conditions", "peak_velocities_mm_s")


def check_levels(ground: Ground, stimulus: Stimulus, protocol: Reading[Protocol]) -> list[Problem]:
    """Return the levels that amplifier, generator or safety do not allow."""
    problems = _check_range(ground, stimulus, protocol)
    if problems:
        return problems
    fast = _moves_fast(ground, stimulus)
    for index, level in ground.levels.items():
        amplified = list(_check_amplifier(ground, stimulus, protocol, index, level))
        problems += amplified or _check_generator(ground, stimulus, protocol, index, level)
        problems += _check_safety(ground, stimulus, protocol, index, level) if fast else []
    return problems


def fits_generator(ground: Ground, stimulus: Stimulus) -> bool:
    """Return whether the full scales at the reference level can be set."""
    return max(stimulus.amplitude_for(stimulus.wish.velocity)) <= _highest_amplitude(ground)


def _highest_amplitude(ground: Ground) -> float:
    """Return what the generator may be set to without its full scale passing the amplifier's limit [Vpp]."""
    return 2 * highest_level(ground.apparatus)


def _check_amplifier(
    ground: Ground, stimulus: Stimulus, protocol: Reading[Protocol], index: int, level: float
) -> Iterator[Problem]:
    limit = ground.apparatus.amplifier.limit_V
    needed = float(stimulus.peak_voltage.max()) * level * 1e-3 / stimulus.wish.velocity
    if needed > limit * (1 + 1e-9):
        highest = _rounded_down(limit / needed * level)
        given = f"{level:g} mm/s, which needs {needed:.0f} V at the beam"
        allowed = f"at most {limit:g} V there ({highest} mm/s)"
        remedy = "lower the level, or choose a law, field or focus that needs less"
        yield protocol.problem((*_LEVELS, index), given, allowed, remedy)


def _check_generator(
    ground: Ground, stimulus: Stimulus, protocol: Reading[Protocol], index: int, level: float
) -> Iterator[Problem]:
    smallest, largest = LOWEST_AMPLITUDE, _highest_amplitude(ground)
    path, sounding = (*_LEVELS, index), _sounding(stimulus, level)
    if not sounding:
        return
    strong, weak = max(sounding, key=sounding.__getitem__), min(sounding, key=sounding.__getitem__)
    if sounding[strong] > largest:
        given = f"{level:g} mm/s, which needs {sounding[strong]:.4g} V peak to peak of output {strong}"
        highest = _rounded_down(level * largest / sounding[strong])
        allowed = f"at most {largest:g} V into an open circuit ({highest} mm/s)"
        yield protocol.problem(path, given, allowed, "lower the level, or take an amplifier of higher gain")
    if sounding[weak] < smallest:
        given = f"{level:g} mm/s, which needs {sounding[weak]:.4g} V peak to peak of output {weak}"
        least = level * smallest / sounding[weak]
        allowed = f"at least {smallest:g} V, the generator's smallest amplitude (about {_rounded_up(least)} mm/s)"
        # A lab that thinks in m/s writes 0.08 for 80 mm/s.
        meant = level * 1e3 if level < 1 and least <= level * 1e3 <= ground.velocity_limit else None
        remedy = "raise the level" if meant is None else f"did you mean {meant:g} mm/s? Levels are in mm/s, not m/s"
        yield protocol.problem(path, given, allowed, remedy)


def _sounding(stimulus: Stimulus, level: float) -> dict[int, float]:
    """Return the amplitude of every output that is not silent, by its number [V peak to peak]."""
    silent = stimulus.peak_drive(level * 1e-3) == 0
    amplitudes = stimulus.amplitude_for(level * 1e-3)
    return {number: float(each) for number, each in enumerate(amplitudes, 1) if not silent[number - 1]}


def _check_range(ground: Ground, stimulus: Stimulus, protocol: Reading[Protocol]) -> list[Problem]:
    """Return why no level can be played: one output falls below the generator's range before the beam is in its own."""
    level, limit = stimulus.wish.velocity * 1e3, ground.apparatus.amplifier.limit_V
    sounding = _sounding(stimulus, level)
    if not sounding:
        return []
    highest = level * min(
        limit / float(stimulus.peak_voltage.max()), _highest_amplitude(ground) / max(sounding.values())
    )
    weak = min(sounding, key=sounding.__getitem__)
    least = level * LOWEST_AMPLITUDE / sounding[weak]
    if least <= highest:
        return []
    length, base = ground.apparatus.beam.length_mm, ground.section.field.base_mm
    path: tuple[str, ...] = ("stimulus",)
    given = "a field that no level can play"
    if base > length:
        path = ("stimulus", "field", "base_mm")
        given = f"{base:g} mm on a beam of {length:g} mm, a field that no level can play"
    given += (
        f" (output {weak} needs at least {_rounded_up(least)} mm/s for the generator's smallest amplitude, and "
        f"amplifier and generator reach at most {_rounded_down(highest)} mm/s)"
    )
    allowed = f"up to {length:g} mm" if base > length else ""
    return [protocol.problem(path, given, allowed, "choose another field, focus or modes; no other level will do")]


def _moves_fast(ground: Ground, stimulus: Stimulus) -> bool:
    """Return whether any level may pass the safety limit; the speeds of all rise with the level."""
    limit = ground.velocity_limit
    highest = max((level for level in ground.levels.values() if level <= limit), default=0.0)
    return highest > 0 and stimulus.passes(_zone_points(ground).ravel(), highest * 1e-3, limit * 1e-3)


def _zone_points(ground: Ground) -> NDArray[np.float64]:
    """Return the points at which each zone's speed is looked at, (n_zones, n_points) array [m]."""
    edges = [zone_edges(zone) for zone in ground.zones.values()]
    half = ground.apparatus.beam.length_mm / 2
    return np.clip([np.linspace(*edge, _POINTS_PER_ZONE) for edge in edges], -half, half) * 1e-3


def _check_safety(
    ground: Ground, stimulus: Stimulus, protocol: Reading[Protocol], index: int, level: float
) -> Iterator[Problem]:
    limit, zones, points = ground.velocity_limit, ground.zones, _zone_points(ground)
    if level > limit:
        return  # said by the protocol's own check
    speeds = stimulus.peak_velocity(points.ravel(), level * 1e-3).reshape(points.shape) * 1e3
    fastest = int(speeds.max(axis=1).argmax())
    speed = float(speeds.max())
    # At the focus the codes' rounding may pass a level that is the limit itself.
    if speed > limit * (1 + 1e-3):
        zone = list(zones)[fastest]
        given = f"{level:g} mm/s, which moves zone {zone} at {speed:.0f} mm/s"
        allowed = f"at most {limit:g} mm/s anywhere in a zone ({_rounded_down(level * limit / speed)} mm/s)"
        remedy = "lower the level; the limit is the safety section of the apparatus"
        yield protocol.problem((*_LEVELS, index), given, allowed, remedy)


def _rounded_down(value: float) -> str:
    """Return a level that can be written down without passing the limit [mm/s]."""
    return f"{math.floor(value):d}" if value >= 10 else f"{math.floor(value * 1000) / 1000:g}"


def _rounded_up(value: float) -> str:
    """Return a level above one that is too small [mm/s]."""
    return f"{math.ceil(value):d}" if value >= 10 else f"{math.ceil(value * 10) / 10:g}"
