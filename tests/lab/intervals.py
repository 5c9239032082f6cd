"""How often the true state of a twin lies in the interval that its calibration states, mode by mode.

``python tests/lab/intervals.py --twins 200 --out results/benchmarks/intervals.json``

Half of the twins have the mismatch that the apparatus is shipped with, half one five times as large and an amplifier
of 100 kHz and 5 us. Each is calibrated; velocity and w eta of every modelled mode under the kept targets are read from
the twin and held against what the calibration's file says: error after, plus or minus its uncertainty.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from calibration.conftest import PROTOCOL, TwinBench, mismatched_of

from modaltouch.lab.calibration.file import CalibrationResult, corrected_inputs
from modaltouch.lab.calibration.loop import calibrate
from modaltouch.preflight import Preflight, examine
from modaltouch.preflight.examination import design_to_fit
from modaltouch.protocol.apparatus import Apparatus


def calibrated(
    preflight: Preflight, rig: Apparatus, seed: int, listed: Apparatus
) -> tuple[CalibrationResult, np.ndarray]:
    """Return a calibration of a twin, and how far its stated state lies from the true one, (2, n_modes) [m/s]."""
    bench, inputs = TwinBench(rig, seed), preflight.inputs
    outcome = calibrate(bench, listed, inputs)
    correction = replace(outcome.correction, corrections=())
    played = design_to_fit(corrected_inputs(inputs, outcome.refined, correction), release="free")
    true = bench.true_state(played.burst, played.target_field.velocity, played.timing.focusing_instant)
    stated = outcome.best.state
    return outcome, np.stack([stated.velocity - true.velocity, stated.displacement - true.displacement])


def main() -> None:
    """Calibrate the twins in turn, and write the shares after each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--twins", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    preflight = examine(PROTOCOL).require()
    shipped = preflight.experiment.apparatus
    kinds = {"default": shipped, "hard": mismatched_of(shipped)}
    within: dict[str, list[np.ndarray]] = {name: [] for name in kinds}
    for number in range(options.twins):
        name = tuple(kinds)[number % 2]
        outcome, off = calibrated(preflight, kinds[name], options.first + number, shipped)
        within[name].append(off / outcome.best.state.half_width)
        labels = [mode.label for mode in shipped.modes]
        result = {}
        for kind, each in within.items():
            if each:
                ratio = np.array(each)
                result[kind] = {
                    "n": len(each),
                    "share_within": float((np.abs(ratio) <= 1).mean()),
                    "share_within_by_mode": dict(
                        zip(map(str, labels), (np.abs(ratio) <= 1).mean(axis=(0, 1)).tolist(), strict=True)
                    ),
                    "rms_of_deviation_over_half_width_by_mode": np.sqrt((ratio**2).mean(axis=0)).round(3).tolist(),
                    "mean": ratio.mean(axis=0).round(3).tolist(),
                }
        options.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
