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
from modaltouch.stimulus.burst import MID_CODE
from modaltouch.stimulus.design import Stimulus

AMPLITUDE_RANGE = (0.02, 20.0)
"""Amplitudes of an AFG3022B into an open circuit [V peak to peak]."""

_POINTS_PER_ZONE = 5
"""Points at which a zone's speed is looked at: a quarter of the shortest wavelength of Table I apart."""

_LEVELS = ("conditions", "peak_velocities_mm_s")


def check_levels(ground: Ground, stimulus: Stimulus, protocol: Reading[Protocol]) -> list[Problem]:
    """Return the levels that amplifier, generator or safety do not allow.

    Parameters
    ----------
    ground : Ground
        What the stimulus was designed from.
    stimulus : Stimulus
        The stimulus of all levels.
    protocol : Reading
        The protocol file, for the places of its levels.
    """
    problems: list[Problem] = []
    for index, level in ground.levels.items():
        amplified = list(_check_amplifier(ground, stimulus, protocol, index, level))
        problems += amplified or _check_generator(ground, stimulus, protocol, index, level)
        problems += _check_safety(ground, stimulus, protocol, index, level)
    return problems


def peak_drive(stimulus: Stimulus, velocity: float) -> NDArray[np.float64]:
    """Return the highest magnitude of each channel's voltage as played at a level, (n_channels,) array [V].

    Parameters
    ----------
    stimulus : Stimulus
        The stimulus of all levels.
    velocity : float
        Level [m/s].
    """
    voltage = np.abs(stimulus.voltage_played(velocity))
    return np.asarray(voltage.max(axis=1))


def fits_generator(ground: Ground, stimulus: Stimulus) -> bool:
    """Return whether the full scales at the reference level can be set."""
    return max(stimulus.burst.amplitude) <= _highest_amplitude(ground)


def _highest_amplitude(ground: Ground) -> float:
    """Return what the generator may be set to without its full scale passing the amplifier's limit [Vpp]."""
    to_beam = ground.apparatus.amplifier.gain_V_per_V * ground.apparatus.generator.load_factor
    # Rounded down to 10 mV of level, as the rig sets the instrument's own limit.
    within_amplifier = 2 * math.floor(ground.apparatus.amplifier.limit_V / to_beam * 100 + 1e-6) / 100
    return min(AMPLITUDE_RANGE[1], within_amplifier)


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
    smallest, largest = AMPLITUDE_RANGE[0], _highest_amplitude(ground)
    silent = (stimulus.burst.codes == MID_CODE).all(axis=1)
    for channel, amplitude in enumerate(stimulus.burst.amplitude_for(level * 1e-3)):
        where = f"{level:g} mm/s, which needs {amplitude:.4g} V peak to peak of output {channel + 1}"
        path = (*_LEVELS, index)
        if not silent[channel] and amplitude > largest:
            highest = _rounded_down(level * largest / amplitude)
            allowed = f"at most {largest:g} V into an open circuit ({highest} mm/s)"
            yield protocol.problem(path, where, allowed, "lower the level, or take an amplifier of higher gain")
        if not silent[channel] and amplitude < smallest:
            allowed = f"at least {smallest:g} V, the generator's smallest amplitude"
            yield protocol.problem(path, where, allowed, "raise the level")


def _check_safety(
    ground: Ground, stimulus: Stimulus, protocol: Reading[Protocol], index: int, level: float
) -> Iterator[Problem]:
    limit, zones = ground.velocity_limit, ground.zones
    if level > limit:
        return  # said by the protocol's own check
    edges = [zone_edges(zone) for zone in zones.values()]
    half = ground.apparatus.beam.length_mm / 2
    points = np.clip([np.linspace(*edge, _POINTS_PER_ZONE) for edge in edges], -half, half)
    speeds = stimulus.peak_velocity(points.ravel() * 1e-3, level * 1e-3).reshape(points.shape) * 1e3
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
