"""Coverage of a calibration's intervals for the true state of a twin, mode by mode.

``python tests/lab/intervals.py --twins 200 --out results/benchmarks/intervals.json``

Half of the twins have the shipped mismatch, half one five times as large and an amplifier of 100 kHz and 5 us. The
trigger's latency, the vibrometer's low-pass and its sensitivity are drawn with the uncertainties of the apparatus
file: normal, 95 % within 0.05 us, a fifth of the data sheet's lag, and 95 % within 1 %. A sensitivity affects all modes
of a twin alike, so sensitivities are drawn evenly over their quantiles. Each twin is calibrated; its true velocity and
w eta of every modelled mode under the kept targets are compared with the calibration's file (error after, plus or minus
its uncertainty), and so is the highest level at the focus.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from calibration.conftest import PROTOCOL, TwinBench, mismatched_of
from scipy.stats import norm

from modaltouch.lab.calibration import CalibrationLoop
from modaltouch.lab.calibration.file import CalibrationResult, corrected_inputs
from modaltouch.lab.calibration.plant import DATA_SHEET
from modaltouch.lab.common import NORMAL_95
from modaltouch.preflight import Preflight, examine
from modaltouch.preflight.single_design import design_to_fit
from modaltouch.protocol.apparatus import Apparatus
from modaltouch.rig.scope import Acquisition, Recording


def calibrated(
    preflight: Preflight, rig: Apparatus, seed: int, listed: Apparatus, reads: float = 1.0
) -> tuple[CalibrationResult, np.ndarray, float]:
    """Return a calibration of a twin, and the errors of its statements.

    Returns
    -------
    outcome : CalibrationResult
        The calibration.
    off : (2, n_modes) array
        Stated minus true velocity, and w eta, under the kept targets [m/s].
    level_off : float
        Stated minus true velocity at the focus at the highest level [m/s].
    """
    bench, inputs = Reading(rig, seed, reads), preflight.inputs
    outcome = CalibrationLoop(bench, listed, inputs).run()
    states = []
    for correction in (replace(outcome.correction, corrections=()), outcome.correction):
        played = design_to_fit(corrected_inputs(inputs, outcome.refined, correction), release="free")
        instant = played.timing.focusing_instant
        states.append(bench.true_state(played.burst, played.target_field.velocity, instant))
    stated, (true, at_level) = outcome.best.state, states
    shapes = bench.twin.beam.shapes(played.target_field.centre)[:, 0]
    at_focus = float(shapes @ np.append(at_level.velocity, at_level.unlisted_velocity))
    off = np.stack([stated.velocity - true.velocity, stated.displacement - true.displacement])
    return outcome, off, max(outcome.levels, key=lambda level: level.velocity).at_focus - at_focus


class Reading(TwinBench):
    """A bench whose vibrometer reads a multiple of the velocity."""

    def __init__(self, apparatus: Apparatus, seed: int, reads: float) -> None:
        super().__init__(apparatus, seed)
        self.reads = reads

    def record(self, position: float, velocity: float, acquisition: Acquisition) -> Recording:
        taken = super().record(position, velocity, acquisition)
        return replace(taken, velocity=taken.velocity * self.reads)


GOLDEN = (5**0.5 - 1) / 2


def reading(apparatus: Apparatus, number: int) -> float:
    """Return a vibrometer's reading of a velocity of 1, evenly over the quantiles of its uncertainty [1]."""
    known = apparatus.acquisition.sensitivity_uncertainty_percent * 1e-2 / NORMAL_95
    return 1 + known * float(norm.ppf((0.5 + number * GOLDEN) % 1))


def drawn(rig: Apparatus, shipped: Apparatus, seed: int) -> tuple[Apparatus, Apparatus]:
    """Return a rig and its listed values, which differ within the uncertainties of the apparatus file."""
    rng, knobs, twin = np.random.default_rng([seed, 9]), shipped.acquisition, rig.twin
    slower = max(0.4, 1 + DATA_SHEET * rng.standard_normal())
    filtered = twin.vibrometer.model_copy(update={"bandwidth_kHz": knobs.vibrometer_bandwidth_kHz / slower})
    late = twin.scope.trigger_latency_us + knobs.trigger_latency_uncertainty_us / NORMAL_95 * rng.standard_normal()
    told = knobs.model_copy(update={"trigger_latency_us": max(0.0, float(late))})
    return (
        rig.model_copy(update={"twin": twin.model_copy(update={"vibrometer": filtered})}),
        shipped.model_copy(update={"acquisition": told}),
    )


def main() -> None:
    """Calibrate the twins in turn, and write the coverage after each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--twins", type=int, default=200)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    preflight = examine(PROTOCOL).require()
    shipped = preflight.experiment.apparatus
    kinds = {"default": shipped, "hard": mismatched_of(shipped)}
    inside: dict[str, list[np.ndarray]] = {name: [] for name in kinds}
    levels: dict[str, list[bool]] = {name: [] for name in kinds}
    for seed in range(options.twins):
        name = tuple(kinds)[seed % len(kinds)]
        rig, listed = drawn(kinds[name], shipped, seed)
        reads = reading(listed, seed // len(kinds))
        outcome, off, level_off = calibrated(preflight, rig, seed, listed, reads)
        inside[name].append(np.abs(off) <= outcome.best.state.true_half_width)
        highest = max(outcome.levels, key=lambda level: level.velocity)
        levels[name].append(bool(abs(level_off) <= highest.true_half_width))
        result = {
            kind: {
                "n": len(each),
                "share_within": float(np.mean(each)),
                "share_within_by_mode": {
                    str(mode.label): float(share)
                    for mode, share in zip(shipped.modes, np.mean(each, axis=(0, 1)), strict=True)
                },
                "share_of_levels_within": float(np.mean(levels[kind])),
            }
            for kind, each in inside.items()
            if each
        }
        options.out.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
