"""From what was measured to what is aimed at next, in the digits of the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from modaltouch.lab.calibration.plant import ModalState, Plant
from modaltouch.preflight import DesignInputs, Preflight
from modaltouch.protocol import Apparatus, InputError, Problem, Protocol
from modaltouch.stimulus import Correction

FloatArray = NDArray[np.float64]

N_BETWEEN = 3
"""Levels verified between bounds within which any level may be played."""

CERTAIN = 3.0
"""Standard errors below which a deviation may be noise, and is not corrected [1]."""

DIGITS = 6
"""Decimals of a target in mm/s that the file keeps: a thousandth of what noise leaves."""


def grounds_of(preflight: Preflight) -> dict[str, DesignInputs]:
    """Return what each stimulus of a checked protocol is designed from, by name; one alone has none.

    Raises
    ------
    InputError
        If anything is wrong with the files, or a stimulus has no targets that could be corrected.
    """
    preflight.require()
    faults = {name: list(_uncorrectable(part)) for name, part in preflight.parts.items()}
    problems = [each for name, own in faults.items() for each in preflight.findings.at_stimulus(name, own)]
    if problems:
        raise InputError(problems)
    return {name: part.sound[0] for name, part in preflight.parts.items()}


def levels_between(protocol: Protocol) -> tuple[float, ...]:
    """Return the levels between a protocol's bounds that are verified too, at equal ratios [mm/s].

    An adaptive run, or a participant whose levels are calibrated, may get any level there. Other protocols have none:
    every level that is played is measured.

    Parameters
    ----------
    protocol : Protocol
        The protocol.
    """
    if protocol.adaptive is None and protocol.conditions.sensation_levels is None:
        return ()
    low, *_, high = sorted(protocol.conditions.peak_velocities_mm_s)
    ratio = (high / low) ** (1 / (N_BETWEEN + 1))
    return tuple(float(f"{low * ratio**step:.4g}") for step in range(1, N_BETWEEN + 1))


def _uncorrectable(preflight: Preflight) -> Iterator[Problem]:
    """Yield why the targets of a protocol's one stimulus cannot be corrected."""
    (ground, _), reading = preflight.sound, preflight.findings.protocol
    if reading is None:
        return
    if ground.section.law != "exact":
        given = f"{ground.section.law}, a law without targets that could be corrected"
        yield reading.problem(("stimulus", "law"), given, "exact", "calibrate the exact law")
    if ground.section.field.file is not None:
        given, remedy = (
            "a file, which a calibration does not hold",
            "write the points into the protocol, under `points`",
        )
        yield reading.problem(("stimulus", "field", "file"), given, "points", remedy)


def significant(state: ModalState, target: FloatArray) -> FloatArray:
    """Return how far the states are from their targets, less what may be noise, (2, n_modes) array [m/s].

    A deviation of a few standard errors is corrected in part, a smaller one not at all, so that the loop does not
    chase the noise of its own measurements.

    Parameters
    ----------
    state : ModalState
        As measured.
    target : (n_modes,) array
        Modal velocities wished [m/s].
    """
    error = np.stack([state.velocity - target, state.displacement])
    doubt = CERTAIN * state.spread / np.maximum(np.abs(error), 1e-30)
    return np.asarray(error * np.maximum(1 - doubt**2, 0.0))


def aimed_ground(ground: DesignInputs, refined: Apparatus, correction: Correction) -> DesignInputs:
    """Return what a stimulus is designed from on an identified rig."""
    used = ground.apparatus.model_copy(update={"modes": refined.modes, "amplifier": refined.amplifier})
    return replace(ground, apparatus=used, correction=correction)


def refined_apparatus(apparatus: Apparatus, plant: Plant) -> Apparatus:
    """Return an apparatus with modes and amplifier as identified, with the digits that the calibration file keeps."""
    channel = {name: actuators.channel - 1 for name, actuators in apparatus.actuator_sets.items()}
    modes = []
    for row, mode in enumerate(apparatus.modes):
        gains = {name: _digits(plant.model.modal_gain[row, place] * 1e3) for name, place in channel.items()}
        update = {
            "natural_frequency_Hz": _digits(plant.model.natural_frequency[row]),
            "damping_ratio": _digits(plant.model.damping_ratio[row]),
            "gain_mm_s2_per_V": gains,
            "assumed": (),
        }
        modes.append(mode.model_copy(update=update))
    bandwidth = plant.amplifier.bandwidth
    amplifier = apparatus.amplifier.model_copy(
        update={
            "gain_V_per_V": _digits(plant.amplifier.gain),
            "bandwidth_kHz": None if bandwidth is None else _digits(bandwidth * 1e-3),
            "delay_us": _digits(plant.amplifier.delay * 1e6),
        }
    )
    return apparatus.model_copy(update={"modes": tuple(modes), "amplifier": amplifier})


def _digits(value: float) -> float:
    return float(f"{value:.9g}")
