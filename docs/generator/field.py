"""The tables behind the interactive field: what the engine computes for each mode alone, to be added up in the page.

Everything is linear in the modal velocities that are asked for at the focusing instant. The page adds up and scales these
tables; it computes no physics.
"""

import base64
import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

import modaltouch
from generator.pages import write
from modaltouch.protocol.placements import FingersFile
from modaltouch.stimulus import Correction, Finger, Stimulus
from modaltouch.stimulus.target_field import Projection
from modaltouch.stimulus.vibration import history

PROTOCOL = "differentiated_stimulation"
ROOT = Path(__file__).parents[2]
PLACES = np.linspace(-50, 50, 101)
"""Points of the beam [mm]."""
FOCI = np.arange(-45, 46)
"""Where the focus may be [mm]."""
LAID = np.arange(-40, 41, 10)
"""Where fingers that weigh may lie [mm]."""


def instants(timing: Any) -> np.ndarray:
    """Return the samples whose velocity the page knows: every 2 us about the focus, 40 us further away."""
    time = np.arange(timing.n_samples) / timing.sampling_rate - timing.focusing_instant
    step = round(2e-6 * timing.sampling_rate)
    near = np.abs(time) <= 0.6e-3
    far = ~near & (np.abs(time + 2.5e-3) < 7.5e-3)
    return np.sort(np.r_[np.flatnonzero(near)[::step], np.flatnonzero(far)[:: 20 * step]])


def one_by_one(stimulus: Stimulus) -> list[Stimulus]:
    """Return a stimulus for each modelled mode: it alone moves at the focusing instant, at 1 m/s per m/s of the level."""
    level, n_modes = stimulus.target_field.velocity, stimulus.model.n_modes
    rest = np.zeros(n_modes)
    return [replace(stimulus, correction=Correction(np.eye(n_modes)[k] * level, rest, level)) for k in range(n_modes)]


def typical_finger(place_mm: float) -> Finger:
    """Return the shipped typical finger at a place."""
    section = FingersFile.read(ROOT / "protocols" / "fingers" / "typical.yaml").fingers
    return Finger(
        place_mm * 1e-3, section.mass_g * 1e-3, section.damping_N_s_per_m, section.stiffness_N_per_mm * 1e3,
        section.contact_width_mm * 1e-3,
    )  # fmt: skip


def tables() -> dict[str, Any]:
    """Return all that the page adds up, in mm/s of response per mm/s of modal velocity."""
    preflight = modaltouch.examine(PROTOCOL).require()
    inputs, stimulus = preflight.sound
    model, timing, level = stimulus.model, stimulus.timing, stimulus.target_field.velocity
    shapes = model.shapes(PLACES * 1e-3)
    coefficient = [
        Projection(model, replace(stimulus.target_field, centre=focus * 1e-3)).coefficient / level for focus in FOCI
    ]
    alone, kept = one_by_one(stimulus), instants(timing)
    courses = np.array(
        [history(stimulus.system, stimulus.system.velocity, each.voltage, timing)[:, kept] / level for each in alone]
    )
    touched = {
        f"{left} {right}": [_under(each, (left, right), shapes, level) for each in alone]
        for left, right in combinations(LAID.tolist(), 2)
    }
    scale = np.abs(courses).max(axis=2)
    codes = np.round(courses / np.maximum(scale, 1e-12)[..., None] * 32767).astype("<i2")
    return {
        "protocol": PROTOCOL,
        "labels": list(model.label),
        "frequencies_Hz": model.natural_frequency.tolist(),
        "selected": list(stimulus.selected),
        "base_mm": inputs.section.field.base_mm,
        "zones_mm": {
            name: [zone.centre_mm - zone.width_mm / 2, zone.centre_mm + zone.width_mm / 2]
            for name, zone in inputs.apparatus.zones.items()
        },
        "places_mm": PLACES.tolist(),
        "shapes": np.round(shapes, 5).tolist(),
        "foci_mm": FOCI.tolist(),
        "coefficients": np.round(coefficient, 6).tolist(),
        "laid_mm": LAID.tolist(),
        "touched": {name: np.round(values, 5).tolist() for name, values in touched.items()},
        "time_ms": np.round((kept / timing.sampling_rate) * 1e3, 4).tolist(),
        "history_scale": np.round(scale, 8).tolist(),
        "history": base64.b64encode(codes.tobytes()).decode(),
    }


def _under(stimulus: Stimulus, places: tuple[float, float], shapes: np.ndarray, level: float) -> np.ndarray:
    """Return the modal velocities at the focusing instant under two typical fingers, by that of the mode asked for."""
    beam = stimulus.touched(tuple(map(typical_finger, places)))
    field = beam.velocity_at_focus(PLACES * 1e-3, stimulus.volts_per_code(level)) / level
    return np.linalg.lstsq(shapes.T, field, rcond=None)[0]


def write_tables(folder: Path) -> None:
    """Write the tables as a script, which a page can load from a file as well as from a server."""
    write(folder / "field_tables.js", "window.MODALTOUCH_FIELD = " + json.dumps(tables()) + ";\n")
